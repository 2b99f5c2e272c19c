"""The timeline: scrub, contacts as bars with ends to drag, edits as marks, pins as ranges."""

from __future__ import annotations

from mujoco.studio.dear_imgui import dear_imgui as imgui

from mjmotion.apps.session.edits import Footprint
from mjmotion.editor import colours
from mjmotion.editor.bars import LABEL, ROW, RULER, Bars, Hit
from mjmotion.editor.clock import SPEEDS
from mjmotion.editor.colours import Colour
from mjmotion.editor.intents import Intents
from mjmotion.editor.overlay import colour

BUTTONS = 30.0  # height of the row of buttons [pixel]
MARGIN = 8.0  # around the whole [pixel]
_TICKS = (1, 2, 5, 10, 20, 30, 60, 100, 150, 300, 600, 1500, 3000)
_TICK_WIDTH = 60.0  # between two numbers of the ruler at least [pixel]


class Timeline:
    """Draws the timeline and turns the mouse on it into intents.

    Attributes:
      height: of its window [pixel].
    """

    def __init__(self) -> None:
        self.height = 140.0
        self._held: Hit | None = None

    def draw(self, do: Intents, width: float, height: float) -> None:
        """Draw it along the lower edge of a page of some size [pixel]."""
        bars = Bars(do.shown, MARGIN, height - self.height + BUTTONS + MARGIN, width - 2 * MARGIN)
        self.height = BUTTONS + 2 * MARGIN + (bars.bottom - bars.top)
        imgui.SetNextWindowPos(imgui.Vec2(0.0, height - self.height))
        imgui.SetNextWindowSize(imgui.Vec2(width, self.height))
        flags = imgui.WindowFlags
        look = int(flags.NoDecoration) | int(flags.NoMove) | int(flags.NoSavedSettings)
        imgui.Begin("Timeline", None, look | int(flags.NoNav))
        self._buttons(do)
        bars = Bars(do.shown, MARGIN, height - self.height + BUTTONS + MARGIN, width - 2 * MARGIN)
        imgui.SetCursorScreenPos(imgui.Vec2(bars.left, bars.top))
        size = imgui.Vec2(max(bars.width, 1.0), max(bars.bottom - bars.top, 1.0))
        imgui.InvisibleButton("##timeline", size)
        self._mouse(do, bars)
        self._draw(do, bars)
        imgui.End()

    def _buttons(self, do: Intents) -> None:
        clock = do.clock
        if imgui.Button("Pause" if clock.playing else "Play", imgui.Vec2(56.0, 0.0)):
            clock.play(not clock.playing)
        for label, frames in (("<<", -clock.nframe), ("<", -1), (">", 1), (">>", clock.nframe)):
            imgui.SameLine()
            if imgui.Button(label, imgui.Vec2(28.0, 0.0)) and do.dragged is None:
                clock.step(frames)
        imgui.SameLine()
        _, clock.loop = imgui.Checkbox("loop", clock.loop)
        imgui.SameLine()
        imgui.SetNextItemWidth(76.0)
        index = SPEEDS.index(clock.speed) if clock.speed in SPEEDS else SPEEDS.index(1.0)
        changed, index = imgui.Combo("##speed", index, [f"{one:g} x" for one in SPEEDS])
        if changed:
            clock.speed = SPEEDS[index]
        imgui.SameLine()
        imgui.Text(
            f"frame {do.frame} of {clock.nframe - 1}   {do.frame / clock.fps:.2f} s"
            f" at {clock.fps:g}/s"
        )
        for name in do.panels:
            imgui.SameLine()
            _, do.panels[name] = imgui.Checkbox(name, do.panels[name])
        imgui.SameLine()
        text = do.doing + " ..." if do.doing else do.message
        tone = colours.FAR if do.bad and not do.doing else colours.CURSOR
        imgui.TextColored(imgui.Vec4(*tone), text)
        if text:
            imgui.SetItemTooltip(text)

    # The mouse

    def _mouse(self, do: Intents, bars: Bars) -> None:
        at = imgui.GetIO().MousePos
        if imgui.IsItemActivated():
            self._held = bars.hit((at.x, at.y))
            if self._held is not None and self._held.kind == "edit":
                do.choose(self._held.index)
        held = self._held
        if held is None:
            return
        if imgui.IsItemActive():
            if held.kind == "scrub" or (held.kind == "contact" and not held.end):
                do.clock.playing = False
                do.seek(bars.frame(at.x))
            return
        self._held = None
        if not do.editable:
            return
        if held.kind == "contact" and held.end:
            moved = bars.moved_contact(held, at.x)
            if moved != do.shown.contacts[held.index]:
                do.set_contact(held.index, moved.start, moved.end)
        elif held.kind == "pin" and bars.frame(at.x) != held.frame:
            first, last = sorted((held.frame, bars.frame(at.x)))
            do.pin(first, last + 1)

    # The picture

    def _draw(self, do: Intents, bars: Bars) -> None:
        page = imgui.GetWindowDrawList()
        right = bars.left + bars.width
        _box(page, bars.left, bars.top, right, bars.bottom, colours.BACK)
        self._reach(page, do, bars)
        _ruler(page, bars)
        for number, site in enumerate(bars.sites):
            _label(page, bars.left, bars.top + RULER + ROW * number, site)
        _label(page, bars.left, bars.edits_top, "edits")
        _label(page, bars.left, bars.pins_top, "pins")
        self._contacts(page, do, bars)
        _edits(page, do, bars)
        if self._held is not None and self._held.kind == "pin":
            first, last = sorted((self._held.frame, bars.frame(imgui.GetIO().MousePos.x)))
            left, end = bars.x(first), bars.x(last + 1)
            _box(page, left, bars.pins_top + 2, end, bars.pins_top + ROW - 2, colours.PIN)
        x = bars.x(do.frame + 0.5)
        page.AddLine(
            imgui.Vec2(x, bars.top), imgui.Vec2(x, bars.bottom), colour(colours.CURSOR), 2.0
        )

    def _reach(self, page: imgui.DrawList, do: Intents, bars: Bars) -> None:
        """Draw the range of the next edit, or of the chosen one, and its knots."""
        if not do.editable:
            return
        frame, length = do.frame, 1
        if 0 <= do.chosen < len(do.shown.edits):
            first, end = do.shown.edits[do.chosen].frames
            frame, length = first, end - first
        left, right = bars.reach(frame, length)
        _box(page, left, bars.top, right, bars.bottom, colours.RANGE)
        for x in bars.knots(frame, length):
            line = colour(colours.faded(colours.LEFT, 0.8))
            page.AddLine(imgui.Vec2(x, bars.top + 12.0), imgui.Vec2(x, bars.top + RULER), line, 1.5)

    def _contacts(self, page: imgui.DrawList, do: Intents, bars: Bars) -> None:
        held = self._held
        for index, one in enumerate(do.shown.contacts):
            if held is not None and held.kind == "contact" and held.end and held.index == index:
                one = bars.moved_contact(held, imgui.GetIO().MousePos.x)
            top = bars.row(one.site)
            tone = colours.faded(colours.of_site(one.site), 0.85)
            _box(page, bars.x(one.start) + 0.5, top + 2, bars.x(one.end) - 0.5, top + ROW - 2, tone)


def _ruler(page: imgui.DrawList, bars: Bars) -> None:
    per_frame = bars.x(1.0) - bars.x(0.0)
    step = next((one for one in _TICKS if one * per_frame >= _TICK_WIDTH), _TICKS[-1])
    line, text = colour(colours.faded(colours.FAINT, 0.5)), colour(colours.FAINT)
    for frame in range(0, bars.shown.nframe, step):
        x = bars.x(float(frame))
        page.AddLine(imgui.Vec2(x, bars.top), imgui.Vec2(x, bars.bottom), line, 1.0)
        page.AddText(imgui.Vec2(x + 3.0, bars.top), text, str(frame))


def _edits(page: imgui.DrawList, do: Intents, bars: Bars) -> None:
    """Draw a mark an edit, by its residual; pins as the range that they hold."""
    for index, (edit, off) in enumerate(zip(do.shown.edits, do.shown.residuals, strict=True)):
        tone = colours.of_residual(off, edit.enabled)
        x, y = bars.mark(index)
        first, end = edit.frames
        if end - first > 1:
            left, right = bars.x(first), bars.x(end)
            _box(page, left, y - ROW / 2 + 2, right, y + ROW / 2 - 2, colours.faded(tone, 0.7))
        elif isinstance(edit, Footprint):
            _box(page, x - 4.0, y - 4.0, x + 4.0, y + 4.0, tone)
        else:
            page.AddCircleFilled(imgui.Vec2(x, y), 4.5, colour(tone))
        if index == do.chosen:
            page.AddCircle(imgui.Vec2(x, y), 6.5, colour(colours.SELECTED), 0, 1.5)


def _label(page: imgui.DrawList, left: float, top: float, text: str) -> None:
    page.AddText(imgui.Vec2(left + 4.0, top - 1.0), colour(colours.FAINT), text[: int(LABEL / 7)])


def _box(
    page: imgui.DrawList, left: float, top: float, right: float, bottom: float, tone: Colour
) -> None:
    if right > left:
        page.AddRectFilled(imgui.Vec2(left, top), imgui.Vec2(right, bottom), colour(tone), 2.0)
