"""The keyboard: which key does what, by name, without a window."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from mjmotion.editor.files import Files
from mjmotion.editor.intents import LONG_STEP, Intents

Act = Callable[[Intents, Files], None]

HELP = (
    "Drag: turn the camera; right drag: move it; wheel: zoom.",
    "Ctrl-click: select the nearest site of a body, with handles.",
    "Ctrl-drag: move a body; a standing foot's whole footprint; a door or box of the scene.",
    "Drag a handle: along x, y or z, or turn a footprint (ring).",
    "Space: play, pause. Left, Right: a frame; with Shift ten. Home, End.",
    "Up, Down: speed. L: loop. G: source. T: paths. M: marks. F: follow.",
    "Ctrl+Z: undo. Ctrl+Y, Ctrl+Shift+Z: redo. Delete: delete the chosen edit.",
    "P: pin the selected site around this frame. [ ]: frames a knot.",
    "Ctrl+S: save the session. Escape: put back what is in the hand, select nothing.",
    "Timeline: drag to scrub; drag the ends of a contact; drag along the row of pins to pin.",
)


def _seek(frames: int) -> Act:
    return lambda do, _: do.clock.step(frames) if do.dragged is None else None


def _flip(name: str) -> Act:
    return lambda do, _: setattr(do, name, not getattr(do, name))


def _loop(do: Intents, _: Files) -> None:
    do.clock.loop = not do.clock.loop


def _home(do: Intents, _: Files) -> None:
    do.seek(0)


def _end(do: Intents, _: Files) -> None:
    do.seek(do.clock.nframe - 1)


def _knots(by: int) -> Act:
    def change(do: Intents, _: Files) -> None:
        do.set_settings(frames_per_knot=max(1, do.settled.settings.frames_per_knot + by))

    return change


def _delete(do: Intents, _: Files) -> None:
    if do.chosen >= 0:
        do.delete(do.chosen)


def _pin(do: Intents, _: Files) -> None:
    reach = do.settled.settings.frames_per_knot
    do.pin(do.frame - reach, do.frame + reach + 1)


# Key, whether with Ctrl, whether with Shift; names are ImGui's.
BINDINGS: Mapping[tuple[str, bool, bool], Act] = {
    ("Space", False, False): lambda do, _: do.clock.play(not do.clock.playing),
    ("LeftArrow", False, False): _seek(-1),
    ("RightArrow", False, False): _seek(1),
    ("LeftArrow", False, True): _seek(-LONG_STEP),
    ("RightArrow", False, True): _seek(LONG_STEP),
    ("Home", False, False): _home,
    ("End", False, False): _end,
    ("UpArrow", False, False): lambda do, _: do.clock.faster(1),
    ("DownArrow", False, False): lambda do, _: do.clock.faster(-1),
    ("L", False, False): _loop,
    ("G", False, False): _flip("ghost"),
    ("T", False, False): _flip("paths"),
    ("M", False, False): _flip("marks"),
    ("F", False, False): _flip("follow"),
    ("Z", True, False): lambda do, _: do.undo(),
    ("Y", True, False): lambda do, _: do.redo(),
    ("Z", True, True): lambda do, _: do.redo(),
    ("S", True, False): lambda _, files: files.save_session(),
    ("Delete", False, False): _delete,
    ("Backspace", False, False): _delete,
    ("P", False, False): _pin,
    ("LeftBracket", False, False): _knots(-1),
    ("RightBracket", False, False): _knots(1),
    ("Escape", False, False): lambda do, _: do.cancel(),
}
KEYS = tuple(dict.fromkeys(name for name, _, _ in BINDINGS))
REPEATED = ("LeftArrow", "RightArrow", "LeftBracket", "RightBracket")  # while they are held down


def press(do: Intents, files: Files, key: str, ctrl: bool = False, shift: bool = False) -> bool:
    """Do what a key is for; False where it is for nothing."""
    act = BINDINGS.get((key, ctrl, shift))
    if act is None:
        return False
    act(do, files)
    return True
