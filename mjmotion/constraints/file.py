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

import json
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from mjmotion.body.kinematics import site_id
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
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise ConstraintError(f"cannot read constraints file '{path}': it does not exist") from None
    except (OSError, UnicodeDecodeError) as error:
        raise ConstraintError(f"cannot read constraints file '{path}': {error}") from error
    if path.suffix.lower() == ".json":
        try:
            entries = json.loads(text)
        except json.JSONDecodeError as error:
            raise ConstraintError(f"'{path}' is not JSON: {error}") from error
    else:
        import yaml

        try:
            entries = yaml.safe_load(text)
        except yaml.YAMLError as error:
            line = str(error).splitlines()[0]
            raise ConstraintError(f"'{path}' is not YAML: {line}") from error
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
        raise ConstraintError(f"unknown key '{min(unknown)}': valid are {valid}")
    span = entry["frames"]
    if type(span) is int:
        span = [span, span + 1]
    if not (isinstance(span, list) and len(span) == 2 and all(type(x) is int for x in span)):
        raise ConstraintError("'frames' must be one frame or [start, end]")
    if not 0 <= span[0] < span[1] <= nframe:
        raise ConstraintError(f"frames {span} are not within the motion's 0 to {nframe}")
    site, frames, weight = str(entry["site"]), np.arange(*span), float(entry.get("weight", 1.0))
    if kind is LookAt:
        axis = entry.get("axis", (1.0, 0.0, 0.0))
        return LookAt(site, frames, entry["look_at"], axis, weight)
    position, quat = entry.get("position"), entry.get("quat")
    if kind is RelativeConstraint:
        return RelativeConstraint(site, frames, str(entry["to"]), position, quat, weight)
    free = entry.get("free", ())
    if not isinstance(free, list | tuple):
        raise ConstraintError("'free' must be a list such as [x, y, yaw]")
    return SiteConstraint(site, frames, position, quat, weight, free=tuple(map(str, free)))
