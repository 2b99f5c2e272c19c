"""How far the root would have to rise or sink for limbs to be closed (§4.4)."""

from __future__ import annotations

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
    rise = np.zeros(len(goal))
    square = dot(goal, goal)
    reach = np.broadcast_to(REACH_SHARE * limbs.reach, square.shape)
    fold = np.broadcast_to(FOLD_SHARE * limbs.fold, square.shape)
    far = square > reach * reach
    wanting = far | (square < fold * fold)
    rows, which = np.nonzero(wanting & counts)
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
