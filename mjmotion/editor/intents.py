"""What a person can do in the editor, in plain Python: pick, drag, release, seek, keys, undo, save.

    do = Intents(session)
    do.seek(120)
    do.grab("right_hand")
    do.drag((1.9, -0.4, 1.6))
    do.release()
    do.tick(1 / 60)                     # the page calls it every frame

No window is needed. Nothing here raises because of what a person did: what cannot be done is said
in ``message``, and all stays as it was.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mjmotion.apps.session import EditSession, Pin, Step
from mjmotion.apps.session.edits import Edit, Vector
from mjmotion.editor.autosave import Autosave
from mjmotion.editor.clock import Clock
from mjmotion.editor.dragging import Dragged, moved_edit, standing, take, take_edit
from mjmotion.editor.figures import Figures
from mjmotion.editor.shown import Shown
from mjmotion.editor.work import Worker
from mjmotion.exceptions import MotionError
from mjmotion.footsteps.contacts import Contact

LONG_STEP = 10  # frames of a step with Shift


class Intents:
    """The editor without its window.

    Args:
      session: what is edited; None to look only.
      shown: what is looked at, without a session.
      autosave: where every change is kept; nowhere without.

    Attributes:
      session: what is edited.
      clock: which frame is shown.
      worker: makes previews and changes in a thread of its own.
      figures: the validation's figures of what is shown.
      message, bad: what there is to say, and whether it is an error.
      ghost, paths, marks, follow: what is shown besides the motion.
      selected: the site with the handles; "" for none.
      chosen: the edit that is selected in the list; −1 for none.
      still: whether a pin holds its site at the place of the present frame.
      panels: which of the panels are shown.
      autosave: where changes are kept; None where they are not.
    """

    def __init__(
        self,
        session: EditSession | None,
        shown: Shown | None = None,
        autosave: Autosave | None = None,
    ) -> None:
        if session is not None:
            shown = Shown.of(session)
        if shown is None:
            raise ValueError("give a session, or what is to be looked at")
        self.session = session
        self._settled: Shown = shown
        self._preview: Shown | None = None
        self._previewed: tuple[Edit, Step] | None = None
        self._dragged: Dragged | None = None
        self._doing = ""
        self.clock = Clock(self._settled.nframe, self._settled.motion.fps)
        self.worker = Worker()
        self.figures = Figures()
        self.message, self.bad = "", False
        self.ghost = shown.source is not shown.motion or session is not None
        self.paths, self.marks, self.follow = True, True, True
        self.selected, self.chosen, self.still = "", -1, False
        self.panels = {"edit": True, "result": True}
        self.autosave = autosave
        self.figures.ask(self._settled)

    # What there is

    @property
    def shown(self) -> Shown:
        """What is to be shown: the motion, or the preview of a drag."""
        return self._settled if self._preview is None else self._preview

    @property
    def settled(self) -> Shown:
        """What there is without the drag in hand."""
        return self._settled

    @property
    def frame(self) -> int:
        """The frame that is shown."""
        return self.clock.frame

    @property
    def dragged(self) -> Dragged | None:
        """What is in the hand."""
        return self._dragged

    @property
    def doing(self) -> str:
        """What is being done that takes long; "" for nothing."""
        return self._doing if self.worker.busy else ""

    @property
    def editable(self) -> bool:
        """Whether this is more than looking."""
        return self.session is not None

    def say(self, message: str, bad: bool = False) -> None:
        """Put a line before the person."""
        self.message, self.bad = " ".join(message.split()), bad

    # Time

    def tick(self, seconds: float) -> None:
        """Let time pass [s]: play, and take what the worker has finished."""
        self.worker.poll()
        if self._dragged is None:
            self.clock.tick(seconds)
            self.figures.tick(self.settled, idle=not self.worker.busy)

    def seek(self, frame: int) -> None:
        """Go to a frame; not while something is in the hand."""
        if self._dragged is None:
            self.clock.seek(frame)

    def choose(self, index: int) -> None:
        """Select an edit of the list, and go to its frame; −1 for none."""
        if self._dragged is None and -1 <= index < len(self.settled.edits):
            self.chosen, self.selected = index, ""
            if index >= 0:
                self.clock.playing = False
                self.seek(self.settled.edits[index].frames[0])

    def stands(self, site: str) -> bool:
        """Whether a site is of a foot that stands at the present frame."""
        return standing(self.settled, site, self.frame) is not None

    # Dragging

    def grab(self, site: str) -> bool:
        """Take a site in hand at the present frame; of a standing foot the whole footprint."""
        if site not in self.settled.sites or not self._may_change():
            return False
        self.clock.playing = False
        self.selected, self.chosen = site, -1
        self._dragged = take(self.settled, site, self.frame)
        return True

    def grab_part(self, name: str) -> bool:
        """Take a part of the scene in hand, such as a door."""
        if not self._may_change():
            return False
        self.clock.playing = False
        zero = np.zeros(3)
        self._dragged = Dragged(name, "part", self.frame, zero, zero)
        return True

    def grab_chosen(self) -> bool:
        """Take the place of the chosen edit in hand."""
        if not 0 <= self.chosen < len(self.settled.edits) or not self._may_change():
            return False
        self.clock.playing = False
        self._dragged = take_edit(self.settled, self.chosen)
        return self._dragged is not None

    def drag(self, place: ArrayLike, turn: float = 0.0) -> None:
        """Have what is in the hand at another place (3,) [m]; the newest place wins."""
        if self._dragged is None:
            return
        drag = self._dragged.to(place).turned(turn)
        if np.array_equal(drag.place, self._dragged.place) and drag.turn == self._dragged.turn:
            return
        self._dragged = drag
        session = self.session
        if drag.kind in ("site", "footprint") and drag.moved and session is not None:
            edit = drag.edit(self.settled.settings)
            self.worker.latest(
                lambda: (edit, session.preview(edit)), self._show_preview, self._complain
            )

    def release(self) -> None:
        """Let go: what was dragged is an edit then, or the part of the scene is there."""
        drag, session = self._dragged, self.session
        self._dragged = None
        self.worker.forget()
        if drag is None or session is None:
            return
        if not drag.moved:
            self._drop_preview()
            return
        if drag.kind == "part":
            by = drag.move
            self._change(f"adapting to '{drag.name}'", lambda: session.move_scene(drag.name, by))
        elif drag.kind == "edit":
            index, move = drag.index, drag.move
            self.move_edit(index, move)
        else:
            edit = drag.edit(self.settled.settings)
            # Done already, where the mouse stood still before it was released.
            known = self._previewed
            step = known[1] if known is not None and known[0] == edit else None
            self._change("fitting", lambda: session.do(edit, step))

    def cancel(self) -> None:
        """Put back what is in the hand; without, select nothing."""
        if self._dragged is None:
            self.selected, self.chosen = "", -1
        self._dragged = None
        self.worker.forget()
        self._drop_preview()

    # Changes

    def pin(self, start: int, end: int, site: str = "") -> None:
        """Hold the selected site from frame ``start`` up to, not including, ``end``.

        Where it is at each frame; with ``still`` at the place of the present one.
        """
        site = site or self.selected
        if site not in self.settled.sites:
            self.say("select a site first: Ctrl-click a body", bad=True)
            return
        place = self.settled.place(site, self.frame) if self.still else None
        position = None if place is None else (float(place[0]), float(place[1]), float(place[2]))
        start, end = max(0, min(start, end)), min(self.settled.nframe, max(start, end))
        edit = Pin(site, start, max(end, start + 1), position, self.settled.settings)
        self._with(lambda session: self._change("pinning", lambda: session.do(edit)))

    def undo(self) -> None:
        """Take the last change back."""
        self._with(lambda session: self._change("undoing", session.undo))

    def redo(self) -> None:
        """Do again what was undone."""
        self._with(lambda session: self._change("doing again", session.redo))

    def set_settings(self, **values: Any) -> None:
        """Change settings of the next edits, by name."""

        def change(session: EditSession) -> None:
            settings = dataclasses.replace(session.state.settings, **values)
            if settings != session.state.settings:
                self._change("", lambda: session.set_settings(settings))

        self._with(change)

    def set_rigidity(self, joint: str, factor: float) -> None:
        """Let a joint resist more than by itself (above 1), or less; 1 takes it off the list."""
        others = [pair for pair in self.settled.settings.rigidity if pair[0] != joint]
        mine = [] if factor == 1.0 else [(joint, factor)]
        self.set_settings(rigidity=tuple(sorted([*others, *mine])))

    def enable(self, index: int, on: bool) -> None:
        """Let an edit count, or not."""
        self._with(lambda one: self._change("making it anew", lambda: one.enable(index, on)))

    def delete(self, index: int) -> None:
        """Take an edit away."""
        self.chosen = -1
        self._with(lambda one: self._change("making it anew", lambda: one.delete(index)))

    def move_edit(self, index: int, by: Vector) -> None:
        """Move the place of an edit [m]."""
        self._with(
            lambda one: self._change(
                "making it anew", lambda: one.change(index, moved_edit(one.edits[index], by))
            )
        )

    def move_edit_to(self, index: int, place: Vector) -> None:
        """Put an edit at a place, or give a footprint another move [m]."""
        if 0 <= index < len(self.settled.edits):
            edit = self.settled.edits[index]
            old = getattr(edit, "move", None) or getattr(edit, "position", None)
            if old is not None:
                self.move_edit(index, (place[0] - old[0], place[1] - old[1], place[2] - old[2]))

    def set_contact(self, index: int, start: int, end: int) -> None:
        """Let a contact last from ``start`` up to, not including, ``end``."""
        contacts = list(self.settled.contacts)
        contacts[index] = Contact(contacts[index].site, start, end)
        self._with(
            lambda one: self._change("adapting to contacts", lambda: one.set_contacts(contacts))
        )

    def replace_session(self, read: Callable[[], EditSession], said: str) -> None:
        """Go on with another session, such as one that is loaded."""

        def take_it(session: EditSession) -> None:
            self.session = session
            self.selected, self.chosen = "", -1
            self._refresh()
            self.clock.nframe, self.clock.fps = self.settled.nframe, self.settled.motion.fps
            self.clock.seek(self.frame)
            self.say(said)

        if self.worker.busy:
            self.say(f"wait: {self._doing}", bad=True)
            return
        self._doing = "reading the session"
        self.worker.job(read, take_it, self._complain)

    # How

    def attempt(self, call: Callable[[], Any]) -> Any:
        """Call, and say in one line what went wrong; None then."""
        try:
            return call()
        except MotionError as error:
            self.say(str(error), bad=True)
        except OSError as error:
            self.say(str(error), bad=True)
        return None

    def close(self) -> None:
        """End the threads."""
        self.worker.close()
        self.figures.close()

    def _may_change(self) -> bool:
        """Whether a change may begin; else it is said why not."""
        if self.session is None:
            self.say("this is for looking only: mjmotion edit opens it for editing", bad=True)
        elif self.autosave is not None and self.autosave.offered:
            self.say("restore the autosave first, or discard it", bad=True)
        elif self.worker.busy:
            self.say(f"wait: {self._doing}", bad=True)
        else:
            return True
        return False

    def _with(self, change: Callable[[EditSession], None]) -> None:
        if self._may_change():
            assert self.session is not None
            session = self.session
            self.attempt(lambda: change(session))

    def _change(self, label: str, call: Callable[[], Any]) -> None:
        """Have the session changed in the worker's thread; all is shown when it is done."""
        self._doing = label
        self.worker.job(call, self._changed, self._complain)

    def _changed(self, value: Any) -> None:
        del value
        self._refresh()
        self.say("")
        if self.autosave is not None and self.session is not None:
            session, autosave = self.session, self.autosave
            self.attempt(lambda: autosave.keep(session))

    def _refresh(self) -> None:
        assert self.session is not None
        self._settled = Shown.of(self.session)
        self._drop_preview()
        if self.chosen >= len(self._settled.edits):
            self.chosen = -1
        if self.selected not in self._settled.sites:
            self.selected = ""
        self.figures.ask(self._settled)

    def _show_preview(self, value: tuple[Edit, Step]) -> None:
        if self._dragged is not None or self.worker.busy:
            self._previewed = value
            self._preview = self.settled.previewed(value[1])
            if self.bad:
                self.say("")

    def _drop_preview(self) -> None:
        self._preview = self._previewed = None

    def _complain(self, error: Exception) -> None:
        """Say what went wrong; the session is as it was."""
        if isinstance(error, MotionError | OSError):
            self.say(str(error), bad=True)
        else:
            self.say(f"{type(error).__name__}: {error}", bad=True)
        if self._dragged is None:
            self._drop_preview()
