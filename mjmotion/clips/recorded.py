"""Keep what a recording says of each role's joint, to be held against what is made of it."""

from __future__ import annotations

import numpy as np

from mjmotion.body.recording import Recording
from mjmotion.clips.floor import Floor
from mjmotion.clips.rig import ROLES
from mjmotion.clips.upright import UprightClip
from mjmotion.numerics import rotations as rot

Array = rot.Array

# The humanoid's body whose origin is where the joint of a role is, by the role's part.
_BODIES = {
    "pelvis": "pelvis",
    "neck": "neck",
    "head": "head",
    "shoulder": "upper_arm",
    "elbow": "forearm",
    "wrist": "hand",
    "hip": "thigh",
    "knee": "shank",
    "ankle": "foot",
    "toe": "toes",
}


def keep_recording(source: UprightClip, turn: Array, start: Array, floor: Floor) -> Recording:
    """Return a clip's joints by role, turned and moved over the ground as the motion is.

    Args:
      source: the clip as recorded: before any of it is mended.
      turn: (4,) wxyz by which the motion is turned about z.
      start: (3,) what is put to x = y = 0 before that [m].
      floor: the ground under the recording, after both.
    """
    roles = [role for role in ROLES if source.has(role) and _part(role) in _BODIES]
    joints = [source.clip.index(source.rig.joints[role]) for role in roles]
    positions = rot.rotate(turn, source.clip.positions[:, joints] - start)
    turns = rot.from_matrix(source.clip.rotations[:, joints])
    under = np.stack([floor.under(positions[:, i]) for i in range(len(roles))], axis=1)
    return Recording(
        tuple(roles),
        tuple(role.removesuffix(_part(role)) + _BODIES[_part(role)] for role in roles),
        positions,
        rot.normalized(rot.multiply(turn, turns)),
        under,
    )


def _part(role: str) -> str:
    """Return a role's part of the body, without its side."""
    return role.rpartition("_")[2]
