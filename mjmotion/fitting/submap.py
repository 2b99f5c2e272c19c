"""One level's submap: a spline through the displacements of the frames that ask for them.

A hand that holds nothing at a frame has nothing to say there: the displacement of its own joints
is zero only because nobody asked. Taken for data, those zeros would pull the arm back to where it
was at every release and out again at every grasp. Each degree of freedom is fitted to the frames
in which something that it moves is held, and in between the spline goes on smoothly.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.character import Character
from mjmotion.body.kinematics import body_dofs
from mjmotion.constraints import Targets
from mjmotion.ik.solver import Solution
from mjmotion.numerics.bspline import Curve

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def fit_submap(
    character: Character,
    targets: Targets,
    nframe: int,
    frames_per_knot: float,
    passes: int,
    curve: Curve,
    solution: Solution,
) -> Array:
    """Return the submap (nframe, nv) of one level.

    Args:
      character: the body.
      targets: what is held, over ``n`` constrained frames.
      nframe: frames of the motion.
      frames_per_knot: of this level.
      passes: times that Eq. 2 is applied.
      curve: how a level is fitted: Eq. 2, or another to compare it with.
      solution: what the solver answered at the constrained frames.
    """
    model = character.model
    moves, held = _columns(character, targets)
    displacement, pushed = solution.displacement, solution.pushed
    if pushed is not None and pushed.any():
        moves = np.vstack((moves, np.ones(model.nv, dtype=bool)))
        held = np.column_stack((held, pushed))
    if held.all():
        frames = targets.frames
        return curve(frames, displacement, nframe, frames_per_knot, passes=passes)
    submap = np.zeros((nframe, model.nv))
    kinds, kind = np.unique(moves, axis=1, return_inverse=True)
    asked = np.stack([held[:, one].any(axis=1) for one in kinds.T])
    for rows in np.unique(asked, axis=0):
        columns = np.flatnonzero((asked == rows).all(axis=1)[kind])
        if rows.any():
            data = displacement[np.ix_(np.flatnonzero(rows), columns)]
            submap[:, columns] = curve(
                targets.frames[rows], data, nframe, frames_per_knot, passes=passes
            )
    return submap


def _columns(character: Character, targets: Targets) -> tuple[Mask, Mask]:
    """Return which degrees of freedom (k, nv) serve each thing that is held, and when (n, k)."""
    model = character.model
    serve = [body_dofs(model, int(model.site_bodyid[site])) for site in targets.sites]
    weight = [*np.maximum(targets.position_weight, targets.turn_weight).T]
    for one in targets.relative:
        bodies = (int(model.site_bodyid[site]) for site in (one.site, one.to))
        serve.append(np.logical_or(*(body_dofs(model, body) for body in bodies)))
        weight.append(np.maximum(one.position_weight, one.turn_weight))
    for look in targets.look_at:
        serve.append(body_dofs(model, int(model.site_bodyid[look.site])))
        weight.append(look.weight)
    moves = np.array(serve).reshape(-1, model.nv)
    tied = character.coupling
    for leader, follower in zip(tied.leader, tied.follower, strict=True):
        moves[:, leader] |= moves[:, follower]
    moves[:, tied.follower] = moves[:, tied.leader]
    return moves, np.array(weight).T > 0.0
