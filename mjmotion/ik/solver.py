"""What every IK solver does: the least displacement that meets the constraints, frame by frame.

A solver sees the poses of the constrained frames, all at once, and answers with one displacement a
frame, which minimises Eq. 4, ``Σ α_i |v_i|²``, among those that meet the targets. From one level
to the next of the same targets it may keep what hardly changes; make a solver for each fit.
"""

from __future__ import annotations

import dataclasses
from typing import Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.kinematics import Pose
from mjmotion.constraints import Link, Targets
from mjmotion.constraints.shared_targets import Sensitivity

Array = NDArray[np.float64]

ROOT_SHIFT_WEIGHT = 60.0  # α of the root's translation, against 1 rad² of a joint [1/m²]
ROOT_TURN_WEIGHT = 12.0  # α of the root's rotation
_LIGHT, _HEAVY = 0.5, 4.0  # α of a joint that moves nothing, and of one that moves the whole body


@dataclasses.dataclass(frozen=True, eq=False)
class Inequalities:
    """Wishes ``rows @ displacement ≥ needed``, each about one frame.

    Attributes:
      frame: (m,) which of the poses handed in.
      rows: (m, nv).
      needed: (m,) [m]; positive where the pose breaks the wish.
      distance: (m,) signed distance to what is to be kept clear of [m].
    """

    frame: NDArray[np.int64]
    rows: Array
    needed: Array
    distance: Array


class Clearance(Protocol):
    """Something to keep clear of."""

    def __call__(self, qpos: Array, frames: NDArray[np.int64]) -> Inequalities:
        """Return what poses (n, nq) at ``frames`` (n,) lack; only frames that lack something."""
        ...


@dataclasses.dataclass(frozen=True, eq=False)
class Solution:
    """Displacements (n, nv), and how far the poses handed in were from their targets.

    ``error`` (n,) is the largest position error of a frame before solving [m]. ``rise`` (n,), where
    the solver leaves the root alone, is how far the root would have to go up for all to be in reach
    [m]; down is negative. ``pushed`` (n,) are the frames that inequalities ask anything of: any of
    their joints may serve.
    """

    displacement: Array
    error: Array
    rise: Array | None = None
    pushed: NDArray[np.bool_] | None = None


class IKSolver(Protocol):
    """The least displacement that meets the targets (Eq. 4)."""

    def solve(
        self,
        qpos: Array,
        targets: Targets,
        inequalities: Clearance | None = None,
        deviation: Array | None = None,
    ) -> Solution:
        """Return displacements for poses (n, nq) at ``targets.frames``.

        They are least in themselves (Eq. 4), or together with a ``deviation`` (n, nv) that there
        is already; where that is NaN, in themselves.
        """
        ...

    def enforce(self, qpos: Array, targets: Targets) -> Solution:
        """Return displacements that meet every target exactly (§4.4), moving the root least."""
        ...

    def sensitivity(
        self, qpos: Array, targets: Targets, deviation: Array | None = None
    ) -> Sensitivity:
        """Return what the frames' deviations cost when their targets change (§7)."""
        ...


def default_weights(model: mujoco.MjModel) -> Array:
    """Return the rigidity α (nv,) of every degree of freedom (Eq. 4).

    A joint resists in proportion to the share of the body's mass that it moves. The root is stiff:
    its path is the first guess's to find (§4.5), the rest of the body works around it.
    """
    total = model.body_subtreemass[model.jnt_bodyid[0]]
    share = model.body_subtreemass[model.dof_bodyid] / max(total, 1e-9)
    weights = _LIGHT + _HEAVY * share
    weights[:3], weights[3:6] = ROOT_SHIFT_WEIGHT, ROOT_TURN_WEIGHT
    return np.asarray(weights)


def position_error(pose: Pose, targets: Targets) -> Array:
    """Return the largest position error of each frame (n,) [m], of sites and of linked sites."""
    gap = np.linalg.norm(targets.position - pose.site_xpos[:, targets.sites], axis=-1)
    worst = np.max(gap * (targets.position_weight > 0), axis=1, initial=0.0)
    for link in targets.links:
        gap = np.linalg.norm(link_position(pose, link) - pose.site_xpos[:, link.site], axis=-1)
        worst = np.maximum(worst, gap * (link.position_weight > 0))
    return np.asarray(worst)


def link_position(pose: Pose, link: Link) -> Array:
    """Return where (n, 3) the held site of a link is to be, in the world [m]."""
    turned = pose.site_xmat[:, link.to] @ link.position[..., None]
    return np.asarray(pose.site_xpos[:, link.to] + turned[..., 0])
