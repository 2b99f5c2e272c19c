"""Retargeting: a motion on a character of other proportions, with its contacts kept.

    result = retarget(load_clip("walk"), "climber", stride="keep")
    result.motion, result.source, result.contacts

The pieces are there on their own, for motions whose constraints are given:

    guess = copy_joints(motion, model)                  # joint angles copied
    shift = held_shift(guess, constraints)              # first guess of §4.5
    fitted = fit(guess, constraints, first_guess=shift)
"""

from mjmotion.apps.retarget.copying import carry_root, copy_joints, leg_ratio, mid_hips
from mjmotion.apps.retarget.grasps import check_span, held_shift, hold_constraints
from mjmotion.apps.retarget.moving import STRIDES, plan_retarget, retarget
from mjmotion.apps.retarget.roles import map_bones, with_soles
from mjmotion.apps.retarget.strides import Placed, Strides

__all__ = [
    "STRIDES",
    "Placed",
    "Strides",
    "carry_root",
    "check_span",
    "copy_joints",
    "held_shift",
    "hold_constraints",
    "leg_ratio",
    "map_bones",
    "mid_hips",
    "plan_retarget",
    "retarget",
    "with_soles",
]
