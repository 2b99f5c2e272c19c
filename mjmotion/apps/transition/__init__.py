"""Transitions: one clip goes over into the next, and no foot slides (§6, Figure 5e).

result = transition(walk, sneak)
result = join([walk, sneak, walk])
result.source, result.motion      # the blend before the fit, and after
"""

from __future__ import annotations

from mjmotion.apps.transition.blending import Blend, blend
from mjmotion.apps.transition.joining import (
    Joined,
    Place,
    blend_clips,
    join,
    keep_contacts,
    transition,
)
from mjmotion.apps.transition.overlap import Overlap, find_overlap
from mjmotion.apps.transition.sampling import resample, resample_contacts
from mjmotion.body.sampling import sample
from mjmotion.apps.transition.warp import Warp, find_warp

__all__ = [
    "Blend",
    "Joined",
    "Overlap",
    "Place",
    "Warp",
    "blend",
    "blend_clips",
    "find_overlap",
    "find_warp",
    "join",
    "keep_contacts",
    "resample",
    "resample_contacts",
    "sample",
    "transition",
]
