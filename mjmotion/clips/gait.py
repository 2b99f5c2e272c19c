"""The built-in walk: made from a table of Fourier coefficients, with no recording at hand.

    motion = make_walk("humanoid")                             # the paper's 464 frames at 30 fps
    motion = make_walk("humanoid", segments=[Segment("straight", 4)], speed=1.0, fps=120)

The body follows a path; root and joints swing about their means by the table
(:mod:`mjmotion.clips.gait_table`), less at lower speed, so that a walk begins and ends in quiet
standing. The feet have their own plan: they come down under the path and stay there, and the legs
are closed on them (Eq. 7), so that nothing skates.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.character import Character, CharacterLike
from mjmotion.body.kinematics import Kinematics
from mjmotion.body.limbs import Limbs
from mjmotion.body.motion import Motion
from mjmotion.clips.gait_feet import (
    TOE_OFF,
    Roll,
    Swing,
    both_feet,
    find_swing,
    foot_shape,
    swing_phases,
    toe_bends,
)
from mjmotion.clips.gait_legs import (
    SIDES,
    close_legs,
    leg_of,
    pelvis_height,
    room_to_rise,
    with_toes,
)
from mjmotion.clips.gait_plan import Segment, WalkPath, plan_path, plan_steps
from mjmotion.clips.gait_table import GaitTable, gait_table
from mjmotion.exceptions import ClipError, ModelError
from mjmotion.numerics.rotations import exp, multiply, rotate, yaw_quat
from mjmotion.numerics.smoothing import ease

Array = NDArray[np.float64]

SPEED = 1.22  # [m/s]
STRIDE = 1.36  # [m]
TURNING = 0.35  # [rad/s]
FRAMES = 464  # of the paper's clip, at 30 fps

WALK = (
    Segment("start"),
    Segment("straight", 4.0),
    Segment("turn_left", 2.0),
    Segment("straight", 1.0),
    Segment("turn_right", 2.0),
    Segment("straight", 1.0),
    Segment("stop"),
)

_CENTRE = ("spine", "neck", "head")
_LIMB = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
_HINGES = ("elbow", "knee")
JOINTS = _CENTRE + tuple(f"{side}_{part}" for side in SIDES for part in _LIMB)

_WIDTHS = (0.17, 0.12)  # of the stance, standing and walking [m]
_TOE_OUT = np.deg2rad(6.0)
_KNEE = np.deg2rad(5.0)  # a knee is never straighter
_STAND_ELBOW = 0.30  # [rad]
_HAND = 0.4  # share of the mean wrist: recorded hands are as askew as their markers
# The recorded people bend their knees more in stance than this walk; with straighter legs the
# pelvis is lowest a little earlier.
_BOB_EARLY = 0.05  # [cycles]
_BOB = 1.6  # the mean over strides and people flattens what each of them does
_NEAR = 40  # the pelvis keeps its height for this long about its lowest [0.01 cycles]
_STAND = (1.0, 0.9)  # quiet standing before a start and after a stop [s]
_STAND_LONGER = 0.93  # the latter of the clip that only stops [s]
_GRAVITY = 9.81
_LEAN = (0.25, 0.35)  # shares of the lean into a turn that pelvis and spine take
_LOOK_AHEAD = 0.45  # how far ahead the head looks into a turn [cycles]
_LOOK = (0.15, 0.35, 0.3)  # shares of that turn of spine, neck and head


def make_walk(  # more than eight parameters: all but the first have a default
    character: CharacterLike,
    *,
    segments: Sequence[Segment] = WALK,
    stride: float = STRIDE,
    speed: float = SPEED,
    turning: float = TURNING,
    duty: float = TOE_OFF,
    stand: tuple[float, float] = _STAND,
    seconds: float | None = None,
    fps: float = 30.0,
) -> Motion:
    """Return a walk on level ground z = 0, beginning at the origin along +x.

    Args:
      character: the humanoid, with or without a scene, or what names it.
      segments: the parts of the walk, in order.
      stride: length of a stride, two steps, at walking speed [m].
      speed: walking speed [m/s]; the cadence is ``speed / stride`` strides a second.
      turning: mean rate of turning within the turns [rad/s].
      duty: share of a stride that a foot stands; at 0.5 a walk becomes a run.
      stand: quiet standing before a start and after a stop [s].
      seconds: length of the whole motion; with a stop at the end, the standing after it is made as
        long as that takes. Without, as long as segments and standing take.
      fps: frames a second. The motion is the same at any, only sampled finer.

    Raises:
      ModelError: the model is not the humanoid: joints, sites or limbs are missing.
      ClipError: segments, stride, speed, duty or time that make no walk.
    """
    character = Character.of(character)
    check_humanoid(character.model)
    for name, value, low, high in (
        ("stride", stride, 0.5, 1.9),
        ("speed", speed, 0.3, 2.2),
        ("turning", turning, 0.0, 1.2),
        ("strides a second", speed / max(stride, 1e-6), 0.5, 1.4),
        ("duty", duty, 0.55, 0.68),
        ("fps", fps, 1.0, 1e5),
    ):
        if not low <= value <= high:
            raise ClipError(f"walk: {name} is {value:.3g}: give {low} to {high}")
    path = plan_path(segments, stride, speed, turning)
    before = stand[0] if path.starts else 0.0
    after = stand[1] if path.stops else 0.0
    ends = float(np.interp(path.end, path.psi, path.time))
    total = before + ends + after if seconds is None else seconds
    if total < before + ends:
        raise ClipError(f"walk: the segments take {before + ends:.2f} s, not {total:.2f}")
    times = np.arange(max(1, round(total * fps))) / fps - before
    return Motion(character, _poses(character, path, path.phase(times), stride, duty), fps)


def check_humanoid(model: mujoco.MjModel) -> None:
    """Raise ModelError unless a model has the joints and sites of the humanoid."""
    names = {model.joint(i).name for i in range(model.njnt)}
    missing = [name for name in JOINTS if name not in names]
    if missing:
        raise ModelError(
            "the built-in walk needs the humanoid:"
            f" this model lacks the joints {', '.join(missing)}; put a walk on it with retarget"
        )
    sites = {model.site(i).name for i in range(model.nsite)}
    needed = [f"{side}_{part}" for side in SIDES for part in ("heel", "toe")]
    missing = [name for name in needed if name not in sites]
    if missing:
        raise ModelError(
            f"the built-in walk needs the humanoid: this model lacks the sites {', '.join(missing)}"
        )


def _poses(character: Character, path: WalkPath, psi: Array, stride: float, duty: float) -> Array:
    """Return qpos (n, nq) at phases (n,)."""
    table = gait_table()
    model = character.model
    legs = Limbs(model, [leg_of(character, side) for side in SIDES])
    shapes = [foot_shape(character, side) for side in SIDES]
    swing = _table_swing(model, table)
    scale = min(stride / STRIDE, 1.2)
    steps = [plan_steps(path, side, _WIDTHS, _TOE_OUT) for side in SIDES]
    roll = Roll(toe_off=duty)
    feet = partial(both_feet, steps, shapes, swing, roll=roll)
    # How high the pelvis can be is found on a grid of its own, so that no frame rate changes it.
    grid = path.psi[::2]
    body = _body(model, table, path, grid, scale)
    room = room_to_rise(legs, body, feet(grid), _KNEE)
    qpos = _body(model, table, path, psi, scale)
    qpos[:, 2] += pelvis_height(grid, room, np.clip(psi, grid[0], grid[-1]), _NEAR)
    placed = feet(psi)
    qpos = close_legs(legs, qpos, placed)
    return with_toes(character, qpos, toe_bends(steps, psi, placed[1], roll))


def _body(
    model: mujoco.MjModel, table: GaitTable, path: WalkPath, psi: Array, scale: float
) -> Array:
    """Return qpos (n, nq) by path and table; the root's height is only its bob."""
    place, heading, pace = path.at(psi)
    swing = np.clip(pace, 0.0, 1.0) * scale
    qpos = np.tile(model.qpos0, (len(psi), 1))
    # Weight goes over to the standing foot before the first step, and back after the last.
    shift = np.ones_like(psi)
    if path.starts:
        shift = shift * ease((psi + 0.38) / 0.5)
    if path.stops:
        shift = shift * ease((path.end + 0.22 - psi) / 0.5)
    along, side, _ = table.swing("root_position", psi).T
    up = table.swing("root_position", psi + _BOB_EARLY)[:, 2]
    along = along * swing
    side = side * shift * np.sqrt(scale)
    qpos[:, 0] = place[:, 0] + along * np.cos(heading) - side * np.sin(heading)
    qpos[:, 1] = place[:, 1] + along * np.sin(heading) + side * np.cos(heading)
    qpos[:, 2] = up * swing * _BOB
    # Into the turn: what a pendulum under the sideways acceleration would lean.
    velocity = np.gradient(path.position, path.time, axis=0)
    pull = np.gradient(path.heading, path.time) * np.linalg.norm(velocity, axis=1)
    lean = -np.arctan(np.interp(psi, path.psi, pull) / _GRAVITY)
    ahead = path.at(psi + _LOOK_AHEAD)[1] - heading
    turn = table.mean("root_rotation") + table.swing("root_rotation", psi) * swing[:, None]
    turn[:, 0] += _LEAN[0] * lean
    qpos[:, 3:7] = multiply(yaw_quat(heading), exp(turn))
    for name in JOINTS:
        address = int(model.joint(name).qposadr[0])
        mean, values = table.mean(name), table.swing(name, psi) * swing[:, None]
        if name.endswith("elbow"):
            mean = _STAND_ELBOW + (mean - _STAND_ELBOW) * swing[:, None]
        values = mean + values
        if name.endswith("wrist"):
            values = values - (1.0 - _HAND) * mean
        if name == "spine":
            values[:, 0] += _LEAN[1] * lean
        if name in _CENTRE:
            values[:, 2] += _LOOK[_CENTRE.index(name)] * ahead
        if name.endswith(_HINGES):
            qpos[:, address] = np.clip(values[:, 0], 0.0, None)
        else:
            qpos[:, address : address + 4] = exp(values)
    return qpos


def _table_swing(model: mujoco.MjModel, table: GaitTable) -> Swing:
    """Return what the table's left foot does in its swing, on a straight walk."""
    psi = swing_phases()
    qpos = np.tile(model.qpos0, (len(psi), 1))
    position = table.mean("root_position") + table.swing("root_position", psi)
    position[:, 0] += psi * STRIDE
    qpos[:, :3] = position
    qpos[:, 3:7] = exp(table.mean("root_rotation") + table.swing("root_rotation", psi))
    for part in ("hip", "knee", "ankle"):
        name = f"left_{part}"
        address = int(model.joint(name).qposadr[0])
        values = table.mean(name) + table.swing(name, psi)
        if part == "knee":
            qpos[:, address] = values[:, 0]
        else:
            qpos[:, address : address + 4] = exp(values)
    pose = Kinematics(model, len(psi)).forward(qpos)
    foot = int(model.joint("left_ankle").bodyid[0])
    toe = rotate(pose.xquat[:, foot], np.array((1.0, 0.0, 0.0)))
    ankle = pose.xpos[:, foot]
    return find_swing(ankle[:, 0], ankle[:, 2], np.arcsin(-toe[:, 2]))


def _walk(character: Character) -> Motion:
    return make_walk(character, seconds=FRAMES / 30.0)


def _part(
    segments: Sequence[Segment], character: Character, *, stand: tuple[float, float] = _STAND
) -> Motion:
    return make_walk(character, segments=segments, stand=stand)


def _turn(kind: str) -> tuple[Segment, ...]:
    """Return a turn with a stride before and after it, in which clips are joined."""
    return (Segment("straight", 1.0), Segment(kind, 2.0), Segment("straight", 1.0))


# Start, straight, turns and stop, joined in this order, make the paper's 464 frames.
BUILTIN: dict[str, Callable[[Character], Motion]] = {
    "walk": _walk,
    "start": partial(_part, (Segment("start"), Segment("straight", 2.0))),
    "straight": partial(_part, (Segment("straight", 3.0),)),
    "turn_left": partial(_part, _turn("turn_left")),
    "turn_right": partial(_part, _turn("turn_right")),
    "stop": partial(
        _part, (Segment("straight", 1.0), Segment("stop")), stand=(_STAND[0], _STAND_LONGER)
    ),
}
