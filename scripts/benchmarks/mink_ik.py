"""What mink does of the same job: inverse kinematics frame by frame, warm-started."""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mjmotion.paper.job import Job

Array = NDArray[np.float64]
Limits = Literal["made once", "default", "none"]

CLOSE = 1e-3  # both feet this near, and the frame is done [m]
MOST_STEPS = 20
POSTURE_COST = 1e-2  # against 1 of a foot: small, and still quick to converge
DAMPING = 1e-6


@dataclasses.dataclass(frozen=True, eq=False)
class Solved:
    """Poses (nframe, nq), steps taken in all, and the frames that did not converge."""

    qpos: Array
    steps: int
    unconverged: tuple[int, ...]


def make_solver(job: Job, limits: Limits = "made once") -> Callable[[], Solved]:
    """Return a function that solves the job with mink and daqp.

    Each frame begins with the solution of the one before it, takes whole Gauss-Newton steps, and
    is drawn a little towards the first guess's posture. Tasks and targets are made beforehand and
    do not count.

    Args:
      job: both feet posed at every frame.
      limits: whether the ranges of hinges are held (mink knows none for balls): by limits that
        are made once, by those that mink makes at each step when it is given none, or not.

    Raises:
      ModuleNotFoundError: mink or daqp is not installed.
    """
    import daqp  # noqa: F401  # mink would find out at its first step
    import mink

    model, guess = job.motion.model, job.guess
    feet = [
        mink.FrameTask(constraint.site, "site", position_cost=1.0, orientation_cost=1.0)
        for constraint in job.constraints
    ]
    posture = mink.PostureTask(model, cost=POSTURE_COST)
    bounds = {
        "made once": [mink.ConfigurationLimit(model)],
        "default": None,
        "none": [],
    }[limits]
    sites = [model.site(constraint.site).id for constraint in job.constraints]
    poses = [np.hstack((_require(c.quat), _require(c.position))) for c in job.constraints]
    targets = [[mink.SE3(pose) for pose in of_foot] for of_foot in poses]
    goal = np.stack([_require(c.position) for c in job.constraints], axis=1)

    def solve() -> Solved:
        state = mink.Configuration(model, q=guess[0])
        qpos, steps, unconverged = np.empty_like(guess), 0, []
        for frame in range(len(guess)):
            for foot, target in zip(feet, targets, strict=True):
                foot.set_target(target[frame])
            posture.set_target(guess[frame])
            for _ in range(MOST_STEPS):
                velocity = mink.solve_ik(
                    state, [*feet, posture], 1.0, "daqp", damping=DAMPING, limits=bounds
                )
                state.integrate_inplace(velocity, 1.0)
                steps += 1
                gap = state.data.site_xpos[sites] - goal[frame]
                if (gap * gap).sum(axis=1).max() < CLOSE**2:
                    break
            else:
                unconverged.append(frame)
            qpos[frame] = state.q
        return Solved(qpos, steps, tuple(unconverged))

    # A pose beyond a range makes mink write a warning each step, which costs time.
    logging.getLogger().setLevel(logging.ERROR)
    return solve


def _require(values: Array | None) -> Array:
    assert values is not None
    return values
