"""What a plan changed of a walk, in words: steps, their length, the time they take, the path.

for line in changes(plan): ...
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from mjmotion.footsteps.plan import Plan

Array = NDArray[np.float64]

SAME_STEP = 0.05  # a step that is longer or shorter by no more is the source's [m]


def changes(plan: Plan) -> tuple[str, ...]:
    """Return what was changed of a walk whose steps were chosen anew, a line each; else nothing."""
    if not plan.loose:
        return ()
    pairs = [
        (before, after)
        for before, after in pairwise(range(len(plan.stances)))
        if plan.stances[before].foot != plan.stances[after].foot
    ]
    source = np.array([stance.source_pos for stance in plan.stances])
    placed = np.array([foothold.position for foothold in plan.footholds])
    own, new = (_lengths(spots, pairs) for spots in (source, placed))
    changed = np.abs(new - own) > SAME_STEP
    lines = []
    if changed.any():
        few = new[changed]
        lines.append(
            f"{int(changed.sum())} of {len(pairs)} steps have another length:"
            f" {few.min():.2f} to {few.max():.2f} m, in the source"
            f" {own[changed].min():.2f} to {own[changed].max():.2f} m"
        )
    clip = plan.recorded or plan.source
    if plan.original is not None:
        lines.append(
            f"the walk takes {clip.duration:.1f} s, in the recording {plan.original.duration:.1f} s"
        )
    way, before = (_path(motion.qpos) for motion in (plan.source, clip))
    lines.append(f"its path is {way:.1f} m long, in the source {before:.1f} m")
    return tuple(lines)


def _lengths(spots: Array, pairs: list[tuple[int, int]]) -> Array:
    """Return how far steps go over the plane (n,) [m]."""
    ends = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    step = spots[ends[:, 1], :2] - spots[ends[:, 0], :2]
    return np.hypot(step[:, 0], step[:, 1])


def _path(qpos: Array) -> float:
    """Return how long the root's path over the plane is [m]."""
    step = np.diff(qpos[:, :2], axis=0)
    return float(np.hypot(step[:, 0], step[:, 1]).sum())
