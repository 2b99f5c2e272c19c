"""Hierarchical motion fitting: Algorithm 1 with the first guess of §4.5 and the exact pass of §4.4.

result = fit(motion, constraints, levels=(16, 8, 4, 2), ik="hybrid")
result.motion, result.trace, result.unmet
"""

from __future__ import annotations

from mjmotion.fitting.algorithm import (
    EDGE_RESIDUAL,
    FINEST,
    SOLVERS,
    contact_shift,
    default_levels,
    fit,
    over_all_frames,
)
from mjmotion.fitting.result import (
    UNMET,
    Fit,
    LevelTrace,
    Trace,
    Unmet,
    find_unmet,
    other_residuals,
    residuals,
)

__all__ = [
    "EDGE_RESIDUAL",
    "FINEST",
    "SOLVERS",
    "UNMET",
    "Fit",
    "LevelTrace",
    "Trace",
    "Unmet",
    "contact_shift",
    "default_levels",
    "find_unmet",
    "fit",
    "other_residuals",
    "over_all_frames",
    "residuals",
]
