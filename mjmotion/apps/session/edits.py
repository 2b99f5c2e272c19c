"""What a session asks of its clip, one edit after another: plain values, as its file holds them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, TypeAlias

from mjmotion.apps.edit import HOLDS, Hold
from mjmotion.boundary.limits import MOST_LENGTH, MOST_RIGIDITY, at_most, real_number, shown
from mjmotion.exceptions import MotionError, SessionError, unknown_name

Vector: TypeAlias = tuple[float, float, float]

FRAMES_PER_KNOT = 12  # of the first level
LEVELS = 4
FINEST = 1.0  # frames a knot, below which no level goes


@dataclasses.dataclass(frozen=True)
class Settings:
    """How an edit is carried out.

    Attributes:
      frames_per_knot: frames between two knots of the first level; an edit reaches three knots to
        either side.
      levels: how many, each with knots half as far apart; none goes below a frame a knot.
      ik: ``"hybrid"`` or ``"numeric"``.
      exact: whether what is held is closed exactly at the end (§4.4).
      hold: what stays around an edit; see :func:`mjmotion.edit_frame`.
      rigidity: joints that resist more (above 1) or less than by themselves, by name.
    """

    frames_per_knot: int = FRAMES_PER_KNOT
    levels: int = LEVELS
    ik: str = "hybrid"
    exact: bool = True
    hold: Hold = "feet"
    rigidity: tuple[tuple[str, float], ...] = ()

    def __post_init__(self) -> None:
        if not 1 <= self.frames_per_knot <= 1000 or not 1 <= self.levels <= 16:
            raise SessionError(
                f"{self.frames_per_knot} frames a knot and {self.levels} levels: give 1 to 1000"
                " and 1 to 16"
            )
        for kind, value, valid in (
            ("hold", self.hold, HOLDS),
            ("IK solver", self.ik, ("hybrid", "numeric")),
        ):
            if value not in valid:
                raise SessionError(unknown_name(kind, value, valid))
        for joint, factor in self.rigidity:
            if not 0.0 < factor <= MOST_RIGIDITY:
                raise SessionError(
                    f"the rigidity of '{joint}' is {factor:g}: it must be above 0, and at most"
                    f" {MOST_RIGIDITY:g}"
                )

    @property
    def knots(self) -> tuple[float, ...]:
        """Frames a knot of every level, coarse to fine."""
        spaced = [self.frames_per_knot / 2.0**level for level in range(self.levels)]
        return tuple(one for one in spaced if one >= FINEST)


@dataclasses.dataclass(frozen=True)
class Drag:
    """A site is at a place at one frame; the frames around follow.

    Attributes:
      site: name of the site.
      frame: at which frame.
      position: where [m].
      settings: how.
      enabled: whether it counts.
    """

    site: str
    frame: int
    position: Vector
    settings: Settings = Settings()
    enabled: bool = True

    @property
    def frames(self) -> tuple[int, int]:
        """First frame, and first after."""
        return self.frame, self.frame + 1


@dataclasses.dataclass(frozen=True)
class Pin:
    """A site stays over some frames: at one place, or where it is at each of them.

    Attributes:
      site: name of the site.
      start, end: from frame ``start`` up to, not including, ``end``.
      position: where [m]; None for where it is.
      settings: how.
      enabled: whether it counts.
    """

    site: str
    start: int
    end: int
    position: Vector | None = None
    settings: Settings = Settings()
    enabled: bool = True

    @property
    def frames(self) -> tuple[int, int]:
        """First frame, and first after."""
        return self.start, self.end


@dataclasses.dataclass(frozen=True)
class Footprint:
    """A foot's whole stay on one spot is moved, with the swings before and after.

    Attributes:
      side: which foot: the common part of its sites' names, such as ``left``.
      frame: a frame at which it stands there.
      move: how far, on to the ground that is there [m].
      turn: about the vertical [rad].
      settings: how.
      enabled: whether it counts.
    """

    side: str
    frame: int
    move: Vector
    turn: float = 0.0
    settings: Settings = Settings()
    enabled: bool = True

    @property
    def frames(self) -> tuple[int, int]:
        """A frame of it, and the next."""
        return self.frame, self.frame + 1


Edit: TypeAlias = Drag | Pin | Footprint

KINDS: Mapping[str, type[Edit]] = {"drag": Drag, "pin": Pin, "footprint": Footprint}


def to_json(edit: Edit) -> dict[str, Any]:
    """Return an edit as a session's file holds it."""
    (kind,) = (name for name, made in KINDS.items() if isinstance(edit, made))
    return {"kind": kind, **dataclasses.asdict(edit)}


def from_json(value: Any, where: str) -> Edit:
    """Return the edit that :func:`to_json` wrote.

    Raises:
      SessionError: it is none.
    """
    entry = _object(value, where)
    kind = entry.pop("kind", None)
    if not isinstance(kind, str) or kind not in KINDS:
        said = kind if isinstance(kind, str) else shown(kind)
        raise SessionError(f"{where}: {unknown_name('kind', said, KINDS)}")
    entry["settings"] = settings_from_json(entry.get("settings", {}), f"{where}, settings")
    return _made(KINDS[kind], entry, where)


def settings_from_json(value: Any, where: str) -> Settings:
    """Return settings as ``dataclasses.asdict`` wrote them.

    Raises:
      SessionError: they are none.
    """
    entry = _object(value, where)
    if "rigidity" in entry:
        try:
            pairs = [(name, real_number(by, "rigidity")) for name, by in entry["rigidity"]]
            if not all(isinstance(name, str) for name, _ in pairs):
                raise TypeError
            entry["rigidity"] = tuple(pairs)
        except (TypeError, ValueError, MotionError) as error:
            raise SessionError(f"{where}: rigidity must be pairs of joint and factor") from error
    return _made(Settings, entry, where)


_READ: Mapping[str, type] = {
    "site": str,
    "side": str,
    "ik": str,
    "hold": str,
    "frame": int,
    "start": int,
    "end": int,
    "frames_per_knot": int,
    "levels": int,
    "turn": float,
}


def _made(kind: type[Any], entry: dict[str, Any], where: str) -> Any:
    """Return an object of a kind from its fields, each of the type that it should be."""
    known = {field.name for field in dataclasses.fields(kind)}
    if unknown := sorted(set(entry) - known):
        raise SessionError(f"{where}: unknown key '{unknown[0]}'")
    try:
        for name, value in entry.items():
            if name in ("position", "move") and value is not None:
                entry[name] = vector(value, name)
            elif name in ("enabled", "exact") and not isinstance(value, bool):
                raise TypeError(f"{name} must be true or false")
            elif name in _READ:
                entry[name] = _plain(name, value)
        lacking = [
            field.name
            for field in dataclasses.fields(kind)
            if field.default is dataclasses.MISSING and field.name not in entry
        ]
        if lacking:
            raise TypeError(f"it lacks {', '.join(lacking)}")
        return kind(**entry)
    except (TypeError, ValueError, OverflowError, MotionError) as error:
        raise SessionError(f"{where}: {error}") from error


def _plain(name: str, value: Any) -> Any:
    read = _READ[name]
    wanted = str if read is str else (int, float)
    if isinstance(value, bool) or not isinstance(value, wanted) or read(value) != value:
        of = {str: "a name", int: "a whole number", float: "a number"}[read]
        raise TypeError(f"{name} must be {of}, not {shown(value)}")
    return read(value)


def vector(value: Any, what: str) -> Vector:
    """Return a place or a way [m] from a list of three numbers.

    Raises:
      SessionError: it is none, or beyond all bounds.
    """
    if not isinstance(value, list | tuple) or len(value) != 3:
        raise SessionError(f"{what} is {shown(value)}: it must be three numbers in metres")
    x, y, z = (real_number(one, what, SessionError) for one in value)
    at_most(max(abs(x), abs(y), abs(z)), MOST_LENGTH, f"{what} [m]", SessionError)
    return x, y, z


def _object(value: Any, where: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise SessionError(f"{where} is no object")
    return dict(value)
