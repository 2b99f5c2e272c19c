"""Large heightfields, shown through a window that follows the figure.

The cost of a picture grows with every node of a heightfield, seen or not: 481 × 321 nodes
cost more than all the rest. So a copy of the model for pictures shows a square of it, with every
k-th of its own nodes, counted from its corner: the surface does not change as the window moves.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjmotion.video.gl import Canvas

Array = NDArray[np.float64]

WINDOW = 12.6
"""Side of the square that is shown [m]; fog must hide its edge."""

_NODES = 85  # along a side of the window, at most
_WHOLE = 256  # along a side of a field that cannot be cut
_JUMP = 8  # nodes that the window moves at once, so that few frames have to upload
_FEWER = 8  # nodes that a window may lack for the sake of a texture
_SWIM = 0.01  # by which a texture may move with the window [m]


class FieldWindow:
    """Shows a square of each large heightfield around a point.

    Fields that are small enough are left as they are. Those that cannot be cut (used by several
    geoms, on a moving body, or with a texture that would swim) are shown whole, but thinned.

    Args:
      model: a copy for pictures, from before its :class:`Canvas` is made; changed by ``move``.
      side: of the square [m].
      nodes: along a side, at most.
    """

    def __init__(self, model: mujoco.MjModel, side: float = WINDOW, nodes: int = _NODES) -> None:
        self._model = model
        self._fields = [
            _Field(model, index, geoms, side, nodes)
            for index in range(model.nhfield)
            if len(geoms := _geoms_of(model, index))
            and max(model.hfield_nrow[index], model.hfield_ncol[index]) > nodes
        ]

    def move(self, point: ArrayLike, canvas: Canvas | None = None) -> bool:
        """Move every window to ``point`` (3,) [m] and tell ``canvas``; return whether any moved."""
        moved = False
        for field in self._fields:
            if field.move(self._model, np.asarray(point, dtype=np.float64)):
                moved = True
                if canvas is not None:
                    canvas.upload_hfield(self._model, field.index)
        return moved


class _Field:
    """One heightfield of which a part is shown."""

    def __init__(
        self,
        model: mujoco.MjModel,
        index: int,
        geoms: NDArray[np.int64],
        side: float,
        nodes: int,
    ) -> None:
        self.index, self._geoms = index, geoms
        rows, columns = int(model.hfield_nrow[index]), int(model.hfield_ncol[index])
        self._begin = int(model.hfield_adr[index])
        data = model.hfield_data[self._begin : self._begin + rows * columns]
        self._heights = data.reshape(rows, columns).copy()
        size = np.array([columns, rows])
        self._half = model.hfield_size[index, :2].copy()
        self._gap = 2 * self._half / (size - 1)  # between nodes, x and y [m]
        self._pos = model.geom_pos[geoms].copy()
        self._matrix = np.array([_matrix(quat) for quat in model.geom_quat[geoms]])

        count = np.minimum(side / self._gap, size - 1) + 1
        step = max(int(np.ceil((count.max() - 1) / (nodes - 1) - 1e-9)), 1)
        period = _texture_period(model, int(geoms[0]))
        corners = None
        if len(geoms) == 1 and model.geom_bodyid[geoms[0]] == 0 and period is not None:
            for fewer in range(_FEWER):  # some sizes keep a texture in place, others cannot
                corners = self._corners(size, step, nodes - fewer, period)
                if corners is not None:
                    nodes -= fewer
                    break
        if corners is None:
            step = -(-int(size.max()) // _WHOLE)
            nodes = int(size.max())
            corners = [np.zeros(1, np.int64)] * 2
        self._step, self._span, self._corners_xy = step, step * (nodes - 1), corners
        self._shown: tuple[int, int] | None = None

    def _corners(
        self, size: NDArray[np.int64], step: int, nodes: int, period: Array
    ) -> list[NDArray[np.int64]] | None:
        """Return the nodes, along x and y, where the window may begin; None if there are none."""
        corners = []
        for axis in range(2):
            last = int(size[axis] - 1) // step * step
            span = step * (nodes - 1)
            places = np.arange(0, max(last - span, 0) + 1, step)
            if len(places) > 1 and np.isfinite(period[axis]):
                shift = (places + span / 2) * self._gap[axis] - self._half[axis]
                turns = shift / period[axis]
                places = places[np.abs(turns - np.round(turns)) * period[axis] < _SWIM]
                if len(places) == 0 or np.any(np.diff(places) > span // 4):
                    return None
            elif len(places) > 1:
                places = np.union1d(places[::_JUMP], places[-1:])
            corners.append(places)
        return corners

    def move(self, model: mujoco.MjModel, point: Array) -> bool:
        """Show the part around ``point`` (3,) [m]; return whether that is another part."""
        local = self._matrix[0].T @ (point - self._pos[0])
        wanted = (local[:2] + self._half) / self._gap - self._span / 2
        x, y = (
            int(places[np.argmin(np.abs(places - place))])
            for places, place in zip(self._corners_xy, wanted, strict=True)
        )
        if self._shown == (x, y):
            return False
        self._shown = (x, y)
        end = self._span + 1
        part = self._heights[y : y + end : self._step, x : x + end : self._step]
        model.hfield_nrow[self.index], model.hfield_ncol[self.index] = part.shape
        model.hfield_data[self._begin : self._begin + part.size] = part.ravel()
        half = (np.array(part.shape[::-1]) - 1) * self._step * self._gap / 2
        model.hfield_size[self.index, :2] = half
        shift = np.array([*(np.array([x, y]) * self._gap + half - self._half), 0.0])
        model.geom_pos[self._geoms] = self._pos + self._matrix @ shift
        return True


def _geoms_of(model: mujoco.MjModel, index: int) -> NDArray[np.int64]:
    of_type = model.geom_type == mujoco.mjtGeom.mjGEOM_HFIELD
    return np.flatnonzero(of_type & (model.geom_dataid == index))


def _texture_period(model: mujoco.MjModel, geom: int) -> Array | None:
    """Return after which lengths along x and y a geom's texture repeats (2,) [m].

    Infinite without a texture; None where it is stretched over the geom, whatever its size.
    """
    material = int(model.geom_matid[geom])
    if material < 0 or np.all(model.mat_texid[material] < 0):
        return np.full(2, np.inf)
    if not model.mat_texuniform[material]:
        return None
    # MuJoCo lays `texrepeat` copies over two metres: a unit object reaches from -1 to 1
    return 2.0 / np.maximum(model.mat_texrepeat[material], 1e-9)


def _matrix(quat: Array) -> Array:
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, quat)
    return matrix.reshape(3, 3)
