"""Knees, palms and the seat on the ground: where they rest on a scene, and what goes along.

What rests in the clip is put on the ground under it, as a whole for as long as it rests. A foot
goes along with its knee, and the root with the seat; palms are laid flat. A clip without such
contacts asks nothing of all this.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.feet import Foot
from mjmotion.body.kinematics import Pose, site_id
from mjmotion.body.motion import Motion
from mjmotion.constraints import SiteConstraint
from mjmotion.footsteps.contacts import Contact, contact_mask
from mjmotion.footsteps.paths import FootPath
from mjmotion.footsteps.swings import frames_to
from mjmotion.numerics.rotations import (
    between,
    conjugate,
    continuous,
    exp,
    from_matrix,
    log,
    multiply,
    rotate,
)
from mjmotion.numerics.smoothing import cover, ease
from mjmotion.scene.ground import Ground

Array = NDArray[np.float64]

BLEND_TIME = 0.25  # over which a foot that stood begins to go along with its knee [s]
CLEAR_TIME = 0.1  # how far on either side it is felt that a foot keeps out of the ground [s]
SHORT_SHANK = 0.1  # least way from knee to foot that a slope is reckoned with [m]
_CLEARS = 2  # times that it is looked whether it must turn further for that
FLAT_MOST = 1.05  # a palm is laid flat that is off it by no more [rad]


@dataclasses.dataclass(frozen=True, eq=False)
class Rest:
    """What rests on the ground.

    Attributes:
      contact: of what, and when.
      position: (3,) where its site is to be [m].
      quat: (4,) how its site is to be turned, wxyz; None where that is left to the rest.
      shift: (3,) how far that is from where it is in the source [m].
    """

    contact: Contact
    position: Array
    quat: Array | None
    shift: Array

    def constraint(self) -> SiteConstraint:
        """Return it as a constraint."""
        frames = np.arange(self.contact.start, self.contact.end)
        quat = None if self.quat is None else np.tile(self.quat, (len(frames), 1))
        position = np.tile(self.position, (len(frames), 1))
        return SiteConstraint(
            self.contact.site, frames, position, quat, contact=True, source="scene"
        )


def find_rests(
    source: Motion, pose: Pose, contacts: Sequence[Contact], ground: Ground
) -> tuple[Rest, ...]:
    """Put what rests in a motion on the ground; where there is none, it stays as high as it is."""
    rests = []
    for contact in contacts:
        if not contact.rests:
            continue
        site = site_id(source.model, contact.site)
        place = pose.site_xpos[contact.start : contact.end, site].mean(axis=0)
        height, normal = ground.under(place[None])
        known = not np.isnan(height[0])
        position = np.array((*place[:2], height[0] if known else place[2]))
        quat = None
        if known and contact.site.endswith("_palm"):
            middle = (contact.start + contact.end) // 2
            own = from_matrix(pose.site_xmat[middle, site])
            # A palm is on the side of its hand that its site is on.
            out = np.array((0.0, np.sign(source.model.site_pos[site, 1]), 0.0))
            turn = between(rotate(own, out), -normal[0])
            quat = multiply(turn, own) if np.linalg.norm(log(turn)) < FLAT_MOST else None
        rests.append(Rest(contact, position, quat, position - place))
    return tuple(rests)


def kneeling(
    foot: Foot,
    path: FootPath,
    pose: Pose,
    rests: Sequence[Rest],
    ground: Ground,
    fps: float,
) -> FootPath:
    """Return the path of a foot that goes along with its knee while that rests.

    It is turned as in the source, with the ground between it and the knee, and kept out of that.

    Args:
      foot: the foot.
      path: where it would go.
      pose: the source, every frame.
      rests: what rests.
      ground: the scene's surfaces.
      fps: frames a second.
    """
    mine = [one for one in rests if one.contact.site == f"{foot.side}_knee"]
    if not mine:
        return path
    share = _share(mine, path.stance, len(path.position), fps)
    site = site_id(pose.model, foot.site)
    own, bend = continuous(from_matrix(pose.site_xmat[:, site])), foot.bend(pose)
    place, quat = pose.site_xpos[:, site] + along(mine, len(share)), own
    # A shank lies as the ground does, turned about its knee; and further where the foot is in that.
    knee = pose.site_xpos[:, site_id(pose.model, mine[0].contact.site)] + along(mine, len(share))
    (under, below), way = (ground.under(p)[0] for p in (place, knee)), place - knee
    rise = np.where(np.isnan(under - below), 0.0, under - below)
    far = np.maximum(np.linalg.norm(way[:, :2], axis=1), SHORT_SHANK)
    across = np.column_stack((way[:, 1], -way[:, 0], np.zeros(len(way)))) / far[:, None]
    angle = np.arctan2(rise, far)
    for _ in range(_CLEARS + 1):
        tilt = exp(angle[:, None] * across)
        place, quat = knee + rotate(tilt, way), multiply(tilt, own)
        points = place[:, None] + rotate(quat[:, None], foot.shape_at(bend))
        height, _ = ground.under(points)
        deep = np.where(np.isnan(height), 0.0, height - points[..., 2]).max(axis=1)
        angle = angle + cover(np.where(share > 0.0, np.arctan2(deep, far), 0.0), CLEAR_TIME * fps)
    turn = log(multiply(conjugate(path.quat), quat))
    return dataclasses.replace(
        path,
        position=path.position + share[:, None] * (place - path.position),
        quat=multiply(path.quat, exp(share[:, None] * turn)),
        shift=path.shift + share[:, None] * (along(mine, len(share)) - path.shift),
        toes=path.toes + share * (bend - path.toes),
        lift=path.lift * (1.0 - share),
    )


def sitting(shift: Array, rests: Sequence[Rest], fps: float) -> Array:
    """Return the root's shift (nframe, 3) [m] as it goes along with what the character sits on."""
    mine = [one for one in rests if one.contact.site.endswith("seat")]
    if not mine:
        return shift
    share = _share(mine, np.zeros(len(shift), dtype=bool), len(shift), fps, BLEND_TIME)
    return np.asarray(shift + share[:, None] * (along(mine, len(shift)) - shift))


def along(rests: Sequence[Rest], nframe: int) -> Array:
    """Return the shift (nframe, 3) [m] of what rests: constant while it does, eased between."""
    shift = np.empty((nframe, 3))
    ordered = sorted(rests, key=lambda one: one.contact.start)
    shift[:] = ordered[0].shift
    for before, after in itertools.pairwise(ordered):
        count = max(after.contact.start - before.contact.end, 0)
        share = ease((np.arange(count) + 1.0) / (count + 1.0))[:, None]
        shift[after.contact.start - count : after.contact.start] = before.shift + share * (
            after.shift - before.shift
        )
        shift[after.contact.start :] = after.shift
    return shift


def _share(
    rests: Sequence[Rest],
    stance: NDArray[np.bool_],
    nframe: int,
    fps: float,
    fades: float | None = None,
) -> Array:
    """Return how far (nframe,) something goes along with what rests, from 0 to 1.

    Not at all where it stands itself; between by what is nearer in time, or within ``fades`` [s].
    """
    rest = contact_mask([one.contact for one in rests], rests[0].contact.site, nframe)
    apart, near = frames_to(stance) / fps, frames_to(rest) / fps
    if fades is not None:
        return np.asarray(1.0 - ease(np.clip(near / fades, 0.0, 1.0)))
    with np.errstate(invalid="ignore"):
        nearer = np.where(np.isinf(apart), 1.0, apart / np.maximum(apart + near, 1e-9))
    return np.asarray(ease(nearer) * ease(np.clip(apart / BLEND_TIME, 0.0, 1.0)))
