"""Morphing (Figure 5d): a body that changes from frame to frame, its stride as it was.

result = morph(motion, [(22, long_legs), (61, short_legs)])
result.motion, result.body, result.contacts, result.trace
"""

from mjmotion.apps.morph.fitting import fit_stride, morph
from mjmotion.apps.morph.stride import Stride, find_stride
from mjmotion.body.morph_body import MorphBody

__all__ = ["MorphBody", "Stride", "find_stride", "fit_stride", "morph"]
