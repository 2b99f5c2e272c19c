"""Feet keep as far from each other as they do in the source, where they would meet.

How far is measured across the body, along the pelvis' own level side axis: legs stand over feet,
so feet that pass each other side by side take their shins along.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.feet import Foot
from mjmotion.body.kinematics import Pose, level_side, site_id
from mjmotion.footsteps.paths import FootPath
from mjmotion.footsteps.swings import frames_to
from mjmotion.numerics.rotations import from_matrix, rotate
from mjmotion.numerics.smoothing import envelope

Array = NDArray[np.float64]

BESIDE = 0.02  # how far feet that pass each other are kept apart, where the source does [m]
OVER = -0.01  # the same at least, where the source's swing over each other [m]
CROSSED = -0.1  # further across the other than this, a foot of the source is meant to be [m]
AHEAD = 0.10  # how far before its toe a foot's shin may be [m]
PASSING = 0.05  # feet that are this far behind each other do not meet [m]
ASIDE_PULL = 15.0  # acceleration with which a foot goes aside [m/s²]
ASIDE_TIME = 0.08  # scale of a move aside [s]


def aside(feet: Sequence[Foot], paths: Sequence[FootPath], pose: Pose, fps: float) -> list[Array]:
    """Return how far swinging feet are to go aside (nframe, 3) [m], one a foot.

    Args:
      feet: the feet; two, or nothing is asked.
      paths: where they go, one a foot.
      pose: the source, every frame.
      fps: frames a second.
    """
    nframe = len(pose.xpos)
    moves = [np.zeros((nframe, 3)) for _ in feet]
    if len(feet) != 2:
        return moves
    side = level_side(pose)
    source = [_shapes(foot, *_placed(pose, foot)) for foot in feet]
    planned = [
        _shapes(foot, path.position, path.quat) for foot, path in zip(feet, paths, strict=True)
    ]
    sign = 1.0 if ((source[0] - source[1]).mean(axis=1) * side).sum(axis=1).mean() > 0.0 else -1.0
    was, _ = _apart(source[0], source[1], sign * side)
    now, behind = _apart(planned[0], planned[1], sign * side)
    least = np.where(was > CROSSED, np.clip(was, OVER, BESIDE), was)
    lack = np.where(behind < PASSING, least - now, 0.0)
    for number, direction in ((0, sign), (1, -sign)):
        mine, other = paths[number].stance, paths[1 - number].stance
        most = 0.5 * ASIDE_PULL * (frames_to(mine) / fps) ** 2
        need = np.where(~mine & other, np.minimum(lack, most), 0.0)
        if need.max(initial=0.0) > 0.0:
            move = envelope(need, mine, ASIDE_TIME * fps)
            moves[number] = direction * move[:, None] * side
    return moves


def _placed(pose: Pose, foot: Foot) -> tuple[Array, Array]:
    site = site_id(pose.model, foot.site)
    return pose.site_xpos[:, site], from_matrix(pose.site_xmat[:, site])


def _shapes(foot: Foot, position: Array, quat: Array) -> Array:
    """Return the points of a foot, in the world (nframe, k, 3) [m]."""
    return np.asarray(position[:, None] + rotate(quat[:, None], foot.shape[None]))


def _apart(first: Array, second: Array, side: Array) -> tuple[Array, Array]:
    """How far the first foot is beside the second (nframe,), and behind or before it [m].

    Beside: from the outermost point of the second to the innermost of the first along ``side``.
    """
    ahead = np.column_stack((side[:, 1], -side[:, 0], np.zeros(len(side))))  # or behind
    across = [(sole * side[:, None]).sum(axis=2) for sole in (first, second)]
    along = [(sole * ahead[:, None]).sum(axis=2) for sole in (first, second)]
    low, high = [a.min(axis=1) for a in along], [a.max(axis=1) + AHEAD for a in along]
    behind = np.maximum(low[0] - high[1], low[1] - high[0])
    return across[0].min(axis=1) - across[1].max(axis=1), behind
