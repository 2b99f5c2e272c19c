"""Direct manipulation (§4.4, Figure 2): one frame changes, and the frames around follow smoothly.

edited = edit_frame(motion, 60, "pelvis", by=(0.0, 0.0, -0.15), levels=(12, 6, 3))
edited.motion, edited.source, edited.unmet
deformation(edited)                     # (nframe,) how far each frame was moved [m]
"""

from __future__ import annotations

from mjmotion.apps.edit.frame import deformation, edit_frame
from mjmotion.apps.edit.hold import HOLDS, Hold
from mjmotion.apps.edit.span import Span

__all__ = ["HOLDS", "Hold", "Span", "deformation", "edit_frame"]
