"""One level's submap: a spline through the displacements of the frames that ask for them.

A hand that holds nothing at a frame has nothing to say there: the displacement of its own joints
is zero only because nobody asked. Taken for data, those zeros would pull the arm back to where it
was at every release and out again at every grasp. Each degree of freedom is fitted to the frames
in which something that it moves is held, and in between the spline goes on smoothly.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.joint_coupling import coupling
from mjmotion.body.kinematics import body_dofs
from mjmotion.constraints import Targets
from mjmotion.ik.solver import Solution
from mjmotion.numerics.bspline import Curve, fit_level

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def fit_submap(
    model: mujoco.MjModel,
    targets: Targets,
    solution: Solution,
    nframe: int,
    spacing: float,
    passes: int,
    curve: Curve = fit_level,
) -> Array:
    """Return the submap (nframe, nv) of one level.

    Args:
      model: the MuJoCo model.
      targets: what is held, over ``n`` constrained frames.
      solution: what the solver answered there.
      nframe: frames of the motion.
      spacing: frames a knot.
      passes: times that Eq. 2 is applied.
      curve: how a level is fitted, if not so.
    """
    moves, held = _columns(model, targets)
    displacement, pushed = solution.displacement, solution.pushed
    if pushed is not None and pushed.any():
        moves = np.vstack((moves, np.ones(model.nv, dtype=bool)))
        held = np.column_stack((held, pushed))
    if held.all():
        frames = targets.frames
        return curve(frames, displacement, nframe, spacing, passes=passes)
    submap = np.zeros((nframe, model.nv))
    kinds, kind = np.unique(moves, axis=1, return_inverse=True)
    asked = np.stack([held[:, one].any(axis=1) for one in kinds.T])
    for rows in np.unique(asked, axis=0):
        columns = np.flatnonzero((asked == rows).all(axis=1)[kind])
        if rows.any():
            data = displacement[np.ix_(np.flatnonzero(rows), columns)]
            submap[:, columns] = curve(targets.frames[rows], data, nframe, spacing, passes=passes)
    return submap


def _columns(model: mujoco.MjModel, targets: Targets) -> tuple[Mask, Mask]:
    """Return which degrees of freedom (k, nv) serve each thing that is held, and when (n, k)."""
    serve = [body_dofs(model, int(model.site_bodyid[site])) for site in targets.sites]
    weight = [*np.maximum(targets.position_weight, targets.turn_weight).T]
    for link in targets.links:
        bodies = (int(model.site_bodyid[site]) for site in (link.site, link.to))
        serve.append(np.logical_or(*(body_dofs(model, body) for body in bodies)))
        weight.append(np.maximum(link.position_weight, link.turn_weight))
    for gaze in targets.gazes:
        serve.append(body_dofs(model, int(model.site_bodyid[gaze.site])))
        weight.append(gaze.weight)
    moves = np.array(serve).reshape(-1, model.nv)
    tied = coupling(model)
    for leader, follower in zip(tied.leader, tied.follower, strict=True):
        moves[:, leader] |= moves[:, follower]
    moves[:, tied.follower] = moves[:, tied.leader]
    return moves, np.array(weight).T > 0.0
