"""Soles on rough ground: a plate that comes to rest on what rises highest under all of it.

A foot set down on bumps, small boxes or rods settles as a rigid plate does under the weight on its
middle: on three points around that, with nothing else above it. Its toes give, as far as they bend.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.feet import Foot
from mjmotion.footsteps.under_toes import TOES_UP
from mjmotion.numerics.rotations import conjugate, cross, from_matrix, normalized, rotate
from mjmotion.scene.ground import Ground

Array = NDArray[np.float64]

EDGE_STEP, INSIDE_STEP = 0.006, 0.006  # how far apart points of a tread are [m]
COARSE_STEP = 0.012  # the same where many places are tried [m]
MAP_STEP = 0.01  # of the heights that many places are tried on [m]
SINK = 0.0025  # how far the ground may rise into a sole that settles [m]
SINK_STANDING = 0.001  # the same where a contact is, whose gap counts [m]
MISSING = 1.0  # the gap where there is no ground [m]
UP = np.array((0.0, 0.0, 1.0))
BESIDE = 0.012  # how far beside a sole it is felt for what stands there, higher than this [m]
_EVEN = 1e-5  # a plate that ground is above by no more has settled [m]
_PIVOTS = 60  # the most that a plate is let tip over; what is left then lifts it
_ROUNDS = 3  # times that a plate settles on what is under it where it is by then


@dataclasses.dataclass(frozen=True, eq=False)
class Tread:
    """The points of a sole, close enough that no ground rises between them unseen.

    Attributes:
      foot: the foot.
      points: (k, 3) in the frame of its posed site: heel, ball, sole, and what is beside it [m].
      sink: (k,) how far the ground may rise into each [m].
      toes: (k,) how far ahead of the hinge the toes' points are [m], 0 of all others.
      beside: how many of them, at the end, are beside the sole.
      load: (2,) where the weight is, between heel and ball [m].
      around: (3,) points around that.
    """

    foot: Foot
    points: Array
    sink: Array
    toes: Array
    beside: int
    load: Array
    around: NDArray[np.int64]

    @classmethod
    def of(cls, foot: Foot, step: float = INSIDE_STEP) -> Tread:
        """Return that of a foot, its points ``step`` apart [m]."""
        from scipy.spatial import ConvexHull

        hull = ConvexHull(foot.sole[:, :2])
        corners = foot.sole[hull.vertices, :2]
        edges = [
            corner + (after - corner) * np.linspace(0.0, 1.0, count, endpoint=False)[:, None]
            for corner, after in zip(corners, np.roll(corners, -1, axis=0), strict=True)
            for count in [
                max(1, int(np.ceil(np.linalg.norm(after - corner) / max(step, EDGE_STEP))))
            ]
        ]
        low, high = corners.min(axis=0), corners.max(axis=0)
        axes = [np.arange(low[i], high[i], step) for i in range(2)]
        grid = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
        outside = grid @ hull.equations[:, :2].T + hull.equations[:, 2]
        edge = np.concatenate(edges)
        beside = edge + BESIDE * normalized(edge - 0.5 * (low + high))
        # A foot that lands on its heel leans back: what is behind it must be further away.
        along = normalized((foot.toe - foot.heel)[:2])
        beside -= BESIDE * along * ((edge - foot.heel[:2]) @ along < BESIDE)[:, None]
        plane = np.concatenate((edge, grid[(outside < 0.0).all(axis=1)], beside))
        flat = np.column_stack((plane, np.full(len(plane), foot.sole[2:, 2].min())))
        points = np.concatenate((foot.heel[None], foot.toe[None], flat))
        sink, toes = np.full(len(points), SINK), np.zeros(len(points))
        sink[:2], sink[-len(beside) :] = SINK_STANDING, SINK + BESIDE
        if foot.toes is not None:
            ahead = normalized((foot.front - foot.toe) * (1.0, 1.0, 0.0))
            toes = np.maximum((points - foot.toes.anchor) @ ahead, 0.0)
            toes[:2] = 0.0
        load = 0.5 * (foot.heel + foot.toe)[:2]
        around = _triangle(points[:, :2], load)
        return cls(foot, points, sink, toes, len(beside), load, around)

    def rises(self, ground: Ground, position: Array, quat: Array, bend: float) -> float:
        """Return how far the ground rises into a sole that stands, its toes bent up [m]."""
        points = position + rotate(quat, self.points)
        height, _ = ground.under(points)
        normal = rotate(quat, UP)
        over = np.where(np.isnan(height), -np.inf, height - points[:, 2]) * normal[2]
        return float((over - self.toes * np.tan(bend) - np.maximum(self.sink - SINK, 0.0)).max())


def _triangle(points: Array, load: Array) -> NDArray[np.int64]:
    """Return three of points (k, 2) around a load, or nearest to it where none are."""
    from scipy.spatial import ConvexHull

    corners = ConvexHull(points).vertices.astype(np.int64)
    fan = np.stack((np.full(len(corners) - 2, corners[0]), corners[1:-1], corners[2:]), axis=1)
    lifted = np.concatenate((points, np.ones((len(points), 1))), axis=1)
    aim = np.broadcast_to(np.append(load, 1.0)[:, None], (len(fan), 3, 1))
    share = np.linalg.solve(np.swapaxes(lifted[fan], 1, 2), aim)[..., 0]
    return np.asarray(fan[share.min(axis=1).argmax()])


@dataclasses.dataclass(frozen=True, eq=False)
class Plates:
    """Where soles come to rest.

    Attributes:
      position: (n, 3) of the posed site [m].
      quat: (n, 4) how it is turned.
      normal: (n, 3) of the plane of the sole.
      gap: (n,) how far heel or ball is off the ground, the further of the two [m].
      hangs: (n,) how far the ground is at most under what is in the sole [m].
    """

    position: Array
    quat: Array
    normal: Array
    gap: Array
    hangs: Array


def settled(tread: Tread, spots: Array, yaw: Array, heights: Array, turned: Array) -> Plates:
    """Let soles settle.

    Args:
      tread: the sole.
      spots: (n, 3) where the posed site is over the plane [m].
      yaw: (4,) how all of them are turned about the vertical.
      heights: (n, k) of the ground under the tread's points, NaN where there is none [m].
      turned: (n, k, 3) those points from the spots, turned as they lie [m].
    """
    foot, back = tread.foot, rotate(conjugate(yaw), turned)
    above = heights - spots[:, None, 2]
    known = np.where(np.isnan(above), -1.0, above)
    bent = tread.toes * np.tan(TOES_UP)
    plane = _rested(back[..., :2], known - tread.sink - bent, tread.load, tread.around)
    normal = rotate(yaw, normalized(np.column_stack((-plane[:, :2], np.ones(len(plane))))))
    local = normalized(foot.toe - foot.heel)
    along = rotate(yaw, local * (1.0, 1.0, 0.0))
    along = normalized(along - (along * normal).sum(axis=1, keepdims=True) / normal[:, 2:] * UP)
    side = cross(UP, local)
    world = np.stack((along, cross(normal, along), normal), axis=-1)
    quat = from_matrix(world @ np.stack((local, side, cross(local, side))))
    stands = back[:, :2].copy()
    stands[..., 2] = 1.0
    stands[..., 2] = (stands * plane[:, None]).sum(axis=2)
    position = spots + rotate(yaw, stands[:, 0]) - rotate(quat, foot.heel)
    gap = np.abs(stands[..., 2] - above[:, :2])
    gap = np.where(np.isnan(gap), MISSING, gap).max(axis=1)
    sole = back[:, : -tread.beside]
    at = (sole[..., :2] * plane[:, None, :2]).sum(axis=2) + plane[:, 2:]
    under = at - above[:, : -tread.beside]
    hangs = np.where(np.isnan(under), MISSING, under).max(axis=1)
    return Plates(position, quat, normal, gap, hangs)


def _rested(points: Array, heights: Array, load: Array, around: NDArray[np.int64]) -> Array:
    """Return planes (n, 3), ``z = a x + b y + c``, that rest on heights (n, k) at points (n, k, 2).

    Of all planes that nothing is above, the lowest at the load. As a simplex method does: a plane
    on three points around the load tips over to the one that is furthest above it, off the one
    that this leaves unloaded.
    """
    row = np.arange(len(heights))
    base = np.tile(around, (len(heights), 1))
    lifted = np.concatenate((points, np.ones((*points.shape[:2], 1))), axis=2)
    aim = np.append(load, 1.0)
    for pivot in range(_PIVOTS + 1):
        corners = lifted[row[:, None], base]
        plane = np.linalg.solve(corners, heights[row[:, None], base][..., None])[..., 0]
        over = heights - np.einsum("nki,ni->nk", lifted, plane)
        worst = over.argmax(axis=1)
        high = over[row, worst] > _EVEN
        if pivot == _PIVOTS or not high.any():
            break
        # Shares of the load, and of what is taken over by the point that comes in.
        sides = np.stack((np.broadcast_to(aim, (len(row), 3)), lifted[row, worst]), axis=-1)
        share = np.linalg.solve(np.swapaxes(corners, 1, 2), sides)
        ratio = np.where(
            share[..., 1] > 1e-9, share[..., 0] / np.maximum(share[..., 1], 1e-9), np.inf
        )
        out = ratio.argmin(axis=1)
        base[row[high], out[high]] = worst[high]
    plane[:, 2] += np.maximum(over.max(axis=1), 0.0)
    return np.asarray(plane)


def settle(tread: Tread, ground: Ground, spot: Array, yaw: Array) -> Plates:
    """Return where one sole comes to rest (n = 1), on the very ground that is under it then.

    Args:
      tread: the sole.
      ground: the scene's surfaces.
      spot: (3,) where its posed site is to be over the plane, about as high as the ground [m].
      yaw: (4,) how it is turned about the vertical.
    """
    turned = rotate(yaw, tread.points)
    for _ in range(_ROUNDS):
        heights, _ = ground.under(spot + turned * (1.0, 1.0, 0.0))
        plates = settled(tread, spot[None], yaw, heights[None], turned[None])
        turned = plates.position[0] - spot + rotate(plates.quat[0], tread.points)
    return plates


class HeightMap:
    """Heights of the ground around a spot, on a grid: for soles tried at many places.

    Args:
      ground: the scene's surfaces.
      spot: (3,) the middle, about as high as the ground [m].
      reach: how far from it is looked [m].
    """

    def __init__(self, ground: Ground, spot: Array, reach: float) -> None:
        count = int(np.ceil(reach / MAP_STEP))
        self._line = MAP_STEP * np.arange(-count, count + 1)
        x, y = np.meshgrid(self._line, self._line)
        heights, _ = ground.under(spot + np.stack((x, y, np.zeros_like(x)), axis=-1))
        self._heights, self._middle = heights, spot[:2]

    def at(self, points: Array) -> Array:
        """Return heights (...) [m] at points (..., 2 or 3), between those of the grid."""
        place = (points[..., :2] - self._middle - self._line[0]) / MAP_STEP
        first = np.clip(np.floor(place).astype(np.int64), 0, len(self._line) - 2)
        u, v = np.moveaxis(np.clip(place - first, 0.0, 1.0), -1, 0)
        column, row = first[..., 0], first[..., 1]
        low = (1.0 - u) * self._heights[row, column] + u * self._heights[row, column + 1]
        high = (1.0 - u) * self._heights[row + 1, column] + u * self._heights[row + 1, column + 1]
        return np.asarray((1.0 - v) * low + v * high)
