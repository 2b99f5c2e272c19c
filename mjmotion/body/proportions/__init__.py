"""Characters of other proportions, made from any humanoid MJCF.

    character = make_character("humanoid", Proportions(legs=1.25, torso=0.8, arms=0.85))
    character.model, character.spec

Every part is stretched with all that belongs to it, the soles stay on the ground, and joint limits,
tuples, sensors and excludes stay valid. The source is not changed.
"""

from mjmotion.body.parts import LimbParts, Parts, find_parts
from mjmotion.body.proportions.make import make_character
from mjmotion.body.proportions.proportions import Proportions
from mjmotion.body.proportions.spine import flexible_spine

__all__ = [
    "LimbParts",
    "Parts",
    "Proportions",
    "find_parts",
    "flexible_spine",
    "make_character",
]
