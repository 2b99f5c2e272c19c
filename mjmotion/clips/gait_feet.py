"""The feet of the built-in walk: planted in stance, rolling over heel and toe, swung in between.

A foot strikes with its heel and turns about it until it is flat; from heel-off on it turns about
its ball, and its toes lie on the ground. In its swing it does what the table's legs do, from where
it leaves to where it comes down, and soon after the one and before the other has the speed and
acceleration of the rolling foot.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.character import Character
from mjmotion.clips.gait_plan import Steps, ease
from mjmotion.numerics.cubic import CubicSpline
from mjmotion.numerics.rotations import exp, multiply, rotate, yaw_quat

Array = NDArray[np.float64]

# Phases of a stance, from heel strike on [cycles]; the recordings' contacts of heel and ball have
# 0.09, 0.43, 0.57.
FOOT_FLAT, HEEL_OFF, TOE_OFF = 0.09, 0.42, 0.57
STRIKE = np.deg2rad(21.0)  # toes up at heel strike of a full stride
PUSH = np.deg2rad(39.0)  # heel up as its ball leaves the ground
LEAST_PUSH = 0.35  # share of that even for the smallest step
_LATER = 0.11  # how much later a foot leaves for the smallest step [cycles]
_EARLY = 0.01  # how long before the heel strike the toes begin to fall [cycles]
_RISE = 2.0  # power of the heel's rise
_STEP = 1e-3  # of the numeric derivatives [cycles]
_CARRY = 0.3  # share of its acceleration that a foot keeps over toe-off: it is kicked off
_TAKE_OFF, _TOUCH = 0.2, 0.15  # speeds at which toes leave and heels come down [m/cycle]
_CLEARANCE = 0.014  # of the sole in mid-swing [m]
_LIFT_AT = np.linspace(0.2, 0.75, 23)  # where in the swing that is looked at
_APART = 0.112  # between the middle lines of a foot that swings by and one that stands [m]
_SAMPLES = 96  # of a swing's shape
_MORE = np.deg2rad(12.0)  # that toes bend up further in the air than as the ball leaves
_STRAIGHT = 0.9  # share of a swing after which toes are straight again
_READY = 0.3  # share of it before its end in which toes that come down first bend
_BLEND = (0.40, 0.30)  # shares of a swing in which it takes leave of the old stance, joins the new


@dataclasses.dataclass(frozen=True)
class Roll:
    """How a foot comes down, rolls and leaves, and what it does apart from that in its swing.

    Attributes:
      flat, heel_off, toe_off: phases of a stance at which the sole is flat, the heel leaves and the
        toe site leaves, of a foot with toes its ball [cycles].
      strike: how far the toes are up at first touch; negative where the toes come down first [rad].
      push: how far the heel is up as that leaves [rad].
      clearance: of the sole in mid-swing, at least [m].
    """

    flat: float = FOOT_FLAT
    heel_off: float = HEEL_OFF
    toe_off: float = TOE_OFF
    strike: float = STRIKE
    push: float = PUSH
    clearance: float = _CLEARANCE


WALKING = Roll()


@dataclasses.dataclass(frozen=True, eq=False)
class FootShape:
    """A foot, in its own frame with the ankle at the origin: heel, toe site and tip (x, z) [m].

    A foot whose toes bend rolls over its toe site, the ball; the tip is of toes that are straight.
    """

    heel: Array
    toe: Array
    tip: Array


def foot_shape(character: Character, side: str) -> FootShape:
    """Return the shape of a foot.

    Raises:
      ModelError: the model has no such foot.
    """
    model = character.model
    heel, toe = (model.site(f"{side}_{part}").pos[[0, 2]] for part in ("heel", "toe"))
    (foot,) = (foot for foot in character.feet if foot.side == side)
    return FootShape(np.array(heel), np.array(toe), toe + (foot.front - foot.toe)[[0, 2]])


def toe_off(steps: Steps, roll: Roll = WALKING) -> Array:
    """Return the phase (k,) of each stance at which the foot leaves: a slow step is a late one."""
    return np.asarray(roll.toe_off + _LATER * (1.0 - steps.leaving))


def stance(
    steps: Steps, index: NDArray[np.int64], psi: Array, shape: FootShape, roll: Roll = WALKING
) -> Array:
    """Return the foot in stances.

    Args:
      steps: the stances of this foot.
      index: (n,) which stance.
      psi: (n,) phases; those a little outside of the stance continue its rolling.
      shape: the foot.
      roll: how it rolls.

    Returns:
      (n, 5): ankle x, y, z [m], pitch (toes down positive) and yaw [rad].
    """
    index = np.asarray(index, dtype=np.int64)
    phase = psi - steps.strike[index]
    standing_in = (index == 0) & steps.first
    standing_out = (index == len(steps.strike) - 1) & steps.last
    early = 1.0 - ease((phase + _EARLY) / (roll.flat + _EARLY))
    landing = np.where(standing_in, 0.0, roll.strike * steps.landing[index] * early)
    leaves = toe_off(steps, roll)[index]
    late = np.maximum((phase - roll.heel_off) / (leaves - roll.heel_off), 0.0) ** _RISE
    share = LEAST_PUSH + (1.0 - LEAST_PUSH) * steps.leaving[index]
    push = np.where(standing_out, 0.0, roll.push * share * late)
    pitch = push - landing
    on_heel = (phase < 0.5 * (roll.flat + roll.heel_off)) & (roll.strike > 0.0)
    pivot = np.where(on_heel[:, None], shape.heel, shape.toe)
    # The pivot stays; turned by pitch about y, (x, z) goes to (x cos + z sin, z cos - x sin).
    cosine, sine = np.cos(pitch), np.sin(pitch)
    along = pivot[:, 0] - (pivot[:, 0] * cosine + pivot[:, 1] * sine)
    up = -(pivot[:, 1] * cosine - pivot[:, 0] * sine)
    yaw = steps.yaw[index]
    x = steps.position[index, 0] + along * np.cos(yaw)
    y = steps.position[index, 1] + along * np.sin(yaw)
    return np.column_stack((x, y, up, pitch, yaw))


def foot_motion(
    steps: Steps,
    psi: Array,
    shape: FootShape,
    swing: Swing,
    roll: Roll = WALKING,
    other: Steps | None = None,
) -> Array:
    """Return the foot (n, 5) at phases (n,), as :func:`stance` does; it swings past the other's."""
    index = np.clip(np.searchsorted(steps.strike, psi, side="right") - 1, 0, None)
    result = stance(steps, index, psi, shape, roll)
    leaves = steps.strike + toe_off(steps, roll)
    flying = (psi > leaves[index]) & (index < len(steps.strike) - 1)
    if not flying.any():
        return result
    here = index[flying]
    begin, end = leaves[here], steps.strike[here + 1]
    span = (end - begin)[:, None]
    u = (psi[flying] - begin) / span[:, 0]
    leave = _state(lambda at: stance(steps, here, at, shape, roll), begin, _STEP, span)
    join = _state(lambda at: stance(steps, here + 1, at, shape, roll), end, _STEP, span)
    leave[1][:, 2] += _TAKE_OFF * span[:, 0]
    join[1][:, 2] -= _TOUCH * span[:, 0]
    path = swing.between(leave, join)
    on_way = [path(np.full(len(u), at)) for at in _LIFT_AT]
    result[flying] = path(u)
    result[flying, 2] += _lift(on_way, shape, roll) * _hump(u)
    if other is not None:
        aside = _aside(on_way, 0.5 * (begin + end), shape, other)
        result[flying, :2] += _hump(u)[:, None] * aside
    return result


def both_feet(
    steps: Sequence[Steps],
    shapes: Sequence[FootShape],
    swing: Swing,
    psi: Array,
    roll: Roll = WALKING,
) -> tuple[Array, Array]:
    """Return ankles (n, 2, 3) [m] and orientations (n, 2, 4) of both feet at phases (n,)."""
    positions, quats = [], []
    for stances, shape, other in zip(steps, shapes, reversed(steps), strict=True):
        foot = foot_motion(stances, psi, shape, swing, roll, other)
        zero = np.zeros_like(psi)
        pitch = exp(np.column_stack((zero, foot[:, 3], zero)))
        positions.append(foot[:, :3])
        quats.append(multiply(yaw_quat(foot[:, 4]), pitch))
    return np.stack(positions, axis=1), np.stack(quats, axis=1)


def toe_bends(
    steps: Sequence[Steps], psi: Array, quats: Array, roll: Roll = WALKING
) -> tuple[Array, ...]:
    """Return how far toes bend up (n,) [rad], one a foot: flat on the ground as the heel rises.

    Args:
      steps: the stances of each foot.
      psi: (n,) phases.
      quats: (n, 2, 4) how the feet are turned.
      roll: how they roll.
    """
    bends = []
    for stances, quat in zip(steps, np.moveaxis(quats, 1, 0), strict=True):
        pitch = np.arcsin(np.clip(-rotate(quat, np.eye(3)[0])[:, 2], -1.0, 1.0))
        index = np.clip(np.searchsorted(stances.strike, psi, side="right") - 1, 0, None)
        leaves = stances.strike + toe_off(stances, roll)
        flying = (psi > leaves[index]) & (index < len(stances.strike) - 1)
        end = np.append(stances.strike[1:], np.inf)[index]
        u = np.where(flying, (psi - leaves[index]) / np.maximum(end - leaves[index], 1e-9), 0.0)
        bends.append(_follow(pitch) * _bent(u, roll))
    return tuple(bends)


def _follow(pitch: Array) -> Array:
    """Return how far toes that lie on the ground bend up (n,) [rad] under a foot pitched so far.

    In the air a foot goes on pitching, its toes hardly bend any further.
    """
    over = _MORE * np.tanh((pitch - PUSH) / _MORE)
    return np.where(pitch > PUSH, PUSH + over, np.maximum(pitch, 0.0))


def _bent(u: Array, roll: Roll) -> Array:
    """Return the share (n,) of a foot's pitch that its toes are bent by, at shares of a swing."""
    share = 1.0 - ease(u / _STRAIGHT)
    if roll.strike < 0.0:  # toes that come down first are ready for it
        share = share + ease((u - 1.0 + _READY) / _READY)
    return np.asarray(share)


def _hump(u: Array) -> Array:
    """Return a hump of height 1 that begins and ends without rate and rate of rate."""
    return (4.0 * u * (1.0 - u)) ** 3


def _lift(on_way: Sequence[Array], shape: FootShape, roll: Roll) -> Array:
    """Return how much higher (n,) swings must go for heel, ball and tip to clear the ground [m].

    Args:
      on_way: the foot (n, 5) at each of :data:`_LIFT_AT`, in the swings of n frames; frames of one
        swing come out the same.
      shape: the foot.
      roll: how it rolls, and its clearance.
    """
    most = np.zeros(len(on_way[0]))
    for u, foot in zip(_LIFT_AT, on_way, strict=True):
        pitch = foot[:, 3]
        toes = pitch - _follow(pitch) * _bent(np.full(len(pitch), u), roll)
        ball, tip = shape.toe, shape.tip - shape.toe
        ends = [z * np.cos(pitch) - x * np.sin(pitch) for x, z in (shape.heel, ball)]
        ends.append(ends[1] + tip[1] * np.cos(toes) - tip[0] * np.sin(toes))
        for end in ends:
            most = np.maximum(most, (roll.clearance - foot[:, 2] - end) / _hump(u))
    return most


def _aside(on_way: Sequence[Array], middle: Array, shape: FootShape, other: Steps) -> Array:
    """Return how far (n, 2) swings must go aside to pass a standing foot [m]: in turns they cut in.

    Args:
      on_way: the foot, as :func:`_lift` has it.
      middle: (n,) the phases at which the swings are half over: the other foot stands.
      shape: of either foot.
      other: the stances of the other foot.
    """
    stand = np.clip(np.searchsorted(other.strike, middle, side="right") - 1, 0, None)
    yaw = other.yaw[stand]
    out = np.column_stack((-np.sin(yaw), np.cos(yaw)))
    ahead = np.column_stack((np.cos(yaw), np.sin(yaw)))
    half = on_way[len(on_way) // 2][:, :2] - other.position[stand]
    side = np.sign(np.sum(half * out, axis=1))
    heel, toe = shape.heel[0], shape.tip[0]
    most = np.zeros(len(middle))
    for u, foot in zip(_LIFT_AT, on_way, strict=True):
        along = np.column_stack((np.cos(foot[:, 4]), np.sin(foot[:, 4])))
        for part in (heel, 0.5 * (heel + toe), toe):
            place = foot[:, :2] + part * along - other.position[stand]
            apart = side * np.sum(place * out, axis=1)
            where = np.sum(place * ahead, axis=1)
            beside = (where > heel) & (where < toe)
            most = np.where(beside, np.maximum(most, (_APART - apart) / _hump(u)), most)
    return np.asarray((most * side)[:, None] * out)


def _state(
    curve: Callable[[Array], Array], at: Array, step: float, scale: Array
) -> tuple[Array, Array, Array]:
    """Return value, rate and the rate's rate of a curve, by ``scale`` of its argument."""
    before, here, after = curve(at - step), curve(at), curve(at + step)
    rate = (after - before) / (2 * step)
    return here, rate * scale, (after - 2 * here + before) / step**2 * scale**2


def _departure(s: Array, rate: Array, bend: Array, width: float) -> Array:
    """Return a curve that leaves zero at s = 0 with these rates and is zero again from s = 1 on."""
    s = np.clip(s, 0.0, 1.0)[:, None]
    left = (1.0 - s) ** 3
    first = s * left * (1.0 + 3.0 * s)
    second = 0.5 * s * s * left
    return first * rate * width + second * bend * width**2


@dataclasses.dataclass(frozen=True, eq=False)
class Swing:
    """What the table's foot does in the swing of a full stride.

    Attributes:
      u: (m,) share of the swing; a little more than from 0 to 1, for derivatives.
      values: (m, 3) share of the way gone, height [m], pitch [rad]; the last two over a smooth
        step between their ends, so that they are zero at 0 and 1.
      way: how far the ankle goes in a full stride's swing [m].
    """

    u: Array
    values: Array
    way: float

    def between(
        self, begin: tuple[Array, Array, Array], end: tuple[Array, Array, Array]
    ) -> Callable[[Array], Array]:
        """Return the swings from one state of the foot to another, as a function of u (n,).

        Args:
          begin: foot (n, 5), its rate and the rate's rate by u, as it leaves.
          end: the same as it lands.
        """
        spline = CubicSpline(self.u, self.values)
        rise = end[0] - begin[0]
        share = np.minimum(np.hypot(rise[:, 0], rise[:, 1]) / self.way, 1.15)

        def path(u: Array) -> Array:
            gone, up, pitch = spline(u).T
            step = ease(u)
            extra = np.column_stack((gone - step, gone - step, np.zeros((len(u), 3))))
            foot = begin[0] + (step[:, None] + extra) * rise
            foot[:, 2] += share * up
            foot[:, 3] += share * pitch
            return foot

        one = np.ones((len(rise), 1))
        leave = _state(path, np.zeros(len(rise)), _STEP, one)
        join = _state(path, np.ones(len(rise)), _STEP, one)

        def joined(u: Array) -> Array:
            first, second = _BLEND
            free = np.array((_CARRY, _CARRY, 1.0, 1.0, 1.0))
            return (
                path(u)
                + _departure(u / first, begin[1] - leave[1], free * (begin[2] - leave[2]), first)
                + _departure((1.0 - u) / second, join[1] - end[1], end[2] - join[2], second)
            )

        return joined


def swing_shares() -> Array:
    """Return the shares of a swing (m,) that a :class:`Swing` is given at."""
    beyond = 4.0 / _SAMPLES
    return np.linspace(-beyond, 1.0 + beyond, _SAMPLES + 9)


def swing_phases() -> Array:
    """Return the phases at which :func:`find_swing` wants the table's foot."""
    return TOE_OFF + (1.0 - TOE_OFF) * swing_shares()


def find_swing(forward: Array, up: Array, pitch: Array) -> Swing:
    """Return the swing of the table's foot.

    Args:
      forward: where the ankle is over the ground (m,) at :func:`swing_phases` [m].
      up: its height (m,) [m].
      pitch: the foot's, toes down positive (m,) [rad].
    """
    u = swing_shares()
    first, last = 4, len(u) - 5
    way = float(forward[last] - forward[first])
    columns = [(forward - forward[first]) / way]
    for values in (up, pitch):
        columns.append(values - values[first] - ease(u) * (values[last] - values[first]))
    return Swing(u, np.column_stack(columns), way)
