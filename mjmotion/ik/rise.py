"""How far the root would have to rise or sink for limbs to be closed (§4.4)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.limbs import Limbs, LimbState
from mjmotion.body.reach import drop_to_reach
from mjmotion.numerics.rotations import dot, rotate

Array = NDArray[np.float64]

REACH_SHARE = 0.996  # share of a limb's length that counts as reach: a straight knee is singular
FOLD_SHARE = 1.001  # the same for the least length that a knee can fold it to


def rise_to_reach(limbs: Limbs, state: LimbState, goal: Array, counts: NDArray[np.bool_]) -> Array:
    """How far the root would have to go up (n,) [m] for every limb to reach; down is negative.

    ``counts`` (n, nlimb) are the limbs that it does so for: one that is only turned asks nothing.
    """
    return rises_to_reach(limbs, state, goal, (counts,))[0]


def rises_to_reach(
    limbs: Limbs, state: LimbState, goal: Array, counts: Sequence[NDArray[np.bool_]]
) -> list[Array]:
    """Return :func:`rise_to_reach` for several choices of limbs."""
    square = dot(goal, goal)
    reach = np.broadcast_to(REACH_SHARE * limbs.reach, square.shape)
    fold = np.broadcast_to(FOLD_SHARE * limbs.fold, square.shape)
    far = square > reach * reach
    wanting = far | (square < fold * fold)
    lengths = (far, reach, fold)
    return [_rise(state, goal, np.nonzero(wanting & mine), lengths) for mine in counts]


def _rise(
    state: LimbState,
    goal: Array,
    wanting: tuple[NDArray[np.int64], ...],
    lengths: tuple[NDArray[np.bool_], Array, Array],
) -> Array:
    """Return the rise (n,) [m] for limbs that want for reach or room."""
    rise = np.zeros(len(goal))
    (rows, which), (far, reach, fold) = wanting, lengths
    if len(rows):
        base_quat = np.broadcast_to(state.base_quat, (*goal.shape[:2], 4))
        apart = rotate(base_quat[rows, which], goal[rows, which])
        beyond, longest = far[rows, which], reach[rows, which]
        length = np.where(beyond, longest, fold[rows, which])
        # A goal over its hip is the same upside down; too near, a drop comes out negative.
        short = drop_to_reach(np.abs(apart), np.zeros(3), length, 0.5 * longest * beyond)
        order = np.argsort(np.abs(short))  # the limb that is furthest off decides
        rise[rows[order]] = (np.sign(apart[:, 2]) * short)[order]
    return rise
