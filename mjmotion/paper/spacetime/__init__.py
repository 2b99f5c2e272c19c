"""The one large spacetime optimisation that §7 compares with: all frames and shared moves at once.

found = solve_spacetime(motion, constraints, shared=moves, first_guess=shift)
found.motion, found.objective, found.max_error, found.seconds
"""

from __future__ import annotations

from mjmotion.paper.spacetime.solve import TOLERANCE, Spacetime, objective, solve_spacetime

__all__ = ["TOLERANCE", "Spacetime", "objective", "solve_spacetime"]
