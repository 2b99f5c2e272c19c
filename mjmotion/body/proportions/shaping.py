"""Primitive shapes and principal axes under a linear map."""

from __future__ import annotations

from itertools import permutations

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_GEOM = mujoco.mjtGeom
_CLOSE = 1e-9  # relative size of what counts as nothing off the diagonal


def girth(stretch: Array, along: Array) -> float:
    """Return by how much a section across a direction grows: the square root of its area's growth.

    Args:
      stretch: (3, 3) linear map.
      along: (3,) the direction, of any length.
    """
    length = np.linalg.norm(stretch @ along) / np.linalg.norm(along)
    return float(np.sqrt(np.linalg.det(stretch) / length))


def stretched_shape(kind: int, size: Array, stretch: Array) -> tuple[Array, Array]:
    """Return size (3,) [m] and turn (3, 3) of a primitive under a map in its own axes.

    An ellipsoid stays one exactly. A box keeps right angles, a capsule and a cylinder their round
    section, a sphere its shape: they take the nearest such shape of the same volume or section.
    """
    size = np.array(size)
    if kind == _GEOM.mjGEOM_SPHERE:
        return size * float(np.cbrt(np.linalg.det(stretch))), np.eye(3)
    if kind in (_GEOM.mjGEOM_CAPSULE, _GEOM.mjGEOM_CYLINDER):
        axis = stretch[:, 2]
        turn = _turned(np.eye(3)[2], axis / np.linalg.norm(axis))
        long = size[1] * float(np.linalg.norm(axis))
        return np.array((size[0] * girth(stretch, np.eye(3)[2]), long, size[2])), turn
    if _diagonal(stretch):
        return size * np.diag(stretch), np.eye(3)
    if kind == _GEOM.mjGEOM_ELLIPSOID:
        axes, lengths, _ = np.linalg.svd(stretch * size)
        order, turn = _matched(axes, np.eye(3))
        return lengths[list(order)], turn
    left, _, right = np.linalg.svd(stretch)
    return size * np.linalg.norm(stretch, axis=0), left @ right


def moments(inertia: Array) -> Array:
    """Return the second moments ``C = tr(I)/2 1 − I`` (…, 3, 3) of inertias ``I`` [kg m²]."""
    half = np.trace(inertia, axis1=-2, axis2=-1)[..., None, None] / 2
    return np.asarray(half * np.eye(3) - inertia)


def inertia_of(moment: Array) -> Array:
    """Return the inertia ``I = tr(C) 1 − C`` (…, 3, 3) of second moments ``C`` [kg m²]."""
    trace = np.trace(moment, axis1=-2, axis2=-1)[..., None, None]
    return np.asarray(trace * np.eye(3) - moment)


def nearest_axes(inertia: Array, turn: Array) -> Array:
    """Return principal axes (3, 3) of an inertia, the nearest to the axes ``turn``.

    Where ``turn`` is principal already it is returned as it is.
    """
    if _diagonal(turn.T @ inertia @ turn):
        return turn
    _, axes = np.linalg.eigh(inertia)
    return _matched(axes, turn)[1]


def _diagonal(matrix: Array) -> bool:
    off = matrix - np.diag(np.diag(matrix))
    return bool(np.abs(off).max() <= _CLOSE * np.abs(matrix).max())


def _matched(axes: Array, like: Array) -> tuple[tuple[int, ...], Array]:
    """Order and sign axes (columns) so that they are near to others and right-handed."""
    order = max(
        permutations(range(3)),
        key=lambda p: sum(abs(axes[:, p[i]] @ like[:, i]) for i in range(3)),
    )
    turn = axes[:, list(order)]
    turn = turn * np.where((turn * like).sum(axis=0) < 0, -1.0, 1.0)
    if np.linalg.det(turn) < 0:
        turn[:, int(np.argmin((turn * like).sum(axis=0)))] *= -1.0
    return order, turn


def _turned(old: Array, new: Array) -> Array:
    """Return the least turn (3, 3) from one unit direction to another, not its opposite."""
    axis = np.cross(old, new)
    skew = np.array(((0, -axis[2], axis[1]), (axis[2], 0, -axis[0]), (-axis[1], axis[0], 0)))
    return np.asarray(np.eye(3) + skew + skew @ skew / (1.0 + float(old @ new)))
