"""What the editor writes and reads: sessions, motions, contacts, result folders, videos.

files = Files(do, "walk")
files.save_session()
files.export_video()
files.task.share, files.task.cancel()
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from mjmotion.apps.session import load_session, save_session
from mjmotion.editor.intents import Intents
from mjmotion.editor.work import Task
from mjmotion.exceptions import OutputError
from mjmotion.footsteps.contacts import save_contacts
from mjmotion.numerics.progress import Progress
from mjmotion.output.result import Result

SESSION_SUFFIX = ".mjsession"


class Files:
    """Writes under one name.

    Args:
      do: what is edited.
      name: the first name, without a suffix.

    Attributes:
      name: a path without a suffix: ``out/lift`` is for ``out/lift.mjsession``,
        ``out/lift.npz``, ``out/lift.contacts.json``, ``out/lift.mp4`` and the folder ``out/lift``.
      replace: whether what is there is replaced; a session's file always is.
      task: what is being written that takes long; None when nothing was yet.
    """

    def __init__(self, do: Intents, name: str) -> None:
        self.name, self.replace = name, False
        self.task: Task | None = None
        self._do = do

    def path(self, suffix: str) -> Path:
        """Return where a file of some kind goes.

        Raises:
          OutputError: there is no name, or something is there already.
        """
        name = self.name.strip()
        if not name:
            raise OutputError("give a name to write under, such as out/lift")
        path = Path(name.removesuffix(SESSION_SUFFIX) + suffix)
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.exists() and not self.replace and suffix != SESSION_SUFFIX:
            raise OutputError(f"'{path}' is there already: tick 'replace' or give another name")
        return path

    def save_session(self) -> None:
        """Write the session; what was kept aside is not needed then."""

        def save() -> None:
            do = self._do
            if do.session is None:
                raise OutputError("there is no session: this is for looking only")
            if do.worker.busy:
                raise OutputError(f"wait: {do.doing}")
            path = save_session(self.path(SESSION_SUFFIX), do.session)
            if do.autosave is not None and not do.autosave.offered:
                do.autosave.remove()
            do.say(f"saved {path}")

        self._do.attempt(save)

    def load_session(self) -> None:
        """Go on with the session of that name; the present one is kept if it cannot be read."""
        path = Path(self.name.strip().removesuffix(SESSION_SUFFIX) + SESSION_SUFFIX)
        self._do.replace_session(lambda: load_session(path), f"loaded {path}")

    def restore(self) -> None:
        """Go on with what was kept aside by an earlier start."""
        autosave = self._do.autosave
        if autosave is not None:
            self._do.replace_session(autosave.restore, "restored what was not saved")

    def discard(self) -> None:
        """Drop what was kept aside by an earlier start."""
        autosave = self._do.autosave
        if autosave is not None:
            self._do.attempt(autosave.remove)

    def export_motion(self) -> None:
        """Write the motion as ``.npz``."""

        def write() -> None:
            path = self.path(".npz")
            self._do.settled.motion.save(path)
            self._do.say(f"wrote {path}")

        self._do.attempt(write)

    def export_contacts(self) -> None:
        """Write who stands when."""

        def write() -> None:
            path = self.path(".contacts.json")
            save_contacts(path, self._do.settled.contacts)
            self._do.say(f"wrote {path}")

        self._do.attempt(write)

    def export_result(self) -> None:
        """Write the whole result folder, without a video, in a thread."""
        result = self._result()

        def write(path: Path, progress: Progress) -> Path:
            return result.save(path, force=self.replace, progress=progress)

        self._aside("result folder", "", write)

    def export_video(self) -> None:
        """Render a video in a thread."""
        result = self._result()

        def write(path: Path, progress: Progress) -> Path:
            return result.render(path, force=self.replace, progress=progress)

        self._aside("video", ".mp4", write)

    def tick(self) -> None:
        """Tell what came of the task."""
        task = self.task
        if task is None or task.running:
            return
        self.task = None
        if task.error is not None:
            self._do.say(f"{task.label}: {task.error}", bad=True)
        else:
            self._do.say(f"{task.label} cancelled" if task.cancelled else f"wrote {task.value}")

    def close(self) -> None:
        """Stop what is being written."""
        if self.task is not None:
            self.task.cancel()
            self.task.join(10.0)

    def _result(self) -> Result:
        do = self._do
        shown = do.settled
        if do.session is not None and not do.worker.busy:
            return do.session.result()
        return Result(shown.source, shown.motion, shown.contacts, shown.trace, ())

    def _aside(self, label: str, suffix: str, write: Callable[[Path, Progress], Any]) -> None:
        if self.task is not None:
            self._do.say(f"wait: the {self.task.label} is being written", bad=True)
            return
        path = self._do.attempt(lambda: self.path(suffix))
        if path is not None:
            self.task = Task(label, lambda progress: write(path, progress))
