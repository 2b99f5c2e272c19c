"""Where joints, bodies and sites sit in their parents: of a model, or of a body that changes.

    bones = Bones.of(model)                       # one body for all frames
    bones = Bones(body_pos, jnt_pos, site_pos)    # (nframe, …): a body of its own in every frame

Everything that places a body in the world takes bones beside its model: the model says how things
are joined, the bones how long they are. Morphing (Figure 5d) is a fit whose bones change.
"""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.exceptions import ModelError

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class Bones:
    """Offsets in the parent's frame, the same in all frames or with a first axis of frames.

    Attributes:
      body_pos: (nbody, 3) or (nframe, nbody, 3) bodies in their parents [m].
      jnt_pos: (njnt, 3) or (nframe, njnt, 3) joint anchors in their bodies [m].
      site_pos: (nsite, 3) or (nframe, nsite, 3) sites in their bodies [m].

    Raises:
      ModelError: the three do not agree on the number of frames, or hold what is not finite.
    """

    body_pos: Array
    jnt_pos: Array
    site_pos: Array

    def __post_init__(self) -> None:
        fields = (self.body_pos, self.jnt_pos, self.site_pos)
        if len({field.shape[:-2] for field in fields}) != 1 or fields[0].ndim not in (2, 3):
            shapes = [field.shape for field in fields]
            raise ModelError(f"bones have shapes {shapes}: give all (n, 3), or all (nframe, n, 3)")
        if not all(np.isfinite(field).all() for field in fields):
            raise ModelError("bones are not finite: check the proportions they come from")

    @classmethod
    def of(cls, model: mujoco.MjModel) -> Bones:
        """Return the bones of a model."""
        return cls(model.body_pos, model.jnt_pos, model.site_pos)

    @property
    def nframe(self) -> int | None:
        """Number of frames, or None where one body serves all."""
        return len(self.body_pos) if self.body_pos.ndim == 3 else None

    def at(self, frames: NDArray[np.int64]) -> Bones:
        """Return the bones of some frames (n,); the same bones where one body serves all."""
        if self.nframe is None:
            return self
        return Bones(self.body_pos[frames], self.jnt_pos[frames], self.site_pos[frames])

    def check(self, model: mujoco.MjModel, nframe: int) -> None:
        """Raise ModelError unless these are bones of ``model`` for ``nframe`` frames."""
        counts = tuple(f.shape[-2] for f in (self.body_pos, self.jnt_pos, self.site_pos))
        wanted = (model.nbody, model.njnt, model.nsite)
        if counts != wanted or self.nframe not in (None, nframe):
            raise ModelError(
                f"bones are of {counts} bodies, joints and sites over {self.nframe} frames, wanted"
                f" {wanted} over {nframe}: make them for this model and motion"
            )
