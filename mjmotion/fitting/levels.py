"""The levels of a fit: how many frames lie between two knots, coarse to fine, and when to stop.

    levels = default_levels(fps=30.0)        # (16, 8, 4, 2) frames a knot
    for frames_per_knot in levels: ...

``levels`` means this everywhere: frames a knot of each level.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.bones import Bones
from mjmotion.body.motion import Motion
from mjmotion.constraints import Targets
from mjmotion.constraints.unmet import relational_residuals, residuals
from mjmotion.exceptions import FitError
from mjmotion.ik.solver import Clearance

Array = NDArray[np.float64]

COARSEST = 16.0 / 30.0  # the paper's coarsest knots: 16 frames at 30 fps [s]
FINEST = 2.0  # frames a knot of the last level
TOLERANCE = 1e-4  # refinement stops once no position is off by more [m]
EDGE_RESIDUAL = 1e-4  # what may be left beside free frames before the exact pass [m]
TOUCHING = 0.004  # nearer than this to an obstacle, and another level follows [m]
BETTER = 0.8  # another level only while each leaves less than this share of the one before
EXTRA_LEVELS = 6  # at most, at the finest knots, to get the edges that close


def default_levels(fps: float) -> tuple[float, ...]:
    """Return frames a knot of every level: 16, 8, 4, 2 at 30 fps, as long in seconds at others."""
    first = max(FINEST, COARSEST * fps)
    count = 1 + max(0, round(math.log2(first / FINEST)))
    return tuple(FINEST * 2.0 ** (count - 1 - level) for level in range(count))


def check_levels(levels: Sequence[float]) -> tuple[float, ...]:
    """Return levels as numbers.

    Raises:
      FitError: none, not positive, or not from coarse to fine.
    """
    try:
        checked = tuple(float(frames_per_knot) for frames_per_knot in levels)
    except (TypeError, ValueError) as error:
        raise FitError(
            f"levels {levels!r} must be frames a knot of each level, such as 16, 8, 4, 2"
        ) from error
    if not checked:
        raise FitError("levels is empty: give frames a knot, such as 16, 8, 4, 2")
    if any(not (math.isfinite(one) and one > 0) for one in checked):
        raise FitError(f"levels {list(checked)} must be positive numbers of frames")
    if any(b > a for a, b in pairwise(checked)):
        raise FitError(f"levels {list(checked)} must go from coarse to fine")
    return checked


def check_tolerance(tolerance: float) -> float:
    """Return a tolerance as a number [m].

    Raises:
      FitError: no number, or less than 0.
    """
    try:
        checked = float(tolerance)
    except (TypeError, ValueError) as error:
        raise FitError(f"tolerance {tolerance!r} must be a length in metres") from error
    if not checked >= 0.0:
        raise FitError(f"tolerance {checked:g} must be 0 m or more")
    return checked


class Refinement:
    """Which level comes next: those asked for, then finer fitting while it still pays.

    Before an exact pass, the finest level is repeated while what the pass would jump beside free
    frames, or the nearness of an obstacle, keeps shrinking.

    Args:
      levels: frames a knot of those asked for.
      tolerance: none follows once no position is off by more [m].
      exact: whether an exact pass comes after.
    """

    def __init__(self, levels: Sequence[float], tolerance: float, exact: bool) -> None:
        self._levels, self._tolerance, self._exact = tuple(levels), tolerance, exact
        self._lefts: list[float] = []

    def next(self, done: int, left: Callable[[], float]) -> float | None:
        """Return frames a knot of the next level, or None.

        Args:
          done: how many levels are done.
          left: how much an exact pass would still jump [m]; asked only where that matters.
        """
        if done < len(self._levels):
            return self._levels[done]
        if not self._exact or done - len(self._levels) >= EXTRA_LEVELS:
            return None
        self._lefts.append(left())
        before = self._lefts[-2] if len(self._lefts) > 1 else math.inf
        return self._levels[-1] if 0.0 < self._lefts[-1] < BETTER * before else None

    def reached(self, error: float, targets: Targets, settled: bool) -> bool:
        """Return whether targets that are off by ``error`` [m] at most need no further level.

        Where something is to turn without a position, nothing says how far it is off.
        """
        return error <= self._tolerance and not targets.turning and settled


def left_to_close(
    motion: Motion,
    qpos: Array,
    targets: Targets,
    clearance: Clearance | None,
    bones: Bones | None,
) -> float:
    """Return how far the exact pass would jump next to free frames, or a body is too near [m].

    Args:
      motion: what is fitted.
      qpos: (nframe, nq) its poses so far.
      targets: what is to hold.
      clearance: what to keep clear of.
      bones: a body for each frame, where it changes.
    """
    left = 0.0
    held = _held_columns(targets)
    if len(held) < motion.nframe or not held.all():
        edge = _edge_residual(motion.replace(qpos), targets, held, bones)
        left = edge if edge > EDGE_RESIDUAL else 0.0
    if clearance is not None:
        distance = clearance(qpos, np.arange(motion.nframe)).distance
        left = max(left, TOUCHING - float(distance.min(initial=TOUCHING)))
    return left


def _held_columns(targets: Targets) -> NDArray[np.bool_]:
    """Return (n, s + relative + look-ats) what holds anything at each constrained frame."""
    columns = [targets.position_weight]
    columns += [one.position_weight[:, None] for one in targets.relative]
    columns += [one.weight[:, None] for one in targets.look_at]
    return np.concatenate(columns, axis=1) > 0.0


def _edge_residual(
    motion: Motion, targets: Targets, columns: NDArray[np.bool_], bones: Bones | None
) -> float:
    """Largest error in frames next to one where what is held there is free [m]."""
    held = np.zeros((motion.nframe + 2, columns.shape[1]), dtype=bool)
    held[targets.frames + 1] = columns
    held[0], held[-1] = held[1], held[-2]
    edge = held[1:-1] & ~(held[:-2] & held[2:])
    errors = (residuals(motion, targets, bones), relational_residuals(motion, targets, bones))
    gap = np.concatenate(errors, axis=1)
    return float((gap * edge[targets.frames]).max(initial=0.0))
