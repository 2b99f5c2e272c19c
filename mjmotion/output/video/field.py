"""Large heightfields, shown through a window that follows the figure.

The cost of a picture grows with every node of a heightfield, seen or not: 481 × 321 nodes
cost more than all the rest. So a copy of the model for pictures shows a square of it, with every
k-th of its own nodes, counted from its corner: the surface does not change as the window moves.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjmotion.output.video.gl import Canvas

Array = NDArray[np.float64]

WINDOW = 15.6
"""Side of the square that is shown [m]; fog must hide its edge."""

_NODES = 105  # along a side of the window, at most
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

        step = max(int(np.ceil(np.min(side / self._gap) / (nodes - 1) - 1e-9)), 1)
        axes = None
        period = _texture_period(model, int(geoms[0]))
        if len(geoms) == 1 and model.geom_bodyid[geoms[0]] == 0 and period is not None:
            axes = [self._places(size[axis], axis, step, nodes, period[axis]) for axis in range(2)]
        if axes is None or any(len(places) == 0 for places, _ in axes):
            step = -(-int(size.max()) // _WHOLE)
            axes = [(np.zeros(1, np.int64), int(count)) for count in size]
        self._step = step
        self._places_xy = [places for places, _ in axes]
        self._span = np.array([span for _, span in axes])
        self._shown: tuple[int, int] | None = None

    def _places(
        self, size: int, axis: int, step: int, nodes: int, period: float
    ) -> tuple[NDArray[np.int64], int]:
        """Return the nodes where the window may begin on one axis, and how many it spans.

        Nodes, counted in the field's own; none if a texture would swim wherever it begins.
        """
        last = (int(size) - 1) // step * step
        if last <= 1.2 * step * (nodes - 1):
            return np.zeros(1, np.int64), last
        for span in step * (nodes - 1 - np.arange(_FEWER)):
            places = np.arange(0, last - span + 1, step)
            if not np.isfinite(period):
                return np.union1d(places[::_JUMP], places[-1:]), int(span)
            turns = ((places + span / 2) * self._gap[axis] - self._half[axis]) / period
            places = places[np.abs(turns - np.round(turns)) * period < _SWIM]
            if len(places) and np.all(np.diff(places) <= span // 4):
                return places, int(span)
        return np.empty(0, np.int64), 0

    def move(self, model: mujoco.MjModel, point: Array) -> bool:
        """Show the part around ``point`` (3,) [m]; return whether that is another part."""
        local = self._matrix[0].T @ (point - self._pos[0])
        wanted = (local[:2] + self._half) / self._gap - self._span / 2
        x, y = (
            int(places[np.argmin(np.abs(places - place))])
            for places, place in zip(self._places_xy, wanted, strict=True)
        )
        if self._shown == (x, y):
            return False
        self._shown = (x, y)
        end = (x, y) + self._span + 1
        part = self._heights[y : end[1] : self._step, x : end[0] : self._step]
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
