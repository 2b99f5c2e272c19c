"""Put a clip on the humanoid: directions of the bones kept, feet where the recording has them."""

from __future__ import annotations

import dataclasses

import numpy as np

from mjmotion.body.character import Character, CharacterLike
from mjmotion.body.feet import Foot
from mjmotion.body.joint_limits import swing_twist
from mjmotion.body.limbs import two_bone_angles
from mjmotion.body.motion import Motion
from mjmotion.clips.assembling import assemble, start_of
from mjmotion.clips.dimensions import HumanoidDimensions
from mjmotion.clips.floor import find_floor
from mjmotion.clips.foot_noise import steady_turns
from mjmotion.clips.foot_planting import plant_feet, toe_bend
from mjmotion.clips.joint_noise import quieted
from mjmotion.clips.recorded import keep_recording
from mjmotion.clips.recorded_feet import RecordedFoot, find_stances, without_raised
from mjmotion.clips.rig import SIDES, Rig, find_rig
from mjmotion.clips.skeleton import Clip
from mjmotion.clips.standing import QUIET, point_noise
from mjmotion.clips.upright import (
    UP,
    UprightClip,
    calibrate,
    check_steady,
    drop_rest_frame,
    frame_of,
    make_upright,
    mend_glitches,
)
from mjmotion.numerics import rotations as rot
from mjmotion.numerics.smoothing import cover

Array = rot.Array

_AXIS_WEIGHT = 0.3  # of the hinge axis learnt over the clip, beside the frame's own bend plane
_BALL = np.array((0.12, 0.0, -0.0682))  # of a foot that has neither toe nor end, from its ankle [m]


@dataclasses.dataclass(frozen=True, eq=False)
class Mapped:
    """A clip on the humanoid, and what was found on the way.

    Attributes:
      motion: the motion.
      scale: metres of the humanoid per unit of the file.
      up: the file's vertical axis.
      clamped: number of frames in which a joint was put back inside its limits.
      notes: what the reader of a report should know, a line each.
      odd: those of the notes that tell of something unusual.
    """

    motion: Motion
    scale: float
    up: str
    clamped: int
    notes: tuple[str, ...]
    odd: tuple[str, ...] = ()


def to_motion(clip: Clip, character: CharacterLike, rig: Rig | None = None) -> Motion:
    """Return the clip as a motion of the humanoid; see :func:`map_clip`."""
    return map_clip(clip, character, rig).motion


def map_clip(
    clip: Clip, character: CharacterLike, rig: Rig | None = None, floor: str = "auto"
) -> Mapped:
    """Put a clip on the humanoid.

    The clip's legs are scaled to the humanoid's, the first frame is moved to x = y = 0 and the clip
    is turned to set off along +x, on ground at z = 0. Bones keep the recording's directions; the
    ankles stand where the scaled recording has them.

    Args:
      clip: the clip, as read.
      character: the humanoid, with or without a scene, or what names it.
      rig: which joint plays which role; found by name when None.
      floor: ``"auto"``, ``"level"`` or ``"follow"``: see :func:`mjmotion.clips.floor.find_floor`.

    Raises:
      ClipError: the skeleton cannot be mapped.
      ModelError: the model is not the humanoid.
    """
    character = Character.of(character)
    humanoid = HumanoidDimensions(character)
    rig = find_rig(clip) if rig is None else rig
    clip, dropped = drop_rest_frame(clip)
    recorded = make_upright(clip, rig, humanoid.leg)
    clip, mended = mend_glitches(clip)
    clip, quiet = quieted(clip, rig, recorded.scale)
    source = make_upright(clip, rig, humanoid.leg)
    odd = (*rig.notes, *(note for note in (dropped, mended, quiet) if note))
    notes = (*odd, f"up axis {source.up_axis}, 1 unit of the file is {source.scale:.6g} m")
    body = _trunk(source)
    root = (source.position("left_hip") + source.position("right_hip")) / 2
    feet = [_foot(source, side, recorded) for side in SIDES]
    shifts = [_hip_shift(source, side, body["pelvis"], humanoid) for side in SIDES]
    feet = [foot.moved_by(shift) for foot, shift in zip(feet, shifts, strict=True)]
    for side in SIDES:
        _arm(source, side, body)
    yaw, start = start_of(root, body["pelvis"], clip.fps)
    turn = rot.yaw_quat(np.array(-yaw))
    body = {name: rot.multiply(np.broadcast_to(turn, q.shape), q) for name, q in body.items()}
    root = rot.rotate(turn, root - start)
    feet = [foot.moved(turn, start) for foot in feet]
    sole = -float(humanoid.site("left_foot")[2])
    stances = without_raised([find_stances(foot, sole, clip.fps) for foot in feet])
    ground = find_floor(feet, stances, sole, clip.fps, floor)
    root, feet = plant_feet(root, body["pelvis"], feet, stances, humanoid, ground, clip.fps)
    knees, planted = {}, []
    for side, foot in zip(SIDES, feet, strict=True):
        hip = root + rot.rotate(body["pelvis"], humanoid.hips[side])
        leg = _leg(hip, foot, side, humanoid, clip.fps)
        body[f"{side}_thigh"], knees[side], tipped = leg
        body[f"{side}_foot"] = tipped.quat
        planted.append(tipped)
    qpos = assemble(character.model, root, body, knees)
    for foot, own in zip(planted, humanoid.feet, strict=True):
        qpos = _with_toes(qpos, foot, own, humanoid, clip.fps)
    check_steady(clip, qpos)
    clamped = int((character.limits.excess(qpos) > 1e-9).any(axis=1).sum())
    kept = keep_recording(recorded, turn, start, ground)
    motion = Motion(character, character.limits.clamp(qpos), clip.fps, kept)
    return Mapped(motion, source.scale, source.up_axis, clamped, notes, odd)


def bend_leg(
    hip: Array, ankle: Array, normal: Array, thigh: float, shank: float
) -> tuple[Array, Array]:
    """Return the thigh's orientation and the knee's angle that bring the ankle to its place.

    Closed form, two bones and a hinge: the paper's Eq. 7 with the knee's plane given, where a
    :class:`mjmotion.body.limbs.Limbs` turns the least from where the limb is.

    Args:
      hip: (nframe, 3) hip centres [m].
      ankle: (nframe, 3) where the ankles are to be [m]; beyond reach, the leg points there.
      normal: (nframe, 3) the knee's axis, as far as it is square to the line hip to ankle.
      thigh: length [m].
      shank: length [m].

    Returns:
      (nframe, 4) quaternions wxyz of the thigh and (nframe,) flexion [rad] of the knee.
    """
    line = ankle - hip
    lean, knee = two_bone_angles(thigh, shank, np.linalg.norm(line, axis=1))
    line = rot.normalized(line)
    normal = rot.normalized(normal - rot.dot(normal, line)[:, None] * line)
    lean = lean[:, None]
    bone = np.cos(lean) * line - np.sin(lean) * rot.cross(normal, line)
    return rot.from_matrix(frame_of(-bone, normal)), knee


def _leg(
    hip: Array, foot: RecordedFoot, side: str, humanoid: HumanoidDimensions, fps: float
) -> tuple[Array, Array, RecordedFoot]:
    """Return the thigh's orientations, the knee's angles and the foot of one side.

    Where a deep crouch would bend the ankle beyond its limit, the heel comes up, the toe stays.
    """
    toe = humanoid.site(f"{side}_toe")
    extra = np.zeros(len(hip))
    for _ in range(8):
        tipped = foot.tipped(extra, toe) if extra.any() else foot
        thigh, knee = bend_leg(hip, tipped.ankle, foot.normal, humanoid.thigh, humanoid.shank)
        half, zero = knee / 2, np.zeros_like(knee)
        bend = np.stack([np.cos(half), zero, np.sin(half), zero], axis=-1)
        ankle = rot.multiply(rot.conjugate(rot.multiply(thigh, bend)), tipped.quat)
        excess = humanoid.most_dorsiflexion[side] - swing_twist(ankle)[:, 1]
        if excess.max() < 1e-4:
            break
        extra = extra + cover(excess, 0.2 * fps)
    return thigh, knee, tipped


def _with_toes(
    qpos: Array, planted: RecordedFoot, foot: Foot, humanoid: HumanoidDimensions, fps: float
) -> Array:
    """Return the poses with the toes of a foot bent, where it has such."""
    if foot.toes is None:
        return qpos
    sole = humanoid.site(foot.site)
    bend = toe_bend(planted, foot.toes, sole + foot.toe, sole + foot.front, fps)
    return foot.toes.put(qpos, bend)


def _trunk(source: UprightClip) -> dict[str, Array]:
    """Return the orientations (nframe, 4) of pelvis, torso, neck and head."""
    hips = source.position("left_hip") - source.position("right_hip")
    chain = _spine(source)
    low = source.clip.positions[:, chain[0]]
    high = source.position("neck") if source.has("neck") else _middle(source, "shoulder")
    lean = rot.normalized(high - low)
    pelvis = source.rotation("pelvis")
    chest = source.clip.rotations[:, chain[-1]]
    if source.facing is not None:
        stand = source.to_z_up.T @ source.facing
        body = {"pelvis": pelvis @ stand}
        straight = chest @ stand
        tops = ["neck"] if source.has("neck") else [f"{side}_shoulder" for side in SIDES]
        rest_high = np.mean([source.rest_position(role) for role in tops], axis=0)
        rest_lean = rot.normalized(rest_high - source.rest[chain[0]])
        # What the trunk's line looks like at rest is what standing upright looks like.
        upright = frame_of(rest_lean, source.facing[:, 1]).T @ source.facing
        line = frame_of(lean, straight[..., 1]) @ upright
        # Half from where the spine goes, half from how the chest is turned: skeletons differ in
        # how much of the trunk lies between their joints.
        torso = _halfway(rot.from_matrix(line), rot.from_matrix(straight))
        body["torso"] = rot.to_matrix(torso)
        head_stand = stand
    else:
        rough = frame_of(lean, hips)
        body = {"pelvis": pelvis @ calibrate(pelvis, rough)}
        shoulders = source.position("left_shoulder") - source.position("right_shoulder")
        left = (chest @ calibrate(chest, frame_of(lean, shoulders)))[..., 1]
        body["torso"] = frame_of(lean, left)
        head_stand = None
    for name, role in (("neck", "neck"), ("head", "head")):
        if not source.has(role):
            body[name] = body["neck"] if "neck" in body else body["torso"]
            continue
        joint = source.rotation(role)
        constant = calibrate(joint, body["torso"]) if head_stand is None else head_stand
        body[name] = joint @ constant
    quats = {name: rot.from_matrix(matrix) for name, matrix in body.items()}
    if source.has("neck") and source.has("head"):
        # Recorded necks hold their two joints against each other; half of that bend is taken out,
        # so that the head keeps its direction within the limits of the head's joint.
        quats["neck"] = _halfway(quats["neck"], _halfway(quats["torso"], quats["head"]))
    return quats


def _halfway(a: Array, b: Array) -> Array:
    """Return the rotations (nframe, 4) half way between two."""
    return rot.normalized(a + np.where(rot.dot(a, b)[:, None] < 0, -b, b))


def _spine(source: UprightClip) -> list[int]:
    """Return the joints from the pelvis' first spine joint to the chest, the shoulders' parent."""
    clip = source.clip

    def line(joint: int) -> list[int]:
        path = [joint]
        while clip.parents[path[-1]] >= 0:
            path.append(int(clip.parents[path[-1]]))
        return path[::-1]

    left, right = (line(clip.index(source.rig.joints[f"{side}_shoulder"])) for side in SIDES)
    shared = [a for a, b in zip(left, right, strict=False) if a == b]
    if source.has("chest"):
        shared = line(clip.index(source.rig.joints["chest"]))
    pelvis = clip.index(source.rig.joints["pelvis"])
    below = line(pelvis)  # it may be beside the spine: both hang on what is above them
    return [joint for joint in shared if joint not in below] or [pelvis]


def _middle(source: UprightClip, part: str) -> Array:
    return (source.position(f"left_{part}") + source.position(f"right_{part}")) / 2


def _hinge_axis(first: Array, second: Array, joint: Array, fallback: Array) -> Array:
    """Return (nframe, 3) axes of a hinge between two bones, steady where they are in line.

    Args:
      first: (nframe, 3) unit direction of the upper bone.
      second: (nframe, 3) unit direction of the lower bone.
      joint: (nframe, 3, 3) rotations of the upper bone's joint, in which the axis is constant.
      fallback: (nframe, 3) axes for a clip in which the hinge never bends.
    """
    bend = rot.cross(first, second)
    local = np.einsum("nji,nj->ni", joint, bend).mean(axis=0)
    if np.linalg.norm(local) < 0.02:
        local = np.einsum("nji,nj->ni", joint, fallback).mean(axis=0)
    steady = joint @ rot.normalized(local)
    # Bent the wrong way by more than the weight, the plane of the frame would turn the hinge over.
    along = rot.dot(bend, steady)[:, None]
    bend = np.where(along < 0, bend - along * steady, bend)
    axis = bend + _AXIS_WEIGHT * steady
    return rot.normalized(axis - rot.dot(axis, first)[:, None] * first)


def _foot(source: UprightClip, side: str, recorded: UprightClip) -> RecordedFoot:
    """Return the recorded foot of one side; ``recorded`` tells how noisy it was."""
    hip, knee, ankle = (source.position(f"{side}_{part}") for part in ("hip", "knee", "ankle"))
    thigh, shank = rot.normalized(knee - hip), rot.normalized(ankle - knee)
    across = source.position("left_hip") - source.position("right_hip")
    normal = _hinge_axis(thigh, shank, source.rotation(f"{side}_hip"), across)
    joint = source.rotation(f"{side}_ankle")
    role = f"{side}_toe"
    rest_pitch, toes = None, None
    if source.has(role):
        ball, toes = source.position(role), source.rotation(role)
        line = source.rest_position(role) - source.rest_position(f"{side}_ankle")
    else:
        name = source.rig.joints[f"{side}_ankle"]
        end = source.clip.ends.get(name, source.to_z_up.T @ _BALL / source.scale) * source.scale
        ball, line = ankle + joint @ end, source.to_z_up @ end
    if source.facing is not None and np.linalg.norm(line) > 0.02:
        # Against the shank, not the vertical: rest poses stand with their legs apart.
        leg = rot.normalized(
            source.rest_position(f"{side}_ankle") - source.rest_position(f"{side}_knee")
        )
        rest_pitch = float(np.arcsin(np.clip(rot.normalized(line) @ leg, -1, 1)))
    # Ball and toes come along: they are where they are because of how the foot is turned.
    joint, noisy = rot.to_matrix(steady_turns(rot.from_matrix(joint), source.clip.fps)), joint
    ball = ankle + np.einsum("nij,nkj,nk->ni", joint, noisy, ball - ankle)
    if toes is not None:
        toes = joint @ np.swapaxes(noisy, 1, 2) @ toes
    foot = RecordedFoot.recorded(ankle, ball, joint, toes, normal, rest_pitch, source.clip.fps)
    points = [f"{side}_{part}" for part in ("ankle", "toe") if recorded.has(f"{side}_{part}")]
    noises = [point_noise(recorded.position(role), source.clip.fps) for role in points]
    # Where the ankle is quiet, what shakes the toe is the foot's own turn: that is steady by now.
    noise = max(noises) if noises[0] > QUIET else noises[0]
    foot = dataclasses.replace(foot, noise=noise)
    standing = None if source.facing is None else joint @ source.to_z_up.T @ source.facing
    return foot.with_knee(knee, standing)


def _hip_shift(
    source: UprightClip, side: str, pelvis: Array, humanoid: HumanoidDimensions
) -> Array:
    """Return (nframe, 3) how far a foot moves sideways because the humanoid's hips are narrower.

    Without it the legs of a broad-hipped skeleton would splay and reach less far down. The side
    follows the pelvis slowly, so that stance feet stay.
    """
    from scipy.ndimage import gaussian_filter1d

    left = rot.rotate(pelvis, np.array((0.0, 1.0, 0.0))) * (1.0, 1.0, 0.0)
    across = source.position("left_hip") - source.position("right_hip")
    half = float(np.median(np.linalg.norm(across, axis=1))) / 2
    more = float(humanoid.hips[side][1]) - (half if side == "left" else -half)
    left = gaussian_filter1d(left, 0.5 * source.clip.fps, axis=0, mode="nearest")
    return more * rot.normalized(left)


def _arm(source: UprightClip, side: str, body: dict[str, Array]) -> None:
    """Add upper arm, forearm and hand of one side to ``body``."""
    shoulder, elbow = source.position(f"{side}_shoulder"), source.position(f"{side}_elbow")
    name = source.rig.joints[f"{side}_elbow"]
    if source.has(f"{side}_wrist"):
        wrist = source.position(f"{side}_wrist")
    elif name in source.clip.ends:
        wrist = elbow + source.rotation(f"{side}_elbow") @ source.clip.ends[name] * source.scale
    else:
        wrist = 2 * elbow - shoulder
    upper, lower = rot.normalized(elbow - shoulder), rot.normalized(wrist - elbow)
    torso = rot.to_matrix(body["torso"])
    axis = _hinge_axis(upper, lower, source.rotation(f"{side}_shoulder"), -torso[..., 1])
    arm = frame_of(-upper, -axis)
    angle = np.arctan2(rot.dot(rot.cross(upper, lower), axis), rot.dot(upper, lower))
    body[f"{side}_upper_arm"] = rot.from_matrix(arm)
    half = np.maximum(angle, 0) / 2
    flex = np.stack([np.cos(half), 0 * half, -np.sin(half), 0 * half], axis=-1)
    forearm = rot.multiply(body[f"{side}_upper_arm"], flex)
    body[f"{side}_forearm"] = forearm
    body[f"{side}_hand"] = forearm
    if source.has(f"{side}_wrist") and source.facing is not None:
        rest_arm = source.rest_position(f"{side}_wrist") - source.rest_position(f"{side}_elbow")
        down = source.facing.T @ rot.normalized(rest_arm)
        hang = rot.to_matrix(rot.between(-UP, down))
        constant = source.to_z_up.T @ source.facing @ hang
        body[f"{side}_hand"] = rot.from_matrix(source.rotation(f"{side}_wrist") @ constant)
