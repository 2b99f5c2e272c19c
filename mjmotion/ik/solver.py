"""What every IK solver does: the least displacement that meets the constraints, frame by frame.

    problem = solver.prepare(targets, clearance)    # once a fit
    solution = problem.solve(qpos)                  # towards the targets, all constrained frames
    closed = problem.enforce(qpos)                  # onto the targets, exactly (§4.4)

A problem sees the poses of the constrained frames, all at once, and answers with one displacement a
frame, which minimises Eq. 4, ``Σ α_i |v_i|²``, among those that meet the targets. A problem never
changes: what a level may take over from the one before it, such as a factored matrix, travels in
the solution, which is handed back as ``last``.

A solver of one's own needs :class:`IKSolver` and :class:`IKProblem`. Targets that are free to move
as a whole (§7) also need :class:`SensitiveProblem`; a fit says in one line if that is not there.
"""

from __future__ import annotations

import dataclasses
from typing import Any, Protocol, runtime_checkable

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.kinematics import Pose
from mjmotion.constraints import Targets
from mjmotion.constraints.shared_targets import Sensitivity

Array = NDArray[np.float64]

ROOT_SHIFT_RIGIDITY = 60.0  # α of the root's translation, against 1 rad² of a joint [1/m²]
ROOT_TURN_RIGIDITY = 12.0  # α of the root's rotation
_LIGHT, _HEAVY = 0.5, 4.0  # α of a joint that moves nothing, and of one that moves the whole body


@dataclasses.dataclass(frozen=True, eq=False)
class Inequalities:
    """What is lacking, ``rows @ displacement ≥ needed``, each row about one frame.

    Attributes:
      frame: (m,) which of the poses handed in.
      rows: (m, nv).
      needed: (m,) [m]; positive where the pose breaks the inequality.
      distance: (m,) signed distance to what is to be kept clear of [m].
    """

    frame: NDArray[np.int64]
    rows: Array
    needed: Array
    distance: Array


class Clearance(Protocol):
    """Something to keep clear of."""

    def __call__(self, qpos: Array, frames: NDArray[np.int64]) -> Inequalities:
        """Return what poses (n, nq) at ``frames`` (n,) lack; only frames that lack something."""
        ...


@dataclasses.dataclass(frozen=True, eq=False)
class Deviation:
    """How far poses already are from the motion that a fit keeps to.

    Attributes:
      values: (n, nv) displacement so far; zero where it does not count.
      counts: (n,) whether a frame's deviation counts; else its displacement is least in itself.
    """

    values: Array
    counts: NDArray[np.bool_]

    def at(self, rows: NDArray[np.int64]) -> Deviation:
        """Return the deviation of some of the constrained frames."""
        return Deviation(self.values[rows], self.counts[rows])


@dataclasses.dataclass(frozen=True, eq=False)
class Solution:
    """What a problem answers.

    Attributes:
      displacement: (n, nv).
      error: (n,) largest position error of each frame before solving [m].
      rise: (n,) where the solver leaves the root alone, how far it would have to go up for all to
        be in reach [m]; down is negative. None where the root took part.
      standing_rise: (n,) the same for what stands or holds on alone.
      pushed: (n,) frames that inequalities ask anything of: any of their joints may serve.
      memory: what the solver takes over to the next level; its own affair.
    """

    displacement: Array
    error: Array
    rise: Array | None = None
    standing_rise: Array | None = None
    pushed: NDArray[np.bool_] | None = None
    memory: Any = None


class IKProblem(Protocol):
    """Targets that poses are to be brought to; nothing of it changes."""

    def solve(
        self, qpos: Array, last: Solution | None = None, deviation: Deviation | None = None
    ) -> Solution:
        """Return displacements for poses (n, nq) at the targets' frames (Eq. 4).

        Args:
          qpos: (n, nq) poses.
          last: what the level before answered, on targets of the same frames and sites.
          deviation: given where targets are free to move: displacements are then least together
            with it. A problem without ``sensitivity`` is never given one.
        """
        ...

    def enforce(self, qpos: Array) -> Solution:
        """Return displacements that meet every target exactly (§4.4), moving the root least."""
        ...


@runtime_checkable
class SensitiveProblem(IKProblem, Protocol):
    """A problem that says what its targets cost: what free targets need (§7)."""

    def sensitivity(
        self, qpos: Array, deviation: Deviation | None = None, last: Solution | None = None
    ) -> Sensitivity:
        """Return what the frames' deviations cost when their targets change."""
        ...


class IKSolver(Protocol):
    """Makes problems: the body, its rigidities and settings are the solver's.

    A solver for a body that is not its character's own, or that changes from frame to frame, says
    so by an attribute ``bones``.
    """

    def prepare(self, targets: Targets, clearance: Clearance | None = None) -> IKProblem:
        """Return the problem of some targets, and what to keep clear of."""
        ...


def default_rigidity(model: mujoco.MjModel) -> Array:
    """Return the rigidity α (nv,) of every degree of freedom (Eq. 4).

    A joint resists in proportion to the share of the body's mass that it moves. The root is stiff:
    its path is the first guess's to find (§4.5), the rest of the body works around it.
    """
    total = model.body_subtreemass[model.jnt_bodyid[0]]
    share = model.body_subtreemass[model.dof_bodyid] / max(total, 1e-9)
    rigidity = _LIGHT + _HEAVY * share
    rigidity[:3], rigidity[3:6] = ROOT_SHIFT_RIGIDITY, ROOT_TURN_RIGIDITY
    return np.asarray(rigidity)


def position_error(pose: Pose, targets: Targets) -> Array:
    """Return the largest position error of each frame (n,) [m], world and relative places alike."""
    gap = np.linalg.norm(targets.position - pose.site_xpos[:, targets.sites], axis=-1)
    worst = np.max(gap * (targets.position_weight > 0), axis=1, initial=0.0)
    for one in targets.relative:
        gap = np.linalg.norm(one.world_position(pose) - pose.site_xpos[:, one.site], axis=-1)
        worst = np.maximum(worst, gap * (one.position_weight > 0))
    return np.asarray(worst)
