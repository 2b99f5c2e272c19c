"""The edited frame on its own: the whole pose that a drag asks for, or comes nearest to it.

What is dragged moves most: an arm or a leg reaches for its hand or foot before the body follows.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mjmotion.apps.edit.hold import Held, Paths
from mjmotion.apps.edit.one_pose import OnePose, goals_of
from mjmotion.body.character import Character
from mjmotion.body.kinematics import body_dofs, root_body, site_id
from mjmotion.body.motion import Motion
from mjmotion.constraints import SiteConstraint, Targets, lay_out
from mjmotion.ik.hybrid import HybridIK
from mjmotion.ik.solver import default_rigidity
from mjmotion.numerics.tangent import ominus, oplus

Array = NDArray[np.float64]

REACHED = 5e-4  # what may be left of a drag, or of a foot, before the drag counts as too far [m]
TRUNK_STIFFNESS = 30.0  # how much stiffer what carries limbs is while a limb is dragged
STRIDE = 0.06  # the way of a drag is gone in steps no longer than this [m]
_MOST_STRIDES = 8
_SETTLE = 3  # Gauss–Newton steps after the last stride
_POLISH = 8  # Gauss–Newton steps of the whole pose
LEVER = 0.1  # from a foot's middle to its ends, about [m]
NEAR = 0.05  # what is off by more is not settled by Gauss–Newton [m]
_SHARES = 12  # places of a way that are looked at together
_BACK = (1.0, 0.97, 0.93, 0.85, 0.7, 0.4)  # shares of a way until one keeps what is held


@dataclasses.dataclass(frozen=True, eq=False)
class PoseSolver:
    """Finds poses in which sites are where they are dragged to; for one thread.

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
    ) -> tuple[Array, bool]:
        """Return the pose (1, nq) that drags ask for, and whether it comes there.

        What is held goes before: where the whole drag would take it away, the drag is followed as
        far as nothing gives. The time is bounded, wherever the drag goes.

        A dragged limb goes alone as far as it can; then the body goes, and the limbs that are held
        close in form: a straight knee then bends the way that knees bend, which Gauss–Newton from
        the old pose would not find. What is still off then is settled together, and what is held
        before what is dragged.

        Args:
          frame: the pose, as a motion of one frame.
          held: what stays, at frame 0.
          drags: where sites are to be, at frame 0.
          own: what :meth:`Held.own` returns, where it is known already.
        """
        own = held.own(frame) if own is None else own
        model = frame.model
        asked = lay_out(drags, model, 1)
        alone = self._limbs_alone(frame, asked)
        if alone is not None:
            return alone, True
        whole = self._follow(frame, asked)
        eased = held.relaxed(frame.put(whole), np.ones(1), own)
        staying = lay_out(eased.constraints(), model, 1)
        pose = self._closed(self._closed(whole, staying), self._on_limbs(asked))
        pose, off = self._settled(pose, staying, asked)
        if off <= REACHED:
            return pose, self._gap(pose, asked) <= REACHED
        return self._as_far(frame, whole, held, asked, own), False

    def _as_far(self, frame: Motion, whole: Array, held: Held, asked: Targets, own: Paths) -> Array:
        """Return the pose (1, nq) furthest on the way to ``whole`` (1, nq) that keeps what is held.

        The limbs say how far they reach, at many places of the way at once; then heels rise that
        must, and a dragged limb points at where it is to go.
        """
        model = frame.model
        way = ominus(model, whole, frame.qpos)
        staying = lay_out(held.constraints(), model, 1)
        share = self._share(frame.qpos, way, staying)
        for back in _BACK:
            pose = oplus(model, frame.qpos, back * share * way)
            pose, off = self._standing(frame, pose, held, asked, own)
            if off <= REACHED:
                break
        else:
            return np.array(frame.qpos)
        if self._is_root(asked):
            return pose
        goals = [*goals_of(staying), *goals_of(asked, soft=True)]
        closer = self._one.solve(pose[0], goals, _POLISH, STRIDE)[None]
        closer, off = self._standing(frame, closer, held, asked, own)
        better = off <= REACHED and self._gap(closer, asked) < self._gap(pose, asked)
        return closer if better else pose

    def _standing(
        self, frame: Motion, pose: Array, held: Held, asked: Targets, own: Paths
    ) -> tuple[Array, float]:
        """Return a pose (1, nq) with its limbs closed, and how far what is held is off [m]."""
        eased = held.relaxed(frame.put(pose), np.ones(1), own)
        staying = lay_out(eased.constraints(), frame.model, 1)
        pose = self._closed(self._closed(pose, staying), self._on_limbs(asked))
        return pose, self._gap(pose, staying)

    def _is_root(self, asked: Targets) -> bool:
        model = self.character.model
        return len(asked.sites) == 1 and model.site_bodyid[asked.sites[0]] == root_body(model)

    def _settled(self, pose: Array, staying: Targets, asked: Targets) -> tuple[Array, float]:
        """Return a pose (1, nq) that keeps what stays, and how far that is off [m].

        Gauss–Newton where closing limbs does not do, such as where something is held that is on
        none, while that is not hopeless.
        """
        off = self._gap(pose, staying)
        left = self._gap(pose, asked)
        if off > NEAR or max(off, left) <= REACHED or len(staying.frames) == 0:
            return pose, off
        goals = [*goals_of(staying), *goals_of(asked, soft=True)]
        closer = self._closed(self._one.solve(pose[0], goals, _POLISH, STRIDE)[None], staying)
        gap = self._gap(closer, staying)
        if gap <= REACHED and (off > REACHED or self._gap(closer, asked) < left):
            return closer, gap
        return pose, off

    def _share(self, start: Array, way: Array, staying: Targets) -> float:
        """Return the largest share of a way (1, nv) from a pose (1, nq) at which limbs reach."""
        if len(staying.frames) == 0:
            return 1.0
        model, low, high = self.character.model, 0.0, 1.0
        every = staying.at(np.zeros(_SHARES, np.int64))
        problem = HybridIK(self.character, self.rigidity).prepare(every)
        for _ in range(2):
            shares = low + (high - low) * (np.arange(_SHARES) + 1.0) / _SHARES
            poses = oplus(model, np.tile(start, (_SHARES, 1)), shares[:, None] * way)
            closed = oplus(model, poses, problem.enforce(poses).displacement)
            reach = [self._gap(pose[None], staying) <= REACHED for pose in closed]
            count = reach.index(False) if False in reach else _SHARES
            low, high = (float(one) for one in (low, *shares, high)[count : count + 2])
        return low

    def _on_limbs(self, asked: Targets) -> Targets:
        """Return those targets that are on limbs' ends."""
        bodies = self.character.model.site_bodyid[asked.sites]
        return asked.columns(np.isin(bodies, list(self.character.limb_by_end)))

    @cached_property
    def _one(self) -> OnePose:
        return OnePose(self.character, self.rigidity)

    def positions(self, qpos: Array, sites: NDArray[np.int64]) -> Array:
        """Return where sites (s,) are in a pose (1, nq): (s, 3) [m]."""
        return self._one.positions(qpos[0], sites)

    def _gap(self, qpos: Array, targets: Targets) -> float:
        """Return how far the worst site of targets at one frame is off [m], turns at a foot's end.

        A foot that is not turned as it is to be has its heel or toe elsewhere.
        """
        if len(targets.frames) == 0 or len(targets.sites) == 0:
            return 0.0
        return self._one.off(qpos[0], goals_of(targets), LEVER)

    def _closed(self, qpos: Array, staying: Targets) -> Array:
        """Return the pose (1, nq) with the limbs that are held closed in form, within limits."""
        if len(staying.frames) == 0 or len(staying.sites) == 0:
            return qpos
        closing = HybridIK(self.character, self.rigidity).prepare(staying).enforce(qpos)
        return self.character.within_limits(oplus(self.character.model, qpos, closing.displacement))

    def _limbs_alone(self, frame: Motion, asked: Targets) -> Array | None:
        """Return the pose (1, nq) with its limbs closed; None if they do not reach."""
        ends = [int(frame.model.site_bodyid[site]) for site in asked.sites]
        if not set(ends) <= set(self.character.limb_by_end) or len(set(ends)) < len(ends):
            return None
        qpos = self._closed(frame.qpos, asked)
        return qpos if self._gap(qpos, asked) <= REACHED else None

    def _follow(self, frame: Motion, asked: Targets) -> Array:
        """Return the pose (1, nq) whose joints go least to where sites are wanted, within limits.

        Gauss–Newton in short strides along the way: a body that folds up starts from a straight
        one, where long steps are far too long.
        """
        way = asked.position[0] - self.positions(frame.qpos, asked.sites)
        if self._is_root(asked):
            moved = frame.qpos.copy()  # where the root is dragged, it goes
            moved[:, :3] += way
            return moved
        longest = float(np.linalg.norm(way, axis=-1).max(initial=0.0))
        count = int(np.clip(np.ceil(longest / STRIDE), 1, _MOST_STRIDES)) + _SETTLE
        return self._one.solve(frame.qpos[0], goals_of(asked, soft=True), count, STRIDE)[None]
