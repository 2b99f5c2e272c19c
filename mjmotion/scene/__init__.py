"""Scenes: any MJCF, a few builders, and a character put into them."""

from mjmotion.scene.builders import (
    BUILDERS,
    DOORWAYS,
    Doorway,
    blocks,
    doors,
    flat,
    from_heights,
    rope,
    slope,
    stairs,
    terrain,
)
from mjmotion.scene.composing import compose, scene_of, with_ground, without_scene
from mjmotion.scene.save import save_model
from mjmotion.scene.scene import START_SITE, Scene, SceneLike, load_scene

__all__ = [
    "BUILDERS",
    "DOORWAYS",
    "START_SITE",
    "Doorway",
    "Scene",
    "SceneLike",
    "blocks",
    "compose",
    "doors",
    "flat",
    "from_heights",
    "load_scene",
    "rope",
    "save_model",
    "scene_of",
    "slope",
    "stairs",
    "terrain",
    "with_ground",
    "without_scene",
]
