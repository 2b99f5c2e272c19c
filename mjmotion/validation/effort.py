"""What moves the body: its centre of mass, and the force that the ground under it cannot give."""

from __future__ import annotations

import copy

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.validation.cone import beyond_cone
from mjmotion.validation.lowpass import low_pass
from mjmotion.validation.support import Support

Array = NDArray[np.float64]

CUTOFF = 6.0  # [Hz] of the low-pass of all that is measured here
HALF_WIDTH = 0.035  # [m] a foot presses with a point this far to either side of its site
UNEXPLAINED = 0.1  # [body weights] a frame with more force left than this counts
_EDGES = 8  # of the pyramid that stands for a friction cone


def acceleration_rms(com: Array, fps: float) -> float:
    """Return the RMS of the acceleration of a centre of mass (nframe, 3) [m/s²]; NaN of two."""
    if len(com) < 3:
        return np.nan
    second = np.diff(low_pass(com, CUTOFF, fps), n=2, axis=0) * fps**2
    return float(np.sqrt(np.mean(np.sum(second**2, axis=1))))


def unexplained_force(model: mujoco.MjModel, qpos: Array, fps: float, support: Support) -> Array:
    """Return the force on the root (nframe,) that its support cannot give [body weights].

    ``mj_inverse`` of velocities without what is faster than 6 Hz, with all constraints off, says
    what wrench would have to act on the root. Of that the least is left that forces inside the
    friction cones at the standing points can leave: least squares of force and torque, in body
    weights and body weights times a metre. NaN in the first and the last frame.
    """
    left = np.full(len(qpos), np.nan)
    weight = float(model.body_subtreemass[model.jnt_bodyid[0]] * np.linalg.norm(model.opt.gravity))
    if len(qpos) < 3 or weight <= 0.0:
        return left
    wrench = _root_wrench(model, qpos, fps) / weight
    generators = _generators(support, qpos[:, :3])
    held = np.repeat(support.held, 2 * _EDGES, axis=1)
    rest = beyond_cone(generators[1:-1], wrench[1:-1], held[1:-1])
    left[1:-1] = np.linalg.norm(rest[:, :3], axis=1)
    return left


def unexplained_share(force: Array) -> float:
    """Return the share of frames with more force left than a tenth of the weight [percent]."""
    known = force[~np.isnan(force)]
    return float(100.0 * np.mean(known > UNEXPLAINED)) if len(known) else np.nan


def _root_wrench(model: mujoco.MjModel, qpos: Array, fps: float) -> Array:
    """Return force and torque about the root's origin (nframe, 6) in the world's axes [N, N m].

    NaN in the first and the last frame.
    """
    model = copy.copy(model)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    data = mujoco.MjData(model)
    velocity = np.empty((len(qpos) - 1, model.nv))
    for row, before, after in zip(velocity, qpos[:-1], qpos[1:], strict=True):
        mujoco.mj_differentiatePos(model, row, 1.0 / fps, before, after)
    velocity = low_pass(velocity, CUTOFF, fps)
    middle, change = (velocity[1:] + velocity[:-1]) / 2.0, np.diff(velocity, axis=0) * fps
    wrench, turn = np.full((len(qpos), 6), np.nan), np.empty(9)
    for row in range(1, len(qpos) - 1):  # MuJoCo takes one frame at a time
        data.qpos[:], data.qvel[:], data.qacc[:] = qpos[row], middle[row - 1], change[row - 1]
        mujoco.mj_inverse(model, data)
        mujoco.mju_quat2Mat(turn, data.qpos[3:7])
        wrench[row, :3] = data.qfrc_inverse[:3]
        wrench[row, 3:] = turn.reshape(3, 3) @ data.qfrc_inverse[3:6]
    return wrench


def _generators(support: Support, root: Array) -> Array:
    """Return unit forces along the edges of all cones (nframe, nsite * 2 * edges, 6), with torques.

    Torques are about ``root`` (nframe, 3) [m].
    """
    normal, along = support.normal, support.along
    side = np.cross(normal, along)
    lost = np.linalg.norm(side, axis=2, keepdims=True) < 1e-9
    side = np.where(lost, np.cross(normal, [1.0, 0.0, 0.0]), side)
    side /= np.linalg.norm(side, axis=2, keepdims=True)
    ahead = np.cross(side, normal)
    angle = 2.0 * np.pi * np.arange(_EDGES) / _EDGES
    round_about = (
        np.cos(angle)[:, None] * ahead[:, :, None] + np.sin(angle)[:, None] * side[:, :, None]
    )
    edge = normal[:, :, None] + support.friction[:, :, None, None] * round_about
    edge /= np.linalg.norm(edge, axis=3, keepdims=True)
    aside = HALF_WIDTH * np.array([-1.0, 1.0])[:, None] * side[:, :, None]
    point = support.place[:, :, None] + aside
    arm = (point - root[:, None, None])[:, :, :, None]
    force = np.broadcast_to(edge[:, :, None], (*edge.shape[:2], 2, _EDGES, 3))
    both = np.concatenate((force, np.cross(arm, force)), axis=4)
    return np.asarray(both.reshape(len(root), -1, 6))
