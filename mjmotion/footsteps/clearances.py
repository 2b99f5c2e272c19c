"""Several things to keep clear of at once, and the way out of what a motion is in.

keep = Clearances((obstacles, BodyClearances(kinematics, (itself, ground))))
motion = pushed_clear(motion, constraints, keep, levels)
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.kinematics import Kinematics, Pose
from mjmotion.body.motion import Motion
from mjmotion.constraints import Constraint, lay_out
from mjmotion.fitting import run_level
from mjmotion.ik import NumericIK, Solution
from mjmotion.ik.solver import Clearance, Inequalities
from mjmotion.numerics.bspline import fit_level

Array = NDArray[np.float64]
Index = NDArray[np.int64]

ROUNDS = 4  # times that what is still lacking is pushed, with knots of one width


class BodyClearance(Protocol):
    """Something to keep clear of that needs no model but the character's own."""

    def lacking(self, pose: Pose, qpos: Array, frames: Index) -> Inequalities:
        """Return what poses (n, nq) at ``frames`` (n,), worked out with geoms, lack of it."""
        ...


class BodyClearances:
    """All that several of these ask for, each pose worked out once for all of them.

    Args:
      kinematics: of the character, with geoms, for as many frames as will be asked for.
      parts: what to keep clear of; at least one.
    """

    def __init__(self, kinematics: Kinematics, parts: Sequence[BodyClearance]) -> None:
        self._kinematics, self.parts = kinematics, tuple(parts)

    def __call__(self, qpos: Array, frames: Index) -> Inequalities:
        """Return what poses (n, nq) at ``frames`` (n,) lack of any of them."""
        pose = self._kinematics.forward(qpos, np.arange(len(qpos)))
        return _together([part.lacking(pose, qpos, frames) for part in self.parts])


class Clearances:
    """All that several clearances ask for (:class:`mjmotion.ik.solver.Clearance`).

    Args:
      parts: what to keep clear of; at least one.
    """

    def __init__(self, parts: Sequence[Clearance]) -> None:
        self.parts = tuple(parts)

    def __call__(self, qpos: Array, frames: Index) -> Inequalities:
        """Return what poses (n, nq) at ``frames`` (n,) lack of any of them."""
        return _together([part(qpos, frames) for part in self.parts])


class _Found:
    """What has been found of the poses that a solver of one iteration asks about."""

    def __init__(self, found: Inequalities) -> None:
        self._found = found

    def __call__(self, qpos: Array, frames: Index) -> Inequalities:
        """Return it, whatever the poses."""
        return self._found


def _together(found: Sequence[Inequalities]) -> Inequalities:
    return Inequalities(
        np.concatenate([one.frame for one in found]),
        np.concatenate([one.rows for one in found]),
        np.concatenate([one.needed for one in found]),
        np.concatenate([one.distance for one in found]),
    )


def pushed_clear(
    motion: Motion,
    constraints: Sequence[Constraint],
    clearance: Clearance,
    levels: Sequence[float],
    rounds: int = ROUNDS,
    rigidity: Array | None = None,
) -> Motion:
    """Return the motion pushed out of what it is in, smoothly, near the frames that are in it.

    Only frames that lack something take part, so that the way out spreads to the frames around
    them, which constraints at every frame would forbid: those are for the fit that follows.

    Args:
      motion: what is to be clear.
      constraints: held in the frames that take part.
      clearance: what to keep clear of.
      levels: frames a knot, coarse to fine.
      rounds: times that what is still lacking is pushed, with each of them.
      rigidity: (nv,) α of Eq. 4; those of every solver without.
    """
    qpos, frames = np.array(motion.qpos), np.arange(motion.nframe)
    targets = lay_out(constraints, motion.model, motion.nframe).over_all_frames(motion.nframe)
    solver = NumericIK(motion.character, rigidity, iterations=1)  # the rounds are its iterations
    look = frames  # what has not moved lacks what it lacked
    for frames_per_knot in levels:
        for _ in range(rounds):
            found = clearance(qpos[look], look)
            lacking, frame = np.unique(found.frame, return_inverse=True)
            near = look[lacking]
            if len(near) == 0:
                return motion.replace(qpos)
            found = dataclasses.replace(found, frame=frame.ravel())  # of those that are near

            def spline(
                solution: Solution, at: Index = near, knots: float = frames_per_knot
            ) -> Array:
                return fit_level(at, solution.displacement, motion.nframe, knots)

            problem = solver.prepare(targets.at(near), _Found(found))
            before = qpos
            qpos = run_level(motion.character, qpos, near, problem.solve, spline).qpos
            look = np.flatnonzero((qpos != before).any(axis=1))
    return motion.replace(qpos)
