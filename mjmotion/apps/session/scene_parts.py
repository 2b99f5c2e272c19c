"""What of a scene can be moved: doors, boxes, beams, bodies; never the ground.

parts(scene)                                  # {"door1": ("door1_left_post", …), "beam": ("beam",)}
moved_scene(scene, [("door1", (0.3, 0.0, 0.0))])
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

import mujoco
import numpy as np

from mjmotion.exceptions import SessionError, unknown_name
from mjmotion.scene import Scene

_GROUND = (mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_HFIELD)
# Of door1_left_post the thing is door1: what comes after its last number, or its first word.
_PART = re.compile(r"^(.*\d|[A-Za-z]+)((?:_[A-Za-z]+)+)$")


def parts(scene: Scene) -> Mapping[str, tuple[str, ...]]:
    """Return the parts of a scene that can be moved, by name, and the geoms or the body of each.

    Geoms of the world whose names differ in words at their ends alone are one part: the posts and
    the lintel of a door. A body is a part of its own.
    """
    found: dict[str, tuple[str, ...]] = {}
    for geom in scene.spec.worldbody.geoms:
        if geom.name and geom.type not in _GROUND:
            match = _PART.match(geom.name)
            name = match[1] if match else geom.name
            found[name] = (*found.get(name, ()), geom.name)
    for body in scene.spec.worldbody.bodies:
        if body.name:
            found[body.name] = (body.name,)
    return found


def part_of(scene: Scene, geom: str) -> str | None:
    """Return the part that a geom of the scene belongs to; None of the ground."""
    for name, geoms in parts(scene).items():
        if geom in geoms:
            return name
    spec = scene.spec.geom(geom)
    body = None if spec is None else spec.parent
    while body is not None and body.name not in ("", "world"):
        if body.name in parts(scene):
            return str(body.name)
        body = body.parent
    return None


def moved_scene(scene: Scene, moves: Iterable[tuple[str, tuple[float, float, float]]]) -> Scene:
    """Return a scene with some of its parts moved [m].

    Raises:
      SessionError: a part that there is not.
    """
    spec, known = scene.spec.copy(), parts(scene)
    for name, by in moves:
        if name not in known:
            raise SessionError(unknown_name("part of the scene", name, known))
        for one in known[name]:
            element = spec.geom(one) or spec.body(one)
            element.pos = np.asarray(element.pos) + np.asarray(by)
    return Scene.from_spec(spec, scene.name)
