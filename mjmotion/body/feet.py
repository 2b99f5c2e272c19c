"""Feet of a character: the sites that stand, the sole they stand with, and toes that bend.

A foot may have toes: a body ``<side>_toes`` on the foot's, on one hinge across the ball.
They are no part of what IK finds: a foot is posed by its rigid part, and its toes lie on the ground
or follow the recording.
"""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.geom_points import body_points
from mjmotion.body.kinematics import Pose, root_body, site_id
from mjmotion.exceptions import ModelError
from mjmotion.numerics.rotations import conjugate, exp, from_matrix, log, multiply, rotate

Array = NDArray[np.float64]

SOLE_BAND = 0.004  # foot geometry this close to the sole plane counts as sole [m]
UNDER_STEP = 0.022  # how far apart points of an underside are: no small thing is missed [m]
_DOWN = 0.2  # upward part of the normals of faces that some pitch of a foot turns down
STIFFENS = 0.25  # how far before the end of their range toes begin to bend less [rad]
_NEARLY = 0.999  # of their range that toes are taken to be bent by at most
_ON_EDGE = 1e-9  # a point of the grid this near to the outline is inside [m]


@dataclasses.dataclass(frozen=True, eq=False)
class Toes:
    """The toes of a foot, on one hinge; all in the frame of the foot's posed site.

    At rest they lie in the plane of the sole.

    Attributes:
      body: body id.
      address: where in ``qpos`` the hinge stands.
      rest: its angle in ``qpos`` at rest [rad].
      quat: (4,) orientation of the body at rest.
      sign: 1 where a positive angle bends the toes up, else -1.
      anchor: (3,) a point of the hinge [m].
      axis: (3,) its direction; a positive turn about it bends the toes up.
      low, high: how far they bend, up positive [rad].
    """

    body: int
    address: int
    rest: float
    quat: Array
    sign: float
    anchor: Array
    axis: Array
    low: float
    high: float

    def settled(self, wanted: Array) -> Array:
        """Return how far toes bend up (n,) [rad] that would have to by ``wanted`` (n,) to lie flat.

        Near the end of their range they give less and less, as tissue does, and none beyond it.
        """
        stiff = self.high - STIFFENS
        over = STIFFENS * np.tanh((wanted - stiff) / STIFFENS)
        return np.asarray(np.maximum(np.where(wanted > stiff, stiff + over, wanted), self.low))

    def wanted(self, settled: Array) -> Array:
        """Return how far toes would have to bend (n,) [rad] that are bent by ``settled`` (n,)."""
        stiff = self.high - STIFFENS
        share = np.clip((settled - stiff) / STIFFENS, 0.0, _NEARLY)
        return np.asarray(np.where(share > 0.0, stiff + STIFFENS * np.arctanh(share), settled))

    def put(self, qpos: Array, bend: Array) -> Array:
        """Return the poses (n, nq) with the toes bent up by (n,) [rad], as far as they go."""
        qpos = np.array(qpos)
        bend = np.clip(bend, self.low, self.high)
        qpos[:, self.address] = self.rest + self.sign * bend
        return qpos

    def placed(self, foot: Array, bend: Array) -> Array:
        """Return orientations (n, 4) of the toes' body on posed sites (n, 4), bent up by (n,)."""
        return multiply(multiply(foot, exp(bend[:, None] * self.axis)), self.quat[None])

    def turned(self, points: Array, bend: Array) -> Array:
        """Return points (k, 3) [m] of the toes where these are bent by (n,) [rad]: (n, k, 3)."""
        turn = exp(bend[:, None] * self.axis)
        return self.anchor + rotate(turn[:, None], (points - self.anchor)[None])


@dataclasses.dataclass(frozen=True, eq=False)
class Foot:
    """A foot: its body, contact sites and sole, in the frame of the posed site.

    Attributes:
      side: common part of its sites' names, such as ``left``.
      body: body id.
      site: name of the site that is posed, on the sole under the ankle.
      heel, toe: (3,) the contact sites in the posed site's frame [m]; of a foot whose toes bend,
        the latter is the ball, on the hinge.
      sole: (k, 3) points of the sole, its outline and its inside, in the same frame [m]; of toes as
        they lie in the plane of the sole, and the last two the ends of their hinge.
      shape: (k, 3) points of the whole foot's surface, likewise [m].
      under: (k, 3) points of what of that can be lowest, closer to each other, likewise [m].
      toes: its toes, where they bend.
      bends: (k,) which points of ``shape`` are the toes'.
      under_bends: (k,) which points of ``under`` are.
    """

    side: str
    body: int
    site: str
    heel: Array
    toe: Array
    sole: Array
    shape: Array
    under: Array
    toes: Toes | None
    bends: NDArray[np.bool_]
    under_bends: NDArray[np.bool_]

    @property
    def bodies(self) -> tuple[int, ...]:
        """The ids of its bodies: the foot's, and the toes' where they bend."""
        return (self.body,) if self.toes is None else (self.body, self.toes.body)

    @property
    def front(self) -> Array:
        """(3,) the toe site; of a foot with toes that bend, their tip straight ahead of it [m]."""
        if self.toes is None:
            return self.toe
        along = (self.toe - self.heel) * (1.0, 1.0, 0.0)
        along = along / max(float(np.linalg.norm(along)), 1e-9)
        return self.toe + max(float(((self.sole - self.toe) @ along).max()), 0.0) * along

    def bend(self, pose: Pose) -> Array:
        """Return how far its toes are bent up in poses (n,) [rad]; 0 where they do not bend."""
        if self.toes is None:
            return np.zeros(len(pose.xpos))
        foot = from_matrix(pose.site_xmat[:, site_id(pose.model, self.site)])
        rest = multiply(foot, np.broadcast_to(self.toes.quat, foot.shape))
        turn = multiply(pose.xquat[:, self.toes.body], conjugate(rest))
        return np.asarray((log(turn) * rotate(foot, self.toes.axis)).sum(axis=1))

    def sole_at(self, bend: Array) -> Array:
        """Return the points of the sole with the toes bent up by (n,) [rad]: (n, k, 3) [m]."""
        return self._at(self.sole, self.bends[: len(self.sole)], bend)

    def shape_at(self, bend: Array) -> Array:
        """Return the points of the shape with the toes bent up by (n,) [rad]: (n, k, 3) [m]."""
        return self._at(self.shape, self.bends, bend)

    def under_at(self, bend: Array) -> Array:
        """Return the points of the underside, toes bent up by (n,) [rad]: (n, k, 3) [m]."""
        return self._at(self.under, self.under_bends, bend)

    def _at(self, points: Array, bends: NDArray[np.bool_], bend: Array) -> Array:
        posed = np.tile(points, (len(bend), 1, 1))
        if self.toes is not None:
            posed[:, bends] = self.toes.turned(points[bends], bend)
        return posed


def find_feet(model: mujoco.MjModel) -> tuple[Foot, ...]:
    """Return the feet: bodies with sites ``<side>_heel``, ``<side>_toe`` and ``<side>_foot``.

    Raises:
      ModelError: there are none, or their sites are on different bodies.
    """
    mine = model.body_rootid[model.site_bodyid] == root_body(model)  # not a bystander's
    names = [model.site(int(i)).name for i in np.flatnonzero(mine)]
    feet = []
    for name in names:
        if not name.endswith("_heel"):
            continue
        side = name.removesuffix("_heel")
        missing = [f"{side}_{part}" for part in ("toe", "foot") if f"{side}_{part}" not in names]
        if missing:
            raise ModelError(f"site '{name}' has no partner {missing}: a foot needs all three")
        heel, toe, foot = (site_id(model, f"{side}_{part}") for part in ("heel", "toe", "foot"))
        body = int(model.site_bodyid[foot])
        if {int(model.site_bodyid[heel]), int(model.site_bodyid[toe])} != {body}:
            raise ModelError(f"the sites of the {side} foot are on different bodies")
        feet.append(_foot(model, side, body, (heel, toe, foot)))
    if not feet:
        raise ModelError("the model has no feet: name sites <side>_heel, <side>_toe, <side>_foot")
    return tuple(feet)


def _foot(model: mujoco.MjModel, side: str, body: int, sites: tuple[int, int, int]) -> Foot:
    """Return a foot from its body and its sites heel, toe and foot."""
    heel, toe, posed = sites
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, model.site_quat[posed])
    frame, origin = matrix.reshape(3, 3), model.site_pos[posed]
    local = (model.site_pos[[heel, toe]] - origin) @ frame
    rigid = (body_points(model, body) - origin) @ frame
    toes, front = _toes(model, side, body, origin, frame)
    points = np.concatenate((rigid, front))
    low = points[:, 2] < points[:, 2].min() + SOLE_BAND
    sole = np.concatenate((local, _fill(points[low])))
    close = _fill(points[low], UNDER_STEP, edges=True)
    parts = [rigid] if toes is None else [rigid, front]
    corners, lowest = [_hull(part) for part in parts], [_hull(part, down=True) for part in parts]
    ahead = np.zeros(3)
    if toes is not None:
        # What of the sole lies ahead of the hinge is the toes'. On the hinge's ends a foot tilts.
        across = points[low] @ toes.axis
        ends = points[low][[across.argmin(), across.argmax()]]
        ahead = np.cross((0.0, 0.0, 1.0), toes.axis)
        ends = ends - ((ends - toes.anchor) @ ahead)[:, None] * ahead
        sole = np.concatenate((sole, ends))
    anchor = np.zeros(3) if toes is None else toes.anchor
    bends, close_bends = ((part - anchor) @ ahead > _ON_EDGE for part in (sole, close))
    whole, low_whole = (
        np.repeat((False, True)[: len(some)], [len(part) for part in some])
        for some in (corners, lowest)
    )
    return Foot(
        side,
        body,
        f"{side}_foot",
        local[0],
        local[1],
        sole,
        np.concatenate((sole, *corners)),
        np.concatenate((sole, close, *lowest)),
        toes,
        np.concatenate((bends, whole)),
        np.concatenate((bends, close_bends, low_whole)),
    )


def _toes(
    model: mujoco.MjModel, side: str, foot: int, origin: Array, frame: Array
) -> tuple[Toes | None, Array]:
    """Return the toes of a foot and their points (k, 3) in its posed site's frame; None, no points.

    Args:
      model: the model.
      side: the foot's.
      foot: its body.
      origin: (3,) place of the posed site in that body [m].
      frame: (3, 3) its axes.
    """
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, f"{side}_toes")
    if body < 0 or model.body_parentid[body] != foot or model.body_jntnum[body] != 1:
        return None, np.zeros((0, 3))
    joint = int(model.body_jntadr[body])
    if model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_HINGE:
        return None, np.zeros((0, 3))
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, model.body_quat[body])
    turn = matrix.reshape(3, 3)
    place = model.body_pos[body]
    axis = model.jnt_axis[joint] @ turn.T @ frame
    sign = -1.0 if axis[1] > 0.0 else 1.0  # about -y the front goes up
    rest = float(model.qpos0[model.jnt_qposadr[joint]])
    limits = (-np.pi, np.pi) if not model.jnt_limited[joint] else model.jnt_range[joint]
    low, high = sorted(sign * (float(limit) - rest) for limit in limits)
    toes = Toes(
        int(body),
        int(model.jnt_qposadr[joint]),
        rest,
        from_matrix(frame.T @ turn),
        sign,
        (place + turn @ model.jnt_pos[joint] - origin) @ frame,
        sign * axis,
        low,
        high,
    )
    points = body_points(model, int(body)) @ turn.T + place
    return toes, (points - origin) @ frame


def _hull(points: Array, *, down: bool = False) -> Array:
    """Corners of the convex hull of points, or of its faces that look ``down``: some forty."""
    from scipy.spatial import ConvexHull

    hull = ConvexHull(points)
    faces = hull.simplices[hull.equations[:, 2] < _DOWN]
    corners = points[np.unique(faces) if down else hull.vertices]
    return corners[:: max(1, len(corners) // 40)]


def _fill(points: Array, step: float = 0.045, *, edges: bool = False) -> Array:
    """Outline points and a grid within them, and the ``edges`` between: all ``step`` apart [m]."""
    from scipy.spatial import ConvexHull

    plane = points[:, :2]
    around = ConvexHull(plane)
    hull = plane[around.vertices]
    low, high = hull.min(axis=0), hull.max(axis=0)
    count = np.maximum(2, np.round((high - low) / step).astype(int))
    axes = [np.linspace(low[i], high[i], count[i] + 1) for i in range(2)]
    grid = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    # Inside is the inner side of every edge. (To look for its triangle in a Delaunay triangulation
    # asks LAPACK, whose threads take 150 ms to wake on a busy machine.)
    outside = grid @ around.equations[:, :2].T + around.equations[:, 2]
    inside = grid[(outside < _ON_EDGE).all(axis=1)]
    rim = [hull[:: max(1, len(hull) // 12)]]
    for corner, way in zip(hull, np.roll(hull, -1, axis=0) - hull, strict=True) if edges else ():
        parts = max(1, int(np.ceil(np.linalg.norm(way) / step)))
        rim.append(corner + way * (np.arange(1, parts) / parts)[:, None])
    flat = np.concatenate((*rim, inside))
    return np.column_stack((flat, np.full(len(flat), points[:, 2].min())))
