"""One job of the paper's Table 1: a motion, what must hold, and how its fit begins.

job = make_job()
job.nframe, job.nscalar, job.ndof, job.nreduced
result = job.fit(ik="hybrid")
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.bones import Bones
from mjmotion.body.motion import Motion
from mjmotion.constraints import SiteConstraint
from mjmotion.fitting import Fit, fit
from mjmotion.footsteps.contacts import Contact
from mjmotion.ik import make_solver, parameters
from mjmotion.ik.solver import IKSolver

Array = NDArray[np.float64]

LEVELS = (16.0, 8.0, 4.0, 2.0)  # the paper's frames a knot


@dataclasses.dataclass(frozen=True, eq=False)
class Job:
    """What is fitted, and to what.

    Attributes:
      name: as in Table 1.
      motion: the motion before the first guess.
      constraints: what must hold.
      first_guess: the root's shift (nframe, 3) [m], or whether to make it of the contacts (§4.5).
      rigidity: (nv,) α of Eq. 4, or None for the default.
      bones: a body for each frame, where it changes.
      contacts: who stands or holds on when.
      source: the motion as it was, to compare with; the same as ``motion`` where None.
    """

    name: str
    motion: Motion
    constraints: tuple[SiteConstraint, ...]
    first_guess: Array | bool = True
    rigidity: Array | None = None
    bones: Bones | None = None
    contacts: tuple[Contact, ...] = ()
    source: Motion | None = None

    @property
    def nframe(self) -> int:
        """Number of frames."""
        return self.motion.nframe

    @property
    def nscalar(self) -> int:
        """Number of scalar constraints, joint limits not counted."""
        return sum(constraint.nscalar for constraint in self.constraints)

    @property
    def ndof(self) -> int:
        """Degrees of freedom that serve."""
        return parameters(self.motion.character, self._sites)[0]

    @property
    def nreduced(self) -> int:
        """Parameters that hybrid IK is left with."""
        return parameters(self.motion.character, self._sites)[1]

    @property
    def _sites(self) -> list[str]:
        return sorted({constraint.site for constraint in self.constraints})

    @property
    def guess(self) -> Array:
        """The motion after the first guess (nframe, nq), where the job gives one."""
        qpos = np.array(self.motion.qpos)
        if isinstance(self.first_guess, np.ndarray):
            qpos[:, :3] += self.first_guess
        return qpos

    def fit(
        self, ik: str | IKSolver = "hybrid", levels: Sequence[float] = LEVELS, **settings: Any
    ) -> Fit:
        """Fit the motion (Algorithm 1); settings go to :func:`mjmotion.fitting.fit`."""
        solver = make_solver(self.motion.character, ik, self.rigidity, self.bones)
        own: dict[str, Any] = {"first_guess": self.first_guess, "tolerance": 0.0}
        return fit(self.motion, self.constraints, ik=solver, levels=levels, **{**own, **settings})
