"""How well a motion meets constraints: residuals, and those that are not met.

    targets = lay_out(constraints, motion.model, motion.nframe)
    for one in find_unmet(motion, targets, constraints):
        print(one)                  # position of left_hand at frames 60, 61, off by 4.2 mm

Residuals are measured against the laid-out targets, which know which constraint each comes from.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.bones import Bones
from mjmotion.body.kinematics import Kinematics, Pose, site_orientations, site_positions
from mjmotion.body.motion import Motion
from mjmotion.constraints.targets import LookAtTarget, RelativeTarget, Targets
from mjmotion.constraints.types import Constraint, SiteConstraint
from mjmotion.exceptions import ConstraintError, frame_list
from mjmotion.numerics.rotations import to_matrix

Array = NDArray[np.float64]
Index = NDArray[np.int64]

UNMET = 1e-3  # residual from which a position or a look-at counts as not met [m]
_FAR = 1e4  # a residual from which it is told in metres [mm]
UNTURNED = np.radians(0.5)  # the same of an orientation [rad]


@dataclasses.dataclass(frozen=True)
class Unmet:
    """A constraint that could not be met: which, where, and by how much.

    Attributes:
      constraint: what it asks for, such as ``position of left_hand``.
      frames: where it is off.
      residual_mm: the most it is off [mm]; None for an orientation.
      residual_deg: the most it is off [degrees]; None for a position.
      index: its place among the constraints of its source.
      source: whose it is: ``"user"`` or ``"scene"``, what the scene asks of the feet.
    """

    constraint: str
    frames: tuple[int, ...]
    residual_mm: float | None
    residual_deg: float | None = None
    index: int = 0
    source: str = "user"

    def as_dict(self) -> dict[str, Any]:
        """Return it as ``report.json`` holds it."""
        return {**dataclasses.asdict(self), "frames": list(self.frames)}

    def __str__(self) -> str:
        if self.residual_mm is None:
            off = f"{self.residual_deg:.1f} degrees"
        elif self.residual_mm < _FAR:
            off = f"{self.residual_mm:.1f} mm"
        else:
            off = f"{self.residual_mm / 1000.0:.1f} m"
        return f"{self.constraint} at frames {frame_list(self.frames)}, off by {off}"


def residuals(motion: Motion, targets: Targets, bones: Bones | None = None) -> Array:
    """Return position errors (n, s) [m] at the targets' frames, 0 where nothing is wanted.

    Args:
      motion: the motion.
      targets: what is to hold.
      bones: a body for each frame of the motion, where that changes.
    """
    if len(targets.frames) == 0 or len(targets.sites) == 0:
        return np.zeros((len(targets.frames), len(targets.sites)))
    bones = bones if bones is None else bones.at(targets.frames)
    sites = site_positions(motion.model, motion.qpos[targets.frames], targets.sites, bones)
    gap = np.linalg.norm(targets.position - sites, axis=-1)
    return np.asarray(gap * (targets.position_weight > 0))


def relational_residuals(motion: Motion, targets: Targets, bones: Bones | None = None) -> Array:
    """Return errors (n, k) [m] of exact relative places, then of exact look-ats.

    A look-at's error is how far its line passes from the point.
    """
    if not (targets.relative or targets.look_at):
        return np.zeros((len(targets.frames), 0))
    pose = _pose_at(motion, targets, bones)
    errors = [_relative_gap(pose, one) * (one.position_weight == 1.0) for one in targets.relative]
    errors += [_look_at_gap(pose, one) * (one.weight == 1.0) for one in targets.look_at]
    return np.stack(errors, axis=1)


def find_unmet(
    motion: Motion,
    targets: Targets,
    constraints: Sequence[Constraint],
    bones: Bones | None = None,
    tolerance: float = UNMET,
    gap: Array | None = None,
) -> tuple[Unmet, ...]:
    """Return the exact constraints that a motion does not meet, in their own order.

    Those of a weight below 1 may give way and are not asked after; where two speak of the same
    site and frame, the later counts. Orientations that the scene asks of feet are not asked after
    either: how feet stand has figures of its own.

    Args:
      motion: the fitted motion.
      targets: the constraints as laid out, those that are free to move where they went.
      constraints: what the targets were laid out from.
      bones: a body for each frame, where it changes.
      tolerance: residual from which a position counts as not met [m].
      gap: :func:`residuals` of the two, if they are known already.
    """
    if len(targets.frames) == 0:
        return ()
    off = _Off(targets.frames, constraints, tolerance)
    name = [motion.model.site(site).name for site in range(motion.model.nsite)]
    gap = residuals(motion, targets, bones) if gap is None else gap
    for column, site in enumerate(targets.sites):
        index = targets.position_index[:, column]
        exact = targets.position_weight[:, column] == 1.0
        off.add(f"position of {name[site]}", index, exact, gap[:, column])
    for column, angle in _user_turns(motion, targets, constraints, bones):
        index = targets.turn_index[:, column]
        exact = targets.turn_weight[:, column] == 1.0
        off.add_turn(f"orientation of {name[targets.sites[column]]}", index, exact, angle)
    if not (targets.relative or targets.look_at):
        return off.in_order()
    pose = _pose_at(motion, targets, bones)
    for one in targets.relative:
        label = f"{name[one.site]} to {name[one.to]}"
        exact = one.position_weight == 1.0
        off.add(f"position of {label}", one.position_index, exact, _relative_gap(pose, one))
        wanted = pose.site_xmat[:, one.to] @ to_matrix(one.quat)
        angle = _angle(pose.site_xmat[:, one.site], wanted)
        off.add_turn(f"orientation of {label}", one.turn_index, one.turn_weight == 1.0, angle)
    for look in targets.look_at:
        label = f"look-at of {name[look.site]}"
        off.add(label, look.index, look.weight == 1.0, _look_at_gap(pose, look))
    return off.in_order()


def _user_turns(
    motion: Motion, targets: Targets, constraints: Sequence[Constraint], bones: Bones | None
) -> list[tuple[int, Array]]:
    """Return how far (n,) [rad] sites are from orientations of the user's, and their columns."""
    mine = [index for index, one in enumerate(constraints) if one.source == "user"]
    columns = np.flatnonzero(np.isin(targets.turn_index, mine).any(axis=0))
    if len(columns) == 0:
        return []
    own = bones if bones is None else bones.at(targets.frames)
    qpos = motion.qpos[targets.frames]
    quat = site_orientations(motion.model, qpos, targets.sites[columns], own)
    angle = _angle(to_matrix(quat), targets.matrix[:, columns])
    return list(zip(columns.tolist(), angle.T, strict=True))


@dataclasses.dataclass(eq=False)
class _Off:
    """Collects what is off, a constraint at a time."""

    frames: Index
    constraints: Sequence[Constraint]
    tolerance: float
    found: list[tuple[int, Unmet]] = dataclasses.field(default_factory=list)

    def add(self, label: str, index: Index, exact: NDArray[np.bool_], gap: Array) -> None:
        """Note the constraints whose places (n,) [m] are off at frames where they are exact."""
        bad = exact & (gap > self.tolerance)
        for which in np.unique(index[bad]):
            rows = bad & (index == which)
            self._note(label, int(which), rows, residual_mm=1000.0 * float(gap[rows].max()))

    def add_turn(self, label: str, index: Index, exact: NDArray[np.bool_], angle: Array) -> None:
        """Note the user's constraints whose orientations (n,) [rad] are off."""
        bad = exact & (angle > UNTURNED)
        for which in np.unique(index[bad]):
            if self.constraints[which].source == "user":
                rows = bad & (index == which)
                degrees = float(np.degrees(angle[rows].max()))
                self._note(label, int(which), rows, residual_mm=None, residual_deg=degrees)

    def _note(self, label: str, which: int, rows: NDArray[np.bool_], **residual: Any) -> None:
        source = self.constraints[which].source
        place = sum(one.source == source for one in self.constraints[:which])
        frames = tuple(int(frame) for frame in self.frames[rows])
        unmet = Unmet(label, frames, **residual, index=place, source=source)
        self.found.append((which, unmet))

    def in_order(self) -> tuple[Unmet, ...]:
        """Return what was noted, in the order of the constraints."""
        return tuple(unmet for _, unmet in sorted(self.found, key=lambda found: found[0]))


def check_free(unmet: Sequence[Unmet], constraints: Sequence[Constraint]) -> None:
    """Refuse what is free to move as a whole and still cannot be met at all of its frames.

    Other constraints out of reach are followed as far as the body goes. What must not slide has no
    such middle way: followed frame by frame it would slide.

    Args:
      unmet: what a fit could not meet.
      constraints: the user's own.

    Raises:
      ConstraintError: names the site, the frames and the residual.
    """
    for one in unmet:
        if one.source != "user" or one.residual_mm is None:
            continue
        constraint = constraints[one.index]
        if isinstance(constraint, SiteConstraint) and constraint.free:
            raise ConstraintError(
                f"'{constraint.site}' is free in {', '.join(constraint.free)} and held in one"
                f" piece, but its frames cannot all be met: off by {one.residual_mm:.1f} mm at"
                f" most, at frames {frame_list(one.frames)}; free more of it, or hold it for fewer"
                " frames",
                one.frames,
            )


def _pose_at(motion: Motion, targets: Targets, bones: Bones | None) -> Pose:
    bones = bones if bones is None else bones.at(targets.frames)
    kinematics = Kinematics(motion.model, len(targets.frames), bones=bones)
    return kinematics.forward(motion.qpos[targets.frames])


def _relative_gap(pose: Pose, one: RelativeTarget) -> Array:
    """Return how far (n,) the held site is from its place in the other's frame [m]."""
    return np.linalg.norm(one.world_position(pose) - pose.site_xpos[:, one.site], axis=-1)


def _look_at_gap(pose: Pose, one: LookAtTarget) -> Array:
    """Return how far (n,) a site's axis, drawn out forwards, passes from its point [m]."""
    away = one.point - pose.site_xpos[:, one.site]
    axis = pose.site_xmat[:, one.site] @ one.axis
    along = np.maximum(np.einsum("ni,ni->n", away, axis), 0.0)
    return np.linalg.norm(away - along[:, None] * axis, axis=-1)


def _angle(one: Array, other: Array) -> Array:
    """Return the angles [rad] between orientations (..., 3, 3), exact at any angle."""
    between = np.swapaxes(one, -1, -2) @ other
    # A turn's trace holds the cosine of its angle and its skew part the sine.
    skew = between - between.swapaxes(-1, -2)
    sine = np.linalg.norm(skew, axis=(-1, -2)) / np.sqrt(8.0)
    return np.asarray(np.arctan2(sine, (np.trace(between, axis1=-2, axis2=-1) - 1.0) / 2.0))
