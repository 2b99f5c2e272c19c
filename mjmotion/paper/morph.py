"""Character morphing, Figure 5(d): long legs, then short ones, in 62 frames of one uniform stride.

job = make_job()
result = job.fit()

The walk is the built-in one at a brisk cadence, of which 62 frames are cut out: 5 stances, 70
frames of them, so that 420 scalar constraints hold the feet (position and orientation of a foot at
every frame that it stands).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mjmotion.apps.adaptation import stiff_root
from mjmotion.apps.clearing import FitSettings
from mjmotion.apps.morph import MorphBody, Stride, find_stride, fit_stride
from mjmotion.body.character import CharacterLike
from mjmotion.body.motion import Motion
from mjmotion.body.proportions import Proportions, make_character
from mjmotion.clips.gait import make_walk
from mjmotion.clips.gait_plan import Segment
from mjmotion.fitting import Fit
from mjmotion.footsteps.contacts import Contact, detect_contacts
from mjmotion.ik.solver import IKSolver
from mjmotion.paper.job import LEVELS, Job

Array = NDArray[np.float64]

FRAMES = 62  # of Table 1
STRIDE, CADENCE = 1.1, 1.15  # [m], strides a second
DUTY = 0.58  # share of a stride that a foot stands
FIRST = 42  # frame of the whole walk that the job begins with
STRIDES = 6.0  # of the whole walk

KEYS: tuple[tuple[int, Mapping[str, float]], ...] = (
    (20, MappingProxyType({"legs": 1.5, "torso": 0.6, "arms": 0.8})),
    (52, MappingProxyType({"legs": 0.6, "torso": 1.5, "arms": 1.2})),
)
"""Frames and what the body is then, as factors of the walk's own."""


class Walk(NamedTuple):
    """A walk and who stands in it when."""

    motion: Motion
    contacts: tuple[Contact, ...]


def paper_walk(character: CharacterLike = "humanoid") -> Walk:
    """Return the paper's 62 frames of a walk.

    Args:
      character: the humanoid, or one of its joints.

    Raises:
      ModelError: no such character, or it lacks joints of the humanoid.
    """
    whole = make_walk(
        character,
        segments=[Segment("straight", STRIDES)],
        stride=STRIDE,
        speed=STRIDE * CADENCE,
        duty=DUTY,
    )
    # Contacts are those of the whole walk: the ends of a window are no begin of a stance.
    contacts = tuple(
        Contact(one.site, max(one.start - FIRST, 0), min(one.end - FIRST, FRAMES))
        for one in detect_contacts(whole)
        if one.end > FIRST and one.start < FIRST + FRAMES
    )
    return Walk(whole.replace(whole.qpos[FIRST : FIRST + FRAMES]), contacts)


def paper_body(walk: Walk) -> MorphBody:
    """Return the body that changes as the paper's does: long legs, then short ones."""
    keys = [
        (frame, make_character(walk.motion.character, Proportions(**factors)).model)
        for frame, factors in KEYS
    ]
    return MorphBody.between(walk.motion.model, keys, walk.motion.nframe)


@dataclasses.dataclass(frozen=True, eq=False)
class MorphJob(Job):
    """The job, fitted as :func:`mjmotion.apps.morph.morph` does it, with its own exact pass.

    Attributes:
      stride: what the feet do.
      body: the body of every frame.
    """

    stride: Stride | None = None
    body: MorphBody | None = None

    def fit(
        self, ik: str | IKSolver = "hybrid", levels: Sequence[float] = LEVELS, **more: Any
    ) -> Fit:
        """Fit the motion; ``more`` is what the job's parts would be in ``fit``.

        With settings of one's own it is the plain fit, from the root's shift.
        """
        if more or not isinstance(ik, str) or self.stride is None or self.body is None:
            return super().fit(ik, levels, **more)
        settings = FitSettings(levels, tolerance=0.0, ik=ik)
        return fit_stride(self.stride, self.body, settings)


def make_job() -> MorphJob:
    """Return the job: 62 frames, 20 parameters (8 reduced), 420 scalar constraints."""
    walk = paper_walk()
    body = paper_body(walk)
    stride = find_stride(walk.motion, body, walk.contacts)
    return MorphJob(
        "character morphing",
        walk.motion,
        tuple(stride.constraints()),
        first_guess=stride.shift,
        rigidity=stiff_root(walk.motion.character),
        bones=body.bones,
        contacts=walk.contacts,
        stride=stride,
        body=body,
    )
