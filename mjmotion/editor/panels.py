"""The panels: how edits are done, the list of them, what came of the last, figures, files."""

from __future__ import annotations

import math

from mujoco.studio.dear_imgui import dear_imgui as imgui

from mjmotion.apps.edit import HOLDS
from mjmotion.apps.session.edits import Drag, Edit, Footprint, Pin, Vector
from mjmotion.editor import colours
from mjmotion.editor.colours import Colour
from mjmotion.editor.files import Files
from mjmotion.editor.intents import Intents
from mjmotion.editor.keys import HELP

WIDTH = 272.0  # of the panel of edits [pixel]
RESULT_WIDTH = 330.0
_SOLVERS = ("hybrid", "numeric")
_MOST_KNOTS, _MOST_LEVELS = 60, 8  # of the sliders
_RIGIDITY = 20.0  # a joint is made that much stiffer, or looser, at most


class Panels:
    """Draws the panels and turns what is clicked into intents."""

    def __init__(self, files: Files) -> None:
        self._files = files
        self._joint = 0
        self._slid: dict[str, float] = {}  # values of sliders that are not let go yet
        self._places: dict[int, Vector] = {}
        self._size = (0.0, 0.0)

    def draw(self, do: Intents, width: float, height: float) -> None:
        """Draw them in a page of some size above the timeline [pixel]."""
        # Where they were put by hand they stay, until the page gets another size.
        again = imgui.Cond.Always if (width, height) != self._size else imgui.Cond.FirstUseEver
        self._size = (width, height)
        small = width < WIDTH + RESULT_WIDTH + 200.0
        if do.panels["edit"]:
            tall = max(100.0, min(height - 12.0, 620.0 if do.editable else 300.0))
            title = "Edit" if do.editable else "View"
            if self._begin(do, "edit", title, (6.0, WIDTH, tall), int(again)):
                self._show(do)
                if do.editable:
                    self._history(do)
                    self._settings(do)
                    self._edits(do)
                if imgui.CollapsingHeader("Keys and mouse"):
                    for line in HELP:
                        imgui.TextWrapped(line)
            imgui.End()
        if do.panels["result"] and not (small and do.panels["edit"]):
            tall = max(100.0, min(height - 12.0, 560.0))
            left = max(6.0, width - RESULT_WIDTH - 6.0)
            if self._begin(do, "result", "Result", (left, RESULT_WIDTH, tall), int(again)):
                self._fit(do)
                self._write(do)
                self._figures(do)
            imgui.End()
        self._offer(do, width, height)

    def _begin(
        self, do: Intents, name: str, title: str, box: tuple[float, float, float], again: int
    ) -> bool:
        """Begin a panel: its left edge, width and height [pixel]; False if it is folded."""
        left, width, height = box
        imgui.SetNextWindowPos(imgui.Vec2(left, 6.0), again)
        imgui.SetNextWindowSize(imgui.Vec2(width, height), again)
        imgui.SetNextWindowBgAlpha(0.88)
        flags = imgui.WindowFlags
        look = int(flags.NoSavedSettings) | int(flags.NoNav)
        unfolded, do.panels[name] = imgui.Begin(title, True, look)
        return bool(unfolded)

    def _show(self, do: Intents) -> None:
        _, do.ghost = imgui.Checkbox("source", do.ghost)
        imgui.SameLine()
        _, do.paths = imgui.Checkbox("paths", do.paths)
        imgui.SameLine()
        _, do.marks = imgui.Checkbox("marks", do.marks)
        imgui.SameLine()
        _, do.follow = imgui.Checkbox("follow", do.follow)

    def _history(self, do: Intents) -> None:
        shown = do.settled
        for label, count, act in (("Undo", shown.undo, do.undo), ("Redo", shown.redo, do.redo)):
            imgui.BeginDisabled(not count)
            if imgui.Button(f"{label} ({count})###{label}", imgui.Vec2(84.0, 0.0)):
                act()
            imgui.EndDisabled()
            imgui.SameLine()
        imgui.NewLine()

    def _settings(self, do: Intents) -> None:
        imgui.SeparatorText("Next edit")
        settings = do.settled.settings
        imgui.PushItemWidth(130.0)
        knots = self._slider("frames a knot", settings.frames_per_knot, 1, _MOST_KNOTS)
        if knots is not None:
            do.set_settings(frames_per_knot=knots)
        levels = self._slider("levels", settings.levels, 1, _MOST_LEVELS)
        if levels is not None:
            do.set_settings(levels=levels)
        changed, hold = imgui.Combo("hold", HOLDS.index(settings.hold), list(HOLDS))
        if changed:
            do.set_settings(hold=HOLDS[hold])
        changed, solver = imgui.Combo("IK", _SOLVERS.index(settings.ik), list(_SOLVERS))
        if changed:
            do.set_settings(ik=_SOLVERS[solver])
        changed, exact = imgui.Checkbox("exact pass", settings.exact)
        if changed:
            do.set_settings(exact=exact)
        if imgui.CollapsingHeader("Rigidity of joints"):
            self._rigidity(do)
        imgui.PopItemWidth()

    def _slider(self, label: str, value: int, low: int, high: int) -> int | None:
        """Return a slider's value when it is let go, None else: every change can be undone."""
        _, at = imgui.SliderInt(label, int(self._slid.get(label, value)), low, high)
        if imgui.IsItemActive():
            self._slid[label] = at
            return None
        let_go = self._slid.pop(label, None)
        return None if let_go is None else int(let_go)

    def _rigidity(self, do: Intents) -> None:
        model = do.settled.model
        names = [model.joint(i).name for i in range(model.njnt) if model.joint(i).name]
        self._joint = min(self._joint, len(names) - 1)
        _, self._joint = imgui.Combo("joint", self._joint, names)
        known = dict(do.settled.settings.rigidity)
        name = names[self._joint]
        log = int(imgui.SliderFlags.Logarithmic)
        value = self._slid.get("rigid", known.get(name, 1.0))
        _, at = imgui.SliderFloat("times", value, 1.0 / _RIGIDITY, _RIGIDITY, "%.2f", log)
        if imgui.IsItemActive():
            self._slid["rigid"] = at
        elif "rigid" in self._slid:
            do.set_rigidity(name, round(self._slid.pop("rigid"), 2))
        for joint, factor in do.settled.settings.rigidity:
            if imgui.SmallButton(f"x###{joint}"):
                do.set_rigidity(joint, 1.0)
            imgui.SameLine()
            imgui.Text(f"{joint}  {factor:g}")

    def _edits(self, do: Intents) -> None:
        shown = do.settled
        imgui.SeparatorText(f"Edits ({len(shown.edits)})")
        if do.selected:
            imgui.Text(f"selected: {do.selected}")
            imgui.SameLine()
            if imgui.SmallButton("pin here"):
                reach = shown.settings.frames_per_knot
                do.pin(do.frame - reach, do.frame + reach + 1)
            imgui.SameLine()
            _, do.still = imgui.Checkbox("still", do.still)
            imgui.SetItemTooltip("hold the place of this frame, not that of each")
        elif not shown.edits:
            imgui.TextWrapped("Ctrl-drag a body, a standing foot or a door.")
        for index, (edit, off) in enumerate(zip(shown.edits, shown.residuals, strict=True)):
            imgui.PushID(index)
            changed, on = imgui.Checkbox("##on", edit.enabled)
            if changed:
                do.enable(index, on)
            imgui.SameLine()
            _tone(colours.of_residual(off, edit.enabled), "o")
            imgui.SameLine()
            if imgui.Selectable(f"{index + 1} {describe(edit, off)}", index == do.chosen):
                do.choose(-1 if index == do.chosen else index)
            imgui.PopID()
        if 0 <= do.chosen < len(shown.edits):
            self._chosen(do, shown.edits[do.chosen])

    def _chosen(self, do: Intents, edit: Edit) -> None:
        """Draw what can be done with the chosen edit."""
        place = edit.move if isinstance(edit, Footprint) else edit.position
        if place is not None:
            at = list(self._places.get(do.chosen, place))
            done = False
            imgui.PushItemWidth(68.0)
            for i, axis in enumerate("xyz"):
                changed, value = imgui.DragFloat(f"##{axis}", at[i], 0.005, 0.0, 0.0, "%.3f")
                if changed:
                    at[i] = value
                    self._places[do.chosen] = (at[0], at[1], at[2])
                done |= bool(imgui.IsItemDeactivatedAfterEdit())
                imgui.SameLine()
            imgui.PopItemWidth()
            imgui.Text("m")
            if done and do.chosen in self._places:
                do.move_edit_to(do.chosen, self._places.pop(do.chosen))
        if imgui.Button("delete"):
            do.delete(do.chosen)

    def _fit(self, do: Intents) -> None:
        trace = do.shown.trace
        rate = do.worker.rate
        if do.dragged is not None:
            imgui.Text(f"dragging {do.dragged.name}: {rate} edits a second")
        elif trace is not None:
            changed = do.shown.changed
            reach = f", frames {changed[0]} to {changed[-1]}" if len(changed) else ""
            imgui.Text(f"last fit {1000 * trace.fit_seconds:.0f} ms{reach}")
        if trace is not None:
            for level in trace.levels:
                imgui.TextDisabled(
                    f"level {level.level}: knot every {level.frames_per_knot:g}, leaves"
                    f" {level.max_error_percent:.3f} %"
                )
            imgui.TextDisabled(f"in the end off by {trace.exact_error_percent:.4f} % of height")

    def _figures(self, do: Intents) -> None:
        imgui.SeparatorText("Figures" + ("" if do.figures.fresh else " (of before)"))
        if do.figures.error:
            imgui.TextWrapped(do.figures.error)
        flags = int(imgui.TableFlags.RowBg) | int(imgui.TableFlags.SizingStretchProp)
        if do.figures.rows and imgui.BeginTable("figures", 3, flags):
            imgui.TableSetupColumn("figure", 0, 0.6)
            imgui.TableSetupColumn("motion", 0, 0.2)
            imgui.TableSetupColumn("source", 0, 0.2)
            imgui.TableHeadersRow()
            for row in do.figures.rows:
                if math.isnan(row.value):
                    continue
                imgui.TableNextColumn()
                imgui.Text(row.label + (f" [{row.unit}]" if row.unit else ""))
                imgui.SetItemTooltip(
                    f"{row.label}: wanted {row.threshold or 'nothing'}; {row.where}"
                )
                imgui.TableNextColumn()
                judged = {True: colours.MET, False: colours.FAR, None: colours.TEXT}
                _tone(judged[row.ok], number(row.value))
                imgui.TableNextColumn()
                imgui.TextDisabled(number(row.source))
            imgui.EndTable()

    def _write(self, do: Intents) -> None:
        files = self._files
        imgui.SeparatorText("Files")
        imgui.SetNextItemWidth(180.0)
        _, files.name = imgui.InputText("name", files.name)
        imgui.SameLine()
        _, files.replace = imgui.Checkbox("replace", files.replace)
        if do.editable:
            if imgui.Button("save session"):
                files.save_session()
            imgui.SameLine()
            if imgui.Button("load session"):
                files.load_session()
        if imgui.Button("motion"):
            files.export_motion()
        imgui.SameLine()
        if imgui.Button("contacts"):
            files.export_contacts()
        imgui.SameLine()
        if imgui.Button("result folder"):
            files.export_result()
        imgui.SameLine()
        if imgui.Button("video"):
            files.export_video()
        task = files.task
        if task is not None:
            imgui.ProgressBar(task.share, imgui.Vec2(200.0, 0.0), f"{task.label}: {task.stage}")
            imgui.SameLine()
            if imgui.Button("cancel"):
                task.cancel()

    def _offer(self, do: Intents, width: float, height: float) -> None:
        """Offer what an earlier start kept aside."""
        if do.autosave is None or not do.autosave.offered:
            return
        always = int(imgui.Cond.Always)
        centre = imgui.Vec2(0.5, 0.5)
        imgui.SetNextWindowPos(imgui.Vec2(width / 2.0, height / 2.0), always, centre)
        flags = imgui.WindowFlags
        look = int(flags.AlwaysAutoResize) | int(flags.NoCollapse) | int(flags.NoSavedSettings)
        imgui.Begin("Not saved", None, look)
        imgui.Text(f"An earlier start left edits that were not saved:\n{do.autosave.path}")
        if imgui.Button("restore"):
            self._files.restore()
        imgui.SameLine()
        if imgui.Button("discard"):
            self._files.discard()
        imgui.End()


def describe(edit: Edit, off: float) -> str:
    """Return an edit in a few words, with how far its site is from its place [m]."""
    if isinstance(edit, Drag):
        return f"{edit.site} @{edit.frame}  {1000 * off:.1f} mm"
    if isinstance(edit, Pin):
        left = "" if math.isnan(off) else f"  {1000 * off:.1f} mm"
        return f"pin {edit.site} {edit.start}-{edit.end - 1}{left}"
    turn = f", {math.degrees(edit.turn):.0f} deg" if edit.turn else ""
    return f"{edit.side} footprint @{edit.frame}{turn}"


def number(value: float) -> str:
    """Return a figure in four characters or so; "-" for one that was not there to measure."""
    if math.isnan(value):
        return "-"
    return f"{value:.0f}" if abs(value) >= 1000.0 else f"{value:.3g}"


def _tone(tone: Colour, text: str) -> None:
    imgui.TextColored(imgui.Vec4(*tone), text)
