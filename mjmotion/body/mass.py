"""Where a body's mass is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.kinematics import Pose
from mjmotion.numerics.rotations import rotate

Array = NDArray[np.float64]


def centre_of_mass(pose: Pose) -> Array:
    """Return the centre of mass of poses (n, 3) [m]."""
    mass = pose.model.body_mass
    place = pose.xpos + rotate(pose.xquat, pose.model.body_ipos)
    return np.asarray((mass[:, None] * place).sum(axis=1) / mass.sum())
