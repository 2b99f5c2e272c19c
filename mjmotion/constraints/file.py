"""A constraints file, YAML or JSON: a list; each entry names a site, its frames, what it wants.

- site: left_hand
  frames: [60, 80]            # from 60 up to, not including, 80
  position: [1.2, 0.4, 1.1]   # one point [m], or one a frame
  quat: [1, 0, 0, 0]          # orientation wxyz, optional
  weight: 1.0                 # 0 to 1, optional: 1 is exact, less gives way
  free: [x, y, yaw]           # optional: what all frames may do together, but not slide
- site: left_hand
  frames: [60, 80]
  to: pelvis                  # in that site's frame: a hand on the hip
  position: [0.0, 0.2, 0.05]
- site: face
  frames: [60, 80]
  look_at: [2.0, 0.0, 1.0]    # a world point; axis: [1, 0, 0] is the site's own
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from mjmotion.body.kinematics import site_id
from mjmotion.boundary.limits import MOST_LENGTH, real_number, shown
from mjmotion.boundary.structured import read_structured
from mjmotion.constraints.types import Constraint, LookAt, RelativeConstraint, SiteConstraint
from mjmotion.exceptions import ConstraintError, MotionError

_KEYS = {
    SiteConstraint: {"site", "frames", "position", "quat", "weight", "free"},
    RelativeConstraint: {"site", "frames", "position", "quat", "weight", "to"},
    LookAt: {"site", "frames", "look_at", "axis", "weight"},
}


def load_constraints(
    path: str | Path, model: mujoco.MjModel, nframe: int
) -> tuple[Constraint, ...]:
    """Read a constraints file (see the module's example).

    Raises:
      ConstraintError: the file is missing or malformed, or names a site or frame that is not there.
    """
    path = Path(path)
    entries = read_structured(path, "constraints file", ConstraintError)
    if not isinstance(entries, list):
        raise ConstraintError(f"'{path}' must hold a list of constraints")
    constraints = []
    for number, entry in enumerate(entries):
        try:
            constraints.append(_from_entry(entry, nframe))
            site_id(model, constraints[-1].site)
            if isinstance(constraints[-1], RelativeConstraint):
                site_id(model, constraints[-1].to)
        except (MotionError, TypeError, ValueError) as error:
            raise ConstraintError(f"'{path}', entry {number}: {error}") from error
    return tuple(constraints)


def _from_entry(entry: Any, nframe: int) -> Constraint:
    if not isinstance(entry, dict) or "site" not in entry or "frames" not in entry:
        raise ConstraintError("it must be a mapping with at least 'site' and 'frames'")
    kind: type[Constraint] = SiteConstraint
    if "to" in entry:
        kind = RelativeConstraint
    elif "look_at" in entry:
        kind = LookAt
    if unknown := set(entry) - _KEYS[kind]:
        valid = ", ".join(sorted(_KEYS[kind]))
        key = min(str(shown(name)) for name in unknown)
        raise ConstraintError(f"unknown key {key}: valid are {valid}")
    span = entry["frames"]
    if type(span) is int:
        span = [span, span + 1]
    if not (isinstance(span, list) and len(span) == 2 and all(type(x) is int for x in span)):
        raise ConstraintError(f"'frames' is {shown(span)}: it must be one frame or [start, end]")
    if span[0] >= span[1]:
        said = f"[{shown(span[0])}, {shown(span[1])}]"
        raise ConstraintError(f"frames {said} are none: the second is where they end, not the last")
    if not 0 <= span[0] < span[1] <= nframe:
        said = f"[{shown(span[0])}, {shown(span[1])}]"
        raise ConstraintError(f"frames {said} are not within the motion's 0 to {nframe}")
    site, frames = _word(entry, "site"), np.arange(*span)
    weight = real_number(entry.get("weight", 1.0), "weight", ConstraintError)
    if kind is LookAt:
        axis: Any = _rows(entry, "axis") if "axis" in entry else (1.0, 0.0, 0.0)
        return LookAt(site, frames, _rows(entry, "look_at"), axis, weight)
    position, quat = (
        None if entry.get(name) is None else _rows(entry, name) for name in ("position", "quat")
    )
    if kind is RelativeConstraint:
        return RelativeConstraint(site, frames, _word(entry, "to"), position, quat, weight)
    free = entry.get("free", ())
    if not isinstance(free, list | tuple) or not all(isinstance(name, str) for name in free):
        raise ConstraintError("'free' must be a list such as [x, y, yaw]")
    return SiteConstraint(site, frames, position, quat, weight, free=tuple(free))


def _word(entry: dict[Any, Any], key: str) -> str:
    if not isinstance(entry[key], str):
        raise ConstraintError(f"'{key}' is {shown(entry[key])}: it must be the name of a site")
    return str(entry[key])


def _rows(entry: dict[Any, Any], key: str) -> Any:
    """Return numbers, or rows of them, as they are: text and booleans are none."""
    value = entry[key]
    name, width = "point" if key == "look_at" else key, 4 if key == "quat" else 3
    for row in value if isinstance(value, list) else [value]:
        for one in row if isinstance(row, list) else [row]:
            if isinstance(one, (bool, str, dict)):
                raise ConstraintError(f"{name} must be {width} numbers, and {shown(one)} is none")
            if isinstance(one, (int, float)) and abs(one) > MOST_LENGTH:
                raise ConstraintError(f"{name}: {shown(one)} is beyond {MOST_LENGTH:,.0f} m")
    return value
