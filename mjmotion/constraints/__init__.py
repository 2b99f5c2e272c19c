"""What must hold at which frames: targets for sites, from the scene or from the user.

hand = SiteConstraint("left_hand", frames=range(60, 80), position=points)
more = load_constraints("constraints.yaml", model, nframe)
targets = lay_out([hand, *more], model, nframe)     # arrays over the constrained frames
"""

from __future__ import annotations

from mjmotion.constraints.file import load_constraints
from mjmotion.constraints.targets import LookAtTarget, RelativeTarget, Targets, lay_out
from mjmotion.constraints.types import (
    Constraint,
    LookAt,
    RelativeConstraint,
    SiteConstraint,
    check_constraints,
)

__all__ = [
    "Constraint",
    "LookAt",
    "LookAtTarget",
    "RelativeConstraint",
    "RelativeTarget",
    "SiteConstraint",
    "Targets",
    "check_constraints",
    "lay_out",
    "load_constraints",
]
