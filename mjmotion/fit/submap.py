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

from mjmotion.constraints import Targets
from mjmotion.kinematics import body_dofs
from mjmotion.spline import Curve, fit_level

Array = NDArray[np.float64]


def fit_submap(
    model: mujoco.MjModel,
    targets: Targets,
    displacement: Array,
    nframe: int,
    spacing: float,
    passes: int,
    curve: Curve = fit_level,
) -> Array:
    """Return the submap (nframe, nv) of one level.

    Args:
      model: the MuJoCo model.
      targets: what is held, over ``n`` constrained frames.
      displacement: (n, nv) what the solver answered there.
      nframe: frames of the motion.
      spacing: frames a knot.
      passes: times that Eq. 2 is applied.
      curve: how a level is fitted, if not so.
    """
    moves = np.zeros((len(targets.sites) + 1, model.nv), dtype=bool)
    for row, site in zip(moves, targets.sites, strict=False):
        row[:] = body_dofs(model, int(model.site_bodyid[site]))
    moves[-1] = True  # what is held to another site, or looks at something, may ask any joint
    held = np.maximum(targets.position_weight, targets.turn_weight) > 0.0
    held = np.column_stack((held, targets.other))
    if held[:, :-1].all():
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
