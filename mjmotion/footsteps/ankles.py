"""Feet give where ankles cannot: on steep ground the heel rises sooner than it did in the source.

A foot flat on a slope asks its ankle for the slope on top of the source's own bend, which can be
more than an ankle has. A person then rolls on to the toe earlier. Here the feet's targets are
turned back, smoothly and about the toe, by what the ankle lacks, and heel contacts end where that
takes the heel off the ground.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.feet import Foot
from mjmotion.body.joint_limits import from_swing_twist, swing_twist
from mjmotion.body.kinematics import site_id
from mjmotion.body.limbs import Limbs, LimbState
from mjmotion.body.motion import Motion
from mjmotion.footsteps.contacts import Contact, contact_mask
from mjmotion.footsteps.footholds import Foothold
from mjmotion.footsteps.paths import FootPath, turned_about_toes
from mjmotion.footsteps.stances import Stance
from mjmotion.footsteps.swings import frames_to
from mjmotion.numerics.rotations import conjugate, exp, multiply, rotate
from mjmotion.numerics.smoothing import cover, ease, envelope

Array = NDArray[np.float64]

MARGIN = 0.03  # how far within its range an ankle is kept [rad]
GIVE_TIME = 0.06  # how far on either side a giving is felt [s]
SHORTEST = 0.07  # what is left of a contact is dropped when it is shorter [s]
MOST_LACK = 0.35  # the most that a foot is turned back at a time [rad]
MOST_TURN = 0.2  # the most that a foothold is turned for that [rad]
_SPARE = 0.02  # more than it lacks, for what the root still does [rad]
_ROUNDS = 3
_FREE = 3.0  # times GIVE_TIME after which a foot that left the ground turns as it likes
HEEL_PULL = 20.0  # acceleration with which a heel leaves the ground [m/s²]
_EDGE = 0.002  # of its range that an ankle is never planned to be at [rad]
SLACK = 0.025  # what an ankle may use of the margin before anything gives [rad]
_GIVES = 5e-4  # a foot that is turned back by less has no more to give [rad]
_LIFTED = 2e-4  # a heel this far off its foothold no longer stands [m]
_ROLLED = 5e-4  # a ball this far off its foothold has been rolled off, over the tip of the toes [m]


def relax_ankles(
    motion: Motion,
    feet: Sequence[Foot],
    paths: Sequence[FootPath],
    contacts: Sequence[Contact],
    source: Motion | None = None,
) -> tuple[tuple[FootPath, ...], tuple[Contact, ...]]:
    """Return paths that the ankles can follow, and the contacts that are left.

    Args:
      motion: the source with its root where it will about be.
      feet: the feet.
      paths: one a foot.
      contacts: all contacts.
      source: what says how far ankles are bent anyway; ``motion`` without.
    """
    source = motion if source is None else source
    ends = motion.character.limb_by_end
    given, left = list(paths), list(contacts)
    boxes = [_ankle_box(source, foot) if foot.body in ends else None for foot in feet]
    numbers = [number for number, box in enumerate(boxes) if box is not None]
    if not numbers:
        return tuple(given), tuple(left)
    mine = [feet[number] for number in numbers]
    limbs = motion.character.chains(tuple(ends[foot.body] for foot in mine))
    state = limbs.state(motion.qpos)
    turning = dict.fromkeys(numbers, True)
    for _ in range(_ROUNDS):
        ankles = _ankles(limbs, state, mine, [given[number] for number in numbers])
        for column, number in enumerate(numbers):
            foot, box = feet[number], boxes[number]
            if box is None or not turning[number]:
                continue
            heel = contact_mask(contacts, f"{foot.side}_heel", motion.nframe)
            allowed = (heel, box)
            turned = _turn_back(motion, foot, given[number], ankles[:, column], allowed)
            turning[number] = turned is not None
            given[number] = given[number] if turned is None else turned
        if not any(turning.values()):
            break
    for foot, flat, path in zip(feet, paths, given, strict=True):
        if path is not flat:
            left = trim_heel_contacts(left, foot, flat, path, SHORTEST * motion.fps)
    return tuple(given), tuple(left)


def turned_footholds(
    motion: Motion,
    feet: Sequence[Foot],
    paths: Sequence[FootPath],
    stances: Sequence[Stance],
    footholds: Sequence[Foothold],
) -> tuple[Foothold, ...]:
    """Return footholds turned in their planes where a foot is turned in or out too far to stand so.

    One turn a stance, about the middle of the foot: what stands does not pivot.

    Args:
      motion: the source with its root where it will about be.
      feet: the feet.
      paths: one a foot.
      stances: all stances.
      footholds: one a stance.
    """
    turned = list(footholds)
    for index, (foot, path) in enumerate(zip(feet, paths, strict=True)):
        limb, box = motion.character.limb_by_end.get(foot.body), _ankle_box(motion, foot)
        if limb is None or box is None:
            continue
        twist = _ankle(motion, foot, path)[:, 2]
        over, under = twist - box[:, 2, 3], box[:, 2, 2] - twist
        for number, stance in enumerate(stances):
            if stance.foot != index or stance.heel[1] == stance.heel[0] or stance.pivot:
                continue
            span = slice(*stance.heel)
            turn = max(0.0, float(under[span].max())) - max(0.0, float(over[span].max()))
            if turn == 0.0:
                continue
            turn = float(np.clip(turn + np.copysign(_SPARE, turn), -MOST_TURN, MOST_TURN))
            old = footholds[number]
            quat = multiply(old.quat, exp(np.array((0.0, 0.0, turn))))
            middle = 0.5 * (foot.heel + foot.front)
            position = old.position + rotate(old.quat, middle) - rotate(quat, middle)
            turned[number] = dataclasses.replace(old, position=position, quat=quat)
    return tuple(turned)


def flat_landings(
    motion: Motion, feet: Sequence[Foot], paths: Sequence[FootPath], stances: Sequence[Stance]
) -> tuple[Stance, ...]:
    """Return stances that land on heel and toe together where the ankle cannot land on the heel.

    Uphill a person sets the foot down flat, or on its ball: on a heel alone it would be steeper
    still, and where that heel had to give, nothing would stand.

    Args:
      motion: the source with its root where it will about be.
      feet: the feet.
      paths: one a foot.
      stances: all stances.
    """
    landed = list(stances)
    for index, (foot, path) in enumerate(zip(feet, paths, strict=True)):
        limb, box = motion.character.limb_by_end.get(foot.body), _ankle_box(motion, foot)
        if limb is None or box is None:
            continue
        ankle = _ankle(motion, foot, path)
        beyond = np.any((ankle < box[..., 2]) | (ankle > box[..., 3]), axis=1)
        for number, stance in enumerate(stances):
            (heel, off), (toe, end) = stance.heel, stance.toe
            on_heel = stance.foot == index and heel < toe <= off and toe < end
            if on_heel and beyond[heel:toe].any():
                landed[number] = dataclasses.replace(stance, toe=(heel, end))
    return tuple(landed)


def _ankle(motion: Motion, foot: Foot, path: FootPath) -> Array:
    """Return how an ankle is bent (nframe, 3) [rad] where its foot is as its path says."""
    limbs = motion.character.chains((motion.character.limb_by_end[foot.body],))
    return _ankles(limbs, limbs.state(motion.qpos), [foot], [path])[:, 0]


def _ankles(
    limbs: Limbs, state: LimbState, feet: Sequence[Foot], paths: Sequence[FootPath]
) -> Array:
    """Return the same of all feet (nframe, nfoot, 3), the limbs' own, in their order."""
    model = limbs.model
    sites = [site_id(model, foot.site) for foot in feet]
    position = np.stack([path.position for path in paths], axis=1)
    quat = np.stack([path.quat for path in paths], axis=1)
    end_quat = multiply(quat, conjugate(model.site_quat[sites]))
    goal = limbs.goal(state, position, end_quat, model.site_pos[sites])
    end = multiply(conjugate(state.base_quat), end_quat)
    displacement = limbs.close(state, goal, end)
    return swing_twist(limbs.ankle_turn(state, displacement))


def _ankle_box(source: Motion, foot: Foot) -> Array | None:
    """Return how far an ankle may bend, and when it must give (nframe, 3, 4) [rad].

    It may bend to a margin within its range, or, where the source bends it further, as far as that:
    low and high, and low and high that it is not let beyond. None where it has no such range.
    """
    model = source.model
    joint = int(model.body_jntadr[foot.body])
    range_ = source.character.limits.boxes.get(joint)
    if range_ is None:
        return None
    at = int(model.jnt_qposadr[joint])
    own = swing_twist(source.qpos[:, at : at + 4])
    low = np.maximum(np.minimum(range_[:, 0] + MARGIN, own), range_[:, 0] + _EDGE)
    high = np.minimum(np.maximum(range_[:, 1] - MARGIN, own), range_[:, 1] - _EDGE)
    # Near the very end of a range there is less to spare before anything must give.
    spare = np.minimum(low - range_[:, 0], range_[:, 1] - high) - _EDGE
    slack = np.clip(spare, 0.0, SLACK)
    return np.stack((low, high, low - slack, high + slack), axis=-1)


def _turn_back(
    motion: Motion,
    foot: Foot,
    path: FootPath,
    ankle: Array,
    allowed: tuple[NDArray[np.bool_], Array],
) -> FootPath | None:
    """Turn a path back by what its ankle (nframe, 3) [rad] lacks; None when it lacks nothing.

    ``allowed`` is when the heel stands (nframe,) and how far the ankle may bend (nframe, 3, 4).
    What lacks while the heel stands is felt a little before and after; what lacks elsewhere takes
    no heel off the ground.
    """
    model, (heel, box) = motion.model, allowed
    low, high = box[..., 0], box[..., 1]
    if not ((ankle < box[..., 2]) | (ankle > box[..., 3])).any():
        return None
    # What is far out of range is out of reach, which turning a foot does not mend.
    ankle = np.clip(ankle, low - MOST_LACK, high + MOST_LACK)
    lack = np.zeros_like(ankle)
    stays = _stays_down(ankle, box, heel, foot, motion.fps)
    time = GIVE_TIME * motion.fps
    free = ease(frames_to(heel) / (_FREE * time))
    for axis in range(3):
        for sign, over in (
            (1.0, (low - ankle)[:, axis]),
            (-1.0, (ankle - high)[:, axis]),
        ):
            if over.max() <= 0.0:
                continue
            given = envelope(np.where(heel, over, 0.0), stays, time)
            rest = cover(np.where(heel, 0.0, over - given), time) * free
            lack[:, axis] += sign * (given + rest)
    if not lack.any():
        return None
    back = multiply(conjugate(from_swing_twist(ankle)), from_swing_twist(ankle + lack))
    to_site = model.site_quat[site_id(model, foot.site)]
    back = multiply(multiply(conjugate(to_site), back), to_site)
    quat = multiply(path.quat, back)
    # Always about the toe: the heel goes up, and nothing goes down.
    turned = turned_about_toes(path, foot, quat)
    gives = np.abs(multiply(conjugate(path.quat), turned.quat)[:, 1:]).max() > _GIVES
    return turned if gives else None


def trim_toe_contacts(
    contacts: Sequence[Contact],
    feet: Sequence[Foot],
    paths: Sequence[FootPath],
    spots: tuple[Sequence[Stance], Sequence[Foothold]],
    shortest: float,
) -> tuple[Contact, ...]:
    """Cut contacts of toes to the stretches in which the ball is down: a foot may roll on its tip.

    Args:
      contacts: all contacts.
      feet: all feet, as the stances number them.
      paths: where some or all of them go.
      spots: all stances, and one foothold each.
      shortest: a stretch shorter than this no longer counts as a contact [frames].
    """
    left = list(contacts)
    index = {foot.site: number for number, foot in enumerate(feet)}
    for path in paths:
        foot = feet[index[path.site]]
        if foot.toes is None:
            continue
        ball = path.position + rotate(path.quat, foot.toe)
        lifted = np.zeros(len(ball), dtype=bool)
        for stance, foothold in zip(*spots, strict=True):
            if stance.foot == index[path.site]:
                span = slice(*stance.toe)
                position, quat = foothold.position, foothold.quat
                if stance.pivot is not None:
                    position, quat = stance.pivot.posed(foot, position, quat)
                    first = stance.toe[0] - stance.start
                    last = stance.toe[1] - stance.start
                    position, quat = position[first:last], quat[first:last]
                place = position + rotate(quat, foot.toe)
                lifted[span] = np.linalg.norm(ball[span] - place, axis=1) > _ROLLED
        left = _cut(left, f"{foot.side}_toe", lifted, shortest)
    return tuple(left)


def _stays_down(
    ankle: Array, box: Array, heel: NDArray[np.bool_], foot: Foot, fps: float
) -> NDArray[np.bool_]:
    """Return when a standing heel stays where it is (nframe,): away from where its ankle lacks.

    A heel that must be off the ground by a height h has left it √(2 h / HEEL_PULL) before.
    """
    over = np.maximum(box[..., 0] - ankle, ankle - box[..., 1]).max(axis=1)
    beyond = np.maximum(box[..., 2] - ankle, ankle - box[..., 3]).max(axis=1) > 0.0
    lifts = heel & beyond
    lever = float(np.linalg.norm(foot.toe - foot.heel))
    rise = np.where(lifts, np.sqrt(2.0 * lever * np.maximum(over, 0.0) / HEEL_PULL) * fps, 0.0)
    frames = np.flatnonzero(lifts)
    stays = heel.copy()
    for frame, reach in zip(frames, np.ceil(rise[frames]).astype(int), strict=True):
        stays[max(0, frame - reach) : frame + reach + 1] = False
    return stays


def trim_heel_contacts(
    contacts: Sequence[Contact], foot: Foot, flat: FootPath, path: FootPath, shortest: float
) -> list[Contact]:
    """Cut a foot's heel contacts to the stretches in which the heel is still down.

    Args:
      contacts: all contacts.
      foot: the foot.
      flat: its path before it was turned back.
      path: its path after.
      shortest: a stretch shorter than this no longer counts as a contact [frames].
    """
    before = flat.position + rotate(flat.quat, foot.heel)
    after = path.position + rotate(path.quat, foot.heel)
    lifted = np.linalg.norm(after - before, axis=1) > _LIFTED
    return _cut(contacts, f"{foot.side}_heel", lifted, shortest)


def _cut(
    contacts: Sequence[Contact], site: str, lifted: NDArray[np.bool_], shortest: float
) -> list[Contact]:
    """Return the contacts, those of a site without the frames (nframe,) in which it is off."""
    kept = []
    for contact in contacts:
        if contact.site != site or not lifted[contact.start : contact.end].any():
            kept.append(contact)
            continue
        down = np.concatenate(([0], ~lifted[contact.start : contact.end], [0])).astype(np.int8)
        for start, end in np.flatnonzero(np.diff(down)).reshape(-1, 2).tolist():
            if end - start >= shortest:
                kept.append(Contact(contact.site, contact.start + start, contact.start + end))
    return sorted(kept, key=lambda contact: (contact.start, contact.site))
