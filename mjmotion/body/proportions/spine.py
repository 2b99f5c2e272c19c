"""A spine of three segments that share the three degrees of freedom of one ball joint (§4.2).

    character = flexible_spine("humanoid")

The torso's one body becomes lower back, middle back and chest, one above the other, with the arms
and the neck on the chest. Their ball joints turn by given shares of one rotation vector ``w``:
joint i is ``exp(share_i · w)``, which the tuple ``couple_spine`` says. At rest the body has the
shape, mass, centre of mass and inertia that it had.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.character import Character, CharacterLike
from mjmotion.body.proportions.frames import BodyFrame
from mjmotion.body.proportions.shaping import inertia_of, moments, nearest_axes
from mjmotion.exceptions import ModelError
from mjmotion.numerics.rotations import from_matrix, to_matrix

Array = NDArray[np.float64]

BODIES = ("lower_back", "middle_back", "chest")
JOINTS = ("spine_lower", "spine_middle", "spine_upper")
COUPLE = "couple_spine"
_PLACES = (0.0, 0.27, 0.54)  # of the joints, as shares of the shoulders' height over the first
_OVERLAP = 0.08  # how far a segment reaches into the next, in the same measure
_TAPER = 0.9  # how much narrower it ends there, so that no edge shows when the spine bends
_MOVED = "moved/"
# Lists of a spec whose elements have names or refer to others, and where they say so.
_NAMED = (
    *("bodies", "joints", "geoms", "sites", "cameras", "lights", "frames", "excludes", "pairs"),
    *("tuples", "sensors", "actuators", "equalities", "tendons", "keys", "numerics", "texts"),
)
_REFERRING = (
    *("name", "objname", "refname", "name1", "name2", "bodyname1", "bodyname2"),
    *("geomname1", "geomname2", "target", "refsite", "slidersite", "targetbody"),
)


def flexible_spine(
    source: CharacterLike,
    shares: Sequence[float] = (1 / 3, 1 / 3, 1 / 3),
    joint: str = "spine",
) -> Character:
    """Return a humanoid whose spine is three segments in the place of one.

    Args:
      source: a humanoid whose torso hangs on one ball joint, or what names one; it is not changed.
      shares: of the spine's turn, from the lowest joint up; positive, with sum 1.
      joint: name of that joint.

    Raises:
      ModelError: shares that are not three positive numbers of sum 1, no such ball joint, or a
        torso that carries nothing to put on a chest.
    """
    share = np.array(shares, dtype=np.float64)
    if (
        share.shape != (3,)
        or not (share > 0).all()
        or not math.isclose(share.sum(), 1, abs_tol=1e-9)
    ):
        raise ModelError(f"shares {tuple(shares)} of the spine must be three, positive, of sum 1")
    character = Character.of(source)
    spec = character.spec.copy()
    old: Any = spec.joint(joint)
    if old is None or old.type != mujoco.mjtJoint.mjJNT_BALL:
        raise ModelError(f"the model has no ball joint '{joint}' to divide: name the spine's joint")
    torso, range_ = old.parent, np.array(old.range)
    model = spec.compile()
    index = torso.id
    carried = [model.body_pos[child, 2] for child in np.flatnonzero(model.body_parentid == index)]
    if not carried or max(carried) <= 0.0:
        raise ModelError(f"body '{torso.name}' carries nothing above it: it is no torso")
    # The arms hang lowest of what a torso carries; the neck is above them.
    heights = np.array(_PLACES) * min(height for height in carried if height > 0.0)
    segments = _Segments(spec, model, index, heights)
    parent = torso.parent
    later = [b for b in parent.bodies if b.id > index]
    lower = parent.add_body(name=BODIES[0], pos=torso.pos, quat=torso.quat)
    middle = lower.add_body(name=BODIES[1], pos=(0.0, 0.0, heights[1]))
    chest = _move(spec, torso, middle, (0.0, 0.0, heights[2] - heights[1]))
    for body in later:
        _move(spec, body, parent)  # so that the joints keep their order
    _without_prefix(spec)
    chest.name = BODIES[2]
    _lower(chest, heights[2])
    moved = next(j for j in chest.joints if j.name == joint)
    _joints(spec, moved, (lower, middle), share, range_)
    segments.put((lower, middle, chest))
    spec.add_tuple(
        name=COUPLE,
        objname=list(JOINTS),
        objtype=[mujoco.mjtObj.mjOBJ_JOINT] * 3,
        objprm=share.tolist(),
    )
    return Character(spec.compile(), spec, character.name)


def _move(spec: mujoco.MjSpec, body: Any, parent: Any, pos: Sequence[float] | None = None) -> Any:
    """Hang a body with all that it carries elsewhere; names get a prefix that has to go again."""
    spec.copy_during_attach = True
    moved = parent.add_frame().attach_body(body, _MOVED, "")
    spec.delete(body)
    if pos is not None:
        moved.pos, moved.quat = pos, (1.0, 0.0, 0.0, 0.0)
    return moved


def _without_prefix(spec: mujoco.MjSpec) -> None:
    """Take the prefix of moved elements off all names and references."""
    for kind in _NAMED:
        for element in getattr(spec, kind):
            for word in _REFERRING:
                value = getattr(element, word, None)
                if isinstance(value, str) and value.startswith(_MOVED):
                    setattr(element, word, value.removeprefix(_MOVED))
    for group in spec.tuples:
        group.objname = [str(name).removeprefix(_MOVED) for name in group.objname]


def _lower(chest: Any, height: float) -> None:
    """Keep what is in the chest where it was, though the body's origin is higher now."""
    down = np.array((0.0, 0.0, -height))
    for element in (*chest.bodies, *chest.geoms, *chest.sites, *chest.cameras, *chest.lights):
        frame = BodyFrame(element)
        ends = np.array(getattr(element, "fromto", (np.nan,)))
        if np.isfinite(ends[0]):
            ends = np.array([frame.to_body(end) + down for end in ends.reshape(2, 3)])
            element.fromto = np.concatenate([frame.from_body(end) for end in ends])
        else:
            element.pos = frame.from_body(frame.to_body(element.pos) + down)


def _joints(
    spec: mujoco.MjSpec, old: Any, below: Sequence[Any], share: Array, range_: Array
) -> None:
    """Give every segment its ball joint, with its share of the range and of the custom limits."""
    custom = next((n for n in spec.numerics if n.name == f"limit_{old.name}"), None)
    ball = mujoco.mjtJoint.mjJNT_BALL
    joints = [body.add_joint(type=ball, limited=old.limited) for body in below] + [old]
    for joint, name, part in zip(joints, JOINTS, share, strict=True):
        joint.name, joint.range = name, range_ * part
        if custom is not None:
            limits = (np.array(custom.data) * part).tolist()
            spec.add_numeric(name=f"limit_{name}", data=limits, size=len(limits))
    if custom is not None:
        spec.delete(custom)


class _Segments:
    """The torso's shapes and inertia, cut at the joints."""

    def __init__(
        self, spec: mujoco.MjSpec, model: mujoco.MjModel, torso: int, heights: Array
    ) -> None:
        self._spec, self._heights = spec, heights
        step = heights[1] / _PLACES[1]
        self._overlap = _OVERLAP * step
        self._hulls = {}
        for geom in np.flatnonzero(model.geom_bodyid == torso):
            if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
                mesh = model.geom_dataid[geom]
                start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
                points = model.mesh_vert[start : start + count].astype(np.float64)
                turn = to_matrix(model.geom_quat[geom])
                self._hulls[model.geom(geom).name] = points @ turn.T + model.geom_pos[geom]
        if not self._hulls:
            raise ModelError("the torso has no mesh to divide: give one of our humanoids")
        self._mass = float(model.body_mass[torso])
        self._com = model.body_ipos[torso].copy()
        turn = to_matrix(model.body_iquat[torso])
        self._inertia = turn @ np.diag(model.body_inertia[torso]) @ turn.T

    def put(self, bodies: Sequence[Any]) -> None:
        """Give each segment its part of every mesh, and its mass."""
        chest = bodies[2]
        for geom in list(chest.geoms):
            if geom.name not in self._hulls:
                continue
            for body, low, high in self._slabs(bodies):
                local = (0.0, 0.0, self._heights[bodies.index(body)])
                points = _slab(self._hulls[geom.name], low, high, self._overlap) - local
                name = f"{geom.meshname}_{body.name}"
                own = geom
                if body is not chest:
                    own = body.add_geom(self._spec.find_default(geom.classname.name))
                    own.name = f"{geom.name}_{body.name}"
                    own.type, own.material = geom.type, geom.material
                mesh = self._spec.add_mesh(name=name, smoothnormal=True)
                mesh.uservert = np.round(points, 5).ravel()
                own.meshname, own.pos, own.quat = name, (0, 0, 0), (1, 0, 0, 0)
        used = {geom.meshname for geom in self._spec.geoms}
        for mesh in [mesh for mesh in self._spec.meshes if mesh.name not in used]:
            self._spec.delete(mesh)
        self._share_mass(bodies)

    def _slabs(self, bodies: Sequence[Any]) -> list[tuple[Any, float, float]]:
        cuts = [-np.inf, *self._heights[1:], np.inf]
        return [(body, cuts[i], cuts[i + 1]) for i, body in enumerate(bodies)]

    def _share_mass(self, bodies: Sequence[Any]) -> None:
        """Masses by volume, their places such that the whole has the torso's mass and moments.

        Uniform density gets centre and second moments a little wrong: the linear map that puts
        them right (the optimal transport between Gaussians of these moments) moves every part.
        """
        largest = max(self._hulls.values(), key=lambda points: float(np.ptp(points, axis=0).prod()))
        solid = mujoco.MjSpec()
        for i, (_, low, high) in enumerate(self._slabs(bodies)):
            mesh = solid.add_mesh(name=f"m{i}", uservert=_slab(largest, low, high, 0.0).ravel())
            body = solid.worldbody.add_body()
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh.name)
        parts = solid.compile()
        share = parts.body_mass[1:] / parts.body_mass[1:].sum()
        turn = to_matrix(parts.body_iquat[1:])
        own = np.einsum("nij,nj,nkj->nik", turn, parts.body_inertia[1:], turn)
        own = moments(own) / parts.body_mass[1:, None, None]
        com = parts.body_ipos[1:]
        arm = com - share @ com
        spread = np.einsum("n,nij->ij", share, own + np.einsum("ni,nj->nij", arm, arm))
        put_right = _transport(spread, moments(self._inertia) / self._mass)
        for i, body in enumerate(bodies):
            mass = float(share[i]) * self._mass
            inertia = inertia_of(mass * put_right @ own[i] @ put_right.T)
            turn = nearest_axes(inertia, np.eye(3))
            body.explicitinertial = True
            body.mass, body.fullinertia = mass, np.full(6, np.nan)
            body.ipos = self._com + put_right @ arm[i] - (0.0, 0.0, self._heights[i])
            body.iquat, body.inertia = from_matrix(turn), np.diag(turn.T @ inertia @ turn)


def _transport(source: Array, target: Array) -> Array:
    """Return the symmetric map ``A`` with ``A source A = target``, both positive definite."""
    root = _root(source)
    back = np.linalg.inv(root)
    return np.asarray(back @ _root(root @ target @ root) @ back)


def _root(matrix: Array) -> Array:
    values, vectors = np.linalg.eigh(matrix)
    return np.asarray(vectors * np.sqrt(values) @ vectors.T)


def _slab(points: Array, low: float, high: float, overlap: float) -> Array:
    """Corners (k, 3) of the part of a convex hull between two heights, a little longer and tapered.

    Where the hull goes on beyond a cut, the part reaches ``overlap`` further and narrows there.
    """
    from scipy.spatial import ConvexHull

    hull = ConvexHull(points)
    edges = np.unique(
        np.sort(np.concatenate([hull.simplices[:, p] for p in ((0, 1), (1, 2), (2, 0))]), axis=1),
        axis=0,
    )
    corners = points[hull.vertices]
    kept = [corners[(corners[:, 2] >= low) & (corners[:, 2] <= high)]]
    for cut, way in ((low, -1.0), (high, 1.0)):
        if not np.isfinite(cut):
            continue
        kept.append(_section(points, edges, cut))
        if overlap > 0.0:
            rim = _section(points, edges, cut + way * overlap)
            centre = rim.mean(axis=0) * (1.0, 1.0, 0.0)
            kept.append((rim - centre) * (_TAPER, _TAPER, 1.0) + centre)
    return np.concatenate(kept)


def _section(points: Array, edges: NDArray[np.int64], height: float) -> Array:
    """Where the edges of a hull cross a height (k, 3)."""
    a, b = points[edges[:, 0]], points[edges[:, 1]]
    crossing = (a[:, 2] - height) * (b[:, 2] - height) < 0.0
    a, b = a[crossing], b[crossing]
    share = ((height - a[:, 2]) / (b[:, 2] - a[:, 2]))[:, None]
    return np.asarray(a + share * (b - a))
