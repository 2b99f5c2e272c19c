"""Two clips made one over an overlap: joints blended, the root's path gone on with, contacts kept.

    joined = blend(first, second, contacts, warp)
    joined.motion, joined.contacts, joined.start, joined.end

Joints, and the root's height and lean, go from one clip's to the other's in the tangent space. In
the plane what is blended is how the root moves, in steps along where it faces: so its path never
jumps, and the second clip goes on from where the first has come to.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mjmotion.apps.transition.overlap import headings
from mjmotion.body.sampling import sample
from mjmotion.apps.transition.warp import Warp
from mjmotion.body.kinematics import site_id, site_positions
from mjmotion.body.motion import Motion
from mjmotion.footsteps.contacts import Contact, contact_mask
from mjmotion.numerics.rotations import multiply, rotate, yaw_quat
from mjmotion.numerics.tangent import ominus, oplus

Array = NDArray[np.float64]

SHORTEST = 2  # frames; a contact that is cut shorter is dropped
FLAT = 0.07  # a foot whose heel and toe touch within this comes down flat [s]
PLANTED = 0.06  # over which the speed of a root on standing feet is smoothed [s]
_PAIRED = 0.3  # share of the shorter that two contacts have in common at least to be one


@dataclasses.dataclass(frozen=True, eq=False)
class Blend:
    """Two clips in one, before any fit.

    Attributes:
      motion: the blend.
      contacts: those of both clips, carried through the warp.
      start, end: the overlap: before ``start`` all is the first clip's, from ``end`` on the
        second's, put where the first left off.
      unused: frames of the second clip that it does not reach back to.
    """

    motion: Motion
    contacts: tuple[Contact, ...]
    start: int
    end: int
    unused: int


def blend(
    first: Motion,
    second: Motion,
    contacts: tuple[Sequence[Contact], Sequence[Contact]],
    warp: Warp,
) -> Blend:
    """Return the two clips in one.

    Args:
      first: the clip that is left.
      second: the clip that is gone into, of the same model and rate.
      contacts: of the first, and of the second.
      warp: how they run together.
    """
    start = int(warp.first[0])
    end = start + warp.length
    rest = round(float(warp.second[-1]))
    over = _poses(first, second, warp)
    begun = np.concatenate((first.qpos[:start], over))
    later = placed(second.qpos[rest:], second.qpos[rest], begun[-1])
    qpos = np.concatenate((begun[:-1], later))
    motion = first.replace(qpos)
    kept = _contacts(contacts, warp, motion)
    return Blend(_planted(motion, kept, start, end), kept, start, end, rest)


def _planted(motion: Motion, contacts: Sequence[Contact], start: int, end: int) -> Motion:
    """Return a blend whose root goes, over the overlap, as its standing feet let it.

    Joints between two gaits' move a standing foot against the root at a speed of their own; the
    root is given the opposite one, smoothly, which leaves to the fit what differs between the feet.
    """
    from scipy.ndimage import gaussian_filter1d

    span = slice(start, end + 1)
    model, frames = motion.model, np.arange(start, end + 1)
    total, count = np.zeros((end - start, 2)), np.zeros((end - start, 1))
    for site in sorted({contact.site for contact in contacts}):
        held = contact_mask(contacts, site, motion.nframe)[span]
        held = held[1:] & held[:-1]
        place = site_positions(model, motion.qpos[frames], np.array([site_id(model, site)]))
        total += held[:, None] * np.diff(place[:, 0, :2], axis=0)
        count += held[:, None]
    slip = total / np.maximum(count, 1.0)
    step = -gaussian_filter1d(slip, PLANTED * motion.fps, axis=0, mode="constant")
    qpos = np.array(motion.qpos)
    qpos[start + 1 : end + 1, :2] += np.cumsum(step, axis=0)
    qpos[end + 1 :, :2] += step.sum(axis=0)
    return motion.replace(qpos)


def _poses(first: Motion, second: Motion, warp: Warp) -> Array:
    """Return the poses of the overlap (length + 1, nq)."""
    model = first.model
    mine = first.replace(sample(first, warp.first))
    other = second.replace(sample(second, warp.second))
    paths = [_steps(motion) for motion in (mine, other)]
    share = 0.5 * (warp.share[1:] + warp.share[:-1])[:, None]
    forward, turned = ((1.0 - share) * a + share * b for a, b in zip(*paths, strict=True))
    heading = headings(mine)[0] + np.concatenate(([0.0], np.cumsum(turned[:, 0])))
    middle = 0.5 * (heading[1:] + heading[:-1])
    level = [
        _at(motion, np.zeros((len(heading), 2)), -headings(motion)) for motion in (mine, other)
    ]
    move = warp.share[:, None] * ominus(model, level[1], level[0])
    blended = first.replace(oplus(model, level[0], move))
    step = rotate(yaw_quat(middle), np.column_stack((forward, np.zeros(len(forward)))))[:, :2]
    place = mine.qpos[0, :2] + np.concatenate((np.zeros((1, 2)), np.cumsum(step, axis=0)))
    return _at(blended, place, heading - headings(blended))


def _steps(motion: Motion) -> tuple[Array, Array]:
    """Return how the root moves from frame to frame: in its heading (n - 1, 2), and turns."""
    heading = headings(motion)
    step = np.diff(motion.qpos[:, :3], axis=0) * (1.0, 1.0, 0.0)
    along = rotate(yaw_quat(-0.5 * (heading[1:] + heading[:-1])), step)
    return along[:, :2], np.diff(heading)[:, None]


def _at(motion: Motion, place: Array, turn: Array) -> Array:
    """Return poses with the root at places (n, 2) [m], turned by ``turn`` (n,) [rad]."""
    qpos = np.array(motion.qpos)
    qpos[:, :2] = place
    qpos[:, 3:7] = multiply(yaw_quat(turn), qpos[:, 3:7])
    return qpos


def placed(qpos: Array, origin: Array, target: Array) -> Array:
    """Return poses (n, nq) moved rigidly in the plane, so that ``origin`` comes to ``target``.

    Args:
      qpos: (n, nq) poses.
      origin: (nq,) a pose of them.
      target: (nq,) the pose that is to have the same place and heading after.
    """
    faces = rotate(np.stack((origin[3:7], target[3:7])), np.array((1.0, 0.0, 0.0)))
    yaw = np.arctan2(faces[:, 1], faces[:, 0])
    turn = yaw_quat(np.full(len(qpos), yaw[1] - yaw[0]))
    flat = np.array((1.0, 1.0, 0.0))
    moved = np.array(qpos)
    moved[:, :3] = rotate(turn, qpos[:, :3] - flat * origin[:3]) + flat * target[:3]
    moved[:, 3:7] = multiply(turn, qpos[:, 3:7])
    return moved


def _contacts(
    contacts: tuple[Sequence[Contact], Sequence[Contact]], warp: Warp, motion: Motion
) -> tuple[Contact, ...]:
    """Return the contacts of a blend: pairs of both clips become one, the rest is the stronger's.

    A contact begins and ends where the two clips' do, weighted by their shares at that time.
    """
    sites = sorted({contact.site for given in contacts for contact in given})
    found: list[Contact] = []
    for site in sites:
        spans = []
        for given, when in zip(contacts, (warp.from_first, warp.from_second), strict=True):
            edges = [(c.start - 0.5, c.end - 0.5) for c in given if c.site == site]
            spans.append(when(np.array(edges, dtype=np.float64).reshape(-1, 2)))
        found.extend(_merged(site, spans[0], spans[1], warp, motion.nframe))
    return tuple(sorted(_set_down(found, warp, motion.fps), key=lambda one: (one.start, one.site)))


def _set_down(contacts: Sequence[Contact], warp: Warp, fps: float) -> list[Contact]:
    """Return contacts in which a foot that would roll down in no time comes down flat.

    Where one clip lands on its heels and the other on its toes, the blend lands between.
    """
    begin, end = warp.first[0], warp.first[0] + warp.length
    landed = []
    for contact in contacts:
        side, _, part = contact.site.rpartition("_")
        other = f"{side}_{'toe' if part == 'heel' else 'heel'}"
        starts = [c.start for c in contacts if c.site == other]
        near = [start for start in starts if 0 < start - contact.start <= FLAT * fps]
        if begin < contact.start < end and near and near[0] < contact.end - SHORTEST:
            contact = Contact(contact.site, near[0], contact.end)
        landed.append(contact)
    return landed


def _merged(site: str, mine: Array, others: Array, warp: Warp, nframe: int) -> list[Contact]:
    """Return the contacts of one site from both clips' spans (n, 2), in frames of the result."""
    common = np.minimum(mine[:, None, 1], others[:, 1]) - np.maximum(mine[:, None, 0], others[:, 0])
    spans: list[Array] = []
    left = [set(range(len(mine))), set(range(len(others)))]
    for row, column in sorted(np.ndindex(common.shape), key=lambda pair: -common[pair]):
        length = min(float(np.ptp(mine[row])), float(np.ptp(others[column])))
        if common[row, column] > _PAIRED * length and row in left[0] and column in left[1]:
            middle = 0.5 * (mine[row] + others[column])
            shares = warp.share_at(middle)
            spans.append((1.0 - shares) * mine[row] + shares * others[column])
            left[0].discard(row)
            left[1].discard(column)
    for own, rows, second in ((mine, left[0], False), (others, left[1], True)):
        for row in rows:
            share = float(warp.share_at(own[row].mean(keepdims=True))[0])
            if (share > 0.5) == second:
                spans.append(own[row])
    contacts: list[Contact] = []
    for span in sorted(spans, key=lambda span: float(span[0])):
        start, end = (int(np.clip(round(float(edge) + 0.5), 0, nframe)) for edge in span)
        start = max(start, contacts[-1].end if contacts else 0)
        if end - start >= SHORTEST or (end == nframe and end > start):
            contacts.append(Contact(site, start, end))
    return contacts
