"""From pixels to the world and back: rays, planes, axes, and which handle the mouse is on.

    view = View.of(model, data, camera, (1000, 700))
    origin, way = view.ray((420.0, 310.0))
    pixels, depth = view.project(points)

Pixels count from the upper left corner, y down. Pure functions; no window is needed.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Point = tuple[float, float]

HANDLES = ("x", "y", "z", "turn")
NEAR = 8.0  # how near to a handle the mouse is on it [pixel]
HANDLE_LENGTH = 0.11  # of an axis, as a share of its distance from the eye
_RING = 32  # points of the ring of a turn
_PARALLEL = 1e-6  # a ray this near to a plane or an axis says nothing about a place on it


@dataclasses.dataclass(frozen=True, eq=False)
class View:
    """How the world is seen.

    Attributes:
      eye: (3,) where from [m].
      forward, right, up: (3,) unit vectors of the picture.
      half_height: half of what is seen at unit distance.
      middle: (2,) where the picture's middle is at unit distance, to the right and up.
      size: width and height [pixel].
    """

    eye: Array
    forward: Array
    right: Array
    up: Array
    half_height: float
    middle: Point
    size: Point

    @classmethod
    def of(
        cls,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        camera: mujoco.MjvCamera,
        size: Point,
    ) -> View:
        """Return the view of a camera on a window of some size [pixel]."""
        seen = mujoco.mjv_camera2GLCamera(model, data, camera)
        eye, forward, up = (np.array(one, float) for one in (seen.pos, seen.forward, seen.up))
        near = float(seen.frustum_near)
        forward /= np.linalg.norm(forward)  # MuJoCo's are of single precision
        right = np.cross(forward, up)
        right /= np.linalg.norm(right)
        return cls(
            eye,
            forward,
            right,
            np.cross(right, forward),
            float(seen.frustum_top - seen.frustum_bottom) / 2.0 / near,
            (
                float(seen.frustum_center) / near,
                float(seen.frustum_top + seen.frustum_bottom) / 2.0 / near,
            ),
            (max(1.0, float(size[0])), max(1.0, float(size[1]))),
        )

    @property
    def _half(self) -> Point:
        return self.half_height * self.size[0] / self.size[1], self.half_height

    def ray(self, pixel: Point) -> tuple[Array, Array]:
        """Return where the ray through a pixel begins (3,) [m], and its unit direction (3,)."""
        across = self.middle[0] + (2.0 * pixel[0] / self.size[0] - 1.0) * self._half[0]
        above = self.middle[1] + (1.0 - 2.0 * pixel[1] / self.size[1]) * self._half[1]
        way = self.forward + across * self.right + above * self.up
        return self.eye, way / np.linalg.norm(way)

    def project(self, points: ArrayLike) -> tuple[Array, Array]:
        """Return where points (n, 3) are seen (n, 2) [pixel], and their depth (n,) [m].

        Points that are not before the eye have a depth of 0 or less, and no place: NaN.
        """
        away = np.atleast_2d(np.asarray(points, dtype=np.float64)) - self.eye
        depth = away @ self.forward
        ahead = np.where(depth > 0.0, depth, np.nan)
        across = (away @ self.right / ahead - self.middle[0]) / self._half[0]
        above = (away @ self.up / ahead - self.middle[1]) / self._half[1]
        x = (across + 1.0) / 2.0 * self.size[0]
        y = (1.0 - above) / 2.0 * self.size[1]
        return np.column_stack((x, y)), depth

    def on_plane(self, pixel: Point, through: ArrayLike, normal: ArrayLike) -> Array | None:
        """Return the place (3,) under the mouse on a plane [m]; None where it meets none ahead."""
        origin, way = self.ray(pixel)
        slope = float(way @ np.asarray(normal))
        if abs(slope) < _PARALLEL:
            return None
        along = float((np.asarray(through) - origin) @ np.asarray(normal)) / slope
        return origin + along * way if along > 0.0 else None

    def along_axis(self, pixel: Point, through: ArrayLike, axis: ArrayLike) -> float | None:
        """Return how far along a unit axis the mouse is [m]: where the ray comes nearest to it."""
        origin, way = self.ray(pixel)
        axis = np.asarray(axis, dtype=np.float64)
        away = origin - np.asarray(through)
        slant = float(axis @ way)
        flat = 1.0 - slant * slant
        if flat < _PARALLEL:
            return None
        return float(axis @ away - slant * (way @ away)) / flat

    def angle_about(self, pixel: Point, through: ArrayLike) -> float | None:
        """Return the mouse's direction from a place on the level plane there, about z [rad]."""
        at = self.on_plane(pixel, through, (0.0, 0.0, 1.0))
        if at is None:
            return None
        x, y = (at - np.asarray(through))[:2]
        return float(np.arctan2(y, x))

    def handle_lines(self, place: ArrayLike, turn: bool) -> dict[str, Array]:
        """Return the handles at a place (3,) as lines in the world (n, 3) [m], by name.

        Of one size on the picture however far they are.

        Args:
          place: where.
          turn: whether there is a ring to turn about the vertical too.
        """
        place = np.asarray(place, dtype=np.float64)
        length = HANDLE_LENGTH * max(float((place - self.eye) @ self.forward), 0.0)
        lines = {
            name: np.stack((place, place + length * axis))
            for name, axis in zip("xyz", np.eye(3), strict=True)
        }
        if turn:
            angle = np.linspace(0.0, 2.0 * np.pi, _RING + 1)
            ring = np.column_stack((np.cos(angle), np.sin(angle), np.zeros(len(angle))))
            lines["turn"] = place + 0.7 * length * ring
        return lines

    def handle_at(self, pixel: Point, place: ArrayLike, turn: bool) -> str | None:
        """Return the handle that the mouse is on; the nearest of several, None off all."""
        best, found = NEAR, None
        for name, line in self.handle_lines(place, turn).items():
            seen, depth = self.project(line)
            if (depth <= 0.0).any():
                continue
            if (away := distance_to_line(pixel, seen)) < best:
                best, found = away, name
        return found


def distance_to_line(pixel: Point, line: Array) -> float:
    """Return how far a pixel is from a line through points (n, 2) [pixel]."""
    start, way = line[:-1], np.diff(line, axis=0)
    length = np.maximum((way**2).sum(axis=1), _PARALLEL)
    share = np.clip(((np.asarray(pixel) - start) * way).sum(axis=1) / length, 0.0, 1.0)
    return float(np.linalg.norm(start + share[:, None] * way - pixel, axis=1).min())


def pull(view: View, pixel: Point, start: Point, place: ArrayLike, handle: str) -> Array | None:
    """Return how far (3,) a handle at a place is pulled, from one pixel to another [m]."""
    axis = np.eye(3)["xyz".index(handle)]
    before, now = (view.along_axis(at, place, axis) for at in (start, pixel))
    return None if before is None or now is None else (now - before) * axis


def turned(view: View, pixel: Point, start: Point, place: ArrayLike) -> float | None:
    """Return how far a ring at a place is turned, from one pixel to another [rad]."""
    before, now = (view.angle_about(at, place) for at in (start, pixel))
    if before is None or now is None:
        return None
    return float((now - before + np.pi) % (2.0 * np.pi) - np.pi)


def nearest(point: ArrayLike, places: Array, names: Sequence[str]) -> str:
    """Return the name of the place (n, 3) that is nearest to a point (3,)."""
    return names[int(np.linalg.norm(places - np.asarray(point), axis=1).argmin())]
