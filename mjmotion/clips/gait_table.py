"""The table of the built-in walk: Fourier coefficients of root and joints over the gait cycle.

Phase 0 is the heel strike of the left foot; the right side does the same half a cycle later. The
coefficients are figures fitted to recordings of four people by ``scripts/fit_gait.py``. The data
used was obtained from mocap.cs.cmu.edu; the database was created with funding from NSF EIA-0196217.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_MIRROR = np.array((-1.0, 1.0, -1.0))  # of a rotation vector


@dataclasses.dataclass(frozen=True)
class GaitTable:
    """Coefficients by channel.

    Attributes:
      channels: name to (columns, 1 + 2 harmonics): mean, cos 1, sin 1, cos 2, ... [m or rad].
        ``root_position`` is forward, left, up; ``root_rotation`` and balls are rotation vectors;
        hinges one angle. Only left limbs are kept.
    """

    channels: Mapping[str, Array]

    def mean(self, channel: str) -> Array:
        """Return the mean over the cycle (columns,) of a channel, of either side."""
        name, mirrored = _left(channel)
        mean = self.channels[name][:, 0]
        return mean * _MIRROR if mirrored and len(mean) == 3 else mean

    def swing(self, channel: str, phase: Array) -> Array:
        """Return what a channel does about its mean (n, columns) at phases (n,) [cycles]."""
        name, mirrored = _left(channel)
        rows = self.channels[name]
        count = (rows.shape[1] - 1) // 2
        angle = 2.0 * np.pi * np.outer(phase + 0.5 * mirrored, np.arange(1, count + 1))
        values = np.cos(angle) @ rows[:, 1::2].T + np.sin(angle) @ rows[:, 2::2].T
        return values * _MIRROR if mirrored and len(rows) == 3 else values


def _left(channel: str) -> tuple[str, bool]:
    """Return the channel that is kept, and whether the one asked for is its mirror image."""
    if channel.startswith("right_"):
        return "left_" + channel.removeprefix("right_"), True
    return channel, False


@lru_cache(maxsize=1)
def gait_table() -> GaitTable:
    """Return the table that comes with the package."""
    content = json.loads(Path(__file__).with_name("gait.json").read_text(encoding="utf-8"))
    channels = {name: np.array(rows) for name, rows in content["channels"].items()}
    return GaitTable(channels)
