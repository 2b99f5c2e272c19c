"""The edited frame on its own: the whole pose that a drag asks for, or comes nearest to it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mjmotion.apps.edit.hold import Held
from mjmotion.body.kinematics import Kinematics, body_dofs, site_id, site_positions
from mjmotion.body.motion import Motion
from mjmotion.constraints import SiteConstraint, Targets, lay_out
from mjmotion.constraints.unmet import residuals
from mjmotion.ik.hybrid import HybridIK
from mjmotion.ik.numeric import NumericIK
from mjmotion.ik.solver import default_rigidity
from mjmotion.numerics.tangent import oplus

Array = NDArray[np.float64]

REACHED = 5e-4  # what may be left of a drag, or of a foot, before the drag counts as too far [m]
_STEPS = 40  # trust-region steps of the body
_POLISH = 8  # Gauss–Newton steps of the whole pose
_INSIST = (30.0, 1e4)  # what an error counts against as much change of a joint, in turn [1/m]
_TINY = 1e-6  # a change by which slopes are found
_ROUNDS = 7  # halvings of the way in which the furthest pose is looked for


def drag_pose(frame: Motion, held: Held, drags: Sequence[SiteConstraint]) -> tuple[Array, float]:
    """Return the pose (1, nq) that drags ask for, and what share of their way it goes.

    What is held goes before: where the whole drag would take it away, the drag is followed as far
    as nothing gives.

    Args:
      frame: the pose, as a motion of one frame.
      held: what stays, at frame 0.
      drags: where sites are to be, at frame 0.
    """
    found, gap = _pose(frame, held, drags, 1.0)
    if gap <= REACHED:
        return found, 1.0
    found, low, high = frame.qpos, 0.0, 1.0
    for _ in range(_ROUNDS):
        share = 0.5 * (low + high)
        pose, gap = _pose(frame, held, drags, share)
        if gap <= REACHED:
            found, low = pose, share
        else:
            high = share
    return found, low


def _pose(
    frame: Motion, held: Held, drags: Sequence[SiteConstraint], share: float
) -> tuple[Array, float]:
    """Return the pose (1, nq) at a share of the way, and the largest distance from a target [m].

    The body goes first and the limbs that are held close in form: a straight knee then bends the
    way that knees bend, which Gauss–Newton from the old pose would not find.
    """
    model = frame.model
    wanted = [_part_of_the_way(frame, drag, share) for drag in drags]
    qpos = _follow(frame, lay_out(wanted, model, 1))
    held = held.relaxed(frame, frame.replace(qpos), np.ones(1))
    staying = held.constraints()
    if staying:
        targets = lay_out(staying, model, 1)
        closing = HybridIK(frame.character).prepare(targets).enforce(qpos)
        qpos = oplus(model, qpos, closing.displacement)
        qpos = frame.character.within_limits(qpos)
    targets = lay_out([*staying, *wanted], model, 1)
    gap = float(residuals(frame.replace(qpos), targets).max(initial=0.0))
    if gap > REACHED:  # something is held that is no foot
        solver = NumericIK(frame.character, iterations=_POLISH)
        step = solver.prepare(targets).solve(qpos).displacement
        closer = frame.character.within_limits(oplus(model, qpos, step))
        left = float(residuals(frame.replace(closer), targets).max(initial=0.0))
        qpos, gap = (closer, left) if left < gap else (qpos, gap)
    return qpos, gap


def _follow(frame: Motion, targets: Targets) -> Array:
    """Return the pose (1, nq) whose joints go least to where sites are wanted, within limits.

    Trust-region least squares (§5.1 with the penalties of Eq. 6), because a body that folds up
    starts from a straight one: there Gauss–Newton steps are far too long.
    """
    from scipy.optimize import least_squares

    model, limits = frame.model, frame.character.limits
    shares = frame.character.coupling
    moves = [body_dofs(model, int(model.site_bodyid[site])) for site in targets.sites]
    serving = np.any(moves, axis=0)
    serving[shares.leader] |= serving[shares.follower]
    serving[shares.follower] = False
    free = np.flatnonzero(serving)
    sqrt_rigidity = np.sqrt(shares.rigidity(default_rigidity(model)))
    was = limits.excess(frame.qpos)[0]

    kinematics = Kinematics(model, len(free) + 1)

    def moved(steps: Array) -> Array:
        whole = np.zeros((len(steps), model.nv))
        whole[:, free] = steps / sqrt_rigidity[free]
        start = np.repeat(frame.qpos, len(steps), axis=0)
        return shares.couple(oplus(model, start, shares.spread(whole)))

    def cost(steps: Array, insist: float) -> Array:
        qpos = moved(steps)
        pose = kinematics.forward(qpos, np.arange(len(qpos)))
        gap = (pose.site_xpos[:, targets.sites] - targets.position).reshape(len(qpos), -1)
        over = np.maximum(limits.excess(qpos) - was, 0.0)
        return np.concatenate((steps, insist * gap, insist * over), axis=1)

    def slope(step: Array, insist: float) -> Array:
        # All columns at once: the frames of one batch.
        rows = cost(
            step + np.concatenate((np.zeros((1, len(free))), _TINY * np.eye(len(free)))), insist
        )
        return np.asarray((rows[1:] - rows[0]).T / _TINY)

    step = np.zeros(len(free))
    for insist in _INSIST:
        step = least_squares(
            lambda step, insist: cost(step[None], insist)[0],
            step,
            slope,
            args=(insist,),
            max_nfev=_STEPS,
        ).x
    return moved(step[None])


def _part_of_the_way(frame: Motion, drag: SiteConstraint, share: float) -> SiteConstraint:
    site = np.array([site_id(frame.model, drag.site)])
    start = site_positions(frame.model, frame.qpos, site)[0]
    return dataclasses.replace(drag, position=start + share * (drag.position - start))
