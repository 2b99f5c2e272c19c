"""Fit recorded motions to other ground, other bodies and constraints of one's own, on MuJoCo.

    from mjmotion import adapt

    result = adapt("walk", "terrain_doors")
    print(result.validate())
    result.save("out/walk")

What is named here is imported from its module when it is first asked for, so ``import mjmotion``
costs nothing and loads no renderer.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mjmotion.apps.adaptation import adapt
    from mjmotion.apps.edit.frame import edit_frame
    from mjmotion.apps.morph.fitting import morph
    from mjmotion.apps.retarget.moving import retarget
    from mjmotion.apps.rope.climb import climb_rope
    from mjmotion.apps.transition.joining import join, transition
    from mjmotion.body.character import Character
    from mjmotion.body.motion import Motion
    from mjmotion.body.proportions import Proportions, make_character
    from mjmotion.clips import load_clip
    from mjmotion.constraints import (
        LookAt,
        RelativeConstraint,
        SiteConstraint,
        load_constraints,
    )
    from mjmotion.constraints.shared_targets import SharedMove
    from mjmotion.exceptions import MotionError
    from mjmotion.fitting import fit
    from mjmotion.footsteps.contacts import Contact, detect_contacts, load_contacts
    from mjmotion.output.folder import result_folder
    from mjmotion.output.reading import read_results
    from mjmotion.output.report import Report
    from mjmotion.output.result import write_results
    from mjmotion.output.video import render_video
    from mjmotion.scene import Scene, load_scene
    from mjmotion.validation import validate

__version__ = "0.1.0"

_MODULES = {
    "Character": "body.character",
    "Contact": "footsteps.contacts",
    "LookAt": "constraints",
    "Motion": "body.motion",
    "MotionError": "exceptions",
    "Proportions": "body.proportions",
    "RelativeConstraint": "constraints",
    "Report": "output.report",
    "Scene": "scene",
    "SharedMove": "constraints.shared_targets",
    "SiteConstraint": "constraints",
    "adapt": "apps.adaptation",
    "climb_rope": "apps.rope.climb",
    "detect_contacts": "footsteps.contacts",
    "edit_frame": "apps.edit.frame",
    "fit": "fitting",
    "join": "apps.transition.joining",
    "load_clip": "clips",
    "load_constraints": "constraints",
    "load_contacts": "footsteps.contacts",
    "load_scene": "scene",
    "make_character": "body.proportions",
    "morph": "apps.morph.fitting",
    "read_results": "output.reading",
    "render_video": "output.video",
    "result_folder": "output.folder",
    "retarget": "apps.retarget.moving",
    "transition": "apps.transition.joining",
    "validate": "validation",
    "write_results": "output.result",
}

__all__ = [
    "Character",
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
    "adapt",
    "climb_rope",
    "detect_contacts",
    "edit_frame",
    "fit",
    "join",
    "load_clip",
    "load_constraints",
    "load_contacts",
    "load_scene",
    "make_character",
    "morph",
    "read_results",
    "render_video",
    "result_folder",
    "retarget",
    "transition",
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
