"""Record the editor's page while bodies are dragged: docs/images/editor.webp, and editor.jpg.

python scripts/record_editor.py          # needs a chromium, and playwright of the dev extra
python scripts/record_editor.py --still
"""

from __future__ import annotations

import argparse
import io
import json
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any

from PIL import Image

State = dict[str, Any]

SIZE, LARGE = (760, 600), (1200, 800)  # of the window that is recorded, and of the still [pixel]
STATUS, RULER = (
    32,
    150,
)  # height of the page's own line; of the timeline's ruler, from below [pixel]
QUALITY, STILL_QUALITY, PACE = 60, 88, 140  # of the recording; time of a picture [ms]
PATIENCE = 120.0  # without a GPU the page draws slowly [s]
MOST = 1.5e6  # bytes of the recording
CLIP, FRAME, AROUND = "walk", 90, 36  # the edited frame, and how far to either side is looked at
FLAGS = (
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
)


def page() -> None:
    """Serve the clip and write where its sites are on the page, a line of JSON at a time."""
    from mjmotion.editor import Intents, open_session
    from mjmotion.editor.files import Files
    from mjmotion.editor.server import LOOPBACK, serve

    session, _ = open_session(CLIP)
    do = Intents(session)
    last: State = {}

    def tell(shown: Any) -> None:
        nonlocal last
        names = ("right_hand", "pelvis")
        places = do.shown.places(names, slice(do.frame, do.frame + 1))[0]
        pixels, _ = shown.view.project(places)
        now = {
            "frame": do.frame,
            "dragged": do.dragged is not None,
            "edits": len(do.settled.edits),
            "previews": do.worker.previews,
            "doing": do.doing,
            "size": list(shown.view.size),
            "sites": dict(zip(names, pixels.round(1).tolist(), strict=True)),
        }
        if now != last:
            last = now
            print(json.dumps(now), flush=True)

    def started(address: str) -> None:
        print(json.dumps({"address": address}), flush=True)

    serve(do, Files(do, "out/lift"), port=0, host=LOOPBACK, started=started, observe=tell)


def _is_near(frame: int, state: State) -> bool:
    return abs(int(state["frame"]) - frame) <= 1


def _went_on(previews: int, state: State) -> bool:
    return int(state["previews"]) > previews


class Recorder:
    """A tab on the page: what is done there, and a picture after every step.

    Args:
      tab: of Playwright.
      server: the page's process, which writes what it shows.
    """

    def __init__(self, tab: Any, server: subprocess.Popen[str]) -> None:
        self.tab, self._server = tab, server
        self.state: State = {}
        self.size = SIZE
        self.pictures: list[Image.Image] = []
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        assert self._server.stdout is not None
        for line in self._server.stdout:
            self.state = json.loads(line)

    def wait(self, until: Callable[[State], Any], seconds: float = PATIENCE) -> State:
        """Wait until the page shows something."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if self.state and until(self.state):
                return self.state
            self.tab.wait_for_timeout(20)
        raise SystemExit(f"the page does not show what was waited for: {self.state}")

    def picture(self) -> Image.Image:
        """Keep what the page shows, once it has drawn what it was sent."""
        self.tab.evaluate(
            "new Promise(done => { let n = 0; const next = () =>"
            " ++n > 2 ? done() : requestAnimationFrame(next); next(); })"
        )
        shot = Image.open(io.BytesIO(self.tab.screenshot())).convert("RGB")
        self.pictures.append(shot)
        return shot

    def scrub(self, frames: Iterable[int]) -> None:
        """Drag along the ruler."""
        for number, frame in enumerate(frames):
            x = 8 + 92 + (self.size[0] - 16 - 92) * (frame + 0.5) / 464
            self.tab.mouse.move(x, self.size[1] - RULER)
            if number == 0:
                self.tab.wait_for_timeout(400)
                self.tab.mouse.down()
            self.wait(partial(_is_near, frame))
            self.picture()
        self.tab.mouse.up()
        self.tab.wait_for_timeout(300)

    def drag(self, site: str, by: tuple[float, float], steps: int) -> None:
        """Ctrl-drag a site by so many pixels."""
        x, y = self.state["sites"][site]
        edits = self.state["edits"]
        self.tab.mouse.move(x, y)
        self.tab.keyboard.down("Control")
        self.tab.wait_for_timeout(500)
        self.tab.mouse.down()
        self.wait(lambda s: s["dragged"])
        for step in range(1, steps + 1):
            previews = self.state["previews"]
            self.tab.mouse.move(x + by[0] * step / steps, y + by[1] * step / steps)
            self.wait(partial(_went_on, previews))
            self.picture()
        self.tab.mouse.up()
        self.wait(lambda s: s["edits"] > edits and not s["doing"])
        self.tab.keyboard.up("Control")

    def resize(self, size: tuple[int, int]) -> None:
        """Make the window so large."""
        self.size = size
        self.tab.set_viewport_size({"width": size[0], "height": size[1]})
        self.wait(lambda s: s.get("size") == [size[0], size[1] - STATUS])
        self.tab.wait_for_timeout(2000)


def record(recorder: Recorder) -> list[Image.Image]:
    """Go through it, and return the pictures."""
    recorder.resize(SIZE)
    recorder.scrub(range(FRAME - AROUND, FRAME + 1, 12))
    recorder.drag("pelvis", (0.0, 24.0), 4)
    recorder.drag("right_hand", (60.0, -80.0), 6)
    recorder.scrub(range(FRAME - AROUND, FRAME + AROUND, 8))
    return recorder.pictures


def portray(recorder: Recorder) -> list[Image.Image]:
    """Lift a hand, and return pictures of which the last is the README's."""
    recorder.resize(LARGE)
    recorder.scrub([FRAME])
    recorder.drag("right_hand", (60.0, -80.0), 1)
    recorder.tab.wait_for_timeout(4000)  # the figures are measured
    recorder.picture()
    return recorder.pictures


def main() -> None:
    """Write the recording and the still."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/images"), help="the folder")
    parser.add_argument("--page", action="store_true", help="only serve the page")
    parser.add_argument("--still", action="store_true", help="the picture for the README instead")
    options = parser.parse_args()
    if options.page:
        page()
        return
    out = options.out
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        sys.exit("there is no chromium: apt-get install chromium")
    from playwright.sync_api import sync_playwright

    command = [sys.executable, "-W", "ignore", __file__, "--page"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        try:
            assert server.stdout is not None
            told: State = {}
            while "address" not in told:
                told = json.loads(server.stdout.readline())
            with sync_playwright() as drive:
                browser = drive.chromium.launch(executable_path=chromium, args=list(FLAGS))
                tab = browser.new_page(viewport={"width": SIZE[0], "height": SIZE[1]})
                tab.set_default_timeout(1000.0 * PATIENCE)
                recorder = Recorder(tab, server)
                tab.goto(told["address"])
                pictures = (portray if options.still else record)(recorder)
                browser.close()
        finally:
            server.kill()
    if options.still:
        pictures[-1].save(out / "editor.jpg", quality=STILL_QUALITY)
        return
    path = out / "editor.webp"
    pictures[0].save(
        path,
        save_all=True,
        append_images=pictures[1:],
        duration=PACE,
        loop=0,
        quality=QUALITY,
        method=4,
    )
    size = path.stat().st_size
    print(f"{path}: {len(pictures)} pictures, {size / 1e6:.2f} MB")
    if size > MOST:
        sys.exit("that is too large: fewer pictures, or a lower quality")


if __name__ == "__main__":
    main()
