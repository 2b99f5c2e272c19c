"""Names that a scene and a character both have: the scene's are changed.

rename_shared(stage, spec)      # geom "floor" of the stage becomes "scene_floor" if spec has one
"""

from __future__ import annotations

from collections.abc import Mapping, Set
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco

_ASSETS = ("textures", "materials", "meshes", "hfields", "skins")
_ELEMENTS = ("bodies", "frames", "geoms", "sites", "cameras", "lights", "numerics", "texts")
# Which attributes of which elements name an element of which kind.
_REFERENCES = {
    "geoms": {"material": "materials", "meshname": "meshes", "hfieldname": "hfields"},
    "sites": {"material": "materials"},
    "skins": {"material": "materials", "bodyname": "bodies"},
    "flexes": {"material": "materials"},
    "meshes": {"material": "materials"},
    "materials": {"textures": "textures"},
    "lights": {"targetbody": "bodies", "texture": "textures"},
    "cameras": {"targetbody": "bodies"},
}


def rename_shared(stage: mujoco.MjSpec, spec: mujoco.MjSpec) -> None:
    """Give elements of ``stage`` another name where ``spec`` has one of that name and kind.

    Bodies, geoms, sites, cameras, lights, custom numbers and texts, assets and default classes. Of
    joints, and what refers to them, a scene that stands still has none.

    Args:
      stage: the scene; it is changed.
      spec: the character; it stays as it is.
    """
    renamed: dict[str, dict[str, str]] = {}
    for kind in (*_ASSETS, *_ELEMENTS):
        taken = {asset_name(element) for element in getattr(spec, kind)}
        ours = {asset_name(element) for element in getattr(stage, kind)}
        renamed[kind] = {}
        for element in getattr(stage, kind):
            old = asset_name(element)
            if old and old in taken and old != "world":
                new = free_name(f"scene_{old}", taken | ours)
                element.name = renamed[kind][old] = new
    for kind, attributes in _REFERENCES.items():
        for element in getattr(stage, kind):
            for attribute, target in attributes.items():
                _follow(element, attribute, renamed[target])
    _rename_classes(stage, spec)


def _follow(element: Any, attribute: str, renamed: Mapping[str, str]) -> None:
    """Let what an element names have its new name."""
    named = getattr(element, attribute)
    if isinstance(named, str):
        if named in renamed:
            setattr(element, attribute, renamed[named])
        return
    names = list(named)
    if any(name in renamed for name in names):
        setattr(element, attribute, [renamed.get(name, name) for name in names])


def _rename_classes(stage: mujoco.MjSpec, spec: mujoco.MjSpec) -> None:
    """Give default classes of ``stage`` another name where ``spec`` has one of that name.

    MuJoCo attaches both and compiles, but what it then saves does not load. A spec has no list of
    its classes; its MJCF has.
    """
    root = ElementTree.fromstring(spec.to_xml())
    taken = {element.get("class", "main") for element in root.iter("default")}
    for name in taken - {"main"}:
        default = stage.find_default(name)
        if default is not None:
            new = f"scene_{name}"
            while new in taken or stage.find_default(new) is not None:
                new += "_"
            default.name = new


def asset_name(asset: Any) -> str:
    """Return the name MuJoCo will know an element by: its own, else its file's."""
    return asset.name or Path(getattr(asset, "file", "")).stem


def free_name(name: str, taken: Set[str]) -> str:
    """Return ``name``, with a number behind it where it is taken."""
    number, candidate = 1, name
    while candidate in taken:
        number += 1
        candidate = f"{name}_{number}"
    return candidate
