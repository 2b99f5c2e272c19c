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

from mjmotion.body.feet import Foot
from mjmotion.body.kinematics import Pose, root_body, site_id
from mjmotion.body.motion import Motion
from mjmotion.constraints.shared_targets import SharedMove
from mjmotion.footsteps.footholds import Foothold, carried
from mjmotion.footsteps.holds import Holds, rolled_less
from mjmotion.footsteps.stances import Stance
from mjmotion.footsteps.swings import DIP, FADE_FRAMES, StepOver, wanted_clearance
from mjmotion.footsteps.toes import (
    kept_up,
    lying_flat,
    pitch_between,
    rolled_no_further,
    room_under_ball,
)
from mjmotion.numerics.rotations import (
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
from mjmotion.numerics.smoothing import blend, cover, ease, envelope, fade
from mjmotion.scene.ground import Ground

Array = NDArray[np.float64]

FADE_TIME = 0.03  # what a contact took away dies out as exp(-t / this) [s]
SHORT_LEVER = 0.06  # least lever that a tip about a contact is reckoned with [m]
FREE_RIGIDITY = 100.0  # α of a free foothold: 10 cm cost what 1 rad of a joint does [1/m²]
SAME_BEND = 1e-9  # toes that are bent by no more than this otherwise are left as they are [rad]
SAME_TURN = 1e-6  # footholds turned by no more about the vertical are as in the source [rad]
_INSIST = 60.0  # how much what a contact allows counts against smoothness


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
      toes: (nframe,) how far its toes would bend up, were there no end to their range [rad]; 0
        where they do not bend.
      room: (nframe,) how far the ends of its ball may still go down; None where no ground is known
        [m].
      clearance: (nframe,) that it should have over the ground; None where none is known [m].
    """

    site: str
    position: Array
    quat: Array
    shift: Array
    stance: NDArray[np.bool_]
    lift: Array
    toes: Array
    room: Array | None = None
    clearance: Array | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class Detour:
    """What a foot does besides what its contacts and the ground ask of it.

    Attributes:
      aside: (nframe, 3) how far it goes aside, zero where it stands [m].
      tip: (nframe,) how much further it is tipped on to its toe, zero where its heel stands [rad].
    """

    aside: Array
    tip: Array

    def and_aside(self, more: Array) -> Detour:
        """Return the detour that goes aside by (nframe, 3) more [m]."""
        return Detour(self.aside + more, self.tip)


def foot_path(
    foot: Foot,
    index: int,
    pose: Pose,
    stances: Sequence[Stance],
    footholds: Sequence[Foothold],
    ground: Ground,
    fps: float,
    detour: Detour | None = None,
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
      detour: what it does for the sake of the other foot, and of the root.
    """
    site = site_id(pose.model, foot.site)
    source_pos = pose.site_xpos[:, site]
    source_quat = continuous(from_matrix(pose.site_xmat[:, site]))
    mine = [(s, f) for s, f in zip(stances, footholds, strict=True) if s.foot == index]
    nframe = len(source_pos)
    if not mine:
        zero = np.zeros((nframe, 3))
        free = np.zeros(nframe, dtype=bool)
        toes = foot.bend(pose) if foot.toes is None else foot.toes.wanted(foot.bend(pose))
        return FootPath(foot.site, source_pos, source_quat, zero, free, np.zeros(nframe), toes)
    holds = Holds(foot, mine, nframe)
    shift, turn = _carry(mine, nframe)
    shift = shift + _round(mine, source_pos, pose.xpos[:, root_body(pose.model)])
    base = multiply(turn, source_quat)
    fading = max(FADE_TIME * fps, FADE_FRAMES)
    quat, position = _turned(holds, base, fading), source_pos + shift
    if detour is not None:
        quat = multiply(quat, exp(detour.tip[:, None] * np.array((0.0, 1.0, 0.0))))
        position = position + detour.aside
    quat = rolled_less(holds, quat, ground, fading)
    held = holds.site_position(quat)
    position = position + fade(holds.any, held - position, fading)
    position[holds.any] = held[holds.any]
    bend = foot.bend(pose)
    wanted = wanted_clearance(foot.sole_at(bend), source_pos, source_quat, mine, nframe)
    toes = lying_flat(foot, holds.bend(quat), holds.toe, bend, fps)
    bend = toes if foot.toes is None else foot.toes.settled(toes)
    step_over = StepOver(foot.under_at(bend), quat, wanted, holds.any, ground, fps)
    position, lift = step_over(position, mine)
    toes = kept_up(foot, position, quat, toes, holds.toe, ground, fps)
    room = room_under_ball(foot, position, quat, holds.any, ground)
    return FootPath(foot.site, position, quat, shift, holds.any, lift, toes, room, wanted)


def turned_about_toes(path: FootPath, foot: Foot, quat: Array) -> FootPath:
    """Return a path turned to ``quat`` (nframe, 4) about its toe site, its toes kept as they lie.

    Where they do not bend as far, it goes on over their tip. It rolls only as far as both ends of
    its ball stay out of the ground.
    """
    if foot.toes is not None and path.room is not None:
        quat, room = rolled_no_further(foot, (path.quat, quat), path.toes, path.stance, path.room)
        path = dataclasses.replace(path, room=room)
    position = path.position + rotate(path.quat, foot.toe) - rotate(quat, foot.toe)
    if foot.toes is None:
        return dataclasses.replace(path, position=position, quat=quat)
    toes = path.toes + pitch_between(path.quat, quat)
    # What the toes give less than asked, before and after, is rolled over their tip.
    lacks = [bend - foot.toes.settled(bend) for bend in (path.toes, toes)]
    if (lacks[0] != lacks[1]).any():
        tip = foot.front[None]
        wanted, given = (
            foot.toes.turned(tip, bend)[:, 0] for bend in (toes - lacks[0], toes - lacks[1])
        )
        position = position + rotate(quat, wanted - given)
    return dataclasses.replace(path, position=position, quat=quat, toes=toes)


def with_toes(motion: Motion, paths: Sequence[FootPath]) -> Motion:
    """Return the motion with the toes of its feet as planned; all else stays as it is."""
    qpos = motion.qpos
    planned = {path.site: path.toes for path in paths}
    for foot in motion.character.feet if planned else ():
        if foot.toes is not None and foot.site in planned:
            bent = foot.toes.put(qpos, foot.toes.settled(planned[foot.site]))
            # Frames in which nothing is asked of the toes stay bit for bit.
            same = np.abs(bent - qpos).max(axis=1) < SAME_BEND
            qpos = np.where(same[:, None], qpos, bent)
    return motion if qpos is motion.qpos else motion.replace(qpos)


def free_footholds(
    feet: Sequence[Foot],
    stances: Sequence[Stance],
    footholds: Sequence[Foothold],
    nframe: int,
) -> list[SharedMove]:
    """Return one shared move a stance (§7): its foothold is free in its own plane, and to turn.

    The paths of the swings before and after follow, as they follow a foothold that is elsewhere.
    """
    moves = []
    for index, foot in enumerate(feet):
        mine = [(s, f) for s, f in zip(stances, footholds, strict=True) if s.foot == index]
        for number, (stance, foothold) in enumerate(mine):
            begin = mine[number - 1][0].end if number > 0 else 0
            end = mine[number + 1][0].start if number + 1 < len(mine) else nframe
            share = np.ones(end - begin)
            before, after = stance.start - begin, end - stance.end
            if number > 0:
                share[:before] = ease((np.arange(before) + 1.0) / (before + 1.0))
            if number + 1 < len(mine):
                rest = share[stance.end - begin :]
                rest[:] = 1.0 - ease((np.arange(after) + 1.0) / (after + 1.0))
            level = rotate(foothold.quat, np.eye(3)[:2])
            moves.append(
                SharedMove(
                    foot.site,
                    np.arange(begin, end),
                    share,
                    foothold.position,
                    level - (level @ foothold.normal)[:, None] * foothold.normal,
                    foothold.normal,
                    rigidity=FREE_RIGIDITY,
                )
            )
    return moves


def _carry(mine: Sequence[tuple[Stance, Foothold]], nframe: int) -> tuple[Array, Array]:
    """Shift (nframe, 3) and turn (nframe, 4) from the source: constant in stance, eased else."""
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
            share = ease(s)[:, None]
            shift[end : stance.start] = old_move + share * (move - old_move)
            between = log(multiply(rotation, conjugate(old_turn)))
            turn[end : stance.start] = multiply(exp(share * between), np.tile(old_turn, (count, 1)))
            shift[stance.start : stance.end], turn[stance.start : stance.end] = move, rotation
        previous = (stance.end, move, rotation)
    assert previous is not None
    shift[previous[0] :], turn[previous[0] :] = previous[1], previous[2]
    return shift, turn


def _round(mine: Sequence[tuple[Stance, Foothold]], source_pos: Array, root: Array) -> Array:
    """Return how far else (nframe, 3) a foot is that turns with the body about the root [m].

    A foothold that is turned about the vertical has the body about it turned, and so what the foot
    does from there; between two of them the root goes over from the one's way to the other's.
    """
    yaws = np.array([_yaw(carried(stance, foothold)) for stance, foothold in mine])
    more = np.zeros_like(source_pos)
    if np.abs(yaws).max() < SAME_TURN:
        return more
    yaws = np.unwrap(yaws)
    nframe, flat = len(source_pos), np.array((1.0, 1.0, 0.0))
    at, turn = np.empty((nframe, 3)), np.empty(nframe)
    for number, (stance, _) in enumerate(mine):
        arm = (root - stance.source_pos) * flat
        way = rotate(yaw_quat(np.full(nframe, yaws[number])), arm) - arm
        before = mine[number - 1][0].end if number else 0
        count = stance.start - before if number else 0
        swing = slice(before, before + count)
        share = ease((np.arange(count) + 1.0) / (count + 1.0))
        at[swing] += share[:, None] * (way[swing] - at[swing])
        turn[swing] += share * (yaws[number] - turn[swing])
        at[before + count :], turn[before + count :] = way[before + count :], yaws[number]
    arm = (source_pos - root) * flat
    return np.asarray(at + rotate(yaw_quat(turn), arm) - arm)


def _yaw(quat: Array) -> float:
    """Return how far a turn (4,) is about the vertical [rad]."""
    return float(2.0 * np.arctan2(quat[3], quat[0]))


def _turned(holds: Holds, base: Array, time: float) -> Array:
    """Orientation: the foothold's while flat, the carried source's else, smooth where they meet.

    On one contact the foot keeps the source's yaw, and its pitch unless that is downwards. Its
    roll comes with the pitch: a rigid sole that rolls while it is nearly flat digs in its side.
    """
    w, x, y, z = np.moveaxis(multiply(conjugate(holds.quat), base), -1, 0)
    yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    pitch = np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))
    single = np.where(holds.heel, np.minimum(pitch, 0.0), np.maximum(pitch, 0.0))
    pitch = np.where(holds.flat, pitch, single)
    roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    zero = np.zeros_like(yaw)
    pitched = multiply(yaw_quat(yaw), exp(np.stack((zero, pitch, zero), axis=-1)))
    # Heights over the surface are all but linear in the roll: keep as much as digs in by DIP.
    arm = holds.arms()
    rolled = multiply(pitched, exp(np.stack((roll, zero, zero), axis=-1)))
    level, rolls = (rotate(turn[:, None], arm)[..., 2] for turn in (pitched, rolled))
    share = np.where(rolls < level, (level + DIP) / np.maximum(level - rolls, 1e-9), 1.0)
    roll = roll * np.clip(share.min(axis=1), 0.0, 1.0)
    rolled = multiply(pitched, exp(np.stack((roll, zero, zero), axis=-1)))
    allowed = multiply(holds.quat, rolled)
    # First towards what a contact allows, smoothly; then flat, faded into all that is not flat.
    correction = log(multiply(conjugate(base), allowed))
    quat = multiply(base, exp(blend(np.where(holds.any, _INSIST, 0.0), correction, time)))
    quat = _tipped_up(holds, quat, time)
    quat = multiply(quat, exp(fade(holds.flat, log(multiply(conjugate(quat), holds.quat)), time)))
    quat[holds.flat] = holds.quat[holds.flat]
    return normalized(_kept_out(holds, quat, time))


def _kept_out(holds: Holds, quat: Array, time: float) -> Array:
    """Tip a foot up about the contact that holds, where its sole would still be under the surface.

    The last word on how a foot is turned: what was faded in after the first tip may dig in again.
    A tip is nothing while the foot is flat, and goes on smoothly into the swing.
    """
    need = _tip_to_clear(holds, quat)
    tip = np.zeros(len(quat))
    for sign, contact in ((-1.0, holds.heel), (1.0, holds.toe)):
        mine = np.where(contact & ~holds.flat, need, 0.0)
        if mine.max(initial=0.0) > 0.0:
            tip += sign * envelope(mine, holds.flat, time)
    zero = np.zeros_like(tip)
    quat = multiply(quat, exp(np.stack((zero, tip, zero), axis=-1)))
    return quat if holds.foot.toes is None else _levelled(holds, quat, time)


def _levelled(holds: Holds, quat: Array, time: float) -> Array:
    """Roll a foot whose ball stands, where one end of that would still be under the surface."""
    foot, rolls = holds.foot, holds.toe & ~holds.heel
    roll = np.zeros(len(quat))
    for end in foot.sole[-2:] - foot.toe:  # the ends of the hinge
        height = rotate(multiply(conjugate(holds.quat), quat), end[None])[:, 2]
        deep = np.arcsin(np.clip((-height - DIP) / float(np.linalg.norm(end)), -1.0, 1.0))
        mine = np.where(rolls, deep, 0.0)
        if mine.max(initial=0.0) > 0.0:
            roll += np.sign(end[1]) * envelope(mine, holds.flat, time)
    zero = np.zeros_like(roll)
    return multiply(quat, exp(np.stack((roll, zero, zero), axis=-1)))


def _tip_to_clear(holds: Holds, quat: Array) -> Array:
    """How far a foot on one contact must tip about it for its sole to be clear (nframe,) [rad]."""
    single = holds.any & ~holds.flat
    arm = holds.arms()
    height = rotate(multiply(conjugate(holds.quat), quat)[:, None], arm)[..., 2]
    lowest = height.argmin(axis=1)
    index = np.arange(len(quat))
    lever = np.maximum(np.abs(arm[index, lowest, 0]), SHORT_LEVER)
    return np.where(single, (-height[index, lowest] - DIP) / lever, 0.0)


def _tipped_up(holds: Holds, quat: Array, time: float) -> Array:
    """Tip a foot on one contact up about it where smoothness still lets its other end dig in."""
    single, need = holds.any & ~holds.flat, _tip_to_clear(holds, quat)
    if need.max() <= 0.0:
        return quat
    tip = cover(need, time) * np.where(holds.heel, -1.0, 1.0)
    zero = np.zeros_like(tip)
    tipped = multiply(quat, exp(np.stack((zero, tip, zero), axis=-1)))
    return np.where(single[:, None], tipped, quat)
