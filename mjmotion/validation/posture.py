"""How a body is held: pitch of trunk and head, bend of the knees, beside the source's own."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.validation.anatomy import Anatomy, Leg
from mjmotion.validation.inputs import ChangingBody

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

LEVEL_WITHIN = 0.02  # [m] ground whose heights differ by less is level
LEVEL_TIME = 0.5  # [s] to either side, for which it has to be level
_LYING = 1e-3  # of the length of the side axis: less of it level gives no direction


@dataclasses.dataclass(frozen=True, eq=False)
class BodyStates:
    """Where the character is in all frames of one motion.

    Attributes:
      turn: (nframe, nbody, 3, 3) orientations of all bodies.
      anchor: (nframe, njnt, 3) places of all joints [m].
      com: (nframe, 3) the character's centre of mass [m].
    """

    turn: Array
    anchor: Array
    com: Array


def body_states(model: mujoco.MjModel, qpos: Array, body: ChangingBody | None = None) -> BodyStates:
    """Return bodies, joints and the centre of mass of poses (n, nq), from MuJoCo frame by frame.

    Args:
      model: the model.
      qpos: (n, nq) poses.
      body: the sizes of every frame, where they change; the centre of mass then is NaN.
    """
    if body is not None:
        body = body.on(model)
        model = copy.copy(body.model)
    data, root, count = mujoco.MjData(model), int(model.jnt_bodyid[0]), len(qpos)
    turn = np.empty((count, model.nbody, 9))
    anchor, com = np.empty((count, model.njnt, 3)), np.full((count, 3), np.nan)
    # Views of what MuJoCo writes; a frame costs a few microseconds.
    pose, xmat, xanchor, middle = data.qpos, data.xmat, data.xanchor, data.subtree_com[root]
    for row in range(count):
        if body is not None:
            body.write(model, row)
        pose[:] = qpos[row]
        mujoco.mj_kinematics(model, data)
        turn[row], anchor[row] = xmat, xanchor
        if body is None:
            mujoco.mj_comPos(model, data)
            com[row] = middle
    return BodyStates(turn.reshape(count, -1, 3, 3), anchor, com)


def pitch(states: BodyStates, rest: BodyStates, body: int, root: int) -> Array:
    """Return by how far (nframe,) a body leans forwards [deg], in (-180, 180].

    The angle between the body's up axis and the vertical about the root's own side axis, which is
    its y axis made level. The up axis is what is vertical at rest. NaN where the root lies on its
    side, so that its side axis is nowhere level, and in all frames where it is not so at rest.

    Args:
      states: all frames.
      rest: the pose ``qpos0``, one frame.
      body: id of the body.
      root: id of the root.
    """
    side = states.turn[:, root, :, 1].copy()
    side[:, 2] = 0.0
    length = np.linalg.norm(side, axis=1)
    resting = np.linalg.norm(rest.turn[0, root, :2, 1])
    side[(length < _LYING) | (resting < _LYING)] = np.nan
    up = states.turn[:, body] @ rest.turn[0, body, 2]
    forwards = (side[:, 1] * up[:, 0] - side[:, 0] * up[:, 1]) / np.maximum(length, _LYING)
    return np.asarray(np.degrees(np.arctan2(forwards, up[:, 2])))


def further_back(own: Array, source: Array) -> tuple[float, int]:
    """Return how much further back [deg] than its source a body leans, and in which frame.

    The most backward frame of all against the source's most backward; no less than 0, NaN where
    either has no pitch (nframe,) at all.
    """
    if np.isnan(own).all() or np.isnan(source).all():
        return np.nan, 0
    frame = int(np.nanargmin(own))
    return max(0.0, float(np.nanmin(source) - own[frame])), frame


def knee_flexion(states: BodyStates, leg: Leg) -> Array:
    """Return the angle (nframe,) between thigh and shank [deg]: 0 of a straight leg."""
    hip, knee, ankle = (states.anchor[:, joint] for joint in (leg.hip, leg.knee, leg.ankle))
    thigh, shank = knee - hip, ankle - knee
    across = np.linalg.norm(np.cross(thigh, shank), axis=1)
    along = np.einsum("fi,fi->f", thigh, shank)
    return np.asarray(np.degrees(np.arctan2(across, along)))


def level_frames(height: Array, fps: float) -> Mask:
    """Return the frames (nframe,) around which feet stand on level ground.

    Args:
      height: (nframe, nsite) of the ground under sites in contact [m], NaN out of contact and
        infinite over nothing.
      fps: frames a second.
    """
    reach = round(LEVEL_TIME * fps)
    none = np.isnan(height)
    low = np.where(none, np.inf, height).min(axis=1, initial=np.inf)
    high = np.where(none, -np.inf, height).max(axis=1, initial=-np.inf)
    windows = np.lib.stride_tricks.sliding_window_view
    low = windows(np.pad(low, reach, constant_values=np.inf), 2 * reach + 1).min(axis=1)
    high = windows(np.pad(high, reach, constant_values=-np.inf), 2 * reach + 1).max(axis=1)
    return np.asarray(np.isfinite(low) & np.isfinite(high) & (high <= low + LEVEL_WITHIN))


def knee_bend(
    anatomy: Anatomy, own: BodyStates, source: BodyStates, stands: Sequence[Mask]
) -> tuple[float, int | None]:
    """Return how much more the knee of the worst leg is bent than the source's, and which leg.

    Args:
      anatomy: the character's legs.
      own: all frames of the motion.
      source: those of its source.
      stands: for each leg the frames (nframe,) that count.

    Returns:
      bend: mean of the differences over those frames [deg]; NaN where no leg has any.
      leg: its number; None where there is none.
    """
    worst: tuple[float, int | None] = (np.nan, None)
    for number, (leg, frames) in enumerate(zip(anatomy.legs, stands, strict=True)):
        if not frames.any():
            continue
        more = (knee_flexion(own, leg) - knee_flexion(source, leg))[frames].mean()
        if worst[1] is None or more > worst[0]:
            worst = float(more), number
    return worst
