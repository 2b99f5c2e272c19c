"""Fit recorded walks to other ground, on MuJoCo; the method of Lee and Shin (SIGGRAPH '99).

    from mjmotion import load_clip, load_scene, validate
    from mjmotion.adapt import adapt

    adaptation = adapt(load_clip("walk"), load_scene("terrain_doors"))
    validation = validate(adaptation.source, adaptation.motion, adaptation.contacts)

What is named here is imported from its module when it is first asked for, so ``import mjmotion``
costs nothing. ``adapt``, ``fit``, ``retarget``, ``morph`` and ``transition`` are modules with a
function of the same name each: import those functions from their modules.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mjmotion.character import Proportions, make_character
    from mjmotion.clips import load_clip
    from mjmotion.constraints import (
        LookAt,
        RelativeConstraint,
        SiteConstraint,
        load_constraints,
    )
    from mjmotion.contacts import Contact, detect_contacts, load_contacts
    from mjmotion.exceptions import MotionError
    from mjmotion.motion import Motion
    from mjmotion.report import Report
    from mjmotion.results import read_results, result_folder, write_results
    from mjmotion.scene import Scene, load_scene
    from mjmotion.shared import SharedMove
    from mjmotion.validation import validate
    from mjmotion.video import render_video

__version__ = "0.1.0"

_MODULES = {
    "Contact": "contacts",
    "LookAt": "constraints",
    "Motion": "motion",
    "MotionError": "exceptions",
    "Proportions": "character",
    "RelativeConstraint": "constraints",
    "Report": "report",
    "Scene": "scene",
    "SharedMove": "shared",
    "SiteConstraint": "constraints",
    "detect_contacts": "contacts",
    "load_clip": "clips",
    "load_constraints": "constraints",
    "load_contacts": "contacts",
    "load_scene": "scene",
    "make_character": "character",
    "read_results": "results",
    "render_video": "video",
    "result_folder": "results",
    "validate": "validation",
    "write_results": "results",
}

__all__ = [
    "Contact",
    "LookAt",
    "Motion",
    "MotionError",
    "Proportions",
    "RelativeConstraint",
    "Report",
    "Scene",
    "SharedMove",
    "SiteConstraint",
    "detect_contacts",
    "load_clip",
    "load_constraints",
    "load_contacts",
    "load_scene",
    "make_character",
    "read_results",
    "render_video",
    "result_folder",
    "validate",
    "write_results",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module 'mjmotion' has no attribute '{name}'")
    value = getattr(importlib.import_module(f"mjmotion.{_MODULES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
