"""Keeping the body out of walls, lintels and step sides: obstacles found in the scene.

MuJoCo's ``mj_geomDistance`` gives distance and nearest points between convex geoms; here they
become inequalities for the IK solvers, ``normalᵀ J d ≥ margin − distance``.

A lintel can be left upwards, downwards, forwards or backwards. Forwards is the shortest and the
wrong way for someone who walks on: an obstacle that cannot be stepped over is therefore drawn out
along the way where the body passes it, and one that hangs overhead upwards too. The ways left are
under it or beside it, and the body begins to duck a little before and straightens a little after.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Collection, Iterator, Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.character import Character
from mjmotion.body.geom_points import geom_points
from mjmotion.body.kinematics import Kinematics, Pose, character_geoms
from mjmotion.footsteps.footholds import Foothold
from mjmotion.footsteps.mesh_pieces import mesh_pieces
from mjmotion.ik.solver import Inequalities
from mjmotion.route.shapes import hull, outline_distance
from mjmotion.scene.hulls import fills_hull

Array = NDArray[np.float64]

MARGIN = 0.02  # distance kept from what cannot be stepped over [m]
STEP_MARGIN = 0.006  # distance kept from steps, on which a foot and so a shin is at home [m]
DRAWN = 0.22  # how far before and after itself a tall obstacle counts [m]
STEP_HEIGHT = 0.45  # an obstacle whose top is higher over the ground cannot be stepped over [m]
ON_TOP = 0.02  # a foothold this close to an obstacle's box stands on it [m]
OVERHEAD = 0.8  # an obstacle whose bottom is higher is passed under, never over [m]
LONG = 2.0  # how far a tall obstacle is drawn out, so that its ends are out of the way [m]
RAISED = 1.0  # how much higher such an obstacle is taken to be [m]
_ABREAST = 0.5**0.5  # cosine to the way of what is beside it, where it is nearest
_ROOM = 0.2  # half of what a trunk takes up [m]
_NEAR = 1.3  # an obstacle this far from the root's path is out of reach [m]
_ROUNDING = 1e-9  # by which a first, coarse look is wider than the close one [m]
_CONVEX = (
    mujoco.mjtGeom.mjGEOM_SPHERE,
    mujoco.mjtGeom.mjGEOM_CAPSULE,
    mujoco.mjtGeom.mjGEOM_ELLIPSOID,
    mujoco.mjtGeom.mjGEOM_CYLINDER,
    mujoco.mjtGeom.mjGEOM_BOX,
    mujoco.mjtGeom.mjGEOM_MESH,
)


@dataclasses.dataclass(frozen=True, eq=False)
class Obstacle:
    """One convex solid near a walk, as points (k, 3) in the world [m].

    Attributes:
      name: of the geom it comes from.
      points: its surface.
      drawn: the same, where it is tall drawn out upwards, and far along ``along`` if it is passed;
        else equal.
      along: (3,) the way the body passes it; zero where it is not tall.
      span: from where to where along ``along`` the drawn shape counts [m].
    """

    name: str
    points: Array
    drawn: Array
    along: Array
    span: tuple[float, float]

    @property
    def overhead(self) -> bool:
        """Whether it is passed under, never over: it is drawn out upwards too."""
        return self.tall and len(self.drawn) > 2 * len(self.points)

    @property
    def tall(self) -> bool:
        """Whether it cannot be stepped over."""
        return bool(self.along.any())


def convex_obstacles(model: mujoco.MjModel) -> NDArray[np.int64]:
    """Return the ids of a scene's obstacles: the solids that a body could be inside of.

    They are by the rule of ``docs/figures.md``, "What is solid": geoms that do not move and collide
    with anything, of a convex kind. Planes and heightfields are ground alone, and so is a mesh that
    is not convex, since MuJoCo would take its hull for it.
    """
    static = model.body_weldid[model.geom_bodyid] == 0
    solid = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    convex = np.isin(model.geom_type, [int(kind) for kind in _CONVEX])
    chosen = np.flatnonzero(static & solid & convex)
    return np.array([geom for geom in chosen if _fills_hull(model, int(geom))], dtype=np.int64)


def _fills_hull(model: mujoco.MjModel, geom: int) -> bool:
    """Whether a geom is its own convex hull: any but a mesh with pits, passages or open sides."""
    if model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_MESH:
        return True
    mesh = model.geom_dataid[geom]
    start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    vertices = np.asarray(model.mesh_vert[start : start + count], dtype=np.float64)
    start, count = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
    return fills_hull(vertices[model.mesh_face[start : start + count]])


def find_obstacles(
    scene: mujoco.MjModel, root_path: Array, footholds: Sequence[Foothold]
) -> tuple[Obstacle, ...]:
    """Return the obstacles within reach of a walk.

    Args:
      scene: the scene alone.
      root_path: (nframe, 3) where the root will pass, about [m].
      footholds: what it will stand on.
    """
    found = []
    way = np.gradient(root_path, axis=0) if len(root_path) > 1 else np.ones((1, 3))
    stands = np.array([foothold.position for foothold in footholds]).reshape(-1, 3)
    for geom, surface in _convex_shapes(scene, root_path):
        low, high = surface.min(axis=0), surface.max(axis=0)
        gap = np.maximum(0.0, np.maximum(low[:2] - root_path[:, :2], root_path[:, :2] - high[:2]))
        distance = np.hypot(gap[:, 0], gap[:, 1])
        nearest = int(np.argmin(distance))
        if distance[nearest] > _NEAR:
            continue
        apart = np.maximum(0.0, np.maximum(low - stands, stands - high))[:, :2]
        ground = stands[np.argmin(np.hypot(apart[:, 0], apart[:, 1])), 2] if len(stands) else 0.0
        drawn, direction, span = surface, np.zeros(3), (-np.inf, np.inf)
        stood_on = ((stands > low - ON_TOP) & (stands < high + ON_TOP)).all(axis=1).any()
        if high[2] - ground > STEP_HEIGHT and not stood_on:
            close = distance < distance[nearest] + 0.4
            heading = way[close].sum(axis=0)
            direction = heading / max(float(np.linalg.norm(heading)), 1e-9)
            along = surface @ direction
            span = (float(along.min()) - DRAWN, float(along.max()) + DRAWN)
            # What is ahead of where a walk ends, or behind where it begins, is not passed: drawn
            # out it would be where the body is.
            towards = np.clip(root_path[nearest], low, high)[:2] - root_path[nearest, :2]
            passed = abs(towards @ direction[:2]) <= _ABREAST * distance[nearest]
            out = LONG * passed * direction
            overhead = low[2] - ground > OVERHEAD
            if not overhead and _in_the_way(surface, out, root_path, span):
                out = np.zeros(3)
            drawn = np.concatenate((surface - out, surface + out))
            if overhead:
                drawn = np.concatenate((drawn, drawn + (0.0, 0.0, RAISED)))
        name = scene.geom(int(geom)).name or f"geom {geom}"
        found.append(Obstacle(name, surface, drawn, direction, span))
    return tuple(found)


def _in_the_way(surface: Array, out: Array, root_path: Array, span: tuple[float, float]) -> bool:
    """Whether a solid drawn out would be where the root passes, and as it is would not.

    That is so of a wall round a corner: the way past it is not one way.

    Args:
      surface: (k, 3) its points [m].
      out: (3,) how far it is drawn out, either way [m].
      root_path: (nframe, 3) where the root passes [m].
      span: from where to where along the way it counts [m].
    """
    along = root_path @ (out / max(float(np.linalg.norm(out)), 1e-9))
    path = root_path[(along > span[0]) & (along < span[1]), :2]
    if not out.any() or len(path) == 0:
        return False
    flat = surface[:, :2]
    drawn = outline_distance(hull(np.concatenate((flat - out[:2], flat + out[:2]))), path)
    narrow = drawn < _ROOM
    return bool((outline_distance(hull(flat), path)[narrow] > drawn[narrow] + ON_TOP).any())


def _convex_shapes(scene: mujoco.MjModel, root_path: Array) -> Iterator[tuple[int, Array]]:
    """Yield geoms with points (k, 3) [m] of the convex solids that they are, or are made of.

    Those that are out of reach of the root's path are left out.
    """
    data = mujoco.MjData(scene)
    mujoco.mj_kinematics(scene, data)
    convex = convex_obstacles(scene)
    solid = (scene.geom_contype != 0) | (scene.geom_conaffinity != 0)
    hollow = solid & (scene.body_weldid[scene.geom_bodyid] == 0)
    hollow &= scene.geom_type == mujoco.mjtGeom.mjGEOM_MESH
    hollow[convex] = False
    low, high = root_path[:, :2].min(axis=0), root_path[:, :2].max(axis=0)
    gap = np.maximum(0.0, np.maximum(low - data.geom_xpos[:, :2], data.geom_xpos[:, :2] - high))
    near = np.hypot(gap[:, 0], gap[:, 1]) < (_NEAR + scene.geom_rbound) * (1.0 + 1e-6)
    for geom in sorted([*convex[near[convex]].tolist(), *np.flatnonzero(hollow & near).tolist()]):
        placed = np.array(data.geom_xpos[geom]), data.geom_xmat[geom].reshape(3, 3)
        if hollow[geom]:
            yield from ((geom, p) for p in mesh_pieces(scene, geom, placed, root_path, _NEAR))
        else:
            yield geom, geom_points(scene, geom) @ placed[1].T + placed[0]


class ObstacleClearance:
    """Inequalities that keep a character out of obstacles (:class:`mjmotion.ik.solver.Clearance`).

    Args:
      character: the character, alone. Its feet are left out: the ground is theirs to stand on.
      obstacles: what to keep out of.
      nframe: most frames that will be asked for.
      margin: distance to keep [m].
    """

    def __init__(
        self,
        character: Character,
        obstacles: Sequence[Obstacle],
        nframe: int,
        margin: float = MARGIN,
    ) -> None:
        self.obstacles = tuple(obstacles)
        self.margin = margin
        self._tall = np.array([obstacle.tall for obstacle in obstacles], dtype=bool)
        self._counts = np.ones(len(obstacles), dtype=bool)
        self._along = np.array([obstacle.along for obstacle in obstacles]).reshape(-1, 3)
        self._span = np.array([obstacle.span for obstacle in obstacles]).reshape(-1, 2)
        spec = character.spec.copy()
        for kind in ("drawn", "points"):
            for number, obstacle in enumerate(obstacles):
                name = _wall_name(kind, number)
                spec.add_mesh(name=name, uservert=getattr(obstacle, kind).ravel().tolist())
                geom = spec.worldbody.add_geom(name=name, meshname=name)
                geom.type = mujoco.mjtGeom.mjGEOM_MESH
                geom.contype = geom.conaffinity = 0
        self.model = spec.compile()
        self._data = mujoco.MjData(self.model)
        mujoco.mj_kinematics(self.model, self._data)
        self._kinematics = Kinematics(self.model, nframe, geoms=True)
        foot_bodies = {body for foot in character.feet for body in foot.bodies}
        self._mine = character_geoms(self.model)
        self._geoms = np.array(
            [
                geom
                for geom in character_geoms(self.model, colliding=True)
                if int(self.model.geom_bodyid[geom]) not in foot_bodies
            ],
            dtype=np.int64,
        )
        self._walls = {
            kind: np.array(
                [self.model.geom(_wall_name(kind, n)).id for n in range(len(obstacles))], np.int64
            )
            for kind in ("drawn", "points")
        }
        # Boxes around what counts of each obstacle: its own shape, and as much as it is drawn.
        reach = DRAWN * np.abs(self._along)
        top = [o.drawn[:, 2].max() for o in obstacles]
        self._low = np.array([o.points.min(axis=0) for o in obstacles]).reshape(-1, 3) - reach
        self._high = np.array([o.points.max(axis=0) for o in obstacles]).reshape(-1, 3) + reach
        self._high[:, 2] = top

    def at_margin(self, margin: float) -> ObstacleClearance:
        """Return the same with another distance kept from what cannot be stepped over [m]."""
        wider = copy.copy(self)
        wider.margin = margin
        return wider

    def of(self, bodies: Collection[int]) -> ObstacleClearance:
        """Return the same for some of the character's bodies alone."""
        some = copy.copy(self)
        some._geoms = self._geoms[np.isin(self.model.geom_bodyid[self._geoms], list(bodies))]
        return some

    def overhead(self) -> ObstacleClearance:
        """Return the same of those obstacles alone that are passed under."""
        some = copy.copy(self)
        some._counts = np.array([obstacle.overhead for obstacle in self.obstacles], dtype=bool)
        return some

    def __call__(self, qpos: Array, frames: NDArray[np.int64]) -> Inequalities:
        """Return what poses (n, nq) lack of the margin; ``frames`` says nothing more here."""
        rows = np.flatnonzero(self._near_root(qpos))
        if len(rows) == 0:
            return self._nothing()
        pose, frame, geom, wall = self._pairs(qpos, rows)
        distance, ends = self._distances(pose, frame, geom, self._walls["drawn"][wall])
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

    def inside(self, qpos: Array) -> tuple[Array, NDArray[np.int64], tuple[str, ...]]:
        """Return how deep bodies are in the true obstacles: depths (m,) [m], frames (m,), names."""
        rows = np.flatnonzero(self._near_root(qpos))
        if len(rows) == 0:
            return np.empty(0), np.empty(0, np.int64), ()
        pose, frame, geom, wall = self._pairs(qpos, rows)
        distance, _ = self._distances(pose, frame, geom, self._walls["points"][wall])
        bad = distance < 0.0
        return -distance[bad], rows[frame[bad]], tuple(self.obstacles[w].name for w in wall[bad])

    def _pairs(
        self, qpos: Array, rows: NDArray[np.int64]
    ) -> tuple[Pose, NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        pose = self._kinematics.forward(qpos[rows], rows)
        assert pose.geom_xpos is not None
        return pose, *self._close_pairs(pose.geom_xpos)

    def _nothing(self) -> Inequalities:
        return Inequalities(
            np.empty(0, np.int64), np.empty((0, self.model.nv)), np.empty(0), np.empty(0)
        )

    @property
    def _margins(self) -> Array:
        return np.where(self._tall, self.margin, STEP_MARGIN)

    def _near_root(self, qpos: Array) -> NDArray[np.bool_]:
        """Frames whose root is within a body's length of some obstacle."""
        if len(self.obstacles) == 0:
            return np.zeros(len(qpos), dtype=bool)
        root = qpos[:, None, :3]
        gap = np.maximum(0.0, np.maximum(self._low - root, root - self._high))
        return np.asarray((np.linalg.norm(gap, axis=-1) < _NEAR).any(axis=1))

    def _close_pairs(
        self, geom_xpos: Array
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """Frame, geom and obstacle number of pairs whose bounding shapes come within the margin."""
        walls = np.flatnonzero(self._counts)
        low, high, margin = self._low[walls], self._high[walls], self._margins[walls]
        centre = geom_xpos[:, self._geoms]
        radius = self.model.geom_rbound[self._geoms]
        # The whole body first: most obstacles are far from all of it.
        first = (centre - radius[:, None]).min(axis=1)[:, None]
        last = (centre + radius[:, None]).max(axis=1)[:, None]
        room = margin[:, None] + _ROUNDING
        frame, wall = np.nonzero(((first <= high + room) & (last >= low - room)).all(axis=2))
        place = centre[frame]
        gap = np.maximum(low[wall, None] - place, place - high[wall, None])
        gap = np.maximum(0.0, gap)
        bound = radius + margin[wall, None]
        pair, geom = np.nonzero(np.einsum("pgi,pgi->pg", gap, gap) < bound * bound)
        frame, wall = frame[pair], walls[wall[pair]]
        order = np.lexsort((wall, geom, frame))
        frame, geom, wall = frame[order], geom[order], wall[order]
        passed = np.einsum("mi,mi->m", geom_xpos[frame, self._geoms[geom]], self._along[wall])
        level = (passed > self._span[wall, 0]) & (passed < self._span[wall, 1])
        return frame[level], self._geoms[geom[level]], wall[level]

    def _distances(
        self,
        pose: Pose,
        frame: NDArray[np.int64],
        geom: NDArray[np.int64],
        wall: NDArray[np.int64],
    ) -> tuple[Array, Array]:
        """Signed distances (m,) and nearest points (m, 2, 3): on the body, on the obstacle."""
        assert pose.geom_xpos is not None and pose.geom_xmat is not None
        distance = np.empty(len(frame))
        ends = np.zeros((len(frame), 6))
        data, model, mine, limit = self._data, self.model, self._mine, self.margin + 0.01
        last = -1
        # MuJoCo measures one pair a call; the pairs left here are few.
        pairs = zip(frame.tolist(), geom.tolist(), wall.tolist(), strict=True)
        for number, (row, body_geom, wall_geom) in enumerate(pairs):
            if row != last:
                last = row
                data.geom_xpos[mine] = pose.geom_xpos[row, mine]
                data.geom_xmat[mine] = pose.geom_xmat[row, mine].reshape(-1, 9)
            distance[number] = mujoco.mj_geomDistance(
                model, data, body_geom, wall_geom, limit, ends[number]
            )
        return distance, ends.reshape(-1, 2, 3)


def _wall_name(kind: str, number: int) -> str:
    return f"mjmotion_{kind}_{number}"
