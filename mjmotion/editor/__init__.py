"""The editor's page: drag a body, watch the clip deform (Figure 6).

    session = open_session("walk", "terrain_doors")
    serve(Intents(session), port=8080)

It draws and reads the mouse through MuJoCo Studio, which only ``plugin``, ``overlay``, ``panels``,
``timeline``, ``widgets`` and ``server`` import, and those are imported late. What a person can do
is in :class:`mjmotion.editor.intents.Intents`, which knows of no window.
"""

from __future__ import annotations

from mjmotion.editor.intents import Intents
from mjmotion.editor.opening import open_session, open_view

__all__ = ["Intents", "open_session", "open_view"]
