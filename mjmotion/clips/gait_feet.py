"""The feet of the built-in walk: planted in stance, rolling over heel and toe, swung in between.

A foot strikes with its heel and turns about it until it is flat; from heel-off on it turns about
its toe. The swing joins toe-off and the next heel strike with the same speed and acceleration, and
in between does what the table's legs do.
"""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.clips.gait_plan import Steps, ease
from mjmotion.clips.gait_table import GaitTable

Array = NDArray[np.float64]

STRIKE = np.deg2rad(19.0)  # toes up at heel strike of a full stride
PUSH = np.deg2rad(52.0)  # heel up at its steepest
LEAST_PUSH = 0.45  # share of that even for the smallest step
_EARLY = 0.03  # how long before the heel strike the toes begin to fall [cycles]
_HIGHEST = 0.68  # when the foot is steepest, soon after toe-off [cycles]
_STEP = 1e-3  # of the numeric derivatives [cycles]
_BUMP = 96  # samples of a swing's shape


@dataclasses.dataclass(frozen=True, eq=False)
class FootShape:
    """A foot, in its own frame with the ankle at the origin: heel and toe (x, z) [m]."""

    heel: Array
    toe: Array


def foot_shape(model: mujoco.MjModel, side: str) -> FootShape:
    """Return heel and toe of a foot from the model's sites."""
    heel, toe = (model.site(f"{side}_{part}").pos[[0, 2]] for part in ("heel", "toe"))
    return FootShape(np.array(heel), np.array(toe))


def stance(steps: Steps, index: Array, psi: Array, table: GaitTable, shape: FootShape) -> Array:
    """Return the foot in stances.

    Args:
      steps: the stances of this foot.
      index: (n,) which stance.
      psi: (n,) phases; those a little outside of the stance continue its rolling.
      table: phases of a stance.
      shape: the foot.

    Returns:
      (n, 5): ankle x, y, z [m], pitch (toes down positive) and yaw [rad].
    """
    index = np.asarray(index, dtype=np.int64)
    phase = psi - steps.strike[index]
    standing_in = (index == 0) & steps.first
    standing_out = (index == len(steps.strike) - 1) & steps.last
    early = 1.0 - ease((phase + _EARLY) / (table.foot_flat + _EARLY))
    landing = np.where(standing_in, 0.0, STRIKE * steps.landing[index] * early)
    late = ease((phase - table.heel_off) / (_HIGHEST - table.heel_off))
    share = LEAST_PUSH + (1.0 - LEAST_PUSH) * steps.leaving[index]
    push = np.where(standing_out, 0.0, PUSH * share * late)
    pitch = push - landing
    pivot = np.where((phase < 0.5 * (table.foot_flat + table.heel_off))[:, None], shape.heel, shape.toe)
    # The pivot stays; turned by pitch about y, (x, z) goes to (x cos + z sin, z cos - x sin).
    cosine, sine = np.cos(pitch), np.sin(pitch)
    along = pivot[:, 0] - (pivot[:, 0] * cosine + pivot[:, 1] * sine)
    up = -(pivot[:, 1] * cosine - pivot[:, 0] * sine)
    yaw = steps.yaw[index]
    x = steps.position[index, 0] + along * np.cos(yaw)
    y = steps.position[index, 1] + along * np.sin(yaw)
    return np.column_stack((x, y, up, pitch, yaw))


def foot_motion(
    steps: Steps, psi: Array, table: GaitTable, shape: FootShape, bump: SwingShape
) -> Array:
    """Return the foot (n, 5) at phases (n,), as :func:`stance` does."""
    index = np.clip(np.searchsorted(steps.strike, psi, side="right") - 1, 0, None)
    result = stance(steps, index, psi, table, shape)
    swing = psi > steps.strike[index] + table.toe_off
    swing &= ~((index == len(steps.strike) - 1))
    if not swing.any():
        return result
    here = index[swing]
    begin, end = steps.strike[here] + table.toe_off, steps.strike[here + 1]
    u = (psi[swing] - begin) / (end - begin)
    span = (end - begin)[:, None]
    start = _derivatives(lambda at: stance(steps, here, at, table, shape), begin)
    stop = _derivatives(lambda at: stance(steps, here + 1, at, table, shape), end)
    values = quintic(u, span, start, stop)
    reach = np.linalg.norm(steps.position[here + 1] - steps.position[here], axis=1)
    values += bump.at(u, reach, 0.5 * (start[0][:, 4] + stop[0][:, 4]))
    result[swing] = values
    return result


def _derivatives(curve, at: Array) -> tuple[Array, Array, Array]:  # type: ignore[no-untyped-def]
    before, here, after = curve(at - _STEP), curve(at), curve(at + _STEP)
    return here, (after - before) / (2 * _STEP), (after - 2 * here + before) / _STEP**2


def quintic(
    u: Array,
    span: Array,
    start: tuple[Array, Array, Array],
    stop: tuple[Array, Array, Array],
) -> Array:
    """Return the curve of fifth degree between two states.

    Args:
      u: (n,) from 0 to 1.
      span: (n, 1) phase that it takes.
      start, stop: value, rate and its rate (n, k) at both ends, by phase.
    """
    u = u[:, None]
    p0, v0, a0 = start[0], start[1] * span, start[2] * span**2
    p1, v1, a1 = stop[0], stop[1] * span, stop[2] * span**2
    rise = p1 - p0
    c3 = 10 * rise - 6 * v0 - 4 * v1 - 1.5 * a0 + 0.5 * a1
    c4 = -15 * rise + 8 * v0 + 7 * v1 + 1.5 * a0 - a1
    c5 = 6 * rise - 3 * v0 - 3 * v1 - 0.5 * a0 + 0.5 * a1
    return p0 + u * (v0 + u * (0.5 * a0 + u * (c3 + u * (c4 + u * c5))))


@dataclasses.dataclass(frozen=True, eq=False)
class SwingShape:
    """What a swing does besides joining its ends: zero, with rate and its rate, at both.

    Attributes:
      values: (_BUMP + 1, 3) forward, up [m] and pitch [rad] over the swing of a full stride.
      stride: the length of that stride [m].
    """

    values: Array
    stride: float

    def at(self, u: Array, reach: Array, yaw: Array) -> Array:
        """Return (n, 5) for swings that go ``reach`` (n,) [m] towards ``yaw`` (n,) [rad]."""
        from scipy.interpolate import CubicSpline

        forward, up, pitch = CubicSpline(np.linspace(0, 1, len(self.values)), self.values)(u).T
        share = np.minimum(reach / self.stride, 1.2)
        forward, pitch = forward * share, pitch * share
        zero = np.zeros_like(u)
        return np.column_stack(
            (forward * np.cos(yaw), forward * np.sin(yaw), up * np.sqrt(share), pitch, zero)
        )


def swing_shape(ankle: Array, pitch: Array, span: float, stride: float) -> SwingShape:
    """Return the shape of the table's own swing.

    Args:
      ankle: (_BUMP + 1 + 4, 2) forward and up [m], two samples before the swing to two after it.
      pitch: the same of the foot's pitch [rad].
      span: phase that the swing takes.
      stride: the stride's length [m].
    """
    values = np.column_stack((ankle, pitch))
    step = span / (len(values) - 5)
    rate = np.gradient(values, step, axis=0)
    bend = np.gradient(rate, step, axis=0)
    u = np.linspace(0.0, 1.0, len(values) - 4)
    ends = [tuple(np.tile(v[at], (len(u), 1)) for v in (values, rate, bend)) for at in (2, -3)]
    base = quintic(u, np.full((len(u), 1), span), ends[0], ends[1])  # type: ignore[arg-type]
    return SwingShape(values[2:-2] - base, stride)
