"""Where everything is in all frames, and what rays hit: the one owner of ``mujoco.batch.Batch``.

    kinematics = Kinematics(model, nframe)
    pose = kinematics.forward(qpos)          # bodies, sites, joint axes of every frame
    jacp, jacr = pose.jacobian(points, body)  # of world points on one body
    distance, geom = cast_rays(model, origins, directions)

Jacobians are put together from joint axes and anchors: one pass for any number of points.
"""

from __future__ import annotations

import copy
import dataclasses
from functools import cached_property

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from mjmotion.body.bones import Bones
from mjmotion.exceptions import ModelError, unknown_name
from mjmotion.numerics.rotations import cross, exp, multiply, rotate

Array = NDArray[np.float64]

_RAY_CHUNK = 64  # simulations that many rays are cut into: enough to keep every core busy
_RAYS_EACH = 256  # rays of one of them at least: it takes longer to wake a thread for fewer


def site_id(model: mujoco.MjModel, name: str) -> int:
    """Return the id of a site; ModelError with the valid names if there is none."""
    # MuJoCo takes a name up to its first zero, and no half of a pair of Unicode.
    plain = "\0" not in name and name.encode("utf-8", "replace").decode() == name
    index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, name) if plain else -1
    if index < 0:
        names = [model.site(i).name for i in range(model.nsite)]
        raise ModelError(unknown_name("site", name, names))
    return int(index)


def root_body(model: mujoco.MjModel) -> int:
    """Return the body of the first joint: the free root."""
    return int(model.jnt_bodyid[0])


def check_free_root(model: mujoco.MjModel, *, only: bool = True) -> None:
    """Raise ModelError unless the model's first joint is free and, if asked, the only free one."""
    free = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)
    if len(free) == 0 or free[0] != 0 or (only and len(free) > 1):
        raise ModelError(
            "the model's first joint must be its only free one, the root:"
            f" it has {len(free)} free joints"
        )


def character_geoms(model: mujoco.MjModel, *, colliding: bool = False) -> NDArray[np.int64]:
    """Return the geoms of the bodies under the free root; only those that collide, if asked."""
    mine = model.body_rootid[model.geom_bodyid] == root_body(model)
    if colliding:
        mine &= (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    return np.flatnonzero(mine)


@dataclasses.dataclass(frozen=True, eq=False)
class DofKinds:
    """Where in ``nv`` each kind of degree of freedom stands, and whose it is."""

    straight: NDArray[np.int64]  # the root's three along the world axes
    turning: NDArray[np.int64]  # threes that turn about the axes of a body
    bodies: NDArray[np.int64]  # those bodies
    single: NDArray[np.int64]  # hinges and slides
    joints: NDArray[np.int64]  # those joints
    turns: NDArray[np.bool_]  # (nv,) whether a degree of freedom turns


def dof_kinds(model: mujoco.MjModel) -> DofKinds:
    """Return where in ``nv`` a model's degrees of freedom of each kind stand."""
    kind, first = model.jnt_type, model.jnt_dofadr
    three = np.arange(3)
    free = np.flatnonzero(kind == mujoco.mjtJoint.mjJNT_FREE)
    ball = np.flatnonzero(kind == mujoco.mjtJoint.mjJNT_BALL)
    joints = np.flatnonzero(
        (kind != mujoco.mjtJoint.mjJNT_FREE) & (kind != mujoco.mjtJoint.mjJNT_BALL)
    )
    starts = np.concatenate((first[free] + 3, first[ball]))
    straight = (first[free][:, None] + three).ravel()
    turns = np.ones(model.nv, dtype=bool)
    turns[straight] = False
    turns[first[kind == mujoco.mjtJoint.mjJNT_SLIDE]] = False
    return DofKinds(
        straight,
        (starts[:, None] + three).ravel(),
        model.jnt_bodyid[np.concatenate((free, ball))],
        first[joints],
        joints,
        turns,
    )


@dataclasses.dataclass(frozen=True, eq=False)
class Pose:
    """World positions of ``n`` frames: all arrays are copies.

    Attributes:
      model: the model.
      xpos: (n, nbody, 3) body origins [m].
      xquat: (n, nbody, 4) body orientations, wxyz.
      xmat: (n, nbody, 3, 3) body orientations.
      site_xpos: (n, nsite, 3) sites [m].
      site_xmat: (n, nsite, 3, 3) site orientations.
      xanchor: (n, njnt, 3) joint anchors [m].
      xaxis: (n, njnt, 3) joint axes.
      kinds: where each kind of degree of freedom stands.
      geom_xpos, geom_xmat: (n, ngeom, 3) [m] and (n, ngeom, 3, 3), if asked for.
    """

    model: mujoco.MjModel
    xpos: Array
    xquat: Array
    xmat: Array
    site_xpos: Array
    site_xmat: Array
    xanchor: Array
    xaxis: Array
    kinds: DofKinds
    geom_xpos: Array | None = None
    geom_xmat: Array | None = None

    @cached_property
    def dof_axis(self) -> Array:
        """(n, nv, 3) the world axis that each degree of freedom turns about or moves along."""
        kinds, model = self.kinds, self.model
        axis = np.zeros((len(self.xpos), model.nv, 3))
        axis[:, kinds.straight] = np.eye(3)
        frames = np.swapaxes(self.xmat[:, kinds.bodies], 2, 3)
        axis[:, kinds.turning] = frames.reshape(len(axis), -1, 3)
        axis[:, kinds.single] = self.xaxis[:, kinds.joints]
        return axis

    def jacobian(self, points: Array, body: int, dofs: NDArray[np.int64]) -> tuple[Array, Array]:
        """Return the Jacobians of one world point a frame, fixed to ``body``.

        Args:
          points: (n, 3) world points [m].
          body: the body they belong to.
          dofs: (k,) the degrees of freedom to give columns for.

        Returns:
          jacp, jacr: (n, 3, k) translation and rotation.
        """
        moves = body_dofs(self.model, body)[dofs]
        turns = moves & self.kinds.turns[dofs]
        axis = self.dof_axis[:, dofs]
        jacr = np.where(turns[:, None], axis, 0.0)
        arm = points[:, None, :] - self.xanchor[:, self.model.dof_jntid[dofs]]
        jacp = np.where(turns[:, None], cross(axis, arm), np.where(moves[:, None], axis, 0.0))
        return np.swapaxes(jacp, 1, 2), np.swapaxes(jacr, 1, 2)

    def rows(
        self, frames: NDArray[np.int64], points: Array, bodies: NDArray[np.int64], normals: Array
    ) -> Array:
        """Return ``normalᵀ J`` (m, nv) for points on bodies of single frames.

        Args:
          frames: (m,) which of the ``n`` frames each row is about.
          points: (m, 3) world points [m].
          bodies: (m,) the body of each point.
          normals: (m, 3) directions along which motion is measured.
        """
        model = self.model
        kinds, which = np.unique(bodies, return_inverse=True)
        moves = np.array([body_dofs(model, int(body)) for body in kinds]).reshape(-1, model.nv)[
            which
        ]
        axis = self.dof_axis[frames]
        arm = points[:, None, :] - self.xanchor[frames][:, model.dof_jntid]
        along = np.where(self.kinds.turns[:, None], cross(axis, arm), axis)
        return np.where(moves, np.einsum("mdi,mi->md", along, normals), 0.0)


def body_dofs(model: mujoco.MjModel, body: int) -> NDArray[np.bool_]:
    """Return (nv,) which degrees of freedom move ``body``."""
    moves = np.zeros(model.nv, dtype=bool)
    while body > 0:
        start, count = model.body_dofadr[body], model.body_dofnum[body]
        if count > 0:
            moves[start : start + count] = True
        body = int(model.body_parentid[body])
    return moves


def body_pose(
    model: mujoco.MjModel, qpos: Array, body: int, bones: Bones | None = None
) -> tuple[Array, Array]:
    """Return the world position (n, 3) and orientation (n, 4) of one body in every frame.

    Only the joints between the world and the body are visited, which for the pelvis is one. Bones
    of their own are those of the same ``n`` frames.
    """
    bones = Bones.of(model) if bones is None else bones
    path = []
    while body > 0:
        path.append(body)
        body = int(model.body_parentid[body])
    count = len(qpos)
    position = np.zeros((count, 3))
    quat = np.tile((1.0, 0.0, 0.0, 0.0), (count, 1))
    for link in reversed(path):
        position = position + rotate(
            quat, np.broadcast_to(bones.body_pos[..., link, :], (count, 3))
        )
        if not np.array_equal(model.body_quat[link], (1.0, 0.0, 0.0, 0.0)):
            quat = multiply(quat, np.broadcast_to(model.body_quat[link], (count, 4)))
        first = model.body_jntadr[link]
        for joint in range(first, first + model.body_jntnum[link]):
            pivot = bones.jnt_pos[..., joint, :]
            position, quat = _apply_joint(model, qpos, joint, pivot, position, quat)
    return position, quat


def _apply_joint(
    model: mujoco.MjModel, qpos: Array, joint: int, pivot: Array, position: Array, quat: Array
) -> tuple[Array, Array]:
    address, kind = model.jnt_qposadr[joint], model.jnt_type[joint]
    if kind == mujoco.mjtJoint.mjJNT_FREE:
        return qpos[:, address : address + 3], qpos[:, address + 3 : address + 7]
    if kind == mujoco.mjtJoint.mjJNT_SLIDE:
        travel = (qpos[:, address] - model.qpos0[address])[:, None]
        return position + rotate(quat, travel * model.jnt_axis[joint]), quat
    if kind == mujoco.mjtJoint.mjJNT_BALL:
        turn = qpos[:, address : address + 4]
    else:
        angle = (qpos[:, address] - model.qpos0[address])[:, None]
        turn = exp(angle * model.jnt_axis[joint])
    turned = multiply(quat, turn)
    if np.any(pivot):
        pivot = np.broadcast_to(pivot, position.shape)
        position = position + rotate(quat, pivot) - rotate(turned, pivot)
    return position, turned


def site_positions(
    model: mujoco.MjModel, qpos: Array, sites: NDArray[np.int64], bones: Bones | None = None
) -> Array:
    """Return the world positions (n, s, 3) [m] of a few sites.

    Cheaper than :meth:`Kinematics.forward` while the sites are on few bodies. Bones of their own
    are those of the same ``n`` frames.
    """
    bones = Bones.of(model) if bones is None else bones
    bodies = set(model.site_bodyid[sites].tolist())
    poses = {body: body_pose(model, qpos, body, bones) for body in bodies}
    return np.stack(
        [
            poses[int(model.site_bodyid[site])][0]
            + rotate(poses[int(model.site_bodyid[site])][1], bones.site_pos[..., site, :])
            for site in sites
        ],
        axis=1,
    )


def site_orientations(
    model: mujoco.MjModel, qpos: Array, sites: NDArray[np.int64], bones: Bones | None = None
) -> Array:
    """Return the world orientations (n, s, 4) wxyz of a few sites; see :func:`site_positions`."""
    bones = Bones.of(model) if bones is None else bones
    bodies = set(model.site_bodyid[sites].tolist())
    turns = {body: body_pose(model, qpos, body, bones)[1] for body in bodies}
    return np.stack(
        [
            multiply(turns[int(model.site_bodyid[site])], model.site_quat[site][None])
            for site in sites
        ],
        axis=1,
    )


class Kinematics:
    """Forward kinematics of ``nframe`` frames of one model.

    ``mj_kinematics`` on one body, frame after frame: a batch would also work out mass matrices, and
    wait for its threads, which takes longer. With ``bones`` that change, every frame gets a body of
    its own, and those are a batch.
    """

    _FIELDS = ("xpos", "xquat", "xmat", "site_xpos", "site_xmat", "xanchor", "xaxis")

    def __init__(
        self,
        model: mujoco.MjModel,
        nframe: int,
        *,
        geoms: bool = False,
        bones: Bones | None = None,
    ) -> None:
        self.model = model
        self.nframe = nframe
        self._kinds = dof_kinds(model)
        self._names = self._FIELDS + (("geom_xpos", "geom_xmat") if geoms else ())
        self._data = mujoco.MjData(model)
        self._batch = None if bones is None else _boned_batch(model, nframe, bones)

    def forward(self, qpos: Array, frames: NDArray[np.int64] | None = None) -> Pose:
        """Return where everything is.

        Args:
          qpos: (n, nq) poses: of all frames, or of ``frames``.
          frames: (n,) which of the frames they are, rising, when ``n`` is less than ``nframe``.
        """
        field = self._one_by_one(qpos) if self._batch is None else self._together(qpos, frames)
        for name in ("xmat", "site_xmat", "geom_xmat"):
            if name in field:
                field[name] = field[name].reshape(*field[name].shape[:2], 3, 3)
        return Pose(self.model, kinds=self._kinds, **field)

    def _one_by_one(self, qpos: Array) -> dict[str, Array]:
        """Return the fields of poses (n, nq) of the model's own body."""
        model, data, kinematics = self.model, self._data, mujoco.mj_kinematics
        field, pose = {}, data.qpos
        for name in self._names:
            view = getattr(data, name)
            field[name] = np.empty((len(qpos), *view.shape)), view
        both = list(field.values())
        for index, row in enumerate(qpos):  # MuJoCo takes one frame at a time
            pose[:] = row
            kinematics(model, data)
            for all_frames, this in both:
                all_frames[index] = this
        return {name: all_frames for name, (all_frames, _) in field.items()}

    def _together(self, qpos: Array, frames: NDArray[np.int64] | None) -> dict[str, Array]:
        """Return the fields of poses (n, nq), each of a body of its own."""
        assert self._batch is not None
        rows = slice(None) if frames is None else frames
        self._batch.bind("qpos")[rows] = qpos
        bound = {name: self._batch.bind(name) for name in self._names}
        self._batch.forward(ids=frames, stage=mujoco.mjtStage.mjSTAGE_POS.value)
        return {name: values[rows].copy() for name, values in bound.items()}


def _boned_batch(model: mujoco.MjModel, nframe: int, bones: Bones) -> Batch:
    """Return a batch with a body for each frame; collisions, limits and sensors are off."""
    bones.check(model, nframe)
    bare = copy.copy(model)
    flags = mujoco.mjtDisableBit
    bare.opt.disableflags |= int(
        flags.mjDSBL_CONTACT | flags.mjDSBL_CONSTRAINT | flags.mjDSBL_SENSOR
    )
    # MuJoCo takes the body's place for a site at its origin, whatever ``site_pos`` becomes.
    bare.site_sameframe[:] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE.value
    batch = Batch(bare, nframe)
    for field in dataclasses.fields(bones):
        batch.expand(field.name)[:] = getattr(bones, field.name)
    return batch


def level_side(pose: Pose) -> Array:
    """Return the root's own axis to the left, made level, at each frame (n, 3)."""
    side = pose.xmat[:, pose.model.jnt_bodyid[0], :, 1] * (1.0, 1.0, 0.0)
    return np.asarray(side / np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-9))


class RayCaster:
    """Rays against the static geoms of a model, on all cores.

    The model's own ``qpos0`` is used, so it should be a scene without a character.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self._batch = Batch(model, _RAY_CHUNK)

    def cast(self, origins: Array, directions: Array) -> tuple[Array, NDArray[np.int32], Array]:
        """Return where rays first hit.

        Args:
          origins: (n, 3) [m].
          directions: (n, 3) or (3,); distances are in units of its length.

        Returns:
          distance (n,), -1 for a miss; geom (n,), -1 for a miss; normal (n, 3), zero for a miss.
        """
        count = len(origins)
        if count == 0:
            return np.empty(0), np.empty(0, np.int32), np.empty((0, 3))
        chunk = min(_RAY_CHUNK, -(-count // _RAYS_EACH))
        per = -(-count // chunk)
        some = np.minimum(np.arange(chunk * per), count - 1)  # the last again, to fill up
        distance, geom, normal = self._batch.ray(
            origins[some].reshape(chunk, per, 3),
            np.broadcast_to(directions, origins.shape)[some].reshape(chunk, per, 3),
            ids=np.arange(chunk),
            normal=True,
        )
        distance, geom, normal = distance.ravel(), geom.ravel(), normal.reshape(-1, 3)
        return distance[:count], geom[:count], normal[:count]
