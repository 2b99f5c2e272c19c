"""Is the adapted motion any good? Figures from MuJoCo itself, independent of the fit.

    validation = validate(source, motion, contacts)
    validation.metrics["stance_drift_mm"]      # every figure by name, with its unit
    validation.worst["sole_penetration_mm"]    # the frame, and the body it happened to
    validation.broken()                        # names of the figures beyond their thresholds

It imports of mjmotion only motions and errors: what it knows of scenes, feet, limits and shapes it
finds out by itself. ``Judge`` keeps that for many motions on one model.

The character is the tree of bodies under the free root; all that cannot move and collides is the
scene. A figure that nothing was there to measure for (no heightfield, no swing) is NaN and never
broken. How each is defined stands in ``docs/figures.md`` and at the functions that compute it.
"""

from __future__ import annotations

from mjmotion.validation.compute import Judge, validate
from mjmotion.validation.result import Row, Validation, Worst
from mjmotion.validation.thresholds import (
    THRESHOLDS,
    Threshold,
    merge_thresholds,
    read_thresholds,
)

__all__ = [
    "THRESHOLDS",
    "Judge",
    "Row",
    "Threshold",
    "Validation",
    "Worst",
    "merge_thresholds",
    "read_thresholds",
    "validate",
]
