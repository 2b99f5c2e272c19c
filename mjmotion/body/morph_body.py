"""A body whose size changes from frame to frame: models of the key sizes, interpolated over time.

    body = MorphBody.between(model, [(20, long_legs), (61, short_legs)], nframe=62)
    body.bones                    # what a fit needs: offsets of bodies, joints and sites
    body.at(30)                   # all that changes, as fields of MjModel
    body.write(copy, 30)          # into a copy of the model, for a picture or a measurement

The key models have the same topology: the same bodies, joints, sites and shapes, in other sizes.
Between two keys every length goes from the one to the other by a smooth step with two continuous
derivatives, so nothing jerks. MuJoCo lays the vertices of a mesh out about its own principal axes,
which trade places as the mesh grows: here they are told from the user's frame of the mesh and
written along the axes that the motion's own model has.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Mapping, Sequence
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.bones import Bones
from mjmotion.body.morph_topology import Correspondence, check_same_topology, correspondence
from mjmotion.boundary.arrays import read_archive
from mjmotion.boundary.limits import real_array
from mjmotion.boundary.whole import whole_file
from mjmotion.exceptions import ModelError, MotionError
from mjmotion.numerics.rotations import conjugate, dot, multiply, normalized, rotate
from mjmotion.numerics.smoothing import ease

Array = NDArray[np.float64]

FIELDS = {
    "body_pos": "body",
    "jnt_pos": "joint",
    "site_pos": "site",
    "site_size": "site",
    "geom_pos": "geom",
    "geom_quat": "geom",
    "geom_size": "geom",
    "geom_aabb": "geom",
    "geom_rbound": "geom",
    "mesh_vert": "vertex",
    "mesh_normal": "normal",
}
"""Fields of MjModel that change with the body, and what each has a row for."""


@dataclasses.dataclass(frozen=True, eq=False)
class MorphBody:
    """One body a frame.

    Attributes:
      model: a model of the topology; its own sizes do not matter.
      fields: field of MjModel to its values in every frame (nframe, …): see :data:`FIELDS`.
      nframe: number of frames.

    Raises:
      ModelError: a field is missing, or its shape is not the model's.
    """

    model: mujoco.MjModel
    fields: Mapping[str, Array]
    nframe: int

    def __post_init__(self) -> None:
        for name in FIELDS:
            values = self.fields.get(name)
            wanted = (self.nframe, *getattr(self.model, name).shape)
            if values is None or values.shape != wanted:
                found = "missing" if values is None else f"{values.shape}"
                raise ModelError(f"body that changes: {name} is {found}, the model wants {wanted}")

    @classmethod
    def between(
        cls,
        model: mujoco.MjModel,
        keys: Sequence[tuple[int, mujoco.MjModel]],
        nframe: int,
    ) -> MorphBody:
        """Return the body that is each key's at its frame, and in between on its way.

        Args:
          model: the motion's own model: the body at frame 0, unless a key says otherwise.
          keys: frames, rising, and the models whose sizes the body has then. After the last the
            body stays as it is.
          nframe: number of frames.

        Raises:
          MotionError: no keys, or frames that do not rise or that the motion does not have.
          ModelError: a model of another topology.
        """
        frames = [int(frame) for frame, _ in keys]
        if not frames:
            raise MotionError("a morph needs keys: give at least one frame and its body")
        outside = [frame for frame in frames if not 0 <= frame < nframe]
        if outside:
            raise MotionError(
                f"key at frame {outside[0]}: the motion has frames 0 to {nframe - 1}", outside
            )
        if any(later <= earlier for earlier, later in pairwise(frames)):
            raise MotionError(f"key frames {', '.join(map(str, frames))} must rise", frames)
        for frame, key in keys:
            check_same_topology(model, key, f"key at frame {frame}")
        chain = [*([] if frames[0] == 0 else [(0, model)]), *keys]
        share = shares([frame for frame, _ in chain], nframe)
        shapes = [_shape(model, key) for _, key in chain]
        mixed = {
            name: np.einsum("fk,k...->f...", share, np.stack([shape[name] for shape in shapes]))
            for name in shapes[0]
        }
        return cls(model, _fields(model, mixed), nframe)

    @cached_property
    def bones(self) -> Bones:
        """Offsets of bodies, joints and sites in every frame."""
        return Bones(*(self.fields[name] for name in ("body_pos", "jnt_pos", "site_pos")))

    def at(self, frame: int) -> dict[str, Array]:
        """Return the fields of one frame, each as MjModel has it."""
        return {name: values[frame] for name, values in self.fields.items()}

    def write(self, model: mujoco.MjModel, frame: int) -> None:
        """Write one frame's body into a model of this topology: a copy for pictures or measures.

        Collision trees of meshes are not told, so such a model is not for collisions.
        """
        for name, values in self.at(frame).items():
            getattr(model, name)[:] = values

    def model_at(self, frame: int) -> mujoco.MjModel:
        """Return a copy of the model with one frame's body."""
        model = copy.copy(self.model)
        self.write(model, frame)
        return model

    def on(self, model: mujoco.MjModel) -> MorphBody:
        """Return the same body on another model with this character in it, such as with a scene.

        Raises:
          ModelError: the model does not hold the character.
        """
        if model is self.model:
            return self
        places: Correspondence = correspondence(self.model, model)
        fields = {}
        for name, kind in FIELDS.items():
            own, there = places[kind]
            whole = getattr(model, name)
            values = np.broadcast_to(whole, (self.nframe, *whole.shape)).astype(np.float64)
            values[:, there] = self.fields[name][:, own]
            fields[name] = values
        return MorphBody(model, fields, self.nframe)

    def part(self, frames: slice | NDArray[np.int64]) -> MorphBody:
        """Return the body over some of the frames."""
        fields = {name: values[frames] for name, values in self.fields.items()}
        return MorphBody(self.model, fields, len(next(iter(fields.values()))))

    def save(self, path: str | Path) -> None:
        """Write all fields into an ``.npz`` file; meshes in single precision, as MuJoCo has them.

        Raises:
          OSError: it cannot be written.
        """
        fields = {
            name: values.astype(np.float32) if name.startswith("mesh") else values
            for name, values in self.fields.items()
        }
        with whole_file(path) as aside, aside.open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, **fields)

    @classmethod
    def load(cls, path: str | Path, model: mujoco.MjModel) -> MorphBody:
        """Read a file of :meth:`save`.

        Raises:
          ModelError: the file is missing or damaged, or its fields are not the model's.
        """
        if not Path(path).is_file():
            raise ModelError(f"body file '{path}' does not exist: check the path")
        try:
            data = read_archive(path, tuple(FIELDS))
            fields = {name: real_array(values, name) for name, values in data.items()}
            bad = [name for name, values in fields.items() if not np.isfinite(values).all()]
            if bad:
                raise ValueError(f"{bad[0]} is not finite")
            if fields["body_pos"].ndim == 0:
                raise ValueError("body_pos is a single number")
        except (ValueError, MotionError) as error:
            raise ModelError(f"'{path}' holds no body of a morph ({error})") from error
        return cls(model, fields, len(fields["body_pos"]))


def shares(frames: Sequence[int], nframe: int) -> Array:
    """Return how much of each key's body there is at every frame, (nframe, nkey), rows sum to 1.

    A smooth step (quintic) from key to key: value, rate and the rate's rate are continuous.
    """
    share = np.zeros((nframe, len(frames)))
    share[:, 0] = 1.0
    for index, (start, end) in enumerate(pairwise(frames)):
        s = np.clip((np.arange(nframe) - start) / (end - start), 0.0, 1.0)
        step = ease(s)
        share[:, index] *= 1.0 - step
        share[:, index + 1] = step
    return share


def _shape(base: mujoco.MjModel, key: mujoco.MjModel) -> dict[str, Array]:
    """Return what of a key can be interpolated linearly: lengths, and meshes in the user's frame.

    Quaternions have the signs that are nearest to the base's.
    """
    vertex, normal = _by_mesh(key, "vert"), _by_mesh(key, "normal")
    return {
        **{name: np.array(getattr(key, name)) for name in ("body_pos", "jnt_pos")},
        **{name: np.array(getattr(key, name)) for name in ("site_pos", "site_size", "geom_size")},
        "geom_aabb": np.array(key.geom_aabb),
        "geom_rbound": np.array(key.geom_rbound),
        "mesh_pos": np.array(key.mesh_pos),
        "vertex": key.mesh_pos[vertex] + rotate(key.mesh_quat[vertex], _wide(key.mesh_vert)),
        "normal": rotate(key.mesh_quat[normal], _wide(key.mesh_normal)),
        "geom_pos": _users_geoms(key)[0],
        "geom_quat": _same_side(_users_geoms(key)[1], _users_geoms(base)[1]),
    }


def _fields(base: mujoco.MjModel, shape: Mapping[str, Array]) -> dict[str, Array]:
    """Return fields of MjModel (nframe, …) from interpolated shapes, meshes along the base's axes.

    The inverse of :func:`_shape`, over frames.
    """
    fields = {name: shape[name] for name in FIELDS if name in shape}
    vertex, normal = _by_mesh(base, "vert"), _by_mesh(base, "normal")
    middle, turn = shape["mesh_pos"], base.mesh_quat
    fields["mesh_vert"] = rotate(conjugate(turn[vertex]), shape["vertex"] - middle[:, vertex])
    fields["mesh_normal"] = normalized(rotate(conjugate(turn[normal]), shape["normal"]))
    quat = normalized(shape["geom_quat"])
    position = shape["geom_pos"]
    for geom in np.flatnonzero(base.geom_type == mujoco.mjtGeom.mjGEOM_MESH):
        mesh = base.geom_dataid[geom]
        start, count = base.mesh_vertadr[mesh], base.mesh_vertnum[mesh]
        points = fields["mesh_vert"][:, start : start + count]
        low, high = points.min(axis=1), points.max(axis=1)
        position[:, geom] += rotate(quat[:, geom], middle[:, mesh])
        quat[:, geom] = multiply(quat[:, geom], turn[mesh])
        fields["geom_aabb"][:, geom] = np.concatenate((low + high, high - low), axis=1) / 2.0
        size = np.abs(points).max(axis=1)  # as MuJoCo has it: about the mesh's frame
        fields["geom_size"][:, geom] = size
        fields["geom_rbound"][:, geom] = np.linalg.norm(size, axis=1)
    return {**fields, "geom_pos": position, "geom_quat": quat}


def _users_geoms(model: mujoco.MjModel) -> tuple[Array, Array]:
    """Return where geoms are in their bodies, (ngeom, 3) [m] and (ngeom, 4), meshes as the user
    put them: before MuJoCo moved them to their own middles and axes.
    """
    position, quat = np.array(model.geom_pos), np.array(model.geom_quat)
    meshes = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_MESH)
    own = model.geom_dataid[meshes]
    quat[meshes] = multiply(quat[meshes], conjugate(model.mesh_quat[own]))
    position[meshes] -= rotate(quat[meshes], model.mesh_pos[own])
    return position, quat


def _same_side(quat: Array, other: Array) -> Array:
    return np.where(dot(quat, other)[:, None] < 0.0, -quat, quat)


def _by_mesh(model: mujoco.MjModel, what: str) -> NDArray[np.int64]:
    """Return the mesh of every vertex or normal."""
    count = getattr(model, f"mesh_{what}num")
    return np.repeat(np.arange(model.nmesh), count)


def _wide(values: NDArray[np.float32]) -> Array:
    return np.asarray(values, dtype=np.float64)
