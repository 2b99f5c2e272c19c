"""Joint angles on another body: what a motion is there before anything is fitted.

guess = copy_joints(motion, character)        # the root where it was
guess = carry_root(motion, guess, about)  # the hips as high as the longer legs hold them
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.character import Character, CharacterLike
from mjmotion.body.joint_coupling import CoupledJoints
from mjmotion.body.kinematics import body_pose
from mjmotion.body.motion import Motion
from mjmotion.exceptions import ModelError
from mjmotion.numerics.rotations import conjugate, exp, log, multiply, rotate

Array = NDArray[np.float64]

_BALL = int(mujoco.mjtJoint.mjJNT_BALL)
_HINGE = int(mujoco.mjtJoint.mjJNT_HINGE)
_WIDTH = {_BALL: 4, _HINGE: 1, int(mujoco.mjtJoint.mjJNT_SLIDE): 1}
_ALIKE = 1e-3  # how far bodies may be turned differently at qpos0 for angles to mean the same [rad]


def copy_joints(motion: Motion, character: CharacterLike) -> Motion:
    """Return a motion with its joint angles on another model, joint by joint of the same name.

    A spine in one piece turns one in several by their shares (§4.2), and the turns of one in
    several add up on one in one piece. Joints that only the other model has stay at rest. The root
    keeps its place.

    Args:
      motion: the motion.
      character: the other body, alone or in a scene.

    Raises:
      ModelError: legs or trunk of the other model hang on joints that the motion does not have, or
        that turn about other axes.
    """
    character = Character.of(character)
    source, model = motion.model, character.model
    qpos = np.tile(model.qpos0, (motion.nframe, 1))
    qpos[:, :7] = motion.qpos[:, :7]
    ids = {source.joint(joint).name: joint for joint in range(source.njnt)}
    groups = {group.name: group for group in motion.character.coupling.groups}
    lacking = []
    for group in character.coupling.groups:
        turn = _group_turn(motion, group, ids, groups)
        if turn is None:
            lacking += [model.joint(joint).name for joint in group.joints]
            continue
        for joint, share in zip(group.joints, group.shares, strict=True):
            _put(model, qpos, joint, exp(share * turn) if turn.shape[1] == 3 else share * turn)
    coupled = {joint for group in character.coupling.groups for joint in group.joints}
    for joint in range(1, model.njnt):
        name, kind = model.joint(joint).name, int(model.jnt_type[joint])
        if joint in coupled:
            continue
        if name in ids and int(source.jnt_type[ids[name]]) == kind:
            _check_axes(source, ids[name], model, joint)
            start = source.jnt_qposadr[ids[name]]
            _put(model, qpos, joint, motion.qpos[:, start : start + _WIDTH[kind]])
        elif name in groups and kind == _BALL:
            _put(model, qpos, joint, _total_turn(motion, groups[name]))
        else:
            lacking.append(name)
    _check_lacking(character, lacking)
    return Motion(character, qpos, motion.fps)


def same_joints(character: Character, other: Character) -> bool:
    """Return whether angles of one's joints can be copied to another: :func:`copy_joints`."""
    try:
        copy_joints(Motion(character, character.model.qpos0[None], 1.0), other)
    except ModelError:
        return False
    return True


def carry_root(motion: Motion, guess: Motion, about: Array, scale: float, support: Array) -> Motion:
    """Return copied joint angles with the root where the other legs would carry it.

    The hips are as much higher over their support as they are when standing, and go ``scale`` times
    as far in the plane.

    Args:
      motion: the motion on its own body.
      guess: the same, its joint angles copied on another.
      about: (3,) the point of the ground about which the plane is scaled [m].
      scale: factor on the root's path in the plane.
      support: (nframe,) heights of what the body stands on [m].
    """
    rise = leg_ratio(motion.character, guess.character)
    hips = mid_hips(motion)
    wanted = np.empty_like(hips)
    wanted[:, :2] = about[:2] + scale * (hips[:, :2] - about[:2])
    wanted[:, 2] = support + rise * (hips[:, 2] - support)
    qpos = np.array(guess.qpos)
    qpos[:, :3] += wanted - mid_hips(guess)
    return guess.replace(qpos)


def leg_ratio(character: Character, other: Character) -> float:
    """Return how much longer the legs of another body are: hips over soles, when standing."""
    return other.parts.hip_height / character.parts.hip_height


def mid_hips(motion: Motion) -> Array:
    """Return the middle of the hips at every frame (nframe, 3) [m]."""
    model = motion.model
    parts = motion.character.parts
    base = int(model.body_parentid[parts.legs[0].top])
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    local = data.xmat[base].reshape(3, 3).T @ (parts.spine[0] - data.xpos[base])
    position, quat = body_pose(model, motion.qpos, base)
    return np.asarray(position + rotate(quat, local))


def _put(model: mujoco.MjModel, qpos: Array, joint: int, values: Array) -> None:
    start = model.jnt_qposadr[joint]
    qpos[:, start : start + values.shape[1]] = values


def _group_turn(
    motion: Motion, group: CoupledJoints, ids: dict[str, int], groups: dict[str, CoupledJoints]
) -> Array | None:
    """Return the turn w (nframe, 3) or (nframe, 1) [rad] for a group of coupled joints."""
    if group.name in groups:
        return motion.character.coupling.shared_turn(groups[group.name], motion.qpos)
    joint = ids.get(group.name)
    if joint is None or int(motion.model.jnt_type[joint]) not in (_BALL, _HINGE):
        return None
    start = motion.model.jnt_qposadr[joint]
    if motion.model.jnt_type[joint] == _BALL:
        return log(motion.qpos[:, start : start + 4])
    return motion.qpos[:, start : start + 1]


def _total_turn(motion: Motion, group: CoupledJoints) -> Array:
    """Return what a group's balls turn one after the other (nframe, 4), from the lowest up."""
    total = None
    for joint in group.joints:
        start = motion.model.jnt_qposadr[joint]
        turn = motion.qpos[:, start : start + 4]
        total = turn if total is None else multiply(total, turn)
    assert total is not None
    return total


def _check_axes(source: mujoco.MjModel, theirs: int, model: mujoco.MjModel, mine: int) -> None:
    """Raise ModelError where a joint of the same name turns its body about other axes at rest."""
    frames = []
    for one, joint in ((source, theirs), (model, mine)):
        data = mujoco.MjData(one)
        mujoco.mj_kinematics(one, data)
        if one.jnt_type[joint] == _BALL:
            frames.append(data.xquat[one.jnt_bodyid[joint]])
        else:
            frames.append(data.xaxis[joint])
    apart = (
        2 * np.arcsin(np.clip(np.linalg.norm(multiply(conjugate(frames[0]), frames[1])[1:]), 0, 1))
        if len(frames[0]) == 4
        else np.linalg.norm(frames[0] - frames[1])
    )
    if apart > _ALIKE:
        raise ModelError(
            f"joint '{model.joint(mine).name}' turns about other axes in the two models, so its"
            " angles cannot be copied: give a model of ours, or one made from it"
        )


def _check_lacking(character: Character, lacking: list[str]) -> None:
    """Raise ModelError where legs, arms or trunk hang on joints that the motion does not have."""
    model, parts = character.model, character.parts
    bodies = {b for limb in (*parts.legs, *parts.arms) for b in limb.bodies} | set(parts.trunk)
    needed = [name for name in lacking if int(model.joint(name).bodyid[0]) in bodies]
    if needed:
        shown = ", ".join(needed[:4]) + (", …" if len(needed) > 4 else "")
        raise ModelError(
            f"the motion has no joints {shown} of the other model ({len(needed)} of"
            f" {model.njnt - 1}): retarget to a model of ours, or to one made from it"
        )


__all__ = ["carry_root", "copy_joints", "leg_ratio", "mid_hips", "same_joints"]
