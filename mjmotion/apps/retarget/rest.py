"""A character at rest: its parts, which way it faces, where joints and soles are in its bodies."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.character import Character
from mjmotion.body.geom_points import body_points
from mjmotion.body.kinematics import Pose
from mjmotion.body.parts import LimbParts
from mjmotion.exceptions import ModelError
from mjmotion.numerics.rotations import normalized

Array = NDArray[np.float64]

SIDES = ("left", "right")
BAND = 0.002  # points this near to the lowest are a sole [m]


class RestBody:
    """A character at ``qpos0``.

    Attributes:
      model: its model.
      parts: what is leg, arm, trunk and head.
      xpos, xmat: (nbody, 3) [m] and (nbody, 3, 3) where bodies are.
      forward, left: (3,) unit directions that it faces and has to its left.
      frame: (3, 3) forward, left and up as columns.
      limbs: ``left_leg``, ``right_leg``, ``left_arm`` and ``right_arm``, as far as it has them.
    """

    def __init__(self, character: Character) -> None:
        model = character.model
        self.model, self.parts = model, character.parts
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        self.xpos, self.xmat = data.xpos.copy(), data.xmat.reshape(-1, 3, 3).copy()
        up = np.array((0.0, 0.0, 1.0))
        legs = self.parts.legs
        across = (legs[0].points[0] - legs[1].points[0]) * (1.0, 1.0, 0.0)
        forward = self._toes(legs) * (1.0, 1.0, 0.0)
        # Feet tell the way; the hips tell it exactly.
        ahead = normalized(np.cross(across, up))
        self.forward = ahead if ahead @ forward >= 0.0 else -ahead
        self.left = np.cross(up, self.forward)
        self.frame = np.stack((self.forward, self.left, up), axis=1)
        self.limbs = {
            f"{side}_{kind}": limb
            for kind, pair in (("leg", legs), ("arm", self.parts.arms))
            for side, limb in zip(SIDES, self._left_first(pair), strict=False)
        }

    def _toes(self, legs: tuple[LimbParts, ...]) -> Array:
        """Return the way from ankles to the middle of the feet."""
        ways = []
        for leg in legs:
            soles = self.sole(leg)
            ways.append(soles.mean(axis=0) - leg.points[2])
        return np.asarray(np.mean(ways, axis=0))

    def _left_first(self, pair: tuple[LimbParts, ...]) -> list[LimbParts]:
        return sorted(pair, key=lambda limb: -float(limb.points[0] @ self.left))

    def sole(self, leg: LimbParts) -> Array:
        """Lowest points (k, 3) of a foot in the world [m]."""
        clouds = []
        for body in leg.end or leg.lower or leg.upper:
            try:
                points = body_points(self.model, body)
            except ModelError:
                continue  # nothing of it collides
            clouds.append(points @ self.xmat[body].T + self.xpos[body])
        if not clouds:
            raise ModelError("a leg has no geom that collides: it has no sole to stand on")
        cloud = np.concatenate(clouds)
        return cloud[cloud[:, 2] < cloud[:, 2].min() + BAND]

    def base(self, limb: LimbParts) -> int:
        """Return the body from which a limb hangs."""
        return int(self.model.body_parentid[limb.top])

    def local(self, body: int, point: Array) -> Array:
        """Return a world point in a body's frame."""
        return np.asarray(self.xmat[body].T @ (point - self.xpos[body]))

    def joints(self, limb: LimbParts) -> list[tuple[int, Array]]:
        """Body and point in its frame of hip, knee and ankle, or shoulder, elbow and wrist."""
        bodies = [self.base(limb), (limb.lower or limb.upper)[0], (limb.end or limb.lower)[0]]
        return [(b, self.local(b, p)) for b, p in zip(bodies, limb.points, strict=True)]


def world(pose: Pose, body: int, point: Array) -> Array:
    """Return a point (3,) of a body in the world at every frame (nframe, 3) [m]."""
    return np.asarray(pose.xpos[:, body] + pose.xmat[:, body] @ point)
