"""What a morph asks of the feet, and where the fit begins: the stride stays, the root follows.

The footprints and the timing are the source's. A foot is held while it stands, from the begin of
its heel's or toe's contact to the last end of the two; in between nothing holds it. The first guess
(§4.5) is the root as much higher as the body stands higher, less where a leg would not reach, and
the coarse part of what would bring every foot on to the source's own path, in its swings too. From
there on only contacts count, and the root is stiff: it has its path.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.bones import Bones
from mjmotion.body.feet import Foot
from mjmotion.body.kinematics import Kinematics, site_id, site_positions
from mjmotion.body.limbs import Limbs
from mjmotion.body.morph_body import MorphBody
from mjmotion.body.motion import Motion
from mjmotion.body.reach import drop_to_reach
from mjmotion.constraints import SiteConstraint
from mjmotion.footsteps.contacts import Contact, contact_mask
from mjmotion.footsteps.paths import with_toes
from mjmotion.footsteps.pelvis import DROP_TIME, LEAST_HEIGHT, REACH_FREE, REACH_MOST
from mjmotion.footsteps.planning import make_plan
from mjmotion.numerics.rotations import conjugate, multiply, rotate, yaw_quat
from mjmotion.numerics.smoothing import cover
from mjmotion.scene import load_scene

Array = NDArray[np.float64]


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
            self.foot.site,
            frames,
            self.position[frames],
            self.quat[frames],
            contact=True,
            source="scene",
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
    asked = make_plan(source, load_scene("flat"), contacts)
    bones = body.bones
    sites = np.array([site_id(source.model, path.site) for path in asked.paths])
    taller = _taller(source, sites, bones)
    level = float(np.mean([foothold.position[2] for foothold in asked.footholds]))
    tracks = []
    for foot, path in zip(source.character.feet, asked.paths, strict=True):
        position = path.position + _grown(foot, source, asked.contacts, bones, path.quat)
        tracks.append(FootTrack(foot, position, path.quat, path.stance))
    shift = np.zeros((source.nframe, 3))
    shift[:, 2] = (taller - 1.0) * (source.qpos[:, 2] - level)
    shift[:, 2] -= _drop(source, tracks, bones, shift)
    lying = with_toes(source, asked.paths)
    return Stride(lying, asked.contacts, tuple(tracks), shift)


def _taller(source: Motion, sites: NDArray[np.int64], bones: Bones) -> Array:
    """Return how high the root is over the soles, as a share of the model's own (nframe,)."""
    model = source.model
    standing = np.tile(model.qpos0, (source.nframe, 1))
    now = standing[:, 2] - site_positions(model, standing, sites, bones)[..., 2].min(axis=1)
    own = model.qpos0[2] - site_positions(model, standing[:1], sites)[0, :, 2].min()
    return np.asarray(now / own)


def _drop(source: Motion, tracks: Sequence[FootTrack], bones: Bones, shift: Array) -> Array:
    """How far the root must go down for every foot to be within reach (nframe,) [m].

    A leg may be as straight as the source's is, and never quite straight.
    """
    model = source.model
    ends = source.character.limb_by_end
    own = Kinematics(model, source.nframe).forward(source.qpos)
    pose = Kinematics(model, source.nframe, bones=bones).forward(source.qpos)
    need = np.full(source.nframe, -np.inf)
    for track in tracks:
        if track.foot.body not in ends:
            continue
        limb = ends[track.foot.body]
        hip, ankle = model.body_jntadr[limb.upper], model.body_jntadr[limb.end]
        was = np.linalg.norm(own.xanchor[:, hip] - own.xanchor[:, ankle], axis=1)
        straight = was / float(source.character.chains((limb,)).reach[0])
        reach = Limbs(model, (limb,), bones).reach[:, 0]
        most = reach * np.clip(straight, REACH_FREE, REACH_MOST)
        site = site_id(model, track.foot.site)
        local = rotate(
            conjugate(model.site_quat[site]), bones.jnt_pos[:, ankle] - bones.site_pos[:, site]
        )
        goal = track.position + rotate(track.quat, local)
        lacking = drop_to_reach(pose.xanchor[:, hip] + shift, goal, most, LEAST_HEIGHT * reach)
        need = np.maximum(need, lacking)
    return cover(need, DROP_TIME * source.fps)


def _grown(
    foot: Foot, source: Motion, contacts: Sequence[Contact], bones: Bones, quat: Array
) -> Array:
    """Return how far a posed site moves (nframe, 3) [m] as its foot grows.

    A footprint grows about its middle, between heel and toe; while the foot rolls on one of the two
    that one stays where it is in the footprint, and in a swing what stays goes over to the next.
    """
    model = source.model
    held = np.zeros((source.nframe, 2))
    drawn = np.empty((source.nframe, 2, 3))  # from heel and toe to the posed site, more than before
    posed = site_id(model, foot.site)
    for column, part in enumerate(("heel", "toe")):
        name = f"{foot.side}_{part}"
        site = site_id(model, name)
        held[:, column] = contact_mask(contacts, name, source.nframe)
        was = model.site_pos[posed] - model.site_pos[site]
        drawn[:, column] = bones.site_pos[:, posed] - bones.site_pos[:, site] - was
    stance = np.flatnonzero(held.any(axis=1))
    if len(stance) == 0:
        return np.zeros((source.nframe, 3))
    heel = held[stance, 0] / held[stance].sum(axis=1)
    heel = np.interp(np.arange(source.nframe), stance, heel)[:, None]
    pivot = heel * drawn[:, 0] + (1.0 - heel) * drawn[:, 1]
    # The targets' quaternions are the posed site's, which may be turned in its body.
    turn = multiply(quat, conjugate(np.broadcast_to(model.site_quat[posed], quat.shape)))
    forward = rotate(turn, np.array((1.0, 0.0, 0.0)))
    flat = yaw_quat(np.arctan2(forward[:, 1], forward[:, 0]))
    return rotate(flat, drawn.mean(axis=1) - pivot) + rotate(turn, pivot)
