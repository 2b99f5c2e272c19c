"""Charts as SVG text: round ticks, lines with gaps, boxes and legends where they belong."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from mjmotion.output.report.chart import Panel, Scale, drawing


def panel(x: Scale | None = None, y: Scale | None = None) -> Panel:
    across, up = x or Scale(0.0, 10.0), y or Scale(0.0, 1.0)
    return Panel(across.within(50.0, 250.0), up.within(110.0, 10.0))


def points(svg: str) -> list[tuple[str, float, float]]:
    """What the first line of a drawing goes through: M or L, x and y."""
    found = re.search(r'<path d="(M[^"]*)" fill="none"', svg)
    assert found is not None
    pairs = re.findall(r"([ML])([-\d.]+) ([-\d.]+)", found.group(1))
    return [(kind, float(x), float(y)) for kind, x, y in pairs]


@pytest.mark.parametrize(
    ("low", "high", "most", "text"),
    [
        (0.0, 1.05, 5, ["0.00", "0.25", "0.50", "0.75", "1.00"]),
        (0.0, 15.4, 8, ["0", "2", "4", "6", "8", "10", "12", "14"]),
        (-0.12, 0.1, 5, ["−0.10", "−0.05", "0.00", "0.05", "0.10"]),
        (0.0, 1200.0, 4, ["0", "500", "1000"]),
    ],
)
def test_ticks_are_round(low: float, high: float, most: int, text: list[str]) -> None:
    ticks = Scale(low, high).ticks(most)
    assert [word for _, word in ticks] == text
    assert all(low <= at <= high for at, _ in ticks)


def test_ticks_of_a_log_axis_are_powers() -> None:
    scale = Scale(5e-5, 40.0, 100.0, 0.0, log=True)
    words = [word for _, word in scale.ticks(9)]
    assert words == ["10⁻⁴", "10⁻³", "10⁻²", "10⁻¹", "10⁰", "10¹"]
    assert len(scale.ticks(3)) == 3
    places = scale([at for at, _ in scale.ticks(9)])
    assert np.ptp(np.diff(places)) < 1e-9


def test_a_scale_is_around_what_is_finite() -> None:
    scale = Scale.around([1.0, np.nan, 3.0, np.inf], 0.1)
    assert (scale.low, scale.high) == pytest.approx((0.8, 3.2))
    for nothing in ([], [np.nan], [2.0, 2.0], [0.0]):
        empty = Scale.around(np.array(nothing))
        assert empty.low < empty.high


def test_a_line_goes_through_its_points_and_has_gaps() -> None:
    chart = panel()
    chart.line([0, 5, 10, 10, 0], [0, 1, np.nan, 0.5, 0], "#123456")
    assert points(chart.svg()) == [
        ("M", 50.0, 110.0),
        ("L", 150.0, 10.0),
        ("M", 250.0, 60.0),
        ("L", 50.0, 110.0),
    ]
    chart = panel()
    chart.line([0, 1], [np.nan, np.nan], "#123456")
    assert "nan" not in chart.svg()


def test_a_long_line_keeps_its_peaks() -> None:
    values = np.zeros(50_000)
    values[31_234], values[4_321] = 1.0, 0.5
    chart = panel()
    chart.line(np.linspace(0, 10, len(values)), values, "#123456")
    seen = points(chart.svg())
    assert len(seen) < 2000
    assert min(y for _, _, y in seen) == 10.0 and 60.0 in [y for _, _, y in seen]
    assert seen[0][1] == 50.0 and seen[-1][1] == 250.0
    assert np.all(np.diff([x for _, x, _ in seen]) >= 0)


def test_boxes_without_a_size_are_left_out() -> None:
    chart = panel()
    chart.boxes([(0, 5), (5, 10)], [(0, 0.5), (0, np.nan)], "#123456", "some", opacity=0.5)
    assert chart.svg().count("<path") == 1
    assert 'd="M50.00 60.00H150.00V110.00H50.00z"' in chart.svg()
    chart.legend()
    assert ">some</text>" in chart.svg()


def test_a_drawing_is_xml_and_escapes_names() -> None:
    chart = panel()
    chart.line([0, 10], [0, 1], "#123456", "left <&> right", dots=5.0)
    chart.number_axis_x("time [s]")
    chart.number_axis_y("height [m]")
    chart.legend(right=True)
    root = ET.fromstring(drawing([chart, panel()], 4.0, 2.0))
    assert root.get("viewBox") == "0 0 288 144"
    words = ["".join(text.itertext()) for text in root.iter("{http://www.w3.org/2000/svg}text")]
    assert "left <&> right" in words and "time [s]" in words and "height [m]" in words
