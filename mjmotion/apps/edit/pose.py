"""The edited frame on its own: the whole pose that a drag asks for, or comes nearest to it.

What is dragged moves most: an arm or a leg reaches for its hand or foot before the body follows.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mjmotion.apps.edit.hold import Held, Paths
from mjmotion.body.character import Character
from mjmotion.body.kinematics import body_dofs, root_body, site_id, site_positions
from mjmotion.body.motion import Motion
from mjmotion.constraints import SiteConstraint, Targets, lay_out
from mjmotion.constraints.unmet import residuals
from mjmotion.ik.hybrid import HybridIK
from mjmotion.ik.numeric import NumericIK
from mjmotion.ik.solver import Deviation, default_rigidity
from mjmotion.numerics.tangent import ominus, oplus

Array = NDArray[np.float64]

REACHED = 5e-4  # what may be left of a drag, or of a foot, before the drag counts as too far [m]
TRUNK_STIFFNESS = 30.0  # how much stiffer what carries limbs is while a limb is dragged
STEP = 0.06  # the way of a drag is gone in steps no longer than this [m]
_MOST_STEPS = 8
_ITERATIONS = 3  # Gauss–Newton steps of each
_POLISH = 8  # Gauss–Newton steps of the whole pose
_ROUNDS = 7  # halvings of the way in which the furthest pose is looked for


@dataclasses.dataclass(frozen=True, eq=False)
class PoseSolver:
    """Finds poses in which sites are where they are dragged to.

    Attributes:
      character: whose poses.
      rigidity: (nv,) α of Eq. 4.
    """

    character: Character
    rigidity: Array

    @classmethod
    def of(
        cls, character: Character, sites: Sequence[str], rigidity: Array | None = None
    ) -> PoseSolver:
        """Return the solver for some dragged sites: the trunk is stiff where all are on limbs."""
        model = character.model
        alpha = np.array(default_rigidity(model) if rigidity is None else rigidity)
        trunk = np.zeros(model.nv, dtype=bool)
        for limb in character.limbs:
            trunk |= body_dofs(model, limb.base)
        bodies = [int(model.site_bodyid[site_id(model, name)]) for name in sites]
        parts = {part for limb in character.limbs for part in (limb.upper, limb.lower, limb.end)}
        if parts.issuperset(bodies):
            alpha[trunk] *= TRUNK_STIFFNESS
        return cls(character, alpha)

    def drag(
        self, frame: Motion, held: Held, drags: Sequence[SiteConstraint], own: Paths | None = None
    ) -> tuple[Array, float]:
        """Return the pose (1, nq) that drags ask for, and what share of their way it goes.

        What is held goes before: where the whole drag would take it away, the drag is followed as
        far as nothing gives.

        Args:
          frame: the pose, as a motion of one frame.
          held: what stays, at frame 0.
          drags: where sites are to be, at frame 0.
          own: what :meth:`Held.own` returns, where it is known already.
        """
        own = held.own(frame) if own is None else own
        found, gap = self._pose(frame, held, drags, 1.0, own)
        if gap <= REACHED:
            return found, 1.0
        found, low, high = frame.qpos, 0.0, 1.0
        for _ in range(_ROUNDS):
            share = 0.5 * (low + high)
            pose, gap = self._pose(frame, held, drags, share, own)
            if gap <= REACHED:
                found, low = pose, share
            else:
                high = share
        return found, low

    def _pose(
        self,
        frame: Motion,
        held: Held,
        drags: Sequence[SiteConstraint],
        share: float,
        own: Paths,
    ) -> tuple[Array, float]:
        """Return the pose (1, nq) at a share of the way, and the largest distance left [m].

        A dragged limb goes alone as far as it can; then the body goes, and the limbs that are held
        close in form: a straight knee then bends the way that knees bend, which Gauss–Newton from
        the old pose would not find.
        """
        model = frame.model
        wanted = [_part_of_the_way(frame, drag, share) for drag in drags]
        asked = lay_out(wanted, model, 1)
        alone = self._limbs_alone(frame, asked)
        if alone is not None:
            return alone
        qpos = self._follow(frame, asked)
        held = held.relaxed(frame.replace(qpos), np.ones(1), own)
        staying = held.constraints()
        if staying:
            targets = lay_out(staying, model, 1)
            closing = HybridIK(self.character, self.rigidity).prepare(targets).enforce(qpos)
            qpos = oplus(model, qpos, closing.displacement)
            qpos = self.character.within_limits(qpos)
        targets = lay_out([*staying, *wanted], model, 1)
        gap = float(residuals(frame.replace(qpos), targets).max(initial=0.0))
        if gap > REACHED:  # something is held that is no foot
            solver = NumericIK(self.character, self.rigidity, iterations=_POLISH)
            step = solver.prepare(targets).solve(qpos).displacement
            closer = self.character.within_limits(oplus(model, qpos, step))
            left = float(residuals(frame.replace(closer), targets).max(initial=0.0))
            qpos, gap = (closer, left) if left < gap else (qpos, gap)
        return qpos, gap

    def _limbs_alone(self, frame: Motion, targets: Targets) -> tuple[Array, float] | None:
        """Return the pose (1, nq) with its limbs closed, and the gap; None if they do not reach."""
        ends = [int(frame.model.site_bodyid[site]) for site in targets.sites]
        if not set(ends) <= set(self.character.limb_by_end) or len(set(ends)) < len(ends):
            return None
        closing = HybridIK(self.character, self.rigidity).prepare(targets).enforce(frame.qpos)
        qpos = self.character.within_limits(oplus(frame.model, frame.qpos, closing.displacement))
        left = float(residuals(frame.replace(qpos), targets).max(initial=0.0))
        return (qpos, left) if left <= REACHED else None

    def _follow(self, frame: Motion, targets: Targets) -> Array:
        """Return the pose (1, nq) whose joints go least to where sites are wanted, within limits.

        Gauss–Newton (§5.1) in short steps along the way: a body that folds up starts from a
        straight one, where long steps are far too long.
        """
        model = frame.model
        solver = NumericIK(self.character, self.rigidity, iterations=_ITERATIONS)
        start = site_positions(model, frame.qpos, targets.sites)
        way = targets.position - start
        if len(targets.sites) == 1 and model.site_bodyid[targets.sites[0]] == root_body(model):
            moved = frame.qpos.copy()  # where the root is dragged, it goes
            moved[:, :3] += way[:, 0]
            return moved
        longest = float(np.linalg.norm(way, axis=-1).max(initial=0.0))
        count = int(np.clip(np.ceil(longest / STEP), 1, _MOST_STEPS))
        qpos = frame.qpos
        for step in range(1, count + 1):
            part = dataclasses.replace(targets, position=start + step / count * way)
            so_far = Deviation(ominus(model, qpos, frame.qpos), np.ones(1, dtype=bool))
            change = solver.prepare(part).solve(qpos, deviation=so_far).displacement
            qpos = self.character.within_limits(oplus(model, qpos, change))
        return np.asarray(qpos)


def _part_of_the_way(frame: Motion, drag: SiteConstraint, share: float) -> SiteConstraint:
    site = np.array([site_id(frame.model, drag.site)])
    start = site_positions(frame.model, frame.qpos, site)[0]
    return dataclasses.replace(drag, position=start + share * (drag.position - start))
