"""Feet of a character: the sites that stand, and the sole they stand with."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.geom_points import body_points
from mjmotion.body.kinematics import site_id
from mjmotion.exceptions import ModelError

Array = NDArray[np.float64]

SOLE_BAND = 0.004  # foot geometry this close to the sole plane counts as sole [m]
_ON_EDGE = 1e-9  # a point of the grid this near to the outline is inside [m]


@dataclasses.dataclass(frozen=True, eq=False)
class Foot:
    """A foot: its body, contact sites and sole, in the frame of the posed site.

    Attributes:
      side: common part of its sites' names, such as ``left``.
      body: body id.
      site: name of the site that is posed, on the sole under the ankle.
      heel, toe: (3,) the contact sites in the posed site's frame [m].
      sole: (k, 3) points of the sole, its outline and its inside, in the same frame [m].
      shape: (k, 3) points of the whole foot's surface, in the same frame [m].
    """

    side: str
    body: int
    site: str
    heel: Array
    toe: Array
    sole: Array
    shape: Array


def find_feet(model: mujoco.MjModel) -> tuple[Foot, ...]:
    """Return the feet: bodies with sites ``<side>_heel``, ``<side>_toe`` and ``<side>_foot``.

    Raises:
      ModelError: there are none, or their sites are on different bodies.
    """
    names = [model.site(i).name for i in range(model.nsite)]
    feet = []
    for name in names:
        if not name.endswith("_heel"):
            continue
        side = name.removesuffix("_heel")
        missing = [f"{side}_{part}" for part in ("toe", "foot") if f"{side}_{part}" not in names]
        if missing:
            raise ModelError(f"site '{name}' has no partner {missing}: a foot needs all three")
        heel, toe, foot = (site_id(model, f"{side}_{part}") for part in ("heel", "toe", "foot"))
        body = int(model.site_bodyid[foot])
        if {int(model.site_bodyid[heel]), int(model.site_bodyid[toe])} != {body}:
            raise ModelError(f"the sites of the {side} foot are on different bodies")
        matrix = np.empty(9)
        mujoco.mju_quat2Mat(matrix, model.site_quat[foot])
        frame, origin = matrix.reshape(3, 3), model.site_pos[foot]
        local = (model.site_pos[[heel, toe]] - origin) @ frame
        points = (body_points(model, body) - origin) @ frame
        low = points[points[:, 2] < points[:, 2].min() + SOLE_BAND]
        sole = np.concatenate((local, _fill(low)))
        shape = np.concatenate((sole, _hull(points)))
        feet.append(Foot(side, body, f"{side}_foot", local[0], local[1], sole, shape))
    if not feet:
        raise ModelError("the model has no feet: name sites <side>_heel, <side>_toe, <side>_foot")
    return tuple(feet)


def _hull(points: Array) -> Array:
    """Corners of the convex hull of points, thinned to some forty."""
    from scipy.spatial import ConvexHull

    corners = points[ConvexHull(points).vertices]
    return corners[:: max(1, len(corners) // 40)]


def _fill(points: Array) -> Array:
    """Outline points and a grid within them: enough that ground cannot rise between unseen."""
    from scipy.spatial import ConvexHull

    plane = points[:, :2]
    around = ConvexHull(plane)
    hull = plane[around.vertices]
    low, high = hull.min(axis=0), hull.max(axis=0)
    count = np.maximum(2, np.round((high - low) / 0.045).astype(int))
    axes = [np.linspace(low[i], high[i], count[i] + 1) for i in range(2)]
    grid = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    # Inside is the inner side of every edge. (To look for its triangle in a Delaunay triangulation
    # asks LAPACK, whose threads take 150 ms to wake on a busy machine.)
    outside = grid @ around.equations[:, :2].T + around.equations[:, 2]
    inside = grid[(outside < _ON_EDGE).all(axis=1)]
    thin = hull[:: max(1, len(hull) // 12)]
    flat = np.concatenate((thin, inside))
    return np.column_stack((flat, np.full(len(flat), points[:, 2].min())))
