"""A walk whose steps were moved keeps the way of its mass: the root makes up for the legs.

A pelvis sways against its own legs. Where these step shorter and lift higher the sway of the
recording makes up for nothing any more, and would shake the whole body about.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.kinematics import Kinematics
from mjmotion.body.mass import centre_of_mass
from mjmotion.body.motion import Motion
from mjmotion.constraints import Constraint
from mjmotion.fitting import Fit, default_levels, fit, whole
from mjmotion.footsteps.plan import Plan, shifted
from mjmotion.ik import IKSolver
from mjmotion.ik.solver import Clearance
from mjmotion.numerics.smoothing import follow

Array = NDArray[np.float64]

LEVELS_FROM = 1  # of the default levels the coarsest is left out: its knots are wider than a sway
ROUNDS = 2  # times that the root makes up for what the legs do
SLOW = 0.35  # what the mass does more slowly than this is left: it lies otherwise, on raised legs [s]
QUICK = 0.04  # and what it does more quickly: that is no sway [s]
MOST = 0.03  # the most that the root goes aside for it [m]
SHARE = 0.8  # of the way that it goes: the mass moves about as much as the root


def steadied(
    plan: Plan,
    result: Fit,
    asked: list[Constraint],
    solver: IKSolver,
    clearance: Clearance | None,
) -> Fit:
    """Return a fit whose mass sways as the recorded walk's does along the planned way.

    Only where steps were moved: ``c* = c_recorded + (root_planned − root_recorded)`` is the way of
    the mass over the legs, and the root goes by what the fitted mass is off that, within a band.

    Args:
      plan: what was asked for.
      result: the motion that was fitted to it.
      asked: all that is asked of it.
      solver: how.
      clearance: what to keep clear of.
    """
    if not plan.loose:
        return result
    recorded = plan.recorded or plan.source
    planned = plan.source.qpos[:, :3] + plan.root_shift
    wanted = _mass(recorded) + planned - recorded.qpos[:, :3]
    levels = default_levels(plan.source.fps)[LEVELS_FROM:]
    for _ in range(ROUNDS):
        off = _band(_mass(result.motion) - wanted, plan.source.fps)
        moved = shifted(result.motion, -SHARE * MOST * np.tanh(off / MOST))
        again = fit(
            moved, asked, levels=levels, ik=solver, clearance=clearance, first_guess=False
        )
        trace = whole((result.trace, again.trace))
        result = dataclasses.replace(again, trace=trace)
    return result


def _mass(motion: Motion) -> Array:
    """Return the centre of mass of every frame (nframe, 3) [m]."""
    return centre_of_mass(Kinematics(motion.model, motion.nframe).forward(motion.qpos))


def _band(values: Array, fps: float) -> Array:
    """Return what of curves (nframe, 3) is neither slow nor quick."""
    weight = np.ones(len(values))
    return follow(values - follow(values, weight, SLOW * fps), weight, QUICK * fps)
