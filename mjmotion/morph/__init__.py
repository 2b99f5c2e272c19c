"""Morphing (Figure 5d): a body that changes from frame to frame, its stride as it was.

result = morph(motion, [(22, long_legs), (61, short_legs)])
result.motion, result.body, result.contacts, result.trace
"""

from mjmotion.morph.body import MorphBody
from mjmotion.morph.fitting import Morph, body_of, fit_stride, morph
from mjmotion.morph.stride import Stride, find_stride

__all__ = ["Morph", "MorphBody", "Stride", "body_of", "find_stride", "fit_stride", "morph"]
