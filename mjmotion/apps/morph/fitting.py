"""Morphing a walk: the character's size changes as it walks, its stride does not (Figure 5d).

    keys = [(22, long_legs), (61, short_legs)]       # frames and characters of the same topology
    result = morph("walk", keys)
    result.motion, result.body, result.contacts, result.trace

One fit over all frames, each on a body of its own: feet are held while they stand, nothing else is
asked (six scalar constraints a foot and frame), and what stands between two contacts follows by the
splines. The last pass closes the legs, see :mod:`mjmotion.apps.morph.landing`.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Sequence
from pathlib import Path

from mjmotion.apps.adaptation import as_clip, stiff_root
from mjmotion.apps.clearing import FitSettings
from mjmotion.apps.morph.landing import landed
from mjmotion.apps.morph.stride import Stride, find_stride
from mjmotion.body.character import Character, CharacterLike
from mjmotion.body.morph_body import MorphBody
from mjmotion.body.motion import Motion
from mjmotion.constraints import lay_out
from mjmotion.constraints.unmet import find_unmet, residuals
from mjmotion.fitting import TOLERANCE, Fit, fit
from mjmotion.footsteps.contacts import Contact
from mjmotion.ik import IKSolver, make_solver
from mjmotion.numerics.progress import Progress, no_progress
from mjmotion.output.result import Result
from mjmotion.scene import with_ground


def morph(
    motion: Motion | str | Path,
    keys: Sequence[tuple[int, CharacterLike]],
    *,
    contacts: Sequence[Contact] | None = None,
    levels: Sequence[float] | None = None,
    tolerance: float = TOLERANCE,
    ik: str | IKSolver = "hybrid",
    progress: Progress = no_progress,
) -> Result:
    """Change the size of a walk's character from frame to frame and keep its stride.

    Args:
      motion: the walk, on level ground at z = 0; or a file or built-in name.
      keys: frames, rising, and the character whose sizes the body has then, or what names one; all
        of the motion's topology. Before the first the body comes from the motion's own, after the
        last it stays.
      contacts: who stands when; found in the walk without.
      levels: frames a knot of each level, coarse to fine.
      tolerance: refinement stops once no position is off by more [m].
      ik: ``"hybrid"``, ``"numeric"`` or a solver made for the body that changes.
      progress: called with stage, done, of.

    Raises:
      MotionError: no keys, or frames that do not rise or that the motion does not have.
      ModelError: a model of another topology, or a character without feet.
      ClipError, ContactError, FitError: bad input.
    """
    walk = as_clip(motion)
    models = [(frame, Character.of(character).model) for frame, character in keys]
    body = MorphBody.between(walk.model, models, walk.nframe)
    composed = with_ground(walk.character)
    progress("contacts", 0, 0)
    stride = find_stride(walk, body, contacts)
    progress("fit", 0, 0)
    result = fit_stride(stride, body, FitSettings(levels, tolerance, ik, progress))
    return Result(
        walk.on(composed),
        result.motion.on(composed),
        stride.contacts,
        result.trace,
        result.unmet,
        body.on(composed.model),
    )


def fit_stride(stride: Stride, body: MorphBody, settings: FitSettings | None = None) -> Fit:
    """Fit a body that changes to a stride: first guess, levels, exact pass.

    Args:
      stride: what the feet do.
      body: the body of every frame, on the stride's model.
      settings: how it is fitted.

    Returns:
      What the fit gave, with the motion of the exact pass and the errors that this left.
    """
    settings = FitSettings() if settings is None else settings
    began = time.perf_counter()
    constraints, bones, character = stride.constraints(), body.bones, stride.source.character
    result = fit(
        stride.source,
        constraints,
        levels=settings.levels,
        tolerance=settings.tolerance,
        ik=make_solver(character, settings.ik, stiff_root(character), bones),
        first_guess=stride.shift,
        exact=False,
        progress=settings.progress,
    )
    done = landed(
        result.motion, body, stride.tracks, make_solver(character, settings.ik, bones=bones)
    )
    took = time.perf_counter() - began
    targets = lay_out(constraints, done.model, done.nframe)
    left = float(residuals(done, targets, bones).max(initial=0.0))
    trace = dataclasses.replace(
        result.trace, fit_seconds=took, exact_error_percent=100.0 * left / character.height
    )
    unmet = find_unmet(done, targets, constraints, bones)
    return dataclasses.replace(result, motion=done, trace=trace, unmet=unmet)
