"""What a session asks of its clip, one edit after another: plain values, as its file holds them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

from mjmotion.apps.edit import HOLDS, Hold
from mjmotion.exceptions import SessionError, unknown_name

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
        if any(not factor > 0.0 for _, factor in self.rigidity):
            raise SessionError("rigidity factors must be above 0")

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
    if kind not in KINDS:
        raise SessionError(f"{where}: {unknown_name('kind', str(kind), KINDS)}")
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
            entry["rigidity"] = tuple((str(name), float(by)) for name, by in entry["rigidity"])
        except (TypeError, ValueError) as error:
            raise SessionError(f"{where}: rigidity must be pairs of joint and factor") from error
    return _made(Settings, entry, where)


_READ: Mapping[str, Callable[[Any], Any]] = {
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
                entry[name] = _vector(value)
            elif name in ("enabled", "exact") and not isinstance(value, bool):
                raise TypeError(f"{name} must be true or false")
            elif name in _READ:
                entry[name] = _plain(name, value)
        return kind(**entry)
    except (TypeError, ValueError) as error:
        raise SessionError(f"{where}: {error}") from error


def _plain(name: str, value: Any) -> Any:
    read = _READ[name]
    wanted = str if read is str else (int, float)
    if isinstance(value, bool) or not isinstance(value, wanted) or read(value) != value:
        raise TypeError(f"{name} must be {'a name' if read is str else 'a number'}, not {value!r}")
    return read(value)


def _vector(value: Any) -> Vector:
    x, y, z = (float(one) for one in value)
    if not all(abs(one) < 1e6 for one in (x, y, z)):
        raise ValueError("a place must be three numbers in metres")
    return x, y, z


def _object(value: Any, where: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise SessionError(f"{where} is no object")
    return dict(value)
