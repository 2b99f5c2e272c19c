"""A scene that stands still: everything in it that could move is fixed where it is.

spec = rest_spec(scene.spec, scene.name, keyframe="home")

A motion is of one character. What else can move (a box that lies free, a door on its hinge, a robot
that stands there, a cloth) is an obstacle at its rest pose or at that of a keyframe: its joints go,
and so does all that acts on them or measures them.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.joint_limits import LIMIT_PREFIX
from mjmotion.boundary.mjcf import MUJOCO_ERRORS
from mjmotion.exceptions import SceneError, mujoco_message, unknown_name
from mjmotion.numerics.rotations import conjugate, multiply, normalized, rotate
from mjmotion.scene.flexes import flexes_to_geoms
from mjmotion.scene.quiet import quiet

Array = NDArray[np.float64]

SAME_PLACE = 1e-9  # a body that a pose moves or turns by less stays as it is written [m, 1]
# Of what stands still, these act on nothing and measure nothing.
_IDLE = ("keys", "tuples", "sensors", "actuators", "equalities", "tendons", "pairs", "excludes")


def moves(model: mujoco.MjModel) -> bool:
    """Return whether anything of a scene can move: joints, mocap bodies, flexes."""
    return bool(model.njnt or model.nmocap or model.nflex)


def rest_spec(spec: mujoco.MjSpec, name: str, keyframe: str | None = None) -> mujoco.MjSpec:
    """Return a scene with everything fixed at its rest pose, or where a keyframe has it.

    Bodies keep their names and geoms. Flexes become geoms of the same shape. Geoms that collide by
    ``<contact><pair>`` alone are solid like others.

    Args:
      spec: the scene; it is not changed.
      name: of the scene, for errors.
      keyframe: name of one of the scene's keyframes; ``qpos0`` without.

    Raises:
      SceneError: there is no such keyframe, or what is left does not compile.
    """
    moving, resting = spec.copy(), spec.copy()
    for one in (moving, resting):
        one.compiler.fusestatic = False  # bodies of both models are then those of the spec
    model = _compiled(moving, name)
    data = mujoco.MjData(model)
    _pose(model, data, keyframe, name)
    flex = flexes_to_geoms(resting, model, data)
    _keep_pairs_solid(resting)
    _fix(resting)
    rest = _compiled(resting, name)
    if keyframe is not None:
        _put(resting, _placed(model, data, rest), rest)
    _drop_bare(resting, [model.body(body).name for body in flex])
    return resting


def drop_idle(spec: mujoco.MjSpec) -> None:
    """Delete from a scene that stands still what acts on joints, measures or tells of states.

    And numbers that would be taken for limits of the character's joints.
    """
    for kind in _IDLE:
        for element in list(getattr(spec, kind)):
            spec.delete(element)
    for numeric in [one for one in spec.numerics if one.name.startswith(LIMIT_PREFIX)]:
        spec.delete(numeric)


def _compiled(spec: mujoco.MjSpec, name: str) -> mujoco.MjModel:
    try:
        with quiet():
            return spec.compile()
    except MUJOCO_ERRORS as error:
        raise SceneError(f"scene '{name}' cannot stand still: {mujoco_message(error)}") from error


def _pose(model: mujoco.MjModel, data: mujoco.MjData, keyframe: str | None, name: str) -> None:
    """Put ``data`` at a keyframe, or leave it at rest, and find where everything is."""
    if keyframe is not None:
        key = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, keyframe)
        if key < 0:
            names = [model.key(index).name for index in range(model.nkey)]
            known = [one for one in names if one]
            raise SceneError(f"scene '{name}': {unknown_name('keyframe', keyframe, known)}")
        mujoco.mj_resetDataKeyframe(model, data, key)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)  # flexes need it
    mujoco.mj_flex(model, data)


def _keep_pairs_solid(spec: mujoco.MjSpec) -> None:
    """Let geoms collide that did so by a pair alone."""
    named = {name for pair in spec.pairs for name in (pair.geomname1, pair.geomname2)}
    for geom in spec.geoms:
        if geom.name in named and not (geom.contype or geom.conaffinity):
            geom.conaffinity = 1


def _fix(spec: mujoco.MjSpec) -> None:
    """Delete joints and what needs them."""
    drop_idle(spec)
    for joint in list(spec.joints):
        spec.delete(joint)
    for body in spec.bodies:
        body.mocap = False
        body.plugin.active = False  # such as a cable's, which bends joints


def _placed(
    model: mujoco.MjModel, data: mujoco.MjData, rest: mujoco.MjModel
) -> tuple[Array, Array]:
    """Return where each body of ``rest`` is to be: (nbody, 3) [m] and (nbody, 4) in the world.

    MuJoCo may turn and move a free body's own frame to its inertia's, which it does not where the
    joint is gone; what lies between the two frames is the same at rest and in the pose.
    """
    first, last = mujoco.MjData(model), mujoco.MjData(rest)
    mujoco.mj_kinematics(model, first)
    mujoco.mj_kinematics(rest, last)
    turn = multiply(conjugate(first.xquat), last.xquat)
    shift = rotate(conjugate(first.xquat), last.xpos - first.xpos)
    return data.xpos + rotate(data.xquat, shift), normalized(multiply(data.xquat, turn))


def _put(spec: mujoco.MjSpec, placed: tuple[Array, Array], rest: mujoco.MjModel) -> None:
    """Put the bodies of a scene that stands still at poses in the world."""
    position, turn = placed
    parent = rest.body_parentid
    back = conjugate(turn[parent])
    local_pos, local_turn = rotate(back, position - position[parent]), multiply(back, turn)
    # In a frame what is written is relative to that. What the pose adds to a body comes after
    # both: its own place here, further in its own axes.
    away = conjugate(rest.body_quat)
    add_pos, add_turn = rotate(away, local_pos - rest.body_pos), multiply(away, local_turn)
    moved = np.linalg.norm(add_pos, axis=1) + np.linalg.norm(add_turn[:, 1:], axis=1) > SAME_PLACE
    for body in spec.bodies:
        if not body.id or not moved[body.id]:
            continue
        written = _written_turn(body)
        body.pos = np.asarray(body.pos) + rotate(written, add_pos[body.id])
        body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
        body.quat = multiply(written, add_turn[body.id])


def _written_turn(body: Any) -> Array:
    """Return the (4,) orientation of a body as its file says it, whatever way that is."""
    if body.alt.type == mujoco.mjtOrientation.mjORIENTATION_QUAT:
        return normalized(np.array(body.quat, dtype=np.float64))
    compiler = body.compiler
    return np.array(
        mujoco.MjSpec.resolve_orientation(
            degree=bool(compiler.degree), sequence=compiler.eulerseq, orientation=body.alt
        ),
        dtype=np.float64,
    )


def _drop_bare(spec: mujoco.MjSpec, names: list[str]) -> None:
    """Delete those of the named bodies that hold nothing, such as the points of a flex."""
    wanted = {name for name in names if name}
    kinds = ("bodies", "geoms", "sites", "cameras", "lights")
    for body in list(spec.bodies):
        if body.name in wanted and not any(getattr(body, kind) for kind in kinds):
            spec.delete(body)
