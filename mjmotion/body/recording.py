"""What a recording itself says, kept beside the motion that was made of it.

motion = load_clip("walk.bvh")
motion.recording.position("left_ankle")      # (nframe, 3), as recorded

A motion is what the mapping made of a recording; these are the recording's own joints, upright and
at the character's scale, so that the one can be held against the other.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mjmotion.boundary.arrays import read_archive
from mjmotion.boundary.limits import MOST_LENGTH, real_array
from mjmotion.exceptions import ClipError, MotionError

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class Recording:
    """Joints of a recording in every frame, by the role that each plays.

    Attributes:
      roles: (nrole) such as ``left_knee``.
      bodies: (nrole) the character's body whose origin is to be where the role's joint is.
      positions: (nframe, nrole, 3) of the recorded joints, z up, at the character's scale [m];
        turned about z and moved over the ground as the recording was.
      turns: (nframe, nrole, 4) orientations of the recorded joints in the world, wxyz; what each is
        at rest is the recording's own affair.
      floor: (nframe, nrole) height of the ground under each joint, as it was taken to be [m].
    """

    roles: tuple[str, ...]
    bodies: tuple[str, ...]
    positions: Array
    turns: Array
    floor: Array

    @property
    def nframe(self) -> int:
        """Number of frames."""
        return len(self.positions)

    def position(self, role: str) -> Array:
        """Return (nframe, 3) positions of a role's joint [m]."""
        return self.positions[:, self.roles.index(role)]

    def save(self, path: str | Path) -> None:
        """Write it as a file (.npz) of the arrays of this class."""
        with Path(path).open("wb") as file:
            np.savez_compressed(
                file,
                roles=np.array(self.roles),
                bodies=np.array(self.bodies),
                positions=self.positions,
                turns=self.turns,
                floor=self.floor,
            )

    @classmethod
    def load(cls, path: str | Path, nframe: int) -> Recording:
        """Read what :meth:`save` wrote.

        Args:
          path: the file.
          nframe: frames of the motion that it belongs to.

        Raises:
          ClipError: the file is missing, damaged, or of another motion.
        """
        try:
            data = read_archive(path, ("roles", "bodies", "positions", "turns", "floor"))
            roles, bodies = (tuple(map(str, data[name].ravel())) for name in ("roles", "bodies"))
            positions, turns, floor = (
                real_array(data[name], name) for name in ("positions", "turns", "floor")
            )
            for name, array, shape in (
                ("bodies", np.array(bodies), (len(roles),)),
                ("positions", positions, (nframe, len(roles), 3)),
                ("turns", turns, (nframe, len(roles), 4)),
                ("floor", floor, (nframe, len(roles))),
            ):
                if array.shape != shape:
                    raise ValueError(f"{name} has the shape {array.shape} in place of {shape}")
            if len(set(roles)) < len(roles):
                raise ValueError("a role is there twice")
            for name, array in (("positions", positions), ("floor", floor)):
                if not (np.abs(array) <= MOST_LENGTH).all():
                    raise ValueError(f"{name} are not finite, or beyond {MOST_LENGTH:,.0f} m")
            size = np.linalg.norm(turns, axis=-1)
            if not (np.abs(size - 1.0) < 1e-6).all():
                raise ValueError("turns are no quaternions")
        except (ValueError, MotionError) as error:
            raise ClipError(
                f"'{path}' does not hold the recording of the motion: {error}"
            ) from error
        return cls(roles, bodies, positions, turns, floor)
