"""What a user names, opened for editing or for looking.

session, name = open_session("walk", "terrain_doors")
shown = open_view("out/walk")
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mjmotion.apps.adaptation import as_clip
from mjmotion.apps.session import EditSession, load_session
from mjmotion.editor.shown import Shown
from mjmotion.exceptions import SessionError
from mjmotion.footsteps.contacts import detect_contacts
from mjmotion.output.reading import check_folder_alone, read_motion, read_results
from mjmotion.scene import compose, with_ground

DEMO = "demo"
DEMO_CLIP, DEMO_SCENE = "walk", "terrain_doors"
SESSION_SUFFIX = ".mjsession"


def open_session(
    what: str, scene: str | None = None, character: str | None = None
) -> tuple[EditSession, str]:
    """Return what a user named as a session, and what stands for it when changes are kept aside.

    Args:
      what: a clip's file or built-in name, a result folder, a session's file, or ``"demo"``.
      scene: a file or built-in name: the clip is adapted to it first.
      character: what names the body of a clip's file.

    Raises:
      MotionError: it cannot be read, or cannot be adapted.
    """
    if what == DEMO and not Path(what).exists():
        if scene is not None or character is not None:
            raise SessionError("demo is the walk on terrain with doors: leave --scene, --character")
        return EditSession(DEMO_CLIP, DEMO_SCENE), DEMO
    if what.endswith(SESSION_SUFFIX):
        if scene is not None or character is not None:
            raise SessionError(
                f"'{what}' is a session and names its own scene and character: leave them"
            )
        return load_session(what), what
    motion, contacts = read_motion(what, character)
    session = EditSession(
        motion, scene, contacts=contacts, name=what, character=character or "humanoid"
    )
    return session, what


def open_view(
    what: str, scene: str | None = None, character: str | None = None, **reading: Any
) -> Shown:
    """Return what a user named, to look at.

    Args:
      what: a result folder, or a motion's file or built-in name.
      scene: where a motion is shown, as it is; on level ground without. A folder has its own.
      character: what names the body of a motion's file.
      reading: how a recording is read, as :func:`mjmotion.load_clip` takes it.

    Raises:
      MotionError: it cannot be read.
    """
    if Path(what).is_dir():
        if scene is not None or character is not None:
            raise SessionError(f"'{what}' is a result folder with its own scene: leave --scene")
        check_folder_alone(what, reading)
        result = read_results(what)
        return Shown(result.source, result.motion, result.contacts)
    motion, contacts = read_motion(what, character, **reading)
    body = (
        with_ground(motion.character)
        if scene is None
        else compose(as_clip(motion).character, scene)
    )
    motion = motion.on(body)
    if contacts is None:
        contacts = detect_contacts(motion) if Shown(motion, motion, ()).feet else ()
    return Shown(motion, motion, tuple(contacts))
