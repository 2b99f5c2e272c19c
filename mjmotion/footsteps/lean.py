"""Leaning into a climb: the trunk comes forwards by what the hips stay back.

Hips that stay back uphill, for the sake of the ankles, would leave the body's weight behind its
feet. A person leans forwards then, with the gaze up and the arms hanging.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.kinematics import Kinematics, level_side
from mjmotion.body.motion import Motion
from mjmotion.exceptions import ModelError
from mjmotion.footsteps.bow import bend_forwards
from mjmotion.numerics.tangent import oplus

Array = NDArray[np.float64]

LEAN = 2.5  # how far a trunk leans for each metre that the hips stay back [rad/m]


def leaning(motion: Motion, back: Array) -> Motion:
    """Return the motion leaning forwards; itself where nothing asks for it.

    Args:
      motion: the motion.
      back: (nframe,) how far its hips are to stay back [m].
    """
    if not back.any():
        return motion
    try:
        parts = motion.character.parts
    except ModelError:  # no trunk to bend
        return motion
    pose = Kinematics(motion.model, motion.nframe).forward(motion.qpos)
    unit = bend_forwards(motion, parts, pose, level_side(pose))
    qpos = oplus(motion.model, motion.qpos, LEAN * back[:, None] * unit)
    return motion.replace(motion.character.within_limits(qpos))
