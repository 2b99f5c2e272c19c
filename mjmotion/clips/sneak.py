"""The built-in sneaking: crouched, on its toes first, one careful high step after the other.

    motion = make_sneak("humanoid")                    # three strides at 30 fps
    motion = make_sneak("humanoid", strides=2.5, stride=0.7, speed=0.4, fps=120)

It is made as the built-in walk is (:mod:`mjmotion.clips.gait`), from figures of its own: the knees
never come out of the crouch, so the pelvis is as low as that asks; a foot is lifted high, carried
forward slowly and put down with its toes first; the body leans over the foot it stands on, the
hands are held before it and the face looks ahead.
"""

from __future__ import annotations

from functools import partial

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.character import Character, CharacterLike
from mjmotion.body.limbs import Limbs
from mjmotion.body.motion import Motion
from mjmotion.clips.gait import JOINTS, check_humanoid
from mjmotion.clips.gait_feet import Roll, Swing, both_feet, foot_shape, swing_shares, toe_bends
from mjmotion.clips.gait_legs import (
    SIDES,
    close_legs,
    leg_of,
    pelvis_height,
    room_to_rise,
    with_toes,
)
from mjmotion.clips.gait_plan import Segment, WalkPath, plan_path, plan_steps
from mjmotion.clips.gait_table import GaitTable
from mjmotion.exceptions import ClipError
from mjmotion.numerics.rotations import exp, log, multiply, yaw_quat
from mjmotion.numerics.smoothing import ease

Array = NDArray[np.float64]

SPEED = 0.52  # [m/s]
STRIDE = 0.84  # [m]
STRIDES = 3.0
KNEE = np.deg2rad(66.0)  # a knee is never straighter
ROLL = Roll(
    flat=0.14,
    heel_off=0.38,
    toe_off=0.56,
    strike=np.deg2rad(-12.0),
    push=np.deg2rad(38.0),
    clearance=0.06,
)
HIGH = 0.15  # how high a foot is carried [m]

_WIDTHS = (0.15, 0.13)  # of the stance, standing and sneaking [m]
_TOE_OUT = np.deg2rad(8.0)
_MIDDLE = 0.33  # phase at which the pelvis passes over the foot: the bent trunk is ahead of it
_NEAR = 58  # the pelvis keeps its height for this long about its lowest [0.01 cycles]
_CARRIED = (0.06, 0.80)  # shares of a swing between which the foot goes forward
_POINT = 0.12  # how far the toes hang in mid-swing [rad]
_HALF = 0.29  # phase at which the left foot carries all the weight


def _wave(mean: float, size: float = 0.0, peak: float = 0.0, times: int = 1) -> list[float]:
    """Return one row of a gait table: a mean, and a swing that is highest at phase ``peak``."""
    row = [mean, 0.0, 0.0, 0.0, 0.0]
    angle = 2.0 * np.pi * times * peak
    row[2 * times - 1 : 2 * times + 1] = size * np.cos(angle), size * np.sin(angle)
    return row


def _table() -> GaitTable:
    """Return the swings of root, trunk and left limbs, in the axes of the built-in walk's table."""
    # Palms to the ground, hands hanging a little from the wrists.
    hand = log(multiply(exp(np.array((0.0, 0.45, 0.0))), exp(np.array((0.0, 0.0, -1.1)))))
    channels = {
        # Forward: the body waits while a foot is lifted and goes as it is put down.
        "root_position": [
            _wave(0.0, 0.014, 0.02, 2),
            _wave(0.0, 0.035, _HALF),
            _wave(0.0, 0.011, _HALF, 2),
        ],
        "root_rotation": [
            _wave(0.0, 0.05, _HALF),
            _wave(0.30, 0.02, 0.05, 2),
            _wave(0.0, 0.10, 0.5),
        ],
        "spine": [
            _wave(0.0, 0.05, _HALF + 0.5),
            _wave(0.42, 0.03, 0.10, 2),
            _wave(0.0, 0.16, 0.02),
        ],
        "neck": [_wave(0.0, 0.02, _HALF), _wave(-0.32, 0.02, 0.35, 2), _wave(0.0, 0.06, 0.45)],
        "head": [_wave(0.0), _wave(-0.22, 0.02, 0.35, 2), _wave(0.0, 0.10, 0.40)],
        "left_shoulder": [_wave(0.42, 0.04, 0.3), _wave(-0.98, 0.17, 0.03), _wave(0.10)],
        "left_elbow": [_wave(1.42, 0.12, 0.60)],
        "left_wrist": [_wave(float(value)) for value in hand],
        "left_hip": [_wave(0.02), _wave(-1.0), _wave(0.16)],
        "left_knee": [_wave(1.2)],
        "left_ankle": [_wave(0.0), _wave(-0.2), _wave(0.0)],
    }
    return GaitTable({name: np.array(rows) for name, rows in channels.items()})


def make_sneak(
    character: CharacterLike,
    *,
    strides: float = STRIDES,
    stride: float = STRIDE,
    speed: float = SPEED,
    fps: float = 30.0,
) -> Motion:
    """Return sneaking on level ground z = 0 along +x, from a touch of the left foot on.

    Args:
      character: the humanoid, with or without a scene, or what names it.
      strides: how long, in strides of two steps, a multiple of one half.
      stride: length of a stride [m].
      speed: [m/s]; a stride takes ``stride / speed`` [s].
      fps: frames a second.

    Raises:
      ModelError: the model is not the humanoid: joints, sites or limbs are missing.
      ClipError: a length, a speed or a rate that makes no sneaking.
    """
    character = Character.of(character)
    check_humanoid(character.model)
    for name, value, low, high in (
        ("stride", stride, 0.3, 1.1),
        ("speed", speed, 0.15, 1.0),
        ("seconds a stride", stride / max(speed, 1e-6), 1.0, 4.0),
        ("fps", fps, 1.0, 1e5),
    ):
        if not low <= value <= high:
            raise ClipError(f"sneak: {name} is {value:.3g}: give {low} to {high}")
    path = plan_path((Segment("straight", strides),), stride, speed, 0.0)
    times = np.arange(max(1, round(strides * stride / speed * fps))) / fps
    return Motion(character, _poses(character, path, path.phase(times), stride), fps)


def _poses(character: Character, path: WalkPath, psi: Array, stride: float) -> Array:
    """Return qpos (n, nq) at phases (n,)."""
    table = _table()
    model = character.model
    legs = Limbs(model, [leg_of(character, side) for side in SIDES])
    shapes = [foot_shape(character, side) for side in SIDES]
    steps = [plan_steps(path, side, _WIDTHS, _TOE_OUT, _MIDDLE) for side in SIDES]
    roll = ROLL
    feet = partial(both_feet, steps, shapes, _swing(stride), roll=roll)
    grid = path.psi[::2]
    room = room_to_rise(legs, _body(model, table, path, grid), feet(grid), KNEE)
    qpos = _body(model, table, path, psi)
    qpos[:, 2] += pelvis_height(grid, room, psi, _NEAR)
    placed = feet(psi)
    qpos = close_legs(legs, qpos, placed)
    return with_toes(character, qpos, toe_bends(steps, psi, placed[1], roll))


def _body(model: mujoco.MjModel, table: GaitTable, path: WalkPath, psi: Array) -> Array:
    """Return qpos (n, nq) by path and table; the root's height is 0."""
    place, heading, _ = path.at(psi)
    qpos = np.tile(model.qpos0, (len(psi), 1))
    along, side, up = table.swing("root_position", psi).T
    qpos[:, 0] = place[:, 0] + along * np.cos(heading) - side * np.sin(heading)
    qpos[:, 1] = place[:, 1] + along * np.sin(heading) + side * np.cos(heading)
    qpos[:, 2] = up
    turn = table.mean("root_rotation") + table.swing("root_rotation", psi)
    qpos[:, 3:7] = multiply(yaw_quat(heading), exp(turn))
    for name in JOINTS:
        address = int(model.joint(name).qposadr[0])
        values = table.mean(name) + table.swing(name, psi)
        if values.shape[1] == 1:
            qpos[:, address] = values[:, 0]
        else:
            qpos[:, address : address + 4] = exp(values)
    return qpos


def _swing(stride: float) -> Swing:
    """Return a careful step: up, forward, and slowly down."""
    u = swing_shares()
    first, last = _CARRIED
    gone = ease((u - first) / (last - first))
    inside = np.clip(u, 0.0, 1.0)
    hump = (4.0 * inside * (1.0 - inside)) ** 2
    return Swing(u, np.column_stack((gone, HIGH * hump, _POINT * hump)), stride)
