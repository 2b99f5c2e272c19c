"""The first guess of §4.5: the root goes where the contacts go, before any joint is asked."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.bones import Bones
from mjmotion.body.kinematics import site_positions
from mjmotion.body.motion import Motion
from mjmotion.constraints import Targets
from mjmotion.numerics.bspline import fit_multilevel

Array = NDArray[np.float64]


def first_guess(
    motion: Motion,
    targets: Targets,
    guess: Array | bool,
    levels: Sequence[float],
    bones: Bones | None = None,
) -> Array:
    """Return poses (nframe, nq) from which a fit begins, coupled joints with their shares.

    Args:
      motion: the motion.
      targets: what is to hold.
      guess: the root's shift (nframe, 3) [m], True for :func:`contact_shift`, False for none.
      levels: frames a knot that the shift is fitted with.
      bones: a body for each frame, where it changes.
    """
    qpos = motion.character.coupling.couple(motion.qpos)
    if isinstance(guess, np.ndarray):
        qpos[:, :3] += guess
    elif guess and targets.contact.any():
        qpos[:, :3] += contact_shift(motion, targets, levels, bones)
    return qpos


def contact_shift(
    motion: Motion, targets: Targets, levels: Sequence[float], bones: Bones | None = None
) -> Array:
    """Return the root shift of §4.5 (nframe, 3) [m]: the contacts' average shift, smoothed."""
    mine = bones if bones is None else bones.at(targets.frames)
    sites = site_positions(motion.model, motion.qpos[targets.frames], targets.sites, mine)
    shift = targets.position - sites
    share = (targets.contact & (targets.position_weight > 0)).astype(float)
    count = share.sum(axis=1)
    has = count > 0
    mean = (shift * share[..., None]).sum(axis=1)[has] / count[has, None]
    return fit_multilevel(targets.frames[has], mean, motion.nframe, levels)
