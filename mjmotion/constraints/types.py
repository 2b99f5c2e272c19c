"""What can be asked of sites at some frames: a place, a relative place, a point to look at.

hand = SiteConstraint("left_hand", frames=range(60, 80), position=points)
hip = RelativeConstraint("left_hand", range(60, 80), to="pelvis", position=(0.0, 0.2, 0.05))
look = LookAt("face", range(60, 80), point=(2.0, 0.0, 1.0))
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjmotion.exceptions import ConstraintError, wrong_type
from mjmotion.numerics.rotations import normalized

Array = NDArray[np.float64]

FREE = ("x", "y", "z", "yaw")


@dataclasses.dataclass(frozen=True, eq=False)
class SiteConstraint:
    """Where one site must be, and how turned, at some frames.

    Attributes:
      site: name of the site.
      frames: (n,) frames, each once.
      position: (n, 3) world positions [m], or None; one (3,) point serves every frame.
      quat: (n, 4) world orientations wxyz of the site's frame, or None; one (4,) serves all.
      weight: in (0, 1]: 1 holds exactly, less gives way to others.
      contact: the site stands on something: it takes part in the first guess (§4.5).
      free: what the positions may do as a whole, some of ``x y z yaw``: all frames move together by
        one unknown that the fit finds (§7), so that nothing slides.
      source: who asks for it: ``"user"``, or ``"scene"`` of what a plan asks of the feet.

    Raises:
      ConstraintError: shapes that do not fit, values that are not finite, repeated frames.
    """

    site: str
    frames: NDArray[np.int64]
    position: Array | None = None
    quat: Array | None = None
    weight: float = 1.0
    contact: bool = False
    free: tuple[str, ...] = ()
    source: str = "user"

    def __post_init__(self) -> None:
        where = f"constraint on site '{self.site}'"
        _check_frames(self, where)
        object.__setattr__(self, "free", tuple(self.free))
        if unknown := [name for name in self.free if name not in FREE]:
            raise ConstraintError(f"{where}: free '{unknown[0]}' is none of {', '.join(FREE)}")
        if self.free and self.position is None:
            raise ConstraintError(f"{where} is free to move but has no position to move from")
        _check_posed(self, where)

    @property
    def nscalar(self) -> int:
        """Scalar constraints this stands for: 3 a position, 3 an orientation, at each frame."""
        return _nscalar(self)


@dataclasses.dataclass(frozen=True, eq=False)
class RelativeConstraint:
    """Where one site must be in the frame of another: a hand on the hip, or in the other hand.

    Attributes:
      site: name of the site that is held.
      frames: (n,) frames, each once.
      to: name of the site that it is held to, on another body.
      position: (n, 3) or (3,) in the frame of ``to`` [m], or None.
      quat: (n, 4) or (4,) orientation of the site in the frame of ``to``, wxyz, or None.
      weight: in (0, 1]: 1 holds exactly, less gives way to others.
      source: who asks for it: ``"user"``, or ``"scene"`` of what a plan asks of the feet.

    Raises:
      ConstraintError: shapes that do not fit, values that are not finite, repeated frames.
    """

    site: str
    frames: NDArray[np.int64]
    to: str
    position: Array | None = (0.0, 0.0, 0.0)  # type: ignore[assignment]
    quat: Array | None = None
    weight: float = 1.0
    source: str = "user"

    def __post_init__(self) -> None:
        where = f"constraint of site '{self.site}' to site '{self.to}'"
        _check_frames(self, where)
        if self.site == self.to:
            raise ConstraintError(f"{where}: give two sites")
        _check_posed(self, where)

    @property
    def nscalar(self) -> int:
        """Scalar constraints this stands for: 3 a position, 3 an orientation, at each frame."""
        return _nscalar(self)


@dataclasses.dataclass(frozen=True, eq=False)
class LookAt:
    """A site that faces a point: an axis of its frame, drawn out, passes through the point.

    Attributes:
      site: name of the site.
      frames: (n,) frames, each once.
      point: (n, 3) or (3,) world point to look at [m].
      axis: (3,) direction in the site's own frame; x, forward, without.
      weight: in (0, 1]: 1 holds exactly, less gives way to others.
      source: who asks for it: ``"user"``, or ``"scene"`` of what a plan asks of the feet.

    Raises:
      ConstraintError: shapes that do not fit, values that are not finite, an axis of no length.
    """

    site: str
    frames: NDArray[np.int64]
    point: Array
    axis: Array = (1.0, 0.0, 0.0)  # type: ignore[assignment]
    weight: float = 1.0
    source: str = "user"

    def __post_init__(self) -> None:
        where = f"look-at of site '{self.site}'"
        _check_frames(self, where)
        point = per_frame(self.point, len(self.frames), 3, where, "point")
        object.__setattr__(self, "point", point)
        axis = per_frame(self.axis, 1, 3, where, "axis")[0]
        if np.linalg.norm(axis) < 1e-9:
            raise ConstraintError(f"{where}: the axis has no length")
        object.__setattr__(self, "axis", normalized(axis))

    @property
    def nscalar(self) -> int:
        """Scalar constraints this stands for: 2 at each frame."""
        return 2 * len(self.frames)


Constraint = SiteConstraint | RelativeConstraint | LookAt


def check_constraints(constraints: Sequence[Constraint]) -> None:
    """Refuse what is no list of constraints.

    Raises:
      ConstraintError: it is something else, or holds something else.
    """
    if not isinstance(constraints, Sequence) or isinstance(constraints, str):
        wanted = "a list of constraints (load_constraints reads a file)"
        raise ConstraintError(wrong_type("constraints", constraints, wanted))
    for constraint in constraints:
        if not isinstance(constraint, Constraint):
            wanted = "a SiteConstraint, RelativeConstraint or LookAt"
            raise ConstraintError(wrong_type("a constraint", constraint, wanted))


def _check_frames(constraint: Constraint, where: str) -> None:
    given = np.array(constraint.frames).reshape(-1)
    if given.dtype.kind not in "iuf" or (given != np.floor(given)).any():
        raise ConstraintError(f"{where} has frames {given.tolist()!r}: they are whole numbers")
    frames = given.astype(np.int64)
    if len(frames) == 0:
        raise ConstraintError(f"{where} has no frames")
    if len(np.unique(frames)) != len(frames):
        raise ConstraintError(f"{where} names a frame twice")
    if not 0.0 < constraint.weight <= 1.0:
        raise ConstraintError(f"{where} has weight {constraint.weight}: it must be in (0, 1]")
    object.__setattr__(constraint, "frames", frames)


def _check_posed(constraint: SiteConstraint | RelativeConstraint, where: str) -> None:
    if constraint.position is None and constraint.quat is None:
        raise ConstraintError(f"{where} wants nothing: give a position or a quat")
    for name, width in (("position", 3), ("quat", 4)):
        _broadcast(constraint, name, width, where)


def _nscalar(constraint: SiteConstraint | RelativeConstraint) -> int:
    kinds = (constraint.position is not None) + (constraint.quat is not None)
    return len(constraint.frames) * 3 * kinds


def _broadcast(constraint: Constraint, name: str, width: int, where: str) -> None:
    value = getattr(constraint, name)
    if value is not None:
        value = per_frame(value, len(constraint.frames), width, where, name)
        object.__setattr__(constraint, name, value)


def per_frame(value: ArrayLike, count: int, width: int, where: str, name: str) -> Array:
    """Return one row of ``width`` numbers a frame, read-only; quaternions normalised.

    Raises:
      ConstraintError: another shape, values that are not finite, a quaternion of no length.
    """
    try:
        array = np.asarray(value, dtype=np.float64)
        array = np.array(np.broadcast_to(array, (count, width)))
    except (TypeError, ValueError) as error:
        rows = f"{count} row{'s' * (count != 1)}"
        raise ConstraintError(
            f"{where}: {name} must be {width} numbers, or {rows} of {width}"
        ) from error
    if not np.isfinite(array).all():
        raise ConstraintError(f"{where}: {name} is not finite")
    if name == "quat":
        if (np.linalg.norm(array, axis=1) < 1e-6).any():
            raise ConstraintError(f"{where}: a quat is zero")
        array = normalized(array)
    array.flags.writeable = False
    return array
