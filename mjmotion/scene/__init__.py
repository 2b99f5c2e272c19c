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
from mjmotion.scene.model import (
    START_SITE,
    Scene,
    compose,
    load_character,
    load_scene,
    scene_of,
    with_ground,
)
from mjmotion.scene.save import save_model

__all__ = [
    "BUILDERS",
    "DOORWAYS",
    "START_SITE",
    "Doorway",
    "Scene",
    "blocks",
    "compose",
    "doors",
    "flat",
    "from_heights",
    "load_character",
    "load_scene",
    "rope",
    "save_model",
    "scene_of",
    "slope",
    "stairs",
    "terrain",
    "with_ground",
]
