"""A camera that follows the walk: planned over the whole motion, so it never jerks."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.kinematics import Kinematics, RayCaster, character_geoms, root_body
from mjmotion.output.video.stage import without_character

if TYPE_CHECKING:
    from mjmotion.body.morph_body import MorphBody

Array = NDArray[np.float64]

FOVY = 32.0
"""Vertical field of view [degree]."""

_FILL = 0.6  # of the picture's height that the figure takes
_EXTENT_FRAMES = 200  # of which the figure's height is measured
_STEP = 0.5  # between the moments at which a view is chosen [s]
_BEARINGS = np.radians(np.arange(0, 360, 15))
_ELEVATIONS = np.radians([12.0, 24.0, 40.0])
_FAVOURITE = np.radians(58.0)  # from the way of walking: three-quarter view from the front
_REST_ELEVATION = 0.25  # of a camera at rest [rad]
_LOOKAT_SIGMA = 0.4  # [s]
_VIEW_SIGMA = 0.8  # [s]
_CLEARANCE = 0.35  # of the camera over the ground [m]


@dataclasses.dataclass(frozen=True, eq=False)
class CameraPath:
    """Where a camera is in every frame of a motion.

    Attributes:
      lookat: (n, 3) the point it looks at [m].
      bearing: (n,) direction from that point to the camera, about z from +x [rad].
      elevation: (n,) of the camera over that point [rad].
      distance: from that point [m].
    """

    lookat: Array
    bearing: Array
    elevation: Array
    distance: float

    @property
    def position(self) -> Array:
        """(n, 3) where the camera is [m]."""
        return self.lookat + self.distance * _direction(self.bearing, self.elevation)

    def at(self, frame: int) -> mujoco.MjvCamera:
        """Return MuJoCo's camera of one frame."""
        camera = mujoco.MjvCamera()
        camera.type = mujoco.mjtCamera.mjCAMERA_FREE
        camera.lookat[:] = self.lookat[frame]
        camera.distance = self.distance
        camera.azimuth = float(np.degrees(self.bearing[frame])) + 180.0
        camera.elevation = -float(np.degrees(self.elevation[frame]))
        return camera


def follow(
    model: mujoco.MjModel,
    qpos: Array,
    fps: float,
    *,
    scene: bool = True,
    body: MorphBody | None = None,
) -> CameraPath:
    """Plan a camera that keeps the figure at about 60 % of the picture's height.

    A view is chosen every half second among 24 bearings and three elevations by dynamic
    programming: it should not be blocked by the scene, lie three quarters to the front, and turn
    little. Then it is smoothed over time and kept above the ground.

    Args:
      model: the model with its scene.
      qpos: (n, nq) the motion.
      fps: its frames a second.
      scene: whether the scene can block the view.
      body: the figure's size in every frame, where that changes: then the largest fits.
    """
    centre = qpos[:, :3].copy()
    if body is None:
        some = qpos[:: max(len(qpos) // _EXTENT_FRAMES, 1)]
        low, high = figure_extent(model, some)
        height = float(np.median(high - low))
        centre[:, 2] += float(np.median((low + high) / 2 - some[:, 2]))
    else:
        low, high = figure_extent(model, qpos, body)
        height = float((high - low).max())
        centre[:, 2] = (low + high) / 2
    lookat = _smooth(centre, _LOOKAT_SIGMA * fps)
    distance = height / (2 * _FILL * np.tan(np.radians(FOVY) / 2))

    moments = np.unique(np.r_[np.arange(0, len(qpos), max(int(_STEP * fps), 1)), len(qpos) - 1])
    heading = walking_direction(qpos, fps)[moments]
    caster = RayCaster(without_character(model)) if scene else None
    blocked = (
        _blocked(caster, lookat[moments], distance, height)
        if caster is not None
        else np.zeros((len(moments), len(_BEARINGS), len(_ELEVATIONS)))
    )
    bearing, elevation = _choose(blocked, heading)
    frames = np.arange(len(qpos))
    bearing = _smooth(np.interp(frames, moments, np.unwrap(bearing)), _VIEW_SIGMA * fps)
    elevation = _smooth(np.interp(frames, moments, elevation), _VIEW_SIGMA * fps)

    path = CameraPath(lookat, bearing, elevation, float(distance))
    return path if caster is None else _above_ground(path, caster, fps)


def _above_ground(path: CameraPath, caster: RayCaster, fps: float) -> CameraPath:
    """Return the path, raised smoothly where the ground would come too near."""
    from scipy.ndimage import maximum_filter1d

    position = path.position
    above = position + np.array([0.0, 0.0, 100.0])
    drop, _, _ = caster.cast(above, np.array([0.0, 0.0, -1.0]))
    ground = np.where(drop >= 0, above[:, 2] - drop, -np.inf)
    lift = np.clip(ground + _CLEARANCE - position[:, 2], 0.0, path.distance / 2)
    window = 2 * int(_VIEW_SIGMA * fps) + 1
    lift = _smooth(maximum_filter1d(lift, window, mode="nearest"), _VIEW_SIGMA / 2 * fps)
    rise = np.clip(np.sin(path.elevation) + lift / path.distance, -0.99, 0.99)
    return dataclasses.replace(path, elevation=np.arcsin(rise))


def _smooth(values: Array, sigma: float) -> Array:
    """Return values (n, ...) smoothed over time by a Gaussian of ``sigma`` frames."""
    from scipy.ndimage import gaussian_filter1d

    return np.asarray(gaussian_filter1d(values, max(sigma, 1e-6), axis=0, mode="nearest"))


def whole_walk(
    model: mujoco.MjModel,
    qpos: Array,
    aspect: float,
    fovy: float,
    body: MorphBody | None = None,
) -> CameraPath:
    """Return a camera at rest that sees all of ``qpos`` (n, nq) from the side of the walk.

    Args:
      model: the model.
      qpos: (n, nq) the poses that are to be in the picture.
      aspect: width over height of the picture.
      fovy: vertical field of view [degree].
      body: the figure's size in each of these poses, where that changes.
    """
    low, high = figure_extent(model, qpos, body)
    middle = qpos[:, :3].copy()
    middle[:, 2] = (low + high) / 2
    radius = float(np.median(high - low) if body is None else (high - low).max()) / 2
    flat = qpos[:, :2] - qpos[:, :2].mean(axis=0)
    along = np.linalg.svd(flat, full_matrices=False)[2][0] if len(qpos) > 1 else np.array([1.0, 0])
    along = along * (1.0 if along @ (qpos[-1, :2] - qpos[0, :2]) >= 0 else -1.0)
    bearing = float(np.arctan2(along[1], along[0]) - np.pi / 2)  # walks from left to right
    back = _direction(np.array(bearing), np.array(_REST_ELEVATION))
    right = np.array([-np.sin(bearing), np.cos(bearing), 0.0])
    up = np.cross(back, right)
    lookat = np.zeros(3)
    for axis in (right, up, back):
        reach = middle @ axis
        lookat += axis * (reach.max() + reach.min()) / 2
    offset = middle - lookat
    tangent = np.tan(np.radians(fovy) / 2)
    need = np.maximum(
        (np.abs(offset @ right) + 0.6 * radius) / (tangent * aspect),
        (np.abs(offset @ up) + 1.15 * radius) / tangent,
    )
    distance = float(np.max(need + offset @ back)) * 1.03
    return CameraPath(lookat[None], np.array([bearing]), np.array([_REST_ELEVATION]), distance)


def figure_extent(
    model: mujoco.MjModel, qpos: Array, body: MorphBody | None = None
) -> tuple[Array, Array]:
    """Return the heights of the figure's lowest and highest point in every frame, (n,) each [m].

    ``body`` is its size in each of the poses, where that changes.
    """
    mine = character_geoms(model)
    if body is not None:
        from mjmotion.validation.morph_poses import body_poses

        poses, box = body_poses(body, qpos), body.fields["geom_aabb"][:, mine]
        return _spans(poses.geom[:, mine, 2], poses.geom_matrix[:, mine, 2], box)
    pose = Kinematics(model, len(qpos), geoms=True).forward(qpos)
    if len(mine) == 0 or pose.geom_xpos is None or pose.geom_xmat is None:
        height = pose.xpos[:, model.body_rootid == root_body(model), 2]
        return height.min(axis=1), height.max(axis=1)
    box = np.broadcast_to(model.geom_aabb[mine], (len(qpos), len(mine), 6))
    return _spans(pose.geom_xpos[:, mine, 2], pose.geom_xmat[:, mine, 2], box)


def _spans(height: Array, up: Array, box: Array) -> tuple[Array, Array]:
    """Return lowest and highest (n,) of boxes (n, g, 6) at heights (n, g), vertical in theirs."""
    centre = height + np.einsum("ngj,ngj->ng", up, box[..., :3])
    half = np.einsum("ngj,ngj->ng", np.abs(up), box[..., 3:])
    return (centre - half).min(axis=1), (centre + half).max(axis=1)


def walking_direction(qpos: Array, fps: float) -> Array:
    """Return the way of walking in every frame, about z from +x, unwrapped, (n,) [rad].

    Slow changes only. Where the figure stands, the way it walked before or will walk counts.
    """
    if len(qpos) < 2:
        return np.zeros(len(qpos))
    velocity = np.gradient(qpos[:, :2], axis=0) * fps
    wide = _smooth(velocity, 1.5 * fps)
    total = qpos[-1, :2] - qpos[0, :2]
    length = float(np.linalg.norm(total))
    if length > 0.2:
        wide = wide + 0.05 * total / length
    elif not wide.any():
        wide = wide + np.array([1.0, 0.0])
    return np.unwrap(np.arctan2(wide[:, 1], wide[:, 0]))


def _direction(bearing: Array, elevation: Array) -> Array:
    """Return unit vectors (..., 3)."""
    bearing, elevation = np.broadcast_arrays(bearing, elevation)
    flat = np.cos(elevation)
    return np.stack((flat * np.cos(bearing), flat * np.sin(bearing), np.sin(elevation)), axis=-1)


def _blocked(caster: RayCaster, lookat: Array, distance: float, height: float) -> Array:
    """Return which share of the figure each view misses, (moment, bearing, elevation) in 0…1."""
    views = _direction(_BEARINGS[:, None], _ELEVATIONS[None])  # (b, e, 3)
    camera = lookat[:, None, None] + distance * views
    shares = []
    for part in (0.42, 0.15, -0.2, -0.42):  # head, chest, knees, ankles
        target = lookat + np.array([0.0, 0.0, part * height])
        ray = target[:, None, None] - camera
        hit, _, _ = caster.cast(camera.reshape(-1, 3), ray.reshape(-1, 3))
        shares.append(((hit >= 0) & (hit < 0.98)).reshape(camera.shape[:-1]))
    return np.mean(shares, axis=0)


def _choose(blocked: Array, heading: Array) -> tuple[Array, Array]:
    """Return the bearing and elevation of each moment, (m,) each [rad]: the cheapest path.

    Args:
      blocked: (m, b, e) share of the figure that is hidden.
      heading: (m,) the way of walking [rad].
    """
    moments, bearings, elevations = blocked.shape
    off = (_BEARINGS[None] - heading[:, None] + np.pi) % (2 * np.pi) - np.pi
    taste = ((np.abs(off) - _FAVOURITE) / np.radians(60.0)) ** 2
    taste += 0.2 * (off > 0)  # from its right the figure walks from left to right
    steep = np.array([0.0, 0.15, 0.8])[:elevations]
    cost = 6.0 * blocked + taste[:, :, None] + steep
    cost = cost.reshape(moments, -1)
    turn = (_BEARINGS[:, None] - _BEARINGS[None] + np.pi) % (2 * np.pi) - np.pi
    change = (
        0.15 * (turn[:, None, :, None] / np.radians(15.0)) ** 2
        + (np.arange(elevations)[:, None] - np.arange(elevations)[None])[None, :, None] ** 2 * 0.5
    ).reshape(bearings * elevations, -1)
    best = cost[0]
    came = np.zeros(cost.shape, np.int64)
    for moment in range(1, moments):
        total = best[:, None] + change
        came[moment] = np.argmin(total, axis=0)
        best = cost[moment] + np.min(total, axis=0)
    path = np.empty(moments, np.int64)
    path[-1] = np.argmin(best)
    for moment in range(moments - 1, 0, -1):
        path[moment - 1] = came[moment, path[moment]]
    return _BEARINGS[path // elevations], _ELEVATIONS[path % elevations]
