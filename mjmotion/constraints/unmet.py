"""The user's own constraints, measured on the adapted motion: which were not met.

    wishes = load_constraints("constraints.yaml", model, nframe)
    missed = unmet_wishes(adaptation.motion, wishes)

What the scene asks of the feet is the program's own plan, and how well it was kept is seen in the
figures. A wish of the user's has no figure: it is met or it is named here.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.kinematics import Kinematics, Pose, site_id
from mjmotion.body.motion import Motion
from mjmotion.constraints import (
    Constraint,
    LookAt,
    RelativeConstraint,
    SiteConstraint,
    lay_out,
)
from mjmotion.exceptions import ConstraintError, frame_list
from mjmotion.numerics.rotations import conjugate, from_matrix, multiply, to_matrix, yaw_quat

Array = NDArray[np.float64]

POSITION_TOLERANCE = 1e-3  # [m]
TURN_TOLERANCE = np.radians(0.5)  # [rad]


@dataclasses.dataclass(frozen=True)
class Unmet:
    """A constraint that could not be met: where and by how much [mm]."""

    constraint: str
    frames: tuple[int, ...]
    residual_mm: float


@dataclasses.dataclass(frozen=True)
class Missed:
    """A constraint that was not met: what, where, by how much, and whose it is.

    Attributes:
      constraint: such as ``position of left_hand``.
      frames: where.
      residual_mm: the most it is off [mm]; None for an orientation.
      residual_deg: the most it is off [degrees]; None for a position.
      own: whether the user asked for it; else the scene did.
    """

    constraint: str
    frames: tuple[int, ...]
    residual_mm: float | None
    residual_deg: float | None = None
    own: bool = False

    def as_dict(self) -> dict[str, Any]:
        """Return it as ``report.json`` holds it."""
        return {**dataclasses.asdict(self), "frames": list(self.frames)}

    def __str__(self) -> str:
        off = (
            f"{self.residual_mm:.1f} mm"
            if self.residual_mm is not None
            else f"{self.residual_deg:.1f} degrees"
        )
        return f"{self.constraint} at frames {frame_list(self.frames)}, off by {off}"


def unmet_wishes(motion: Motion, wishes: Sequence[Constraint]) -> tuple[Missed, ...]:
    """Return the user's constraints that a motion does not meet.

    Those of a weight below 1 may give way and are not asked after. Where two speak of the same site
    and frame, the later counts. Places in another site's frame, gazes and places that are free to
    move are measured by the fit, which knows where they went; their orientations are measured here.

    Raises:
      ConstraintError: a frame the motion does not have.
      ModelError: an unknown site.
    """
    wishes = [wish for wish in wishes if not isinstance(wish, LookAt)]
    if not wishes:
        return ()
    model = motion.model
    pose = Kinematics(model, motion.nframe).forward(motion.qpos)
    held = [_held(wish, pose) for wish in wishes if isinstance(wish, SiteConstraint)]
    links = [wish for wish in wishes if isinstance(wish, RelativeConstraint)]
    targets = lay_out([*(wish for wish in held if wish is not None), *links], model, motion.nframe)
    rows = targets.frames
    gap = np.linalg.norm(targets.position - pose.site_xpos[rows][:, targets.sites], axis=-1)
    turn = _angle(pose.site_xmat[rows][:, targets.sites], targets.matrix)
    found: list[Missed] = []
    for column, site in enumerate(targets.sites):
        name = model.site(int(site)).name
        bad = (targets.position_weight[:, column] == 1.0) & (gap[:, column] > POSITION_TOLERANCE)
        if bad.any():
            frames = tuple(targets.frames[bad].tolist())
            worst = 1000.0 * float(gap[bad, column].max())
            found.append(Missed(f"position of {name}", frames, worst, own=True))
        found += _turned(
            f"orientation of {name}", rows, targets.turn_weight[:, column], turn[:, column]
        )
    for link in targets.links:
        wanted = pose.site_xmat[rows, link.to] @ to_matrix(link.quat)
        name = f"orientation of {model.site(link.site).name} to {model.site(link.to).name}"
        angle = _angle(pose.site_xmat[rows, link.site], wanted)
        found += _turned(name, rows, link.turn_weight, angle)
    return tuple(found)


def _held(wish: SiteConstraint, pose: Pose) -> SiteConstraint | None:
    """Return what of a wish does not move: all, or the orientation of what is free to move."""
    if not wish.free:
        return wish
    if wish.quat is None:
        return None
    quat = wish.quat
    if "yaw" in wish.free:
        site = pose.site_xmat[wish.frames, site_id(pose.model, wish.site)]
        turn = multiply(from_matrix(site), conjugate(quat))
        # All frames turn by the same angle: that of the mean of their turns.
        yaw = 2.0 * np.arctan2(*(turn * np.sign(turn[:, :1] + 1e-12)).mean(axis=0)[[3, 0]])
        quat = multiply(yaw_quat(yaw), quat)
    return dataclasses.replace(wish, position=None, quat=quat, free=())


def _angle(one: Array, other: Array) -> Array:
    """Return the angles [rad] between orientations (..., 3, 3), exact at any angle."""
    between = np.swapaxes(one, -1, -2) @ other
    # A turn's trace holds the cosine of its angle and its skew part the sine.
    skew = between - between.swapaxes(-1, -2)
    sine = np.linalg.norm(skew, axis=(-1, -2)) / np.sqrt(8.0)
    return np.asarray(np.arctan2(sine, (np.trace(between, axis1=-2, axis2=-1) - 1.0) / 2.0))


def _turned(name: str, frames: NDArray[np.int64], weight: Array, angle: Array) -> list[Missed]:
    """Return an orientation, if it is missed at any of the frames (n,) where it is exact."""
    bad = (weight == 1.0) & (angle > TURN_TOLERANCE)
    if not bad.any():
        return []
    degrees = float(np.degrees(angle[bad].max()))
    return [Missed(name, tuple(frames[bad].tolist()), None, degrees, own=True)]


def all_missed(
    unmet: Sequence[Unmet], motion: Motion, wishes: Sequence[Constraint] = ()
) -> tuple[Missed, ...]:
    """Return everything that was not met: the user's wishes first, then what the scene asked.

    Args:
      unmet: what the fit could not meet, wishes among it.
      motion: the adapted motion.
      wishes: the user's own constraints.
    """
    asked: dict[str, set[int]] = {}  # measured here
    known: dict[str, set[int]] = {}  # measured by the fit
    for wish in wishes:
        frames = wish.frames.tolist()
        if isinstance(wish, RelativeConstraint):
            known.setdefault(f"position of {wish.site} to {wish.to}", set()).update(frames)
        elif isinstance(wish, LookAt):
            known.setdefault(f"gaze of {wish.site}", set()).update(frames)
        elif wish.position is not None:
            names = known if wish.free else asked
            names.setdefault(f"position of {wish.site}", set()).update(frames)
    rest = []
    for one in unmet:
        others = tuple(f for f in one.frames if f not in asked.get(one.constraint, ()))
        if others:
            own = bool(known.get(one.constraint, set()) & set(others))
            rest.append(Missed(one.constraint, others, one.residual_mm, own=own))
    return (*unmet_wishes(motion, wishes), *rest)


def check_free(unmet: Sequence[Unmet], wishes: Sequence[Constraint]) -> None:
    """Refuse what is free to move as a whole and still cannot be met at all of its frames.

    Other wishes out of reach are followed as far as the body goes. What must not slide has no such
    middle way: followed frame by frame it would slide.

    Args:
      unmet: what a fit could not meet.
      wishes: the user's own constraints.

    Raises:
      ConstraintError: names the site, the frames and the residual.
    """
    for wish in wishes:
        if not (isinstance(wish, SiteConstraint) and wish.free):
            continue
        for one in unmet:
            frames = np.intersect1d(one.frames, wish.frames).tolist()
            if one.constraint == f"position of {wish.site}" and frames:
                raise ConstraintError(
                    f"'{wish.site}' is free in {', '.join(wish.free)} and held in one piece, but"
                    f" its frames cannot all be met: off by {one.residual_mm:.1f} mm at most, at"
                    f" frames {frame_list(frames)}; free more of it, or hold it for fewer frames",
                    frames,
                )
