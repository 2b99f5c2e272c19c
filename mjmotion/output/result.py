"""What every application returns: a motion, what it came from, and what could not be met."""

from __future__ import annotations

import dataclasses

from mjmotion.body.morph_body import MorphBody
from mjmotion.body.motion import Motion
from mjmotion.constraints.unmet import Unmet
from mjmotion.fitting import Trace
from mjmotion.footsteps.contacts import Contact


@dataclasses.dataclass(frozen=True, eq=False)
class Result:
    """A motion that was adapted, retargeted, morphed, joined or edited.

    Attributes:
      source: the motion before, on the composed model, placed at the scene's start.
      motion: the motion after, the same frames.
      contacts: who stands when.
      trace: what the fit did.
      unmet: constraints that could not be met.
      body: the body of every frame, where that changes (a morph).
    """

    source: Motion
    motion: Motion
    contacts: tuple[Contact, ...]
    trace: Trace
    unmet: tuple[Unmet, ...]
    body: MorphBody | None = None
