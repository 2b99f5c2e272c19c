"""What of a plan is given: a way that a walk is to take, and footholds in place of those found.

way = given_way(scene, settings)
clip, contacts = cut_to_way(clip, contacts, way)
footholds, turns = as_given(given, spots, found, feet, ground)
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.feet import Foot
from mjmotion.body.motion import Motion
from mjmotion.exceptions import ContactError
from mjmotion.footsteps.contacts import Contact
from mjmotion.footsteps.footholds import Foothold, footholds_at
from mjmotion.footsteps.settings import PlanSettings
from mjmotion.footsteps.stances import Stance
from mjmotion.numerics.rotations import rotate, yaw_quat
from mjmotion.route.centreline import Centreline
from mjmotion.route.given import check_way, way_sites
from mjmotion.route.way import way_length
from mjmotion.scene import Scene
from mjmotion.scene.ground import Ground

Array = NDArray[np.float64]

SAME_SPOT = 0.002  # a foothold given so near is the one found [m]
SAME_YAW = np.radians(0.5)  # and so little turned


def as_given(
    given: Array,
    spots: Sequence[Stance],
    found: tuple[tuple[Foothold, ...], Array | None],
    feet: Sequence[Foot],
    ground: Ground,
) -> tuple[tuple[Foothold, ...], Array | None]:
    """Return the footholds where they are given, and how far each is turned (n,) [rad].

    What is found there already stays as it is.

    Raises:
      ContactError: as many are given as there are not.
      SceneError: there is nothing to stand on at one.
    """
    own = np.array([(*one.position[:2], yaw_of(one.quat)) for one in found[0]])
    if given.shape != own.shape:
        raise ContactError(
            f"{len(given)} footholds are given for {len(own)} stances: give one for each"
        )
    off = given - own
    off[:, 2] = (off[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
    moved = (np.hypot(off[:, 0], off[:, 1]) > SAME_SPOT) | (np.abs(off[:, 2]) > SAME_YAW)
    if not moved.any():
        return found
    turns = np.zeros(len(own)) if found[1] is None else found[1] + 0.0
    turns[moved] += off[moved, 2]
    stances = [
        dataclasses.replace(
            spot,
            source_pos=np.array((*row[:2], spot.source_pos[2])),
            source_quat=yaw_quat(np.asarray(row[2])),
        )
        for spot, row in zip(spots, np.where(moved[:, None], given, own), strict=True)
    ]
    heights = [float(one.position[2]) for one in found[0]]
    placed = footholds_at(stances, feet, ground, heights)
    kept = [new if far else old for new, old, far in zip(placed, found[0], moved, strict=True)]
    return tuple(kept), turns


def yaw_of(quat: Array) -> float:
    """Return about the vertical how far a foot (4,) is turned [rad]."""
    ahead = rotate(quat, np.array((1.0, 0.0, 0.0)))
    return float(np.arctan2(ahead[1], ahead[0]))


def given_way(scene: Scene, settings: PlanSettings) -> Array | None:
    """Return the way (n, 2) that settings or the scene's sites give [m]; None without.

    Raises:
      SceneError: it is no way.
    """
    if isinstance(settings.path, str):
        return way_sites(scene) if settings.path == "bend" else None
    return check_way(settings.path)


def cut_to_way(
    clip: Motion, contacts: Sequence[Contact], way: Array
) -> tuple[Motion, tuple[Contact, ...]]:
    """Return a clip and its contacts cut where a way is at its end; all where that is longer."""
    line = Centreline.of(clip)
    beyond = np.flatnonzero(line.length > way_length(way))
    if len(beyond) == 0 or beyond[0] < 2:
        return clip, tuple(contacts)
    last = int(beyond[0])
    kept = [one for one in contacts if one.start < last]
    ended = tuple(dataclasses.replace(one, end=min(one.end, last)) for one in kept)
    return clip.replace(clip.qpos[:last]), ended
