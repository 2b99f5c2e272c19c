"""Keeping the body out of walls, lintels and step sides: obstacles found in the scene.

MuJoCo's ``mj_geomDistance`` gives distance and nearest points between convex geoms; here they become
inequalities for the IK solvers, ``normalᵀ J d ≥ margin − distance``.

A lintel can be left upwards, downwards, forwards or backwards. Forwards is the shortest and the
wrong way for someone who walks on: an obstacle that cannot be stepped over is therefore drawn out
along the way the body passes it, so that the only ways left are under it or beside it, and the body
begins to duck a little before and straightens a little after.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.footholds import Foot, Foothold
from mjmotion.ik.solver import Inequalities
from mjmotion.kinematics import Kinematics, character_geoms
from mjmotion.shapes import geom_points

Array = NDArray[np.float64]

MARGIN = 0.03  # distance kept from what cannot be stepped over [m]
STEP_MARGIN = 0.006  # distance kept from steps, on which a foot and so a shin is at home [m]
DRAWN = 0.22  # how far before and after itself a tall obstacle counts [m]
STEP_HEIGHT = 0.45  # an obstacle whose top is higher over the ground cannot be stepped over [m]
_NEAR = 1.3  # an obstacle this far from the root's path is out of reach [m]
_CONVEX = (
    mujoco.mjtGeom.mjGEOM_SPHERE,
    mujoco.mjtGeom.mjGEOM_CAPSULE,
    mujoco.mjtGeom.mjGEOM_ELLIPSOID,
    mujoco.mjtGeom.mjGEOM_CYLINDER,
    mujoco.mjtGeom.mjGEOM_BOX,
    mujoco.mjtGeom.mjGEOM_MESH,
)
_CONVEX_SHARE = 0.98  # a mesh that fills this much of its hull counts as convex


@dataclasses.dataclass(frozen=True, eq=False)
class Obstacles:
    """Convex solids near a walk, as points (k, 3) of their surfaces in the world [m].

    Attributes:
      names: of the geoms they come from.
      points: one array an obstacle, drawn out where it is tall.
      tall: whether it cannot be stepped over.
    """

    names: tuple[str, ...]
    points: tuple[Array, ...]
    tall: tuple[bool, ...]


def convex_obstacles(model: mujoco.MjModel) -> NDArray[np.int64]:
    """Return the static colliding convex geoms of a scene: what a body could be inside of.

    Planes and heightfields are ground, and so is a mesh that is not convex, since MuJoCo would take
    its hull for it.
    """
    static = model.body_weldid[model.geom_bodyid] == 0
    solid = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    convex = np.isin(model.geom_type, [int(kind) for kind in _CONVEX])
    chosen = np.flatnonzero(static & solid & convex)
    return np.array([geom for geom in chosen if _fills_hull(model, int(geom))], dtype=np.int64)


def _fills_hull(model: mujoco.MjModel, geom: int) -> bool:
    if model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_MESH:
        return True
    from scipy.spatial import ConvexHull, QhullError

    mesh = model.geom_dataid[geom]
    start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    vertices = np.asarray(model.mesh_vert[start : start + count], dtype=np.float64)
    start, count = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
    corners = vertices[model.mesh_face[start : start + count]]
    volume = abs(np.einsum("fi,fi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))) / 6.0
    try:
        return bool(volume >= _CONVEX_SHARE * ConvexHull(vertices).volume)
    except QhullError:
        return False


def find_obstacles(
    scene: mujoco.MjModel, root_path: Array, footholds: Sequence[Foothold]
) -> Obstacles:
    """Return the obstacles within reach of a walk.

    Args:
      scene: the scene alone.
      root_path: (nframe, 3) where the root will pass, about [m].
      footholds: what it will stand on.
    """
    geoms = convex_obstacles(scene)
    data = mujoco.MjData(scene)
    mujoco.mj_kinematics(scene, data)
    names, points, tall = [], [], []
    way = np.gradient(root_path[:, :2], axis=0) if len(root_path) > 1 else np.ones((1, 2))
    stands = np.array([foothold.position for foothold in footholds]).reshape(-1, 3)
    for geom in geoms:
        matrix = data.geom_xmat[geom].reshape(3, 3)
        surface = geom_points(scene, int(geom)) @ matrix.T + data.geom_xpos[geom]
        low, high = surface.min(axis=0), surface.max(axis=0)
        gap = np.maximum(0.0, np.maximum(low[:2] - root_path[:, :2], root_path[:, :2] - high[:2]))
        distance = np.hypot(gap[:, 0], gap[:, 1])
        nearest = int(np.argmin(distance))
        if distance[nearest] > _NEAR:
            continue
        apart = np.maximum(0.0, np.maximum(low - stands, stands - high))[:, :2]
        ground = stands[np.argmin(np.hypot(apart[:, 0], apart[:, 1])), 2] if len(stands) else 0.0
        tall.append(bool(high[2] - ground > STEP_HEIGHT))
        if tall[-1]:
            close = distance < distance[nearest] + 0.3
            along = way[close].sum(axis=0)
            along = along / max(float(np.linalg.norm(along)), 1e-9)
            drawn = DRAWN * np.array((*along, 0.0))
            surface = np.concatenate((surface - drawn, surface + drawn))
        names.append(scene.geom(int(geom)).name or f"geom {geom}")
        points.append(surface)
    return Obstacles(tuple(names), tuple(points), tuple(tall))


class ObstacleClearance:
    """Inequalities that keep a character out of obstacles; see :class:`mjmotion.ik.solver.Clearance`.

    Args:
      character: the character alone.
      obstacles: what to keep out of.
      feet: their bodies are left out, the ground being theirs to stand on.
      nframe: most frames that will be asked for.
      margin: distance to keep [m].
    """

    def __init__(
        self,
        character: mujoco.MjSpec,
        obstacles: Obstacles,
        feet: Sequence[Foot],
        nframe: int,
        margin: float = MARGIN,
    ) -> None:
        self.obstacles = obstacles
        self.margin = margin
        self._tall = np.array(obstacles.tall, dtype=bool)
        spec = character.copy()
        for number, points in enumerate(obstacles.points):
            name = f"mjmotion_obstacle_{number}"
            spec.add_mesh(name=name, uservert=points.ravel().tolist())
            spec.worldbody.add_geom(
                name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, contype=0, conaffinity=0
            )
        self.model = spec.compile()
        self._data = mujoco.MjData(self.model)
        mujoco.mj_kinematics(self.model, self._data)
        self._kinematics = Kinematics(self.model, nframe, geoms=True)
        foot_bodies = {foot.body for foot in feet}
        self.geoms = np.array(
            [
                geom
                for geom in character_geoms(self.model, colliding=True)
                if int(self.model.geom_bodyid[geom]) not in foot_bodies
            ],
            dtype=np.int64,
        )
        self._walls = np.array(
            [self.model.geom(f"mjmotion_obstacle_{n}").id for n in range(len(obstacles.points))],
            dtype=np.int64,
        )
        self._low = np.array([points.min(axis=0) for points in obstacles.points]).reshape(-1, 3)
        self._high = np.array([points.max(axis=0) for points in obstacles.points]).reshape(-1, 3)
        self._reach = float(np.linalg.norm(self.model.stat.extent)) + 1.0

    def __call__(self, qpos: Array, frames: NDArray[np.int64]) -> Inequalities:
        """Return what poses (n, nq) lack of the margin; ``frames`` says nothing more here."""
        if len(self._walls) == 0 or len(qpos) == 0:
            return self._nothing()
        rows = np.arange(len(qpos))
        near = self._near_root(qpos)
        if not near.any():
            return self._nothing()
        rows = rows[near]
        pose = self._kinematics.forward(qpos[rows], rows)
        assert pose.geom_xpos is not None and pose.geom_xmat is not None
        frame, geom, wall = self._close_pairs(pose.geom_xpos)
        distance, ends = self._distances(pose.geom_xpos, pose.geom_xmat, frame, geom, wall)
        margin = self._margins[wall]
        lacking = distance < margin
        margin = margin[lacking]
        frame, geom, distance = frame[lacking], geom[lacking], distance[lacking]
        body_end, wall_end = ends[lacking, 0], ends[lacking, 1]
        apart = np.where(distance[:, None] >= 0.0, body_end - wall_end, wall_end - body_end)
        length = np.linalg.norm(apart, axis=1, keepdims=True)
        known = length[:, 0] > 1e-6
        normal = apart[known] / length[known]
        bodies = self.model.geom_bodyid[geom[known]]
        jacobian = pose.rows(frame[known], body_end[known], bodies, normal)
        needed = (margin - distance)[known]
        return Inequalities(rows[frame[known]], jacobian, needed, distance[known])

    def _nothing(self) -> Inequalities:
        return Inequalities(
            np.empty(0, np.int64), np.empty((0, self.model.nv)), np.empty(0), np.empty(0)
        )

    @property
    def _margins(self) -> Array:
        return np.where(self._tall, self.margin, STEP_MARGIN)

    def _near_root(self, qpos: Array) -> NDArray[np.bool_]:
        """Frames whose root is within a body's length of some obstacle."""
        root = qpos[:, None, :3]
        gap = np.maximum(0.0, np.maximum(self._low - root, root - self._high))
        return np.asarray((np.linalg.norm(gap, axis=-1) < _NEAR).any(axis=1))

    def _close_pairs(
        self, geom_xpos: Array
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """Frame, geom and obstacle number of pairs whose bounding shapes come within the margin."""
        centre = geom_xpos[:, self.geoms, None]
        gap = np.maximum(0.0, np.maximum(self._low - centre, centre - self._high))
        bound = self.model.geom_rbound[self.geoms][None, :, None] + self._margins
        frame, geom, wall = np.nonzero(np.einsum("fgoi,fgoi->fgo", gap, gap) < bound * bound)
        return frame, self.geoms[geom], wall

    def _distances(
        self,
        geom_xpos: Array,
        geom_xmat: Array,
        frame: NDArray[np.int64],
        geom: NDArray[np.int64],
        wall: NDArray[np.int64],
    ) -> tuple[Array, Array]:
        """Signed distances (m,) and nearest points (m, 2, 3): on the body, on the obstacle."""
        distance = np.empty(len(frame))
        ends = np.zeros((len(frame), 6))
        data, model, limit = self._data, self.model, self.margin + 0.01
        last = -1
        mine = character_geoms(model)
        # MuJoCo measures one pair a call; the pairs left here are few.
        for number in range(len(frame)):
            if frame[number] != last:
                last = frame[number]
                data.geom_xpos[mine] = geom_xpos[last, mine]
                data.geom_xmat[mine] = geom_xmat[last, mine].reshape(-1, 9)
            distance[number] = mujoco.mj_geomDistance(
                model, data, int(geom[number]), int(self._walls[wall[number]]), limit, ends[number]
            )
        return distance, ends.reshape(-1, 2, 3)
