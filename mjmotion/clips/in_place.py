"""Clips walked in place, as on a treadmill or for a game: recognised, and set going again.

A foot that stands stays where it is. Where a recording keeps the pelvis in place, its standing feet
glide back under it instead; what they glide, the body travels the other way.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.character import Character, CharacterLike
from mjmotion.boundary.limits import MOST_FRAMES, at_most
from mjmotion.clips.dimensions import HumanoidDimensions
from mjmotion.clips.mapping import Mapped, map_clip
from mjmotion.clips.rig import Rig
from mjmotion.clips.skeleton import Clip
from mjmotion.clips.upright import UprightClip, drop_rest_frame, make_upright
from mjmotion.exceptions import ClipError
from mjmotion.numerics import rotations as rot

Array = NDArray[np.float64]

_LOW = 0.015  # over the lowest a foot's point comes, it stands [m]
_GLIDE = 0.3  # standing feet that go faster glide [m/s]
_STAYS = 0.35  # of what its feet glide, what the pelvis of one in place may travel itself
_SMOOTH = 0.05  # standard deviation of the smoothing of the speed [s]
_SEAM = 0.2  # how long a repetition takes to pass into the next [s]
_APART = np.radians(15)  # turn of joints between end and beginning that is no loop any more


def going(
    clip: Clip,
    character: CharacterLike,
    rig: Rig,
    *,
    in_place: str | float | None = None,
    loop: int = 1,
    floor: str = "auto",
) -> Mapped:
    """Put a clip on the humanoid, repeated and set going as asked.

    Args:
      clip: the clip, as read.
      character: the humanoid, with or without a scene, or what names it.
      rig: role to joint.
      in_place: ``"travel"`` rebuilds the travel, a number does so with this mean speed [m/s],
        ``"keep"`` leaves it; None leaves it too, with a note where the clip is walked in place.
      loop: how often the clip is repeated.
      floor: as :func:`map_clip` takes it.

    Raises:
      ClipError: the clip cannot be mapped, is no loop, or has no foot that stands.
    """
    character = Character.of(character)
    leg = HumanoidDimensions(character).leg
    clip, dropped = drop_rest_frame(clip)
    clip = repeat(clip, rig, leg, loop)
    if in_place not in (None, "keep"):
        clip = rebuild_travel(clip, rig, leg, None if in_place == "travel" else float(in_place))
    mapped = map_clip(clip, character, rig, floor)
    speed = glide_speed(clip, rig, leg) if in_place is None else None
    notes = [] if dropped is None else [dropped]
    if speed is not None:
        notes.append(
            f"the recording does not travel: its standing feet glide at {speed:.1f} m/s;"
            " --in-place travel rebuilds the travel from them"
        )
    return dataclasses.replace(mapped, notes=(*mapped.notes, *notes), odd=(*mapped.odd, *notes))


def glide_speed(clip: Clip, rig: Rig, leg_length: float) -> float | None:
    """Return how fast standing feet glide [m/s] in a clip walked in place, None in another.

    Args:
      clip: the clip, as read.
      rig: role to joint.
      leg_length: of the humanoid [m].
    """
    if clip.nframe < 3:
        return None
    source = make_upright(clip, rig, leg_length)
    standing, speeds = _standing(source)
    if not standing.any():
        return None
    glide = np.linalg.norm(speeds[standing], axis=1)
    hips = (source.position("left_hip") + source.position("right_hip"))[:, :2] / 2
    own = float(np.linalg.norm(hips[-1] - hips[0])) * clip.fps / (clip.nframe - 1)
    speed = float(np.median(glide))
    return speed if speed > _GLIDE and own < _STAYS * speed else None


def rebuild_travel(clip: Clip, rig: Rig, leg_length: float, speed: float | None = None) -> Clip:
    """Return a clip that travels as its standing feet say.

    The body's speed is what its lowest points on the feet glide, the other way, smoothed; where no
    foot is low, in the flight of a run, it goes on between what is before and after.

    Args:
      clip: a clip walked in place.
      rig: role to joint.
      leg_length: of the humanoid [m].
      speed: mean speed to have [m/s]; what the feet say without.

    Raises:
      ClipError: no foot is ever low, or a speed is asked for where nothing moves.
    """
    from scipy.ndimage import gaussian_filter1d

    source = make_upright(clip, rig, leg_length)
    standing, speeds = _standing(source)
    weight = standing.sum(axis=1)
    if clip.nframe < 3 or not weight.any():
        raise ClipError(f"'{clip.name}': no foot ever stands: its travel cannot be rebuilt")
    known = np.flatnonzero(weight)
    mean = (speeds * standing[..., None]).sum(axis=1)[known] / weight[known, None]
    frames = np.arange(clip.nframe)
    velocity = -np.stack([np.interp(frames, known, column) for column in mean.T], axis=1)
    velocity = gaussian_filter1d(velocity, _SMOOTH * clip.fps, axis=0, mode="nearest")
    if speed is not None:
        own = float(np.linalg.norm(velocity, axis=1).mean())
        if own < 1e-6:
            raise ClipError(f"'{clip.name}': its feet do not glide: no speed can be given to it")
        velocity = velocity * (speed / own)
    shift = np.zeros((clip.nframe, 3))
    shift[1:, :2] = np.cumsum((velocity[1:] + velocity[:-1]) / 2, axis=0) / clip.fps
    moved = clip.positions + (shift @ source.to_z_up / source.scale)[:, None]
    return dataclasses.replace(clip, positions=moved)


def _standing(source: UprightClip) -> tuple[NDArray[np.bool_], Array]:
    """Return which points of feet stand (nframe, npoint), and all speeds [m/s] (…, 2)."""
    roles = [f"{side}_{part}" for side in ("left", "right") for part in ("ankle", "toe")]
    points = np.stack([source.position(role) for role in roles if source.has(role)], axis=1)
    speeds = np.gradient(points, axis=0) * source.clip.fps
    height = points[..., 2]
    low = height - height.min(axis=0) < _LOW
    return low, speeds[..., :2]


def repeat(clip: Clip, rig: Rig, leg_length: float, count: int) -> Clip:
    """Return a loop ``count`` times, each time from where the last one ended.

    A repetition is moved and turned over the ground so that its pelvis goes on; what is left of the
    difference between end and beginning passes away over the first 0.2 s.

    Args:
      clip: the loop; its last frame may be its first again. What goes on after that, in the second
        half, is cut off where it is most like the beginning.
      rig: role to joint.
      leg_length: of the humanoid [m].
      count: how often, 1 or more.

    Raises:
      ClipError: it does not come back to its beginning.
    """
    if count == 1:
        return clip
    at_most(count * clip.nframe, MOST_FRAMES, f"frames of '{clip.name}', {count} times", ClipError)
    if count < 1 or clip.nframe < 4:
        raise ClipError(f"'{clip.name}': it cannot be repeated {count} times")
    up = make_upright(clip, rig, leg_length).to_z_up[2]  # in the file's axes
    pelvis = clip.index(rig.joints["pelvis"])
    # Turned as a whole to where the pelvis then faces, what is left between end and beginning.
    turns = _yaw(clip.rotations[:, pelvis] @ clip.rotations[0, pelvis].T, up)
    gaps = _angle(clip.rotations, turns[:, None] @ clip.rotations[0])
    gap = np.sqrt((gaps**2).mean(axis=1))
    end = clip.nframe // 2 + int(np.argmin(gap[clip.nframe // 2 :]))
    step = float(np.sqrt((_angle(clip.rotations[1:2], clip.rotations[0]) ** 2).mean()))
    if gap[end] > max(_APART, 3 * step):
        raise ClipError(
            f"'{clip.name}': nowhere in its second half does it come back to its beginning:"
            f" {np.degrees(gap[end]):.0f} degrees are left at frame {end}: it is no loop"
        )
    if gap[-1] < 1.5 * max(gap[end], step):
        end = clip.nframe - 1
    clip, turned = clip.cut(0, end + 1), turns[end]
    # The same frame twice: the step to the next repetition is then that after the first frame.
    same = bool(gap[end] < 0.5 * step) or end < len(gap) - 1
    body = clip.cut(0, clip.nframe - 1) if same else clip
    last = clip.positions[-1, pelvis]
    start = clip.positions[0, pelvis]
    onward = np.zeros(3) if same else turned @ (clip.positions[1, pelvis] - start)
    flat = np.eye(3) - np.outer(up, up)
    positions, rotations = [body.positions], [body.rotations]
    turn, place = np.eye(3), np.zeros(3)
    for _ in range(count - 1):
        # One more time the way from the first frame to the last.
        shift = flat @ (last + onward - turned @ start)
        turn, place = turn @ turned, turn @ shift + place
        positions.append(body.positions @ turn.T + place)
        rotations.append(turn @ body.rotations)
    whole = dataclasses.replace(
        body, positions=np.concatenate(positions), rotations=np.concatenate(rotations)
    )
    return _pass_over(whole, body.nframe, count)


def _pass_over(clip: Clip, period: int, count: int) -> Clip:
    """Return a repeated clip whose seams are smooth: each difference passes away in 0.2 s."""
    width = min(max(round(_SEAM * clip.fps), 1), period - 1)
    positions, quats = clip.positions.copy(), rot.from_matrix(clip.rotations)
    for seam in range(period, count * period, period):
        fade = 1 - np.arange(width) / width
        fade = (fade * fade * (3 - 2 * fade))[:, None, None]
        # Where the frames before the seam would have gone on to.
        ahead = 2 * positions[seam - 1] - positions[seam - 2]
        positions[seam : seam + width] += fade * (ahead - positions[seam])
        step = rot.multiply(quats[seam - 1], rot.conjugate(quats[seam - 2]))
        miss = rot.multiply(rot.multiply(step, quats[seam - 1]), rot.conjugate(quats[seam]))
        part = rot.exp(fade * rot.log(miss)[None])
        quats[seam : seam + width] = rot.multiply(part, quats[seam : seam + width])
    return dataclasses.replace(clip, positions=positions, rotations=rot.to_matrix(quats))


def _yaw(turn: Array, up: Array) -> Array:
    """Return the parts of rotations (n, 3, 3) that turn about ``up``."""
    quats = rot.from_matrix(turn)
    along = (quats[:, 1:] @ up)[:, None] * up
    return rot.to_matrix(rot.normalized(np.concatenate([quats[:, :1], along], axis=1)))


def _angle(first: Array, second: Array) -> Array:
    """Return the angles [rad] between rotations (..., 3, 3)."""
    cosine = (np.einsum("...ij,...ij->...", first, second) - 1) / 2
    return np.arccos(np.clip(cosine, -1, 1))
