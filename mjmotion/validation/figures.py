"""The figures themselves, each from arrays of one motion; lengths in metres until the very end."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.motion import Motion
from mjmotion.exceptions import ContactError, MotionError, unknown_name
from mjmotion.validation.ground import Ground
from mjmotion.validation.inputs import Contact
from mjmotion.validation.lowpass import low_pass
from mjmotion.validation.penetration import (
    CharacterGeoms,
    lowest_points,
    sample_spacing,
    sole_points,
    world_boxes,
)

Array = NDArray[np.float64]
Index = NDArray[np.int64]

SHORTEST_SWING = 0.1  # [s] a shorter gap between contacts is not a swing
SWING_MIDDLE = 0.5  # the part of a swing that its clearance is measured over
JERK_CUTOFF = 10.0  # [Hz] of the low-pass of joint angles whose jerk is judged
NOTHING = 1e-6  # a jerk or acceleration that is no more is none [rad/s³, m/s²]
STILL = 0.01  # a root that goes no further goes nowhere [m]


@dataclasses.dataclass(frozen=True, eq=False)
class Poses:
    """Where the character is in all frames of one motion.

    Attributes:
      site: (nframe, nsite, 3) sites [m].
      geom: (nframe, ngeom, 3) the character's geoms [m].
      turn: (nframe, ngeom, 3, 3) their orientations.
    """

    site: Array
    geom: Array
    turn: Array


@dataclasses.dataclass(frozen=True)
class Swing:
    """One swing of a foot: frames ``start`` to ``end``, of which ``first`` to ``last`` count."""

    foot: int
    start: int
    end: int
    first: int
    last: int


def poses_of(motion: Motion, geoms: CharacterGeoms) -> Poses:
    """Return sites and geoms of all frames, from ``mj_kinematics`` alone.

    A frame costs 3 µs here, less than it takes to set up a batch for a single pass over a clip.
    """
    model, ids = motion.model, geoms.ids
    data = mujoco.MjData(model)
    first, last = (int(ids[0]), int(ids[-1]) + 1) if len(ids) else (0, 0)
    # Views of what MuJoCo writes; the character's geoms follow one another, or nearly so.
    qpos, site_xpos = data.qpos, data.site_xpos
    geom_xpos, geom_xmat = data.geom_xpos[first:last], data.geom_xmat[first:last]
    site = np.empty((motion.nframe, *site_xpos.shape))
    geom = np.empty((motion.nframe, *geom_xpos.shape))
    turn = np.empty((motion.nframe, *geom_xmat.shape))
    for pose, *place in zip(motion.qpos, site, geom, turn, strict=True):
        qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        place[0][:], place[1][:], place[2][:] = site_xpos, geom_xpos, geom_xmat
    if last - first > len(ids):
        geom, turn = geom[:, ids - first], turn[:, ids - first]
    return Poses(site, geom, turn.reshape(motion.nframe, -1, 3, 3))


def check_pair(source: Motion, motion: Motion, contacts: Sequence[Contact]) -> None:
    """Raise an error unless source, motion and contacts belong together."""
    if source.joint_names != motion.joint_names or source.model.nq != motion.model.nq:
        raise MotionError("source and motion have different joints: validate motions of one model")
    if source.nframe != motion.nframe:
        raise MotionError(
            f"the source has {source.nframe} frames and the motion {motion.nframe}:"
            " validate a motion beside the source it was adapted from"
        )
    if not np.isclose(source.fps, motion.fps):
        raise MotionError(f"the source runs at {source.fps:g} fps and the motion at {motion.fps:g}")
    names = [motion.model.site(i).name for i in range(motion.model.nsite)]
    for contact in contacts:
        if contact.site not in names:
            raise ContactError(unknown_name("contact site", contact.site, names))
        if not 0 <= contact.start < contact.end <= motion.nframe:
            raise ContactError(
                f"contact of {contact.site} lasts from frame {contact.start} to {contact.end}:"
                f" the motion has frames 0 to {motion.nframe - 1}"
            )


def sole_sites(model: mujoco.MjModel, contacts: Sequence[Contact]) -> tuple[int, ...]:
    """Return the ids of sites that feet stand with.

    Sites that contacts name, and sites of the character called ``…heel`` or ``…toe``.
    """
    root = int(model.jnt_bodyid[0])
    named = {contact.site for contact in contacts}
    return tuple(
        i
        for i in range(model.nsite)
        if model.site(i).name in named
        or (
            model.body_rootid[model.site_bodyid[i]] == root
            and model.site(i).name.endswith(("heel", "toe"))
        )
    )


def contact_frames(contacts: Sequence[Contact]) -> tuple[Index, Index]:
    """Return, for every frame of every contact in turn, the contact's number and the frame."""
    length = np.array([contact.end - contact.start for contact in contacts], dtype=np.int64)
    which = np.repeat(np.arange(len(contacts)), length)
    start = np.array([contact.start for contact in contacts], dtype=np.int64)
    frame = np.arange(len(which)) - np.repeat(np.cumsum(length) - length, length) + start[which]
    return which, frame


def swings_of(
    feet: Sequence[int], model: mujoco.MjModel, contacts: Sequence[Contact], motion: Motion
) -> list[Swing]:
    """Return all swings: where no site of a foot is in contact for 0.1 s or more.

    Only of feet, and while their knees do not rest on the ground either: hands that support a body
    go their own ways.

    The clearance of a swing is measured over its middle half. In the quarter before, the foot is
    still leaving the ground and in the quarter after it is about to land, and both go through
    every height down to zero; a swing cut off by an end of the clip is treated alike.
    """
    swings = []
    soles = {int(model.site_bodyid[site]) for site in sole_sites(model, ())}
    for foot in soles.intersection(feet) or feet:
        leg = {foot, int(model.body_parentid[foot])} - {int(model.jnt_bodyid[0])}
        if not any(int(model.site_bodyid[model.site(one.site).id]) == foot for one in contacts):
            continue  # a foot that never stands, as of one who crawls
        down = np.zeros(motion.nframe + 2, dtype=bool)
        down[[0, -1]] = True
        for contact in contacts:
            if int(model.site_bodyid[model.site(contact.site).id]) in leg:
                down[contact.start + 1 : contact.end + 1] = True
        edge = np.flatnonzero(np.diff(down.astype(np.int8)))
        for start, end in edge.reshape(-1, 2).tolist():
            length = end - start
            if length / motion.fps < SHORTEST_SWING or length == motion.nframe:
                continue
            aside = int(length * (1 - SWING_MIDDLE) / 2)
            swings.append(Swing(foot, start, end, start + aside, end - aside))
    return swings


def swing_clearances(
    swings: Sequence[Swing], ground: Ground, geoms: CharacterGeoms, poses: Poses
) -> list[tuple[float, int]]:
    """Return the least height [m] of the sole over the ground in each swing, and its frame.

    Points over no ground at all do not count; a swing without any is infinitely clear.
    """
    result = [(np.inf, swing.first) for swing in swings]
    body = geoms.owner
    # One row for every geom of the foot in every frame of every swing, geom by geom.
    rows = [
        np.stack(np.broadcast_arrays(i, np.arange(swing.first, swing.last), order), axis=1)
        for i in np.flatnonzero(np.isin(body, [swing.foot for swing in swings]))
        for order, swing in enumerate(swings)
        if swing.foot == body[i]
    ]
    if not rows:
        return result
    geom, at, number = np.concatenate(rows).T
    position, matrix = poses.geom[at, geom], poses.turn[at, geom]
    spacing = sample_spacing(ground)
    lowest = _low_points(geoms, geom, position, matrix, spacing)
    some = np.flatnonzero(~np.isnan(lowest[:, 2]))
    known = lowest[some, 2] - ground.heights(lowest[some])[0]
    least = np.full(len(swings), np.inf)
    np.fmin.at(least, number[some], known)
    # No ground near is higher than this, so what is higher by more than is known cannot count.
    middle, extent = world_boxes(ground.model, geoms.ids[geom], position, matrix)
    above = np.where(np.isinf(least), 0.0, least + 1e-9)[number]
    top = np.where(np.isinf(least[number]), np.inf, ground.highest(middle, extent) + above)
    low = middle[:, 2] - extent[:, 2] < top
    points, owners, frames = [], [], []
    for i in np.unique(geom[low]).tolist():
        mine = np.flatnonzero(low & (geom == i))
        xyz, row = sole_points(geoms, i, position[mine], matrix[mine], spacing, top[mine])
        points.append(xyz)
        owners.append(number[mine[row]])
        frames.append(at[mine[row]])
    if not points:
        return result
    xyz, owner, frame = np.concatenate(points), np.concatenate(owners), np.concatenate(frames)
    height, _ = ground.heights(xyz)
    clear = xyz[:, 2] - height
    clear[np.isnan(clear)] = np.inf
    order = np.lexsort((-clear, owner))
    last = np.searchsorted(owner[order], np.arange(len(swings)), side="right") - 1
    for swing, place in enumerate(last):
        if place >= 0 and owner[order[place]] == swing:
            result[swing] = (float(clear[order[place]]), int(frame[order[place]]))
    return result


def _low_points(
    geoms: CharacterGeoms, geom: Index, position: Array, matrix: Array, spacing: float
) -> Array:
    """Return the lowest sample (n, 3) on the underside of geoms number ``geom`` (n,) [m].

    NaN where no sample is on the underside: all of it is inside the foot's other geoms.
    """
    points = np.empty_like(position)
    for i in np.unique(geom).tolist():
        mine = np.flatnonzero(geom == i)
        whole = geoms.skin(i, spacing)
        height = matrix[mine, 2] @ whole.point.T
        height[~whole.facing_down(matrix[mine])] = np.inf
        lowest = height.argmin(axis=1)
        points[mine] = np.einsum("nij,nj->ni", matrix[mine], whole.point[lowest])
        points[mine[np.isinf(height.min(axis=1))]] = np.nan
    return position + points


def source_clearances(
    swings: Sequence[Swing],
    contacts: Sequence[Contact],
    model: mujoco.MjModel,
    geoms: CharacterGeoms,
    poses: Poses,
) -> list[tuple[float, int]]:
    """Return the same as swing_clearances for the source, whose ground is nowhere in the scene.

    The source's ground is the height that the foot stood at before and stands at after: the mean
    height of its contacts, and straight lines over time between them.
    """
    body = geoms.owner
    every = np.arange(len(poses.site))
    lowest = {
        i: lowest_points(geoms.solids[i], poses.geom[:, i], poses.turn[:, i])
        for i in np.flatnonzero(np.isin(body, [swing.foot for swing in swings])).tolist()
    }
    levels = {}
    for foot in {swing.foot for swing in swings}:
        stood = []
        for contact in contacts:
            site = model.site(contact.site).id
            if model.site_bodyid[site] == foot:
                height = float(poses.site[contact.start : contact.end, site, 2].mean())
                stood += [(contact.start, height), (contact.end - 1, height)]
        stood.sort()
        levels[foot] = np.interp(every, [s[0] for s in stood], [s[1] for s in stood])
    result = []
    for swing in swings:
        level = levels[swing.foot]
        mine = [height for i, height in lowest.items() if body[i] == swing.foot]
        if not mine:
            result.append((np.inf, swing.first))
            continue
        clear = np.minimum.reduce(mine) - level
        frame = swing.first + int(clear[swing.first : swing.last].argmin())
        result.append((float(clear[frame]), frame))
    return result


def joint_jerk(motion: Motion, cutoff: float = np.inf) -> Array:
    """Return the third time derivative of all joint angles but the root's [rad/s³].

    Args:
      motion: the motion.
      cutoff: of a low-pass of the angles, both ways [Hz]; without one they are as they come.

    Velocities are ``mj_differentiatePos`` from frame to frame, in the tangent space of each joint;
    two more differences follow. (nframe - 3, nv - 6), of frames 0 to nframe - 4; slides are left
    out, for they are not angles. The low-pass is of all displacements so far.
    """
    model, qpos = motion.model, motion.qpos
    displacement = np.empty((motion.nframe - 1, model.nv))
    for row, before, after in zip(displacement, qpos[:-1], qpos[1:], strict=True):
        # A frame a call costs half a microsecond, less than NumPy over all frames.
        mujoco.mj_differentiatePos(model, row, 1.0, before, after)
    angle = np.zeros((motion.nframe, len(jerk_dofs(model))))
    np.cumsum(displacement[:, jerk_dofs(model)], axis=0, out=angle[1:])
    smooth = low_pass(angle, cutoff, motion.fps)
    # As they come they are not summed: a sum and a difference would leave rounding behind.
    step = displacement[:, jerk_dofs(model)] if smooth is angle else np.diff(smooth, axis=0)
    return np.asarray(np.diff(step * motion.fps, n=2, axis=0) * motion.fps**2)


def joint_jerk_ratio(motion: Motion, others: Sequence[Motion]) -> float:
    """Return the RMS joint jerk of a motion, as it comes, over the largest of others'."""
    size = [float(np.sqrt(np.mean(joint_jerk(one) ** 2))) for one in (motion, *others)]
    return ratio(size[0], max(size[1:]))


def jerk_dofs(model: mujoco.MjModel) -> Index:
    """Return the degrees of freedom that are joint angles: of hinges and balls."""
    kind = model.jnt_type[model.dof_jntid]
    angle = (kind == mujoco.mjtJoint.mjJNT_HINGE) | (kind == mujoco.mjtJoint.mjJNT_BALL)
    return np.flatnonzero(angle)


def ratio(adapted: float, source: float, nothing: float = NOTHING) -> float:
    """Return adapted over source; NaN where the source is no more than ``nothing``."""
    return adapted / source if source > nothing else float("nan")


def travel(qpos: Array) -> tuple[float, float]:
    """Return the root's path length over the ground plane and its displacement [m]."""
    steps = np.linalg.norm(np.diff(qpos[:, :2], axis=0), axis=1)
    return float(steps.sum()), float(np.linalg.norm(qpos[-1, :2] - qpos[0, :2]))
