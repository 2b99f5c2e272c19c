"""The exact pass of a morph (§4.4): standing feet on their footprints, swinging feet carried along.

Contacts begin and end within the motion, so closing the standing legs alone would make a foot jump
where its contact begins. So a foot leaves the ground and comes down as the source's does, swings in
between as fitted, and is lifted, smoothly, where it would scrape. The root only gives for feet that
stand: a swinging leg that has no range left swings otherwise.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mjmotion.apps.morph.stride import FootTrack
from mjmotion.body.bones import Bones
from mjmotion.body.geom_points import body_points
from mjmotion.body.kinematics import Kinematics, site_id
from mjmotion.body.morph_body import MorphBody
from mjmotion.body.motion import Motion
from mjmotion.constraints import SiteConstraint, lay_out
from mjmotion.fitting import default_levels
from mjmotion.fitting.exact import ExactPass
from mjmotion.ik import IKSolver
from mjmotion.numerics.rotations import (
    conjugate,
    continuous,
    exp,
    from_matrix,
    log,
    multiply,
    rotate,
)
from mjmotion.numerics.smoothing import ease, envelope
from mjmotion.numerics.tangent import oplus

Array = NDArray[np.float64]

JOIN_TIME = 0.15  # in which a foot goes over from its contact to its swing as fitted [s]
LIFT_TIME = 0.05  # scale of a lift's rise and fall [s]
LIFT_PULL = 30.0  # acceleration with which a foot can be lifted off, or set down [m/s²]
CLEARANCE = 0.012  # height that a swing is given, where the source has as much [m]


def landed(
    motion: Motion, body: MorphBody, tracks: Sequence[FootTrack], solver: IKSolver
) -> Motion:
    """Return a fitted motion whose feet stand exactly where they are to.

    Args:
      motion: after the levels.
      body: the body of every frame, on the motion's model.
      tracks: where the feet are to be.
      solver: made for the body that changes.
    """
    model, bones, nframe = motion.model, body.bones, motion.nframe
    qpos = np.array(motion.qpos)
    wanted = [_carried(motion, bones, track, _soles(body, track, nframe)) for track in tracks]
    posed = [track.constraints() for track in tracks if track.stance.any()]
    if posed:
        targets = lay_out(posed, model, nframe)
        coarsest = default_levels(motion.fps)[0]
        qpos, _ = ExactPass(motion, solver.prepare(targets), targets, coarsest, bones)(qpos)
    swinging = solver.prepare(lay_out(wanted, model, nframe)).enforce(qpos).displacement
    closed = motion.character.within_limits(oplus(model, qpos, swinging))
    # Where both feet stand, all is as it should be, to the bit.
    still = np.all([track.stance for track in tracks], axis=0)
    return motion.replace(np.where(still[:, None], qpos, closed))


def _carried(motion: Motion, bones: Bones, track: FootTrack, sole: Array) -> SiteConstraint:
    """Return where a foot is to be at every frame: its track near contacts, as fitted elsewhere."""
    site = site_id(motion.model, track.foot.site)
    pose = Kinematics(motion.model, motion.nframe, bones=bones).forward(motion.qpos)
    position = pose.site_xpos[:, site]
    quat = continuous(from_matrix(pose.site_xmat[:, site]))
    apart = _apart(track.stance) / motion.fps
    share = ease(np.minimum(apart / JOIN_TIME, 1.0))[:, None]
    position = track.position + share * (position - track.position)
    quat = multiply(track.quat, exp(share * log(multiply(conjugate(track.quat), quat))))
    source = _lowest(track.position, track.quat, sole)
    level = _ground(track.stance, source)
    height = _lowest(position, quat, sole) - level
    source = source - level
    # A foot cannot be up at once: what it could have risen since it stood bounds its lift.
    need = np.minimum(np.clip(source, 0.0, CLEARANCE) - height, 0.5 * LIFT_PULL * apart**2)
    position[:, 2] += envelope(need, track.stance, LIFT_TIME * motion.fps)
    return SiteConstraint(track.foot.site, np.arange(motion.nframe), position, quat)


def _apart(stance: NDArray[np.bool_]) -> Array:
    """How far every frame is from one in which a foot stands (nframe,) [frames]."""
    frames = np.flatnonzero(stance)
    if len(frames) == 0:
        return np.full(len(stance), np.inf)
    return np.asarray(np.abs(np.arange(len(stance))[:, None] - frames).min(axis=1), dtype=float)


def _ground(stance: NDArray[np.bool_], lowest: Array) -> Array:
    """Height of the ground (nframe,) under a foot [m]: where it stood before and stands next."""
    frames = np.flatnonzero(stance)
    if len(frames) == 0:
        return np.zeros(len(stance))
    return np.interp(np.arange(len(stance)), frames, lowest[frames])


def _lowest(position: Array, quat: Array, sole: Array) -> Array:
    """Height (nframe,) of the lowest of points (nframe, k, 3) that a posed site carries [m]."""
    return np.asarray((position[:, None] + rotate(quat[:, None], sole))[..., 2].min(axis=1))


def _soles(body: MorphBody, track: FootTrack, nframe: int) -> Array:
    """Return points of a foot's surface in its posed site's frame (nframe, k, 3) [m]."""
    foot, model = track.foot, body.model
    mine = np.flatnonzero(model.geom_bodyid == foot.body)
    still = all(
        np.ptp(body.fields[name][:, mine], axis=0).max() < 1e-6
        for name in ("geom_pos", "geom_size", "geom_aabb")
    )
    if still:
        return np.broadcast_to(foot.shape, (nframe, *foot.shape.shape))
    site = site_id(model, foot.site)
    turn = conjugate(model.site_quat[site])
    copy_ = body.model_at(0)
    points = []
    for frame in range(nframe):
        body.write(copy_, frame)
        points.append(rotate(turn, body_points(copy_, foot.body) - copy_.site_pos[site]))
    return np.stack(points)
