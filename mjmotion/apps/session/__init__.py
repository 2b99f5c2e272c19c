"""Editing without a window: what the editor's page does, for scripts and tests (Figure 6)."""

from __future__ import annotations

from mjmotion.apps.session.applying import Step, apply
from mjmotion.apps.session.edits import Drag, Edit, Footprint, Pin, Settings
from mjmotion.apps.session.file import clip_hash, load_session, save_session
from mjmotion.apps.session.history import State
from mjmotion.apps.session.session import EditSession

__all__ = [
    "Drag",
    "Edit",
    "EditSession",
    "Footprint",
    "Pin",
    "Settings",
    "State",
    "Step",
    "apply",
    "clip_hash",
    "load_session",
    "save_session",
]
