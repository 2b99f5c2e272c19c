"""Meshes stretched: every use of a mesh gets an asset of its own where the stretches differ."""

from __future__ import annotations

import struct
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.numerics.rotations import to_matrix

Array = NDArray[np.float64]

_ALIGNED = 1e-6  # how far from diagonal a map may be to be a scale along a mesh's own axes
_COPIED = (
    ("file", "content_type", "refpos", "refquat", "inertia", "smoothnormal", "needsdf")
    + ("maxhullvert", "octree_maxdepth", "material", "userface", "usernormal", "userfacenormal")
    + ("usertexcoord", "userfacetexcoord", "uservert", "scale")
)


class StretchedMeshes:
    """Gives meshes of a spec under a linear map, each made once.

    Args:
      spec: the spec whose meshes are used; stretched ones are added to it.
      model: what the spec compiles to, with the meshes in the same order.
    """

    def __init__(self, spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
        self._spec, self._model = spec, model
        self._ids = {mesh.name or _stem(mesh.file): i for i, mesh in enumerate(spec.meshes)}
        self._made: dict[tuple[str, bytes], str] = {}
        self._kept: set[str] = set()
        self._original = {
            name: {key: _value(spec.meshes[i], key) for key in _COPIED}
            for name, i in self._ids.items()
        }

    def named(self, name: str, stretch: Array) -> str:
        """Return the name of the mesh ``name`` under ``stretch`` (3, 3), in the mesh's own axes."""
        key = (name, np.round(stretch, 9).tobytes())
        if key not in self._made:
            self._made[key] = self._make(name, stretch)
        return self._made[key]

    def _make(self, name: str, stretch: Array) -> str:
        mesh = self._spec.meshes[self._ids[name]]
        if name in self._kept:  # the first use keeps the asset, others get a copy
            mesh = self._spec.add_mesh(name=self._free(name))
            for key, value in self._original[name].items():
                setattr(mesh, key, value)
        elif not mesh.name:
            mesh.name = name
        self._kept.add(name)
        _stretch(self._spec, mesh, stretch, self._model, self._ids[name])
        return str(mesh.name)

    def _free(self, name: str) -> str:
        taken = {mesh.name for mesh in self._spec.meshes}
        number = 2
        while f"{name}_{number}" in taken:
            number += 1
        return f"{name}_{number}"


def _value(mesh: Any, key: str) -> Any:
    value = getattr(mesh, key)
    if key.startswith("user"):
        return np.array(value)
    return np.array(value) if isinstance(value, np.ndarray) else value


def _stem(file: str) -> str:
    return file.replace("\\", "/").rsplit("/", 1)[-1].rsplit(".", 1)[0]


def _stretch(
    spec: mujoco.MjSpec, mesh: Any, stretch: Array, model: mujoco.MjModel, index: int
) -> None:
    """Stretch one asset: by its vertices where they are inline, by its scale where that will do."""
    plain = not np.any(mesh.refpos) and np.allclose(mesh.refquat, (1, 0, 0, 0))
    diagonal = np.abs(stretch - np.diag(np.diag(stretch))).max() < _ALIGNED * np.abs(stretch).max()
    if plain and diagonal:
        if len(mesh.uservert):
            vertices = np.array(mesh.uservert).reshape(-1, 3) * np.diag(stretch)
            mesh.uservert = vertices.ravel()
        else:
            mesh.scale = np.array(mesh.scale) * np.diag(stretch)
        return
    # Compiled vertices stand in the mesh's inertial frame: back to the file's own axes first.
    start, count = model.mesh_vertadr[index], model.mesh_vertnum[index]
    turn = to_matrix(model.mesh_quat[index])
    vertices = model.mesh_vert[start : start + count] @ turn.T + model.mesh_pos[index]
    faces = model.mesh_face[model.mesh_faceadr[index] :][: model.mesh_facenum[index]]
    _embed(spec, mesh, vertices @ stretch.T, faces, model, index)


def _embed(
    spec: mujoco.MjSpec,
    mesh: Any,
    vertices: Array,
    faces: NDArray[np.int32],
    model: mujoco.MjModel,
    index: int,
) -> None:
    """Put new vertices into an asset: a file in memory; inline with texture coordinates."""
    inline = bool(len(mesh.uservert)) or model.mesh_texcoordadr[index] >= 0
    mesh.scale, mesh.refpos, mesh.refquat = (1, 1, 1), (0, 0, 0), (1, 0, 0, 0)
    mesh.usernormal, mesh.userfacenormal = [], []
    if not inline:
        name = f"{mesh.name}.stl"
        spec.assets = {**spec.assets, name: _stl(vertices, faces)}
        mesh.file, mesh.content_type = name, ""
        return
    was_hull = bool(len(mesh.uservert)) and not len(mesh.userface)
    mesh.file, mesh.content_type = "", ""
    mesh.uservert = vertices.ravel()
    mesh.userface = [] if was_hull else faces.ravel()
    if model.mesh_texcoordadr[index] >= 0:
        start, count = model.mesh_texcoordadr[index], model.mesh_texcoordnum[index]
        mesh.usertexcoord = model.mesh_texcoord[start : start + count].ravel()
        texcoords = model.mesh_facetexcoord[model.mesh_faceadr[index] :]
        mesh.userfacetexcoord = texcoords[: model.mesh_facenum[index]].ravel()


def _stl(vertices: Array, faces: NDArray[np.int32]) -> bytes:
    """Return a binary STL file; normals are left to the reader."""
    record = np.zeros(
        len(faces), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]
    )
    record["corners"] = vertices[faces]
    return bytes(80) + struct.pack("<I", len(faces)) + record.tobytes()
