"""Ways that are given: by sites of a scene, by a file of points, by an array.

way = way_sites(scene)             # way_1, way_2, …; None where there are none
way = read_way("way.csv")          # or JSON or YAML: a list of [x, y]
line = rounded(way)
"""

from __future__ import annotations

import csv
import re
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjmotion.boundary.limits import MOST_LENGTH, MOST_STRUCTURED, at_most, real_array, shown
from mjmotion.boundary.structured import read_structured
from mjmotion.exceptions import SceneError
from mjmotion.numerics.smoothing import follow
from mjmotion.route.centreline import at_lengths
from mjmotion.route.fit import FINE
from mjmotion.scene import Scene

Array = NDArray[np.float64]

MOST_POINTS = 10_000  # of a way
ROUND = 0.3  # τ with which corners are rounded [m]
SMOOTH = np.radians(12.0)  # a way that turns by no more from piece to piece is smooth as it is
NEAR = 0.1  # points nearer to the start, or to each other, are one with it [m]
_SITE = re.compile(r"way_([0-9]{1,6})")


def way_sites(scene: Scene) -> Array | None:
    """Return the way (n, 2) from a scene's start over its sites ``way_1, way_2, …`` [m], or None.

    Raises:
      SceneError: they are all in one place.
    """
    model = scene.model
    found = {}
    for site in range(model.nsite):
        match = _SITE.fullmatch(model.site(site).name)
        if match:
            found[int(match[1])] = site
    if not found:
        return None
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    points = [scene.start_pos[:2], *(data.site_xpos[found[number], :2] for number in sorted(found))]
    return check_way(points, f"way of scene '{scene.name}'")


def read_way(path: str | Path) -> Array:
    """Return the way (n, 2) of a file: CSV of x and y, or a JSON or YAML list of [x, y] [m].

    Raises:
      SceneError: no such file, damaged, or no way.
    """
    path = Path(path)
    if path.suffix.lower() in (".json", ".yaml", ".yml"):
        return check_way(read_structured(path, "way", SceneError), f"way '{path}'")
    try:
        at_most(path.stat().st_size, MOST_STRUCTURED, f"bytes of way '{path}'", SceneError)
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = [row for row in csv.reader(file) if any(cell.strip() for cell in row)]
    except (OSError, ValueError, csv.Error) as error:
        why = getattr(error, "strerror", None) or error
        raise SceneError(f"cannot read way '{path}': {why}") from None
    if rows and [cell.strip().lower() for cell in rows[0]] == ["x", "y"]:
        rows = rows[1:]
    at_most(len(rows), MOST_POINTS, f"points of way '{path}'", SceneError)
    points = []
    for number, row in enumerate(rows, 1):
        try:
            points.append([float(cell) for cell in row])
        except ValueError:
            raise SceneError(
                f"way '{path}', point {number}: {shown(','.join(row))} is not x,y in metres"
            ) from None
    return check_way(points, f"way '{path}'")


def check_way(points: object, what: str = "way") -> Array:
    """Return points as a way (n, 2) [m], those that are one with the last left out.

    Raises:
      SceneError: they are not numbers, not pairs, too far away, too many, or in one place.
    """
    if not isinstance(points, (list, tuple, np.ndarray)):
        raise SceneError(f"{what}: it must be a list of points of x and y")
    if len(points) < 2:
        raise SceneError(f"{what}: it needs two points or more, further apart than {NEAR} m")
    if isinstance(points, (list, tuple)):
        for point in points:
            if np.shape(point) != (2,) or any(isinstance(value, bool) for value in point):
                raise SceneError(f"{what}: every point must be two numbers, x and y in metres")
    way = real_array(points, what, SceneError)
    if way.ndim != 2 or way.shape[1] != 2:
        raise SceneError(f"{what}: it must be a list of points of x and y, not {way.shape}")
    at_most(len(way), MOST_POINTS, f"points of {what}", SceneError)
    if not np.isfinite(way).all():
        raise SceneError(f"{what}: it holds numbers that are not finite")
    at_most(float(np.abs(way).max(initial=0.0)), MOST_LENGTH, f"{what} [m]", SceneError)
    far = np.linalg.norm(np.diff(way, axis=0), axis=1)
    if far.sum() <= NEAR:
        raise SceneError(f"{what}: it needs two points or more, further apart than {NEAR} m")
    return way[np.concatenate(([True], far > 1e-6))]


def rounded(way: ArrayLike) -> Array:
    """Return a way as points (n, 2), :data:`FINE` apart, with its corners rounded [m]."""
    points = np.asarray(way, dtype=np.float64)
    pieces = np.diff(points, axis=0)
    length = np.concatenate(([0.0], np.cumsum(np.linalg.norm(pieces, axis=1))))
    line = at_lengths(points, length, np.arange(0.0, length[-1] + 0.5 * FINE, FINE))
    turn = np.diff(np.unwrap(np.arctan2(pieces[:, 1], pieces[:, 0])))
    if np.abs(turn).max(initial=0.0) <= SMOOTH:
        return line
    weight = np.ones(len(line))
    weight[[0, -1]] = 1e4
    return follow(line, weight, ROUND / FINE)
