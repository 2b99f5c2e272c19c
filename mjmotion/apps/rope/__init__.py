"""Climbing a rope (Figure 5c): fitted to another character, the rope simulated, both measured.

climb = climb_rope("climber")
climb.figures, climb.jerk_ratio, climb.broken()
climb.save("out/rope", video=True)
"""

from mjmotion.apps.rope.climb import climb_rope
from mjmotion.apps.rope.measuring import RopeFigures, measure
from mjmotion.apps.rope.points import RopePoints, rope_points
from mjmotion.apps.rope.result import RopeClimb, render_climb, write_climb
from mjmotion.apps.rope.simulation import simulate

__all__ = [
    "RopeClimb",
    "RopeFigures",
    "RopePoints",
    "climb_rope",
    "measure",
    "render_climb",
    "rope_points",
    "simulate",
    "write_climb",
]
