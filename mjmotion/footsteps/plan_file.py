"""plan.json: who stands when, which way and where on, to be looked at, edited and taken back.

save_plan("plan.json", plan, clip="walk", scene="stairs")
contacts, settings = load_plan("plan.json", clip, settings)
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np

from mjmotion.body.motion import Motion
from mjmotion.boundary.limits import MOST_COUNT, MOST_LENGTH, at_most, real_number, shown
from mjmotion.boundary.structured import read_json
from mjmotion.exceptions import ContactError, SceneError
from mjmotion.footsteps.contacts import Contact, check_contacts
from mjmotion.footsteps.given import yaw_of
from mjmotion.footsteps.plan import Plan
from mjmotion.footsteps.settings import PlanSettings
from mjmotion.route.given import check_way

_DECIMALS = 5  # of metres


def plan_entries(plan: Plan, clip: str = "", scene: str = "") -> dict[str, Any]:
    """Return what ``plan.json`` holds.

    Contacts are those of the clip in its own time. ``path`` is None where the walk keeps its own
    way, which ``own_path`` tells.
    """
    feet, route = plan.source.character.feet, plan.route
    whole = plan.original or plan.recorded or plan.source
    return {
        "clip": clip,
        "scene": scene,
        "fps": whole.fps,
        "nframe": whole.nframe,
        "contacts": [dataclasses.asdict(one) for one in plan.detected or plan.contacts],
        "own_path": [] if route is None else np.round(route.own, _DECIMALS).tolist(),
        "path": np.round(route.line, _DECIMALS).tolist() if route and route.bent else None,
        "footholds": [
            {
                "foot": feet[stance.foot].side,
                "start": stance.start,
                "end": stance.end,
                **dict(zip("xyz", np.round(one.position, _DECIMALS).tolist(), strict=True)),
                "yaw_deg": round(float(np.degrees(yaw_of(one.quat))), 3),
            }
            for stance, one in zip(plan.stances, plan.footholds, strict=True)
        ],
    }


def save_plan(path: str | Path, plan: Plan, clip: str = "", scene: str = "") -> None:
    """Write a plan file; OSError where that is not possible."""
    entries = plan_entries(plan, clip, scene)
    Path(path).write_text(json.dumps(entries, indent=1, ensure_ascii=False) + "\n", "utf-8")


def load_plan(
    path: str | Path, clip: Motion, settings: PlanSettings | None = None
) -> tuple[tuple[Contact, ...], PlanSettings]:
    """Read a plan file: the contacts of the clip, and settings with its way and its footholds.

    Args:
      path: the file.
      clip: what it is the plan of.
      settings: what else may change.

    Raises:
      ContactError: the file is missing, damaged, or of another clip.
      SceneError: its path is none.
    """
    entries = read_json(path, "plan", ContactError)
    if not isinstance(entries, dict) or not {"nframe", "contacts", "path", "footholds"} <= set(
        entries
    ):
        raise ContactError(f"plan '{path}' must hold nframe, contacts, path and footholds")
    if entries["nframe"] != clip.nframe:
        raise ContactError(
            f"plan '{path}' is of a clip of {shown(entries['nframe'])} frames, and this one has"
            f" {clip.nframe}: give the clip that it was made for"
        )
    contacts = [_contact(entry, f"plan '{path}'") for entry in _list(entries, "contacts", path)]
    way: Any = "keep"
    if entries["path"] is not None:
        way = check_way(entries["path"], f"path of plan '{path}'")
    rows = [_spot(entry, f"plan '{path}'") for entry in _list(entries, "footholds", path)]
    settings = PlanSettings() if settings is None else settings
    spots = np.array(rows, dtype=np.float64).reshape(-1, 3)
    return (
        check_contacts(contacts, clip.model, clip.nframe),
        dataclasses.replace(settings, path=way, footholds=spots),
    )


def _list(entries: dict[str, Any], name: str, path: str | Path) -> list[Any]:
    if not isinstance(entries[name], list):
        raise ContactError(f"plan '{path}': {name} must be a list")
    at_most(len(entries[name]), MOST_COUNT, f"{name} of plan '{path}'", ContactError)
    return entries[name]


def _contact(entry: Any, where: str) -> Contact:
    good = isinstance(entry, dict) and set(entry) == {"site", "start", "end"}
    if not good or not isinstance(entry["site"], str):
        raise ContactError(f"{where}: a contact must have just site, start and end")
    if type(entry["start"]) is not int or type(entry["end"]) is not int:
        raise ContactError(f"{where}: start and end of a contact must be whole frames")
    return Contact(entry["site"], entry["start"], entry["end"])


def _spot(entry: Any, where: str) -> tuple[float, float, float]:
    if not isinstance(entry, dict) or not {"x", "y", "yaw_deg"} <= set(entry):
        raise ContactError(f"{where}: a foothold must have x, y and yaw_deg")
    x, y, yaw = (
        real_number(entry[name], f"{where}: {name} of a foothold", ContactError)
        for name in ("x", "y", "yaw_deg")
    )
    at_most(max(abs(x), abs(y), abs(yaw)), MOST_LENGTH, f"{where}: a foothold", SceneError)
    return x, y, float(np.radians(yaw))
