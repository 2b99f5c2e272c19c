"""Where each foot goes, at every frame: held on its footholds, smooth and clear in between.

The target of a foot is the source's own path carried to the new footholds. While heel and toe both
stand the foot is the foothold itself; while one of them stands the foot turns about it; in between
the carry blends from one foothold to the next, what the contacts took away fades out within a tenth
of a second, and the foot is lifted where the ground would come too near. As targets are smooth, so
is what IK makes of them: the exact pass (§4.4) has no kink to bring back.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mjmotion.footholds import Foot, Foothold, Stance, carried
from mjmotion.kinematics import Pose, site_id
from mjmotion.rotations import (
    conjugate,
    continuous,
    exp,
    from_matrix,
    log,
    multiply,
    normalized,
    rotate,
    yaw_quat,
)
from mjmotion.scene.ground import Ground
from mjmotion.smoothing import envelope, fade

Array = NDArray[np.float64]

FADE_TIME = 0.04  # what a contact took away dies out as exp(-t / this) [s]
ROLL_PITCH = 0.6  # pitch on one contact from which the foot may roll as it likes [rad]
LIFT_TIME = 0.12  # scale of a lift's rise and fall [s]
CLEARANCE = 0.022  # most clearance that a swing is given on its own account [m]
CLEARANCE_SHARE = 1.0  # share of the source's clearance that a swing keeps, up to that


@dataclasses.dataclass(frozen=True, eq=False)
class FootPath:
    """Targets of one foot's posed site, and how it got there.

    Attributes:
      site: name of the posed site.
      position: (nframe, 3) [m].
      quat: (nframe, 4) wxyz.
      shift: (nframe, 3) how far its contacts are shifted, blended through the swings [m].
      stance: (nframe,) when any contact holds.
      lift: (nframe,) how much it was lifted to clear the ground [m].
    """

    site: str
    position: Array
    quat: Array
    shift: Array
    stance: NDArray[np.bool_]
    lift: Array


def foot_path(
    foot: Foot,
    index: int,
    pose: Pose,
    stances: Sequence[Stance],
    footholds: Sequence[Foothold],
    ground: Ground,
    fps: float,
) -> FootPath:
    """Return the path of foot number ``index``.

    Args:
      foot: the foot.
      index: its number in the stances.
      pose: the source, every frame.
      stances: all stances, of both feet.
      footholds: one a stance.
      ground: the scene's surfaces.
      fps: frames a second.
    """
    site = site_id(pose.model, foot.site)
    source_pos = pose.site_xpos[:, site]
    source_quat = continuous(from_matrix(pose.site_xmat[:, site]))
    mine = [(s, f) for s, f in zip(stances, footholds, strict=True) if s.foot == index]
    nframe = len(source_pos)
    if not mine:
        zero = np.zeros((nframe, 3))
        free = np.zeros(nframe, dtype=bool)
        return FootPath(foot.site, source_pos, source_quat, zero, free, np.zeros(nframe))
    holds = _Holds(foot, mine, nframe)
    shift, turn = _carry(mine, nframe)
    base = multiply(turn, source_quat)
    quat = _turned(foot, holds, base, FADE_TIME * fps)
    position = source_pos + shift
    held = holds.site_position(quat)
    position = position + fade(holds.any, held - position, FADE_TIME * fps)
    position[holds.any] = held[holds.any]
    lift = _lift(foot, position, quat, source_pos, source_quat, holds.any, mine, ground, fps)
    position[:, 2] += lift
    return FootPath(foot.site, position, quat, shift, holds.any, lift)


class _Holds:
    """What a foot's contacts hold at each frame."""

    def __init__(self, foot: Foot, mine: Sequence[tuple[Stance, Foothold]], nframe: int) -> None:
        self.foot = foot
        self.heel = np.zeros(nframe, dtype=bool)
        self.toe = np.zeros(nframe, dtype=bool)
        self.position = np.zeros((nframe, 3))
        self.quat = np.tile((1.0, 0.0, 0.0, 0.0), (nframe, 1))
        for stance, foothold in mine:
            span = slice(stance.start, stance.end)
            self.position[span], self.quat[span] = foothold.position, foothold.quat
            self.heel[slice(*stance.heel)] = True
            self.toe[slice(*stance.toe)] = True
        self.any = self.heel | self.toe
        self.flat = self.heel & self.toe

    def site_position(self, quat: Array) -> Array:
        """Where the posed site is when the contact that holds stays and the foot is turned."""
        local = np.where(self.heel[:, None], self.foot.heel, self.foot.toe)
        point = self.position + rotate(self.quat, local)
        return np.where(self.flat[:, None], self.position, point - rotate(quat, local))


def _carry(mine: Sequence[tuple[Stance, Foothold]], nframe: int) -> tuple[Array, Array]:
    """Shift (nframe, 3) and turn (nframe, 4) from the source: constant in stance, eased in swing."""
    shift, turn = np.empty((nframe, 3)), np.empty((nframe, 4))
    previous: tuple[int, Array, Array] | None = None
    for stance, foothold in mine:
        move, rotation = foothold.position - stance.source_pos, carried(stance, foothold)
        if previous is None:
            shift[: stance.end], turn[: stance.end] = move, rotation
        else:
            end, old_move, old_turn = previous
            count = stance.start - end
            s = (np.arange(count) + 1.0) / (count + 1.0)
            ease = (s**3 * (10.0 - 15.0 * s + 6.0 * s * s))[:, None]
            shift[end : stance.start] = old_move + ease * (move - old_move)
            between = log(multiply(rotation, conjugate(old_turn)))
            turn[end : stance.start] = multiply(exp(ease * between), np.tile(old_turn, (count, 1)))
            shift[stance.start : stance.end], turn[stance.start : stance.end] = move, rotation
        previous = (stance.end, move, rotation)
    assert previous is not None
    shift[previous[0] :], turn[previous[0] :] = previous[1], previous[2]
    return shift, turn


def _turned(foot: Foot, holds: _Holds, base: Array, time: float) -> Array:
    """Orientation: the foothold's while flat, the carried source's else, smooth where they meet.

    On one contact the foot keeps the source's yaw, and its pitch unless that is into the ground. Its
    roll comes with the pitch: a rigid sole that rolls while it is nearly flat digs in with a side.
    """
    w, x, y, z = np.moveaxis(multiply(conjugate(holds.quat), base), -1, 0)
    yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    pitch = np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))
    single = np.where(holds.heel, np.minimum(pitch, 0.0), np.maximum(pitch, 0.0))
    pitch = np.where(holds.flat, pitch, single)
    roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    s = np.clip(np.abs(pitch) / ROLL_PITCH, 0.0, 1.0)
    zero = np.zeros_like(yaw)
    rolled = multiply(yaw_quat(yaw), exp(np.stack((zero, pitch, zero), axis=-1)))
    rolled = multiply(rolled, exp(np.stack((roll * s * s * (3.0 - 2.0 * s), zero, zero), axis=-1)))
    allowed = multiply(holds.quat, rolled)
    # First what a contact allows, faded into the swings; then flat, faded into all that is not.
    quat = multiply(base, exp(fade(holds.any, log(multiply(conjugate(base), allowed)), time)))
    quat = multiply(quat, exp(fade(holds.flat, log(multiply(conjugate(quat), holds.quat)), time)))
    quat[holds.flat] = holds.quat[holds.flat]
    return normalized(quat)


def _lift(
    foot: Foot,
    position: Array,
    quat: Array,
    source_pos: Array,
    source_quat: Array,
    stance: NDArray[np.bool_],
    mine: Sequence[tuple[Stance, Foothold]],
    ground: Ground,
    fps: float,
) -> Array:
    """How much the foot must rise for its sole to clear the ground (nframe,) [m]."""
    swing = np.flatnonzero(~stance)
    if len(swing) == 0:
        return np.zeros(len(stance))
    sole = position[swing, None] + rotate(quat[swing, None], foot.shape[None])
    height, _ = ground.under(sole)
    over = np.where(np.isnan(height), np.inf, sole[..., 2] - height).min(axis=1)
    # The source stands on level ground, at the height its own stances show.
    frames = np.array([0.5 * (s.start + s.end) for s, _ in mine])
    level = np.interp(np.arange(len(stance)), frames, [s.source_pos[2] for s, _ in mine])
    source_sole = source_pos[swing, None] + rotate(source_quat[swing, None], foot.sole[None])
    source_over = source_sole[..., 2].min(axis=1) - level[swing]
    wanted = np.clip(CLEARANCE_SHARE * source_over, 0.0, CLEARANCE)
    need = np.full(len(stance), -np.inf)
    need[swing] = wanted - over
    return envelope(need, stance, LIFT_TIME * fps)
