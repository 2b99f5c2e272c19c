"""What a morph asks of the feet, and where the fit begins: the stride stays, the root follows.

The footprints and the timing are the source's. A foot is held while it stands, from the begin of
its heel's or toe's contact to the last end of the two; in between nothing holds it. The first guess
(§4.5) is the root as much higher as the body stands higher, and the coarse part of what would bring
every foot on to the source's own path, in its swings too: from there on only contacts count.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mjmotion.adapt import plan
from mjmotion.bones import Bones
from mjmotion.constraints import SiteConstraint
from mjmotion.contacts import Contact, contact_mask
from mjmotion.fit import default_levels, fit
from mjmotion.footholds import Foot, find_feet
from mjmotion.kinematics import site_id, site_positions
from mjmotion.morph.body import MorphBody
from mjmotion.motion import Motion
from mjmotion.rotations import conjugate, multiply, rotate
from mjmotion.scene import load_scene

Array = NDArray[np.float64]

_COARSE = 2  # levels of the first guess


@dataclasses.dataclass(frozen=True, eq=False)
class FootTrack:
    """Where one foot goes.

    Attributes:
      foot: the foot.
      position: (nframe, 3) of its posed site [m]: where it is held, and where the source swings it.
      quat: (nframe, 4) how the site is turned there.
      stance: (nframe,) when it is held.
    """

    foot: Foot
    position: Array
    quat: Array
    stance: NDArray[np.bool_]

    def constraints(self, frames: NDArray[np.int64] | None = None) -> SiteConstraint:
        """Hold the foot at some frames, or while it stands: six scalar constraints at each."""
        if frames is None:
            frames = np.flatnonzero(self.stance)
        return SiteConstraint(
            self.foot.site, frames, self.position[frames], self.quat[frames], contact=True
        )


@dataclasses.dataclass(frozen=True, eq=False)
class Stride:
    """What the feet of a walk do, for a body that changes.

    Attributes:
      source: the walk.
      contacts: who stands when.
      tracks: one a foot.
      shift: (nframe, 3) how much higher the root is for the body that changes [m].
    """

    source: Motion
    contacts: tuple[Contact, ...]
    tracks: tuple[FootTrack, ...]
    shift: Array

    def constraints(self) -> list[SiteConstraint]:
        """Feet held while they stand."""
        return [track.constraints() for track in self.tracks if track.stance.any()]

    def first_guess(self, bones: Bones, ik: str = "hybrid") -> Motion:
        """Return the walk with the root at its height and the legs roughly as long as they are.

        A retarget of every frame to its own body, of which only the coarse knots are kept.
        """
        frames = np.arange(self.source.nframe)
        return fit(
            self.source,
            [track.constraints(frames) for track in self.tracks],
            levels=default_levels(self.source.fps)[:_COARSE],
            ik=ik,
            first_guess=self.shift,
            exact=False,
            bones=bones,
        ).motion


def find_stride(
    source: Motion, body: MorphBody, contacts: Sequence[Contact] | None = None
) -> Stride:
    """Find out where the feet of a walk stand and swing.

    Args:
      source: the walk, on level ground at z = 0.
      body: the body of every frame.
      contacts: who stands when; found in the walk without.

    Raises:
      ContactError: no contacts, or ones that do not fit the walk.
      ModelError: the character has no feet.
    """
    asked = plan(source, load_scene("flat"), contacts)
    bones = body.bones
    sites = np.array([site_id(source.model, path.site) for path in asked.paths])
    taller = _taller(source, sites, bones)
    ground = np.concatenate([path.position[path.stance, 2] for path in asked.paths])
    level = float(ground.mean())
    tracks = []
    for foot, path in zip(find_feet(source.model), asked.paths, strict=True):
        position = path.position + _grown(foot, source, asked.contacts, bones, path.quat)
        tracks.append(FootTrack(foot, position, path.quat, path.stance))
    shift = np.zeros((source.nframe, 3))
    shift[:, 2] = (taller - 1.0) * (source.qpos[:, 2] - level)
    return Stride(source, asked.contacts, tuple(tracks), shift)


def _taller(source: Motion, sites: NDArray[np.int64], bones: Bones) -> Array:
    """Return how high the root is over the soles, as a share of the model's own (nframe,)."""
    model = source.model
    standing = np.tile(model.qpos0, (source.nframe, 1))
    now = standing[:, 2] - site_positions(model, standing, sites, bones)[..., 2].min(axis=1)
    own = model.qpos0[2] - site_positions(model, standing[:1], sites)[0, :, 2].min()
    return np.asarray(now / own)


def _grown(
    foot: Foot, source: Motion, contacts: Sequence[Contact], bones: Bones, quat: Array
) -> Array:
    """Return how far a posed site moves (nframe, 3) [m] as its foot grows about what stands.

    Where only the heel stands it stays, where only the toe stands that; else the middle of both.
    """
    model = source.model
    share = np.zeros((source.nframe, 2, 1))
    drawn = np.empty((source.nframe, 2, 3))
    posed = site_id(model, foot.site)
    for column, part in enumerate(("heel", "toe")):
        name = f"{foot.side}_{part}"
        site = site_id(model, name)
        share[:, column, 0] = contact_mask(contacts, name, source.nframe)
        was = model.site_pos[posed] - model.site_pos[site]
        now = bones.site_pos[:, posed] - bones.site_pos[:, site]
        drawn[:, column] = now - was
    share[share.sum(axis=1)[:, 0] == 0.0] = 1.0
    mean = (share * drawn).sum(axis=1) / share.sum(axis=1)
    # The targets' quaternions are the posed site's, which may be turned in its body.
    return rotate(multiply(quat, conjugate(model.site_quat[posed])), mean)
