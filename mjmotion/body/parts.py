"""What is leg, arm, trunk and head in a humanoid of any make: found from its shape and joints.

    parts = find_parts(model)
    parts.legs[0].upper, parts.trunk, parts.head

A *limb* is one of two subtrees that hang from the trunk, have joints of the same kinds in the same
order, weigh the same and reach as far. The pair that reaches lowest at ``qpos0`` is the legs; of
the others the longest is the arms. The trunk is what joins the root and both pairs; the head is the
highest of what else hangs from it, or, where it has no body of its own, the geoms of the trunk
above the shoulders. Knee and elbow are the joints nearest to the middle of their limb that do not
merely twist it; the foot is what begins below a sixth of the leg. Names decide only where shape
does not: which of two equally low pairs is the legs, what is a collar bone or a wrist, which geom
is a head.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.geom_points import geom_points
from mjmotion.body.kinematics import check_free_root
from mjmotion.exceptions import ModelError

Array = NDArray[np.float64]

FOOT_SHARE = 1.0 / 6.0  # a foot begins below this share of the hip's height over the sole
HAND_SHARE = 0.65  # a hand begins beyond this share of the way from shoulder to finger tip
_ALIKE = 0.05  # relative difference of mass and reach up to which two subtrees are a pair
_HINGE = mujoco.mjtJoint.mjJNT_HINGE
_LEGS = ("leg", "thigh", "hip", "femur", "foot", "ankle", "shin", "knee")
_COLLARS = ("clav", "collar", "scap")
_HANDS = ("hand", "wrist", "palm", "carp")
_HEADS = ("head", "skull", "face")


@dataclasses.dataclass(frozen=True, eq=False)
class LimbParts:
    """A leg or an arm, at ``qpos0``.

    Attributes:
      top: the body by which it hangs from the trunk.
      upper, lower, end: bodies of thigh, shank and foot, or upper arm, forearm and hand; a limb of
        fewer joints has no ``end``, or no ``lower``.
      points: (3, 3) world positions of hip, knee and ankle, or shoulder, elbow and wrist [m];
        without an end, the limb's far end stands for the last.
    """

    top: int
    upper: tuple[int, ...]
    lower: tuple[int, ...]
    end: tuple[int, ...]
    points: Array

    @property
    def bodies(self) -> tuple[int, ...]:
        """All its bodies."""
        return self.upper + self.lower + self.end


@dataclasses.dataclass(frozen=True, eq=False)
class Parts:
    """The parts of a humanoid, as body ids.

    Attributes:
      legs: two; the left one first where the lateral axis can be told.
      arms: two, or none.
      trunk: bodies between the limbs, with what hangs from them and is nothing else.
      head: bodies of neck and head.
      head_geoms: geoms of the trunk that are the head, where it has no body.
      spine: (2, 3) world positions of the middle of the hips and of the shoulders (of the trunk's
        top, where there are no arms) [m].
      sole: height of the lowest point of the legs [m].
    """

    legs: tuple[LimbParts, ...]
    arms: tuple[LimbParts, ...]
    trunk: tuple[int, ...]
    head: tuple[int, ...]
    head_geoms: tuple[int, ...]
    spine: Array
    sole: float

    @property
    def hip_height(self) -> float:
        """Height of the hips over the soles [m]."""
        return float(self.spine[0, 2] - self.sole)


def find_parts(model: mujoco.MjModel) -> Parts:
    """Return the parts of the character with the free root.

    Raises:
      ModelError: no free root, or no two subtrees that could be legs.
    """
    check_free_root(model)
    body = _Shape(model)
    pairs = body.pairs()
    if not pairs:
        raise ModelError(
            "no limbs found: no two parts of the body mirror each other, so nothing can be told to"
            " be a leg or an arm; give a humanoid"
        )
    legs = _legs(body, pairs)
    inside = {child for top in legs for child in body.subtree(top)}
    rest = [pair for pair in pairs if pair[0] not in inside and pair != legs]
    nested = {c for pair in rest for top in pair for c in body.subtree(top) if c != top}
    rest = [pair for pair in rest if pair[0] not in nested]
    arms = max(rest, key=lambda pair: body.reach(pair[0]), default=None)
    if arms is not None and body.reach(arms[0]) < 0.3 * body.reach(legs[0]):
        arms = None  # ears, eyes, shoulder plates: too short to be arms
    limbs = tuple(_limb(body, top, leg=True) for top in legs)
    arm_limbs = tuple(_limb(body, top, leg=False) for top in arms or ())
    return _with_trunk(body, limbs, arm_limbs)


class _Shape:
    """The tree under the free root at ``qpos0``: positions, extents, who hangs from whom."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model = model
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        self.root = int(model.jnt_bodyid[0])
        self.bodies = [b for b in range(1, model.nbody) if self.root in self.ancestors(b)]
        self.children = {
            b: [c for c in self.bodies if model.body_parentid[c] == b] for b in self.bodies
        }
        self.anchor = np.array(data.xpos)
        for b in range(model.nbody):
            if model.body_jntnum[b] and b != self.root:
                self.anchor[b] = data.xanchor[model.body_jntadr[b]]
        self._axis = np.array(data.xaxis)
        self.points: dict[int, Array] = {}
        for b in self.bodies:
            parts = [data.xpos[b][None], data.site_xpos[model.site_bodyid == b]]
            parts += [self.surface(data, int(g)) for g in np.flatnonzero(model.geom_bodyid == b)]
            self.points[b] = np.concatenate(parts)

    def surface(self, data: mujoco.MjData, geom: int) -> Array:
        """Surface points (k, 3) of one geom in the world [m]."""
        points = geom_points(self.model, geom)
        return points @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]

    def ancestors(self, body: int) -> list[int]:
        """Return the body and all that it hangs from, up to the root of its tree."""
        path = [body]
        while self.model.body_parentid[path[-1]] > 0:
            path.append(int(self.model.body_parentid[path[-1]]))
        return path

    def subtree(self, body: int) -> list[int]:
        """Return the body and all that hangs from it."""
        return [body] + [b for child in self.children[body] for b in self.subtree(child)]

    def cloud(self, bodies: Sequence[int]) -> Array:
        """Surface points (k, 3) of some bodies [m]."""
        return np.concatenate([self.points[b] for b in bodies])

    def reach(self, top: int) -> float:
        """How far a subtree goes from where it hangs [m]."""
        away = self.cloud(self.subtree(top)) - self.anchor[top]
        return float(np.linalg.norm(away, axis=1).max())

    def low(self, top: int) -> float:
        """How low a subtree goes [m]."""
        return float(self.cloud(self.subtree(top))[:, 2].min())

    def name(self, body: int) -> str:
        """Name of a body, lower case."""
        return str(self.model.body(body).name).lower()

    def named(self, top: int, words: Sequence[str]) -> bool:
        """Whether any body of a subtree has one of the words in its name."""
        return any(word in self.name(b) for b in self.subtree(top) for word in words)

    def twists(self, body: int, bone: Array) -> bool:
        """Whether a body's only joint is a hinge about its bone: never a knee or an elbow."""
        joint = int(self.model.body_jntadr[body])
        if self.model.body_jntnum[body] != 1 or self.model.jnt_type[joint] != _HINGE:
            return False
        return bool(abs(self._axis[joint] @ bone) > 0.8 * np.linalg.norm(bone))

    def pairs(self) -> list[tuple[int, int]]:
        """Sibling subtrees that mirror each other and have joints."""
        found = []
        for siblings in self.children.values():
            for i, a in enumerate(siblings):
                for b in siblings[i + 1 :]:
                    if (
                        self._kinds(a) == self._kinds(b)
                        and self._kinds(a)[0]
                        and self._mirror(a, b)
                    ):
                        found.append((a, b))
        return found

    def _kinds(self, body: int) -> tuple[tuple[int, ...], tuple[object, ...]]:
        first, count = self.model.body_jntadr[body], self.model.body_jntnum[body]
        own = tuple(int(kind) for kind in self.model.jnt_type[first : first + count])
        return own, tuple(sorted((self._kinds(c) for c in self.children[body]), key=repr))

    def _mirror(self, a: int, b: int) -> bool:
        mass, reach = self.model.body_subtreemass[[a, b]], (self.reach(a), self.reach(b))
        apart = self.anchor[a] - self.anchor[b]
        far = np.linalg.norm(
            self.cloud(self.subtree(a)).mean(0) - self.cloud(self.subtree(b)).mean(0)
        )
        return bool(
            abs(mass[0] - mass[1]) <= _ALIKE * mass.max()
            and abs(reach[0] - reach[1]) <= _ALIKE * max(reach)
            and abs(apart[2]) <= _ALIKE * max(reach)
            and far > 1e-3 * max(reach)
        )


def _legs(body: _Shape, pairs: Sequence[tuple[int, int]]) -> tuple[int, int]:
    """Return the lowest pair; of several as low, the one that is called so."""
    inner = {c for pair in pairs for top in pair for c in body.subtree(top) if c != top}
    outer = [pair for pair in pairs if pair[0] not in inner]
    lowest = min(body.low(pair[0]) for pair in outer)
    near = [p for p in outer if body.low(p[0]) <= lowest + 0.1 * body.reach(p[0])]
    called = [pair for pair in near if body.named(pair[0], _LEGS)]
    return max(called or near, key=lambda pair: body.reach(pair[0]))


def _limb(body: _Shape, top: int, *, leg: bool) -> LimbParts:
    """Divide a limb at knee and ankle, or elbow and wrist."""
    cloud = body.cloud(body.subtree(top))
    # The line of bones ends in the body that reaches furthest from where the limb hangs.
    away = {
        b: np.linalg.norm(body.points[b] - body.anchor[top], axis=1).max()
        for b in body.subtree(top)
    }
    last = max(away, key=lambda b: away[b])
    chain = [b for b in reversed(body.ancestors(last)) if b in away]
    while len(chain) > 1 and not leg and any(word in body.name(chain[0]) for word in _COLLARS):
        chain = chain[1:]  # a collar bone belongs to the trunk
    jointed = [b for b in chain if body.model.body_jntnum[b]] or chain[:1]
    start = body.anchor[jointed[0]]
    tip = cloud[np.argmax(np.linalg.norm(cloud - start, axis=1))]
    if leg:
        sole = cloud[:, 2].min()
        height = start[2] - sole
        ends = [b for b in jointed[1:] if body.anchor[b][2] - sole < FOOT_SHARE * height]
    else:
        line = np.array([body.anchor[b] for b in jointed] + [tip])
        arc = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))))
        share = dict(zip(jointed, arc[:-1] / max(arc[-1], 1e-9), strict=True))
        ends = [b for b in jointed[1:] if share[b] > HAND_SHARE]
        called = [b for b in jointed[1:] if any(word in body.name(b) for word in _HANDS)]
        ends = called if called and share[called[0]] > 0.4 else ends
    end = ends[0] if ends and len(jointed) > 2 else None
    between = [b for b in jointed[1:] if end is None or jointed.index(b) < jointed.index(end)]
    ankle = body.anchor[end] if end is not None else tip
    line = np.array([start, *(body.anchor[b] for b in between), ankle])
    arc = np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))
    off = np.abs(arc[:-1] / max(arc[-1], 1e-9) - 0.5)
    off += [body.twists(b, line[i + 2] - line[i + 1]) for i, b in enumerate(between)]
    knee = between[int(np.argmin(off))] if between else None
    groups: dict[int, list[int]] = {0: [], 1: [], 2: []}
    for b in body.subtree(chain[0]):
        path = body.ancestors(b)
        groups[2 if end in path else 1 if knee in path else 0].append(b)
    points = np.stack(
        (start, body.anchor[knee] if knee is not None else (start + ankle) / 2, ankle)
    )
    upper, lower, foot = (tuple(groups[i]) for i in range(3))
    return LimbParts(chain[0], upper, lower, foot, points)


def _with_trunk(body: _Shape, legs: tuple[LimbParts, ...], arms: tuple[LimbParts, ...]) -> Parts:
    taken = {b for limb in (*legs, *arms) for b in limb.bodies}
    bases = [int(body.model.body_parentid[limb.top]) for limb in (*legs, *arms)]
    core = {b for base in bases for b in body.ancestors(base)}
    hips = np.mean([limb.points[0] for limb in legs], axis=0)
    free = [b for b in body.bodies if b not in taken]
    top = body.cloud(free)[:, 2].max()
    high = np.mean([limb.points[0] for limb in arms], axis=0) if arms else np.append(hips[:2], top)
    heads = [
        b
        for b in free
        if b not in core and body.model.body_parentid[b] in core and body.anchor[b][2] > hips[2]
    ]
    called = [b for b in heads if body.named(b, _HEADS)]
    above = called or [b for b in heads if body.cloud(body.subtree(b))[:, 2].max() > high[2]]
    head = max(above, key=lambda b: body.cloud(body.subtree(b))[:, 2].max(), default=None)
    head_bodies = tuple(body.subtree(head)) if head is not None else ()
    trunk = tuple(b for b in free if b not in head_bodies)
    geoms = () if head is not None or not arms else _head_geoms(body, trunk, high)
    sole = min(body.low(limb.top) for limb in legs)
    return Parts(legs, arms, trunk, head_bodies, geoms, np.stack((hips, high)), sole)


def _head_geoms(body: _Shape, trunk: Sequence[int], high: Array) -> tuple[int, ...]:
    """Geoms of the trunk that lie wholly above the shoulders, or are called a head."""
    model, found = body.model, []
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for geom in range(model.ngeom):
        if model.geom_bodyid[geom] not in trunk:
            continue
        name = model.geom(geom).name.lower()
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
            name += model.mesh(model.geom_dataid[geom]).name.lower()
        cloud = body.surface(data, geom)
        if cloud[:, 2].min() > high[2] or any(word in name for word in _HEADS):
            found.append(geom)
    return tuple(found)
