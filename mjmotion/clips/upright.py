"""Bring a clip upright: vertical axis, unit, a leading rest pose, and frames of bodies."""

from __future__ import annotations

import dataclasses

import numpy as np

from mjmotion.clips.rig import SIDES, Rig
from mjmotion.clips.skeleton import Clip, pose_skeleton
from mjmotion.exceptions import ClipError, frame_list
from mjmotion.numerics import rotations as rot

Array = rot.Array

UP = np.array((0.0, 0.0, 1.0))
_STANDS = 0.9  # part of the line from feet to shoulders along one axis, of a rest pose that stands
_PRONE = 0.2  # the same of a clip that does not object to that axis
_GLITCH = np.radians(8)  # a joint this far off its neighbouring frames has jumped


@dataclasses.dataclass(frozen=True, eq=False)
class UprightClip:
    """A clip turned so that z is up, in metres of the humanoid, and its rest pose if it has one.

    Attributes:
      clip: the turned and scaled clip.
      rig: role to joint.
      facing: (3, 3) columns forward, left, up of the rest pose's body, or None where the rest pose
        is no standing person (rigs whose bones all lie along one axis).
      rest: (njoint, 3) joint positions of the rest pose, turned and scaled.
      to_z_up: (3, 3) from the file's axes to z up: every joint's rotation at rest.
      up_axis: the file's vertical axis, such as ``"y"``.
      scale: metres of the humanoid per unit of the file.
    """

    clip: Clip
    rig: Rig
    facing: Array | None
    rest: Array
    to_z_up: Array
    up_axis: str
    scale: float

    def has(self, role: str) -> bool:
        """Return whether the clip has the role's joint."""
        return role in self.rig.joints

    def position(self, role: str) -> Array:
        """Return (nframe, 3) positions of a role's joint."""
        return self.clip.positions[:, self.clip.index(self.rig.joints[role])]

    def rest_position(self, role: str) -> Array:
        """Return the (3,) rest position of a role's joint."""
        return self.rest[self.clip.index(self.rig.joints[role])]

    def rotation(self, role: str) -> Array:
        """Return (nframe, 3, 3) global rotations of a role's joint."""
        return self.clip.rotations[:, self.clip.index(self.rig.joints[role])]


def drop_rest_frame(clip: Clip) -> tuple[Clip, str | None]:
    """Return the clip without a leading rest pose (T-pose), and a note where there was one.

    The first frame is a rest pose when the turn of all joints to the next frame is at least twenty
    times the clip's own usual one, and more than 0.05 rad a joint: no body moves so.
    """
    if clip.nframe < 4:
        return clip, None
    steps = np.swapaxes(clip.rotations[:-1], -1, -2) @ clip.rotations[1:]
    cosine = (np.trace(steps, axis1=-2, axis2=-1) - 1) / 2
    angle = np.sqrt((np.arccos(np.clip(cosine, -1, 1)) ** 2).mean(axis=1))
    if angle[0] > 0.05 and angle[0] > 20 * np.percentile(angle[1:], 99):
        return clip.cut(1, clip.nframe), "frame 0 is a rest pose and was dropped"
    return clip, None


def mend_glitches(clip: Clip) -> tuple[Clip, str | None]:
    """Return the clip without one- and two-frame jumps of its joints, and a note where it had some.

    A joint's turn against its parent is compared with the median over 60 ms; where it is far off,
    both in degrees and beside what is usual around, it is drawn between its neighbours. Recordings
    below 60 frames a second are left alone: there a quick movement looks the same.
    """
    width = 2 * round(0.03 * clip.fps) + 1
    if clip.fps < 60 or clip.nframe < 2 * width:
        return clip, None
    parents = np.maximum(clip.parents, 0)
    turn = np.swapaxes(clip.rotations[:, parents], -1, -2)
    shift = (turn @ (clip.positions - clip.positions[:, parents])[..., None])[..., 0]
    local = np.where((clip.parents < 0)[:, None, None], clip.rotations, turn @ clip.rotations)
    shift = np.where((clip.parents < 0)[:, None], clip.positions, shift)
    quats = rot.continuous(rot.from_matrix(local))
    edge = np.pad(quats, ((width // 2, width // 2), (0, 0), (0, 0)), mode="edge")
    middle = rot.normalized(
        np.median(np.lib.stride_tricks.sliding_window_view(edge, width, axis=0), axis=-1)
    )
    off = 2 * np.arccos(np.clip(np.abs(rot.dot(quats, middle)), 0, 1))
    usual = np.pad(off, ((width, width), (0, 0)), mode="edge")
    usual = np.median(np.lib.stride_tricks.sliding_window_view(usual, 2 * width + 1, axis=0), -1)
    bad = (off > _GLITCH) & (off > 8 * usual)
    if not bad.any():
        return clip, None
    frames = np.arange(clip.nframe)
    for joint in np.flatnonzero(bad.any(axis=0)):
        wrong, good = np.flatnonzero(bad[:, joint]), np.flatnonzero(~bad[:, joint])
        for values in (quats[:, joint], shift[:, joint]):
            for column in values.T:
                column[wrong] = np.interp(frames[wrong], good, column[good])
    mended = pose_skeleton(
        clip.name,
        clip.joint_names,
        clip.parents,
        clip.offsets,
        shift,
        rot.to_matrix(rot.normalized(quats)),
        clip.fps,
        clip.ends,
    )
    count = int(bad.any(axis=1).sum())
    return mended, f"{count} frames had joints that jump for a frame or two; they were mended"


def make_upright(clip: Clip, rig: Rig, leg_length: float) -> UprightClip:
    """Turn a clip so that z is up, and scale its legs to ``leg_length`` [m].

    Raises:
      ClipError: the skeleton's legs have no length, or which way is up cannot be seen.
    """
    index = {role: clip.index(joint) for role, joint in rig.joints.items()}
    rest = clip.rest_positions
    if rig.scale is not None:
        scale = float(rig.scale)
    else:
        legs = [
            np.linalg.norm(rest[index[f"{side}_knee"]] - rest[index[f"{side}_hip"]])
            + np.linalg.norm(rest[index[f"{side}_ankle"]] - rest[index[f"{side}_knee"]])
            for side in SIDES
        ]
        if min(legs) < 1e-9:
            raise ClipError(
                f"'{clip.name}': a leg has no length: check the mapping of hip to ankle"
            )
        # The longer leg reaches exactly as far as the humanoid's, the shorter stays a little bent.
        scale = leg_length / float(max(legs))
    axis = rig.up or _up_axis(clip, index)
    turn = _turn_up(axis)
    # Both products in place of positions: a turn and a scale keep every direction.
    upright = dataclasses.replace(
        clip,
        offsets=clip.offsets @ turn.T * scale,
        positions=clip.positions @ turn.T * scale,
        rotations=turn @ clip.rotations,
    )
    rest = rest @ turn.T * scale
    return UprightClip(upright, rig, _rest_facing(rest, index), rest, turn, axis, scale)


def _up_axis(clip: Clip, index: dict[str, int]) -> str:
    """Return the axis that points from the feet to the shoulders over most of the clip."""
    ankles = clip.positions[:, [index["left_ankle"], index["right_ankle"]]].mean(axis=1)
    shoulders = clip.positions[:, [index["left_shoulder"], index["right_shoulder"]]].mean(axis=1)
    direction = np.median(rot.normalized(shoulders - ankles), axis=0)
    best = int(np.argmax(np.abs(direction)))
    # Of one who crawls the rest pose tells it, where the clip does not object.
    rest = clip.rest_positions
    standing = rot.normalized(
        rest[[index["left_shoulder"], index["right_shoulder"]]].mean(axis=0)
        - rest[[index["left_ankle"], index["right_ankle"]]].mean(axis=0)
    )
    upright = int(np.argmax(np.abs(standing)))
    if abs(standing[upright]) > _STANDS and direction[upright] * standing[upright] > _PRONE:
        best = upright
        return ("-" if standing[best] < 0 else "") + "xyz"[best]
    if abs(direction[best]) < 0.7 * np.linalg.norm(direction) or abs(direction[best]) < 0.3:
        raise ClipError(
            f"'{clip.name}': which way is up cannot be seen: give 'up:' in a mapping file"
        )
    return ("-" if direction[best] < 0 else "") + "xyz"[best]


def _turn_up(axis: str) -> Array:
    """Return the rotation that takes a signed axis of the file to +z."""
    sign = -1.0 if axis.startswith("-") else 1.0
    index = "xyz".index(axis[-1])
    up = np.zeros(3)
    up[index] = sign
    # The axis after the vertical one becomes y or x: for Y up, the file's z becomes x (forward).
    forward = np.roll(np.array((1.0, 0.0, 0.0)), (index + 1) % 3)
    return np.stack([forward, np.cross(up, forward), up])


def _rest_facing(rest: Array, index: dict[str, int]) -> Array | None:
    """Return columns forward, left, up of the rest pose, or None where nobody stands like that."""
    hips = {side: rest[index[f"{side}_hip"]] for side in SIDES}
    legs = [rot.normalized(rest[index[f"{side}_ankle"]] - hips[side]) for side in SIDES]
    left = rot.normalized(hips["left"] - hips["right"])
    shoulders = (rest[index["left_shoulder"]] + rest[index["right_shoulder"]]) / 2
    trunk = rot.normalized(shoulders - (hips["left"] + hips["right"]) / 2)
    if max(leg[2] for leg in legs) > -0.85 or trunk[2] < 0.9 or abs(left[2]) > 0.2:
        return None
    return frame_of(UP, left)


def frame_of(up: Array, left: Array) -> Array:
    """Return rotations (..., 3, 3) with z along ``up`` and y as near to ``left`` as can be."""
    z = rot.normalized(up)
    x = rot.normalized(rot.cross(np.broadcast_to(left, z.shape), z))
    return np.stack([x, rot.cross(z, x), z], axis=-1)


def calibrate(joint: Array, body: Array, weight: Array | None = None) -> Array:
    """Return the constant C that brings ``joint @ C`` nearest to ``body``, least squares (Kabsch).

    Args:
      joint: (nframe, 3, 3) rotations of the clip's joint.
      body: (nframe, 3, 3) rotations wanted of the humanoid's body.
      weight: (nframe,) weights, all 1 by default.
    """
    weight = np.ones(len(joint)) if weight is None else weight
    u, _, vt = np.linalg.svd(np.einsum("n,nji,njk->ik", weight, joint, body))
    return u @ np.diag((1.0, 1.0, np.linalg.det(u @ vt))) @ vt


def speed_of(points: Array, fps: float) -> Array:
    """Return speeds (nframe,) [m/s] of points (nframe, 3)."""
    if len(points) < 2:
        return np.zeros(len(points))
    return np.linalg.norm(np.gradient(points, axis=0), axis=1) * fps


def check_steady(clip: Clip, qpos: Array) -> None:
    """Raise ClipError where mapping gave values that are not finite."""
    bad = np.flatnonzero(~np.isfinite(qpos).all(axis=1))
    if len(bad):
        raise ClipError(
            f"'{clip.name}' cannot be mapped at frames {frame_list(bad.tolist())}:"
            " joints lie on each other",
            bad.tolist(),
        )
