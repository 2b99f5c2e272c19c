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
from mjmotion.body.limbs import Limbs
from mjmotion.body.motion import Motion
from mjmotion.footsteps.contacts import Contact, contact_mask
from mjmotion.footsteps.paths import FootPath
from mjmotion.numerics.rotations import conjugate, multiply, rotate
from mjmotion.numerics.smoothing import cover, envelope

Array = NDArray[np.float64]

MARGIN = 0.02  # how far within its range an ankle is kept [rad]
GIVE_TIME = 0.06  # how far on either side a giving is felt [s]
SHORTEST = 0.07  # what is left of a contact is dropped when it is shorter [s]
MOST_LACK = 0.35  # the most that a foot is turned back at a time [rad]
_ROUNDS = 3
SLACK = 0.018  # what an ankle may use of the margin before anything gives [rad]
_LIFTED = 5e-4  # a heel this far off its foothold no longer stands [m]


def relax_ankles(
    motion: Motion, feet: Sequence[Foot], paths: Sequence[FootPath], contacts: Sequence[Contact]
) -> tuple[tuple[FootPath, ...], tuple[Contact, ...]]:
    """Return paths that the ankles can follow, and the contacts that are left.

    Args:
      motion: the source with its root where it will about be.
      feet: the feet.
      paths: one a foot.
      contacts: all contacts.
    """
    given: list[FootPath] = []
    left = list(contacts)
    for foot, path in zip(feet, paths, strict=True):
        limb = motion.character.limb_by_end.get(foot.body)
        if limb is not None:
            limbs = motion.character.chains((limb,))
            heel = contact_mask(left, f"{foot.side}_heel", motion.nframe)
            flat = path
            for _ in range(_ROUNDS):
                turned = _turn_back(motion, limbs, foot, path, heel)
                if turned is None:
                    break
                path = turned
            if path is not flat:
                left = trim_heel_contacts(left, foot, flat, path, SHORTEST * motion.fps)
        given.append(path)
    return tuple(given), tuple(left)


def _turn_back(
    motion: Motion, limbs: Limbs, foot: Foot, path: FootPath, heel: NDArray[np.bool_]
) -> FootPath | None:
    """Turn a path back by what its ankle lacks; None when it lacks nothing.

    What it lacks while the heel stands (nframe,) is felt a little before and after; what it lacks
    elsewhere takes no heel off the ground.
    """
    model = motion.model
    joint = int(model.body_jntadr[foot.body])
    box = motion.character.limits.boxes.get(joint)
    if box is None:
        return None
    site = site_id(model, foot.site)
    state = limbs.state(motion.qpos)
    end_quat = multiply(path.quat, conjugate(model.site_quat[site]))
    goal = limbs.goal(state, path.position[:, None], end_quat[:, None], model.site_pos[site][None])
    end = multiply(conjugate(state.base_quat), end_quat[:, None])
    displacement = limbs.close(state, goal, end)
    ankle = swing_twist(limbs.ankle_turn(state, displacement)[:, 0])
    if not ((ankle < box[:, 0] + MARGIN - SLACK) | (ankle > box[:, 1] - MARGIN + SLACK)).any():
        return None
    # What is far out of range is out of reach, which turning a foot does not mend.
    ankle = np.clip(ankle, box[:, 0] - MOST_LACK, box[:, 1] + MOST_LACK)
    lack = np.zeros_like(ankle)
    time = GIVE_TIME * motion.fps
    for axis in range(3):
        for sign, over in (
            (1.0, box[axis, 0] + MARGIN - ankle[:, axis]),
            (-1.0, ankle[:, axis] - box[axis, 1] + MARGIN),
        ):
            given = cover(np.where(heel, over, 0.0), time)
            lack[:, axis] += sign * (given + envelope(over - given, heel, time))
    if not lack.any():
        return None
    back = multiply(conjugate(from_swing_twist(ankle)), from_swing_twist(ankle + lack))
    to_site = model.site_quat[site]
    back = multiply(multiply(conjugate(to_site), back), to_site)
    quat = multiply(path.quat, back)
    # Always about the toe: the heel goes up, and nothing goes down.
    position = path.position + rotate(path.quat, foot.toe) - rotate(quat, foot.toe)
    return dataclasses.replace(path, position=position, quat=quat)


def trim_heel_contacts(
    contacts: Sequence[Contact], foot: Foot, flat: FootPath, path: FootPath, shortest: float
) -> list[Contact]:
    """Cut a foot's heel contacts to the longest stretch in which the heel is still down.

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
    kept = []
    for contact in contacts:
        if contact.site != f"{foot.side}_heel" or not lifted[contact.start : contact.end].any():
            kept.append(contact)
            continue
        down = np.concatenate(([0], ~lifted[contact.start : contact.end], [0])).astype(np.int8)
        runs = np.flatnonzero(np.diff(down)).reshape(-1, 2)
        if len(runs):
            start, end = runs[np.argmax(runs[:, 1] - runs[:, 0])]
            if end - start < shortest:
                continue
            kept.append(Contact(contact.site, contact.start + int(start), contact.start + int(end)))
    return sorted(kept, key=lambda contact: (contact.start, contact.site))
