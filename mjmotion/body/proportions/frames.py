"""Where elements of a spec stand in their body, through the MJCF frames around them."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.numerics.rotations import normalized, to_matrix

Array = NDArray[np.float64]

QUAT = mujoco.mjtOrientation.mjORIENTATION_QUAT


class BodyFrame:
    """The pose of the frames that an element stands in, within its body.

    Attributes:
      turn: (3, 3) orientation.
      pos: (3,) origin [m].
    """

    def __init__(self, element: Any) -> None:
        self.turn, self.pos = np.eye(3), np.zeros(3)
        frame = element.frame
        while frame is not None:  # from the innermost out
            turn = to_matrix(quat_of(frame))
            self.pos = np.array(frame.pos) + turn @ self.pos
            self.turn = turn @ self.turn
            frame = frame.frame

    def to_body(self, point: Array) -> Array:
        """Return a point (3,) of the frame in the body."""
        return np.asarray(self.turn @ np.asarray(point) + self.pos)

    def from_body(self, point: Array) -> Array:
        """Return a point (3,) of the body in the frame."""
        return np.asarray(self.turn.T @ (np.asarray(point) - self.pos))


def quat_of(element: Any, alternative: str = "alt", quat: str = "quat") -> Array:
    """Return the orientation (4,) wxyz of an element, however it was said, as a unit quaternion."""
    other = getattr(element, alternative)
    if other.type == QUAT:
        return normalized(np.array(getattr(element, quat), dtype=np.float64))
    compiler = element.compiler
    resolved = mujoco.MjSpec.resolve_orientation(
        degree=bool(compiler.degree), sequence=compiler.eulerseq, orientation=other
    )
    return normalized(np.array(resolved, dtype=np.float64))
