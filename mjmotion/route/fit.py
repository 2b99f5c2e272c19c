"""A smooth line near a way that was found, within free space: banded least squares.

The way is pushed out of what it lacks, and smoothed again, until it lacks nothing more or no less.
Of all of these the line that lacks the least is taken, and of equal ones the smoothest.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mjmotion.numerics.smoothing import follow
from mjmotion.route.centreline import at_lengths
from mjmotion.route.free_space import FreeSpace
from mjmotion.route.search import Asked

Array = NDArray[np.float64]

SMOOTH = (0.45, 0.3, 0.2, 0.12)  # τ of the line, tried in this order [m]
ROUNDS = 12
_HELD = 1e4  # weight of where the walk begins
_PROBE = 0.01  # over which the slope of a lack is taken [m]
_ENOUGH = 0.003  # lack that is none [m]
_SOFT = 0.02  # what a lack of room for arms is worth, to one of room for the trunk
_FIRM = 8.0  # weight of what is pushed, to that of the rest
FINE = 0.05  # spacing of the line's points [m]


def fit_line(way: Array, asked: Asked, space: FreeSpace) -> Array:
    """Return the smooth line (n, 2) near a way, :data:`FINE` apart [m].

    Args:
      way: (m, 2) the way, a step apart [m].
      asked: what the walk asks of it.
      space: what is free.
    """
    length = asked.spacing * np.arange(len(way), dtype=np.float64)
    wanted = np.arange(0.0, length[-1] + 1e-9, FINE)
    rough = at_lengths(way, length, wanted)
    swung, trunk = (
        np.column_stack([np.interp(wanted, length, column) for column in needed.T])
        for needed in (asked.swung, asked.trunk)
    )
    # Arms have all their room where the way has it, and what it has elsewhere.
    narrow = space.lack(rough, swung) > 0.0
    wide = np.where(narrow[:, None], trunk, swung)
    best, least = rough, np.inf
    for time in SMOOTH:
        line, lack = _pushed(rough, (trunk, wide), space, time)
        if lack < least - _ENOUGH:
            best, least = line, lack
        if least <= _ENOUGH:
            break
    return best


def _pushed(
    rough: Array, widths: tuple[Array, Array], space: FreeSpace, time: float
) -> tuple[Array, float]:
    """Return the smooth line that lacks the least, and what of the first widths it lacks [m]."""
    trunk, wide = widths
    weight = np.ones(len(rough))
    weight[0] = _HELD
    goal = rough
    best, least, worth = rough, np.inf, np.inf
    for _ in range(ROUNDS):
        line = follow(goal, weight, time / FINE)
        lack = space.lack(line, wide)
        firm, soft = float(space.lack(line, trunk).max()), float(lack.max())
        if max(firm, _ENOUGH) + _SOFT * soft < worth:
            best, least, worth = line, firm, max(firm, _ENOUGH) + _SOFT * soft
        if max(firm, soft) <= _ENOUGH:
            break
        out = np.stack(
            [
                space.lack(line + shift, wide) - space.lack(line - shift, wide)
                for shift in _PROBE * np.eye(2)
            ],
            axis=-1,
        )
        out = -out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-9)
        pushed = lack > 0.0
        goal = np.where(pushed[:, None], goal + (1.3 * lack + 0.002)[:, None] * out, goal)
        weight = np.where(pushed & (weight < _HELD), _FIRM, weight)
    return best, least
