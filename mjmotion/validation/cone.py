"""What cones of forces cannot give: least squares of shares that only push, for all frames at once.

rest = beyond_cone(edges, wanted, held)
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

_LEAN = 1e-11  # an edge to which what is left leans by less is of no use
_RIDGE = 1e-14  # keeps edges apart that all but coincide
_ROUNDS = 3  # times the number of edges, after which a frame is left as it is


def beyond_cone(edges: Array, wanted: Array, held: Mask) -> Array:
    """Return what is left (n, d) of vectors less the nearest points of their cones.

    The active sets of Lawson and Hanson (1974), those of all frames at once: the edge to which
    what is left leans the most is added, and edges that would then have to pull are dropped.

    Args:
      edges: (n, m, d) the cones' edges.
      wanted: (n, d) the vectors.
      held: (n, m) which of the edges there are.
    """
    rest, share, used = wanted.copy(), np.zeros(held.shape), np.zeros_like(held)
    rows = np.flatnonzero(held.any(axis=1))
    for _ in range(_ROUNDS * held.shape[1]):
        lean = (edges @ rest[..., None])[rows, :, 0]
        lean[used[rows] | ~held[rows]] = -np.inf
        best = lean.argmax(axis=1)
        more = lean[np.arange(len(rows)), best] > _LEAN
        rows = rows[more]
        if len(rows) == 0:
            break
        used[rows, best[more]] = True
        share[rows], used[rows] = _settled(edges, wanted, share[rows], used[rows], rows)
        columns, some = _in_use(edges, used[rows], rows)
        taken = np.take_along_axis(share[rows], columns, axis=1)[:, None] @ some
        rest[rows] = wanted[rows] - taken[:, 0]
    return rest


def _settled(
    edges: Array, wanted: Array, share: Array, used: Mask, rows: Index
) -> tuple[Array, Mask]:
    """Return the best shares (k, m) of edges in use at some rows, and those that then push."""
    share, used = share.copy(), used.copy()
    left = np.arange(len(rows))
    for _ in range(used.shape[1]):
        best = _least_squares(edges, wanted, used[left], rows[left])
        pulls = used[left] & (best <= 0.0)
        fine = ~pulls.any(axis=1)
        share[left[fine]] = best[fine]
        left, best, pulls = left[~fine], best[~fine], pulls[~fine]
        if len(left) == 0:
            break
        # As far towards the best as the first edge lets it that would come to pull.
        way = share[left] - best
        part = np.where(pulls, share[left] / np.where(pulls, way, 1.0), np.inf)
        length = part.min(axis=1, keepdims=True)
        used[left] &= part > length
        share[left] = (share[left] - length * way) * used[left]
    return share, used


def _least_squares(edges: Array, wanted: Array, used: Mask, rows: Index) -> Array:
    """Return shares (k, m) of the edges in use, of any sign, that leave the least."""
    columns, some = _in_use(edges, used, rows)
    gram = some @ some.swapaxes(1, 2)
    index = np.arange(columns.shape[1])
    gram[:, index, index] += np.where(some.any(axis=2), _RIDGE, 1.0)
    found = np.linalg.solve(gram, some @ wanted[rows, :, None])[..., 0]
    share = np.zeros(used.shape)
    np.put_along_axis(share, columns, found, axis=1)
    return share


def _in_use(edges: Array, used: Mask, rows: Index) -> tuple[Index, Array]:
    """Return columns (k, c) of edges in use (k, m) at some rows, and those edges, else zero."""
    size = int(used.sum(axis=1).max())
    columns = np.argsort(~used, axis=1, kind="stable")[:, :size]
    there = np.take_along_axis(used, columns, axis=1)
    return columns, edges[rows[:, None], columns] * there[..., None]
