"""Where one clip can go over into another: where their poses and velocities are most alike.

The likeness of two frames is that of their joints, weighted by the mass that each moves, of the
root's height and lean, of all velocities, and of which heels and toes stand. Where they stand in
the plane and which way they face does not count, for the second clip is put where the first leaves
off. Over an overlap the two run at their own cadence.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.feet import Foot
from mjmotion.body.motion import Motion
from mjmotion.exceptions import ClipError
from mjmotion.footsteps.contacts import Contact, contact_mask, contact_sites
from mjmotion.ik.solver import default_rigidity
from mjmotion.numerics.rotations import multiply, rotate, yaw_quat
from mjmotion.numerics.tangent import ominus

Array = NDArray[np.float64]

LENGTH = 0.7  # how long an overlap lasts [s]
SHORTEST = 0.1  # the least it may last [s]
FEWEST = 4  # frames of the shortest overlap
RATES = (0.4, 2.5)  # slowest and fastest cadence of the second clip against the first's
_STEP = 1.0 / 30.0  # frames are compared this far apart [s]
_PLACES = 7  # of an overlap that are compared
_HEIGHT = 10.0  # 1 rad of a joint counts as 1 / this of the root's height [1/m]
_SPEED = 0.15  # a velocity counts as what it moves in this time [s]
_STANDING = 0.4  # a heel or toe that stands in one alone counts as this much [rad²]
_KEEP = 0.1  # share of the middle unlikeness that an unused second of a clip costs, squared [1/s²]
_LIFT = 0.12  # a foot that leaves the ground for less than this makes no step [s]


@dataclasses.dataclass(frozen=True)
class Overlap:
    """Where one clip goes over into another.

    Attributes:
      first: frame of the first clip where it begins.
      second: frame of the second clip that belongs there.
      length: frames that it lasts.
    """

    first: int
    second: int
    length: int


@dataclasses.dataclass(frozen=True, eq=False)
class Traits:
    """What of a clip's frames is compared: features whose squared distance is their unlikeness.

    Attributes:
      frames: (n,) frames that they are of.
      quats: (n, k, 4) leans of root and balls, each times the root of its weight.
      flat: (n, m) all that is a plain number, likewise.
    """

    frames: NDArray[np.int64]
    quats: Array
    flat: Array

    @classmethod
    def of(cls, motion: Motion, contacts: Sequence[Contact], step: int) -> Traits:
        """Return the traits of every ``step``-th frame of a motion.

        Args:
          motion: the clip.
          contacts: who stands in it when.
          step: frames from one to the next.
        """
        model, qpos = motion.model, motion.qpos
        weight = default_rigidity(model)
        weight[:6] = weight[6:].max(initial=1.0)
        weight /= weight[6:].sum() if model.nv > 6 else 1.0
        heading = yaw_quat(-headings(motion))
        velocity = _velocity(motion)
        velocity[:, :3] = rotate(heading, velocity[:, :3])
        quats = [np.sqrt(weight[3]) * multiply(heading, qpos[:, 3:7])]
        flat = [np.sqrt(weight[0]) * _HEIGHT * qpos[:, 2:3]]
        for joint in range(1, model.njnt):
            address, dof = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
            if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_BALL:
                quats.append(np.sqrt(weight[dof]) * qpos[:, address : address + 4])
            else:
                flat.append(np.sqrt(weight[dof]) * qpos[:, address : address + 1])
        scale = np.sqrt(weight) * _SPEED
        scale[:3] *= _HEIGHT / 3.0
        flat.append(velocity * scale)
        masks = [contact_mask(contacts, site, motion.nframe) for site in contact_sites(model)]
        flat.append(np.sqrt(_STANDING) * np.array(masks, dtype=float).T.reshape(motion.nframe, -1))
        frames = np.arange(0, motion.nframe, step)
        return cls(frames, np.stack(quats, axis=1)[frames], np.concatenate(flat, axis=1)[frames])

    def unlike(self, other: Traits) -> Array:
        """Return how unlike frames are (n of these, n of the other's)."""
        a, b = self.flat, other.flat
        square = (a * a).sum(1)[:, None] + (b * b).sum(1) - 2.0 * a @ b.T
        for column in range(self.quats.shape[1]):
            # 8 (1 - |cos|) of half the angle between them is nearly the square of that angle.
            p, q = self.quats[:, column], other.quats[:, column]
            square += 8.0 * ((p[0] @ p[0]) - np.abs(p @ q.T))
        return np.maximum(square, 0.0)


def headings(motion: Motion) -> Array:
    """Return which way the root faces (nframe,) [rad], without jumps."""
    forward = rotate(motion.qpos[:, 3:7], np.array((1.0, 0.0, 0.0)))
    return np.unwrap(np.arctan2(forward[:, 1], forward[:, 0]))


def _velocity(motion: Motion) -> Array:
    """Return velocities (nframe, nv) [m/s, rad/s] by central differences."""
    if motion.nframe == 1:
        return np.zeros((1, motion.model.nv))
    step = ominus(motion.model, motion.qpos[1:], motion.qpos[:-1]) * motion.fps
    ends = np.concatenate((step[:1], step, step[-1:]))
    return np.asarray(0.5 * (ends[1:] + ends[:-1]))


def strikes(
    foot: Foot, contacts: Sequence[Contact], motion: Motion
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the frames at which a foot comes down and those at which it leaves.

    What begins with the clip or ends with it is no event, nor is a lift of a moment.
    """
    down = np.zeros(motion.nframe, dtype=bool)
    for part in ("heel", "toe"):
        down |= contact_mask(contacts, f"{foot.side}_{part}", motion.nframe)
    change = np.diff(down.astype(np.int8))
    lands, leaves = np.flatnonzero(change > 0) + 1, np.flatnonzero(change < 0) + 1
    if len(lands) == 0 or len(leaves) == 0:
        return lands, leaves
    after = np.searchsorted(lands, leaves)
    gap = np.where(after < len(lands), np.append(lands, 0)[after] - leaves, motion.nframe)
    brief = gap < _LIFT * motion.fps
    return np.delete(lands, after[brief]), leaves[~brief]


def stride_frames(motion: Motion, contacts: Sequence[Contact]) -> float | None:
    """Return how many frames a stride of a clip takes; None where it shows no whole stride."""
    gaps = []
    for foot in motion.character.feet:
        for events in strikes(foot, contacts, motion):
            gaps.extend(np.diff(events).tolist())
    return float(np.median(gaps)) if gaps else None


def cadence_ratio(
    first: Motion, second: Motion, contacts: tuple[Sequence[Contact], Sequence[Contact]]
) -> float:
    """Return how many frames of the second clip take as long in a stride as one of the first."""
    strides = [stride_frames(*pair) for pair in zip((first, second), contacts, strict=True)]
    if strides[0] is None or strides[1] is None:
        return 1.0
    return float(np.clip(strides[1] / strides[0], *RATES))


def spans(length: float, ratio: float) -> tuple[float, float]:
    """Return how many frames of each clip an overlap takes, about.

    It begins in the first's tempo and ends in the second's.

    Args:
      length: frames of the result.
      ratio: :func:`cadence_ratio`.
    """
    return 2.0 * length / (1.0 + ratio), 2.0 * length * ratio / (1.0 + ratio)


def default_length(
    first: Motion, second: Motion, ratio: float, parts: tuple[float, float] = (2.0, 2.0)
) -> int:
    """Return how many frames an overlap of two clips should last: LENGTH, less for short clips.

    Args:
      first: the clip that is left.
      second: the clip that is gone into, of the same rate.
      ratio: their :func:`cadence_ratio`.
      parts: it takes no more than one of so many parts of each.

    Raises:
      ClipError: a clip is too short to overlap.
    """
    fewest = max(FEWEST, round(SHORTEST * first.fps))
    wanted = LENGTH * first.fps
    for name, clip, span, part in zip(
        ("first", "second"), (first, second), spans(1.0, ratio), parts, strict=True
    ):
        wanted = min(wanted, (clip.nframe / part - 2.0) / span)
        if wanted < fewest:
            raise ClipError(
                f"the {name} clip has {clip.nframe} frames, too few to overlap:"
                f" give {int(np.ceil(part * (fewest * span + 2.0)))} at {first.fps:g} fps"
            )
    return round(wanted)


def find_overlap(
    first: Motion,
    second: Motion,
    contacts: tuple[Sequence[Contact], Sequence[Contact]],
    *,
    length: int | None = None,
    earliest: int = 0,
    spare: int = 0,
) -> Overlap:
    """Return where the first clip can best go over into the second.

    Args:
      first: the clip that is left.
      second: the clip that is gone into, of the same model and rate.
      contacts: of the first, and of the second.
      length: frames that it is to last; :func:`default_length` without.
      earliest: frame of the first clip before which it may not begin.
      spare: frames at the end of the second clip that it leaves alone.

    Raises:
      ClipError: a clip is too short for it.
    """
    ratio = cadence_ratio(first, second, contacts)
    length = default_length(first, second, ratio) if length is None else length
    taken = spans(length, ratio)
    lasts = (first.nframe - 2 - taken[0], second.nframe - 2 - taken[1] - spare)
    for name, last, low, span in zip(("first", "second"), lasts, (earliest, 0), taken, strict=True):
        if last < low:
            raise ClipError(
                f"the {name} clip is too short to overlap: a transition of {length} frames takes"
                f" {int(np.ceil(span)) + 2} of its frames, {int(np.ceil(low - last))} more than are"
                " left; give a longer clip or a shorter overlap"
            )
    step = max(1, round(_STEP * first.fps))
    traits = [Traits.of(*pair, step) for pair in zip((first, second), contacts, strict=True)]
    unlike = traits[0].unlike(traits[1])
    begins = [
        trait.frames[(trait.frames >= low) & (trait.frames <= last)]
        for trait, low, last in zip(traits, (earliest, 0), lasts, strict=True)
    ]
    if min(len(begin) for begin in begins) == 0:  # between two frames that are compared
        begins = [np.array([low]) for low in (earliest, 0)]
    total = np.zeros((len(begins[0]), len(begins[1])))
    for share in np.linspace(0.0, 1.0, _PLACES):
        rows, columns = (
            np.clip(np.round((begin + share * span) / step).astype(int), 0, size - 1)
            for begin, span, size in zip(begins, taken, unlike.shape, strict=True)
        )
        total += unlike[np.ix_(rows, columns)] / _PLACES
    # A little of a clip may go for a better place, most of it never.
    unused = [(begins[0].max() - begins[0])[:, None], begins[1] - begins[1].min()]
    lost = sum((frames / first.fps) ** 2 for frames in unused)
    cost = total + _KEEP * float(np.median(total)) * lost
    row, column = np.unravel_index(int(np.argmin(cost)), cost.shape)
    return Overlap(int(begins[0][row]), int(begins[1][column]), length)
