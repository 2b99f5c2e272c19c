"""The paper's terrain job: 464 frames, both feet posed at every frame, 5,568 scalar constraints."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.motion import Motion
from mjmotion.constraints import SiteConstraint
from mjmotion.fitting import Fit, fit
from mjmotion.paper import terrain
from mjmotion.paper.job import LEVELS

Array = NDArray[np.float64]

NFRAME, NSCALAR = 464, 5568


@dataclasses.dataclass(frozen=True, eq=False)
class Job:
    """A motion, its constraints and the root shift (nframe, 3) [m] that ``adapt`` begins with."""

    source: Motion
    constraints: tuple[SiteConstraint, ...]
    root_shift: Array

    @property
    def guess(self) -> Array:
        """The motion after the first guess (nframe, nq)."""
        qpos = np.array(self.source.qpos)
        qpos[:, :3] += self.root_shift
        return qpos

    def fit(self, ik: str = "hybrid", *, paper_guess: bool = False) -> Fit:
        """Fit it; with ``paper_guess`` from the contacts' mean shift alone (§4.5)."""
        return fit(
            self.source,
            self.constraints,
            levels=LEVELS,
            ik=ik,
            first_guess=True if paper_guess else self.root_shift,
        )

    def tiled(self, times: int) -> Job:
        """Return the job again and again; every second copy runs backwards, so nothing jumps."""
        count = self.source.nframe
        order = np.concatenate([np.arange(count)[:: 1 - 2 * (i % 2)] for i in range(times)])
        return Job(
            self.source.replace(self.source.qpos[order]),
            tuple(_take(constraint, order) for constraint in self.constraints),
            self.root_shift[order],
        )


def _take(constraint: SiteConstraint, order: NDArray[np.int64]) -> SiteConstraint:
    assert constraint.position is not None and constraint.quat is not None
    return dataclasses.replace(
        constraint,
        frames=np.arange(len(order)),
        position=constraint.position[order],
        quat=constraint.quat[order],
    )


def make_job(clip: str = "walk", scene: str = "terrain") -> Job:
    """Return the job of a clip on a scene."""
    job = terrain.make_job(clip, scene)
    assert isinstance(job.first_guess, np.ndarray)
    return Job(job.motion, job.constraints, job.first_guess)


def size(constraints: Sequence[SiteConstraint]) -> int:
    """Return the number of scalar constraints."""
    return sum(constraint.nscalar for constraint in constraints)
