"""The report: strict JSON with every figure, a table, and a page that stands on its own."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import mujoco
import numpy as np
import pytest
from made_up import some

from mjmotion.body.motion import Motion
from mjmotion.constraints.unmet import Unmet
from mjmotion.exceptions import MotionError, OutputError
from mjmotion.footsteps.contacts import Contact
from mjmotion.output.reading import read_results
from mjmotion.output.report import Report
from mjmotion.validation import THRESHOLDS, validate
from mjmotion.validation.result import LABELS

XML = """<mujoco><worldbody><geom name="floor" type="plane" size="5 5 .1"/>
<body name="trunk" pos="0 0 .5"><freejoint name="root"/>
  <geom name="trunk" type="box" size=".1 .1 .1" pos="0 0 .3"/>
  <body name="left_foot" pos="0 0 -.4"><joint name="ankle" axis="0 1 0"/>
    <geom name="sole" type="box" size=".1 .05 .02" pos="0 0 -.08"/>
    <site name="left_heel" pos="-.1 0 -.1"/><site name="left_toe" pos=".1 0 -.1"/>
  </body></body></worldbody></mujoco>"""
LEVELS = (
    {"level": 1, "frames_per_knot": 16.0, "seconds": 0.01, "max_error_percent": 4.5},
    {"level": 2, "frames_per_knot": 8.0, "seconds": 0.02, "max_error_percent": 0.7},
)
UNMET = (Unmet("left_toe <&> rail", (3, 4), 12.5).as_dict(),)


def make(gap: float = 0.003, contacts: bool = True) -> Report:
    model = mujoco.MjModel.from_xml_string(XML)
    own = np.tile(model.qpos0, (60, 1))
    own[:, 0] = np.linspace(0, 1, 60)
    own[:, 7] = 0.1 * np.sin(np.arange(60) / 5)
    own[:20, 0], own[:20, 7] = 0.0, 0.0
    adapted = own.copy()
    adapted[7, 2] += gap
    source, motion = Motion(model, own, 30), Motion(model, adapted, 30)
    stand = (Contact("left_heel", 0, 20), Contact("left_toe", 0, 20)) if contacts else ()
    return Report(
        source,
        motion,
        stand,
        validate(source, motion, stand),
        levels=LEVELS,
        fit_seconds=0.031,
        exact_error_percent=0.0,
        unmet=UNMET,
        title="walk on <floor> & co",
    )


def save_folder(report: Report, folder: Path) -> None:
    (folder / "model.xml").write_text(XML, "utf-8")
    report.motion.save(folder / "motion.npz")
    report.source.save(folder / "source.npz")
    contacts = [{"site": c.site, "start": c.start, "end": c.end} for c in report.contacts]
    (folder / "contacts.json").write_text(json.dumps(contacts), "utf-8")


def measured_again(folder: Path, thresholds: dict[str, object] | None = None) -> Report:
    result = read_results(folder)
    return result.report(result.validate(thresholds))


def strict(text: str) -> dict:
    def refuse(name: str) -> None:
        raise AssertionError(f"{name} is not JSON")

    return json.loads(text, parse_constant=refuse)


def test_json_holds_what_the_design_says(tmp_path: Path) -> None:
    report = make()
    report.write(tmp_path)
    saved = strict((tmp_path / "report.json").read_text("utf-8"))
    assert saved["levels"] == list(LEVELS)
    assert saved["fit_seconds"] == 0.031
    assert set(saved["metrics"]) == set(LABELS)
    assert saved["metrics"]["stance_gap_max_mm"] == pytest.approx(3.0)
    assert saved["metrics"]["stance_gap_hfield_p95_mm"] is None  # no heightfield
    assert set(saved["thresholds"]) == set(THRESHOLDS)
    assert saved["thresholds"]["root_travel_ratio"] == [0.97, 1.03]
    assert saved["broken"] == report.broken
    assert "stance_gap_max_mm" in saved["broken"]
    assert saved["worst"]["stance_gap_max_mm"]["frame"] == 7
    assert "floor" in saved["worst"]["stance_gap_max_mm"]["where"]
    assert [c["site"] for c in saved["per_contact"]] == ["left_heel", "left_toe"]
    assert saved["unmet"] == list(UNMET)


def test_json_stays_strict_where_a_foot_stands_on_nothing(tmp_path: Path) -> None:
    model = mujoco.MjModel.from_xml_string(XML.replace('type="plane" size="5 5 .1"', 'size=".01"'))
    motion = Motion(model, np.tile(model.qpos0, (5, 1)), 30)
    contacts = (Contact("left_heel", 0, 5),)
    report = Report(motion, motion, contacts, validate(motion, motion, contacts))
    report.write(tmp_path)
    saved = strict((tmp_path / "report.json").read_text("utf-8"))
    assert saved["metrics"]["stance_gap_max_mm"] is None
    assert "stance_gap_max_mm" in saved["broken"]
    assert "∞" in report.table()


def test_table_is_aligned_and_says_what_is_broken() -> None:
    report = make()
    lines = report.validation.table().splitlines()
    assert len(lines) == 1 + len(LABELS)
    gap = next(line for line in lines if line.startswith("stance gap, planes"))
    assert re.search(r"3\.000 mm +≤ 2 +BROKEN +frame 7, left_heel over floor", gap)
    drift = next(line for line in lines if line.startswith("stance drift"))
    assert drift.index("≤") == gap.index("≤")
    assert report.table() == "\n".join(lines)


def test_a_folder_is_measured_again(tmp_path: Path) -> None:
    report = make()
    save_folder(report, tmp_path)
    report.write(tmp_path)
    saved = json.loads((tmp_path / "report.json").read_text("utf-8"))
    saved["metrics"] = {"stance_gap_max_mm": 0.0}  # what an old report says does not count
    (tmp_path / "report.json").write_text(json.dumps(saved), "utf-8")
    again = measured_again(tmp_path)
    for name, value in report.metrics.items():
        assert again.metrics[name] == pytest.approx(value, nan_ok=True), name
    assert again.levels == LEVELS and again.fit_seconds == 0.031 and again.unmet == UNMET
    assert again.broken == report.broken
    lenient = measured_again(tmp_path, {"stance_gap_max_mm": 5})
    assert set(report.broken) - set(lenient.broken) == {"stance_gap_max_mm"}


def test_a_folder_without_a_report_has_figures_but_no_fit(tmp_path: Path) -> None:
    save_folder(make(), tmp_path)
    report = measured_again(tmp_path)
    assert report.levels == () and report.fit_seconds is None
    report.write(tmp_path)
    assert strict((tmp_path / "report.json").read_text("utf-8"))["fit_seconds"] is None


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("model.xml", None),
        ("model.xml", "<mujoco>"),
        ("motion.npz", None),
        ("motion.npz", "no .npz archive"),
        ("contacts.json", "[{"),
        ("report.json", "{"),
        ("report.json", "[1, 2]"),
    ],
)
def test_damaged_folders_give_one_line(tmp_path: Path, name: str, content: str | None) -> None:
    save_folder(make(), tmp_path)
    (tmp_path / "report.json").write_text("{}", "utf-8")
    if content is None:
        (tmp_path / name).unlink()
    else:
        (tmp_path / name).write_text(content, "utf-8")
    with pytest.raises(MotionError) as caught:
        measured_again(tmp_path)
    assert "\n" not in str(caught.value)
    assert name in str(caught.value)


def test_write_needs_a_folder(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="cannot write"):
        make().write(tmp_path / "missing")


class _Page(HTMLParser):
    """Collects text, tags and what the page would load from elsewhere."""

    void = frozenset({"meta", "img", "br", "link", "input"})

    def __init__(self, html: str) -> None:
        super().__init__()
        self.words: list[str] = []
        self.tags: list[str] = []
        self.open: list[str] = []
        self.ids: list[str] = []
        self.loads: list[str] = []
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        if tag not in self.void:
            self.open.append(tag)
        for name, value in attrs:
            if name == "id":
                self.ids.append(some(value))
            if name in ("src", "href", "xlink:href") and not some(value).startswith(("data:", "#")):
                self.loads.append(some(value))

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in self.void:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.words.append(data)


def test_page_stands_alone_and_says_everything() -> None:
    report = make()
    html = report.html(why_no_poses="install the package libegl1")
    page = _Page(html)
    text = " ".join(" ".join(page.words).split())
    assert page.open == [] and page.loads == []
    assert "script" not in page.tags and "url(http" not in html
    assert len(page.ids) == len(set(page.ids))
    for row in report.validation.summary():
        assert row.label in text
    assert "walk on <floor> & co" in text  # escaped, so it reads as it was written
    assert "3.000" in text and "✗ broken" in text and "✓ holds" in text
    assert "install the package libegl1" in text
    assert "left_toe <&> rail" in text and "12.5 mm" in text
    assert page.tags.count("svg") == 5
    for word in ("height [m]", "greatest error", "Lee and Shin 1999", "drift [mm]", "RMS jerk"):
        assert word in text
    assert "currentColor" in html and "#010203" not in html


def test_page_without_contacts_and_fit_leaves_their_plots_out() -> None:
    report = make(contacts=False)
    bare = Report(report.source, report.motion, (), report.validation)
    page = _Page(bare.html())
    text = " ".join(page.words)
    assert "Drift per contact" not in text and "Residual per level" not in text
    assert "Penetration over time" in text


def test_pictures_are_inside_the_page() -> None:
    image = np.zeros((8, 12, 3), np.uint8)
    image[:, 6:] = (200, 30, 30)
    html = make().html([image, b"\x89PNG\r\n\x1a\n...."])
    assert html.count("<img ") == 2
    assert 'src="data:image/jpeg;base64,' in html and 'src="data:image/png;base64,' in html
    assert "No pictures of poses" not in html


def test_the_page_needs_no_plotting_library() -> None:
    """It is written at the end of every command; matplotlib alone took a second there."""
    code = (
        "import sys, mjmotion.output.report.page\n"
        "assert not {'matplotlib', 'PIL', 'scipy.interpolate'} & set(sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
