"""The editor's page in a process of its own, and a browser without a browser that speaks to it.

The page writes what it shows to stdout, a line of JSON whenever that changes; the browser speaks
the protocol of MuJoCo Studio's page (NetImgui 1.13 on ``/ui``, acknowledged states on ``/state``).
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import struct
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

State = dict[str, Any]
SHOWN_SITES = ("pelvis", "right_hand", "left_hand", "left_foot", "right_foot", "head_top")


# --- the page's side: python tests/editor_page.py WHAT SCENE PORT HOST --------------------------


def report(page: Any) -> State:
    """What a page shows, as plain values."""
    do, view = page.do, page.view
    shown = do.shown
    sites = [name for name in SHOWN_SITES if name in shown.sites]
    places = shown.places(sites, slice(do.frame, do.frame + 1))[0]
    # The sites of feet are on the soles, where a ray may meet the ground.
    places = places + [(0.0, 0.0, 0.04 * name.endswith("_foot")) for name in sites]
    pixels, _ = view.project(places)
    return {
        "frame": do.frame,
        "playing": do.clock.playing,
        "dragged": None if do.dragged is None else [do.dragged.kind, do.dragged.name],
        "edits": [type(one).__name__ for one in do.settled.edits],
        "contacts": [[one.site, one.start, one.end] for one in do.settled.contacts],
        "undo": do.settled.undo,
        "redo": do.settled.redo,
        "knots": do.settled.settings.frames_per_knot,
        "ghost": do.ghost,
        "selected": do.selected,
        "message": do.message,
        "doing": do.doing,
        "hovered": page.hovered,
        "previews": do.worker.previews,
        "rate": do.worker.rate,
        "size": list(view.size),
        "sites": {name: at for name, at in zip(sites, pixels.round(1).tolist(), strict=True)},
        "offered": do.autosave is not None and do.autosave.offered,
        "azimuth": round(float(page.viewer.camera.azimuth), 2),
    }


def main(what: str, scene: str, port: int, host: str) -> None:
    """Serve a page that tells what it shows."""
    from mjmotion.editor import Intents, open_session
    from mjmotion.editor.autosave import Autosave
    from mjmotion.editor.files import Files
    from mjmotion.editor.server import serve

    session, name = open_session(what, scene or None)
    do = Intents(session, autosave=Autosave.of(name))
    do.follow = False  # that pixels stay
    last = ""

    def tell(page: Any) -> None:
        nonlocal last
        line = json.dumps(report(page))
        if line != last:
            last = line
            sys.stdout.write(line + "\n")
            sys.stdout.flush()

    def started(address: str) -> None:
        sys.stdout.write(json.dumps({"address": address}) + "\n")
        sys.stdout.flush()

    with contextlib.suppress(KeyboardInterrupt):  # how it is ended
        serve(do, Files(do, "edited"), port=port, host=host, started=started, observe=tell)


class Page:
    """A page in a process of its own.

    Attributes:
      state: what it shows now.
      port: where it listens.
      process: the process.
    """

    def __init__(self, folder: Path, what: str, scene: str = "", host: str = "127.0.0.1") -> None:
        command = [sys.executable, "-W", "ignore", __file__, what, scene, "0", host]
        environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])}
        self._errors = (folder / "page.log").open("w+")
        self.process = subprocess.Popen(
            command,
            cwd=folder,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            text=True,
        )
        self.state: State = {}
        self.port = 0
        self._lines: list[State] = []
        threading.Thread(target=self._read, daemon=True).start()
        self.wait(lambda _: self.port > 0, "the server's start", 40.0)

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            told = json.loads(line)
            if "address" in told:
                self.port = int(told["address"].rstrip("/").rpartition(":")[2])
            else:
                self._lines.append(told)
                self.state = told

    @property
    def told(self) -> list[State]:
        """All that it has shown."""
        return self._lines

    def wait(
        self, until: Callable[[State], Any], what: str = "the page", seconds: float = 20.0
    ) -> State:
        """Wait for the page to show something."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            state = self.state
            if (state or self.port) and until(state):
                return state
            if self.process.poll() is not None:
                raise AssertionError(f"the page ended with {self.process.returncode}: {self.log()}")
            time.sleep(0.005)
        raise AssertionError(f"not seen in {seconds:g} s: {what}; {self.state} {self.log()}")

    def log(self) -> str:
        """The end of what it wrote to stderr."""
        self._errors.flush()
        return Path(self._errors.name).read_text()[-1500:]

    def kill(self) -> None:
        """End it on the spot, as a crash would."""
        self.process.kill()
        self.process.wait(10)

    def stop(self) -> int:
        """End it as Ctrl-C does, and return its exit code."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        try:
            return self.process.wait(15)
        except subprocess.TimeoutExpired:
            self.process.kill()
            raise


@contextmanager
def running(folder: Path, what: str, scene: str = "") -> Iterator[Page]:
    """A page that is ended afterwards."""
    page = Page(folder, what, scene)
    try:
        yield page
    finally:
        page.process.kill()
        page.process.wait(10)


# --- the browser's side ---------------------------------------------------------------------------

_NAMES = ("Tab", "LeftArrow", "RightArrow", "UpArrow", "DownArrow", "PageUp", "PageDown", "Home")
KEYS = {name: number for number, name in enumerate(_NAMES)}
KEYS |= {"End": 8, "Delete": 10, "Backspace": 11, "Space": 12, "Enter": 13, "Escape": 14}
KEYS |= {letter: 34 + i for i, letter in enumerate("ABCDEFGHIJKLMNOPQRSTUVWXYZ")}
KEYS |= {"Ctrl": 151, "Shift": 152}
_KEY_WORDS, _CHARS = 3, 256


def version_packet() -> bytes:
    """The first packet: who speaks, and which NetImgui."""
    names = (b"mjmotion test", b"1.92", b"1.13.0")
    return struct.pack("<IBB2x64s16s16sIIIBB2x", 120, 0, 0, *names, 18, 19200, 11300, 2, 0)


def input_packet(
    size: tuple[int, int], mouse: tuple[int, int], buttons: int, keys: Sequence[str]
) -> bytes:
    """A packet of mouse and keys, as they are."""
    words = [0] * _KEY_WORDS
    for name in keys:
        words[KEYS[name] // 64] |= 1 << KEYS[name] % 64
    chars = [0] * _CHARS
    body = struct.pack(
        f"<HHhhff{_CHARS}HHBBff4xQ", *size, *mouse, 0.0, 0.0, *chars, 0, 0, 0, 1.0, 60.0, buttons
    )
    body += struct.pack(f"<{_KEY_WORDS}Q8f", *words, *[0.0] * 8)
    return struct.pack("<IBB2x", 8 + len(body), 2, 0) + body


class Browser:
    """A browser's connections to a page: its mouse and keys, and what it is sent.

    Attributes:
      states: how many states came.
      drawn: how many frames of the page's windows came.
      closed: why the page's windows are not sent any more; "" while they are.
    """

    def __init__(self, port: int, size: tuple[int, int] = (1200, 768)) -> None:
        from websockets.sync.client import connect

        self._size, self._mouse = size, (-1, -1)
        self._buttons, self._keys = 0, ()
        self.states, self.drawn, self.closed, self.roster = 0, 0, "", ""
        sid = uuid.uuid4().hex[:12]
        here = f"ws://127.0.0.1:{port}"
        self._open = contextlib.ExitStack()
        self._state, self._ui = (
            self._open.enter_context(
                connect(f"{here}/{path}?sid={sid}", compression=None, max_size=None)
            )
            for path in ("state", "ui")
        )
        threading.Thread(target=self._read_state, daemon=True).start()
        try:
            self._ui.send(version_packet())
            self._ui.recv(timeout=10)
        except Exception as error:
            self.closed = repr(error)
        else:
            threading.Thread(target=self._read_ui, daemon=True).start()
            threading.Thread(target=self._tell, daemon=True).start()

    def _read_state(self) -> None:
        try:
            for message in self._state:
                if isinstance(message, bytes):
                    self.states += 1
                    self._state.send("state_ack")
                elif message.startswith("viewers"):
                    self.roster = message
        except Exception as error:
            self.state_closed = repr(error)

    def _read_ui(self) -> None:
        try:
            for _ in self._ui:
                self.drawn += 1
        except Exception as error:
            self.closed = repr(error)
        self.closed = self.closed or "closed"

    def _tell(self) -> None:
        """Tell mouse and keys every frame, as a page does."""
        while not self.closed:
            with contextlib.suppress(Exception):
                self._send()
            time.sleep(1.0 / 60.0)

    def _send(self) -> None:
        self._ui.send(input_packet(self._size, self._mouse, self._buttons, self._keys))

    def move(self, at: Sequence[float]) -> None:
        """Move the mouse to a pixel."""
        self._mouse = (round(at[0]), round(at[1]))
        self._send()

    def down(self) -> None:
        """Press the left button."""
        self._buttons = 1
        self._send()

    def up(self) -> None:
        """Let it go."""
        self._buttons = 0
        self._send()

    def hold(self, *keys: str) -> None:
        """Hold some keys, and no others."""
        self._keys = keys  # type: ignore[assignment]
        self._send()

    def close(self) -> None:
        """Close the page."""
        self.closed = self.closed or "by us"
        self._open.close()


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]), sys.argv[4])
