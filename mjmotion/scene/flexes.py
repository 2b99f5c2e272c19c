"""Cloths, ropes and soft bodies that stand still: geoms in the shape of a flex."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.numerics.rotations import cross, normalized

Array = NDArray[np.float64]
Faces = NDArray[np.int64]

THIN = 1e-3  # half the least thickness of what a cloth becomes [m]


def flexes_to_geoms(spec: mujoco.MjSpec, model: mujoco.MjModel, data: mujoco.MjData) -> list[int]:
    """Replace every flex of a scene by geoms of the world where it is in ``data``.

    A rope becomes capsules, a cloth a closed mesh as thick as the flex is, and a soft body its
    surface. They collide as the flex does, and look like it.

    Args:
      spec: the scene; it is changed.
      model: the scene compiled, with its flexes.
      data: a pose of it, flexes included.

    Returns:
      The ids of the bodies that the flexes' points belong to.
    """
    taken = {geom.name for geom in spec.geoms} | {mesh.name for mesh in spec.meshes}
    points: list[int] = []
    for index, flex in enumerate(list(spec.flexes)):
        start, count = model.flex_vertadr[index], model.flex_vertnum[index]
        vertices = np.array(data.flexvert_xpos[start : start + count])
        if model.flex_interp[index]:
            node, number = model.flex_nodeadr[index], model.flex_nodenum[index]
            points += model.flex_nodebodyid[node : node + number].tolist()
        else:
            points += model.flex_vertbodyid[start : start + count].tolist()
        name = flex.name
        while name in taken:
            name += "_"
        taken.add(name)
        if model.flex_dim[index] == 1:
            _add_rope(spec, model, index, vertices, flex, name)
        else:
            faces = _faces(model, index)
            thick = max(THIN, float(model.flex_radius[index]))
            shape = _sheet if model.flex_dim[index] == 2 else _inflated
            vertices, faces = shape(vertices, faces, thick)
            spec.add_mesh(
                name=name,
                uservert=vertices.ravel(),
                userface=faces.ravel(),
                inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
            )
            _add_geom(spec, flex, name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name)
        spec.delete(flex)
    return sorted(set(points) - {0})


def _add_rope(  # six parameters that all come from one loop
    spec: mujoco.MjSpec, model: mujoco.MjModel, index: int, vertices: Array, flex: Any, name: str
) -> None:
    """Add a capsule for every element of a one-dimensional flex."""
    radius = max(THIN, float(model.flex_radius[index]))
    for number, (one, other) in enumerate(_elements(model, index)):
        ends = np.concatenate((vertices[one], vertices[other]))
        if np.linalg.norm(ends[3:] - ends[:3]) > THIN:
            _add_geom(
                spec,
                flex,
                f"{name}_{number + 1}" if name else "",
                type=mujoco.mjtGeom.mjGEOM_CAPSULE,
                fromto=ends,
                size=(radius, 0.0, 0.0),
            )


def _add_geom(spec: mujoco.MjSpec, flex: Any, name: str, **shape: Any) -> None:
    """Add a geom that collides and looks as a flex does."""
    spec.worldbody.add_geom(
        name=name,
        contype=flex.contype,
        conaffinity=flex.conaffinity,
        group=flex.group,
        rgba=flex.rgba,
        material=next(iter(flex.material), ""),  # of several layers the first
        **shape,
    )


def _elements(model: mujoco.MjModel, index: int) -> Faces:
    """Return the elements (n, dim + 1) of a flex, by its own vertices."""
    start, width = int(model.flex_elemdataadr[index]), int(model.flex_dim[index]) + 1
    count = int(model.flex_elemnum[index])
    return np.array(model.flex_elem[start : start + count * width], np.int64).reshape(-1, width)


def _faces(model: mujoco.MjModel, index: int) -> Faces:
    """Return triangles (n, 3): a cloth's elements, a soft body's surface seen from outside."""
    if model.flex_dim[index] == 2:
        return _elements(model, index)
    start, count = int(model.flex_shelldataadr[index]), int(model.flex_shellnum[index])
    return np.array(model.flex_shell[start : start + 3 * count], np.int64).reshape(-1, 3)


def _normals(vertices: Array, faces: Faces) -> Array:
    """Return the mean normals (n, 3) of the triangles around each vertex, by their areas."""
    corner = vertices[faces]
    facing = cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    total = np.zeros_like(vertices)
    for column in faces.T:
        np.add.at(total, column, facing)
    return np.asarray(normalized(total))


def _sheet(vertices: Array, faces: Faces, thick: float) -> tuple[Array, Faces]:
    """Return a closed surface ``thick`` [m] on both sides of an open one."""
    normal, count = _normals(vertices, faces), len(vertices)
    edges = np.concatenate((faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]))
    there = {(int(a), int(b)) for a, b in edges}
    rim = np.array([edge for edge in sorted(there) if edge[::-1] not in there]).reshape(-1, 2)
    a, b = rim.T
    # Around the rim the two sides are joined by two triangles an edge.
    walls = np.concatenate(
        (np.stack((b, a, a + count), axis=1), np.stack((b, a + count, b + count), axis=1))
    )
    both = np.concatenate((vertices + thick * normal, vertices - thick * normal))
    return both, np.concatenate((faces, faces[:, ::-1] + count, walls))


def _inflated(vertices: Array, faces: Faces, thick: float) -> tuple[Array, Faces]:
    """Return a closed surface moved outwards by ``thick`` [m]."""
    used, faces = np.unique(faces, return_inverse=True)
    vertices, faces = vertices[used], faces.reshape(-1, 3)
    return vertices + thick * _normals(vertices, faces), faces
