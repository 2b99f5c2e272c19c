"""Hierarchical motion fitting: Algorithm 1 with the first guess of §4.5 and the exact pass of §4.4.

    result = fit(motion, constraints, levels=(16, 8, 4, 2), ik="hybrid")
    result.motion, result.trace, result.unmet

``fitting`` and not ``fit``, because ``from mjmotion import fit`` gives the function.
"""

from __future__ import annotations

from mjmotion.fitting.algorithm import fit
from mjmotion.fitting.first_guess import contact_shift
from mjmotion.fitting.level import Level, run_level
from mjmotion.fitting.levels import FINEST, TOLERANCE, default_levels
from mjmotion.fitting.result import Fit
from mjmotion.fitting.trace import LevelTrace, Trace, whole

__all__ = [
    "FINEST",
    "TOLERANCE",
    "Fit",
    "Level",
    "LevelTrace",
    "Trace",
    "contact_shift",
    "default_levels",
    "fit",
    "run_level",
    "whole",
]
