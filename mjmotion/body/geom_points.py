"""Points on the surfaces of geoms: enough of them to stand for the shape."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.exceptions import ModelError

Array = NDArray[np.float64]


def body_points(model: mujoco.MjModel, body: int) -> Array:
    """Surface points (k, 3) of a body's colliding geoms, in the body's frame."""
    parts = []
    for geom in np.flatnonzero(model.geom_bodyid == body):
        if model.geom_contype[geom] == 0 and model.geom_conaffinity[geom] == 0:
            continue
        matrix = np.empty(9)
        mujoco.mju_quat2Mat(matrix, model.geom_quat[geom])
        parts.append(geom_points(model, int(geom)) @ matrix.reshape(3, 3).T + model.geom_pos[geom])
    if not parts:
        raise ModelError(f"body '{model.body(body).name}' has no geom that collides: no sole")
    return np.concatenate(parts)


def geom_points(model: mujoco.MjModel, geom: int) -> Array:
    """Surface points (k, 3) of one geom in its own frame."""
    kind, size = mujoco.mjtGeom(int(model.geom_type[geom])), model.geom_size[geom]
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = model.geom_dataid[geom]
        start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        return np.asarray(model.mesh_vert[start : start + count], dtype=np.float64)
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        signs = np.stack(np.meshgrid((-1, 1), (-1, 1), (-1, 1)), axis=-1).reshape(-1, 3)
        return np.asarray(signs * size)
    longitude, latitude = np.meshgrid(
        np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False), np.linspace(-0.5, 0.5, 9) * np.pi
    )
    ball = np.stack(
        (
            np.cos(latitude) * np.cos(longitude),
            np.cos(latitude) * np.sin(longitude),
            np.sin(latitude),
        ),
        axis=-1,
    ).reshape(-1, 3)
    if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        return np.asarray(ball * size)
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return np.asarray(ball * size[0])
    end = np.sign(ball[:, 2:]) * (0.0, 0.0, size[1])
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return np.asarray(ball * size[0] + end)
    flat = ball / np.maximum(np.abs(ball).max(axis=1, keepdims=True), 1e-9)
    return np.asarray(flat * (size[0], size[0], 0.0) + end)  # cylinder
