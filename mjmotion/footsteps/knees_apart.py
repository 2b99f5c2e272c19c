"""Knees turn outwards where legs would meet that do not in the source.

Feet have their places, and the body has its way. What is left to a leg is its swivel about the
line from hip to ankle: it takes the knee aside and leaves both ends where they are. A curve over
time for each leg is the smallest smooth one that takes them apart; both turn as far where both can.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.character import Character
from mjmotion.body.kinematics import Kinematics, level_side
from mjmotion.body.limbs import Limbs
from mjmotion.body.motion import Motion
from mjmotion.footsteps.clearances import BodyClearances
from mjmotion.footsteps.self_clearance import SelfClearance
from mjmotion.ik.solver import Clearance
from mjmotion.numerics.rotations import cross, dot, norm, rotate
from mjmotion.numerics.smoothing import Bound, between
from mjmotion.numerics.tangent import oplus

Array = NDArray[np.float64]
Index = NDArray[np.int64]

MOST = 0.6  # the most that a leg is swivelled [rad]
RUNG = 0.04  # steps in which it is tried how far it must be [rad]
SWIVEL_TIME = 0.1  # scale of a swivel's rise and fall [s]
_ROUNDS = 4
_SLACK = 0.001  # what is still lacking after that is left [m]
_WITHIN = 0.02  # how far within what its joints allow a swivel is kept [rad]
_LIMIT = 1e-9  # a joint further out of its range than before by more is out of it [rad]
_INSIST = 100.0  # penalty for too small a swivel, against its stiffness; tenfold for too large
_NONE = 1e-5  # a swivel this small is none [rad]


def knees_apart(motion: Motion, source: Motion) -> Motion:
    """Return the motion with its knees turned outwards where its legs are in each other.

    Both ends of each leg stay where they are. A motion in which no leg comes nearer to the other
    than it is in the source, at the same frame, is returned as it is.

    Args:
      motion: the motion, on the character alone.
      source: the one that says what is near enough; as many frames, on the same character.
    """
    limbs = _legs(motion.character)
    if limbs is None:
        return motion
    kinematics = Kinematics(motion.model, motion.nframe, geoms=True)
    ours, theirs = ({limb.upper, limb.lower, limb.end} for limb in limbs.limbs)
    legs = SelfClearance(source, kinematics, ours, others=theirs)
    frames = np.arange(motion.nframe)
    inside = BodyClearances(kinematics, (legs.at_margin(0.0),))
    if len(inside(motion.qpos, frames).frame) == 0:
        return motion
    swivels = _Swivels(motion, limbs)
    keep = BodyClearances(kinematics, (legs,))
    none = np.zeros((motion.nframe, 2))
    lacked = _lacking(keep, motion.qpos, frames)
    need, curves, lack = none.copy(), none, lacked
    for _ in range(_ROUNDS):
        low = np.flatnonzero(lack > _SLACK)
        if len(low) == 0:
            break
        need[low] = np.maximum(need[low], swivels.least(keep, low, curves[low]))
        curves = swivels.smooth(need)
        lack = _lacking(keep, swivels.posed(curves, frames), frames)
    curves = _that_help(curves, lacked, lack)
    return motion.replace(swivels.posed(curves, frames)) if curves.any() else motion


def _legs(character: Character) -> Limbs | None:
    """Return the limbs that end in feet; None where these are not two of their own on one body."""
    ends = [character.limb_by_end.get(foot.body) for foot in character.feet]
    found = tuple(limb for limb in ends if limb is not None)
    if len(found) != 2 or len(ends) != 2 or found[0].base != found[1].base:
        return None
    limbs, coupling = character.chains(found), character.coupling
    coupled = np.isin(limbs.dofs, np.concatenate((coupling.leader, coupling.follower)))
    return None if coupled.any() else limbs


def _lacking(keep: Clearance, qpos: Array, frames: Index) -> Array:
    """Return how much poses (n, nq) lack (n,) [m]; 0 where they lack nothing."""
    found = keep(qpos, frames)
    lack = np.zeros(len(qpos))
    np.maximum.at(lack, found.frame, found.needed)
    return lack


def _that_help(curves: Array, before: Array, after: Array) -> Array:
    """Return the curves (nframe, 2) without swivels that leave legs as deep in each other."""
    from scipy.ndimage import label, maximum

    part, count = label(curves.any(axis=1))
    numbers = np.arange(count + 1)
    most = [np.asarray(maximum(lack, part, numbers)) for lack in (before, after)]
    return np.where((most[1] < most[0])[part][:, None], curves, 0.0)


class _Swivels:
    """A motion whose legs swivel outwards."""

    def __init__(self, motion: Motion, limbs: Limbs) -> None:
        self._motion = motion
        self._limits = motion.character.limits
        state = limbs.state(motion.qpos)
        _, _, rates = limbs.closure(state)
        pose = Kinematics(motion.model, motion.nframe).forward(motion.qpos)
        knee = pose.xpos[:, [limb.lower for limb in limbs.limbs]] - state.hip
        line = rotate(state.base_quat, state.ankle / norm(state.ankle)[..., None])
        # Away from the other leg, which hangs on the other side of the body.
        side = level_side(pose)
        apart = dot(state.hip[:, 0] - state.hip[:, 1], side).mean()
        out = np.sign(apart) * np.array((1.0, -1.0)) * dot(cross(line, knee), side[:, None])
        self._unit = np.zeros((2, motion.nframe, motion.model.nv))
        for number, dofs in enumerate(limbs.dofs):
            # One sign a leg: where it is straight, which way is out is what it mostly is.
            self._unit[number][:, dofs] = np.sign(out[:, number].sum()) * rates[:, number]
        self._most = np.column_stack([self._allowed(number) for number in range(2)])

    def posed(self, curves: Array, frames: Index) -> Array:
        """Return poses (n, nq) at ``frames`` (n,), swivelled by (n, 2) [rad]."""
        qpos = self._motion.qpos[frames]
        step = np.einsum("nk,knv->nv", curves, self._unit[:, frames])
        swivelled = oplus(self._motion.model, qpos, step)
        return np.where(curves.any(axis=1, keepdims=True), swivelled, qpos)

    def least(self, keep: Clearance, frames: Index, curves: Array) -> Array:
        """Return the least swivels (n, 2) [rad] that lack nothing, or leave the least."""
        found, rest = np.array(curves), np.full(len(frames), np.inf)
        left = np.arange(len(frames))
        for rung in np.arange(1, round(MOST / RUNG) + 1) * RUNG:
            at = frames[left]
            tried = np.minimum(np.maximum(rung, curves[left]), self._most[at])
            lack = _lacking(keep, self.posed(tried, at), at)
            better = lack < rest[left] - _SLACK
            found[left[better]], rest[left[better]] = tried[better], lack[better]
            left = left[lack > _SLACK]
            if len(left) == 0:
                break
        return found

    def smooth(self, need: Array) -> Array:
        """Return smooth curves (nframe, 2) [rad] over what is needed, under what joints allow."""
        time = SWIVEL_TIME * self._motion.fps
        price, always = _INSIST * time**6, np.ones(len(need), dtype=bool)
        curves = np.empty_like(need)
        for number in range(2):
            most = self._most[:, number]
            low = Bound(np.minimum(need[:, number], most), always, price, upper=False)
            high = Bound(most, always, 10.0 * price, upper=True)
            curves[:, number] = between(np.zeros(len(need)), time, (low, high))
        allowed = self._most + np.where(self._most > 0.0, _WITHIN, 0.0)
        return np.where(curves > _NONE, np.minimum(curves, allowed), 0.0)

    def _allowed(self, number: int) -> Array:
        """Return how far a leg may be swivelled (nframe,) [rad] for its joints."""
        frames = np.arange(self._motion.nframe)
        least = self._limits.excess(self._motion.qpos).max(axis=1, initial=0.0) + _LIMIT
        most, inside = np.zeros(len(frames)), np.ones(len(frames), dtype=bool)
        for rung in np.arange(1, round(MOST / RUNG) + 1) * RUNG:
            tried = np.zeros((len(frames), 2))
            tried[:, number] = rung
            excess = self._limits.excess(self.posed(tried, frames)).max(axis=1, initial=0.0)
            inside &= excess <= least
            most[inside] = rung
        return np.maximum(most - _WITHIN, 0.0)
