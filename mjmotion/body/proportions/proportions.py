"""Proportions: by what factors the parts of a body are longer, wider or larger than before."""

from __future__ import annotations

import dataclasses
import math

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.parts import LimbParts, Parts, find_parts
from mjmotion.exceptions import ModelError

Array = NDArray[np.float64]

LEAST, MOST = 0.1, 10.0  # factors, times size, beyond which a part vanishes or is all there is


@dataclasses.dataclass(frozen=True)
class Proportions:
    """Factors on the parts of a body, 1 as it is.

    Attributes:
      legs: length from hip to ankle.
      torso: length of the trunk, from the hips to the shoulders.
      arms: length from shoulder to wrist.
      head: neck and head, in every direction.
      feet, hands: in every direction.
      width: thickness of limbs, breadth and depth of the trunk.
      size: all of the above once more, so that a body of size 0.5 is half as tall.

    Raises:
      ModelError: a factor that is not a positive number, or makes a part vanish: each, times
        ``size``, must be from 0.1 to 10.
    """

    legs: float = 1.0
    torso: float = 1.0
    arms: float = 1.0
    head: float = 1.0
    feet: float = 1.0
    hands: float = 1.0
    width: float = 1.0
    size: float = 1.0

    def named(self, name: str) -> str:
        """Return a body's name with what is other about it, such as ``humanoid, legs 1.2``."""
        factors = dataclasses.asdict(self).items()
        return ", ".join([name, *(f"{part} {x:g}" for part, x in factors if x != 1.0)])

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if not (math.isfinite(value) and value > 0.0):
                raise ModelError(
                    f"proportion {field.name} is {value}: it must be a positive number"
                )
            full = value if field.name == "size" else value * self.size
            if not LEAST <= full <= MOST:
                times = "" if field.name == "size" else f" times size {self.size:g}"
                gone = "vanish" if full < LEAST else "outgrow the body"
                raise ModelError(
                    f"proportion {field.name} {value:g}{times} makes that part {gone}:"
                    f" keep it from {LEAST:g} to {MOST:g}"
                )

    def maps(self, model: mujoco.MjModel) -> tuple[Array, Array]:
        """Return how every body is stretched.

        Returns:
          bodies: (nbody, 3, 3) linear maps in world axes at ``qpos0``; identities outside the
          character.
          geoms: (ngeom, 3, 3), the same as their bodies' but for a head that has no body.

        Raises:
          ModelError: no legs found, or no arms or head that are to be scaled.
        """
        parts = find_parts(model)
        self._check(parts)
        maps = np.tile(np.eye(3), (model.nbody, 1, 1))
        wide = self.width * self.size
        for limbs, length, end in (
            (parts.legs, self.legs, self.feet),
            (parts.arms, self.arms, self.hands),
        ):
            for limb in limbs:
                for bodies, bone in zip((limb.upper, limb.lower), _bones(limb), strict=True):
                    maps[list(bodies)] = stretch(bone, length * self.size, wide)
                maps[list(limb.end)] = end * self.size * np.eye(3)
        trunk = stretch(parts.spine[1] - parts.spine[0], self.torso * self.size, wide)
        maps[list(parts.trunk)] = trunk
        head = self.head * self.size * np.eye(3)
        maps[list(parts.head)] = head
        geoms = maps[model.geom_bodyid]
        geoms[list(parts.head_geoms)] = head
        return maps, geoms

    def _check(self, parts: Parts) -> None:
        lacking = [
            name
            for name, there in (
                ("arms", parts.arms),
                ("hands", parts.arms and parts.arms[0].end),
                ("feet", parts.legs[0].end),
                ("head", parts.head or parts.head_geoms),
            )
            if not there and getattr(self, name) != 1.0
        ]
        if lacking:
            raise ModelError(f"the model has no {lacking[0]} to scale: leave that proportion at 1")


def stretch(direction: Array, along: float, across: float) -> Array:
    """Return the map (3, 3) that stretches by one factor along a direction and another across."""
    unit = direction / max(float(np.linalg.norm(direction)), 1e-9)
    return np.asarray(across * np.eye(3) + (along - across) * np.outer(unit, unit))


def _bones(limb: LimbParts) -> tuple[Array, Array]:
    hip, knee, ankle = limb.points
    return knee - hip, ankle - knee
