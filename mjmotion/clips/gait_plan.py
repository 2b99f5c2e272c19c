"""The plan of a walk: how fast, where to, and where each foot comes down.

Everything is a function of the gait phase ``psi`` [cycles]: the left heel strikes at whole numbers,
the right at halves. Phase, time and the way along the path grow together; as all of it is
continuous, a walk is the same at any frame rate.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mjmotion.exceptions import ClipError, unknown_name
from mjmotion.numerics.cubic import CubicSpline
from mjmotion.numerics.smoothing import ease

Array = NDArray[np.float64]

KINDS = ("start", "straight", "turn_left", "turn_right", "stop")
MIDDLE = 0.23  # phase of a stance at which the pelvis passes over the foot
_GRID = 200  # samples of a cycle
_MARGIN = 2.0  # cycles kept before and after the walk
_EARLY, _LATE = 0.15, 0.10  # how long before a start and after a stop the speed changes [cycles]
_SLOWER = 0.15  # by how much steps take longer when standing still begins or ends
_STOP = 1.0  # phase of a stop's last heel strike from its begin on


@dataclasses.dataclass(frozen=True)
class Segment:
    """A part of a walk.

    Attributes:
      kind: one of ``start`` (from quiet standing), ``straight``, ``turn_left``, ``turn_right`` and
        ``stop`` (to quiet standing).
      strides: how long, in gait cycles, a multiple of one half. A start or a stop takes one.
    """

    kind: str
    strides: float = 1.0


@dataclasses.dataclass(frozen=True, eq=False)
class WalkPath:
    """What the body does, sampled evenly in phase.

    Attributes:
      psi: (n,) phase [cycles].
      time: (n,) [s], 0 where the first segment begins.
      pace: (n,) speed as a share of the walking speed.
      position: (n, 2) point that the body follows on the ground [m].
      heading: (n,) [rad].
      begin, end: phases at which the first segment begins and the last ends.
      starts, stops: whether it begins and ends standing.
    """

    psi: Array
    time: Array
    pace: Array
    position: Array
    heading: Array
    begin: float
    end: float
    starts: bool
    stops: bool

    def at(self, psi: Array) -> tuple[Array, Array, Array]:
        """Return position (n, 2) [m], heading (n,) [rad] and pace (n,) at phases (n,)."""
        # The grid is fine enough for a cubic through it to be exact to a micrometre.
        table = np.column_stack((self.position, self.heading, self.pace))
        values = CubicSpline(self.psi, table)(np.clip(psi, self.psi[0], self.psi[-1]))
        return values[:, :2], values[:, 2], values[:, 3]

    def phase(self, time: Array) -> Array:
        """Return phases (n,) at times (n,) [s]; before and after the grid the rate goes on."""
        inside = CubicSpline(self.time, self.psi)(np.clip(time, self.time[0], self.time[-1]))
        rate = (self.psi[-1] - self.psi[-2]) / (self.time[-1] - self.time[-2])
        beyond = time - np.clip(time, self.time[0], self.time[-1])
        return np.asarray(inside + rate * beyond)


def plan_path(segments: Sequence[Segment], stride: float, speed: float, turning: float) -> WalkPath:
    """Return the path of a walk.

    Args:
      segments: its parts, in order.
      stride: length of a whole stride at walking speed [m].
      speed: walking speed [m/s].
      turning: mean rate of turning in the turns [rad/s].

    Raises:
      ClipError: no segments, an unknown kind, a length that is not a multiple of one half, a start
        that is not first or a stop that is not last.
    """
    _check(segments)
    starts, stops = segments[0].kind == "start", segments[-1].kind == "stop"
    end = sum(segment.strides for segment in segments)
    psi = np.linspace(-_MARGIN, end + _MARGIN, round((end + 2 * _MARGIN) * _GRID) + 1)
    pace = np.ones_like(psi)
    if starts:
        pace *= ease((psi + _EARLY) / (segments[0].strides + _EARLY))
    if stops:
        first = end - segments[-1].strides
        pace *= ease((end + _LATE - psi) / (end + _LATE - first + 0.05))
    period = stride / speed
    rate = period * (1.0 + _SLOWER * (1.0 - pace))  # time of a cycle
    time = _integral(psi, rate)
    time -= np.interp(0.0, psi, time)
    heading = np.zeros_like(psi)
    at = 0.0
    for segment in segments:
        if segment.kind.startswith("turn"):
            way = 1.0 if segment.kind == "turn_left" else -1.0
            angle = way * turning * segment.strides * period
            heading += angle * ease((psi - at) / segment.strides)
        at += segment.strides
    velocity = (speed * pace * rate)[:, None]
    step = velocity * np.column_stack((np.cos(heading), np.sin(heading)))
    position = np.column_stack([_integral(psi, column) for column in step.T])
    position -= [np.interp(0.0, psi, column) for column in position.T]
    if starts:
        position -= position[0]
    return WalkPath(psi, time, pace, position, heading, 0.0, end, starts, stops)


def _check(segments: Sequence[Segment]) -> None:
    if not segments:
        raise ClipError("a walk needs segments: give at least one")
    for number, segment in enumerate(segments):
        if segment.kind not in KINDS:
            raise ClipError(unknown_name("segment", segment.kind, KINDS))
        whole = 2.0 * segment.strides
        if not (whole >= 1.0 and whole == round(whole)):
            raise ClipError(
                f"segment {number} ({segment.kind}) has {segment.strides} strides:"
                " give a multiple of 0.5"
            )
        if segment.kind in ("start", "stop"):
            required = 0 if segment.kind == "start" else len(segments) - 1
            if number != required or segment.strides != 1.0:
                raise ClipError(
                    f"segment {number} is a {segment.kind}: it takes one stride,"
                    f" at the walk's {'begin' if required == 0 else 'end'}"
                )


def _integral(x: Array, values: Array) -> Array:
    return CubicSpline(x, values).integral()


@dataclasses.dataclass(frozen=True, eq=False)
class Steps:
    """The stances of one foot, in order.

    Attributes:
      strike: (k,) phase of each heel strike.
      position: (k, 2) where the ankle is over the flat foot [m].
      yaw: (k,) which way the foot points [rad].
      landing: (k,) how far the toes are up at heel strike, as a share of a full stride's.
      leaving: (k,) how far the heel is up at toe-off, likewise.
      first, last: whether the first and the last stance have no begin and no end: standing.
    """

    strike: Array
    position: Array
    yaw: Array
    landing: Array
    leaving: Array
    first: bool
    last: bool


def plan_steps(
    path: WalkPath, side: str, widths: tuple[float, float], toe_out: float, middle: float = MIDDLE
) -> Steps:
    """Return where a foot stands: under the path, half the width to its side.

    Args:
      path: what the body does.
      side: ``left`` or ``right``.
      widths: distance of the ankles' lines, standing and walking [m].
      toe_out: how far the feet point outward [rad].
      middle: phase of a stance at which the pelvis passes over the foot [cycles].
    """
    sign, offset = (1.0, 0.0) if side == "left" else (-1.0, 0.5)
    low, high = path.begin - _MARGIN + 0.5, path.end + _MARGIN - 1.0
    strike = np.arange(np.ceil(low - offset), np.floor(high - offset) + 1.0) + offset
    if path.starts:
        # The right foot goes first, and until it does both stand.
        strike = strike[strike >= (0.0 if side == "left" else -0.5)]
    last = path.end - 1.0 + _STOP  # last heel strike of a stop
    if path.stops:
        strike = strike[strike <= last]
    over = strike + middle
    if path.starts:
        over[0] = path.psi[0]
    if path.stops:
        over[strike >= last - 0.5] = path.psi[-1]
    position, yaw, pace = path.at(over)
    width = widths[0] + (widths[1] - widths[0]) * np.clip(pace, 0.0, 1.0)
    normal = np.column_stack((-np.sin(yaw), np.cos(yaw)))
    return Steps(
        strike=strike,
        position=position + 0.5 * sign * width[:, None] * normal,
        yaw=yaw + sign * toe_out,
        landing=np.clip(path.at(strike)[2], 0.0, 1.0),
        leaving=np.clip(path.at(strike + 0.62)[2], 0.0, 1.0),
        first=path.starts,
        last=path.stops,
    )
