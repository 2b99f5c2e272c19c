"""Whether triangles are a convex solid, or have pits, passages or open sides."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_COVERED = 0.99  # of its hull's area that a piece's own surface has at least
_SAMPLE = 200  # triangles that a quick look is at
_HOLLOW = 1e-3  # a piece has no triangle that is further inside its hull [m]


def fills_hull(corners: Array) -> bool:
    """Whether triangles (m, 3, 3) are the surface of their own convex hull."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(corners.reshape(-1, 3))
    except QhullError:  # flat
        return False
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    if np.linalg.norm(across, axis=1).sum() / 2.0 < _COVERED * hull.area:
        return False
    # Most that do not fill their hull show it at once.
    some = corners[:: max(1, len(corners) // _SAMPLE)]
    for triangles in np.array_split(some, max(1, len(some) // 16)):
        depth = triangles @ hull.equations[:, :3].T + hull.equations[:, 3]
        if (depth.min(axis=1).max(axis=1) < -_HOLLOW).any():
            return False
    # Triangles are struck off face by face of the hull: what is left at the end is inside it.
    for face in hull.equations:  # outward normal and offset
        on_face = (corners @ face[:3] + face[3] >= -_HOLLOW).all(axis=1)
        corners = corners[~on_face]
        if len(corners) == 0:
            return True
    return False
