"""Runs of frames in which something holds: found with hysteresis, cut, and joined."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def hysteresis(begin: NDArray[np.bool_], stay: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return runs of ``stay`` that contain a frame of ``begin``, from the first such frame on."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], stay.astype(np.int8), [0]))))
    runs = []
    for start, end in edges.reshape(-1, 2):
        first = np.flatnonzero(begin[start:end])
        if len(first):
            runs.append((int(start + first[0]), int(end)))
    return runs


def resting(height: Array, run: tuple[int, int], rise: float) -> tuple[int, int]:
    """Cut a run where the site has not come down yet, or is on its way up."""
    start, end = run
    low = np.flatnonzero(height[start:end] < np.quantile(height[start:end], 0.3) + rise)
    return (start + int(low[0]), start + int(low[-1]) + 1)


def merged(runs: list[tuple[int, int]], gap: float) -> list[tuple[int, int]]:
    """Return runs in order, those joined that are no more than ``gap`` frames apart."""
    joined: list[tuple[int, int]] = []
    for start, end in runs:
        if joined and start - joined[-1][1] <= gap:
            joined[-1] = (joined[-1][0], end)
        else:
            joined.append((start, end))
    return joined
