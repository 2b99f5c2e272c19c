"""What feet stand on in every frame, and which of the source's stances the contacts kept."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.validation.ground import Ground
from mjmotion.validation.inputs import Contact, stands

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FRICTION = 0.8  # where nothing is known of the ground
SLOW, LOW = 0.08, 0.02  # [m/s], [m] a site slower and no higher than this surely stands
_ASIDE = 1e-3  # [m] between the points whose heights give a normal
_STEEPEST = 0.2  # upward part of a normal; what is steeper is an edge between two heights


@dataclasses.dataclass(frozen=True, eq=False)
class Support:
    """What feet stand on.

    Attributes:
      held: (nframe, nsite) whether a site stands.
      place: (nframe, nsite, 3) sites [m].
      along: (nframe, nsite, 3) from a site to another of its foot [m]; 0 where there is none.
      normal: (nframe, nsite, 3) of the ground under each, of unit length.
      friction: (nframe, nsite) its coefficient.
      height: (nframe, nsite) of the ground [m]; NaN out of contact, infinite where there is none.
    """

    held: Mask
    place: Array
    along: Array
    normal: Array
    friction: Array
    height: Array


def standing_frames(
    model: mujoco.MjModel, sites: Sequence[int], contacts: Sequence[Contact], nframe: int
) -> Mask:
    """Return whether a heel's or toe's contact covers each site in each frame (nframe, nsite)."""
    held = np.zeros((nframe, len(sites)), dtype=bool)
    for contact in contacts:
        if stands(contact):
            held[contact.start : contact.end, sites.index(model.site(contact.site).id)] = True
    return held


def level_support(model: mujoco.MjModel, sites: Sequence[int], place: Array, held: Mask) -> Support:
    """Return the support of sites (nframe, nsite, 3) on level ground of which no more is known."""
    body = model.site_bodyid[list(sites)]
    along = np.zeros_like(place)
    for i in range(len(sites)):
        other = [k for k in np.flatnonzero(body == body[i]).tolist() if k != i]
        if other:
            along[:, i] = place[:, other[0]] - place[:, i]
    normal = np.zeros_like(place)
    normal[..., 2] = 1.0
    return Support(
        held=held,
        place=place,
        along=along,
        normal=normal,
        friction=np.full(held.shape, FRICTION),
        height=np.where(held, 0.0, np.nan),
    )


def ground_support(ground: Ground, sites: Sequence[int], place: Array, held: Mask) -> Support:
    """Return the support of sites (nframe, nsite, 3) on the scene, with its normals and friction.

    A normal is of the heights of four points 1 mm around the site. Over an edge, where they are of
    two heights, and over nothing, it is vertical.
    """
    level = level_support(ground.model, sites, place, held)
    point = place[held]
    height, geom = ground.heights(point)
    step = _ASIDE / 2.0 * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    around, _ = ground.heights((point[:, None] + step).reshape(-1, 3))
    around = around.reshape(-1, 4)
    slope = np.stack((around[:, 1] - around[:, 0], around[:, 3] - around[:, 2]), axis=1) / _ASIDE
    steep = ~(1.0 / np.sqrt(1.0 + np.sum(slope**2, axis=1)) > _STEEPEST)  # also of NaN
    slope[steep] = 0.0
    some = np.column_stack((slope, np.ones(len(slope))))
    normal, friction, heights = level.normal.copy(), level.friction.copy(), level.height.copy()
    normal[held] = some / np.linalg.norm(some, axis=1, keepdims=True)
    known = ground.model.geom_friction[np.maximum(geom, 0), 0]
    friction[held] = np.where(geom >= 0, known, FRICTION)
    heights[held] = np.where(geom >= 0, height, np.inf)
    return dataclasses.replace(level, normal=normal, friction=friction, height=heights)


def kept_share(place: Array, held: Mask, fps: float, left_out: Mask | None = None) -> float:
    """Return the share [percent] of frames in which the source's sites stand that contacts cover.

    A site surely stands where it is slower than 0.08 m/s and no more than 20 mm over its lowest
    frame of all. NaN where none does.

    Args:
      place: (nframe, nsite, 3) the source's heels and toes [m].
      held: (nframe, nsite) whether a contact covers them.
      fps: frames a second.
      left_out: (nframe, nsite) where they are not asked, as of a foot whose knee rests.
    """
    if len(place) < 2 or place.shape[1] == 0:
        return np.nan
    speed = np.linalg.norm(np.gradient(place, axis=0), axis=2) * fps
    low = place[..., 2] <= place[..., 2].min(axis=0) + LOW
    sure = (speed < SLOW) & low
    if left_out is not None:
        sure &= ~left_out
    return float(100.0 * np.mean(held[sure])) if sure.any() else np.nan


def footprint_line(place: Array, held: Mask) -> float:
    """Return how long the line between the footprints of a walk is, over the plane [m].

    It is at the mean of all sites that ever stand, each where it stands on the mean until it is
    put down elsewhere, and in between on the straight way there.

    Args:
      place: (nframe, nsite, 3) sites [m].
      held: (nframe, nsite) whether each stands.
    """
    lines = []
    frames = np.arange(len(place))
    for site in np.flatnonzero(held.any(axis=0)).tolist():
        edges = np.flatnonzero(np.diff(np.concatenate(([0], held[:, site], [0]))))
        runs = edges.reshape(-1, 2)
        print_of = np.array([place[start:end, site, :2].mean(axis=0) for start, end in runs])
        at = np.column_stack((runs[:, 0], runs[:, 1] - 1)).ravel()
        both = np.repeat(print_of, 2, axis=0)
        # A foot in the air where the clip begins or ends is where it is.
        for frame, end in ((0, 0), (len(place) - 1, len(at))):
            if not held[frame, site]:
                at = np.insert(at, end, frame)
                both = np.insert(both, end, place[frame, site, :2], axis=0)
        lines.append([np.interp(frames, at, both[:, axis]) for axis in range(2)])
    if not lines:
        return 0.0
    x, y = np.mean(lines, axis=0)
    return float(np.hypot(np.diff(x), np.diff(y)).sum())
