"""The colours of the page, and which of them says how far a constraint is from its place."""

from __future__ import annotations

import math

Colour = tuple[float, float, float, float]

MET: Colour = (0.30, 0.80, 0.40, 1.0)
NEAR: Colour = (0.95, 0.70, 0.20, 1.0)
FAR: Colour = (0.95, 0.30, 0.25, 1.0)
OFF: Colour = (0.55, 0.58, 0.62, 1.0)
PIN: Colour = (0.40, 0.70, 0.95, 1.0)
LEFT: Colour = (0.35, 0.62, 0.95, 1.0)
RIGHT: Colour = (0.95, 0.55, 0.30, 1.0)
MIDDLE: Colour = (0.72, 0.62, 0.92, 1.0)
CURSOR: Colour = (1.0, 0.92, 0.35, 1.0)
TEXT: Colour = (0.90, 0.92, 0.95, 1.0)
FAINT: Colour = (0.60, 0.64, 0.70, 1.0)
RANGE: Colour = (0.35, 0.60, 0.95, 0.22)
SELECTED: Colour = (1.0, 1.0, 1.0, 1.0)
BACK: Colour = (0.11, 0.13, 0.16, 1.0)
AXES: dict[str, Colour] = {
    "x": (0.95, 0.30, 0.30, 1.0),
    "y": (0.40, 0.85, 0.40, 1.0),
    "z": (0.40, 0.55, 1.0, 1.0),
    "turn": (0.95, 0.85, 0.35, 1.0),
}

MET_BELOW = 1e-3  # a constraint off by less is met, as in reports [m]
NEAR_BELOW = 1e-2  # one off by less is near [m]


def of_residual(residual: float, enabled: bool = True) -> Colour:
    """Return the colour of a constraint that is off by so much [m]; NaN has no place."""
    if not enabled:
        return OFF
    if math.isnan(residual):
        return PIN
    if residual < MET_BELOW:
        return MET
    return NEAR if residual < NEAR_BELOW else FAR


def of_site(name: str) -> Colour:
    """Return the colour of a site's bar or path: by its side."""
    if name.startswith("left"):
        return LEFT
    return RIGHT if name.startswith("right") else MIDDLE


def faded(colour: Colour, alpha: float) -> Colour:
    """Return a colour that lets more through."""
    return (*colour[:3], colour[3] * alpha)
