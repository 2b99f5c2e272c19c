"""How hands and feet lie against a rope: where its centre line runs in the frame of each site.

The rope crosses the palm between thumb and forefinger, and is clamped between the inner sides of
the feet. How far its centre line is from the skin follows from the character's own geoms, so a
character with larger feet stands further off.
"""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.kinematics import site_id
from mjmotion.exceptions import ModelError
from mjmotion.numerics.rotations import conjugate, exp, multiply, rotate, to_matrix, yaw_quat
from mjmotion.scene.rope_scene import RADIUS as ROPE_RADIUS

Array = NDArray[np.float64]

HANDS = ("left_hand", "right_hand")
FEET = ("left_foot", "right_foot")
LIMBS = HANDS + FEET

_CROSSING = np.deg2rad(30.0)  # between the fingers and the rope
_FINGERS_IN = np.deg2rad(32.0)  # how far the fingers point inward, about the rope
_TOES_DOWN = np.deg2rad(24.0)
_TOES_OUT = np.deg2rad(7.0)
_PALM = (0.006, 0.0, 0.0)  # where the rope passes a hand, from its site: towards the thumb [m]
_BALL = (0.085, 0.0, 0.02)  # where the rope passes a foot, from its site [m]
_TOUCH = 2e-3  # left between skin and rope [m]
_FAR = 0.3  # from here the rope is brought nearer [m]
_STEPS = 60


@dataclasses.dataclass(frozen=True, eq=False)
class Grip:
    """A hand or foot on an upright rope.

    Attributes:
      site: its name.
      quat: (4,) orientation of the site in the world, wxyz, while it holds an upright rope.
      to_rope: (3,) from the site to the rope's centre line, in the site's frame [m].
    """

    site: str
    quat: Array
    to_rope: Array

    def position(self, point: Array, quat: Array) -> Array:
        """Return where the site is (..., 3) if it holds ``point`` (..., 3), turned ``quat``."""
        return point - rotate(quat, np.broadcast_to(self.to_rope, point.shape))


def find_grips(model: mujoco.MjModel, radius: float = ROPE_RADIUS) -> dict[str, Grip]:
    """Return how the hands and feet of a character lie against a rope of ``radius`` [m].

    Raises:
      ModelError: the model lacks a site of :data:`LIMBS`, or there is nothing solid near it.
    """
    return {site: _find_grip(model, site, radius) for site in LIMBS}


def _find_grip(model: mujoco.MjModel, site: str, radius: float) -> Grip:
    index = site_id(model, site)
    sign = 1.0 if site.startswith("left") else -1.0
    inward = np.array((0.0, -sign, 0.0))  # the palm's normal, and the inner side of the foot
    if site in HANDS:
        # The fingers, along -z of the hand, point up and forward; the thumb, along x, up and back.
        pitch = exp(np.array((0.0, _CROSSING - np.pi, 0.0)))
        quat, near = multiply(yaw_quat(np.array(-sign * _FINGERS_IN)), pitch), np.array(_PALM)
    else:
        quat = multiply(yaw_quat(np.array(sign * _TOES_OUT)), exp(np.array((0.0, _TOES_DOWN, 0.0))))
        near = np.array(_BALL)
    axis = rotate(conjugate(quat), np.array((0.0, 0.0, 1.0)))
    inward = inward - (inward @ axis) * axis
    inward /= np.linalg.norm(inward)
    away = _touching(model, index, near, inward, axis, radius)
    return Grip(site, quat, near + away * inward)


def _touching(
    model: mujoco.MjModel, site: int, near: Array, inward: Array, axis: Array, radius: float
) -> float:
    """Return how far along ``inward`` from ``near`` a rope touches the site's body [m].

    It comes from afar, each time by the distance that is left, which cannot take it inside.
    """
    alone, data = _body_and_rope(model, int(model.site_bodyid[site]), radius)
    turn = to_matrix(model.site_quat[site])
    quat = np.empty(4)
    mujoco.mju_quatZ2Vec(quat, turn @ axis)
    data.mocap_quat[0] = quat
    away, line = _FAR, np.zeros(6)
    for _ in range(_STEPS):
        data.mocap_pos[0] = model.site_pos[site] + turn @ (near + away * inward)
        mujoco.mj_kinematics(alone, data)
        gap = min(
            mujoco.mj_geomDistance(alone, data, geom, alone.ngeom - 1, 2.0 * _FAR, line)
            for geom in range(alone.ngeom - 1)
        )
        if gap >= _FAR + 0.2:
            raise ModelError(
                f"there is nothing solid at site '{model.site(site).name}' to hold a rope with"
            )
        away -= gap - _TOUCH
        if abs(gap - _TOUCH) < 1e-6:
            break
    return away


def _body_and_rope(
    model: mujoco.MjModel, body: int, radius: float
) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Return a model of one body's geoms in its own frame, and a piece of rope as the last."""
    spec = mujoco.MjSpec()
    rope = spec.worldbody.add_body(mocap=True)
    rope.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=(radius, _FAR, 0.0))
    for geom in np.flatnonzero(model.geom_bodyid == body):
        kind = mujoco.mjtGeom(int(model.geom_type[geom]))
        place = {"pos": model.geom_pos[geom], "quat": model.geom_quat[geom]}
        if kind == mujoco.mjtGeom.mjGEOM_MESH:
            mesh = int(model.geom_dataid[geom])
            first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
            vertices = model.mesh_vert[first : first + count].astype(np.float64).ravel()
            name = f"mesh{geom}"
            spec.add_mesh(name=name, uservert=vertices.tolist())
            spec.worldbody.add_geom(type=kind, meshname=name, **place)
        else:
            spec.worldbody.add_geom(type=kind, size=model.geom_size[geom], **place)
    if len(spec.worldbody.geoms) == 0:
        raise ModelError(
            f"body '{model.body(body).name}' has no geoms: it has nothing to hold a rope with"
        )
    alone = spec.compile()
    return alone, mujoco.MjData(alone)
