"""Morphing a walk: the character's size changes as it walks, its stride does not (Figure 5d).

    keys = [(22, long_legs), (61, short_legs)]            # frames and models of the same topology
    result = morph(load_clip("walk"), keys)
    result.motion, result.body, result.contacts, result.trace

One fit over all frames, each on a body of its own: feet are held while they stand, nothing else is
asked (six scalar constraints a foot and frame), and what stands between two contacts follows by the
splines. The last pass closes the legs, see :mod:`mjmotion.apps.morph.landing`.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.apps.adaptation import stiff_root
from mjmotion.apps.morph.landing import landed
from mjmotion.apps.morph.stride import Stride, find_stride
from mjmotion.body.kinematics import character_height
from mjmotion.body.morph_body import MorphBody
from mjmotion.body.motion import Motion
from mjmotion.constraints import lay_out
from mjmotion.fitting import Fit, find_unmet, fit, residuals
from mjmotion.footsteps.contacts import Contact
from mjmotion.output.result import Result
from mjmotion.scene import with_ground

Array = NDArray[np.float64]


def morph(
    motion: Motion,
    keys: Sequence[tuple[int, mujoco.MjModel]],
    *,
    character: str | Path = "humanoid",
    contacts: Sequence[Contact] | None = None,
    levels: Sequence[float] | None = None,
    tolerance: float = 0.0,
    ik: str = "hybrid",
    progress: Callable[[str], None] | None = None,
) -> Result:
    """Change the size of a walk's character from frame to frame and keep its stride.

    Args:
      motion: the walk, on level ground at z = 0.
      keys: frames, rising, and the model whose sizes the body has then; all of the motion's
        topology. Before the first the body comes from the motion's own, after the last it stays.
      character: the MJCF of the motion's model, or the name of one of ours: what is written with
        the result.
      contacts: who stands when; found in the walk without.
      levels: frames a knot, coarse to fine.
      tolerance: refinement stops once no constraint is off by more [m].
      ik: ``"hybrid"`` or ``"numeric"``.
      progress: called with the name of each stage as it begins.

    Raises:
      MotionError: no keys, or frames that do not rise or that the motion does not have.
      ModelError: a model of another topology, or a character without feet.
      ContactError, FitError: bad input.
    """
    say = progress or (lambda stage: None)
    body = MorphBody.between(motion.model, keys, motion.nframe)
    spec = with_ground(character)
    composed = spec.compile()
    say("contacts")
    stride = find_stride(motion, body, contacts)
    say("fit")
    result = fit_stride(stride, body, levels=levels, tolerance=tolerance, ik=ik)
    return Result(
        motion.on(composed),
        result.motion.on(composed),
        stride.contacts,
        result.trace,
        result.unmet,
        spec,
        body.on(composed),
    )


def fit_stride(
    stride: Stride,
    body: MorphBody,
    *,
    levels: Sequence[float] | None = None,
    tolerance: float = 0.0,
    ik: str = "hybrid",
) -> Fit:
    """Fit a body that changes to a stride: first guess, levels, exact pass.

    Args:
      stride: what the feet do.
      body: the body of every frame, on the stride's model.
      levels: frames a knot, coarse to fine.
      tolerance: refinement stops once no position is off by more [m].
      ik: ``"hybrid"`` or ``"numeric"``.

    Returns:
      What the fit gave, with the motion of the exact pass and the errors that this left.
    """
    began = time.perf_counter()
    constraints, bones = stride.constraints(), body.bones
    result = fit(
        stride.source,
        constraints,
        levels=levels,
        tolerance=tolerance,
        ik=ik,
        weights=stiff_root(stride.source.model),
        first_guess=stride.shift,
        exact=False,
        bones=bones,
    )
    done = landed(result.motion, body, stride.tracks, ik)
    took = time.perf_counter() - began
    targets = lay_out(constraints, done.model, done.nframe)
    left = residuals(done, targets, bones)
    percent = 100.0 * float(left.max(initial=0.0)) / character_height(done.model)
    trace = dataclasses.replace(
        result.trace,
        fit_seconds=took,
        exact_error_percent=percent,
    )
    unmet = find_unmet(done, targets, left, bones=bones)
    return dataclasses.replace(result, motion=done, trace=trace, unmet=unmet)
