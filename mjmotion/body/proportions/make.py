"""From a humanoid and proportions to a spec that stands on its soles."""

from __future__ import annotations

import contextlib
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.character import Character, CharacterLike, read_spec
from mjmotion.body.geom_points import geom_points
from mjmotion.body.kinematics import check_free_root
from mjmotion.body.proportions.frames import BodyFrame
from mjmotion.body.proportions.proportions import Proportions
from mjmotion.body.proportions.scaling import Scaling
from mjmotion.boundary.mjcf import MUJOCO_ERRORS
from mjmotion.exceptions import ModelError, mujoco_message

Array = NDArray[np.float64]


def make_character(source: CharacterLike, proportions: Proportions | None = None) -> Character:
    """Return a humanoid of other proportions.

    Args:
      source: a character, or what names one; it is not changed.
      proportions: the factors; all 1 without.

    Raises:
      ModelError: no such model, it does not compile, has no free root, no limbs, or lacks a part
        that is to be scaled.
    """
    proportions = Proportions() if proportions is None else proportions
    spec = _spec_of(source)
    name = spec.modelname or "the model"
    before = _compile(spec, name)
    check_free_root(before)
    total = _without_total(spec)
    try:
        Scaling(spec, proportions)()
        after = _compile(spec, name)
        _put_on_ground(spec, before, after)
        if total is not None:
            spec.compiler.settotalmass = total * _mass(spec) / _mass(_untouched(source))
        _scale_tendons(spec, before, after)
        return Character(_compile(spec, name), spec, proportions.named(name))
    except MUJOCO_ERRORS as error:
        raise ModelError(
            f"'{name}' cannot be given these proportions: {mujoco_message(error)}"
        ) from error


def _spec_of(source: CharacterLike) -> mujoco.MjSpec:
    """Return the spec of a character, or of what names one; always a new one."""
    if isinstance(source, str | Path | mujoco.MjSpec):
        return read_spec(source)[0]
    return Character.of(source).spec.copy()


def _compile(spec: mujoco.MjSpec, name: str) -> mujoco.MjModel:
    try:
        return spec.compile()
    except MUJOCO_ERRORS as error:
        raise ModelError(f"model '{name}' does not compile: {mujoco_message(error)}") from error


def _without_total(spec: mujoco.MjSpec) -> float | None:
    """Take the compiler's demand for a total mass off a spec; return it."""
    total = float(spec.compiler.settotalmass)
    if total <= 0:
        return None
    spec.compiler.settotalmass = -1.0
    return total


def _untouched(source: CharacterLike) -> mujoco.MjSpec:
    spec = _spec_of(source)
    _without_total(spec)
    return spec


def _mass(spec: mujoco.MjSpec) -> float:
    model = spec.compile()
    return float(model.body_subtreemass[model.jnt_bodyid[0]])


def _lowest(model: mujoco.MjModel, qpos: Array) -> float:
    """Height of the lowest point of the character's colliding geoms in a pose [m]."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    root = model.jnt_bodyid[0]
    own = model.body_rootid[model.geom_bodyid] == model.body_rootid[root]
    solid = own & ((model.geom_contype > 0) | (model.geom_conaffinity > 0))
    heights = [
        data.geom_xpos[geom, 2]
        + geom_points(model, int(geom)) @ data.geom_xmat[geom].reshape(3, 3)[2]
        for geom in np.flatnonzero(solid if solid.any() else own)
    ]
    return float(np.concatenate(heights).min()) if heights else float(data.xpos[root, 2])


def _put_on_ground(spec: mujoco.MjSpec, before: mujoco.MjModel, after: mujoco.MjModel) -> None:
    """Raise or lower the root, at ``qpos0`` and in every keyframe, to where it stood before."""
    root = next(body for body in spec.bodies if body.id == after.jnt_bodyid[0])
    rise = _lowest(before, before.qpos0) - _lowest(after, after.qpos0)
    up = np.array((0.0, 0.0, rise))
    frame = BodyFrame(root)
    root.pos = frame.from_body(frame.to_body(root.pos) + up)
    slides = np.flatnonzero(before.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE)
    for key in spec.keys:
        old = np.array(key.qpos)
        if len(old) != before.nq:
            continue
        new = old.copy()
        for joint in slides:
            adr, span = before.jnt_qposadr[joint], before.jnt_range[joint]
            if np.ptp(span) > 0:
                new[adr] *= float(np.ptp(after.jnt_range[joint]) / np.ptp(span))
        new[2] += _lowest(before, old) - _lowest(after, new)
        key.qpos = new


def _scale_tendons(spec: mujoco.MjSpec, before: mujoco.MjModel, after: mujoco.MjModel) -> None:
    """Lengths that are written down for spatial tendons grow as the tendons do."""
    for index, tendon in enumerate(spec.tendons):
        path = before.wrap_type[before.tendon_adr[index]]
        if path == mujoco.mjtWrap.mjWRAP_JOINT:
            continue
        factor = float(after.tendon_length0[index] / max(before.tendon_length0[index], 1e-9))
        tendon.range = np.array(tendon.range) * factor
        with contextlib.suppress(TypeError, ValueError):
            lengths = np.array(tendon.springlength)
            tendon.springlength = np.where(lengths > 0, lengths * factor, lengths)


__all__ = ["make_character"]
