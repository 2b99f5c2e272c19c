"""The editor's page by its own protocol, without a screen, and once in a headless Chromium.

Each page is a process of its own: MuJoCo Studio holds its windows in globals.
"""

from __future__ import annotations

import shutil
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from editor_page import Browser, Page, State, running

from mjmotion.apps.session import load_session

pytest.importorskip("mujoco.studio", reason="MuJoCo Studio comes with mujoco 4")
pytest.importorskip("websockets", reason="MuJoCo Studio needs websockets to serve its page")

SIZE = (1200, 768)
FRAME = 45  # the left foot stands, and no hand is before the pelvis
# Where things of the page are at that size [pixel]: the timeline is 162 high, and its frames
# begin 92 + 8 from the left; the slider of frames a knot is the first of the panel.
RULER_Y = SIZE[1] - 118
ROWS = ("left_heel", "left_toe", "right_heel", "right_toe")  # 16 high each, edits, pins below
KNOTS_SLIDER = ((40, 125), (90, 125))


def x_of(frame: float, nframe: int = 464) -> float:
    return 8 + 92 + (SIZE[0] - 16 - 92) * (frame + 0.5) / nframe


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    with running(tmp_path_factory.mktemp("page"), "walk") as page:
        yield page


@pytest.fixture
def browser(page: Page) -> Iterator[Browser]:
    """A browser on a page that is paused at one frame, with nothing edited."""
    browser = Browser(page.port, SIZE)
    page.wait(lambda s: s.get("size") == list(SIZE), "the browser's size")
    scrub(page, browser, FRAME)
    yield browser
    browser.hold()
    browser.up()
    browser.close()
    time.sleep(0.1)


def scrub(page: Page, browser: Browser, frame: int) -> None:
    browser.move((x_of(frame), RULER_Y))
    time.sleep(0.1)
    browser.down()
    page.wait(lambda s: s["frame"] == frame, f"frame {frame}")
    browser.up()
    time.sleep(0.1)


def take(page: Page, browser: Browser, site: str) -> State:
    """Press on a site with Ctrl held."""
    browser.move(page.state["sites"][site])
    browser.hold("Ctrl")
    time.sleep(0.1)
    browser.down()
    return page.wait(lambda s: s["dragged"], f"{site} in the hand")


def release(page: Page, browser: Browser) -> State:
    edits = len(page.state["edits"])
    browser.up()
    browser.hold()
    return page.wait(lambda s: len(s["edits"]) > edits and not s["doing"], "the edit in the list")


def undo(page: Page, browser: Browser) -> State:
    count = page.state["undo"]
    browser.hold("Ctrl", "Z")
    state = page.wait(lambda s: s["undo"] < count and not s["doing"], "undone")
    browser.hold()
    time.sleep(0.1)
    return state


def test_pick_drag_release_undo(page: Page, browser: Browser) -> None:
    before = page.state["sites"]["pelvis"]
    state = take(page, browser, "pelvis")
    assert state["dragged"] == ["site", "pelvis"]
    at = state["sites"]["pelvis"]
    for step in range(1, 11):
        browser.move((at[0], at[1] + 4 * step))
        time.sleep(0.02)
    state = page.wait(lambda s: s["sites"]["pelvis"][1] > before[1] + 30, "the pelvis goes along")
    assert state["edits"] == []
    state = release(page, browser)
    assert state["edits"] == ["Drag"]
    assert state["sites"]["pelvis"] == pytest.approx((at[0], at[1] + 40), abs=4)
    state = undo(page, browser)
    assert state["edits"] == []
    assert state["sites"]["pelvis"] == before


def test_a_standing_foot_is_dragged_along_the_ground(page: Page, browser: Browser) -> None:
    state = take(page, browser, "left_foot")
    assert state["dragged"] == ["footprint", "left"]
    at = state["sites"]["left_foot"]
    browser.move((at[0] + 25, at[1]))
    page.wait(lambda s: s["sites"]["left_foot"][0] > at[0] + 20, "the foot goes along")
    assert release(page, browser)["edits"] == ["Footprint"]
    undo(page, browser)


def test_a_handle_moves_along_its_axis_without_ctrl(page: Page, browser: Browser) -> None:
    take(page, browser, "right_hand")
    browser.up()
    browser.hold()
    page.wait(lambda s: not s["dragged"], "the hand is let go")
    x, y = page.state["sites"]["right_hand"]
    browser.move((x, y - 45))
    page.wait(lambda s: s["hovered"] == "z", "the mouse is on the handle of z")
    browser.down()
    page.wait(lambda s: s["dragged"], "the handle in the hand")
    browser.move((x + 30, y - 75))  # to the side as well: it goes up alone
    page.wait(lambda s: s["sites"]["right_hand"][1] < y - 20, "the hand goes up")
    state = release(page, browser)
    assert abs(state["sites"]["right_hand"][0] - x) < 4
    undo(page, browser)


def test_sliders_and_keys(page: Page, browser: Browser) -> None:
    first, second = KNOTS_SLIDER
    browser.move(first)
    time.sleep(0.1)
    browser.down()
    time.sleep(0.1)
    browser.move(second)
    time.sleep(0.1)
    assert page.state["knots"] == 12  # not while it is slid
    browser.up()
    state = page.wait(lambda s: s["knots"] != 12, "another knot spacing")
    assert 30 < state["knots"] < 50
    undo(page, browser)
    assert page.state["knots"] == 12
    browser.move((600, 60))
    browser.hold("RightArrow")
    page.wait(lambda s: s["frame"] > FRAME, "the next frame")
    browser.hold("G")
    page.wait(lambda s: not s["ghost"], "no ghost")
    browser.hold("Space")
    page.wait(lambda s: s["playing"], "it plays")
    browser.hold()
    time.sleep(0.1)
    browser.hold("Space", "G")
    page.wait(lambda s: not s["playing"] and s["ghost"], "it pauses, with a ghost")


def test_the_timeline_moves_contacts_and_draws_pins(page: Page, browser: Browser) -> None:
    number, (site, _, end) = next(
        (i, one) for i, one in enumerate(page.state["contacts"]) if one[0] == "left_heel"
    )
    y = RULER_Y + 10 + ROWS.index(site) * 16 + 16
    slide(browser, (x_of(end - 0.5), y), (x_of(end - 4.5), y))
    state = page.wait(lambda s: s["undo"] and not s["doing"], "a shorter contact")
    assert [site, end - 4] in [[one[0], one[2]] for one in state["contacts"]]
    assert len(state["contacts"]) > number
    undo(page, browser)

    take(page, browser, "left_hand")
    browser.up()
    browser.hold()
    page.wait(lambda s: not s["dragged"] and s["selected"] == "left_hand", "a site is selected")
    y = RULER_Y + 10 + (len(ROWS) + 1) * 16 + 16
    slide(browser, (x_of(60), y), (x_of(80), y))
    state = page.wait(lambda s: s["edits"] and not s["doing"], "a pin")
    assert state["edits"] == ["Pin"]
    undo(page, browser)


def slide(browser: Browser, start: tuple[float, float], end: tuple[float, float]) -> None:
    browser.move(start)
    time.sleep(0.15)
    browser.down()
    time.sleep(0.15)
    browser.move(end)
    time.sleep(0.15)
    browser.up()


def test_one_controls_and_one_watches(page: Page, browser: Browser) -> None:
    """The second is told that it watches, and is sent every state; edits go on at a rate."""
    watcher = Browser(page.port, SIZE)
    try:
        end = time.monotonic() + 5.0
        while not watcher.closed and time.monotonic() < end:
            time.sleep(0.02)
        assert "4001" in watcher.closed
        assert not browser.closed
        at = take(page, browser, "left_hand")["sites"]["left_hand"]
        before, seen, start = page.state["previews"], watcher.states, time.monotonic()
        while (passed := time.monotonic() - start) < 1.5:
            browser.move((at[0] + 20 * np.sin(8 * passed), at[1] - 20))
            time.sleep(1.0 / 60.0)
        assert watcher.states - seen > 15
        assert page.state["previews"] - before > 2  # how many a second is for the benchmark
        state = release(page, browser)
        assert state["edits"] == ["Drag"]
        undo(page, browser)
    finally:
        watcher.close()


def test_a_foreign_origin_is_refused(page: Page) -> None:
    from websockets.exceptions import InvalidStatus
    from websockets.sync.client import connect
    from websockets.typing import Origin

    for path in ("ui", "state", "drop"):
        with pytest.raises(InvalidStatus, match="403"):
            address = f"ws://127.0.0.1:{page.port}/{path}?sid=x"
            with connect(address, origin=Origin("http://evil.example")):
                pass
    own = Origin(f"http://127.0.0.1:{page.port}")
    with connect(f"ws://127.0.0.1:{page.port}/state?sid=y", origin=own):
        pass


def test_another_interface_is_refused(page: Page) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # nothing is sent: it tells our own address
        except OSError:
            pytest.skip("this machine has no address but that of loopback")
        own = probe.getsockname()[0]
    socket.create_connection(("127.0.0.1", page.port), 5.0).close()
    if own.startswith("127."):
        pytest.skip("this machine has no address but that of loopback")
    with pytest.raises(OSError, match=r"refused|timed out"):
        socket.create_connection((own, page.port), 5.0)


def test_a_killed_server_loses_nothing_and_one_that_is_ended_ends(tmp_path: Path) -> None:
    with running(tmp_path, "walk") as page:
        browser = Browser(page.port, SIZE)
        page.wait(lambda s: s.get("size") == list(SIZE), "the browser's size")
        scrub(page, browser, FRAME)
        at = take(page, browser, "pelvis")["sites"]["pelvis"]
        browser.move((at[0], at[1] + 30))
        page.wait(lambda s: s["previews"] > 0, "a preview")
        release(page, browser)
        page.kill()
        browser.close()
    assert (tmp_path / "walk.autosave.mjsession").is_file()
    with running(tmp_path, "walk") as page:
        browser = Browser(page.port, SIZE)
        page.wait(lambda s: s.get("size") == list(SIZE) and s["offered"], "it is offered")
        browser.move((SIZE[0] / 2 - 20, SIZE[1] / 2 + 100))
        start = time.monotonic()
        code = page.stop()
        assert code == 0, page.log()
        assert time.monotonic() - start < 10.0
        browser.close()


# --- a real browser -------------------------------------------------------------------------------

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
FLAGS = [
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
]
WINDOW = (760, 640)
STATUS = 32  # height of the page's own line at its lower end [pixel]
SCENE = (slice(10, 440), slice(290, 750))  # rows and columns right of the panel
BARS = (slice(WINDOW[1] - STATUS - 98, WINDOW[1] - STATUS - 40), slice(105, 750))
# Mean difference of a region that changed, and of one that did not: the page dithers by 0.5.
MOVED, SAME = 3.0, 1.0


class Chromium:
    """A page in Chromium: what is done, waited for by what the page tells."""

    def __init__(self, tab: Any, page: Page) -> None:
        self.tab, self.page = tab, page
        self.errors: list[str] = []
        tab.on("console", lambda m: self.errors.append(m.text) if "ERROR" in m.text else None)

    def wait(self, until: Callable[[State], Any], what: str, seconds: float = 30.0) -> State:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if self.page.state and until(self.page.state):
                return self.page.state
            self.tab.wait_for_timeout(20)
        raise AssertionError(f"not seen: {what}; {self.page.state}, {self.page.log()}")

    def load(self) -> None:
        told = len(self.page.told)
        self.tab.goto(f"http://127.0.0.1:{self.page.port}/")
        self.wait(
            lambda s: (
                s.get("size") == [WINDOW[0], WINDOW[1] - STATUS]
                and (len(self.page.told) > told or told == 0)
            ),
            "the page's size",
        )
        self.tab.wait_for_timeout(1500)

    def drag(self, site: str, by: tuple[float, float]) -> State:
        mouse, keys = self.tab.mouse, self.tab.keyboard
        x, y = self.page.state["sites"][site]
        edits = len(self.page.state["edits"])
        mouse.move(x, y)
        keys.down("Control")
        self.tab.wait_for_timeout(300)
        mouse.down()
        self.wait(lambda s: s["dragged"], f"{site} in the hand")
        previews = self.page.state["previews"]
        mouse.move(x + by[0], y + by[1])
        self.wait(lambda s: s["previews"] > previews, "a preview")
        mouse.up()
        state = self.wait(lambda s: len(s["edits"]) > edits and not s["doing"], "an edit")
        keys.up("Control")
        return state

    def press(self, key: str, until: Callable[[State], Any], ctrl: bool = False) -> State:
        if ctrl:
            self.tab.keyboard.down("Control")
        self.tab.keyboard.down(key)  # held until it is seen: the page draws slowly here
        state = self.wait(until, f"key {key}")
        self.tab.keyboard.up(key)
        if ctrl:
            self.tab.keyboard.up("Control")
        return state

    def picture(self) -> np.ndarray:
        """What the page shows, without handles, once it has drawn what it was sent."""
        import io

        from PIL import Image

        self.tab.mouse.move(500, 20)
        if self.page.state["selected"]:
            self.press("Escape", lambda s: not s["selected"])
        self.tab.evaluate(
            "new Promise(done => { let n = 0; const next = () =>"
            " ++n > 2 ? done() : requestAnimationFrame(next); next(); })"
        )
        shot = Image.open(io.BytesIO(self.tab.screenshot())).convert("RGB")
        return np.asarray(shot, dtype=np.float64)


def difference(one: np.ndarray, other: np.ndarray, where: tuple[slice, slice]) -> float:
    """The mean difference of two pictures in a region, of 255."""
    return float(np.abs(one[where] - other[where]).mean())


@pytest.mark.skipif(CHROMIUM is None, reason="no chromium here: apt-get install chromium")
def test_a_whole_run_in_chromium(tmp_path: Path) -> None:
    """Load, scrub, drag pelvis and foot, undo, save, reload; pictures compared by region."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with running(tmp_path, "walk") as page, playwright.sync_playwright() as drive:
        browser = drive.chromium.launch(executable_path=CHROMIUM, headless=True, args=FLAGS)
        tab = browser.new_page(viewport={"width": WINDOW[0], "height": WINDOW[1]})
        window = Chromium(tab, page)
        window.load()
        x = 8 + 92 + (WINDOW[0] - 16 - 92) * (FRAME + 0.5) / 464
        tab.mouse.move(x, WINDOW[1] - STATUS - 118)
        tab.wait_for_timeout(500)
        tab.mouse.down()
        window.wait(lambda s: abs(s["frame"] - FRAME) <= 1, "scrubbed")
        tab.mouse.up()
        window.drag("left_foot", (30.0, 0.0))
        state = window.drag("pelvis", (0.0, 45.0))
        assert state["edits"] == ["Footprint", "Drag"]
        sunk = window.picture()
        state = window.press("z", lambda s: s["undo"] == 1, ctrl=True)
        assert state["edits"] == ["Footprint"]
        risen = window.picture()
        assert difference(sunk, risen, SCENE) > MOVED
        window.press("s", lambda s: "saved" in s["message"], ctrl=True)
        assert load_session(tmp_path / "edited.mjsession").edits[0].frames[0] == state["frame"]

        window.load()
        again = window.picture()
        assert page.state["edits"] == ["Footprint"]
        assert difference(risen, again, SCENE) < SAME
        assert difference(risen, again, BARS) < SAME
        assert not window.errors
        browser.close()
