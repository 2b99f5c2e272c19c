"""What a fit gives back: the motion, what every level did, and what could not be met."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.bones import Bones
from mjmotion.body.kinematics import Kinematics, Pose, site_positions
from mjmotion.body.motion import Motion
from mjmotion.constraints import Targets
from mjmotion.constraints.unmet import Unmet
from mjmotion.ik.solver import link_position

Array = NDArray[np.float64]

UNMET = 1e-3  # residual from which a constraint counts as not met [m]


@dataclasses.dataclass(frozen=True)
class LevelTrace:
    """One level: its place (from 1), knots, time [s] and the error it left [% of height]."""

    level: int
    frames_per_knot: float
    seconds: float
    max_error_percent: float


@dataclasses.dataclass(frozen=True)
class Trace:
    """What a fit did.

    Attributes:
      levels: its levels.
      fit_seconds: its whole time [s].
      first_error_percent, exact_error_percent: the errors before and after [% of height].
      nscalar: number of scalar constraints.
      preprocessing_seconds: of the whole time, what the first guess took (§4.5) [s].
    """

    levels: tuple[LevelTrace, ...]
    fit_seconds: float
    first_error_percent: float
    exact_error_percent: float
    nscalar: int
    preprocessing_seconds: float = 0.0


@dataclasses.dataclass(frozen=True, eq=False)
class Fit:
    """A fitted motion, what the fit did, and what it could not meet.

    Attributes:
      motion: the fitted motion.
      trace: what every level did.
      unmet: constraints that are off by more than the tolerance.
      moves: (nshared, 4) what each shared move came to: along its directions [m], and its turn
        [rad]; in the order in which they were given, those of ``free`` constraints last.
      targets: what the fit held in the end, with shared moves made.
    """

    motion: Motion
    trace: Trace
    unmet: tuple[Unmet, ...]
    moves: Array
    targets: Targets


def residuals(motion: Motion, targets: Targets, bones: Bones | None = None) -> Array:
    """Return position errors (n, s) [m] at the targets' frames, 0 where nothing is wanted."""
    if len(targets.frames) == 0 or len(targets.sites) == 0:
        return np.zeros((len(targets.frames), len(targets.sites)))
    bones = bones if bones is None else bones.at(targets.frames)
    sites = site_positions(motion.model, motion.qpos[targets.frames], targets.sites, bones)
    gap = np.linalg.norm(targets.position - sites, axis=-1)
    return np.asarray(gap * (targets.position_weight > 0))


def other_residuals(
    motion: Motion, targets: Targets, bones: Bones | None = None
) -> list[tuple[str, Array]]:
    """Return the names of links and gazes with their errors (n,) [m], 0 where nothing is wanted.

    A gaze's error is how far its line passes from the point.
    """
    if not (targets.links or targets.gazes):
        return []
    pose = _pose_at(motion, targets, bones)
    name = [motion.model.site(site).name for site in range(motion.model.nsite)]
    found = []
    for link in targets.links:
        gap = np.linalg.norm(link_position(pose, link) - pose.site_xpos[:, link.site], axis=-1)
        label = f"position of {name[link.site]} to {name[link.to]}"
        found.append((label, gap * (link.position_weight == 1.0)))
    for gaze in targets.gazes:
        away = gaze.point - pose.site_xpos[:, gaze.site]
        axis = pose.site_xmat[:, gaze.site] @ gaze.axis
        along = np.maximum(np.einsum("ni,ni->n", away, axis), 0.0)
        gap = np.linalg.norm(away - along[:, None] * axis, axis=-1)
        found.append((f"gaze of {name[gaze.site]}", gap * (gaze.weight == 1.0)))
    return found


def _pose_at(motion: Motion, targets: Targets, bones: Bones | None) -> Pose:
    bones = bones if bones is None else bones.at(targets.frames)
    kinematics = Kinematics(motion.model, len(targets.frames), bones=bones)
    return kinematics.forward(motion.qpos[targets.frames])


def find_unmet(
    motion: Motion,
    targets: Targets,
    residual: Array,
    tolerance: float = UNMET,
    bones: Bones | None = None,
) -> tuple[Unmet, ...]:
    """Return the exact position targets of a motion that are off by more than ``tolerance`` [m].

    Args:
      motion: the fitted motion.
      targets: what was to hold.
      residual: (n, s) :func:`residuals` of the two [m].
      tolerance: residual from which a constraint counts as not met [m].
      bones: a body for each frame, where it changes.
    """
    errors = [
        (
            f"position of {motion.model.site(site).name}",
            residual[:, column] * (targets.position_weight[:, column] == 1.0),
        )
        for column, site in enumerate(targets.sites)
    ]
    found = []
    for name, error in errors + other_residuals(motion, targets, bones):
        bad = np.flatnonzero(error > tolerance)
        if len(bad):
            frames = tuple(int(frame) for frame in targets.frames[bad])
            found.append(Unmet(name, frames, 1000.0 * float(error[bad].max())))
    return tuple(found)
