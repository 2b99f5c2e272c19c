"""Where a body that changes is in every frame, from MuJoCo itself, frame by frame.

A loop over one ``MjData`` with each frame's body written into a private copy of the model: slower
than :class:`mjmotion.body.kinematics.Kinematics` and independent of it, so that what a fit claims
can be held against it.
"""

from __future__ import annotations

import copy
import dataclasses

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.validation.inputs import ChangingBody

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class BodyPoses:
    """World positions of all frames.

    Attributes:
      site: (nframe, nsite, 3) sites [m].
      site_matrix: (nframe, nsite, 3, 3) their orientations.
      geom: (nframe, ngeom, 3) geoms [m].
      geom_matrix: (nframe, ngeom, 3, 3) their orientations.
    """

    site: Array
    site_matrix: Array
    geom: Array
    geom_matrix: Array


def body_poses(body: ChangingBody, qpos: Array) -> BodyPoses:
    """Return where sites and geoms are.

    Args:
      body: the body of every frame.
      qpos: (n, nq) poses of all frames.
    """
    model = copy.copy(body.model)
    data = mujoco.MjData(model)
    count = len(qpos)
    site, geom = np.empty((count, model.nsite, 3)), np.empty((count, model.ngeom, 3))
    site_matrix = np.empty((count, model.nsite, 9))
    geom_matrix = np.empty((count, model.ngeom, 9))
    for row in range(count):
        body.write(model, row)
        data.qpos[:] = qpos[row]
        mujoco.mj_kinematics(model, data)
        site[row], site_matrix[row] = data.site_xpos, data.site_xmat
        geom[row], geom_matrix[row] = data.geom_xpos, data.geom_xmat
    return BodyPoses(
        site,
        site_matrix.reshape(count, -1, 3, 3),
        geom,
        geom_matrix.reshape(count, -1, 3, 3),
    )
