"""Morphing (Figure 5d): a body that changes from frame to frame, its stride as it was."""

from mjmotion.morph.body import MorphBody

__all__ = ["MorphBody"]
