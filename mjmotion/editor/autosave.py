"""A session kept aside after every change: a server that is killed loses the drag in hand at most.

autosave = Autosave(Path("out/walk.autosave.mjsession"))
autosave.offered                     # whether one was left there by an earlier start
autosave.keep(session)
autosave.remove()                    # the session was saved: nothing is to be kept
"""

from __future__ import annotations

from pathlib import Path

from mjmotion.apps.session import EditSession, load_session, save_session

SUFFIX = ".autosave.mjsession"


class Autosave:
    """The file that keeps what was not saved yet.

    Args:
      path: where it is.

    Attributes:
      path: where it is.
      offered: whether it is there from an earlier start, neither restored nor discarded.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.offered = path.is_file()

    @classmethod
    def of(cls, what: str) -> Autosave:
        """Return that of what a user named: in a result folder, beside a file, or here."""
        path = Path(what)
        if path.is_dir():
            return cls(path / f"{path.resolve().name}{SUFFIX}")
        if path.name.endswith(SUFFIX):
            return cls(path)
        beside = path.parent if path.is_file() else Path()
        return cls(beside / f"{path.stem}{SUFFIX}")

    def keep(self, session: EditSession) -> None:
        """Write a session; one in which all was undone leaves nothing to keep.

        Raises:
          OutputError: it cannot be written.
          OSError: it cannot be removed.
        """
        if session.can_undo or session.edits:
            save_session(self.path, session)
        else:
            self.path.unlink(missing_ok=True)

    def restore(self) -> EditSession:
        """Return the session that was left.

        Raises:
          MotionError: it cannot be read, or is of another clip.
        """
        session = load_session(self.path)
        self.offered = False
        return session

    def remove(self) -> None:
        """Remove it, if it is there.

        Raises:
          OSError: it cannot be removed.
        """
        self.path.unlink(missing_ok=True)
        self.offered = False
