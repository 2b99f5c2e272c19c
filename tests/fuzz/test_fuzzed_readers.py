"""A few hundred damaged files through every reader, and made-up ones: refused in words, or read."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

import fuzz_all
import pytest
import readers
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mjmotion.boundary.structured import read_structured
from mjmotion.boundary.words import harmless, one_line
from mjmotion.clips import load_clip
from mjmotion.exceptions import MotionError

CASES = 270
EVERY = readers.readers()


@pytest.mark.parametrize("name", EVERY)
def test_what_is_not_damaged_is_read(name: str, tmp_path: Path) -> None:
    reader = EVERY[name]
    assert readers.judged(reader, reader.whole, tmp_path) == "read"


def test_damaged_files(capfd: pytest.CaptureFixture[str]) -> None:
    table = fuzz_all.fuzz(CASES, seed=1)
    assert fuzz_all.faults(table) == 0, capfd.readouterr().err
    assert all(count["refused"] for count in table.values())


def test_faults_are_found(tmp_path: Path) -> None:
    """The judge sees an error that nobody foresaw, and one that takes too long."""

    def fails(path: Path) -> object:
        raise KeyError("key")

    def left(path: Path) -> object:
        return (path.parent / "MUJOCO_LOG.TXT").write_text("x", "utf-8")

    assert readers.judged(readers.Reader("f", b"", lambda _: b"", fails), b"", tmp_path) == (
        "traceback: KeyError: 'key'"
    )
    with pytest.raises(AssertionError, match="left"):
        readers.judged(readers.Reader("f", b"", lambda _: b"", left), b"", tmp_path)


PLAIN = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8)
NESTED = st.recursive(
    PLAIN, lambda inner: st.lists(inner) | st.dictionaries(st.text(max_size=6), inner), max_leaves=9
)
KEYS = ("site", "frames", "position", "quat", "weight", "free", "to", "look_at", "axis")
quick = settings(
    max_examples=60,
    deadline=None,
    database=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow],
)


def verdict(name: str, data: bytes) -> str:
    with tempfile.TemporaryDirectory() as folder:
        return readers.judged(EVERY[name], data, Path(folder))


@quick
@given(st.lists(st.fixed_dictionaries({}, optional={key: NESTED for key in KEYS}), max_size=2))
def test_constraints_of_any_values(entries: list[Any]) -> None:
    data = json.dumps(entries).encode()
    assert verdict("constraints.json", data) in ("read", "refused")
    assert verdict("constraints.yaml", data) in ("read", "refused")


@quick
@given(
    st.lists(st.fixed_dictionaries({"site": NESTED, "start": NESTED, "end": NESTED}), max_size=2)
)
def test_contacts_of_any_values(entries: list[Any]) -> None:
    assert verdict("contacts", json.dumps(entries).encode()) in ("read", "refused")


@quick
@given(st.dictionaries(st.sampled_from(("title", "levels", "unmet", "fit_seconds")), NESTED))
def test_reports_of_any_values(report: dict[str, Any]) -> None:
    assert verdict("report", json.dumps(report).encode()) in ("read", "refused")


@quick
@given(st.sampled_from(("joints", "up", "scale", "ignore")), NESTED)
def test_mappings_of_any_values(key: str, value: Any) -> None:
    assert verdict("mapping", json.dumps({key: value}).encode()) in ("read", "refused")


@quick
@given(st.sampled_from(("contacts", "thresholds", "bvh", "csv", "asf")), st.binary(max_size=200))
def test_any_bytes(name: str, data: bytes) -> None:
    assert verdict(name, data) in ("read", "refused")


@quick
@given(st.text())
def test_words_are_harmless(text: str) -> None:
    line = one_line(text)
    assert line.isprintable() or any(letter.isspace() for letter in line)
    assert "\x1b" not in line and "\n" not in line
    assert harmless(line) == line
    line.encode("utf-8")  # no half of a pair is left


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a: 1\na: 2\n", "twice"),
        ("a: &a [*a]\n", "within what it names"),
        ("[" * 100, "deep"),
        ("9" * 5000, "digits"),
        ("a: 2024-13-45\n", "YAML"),
        ("? [1]\n: 2\n", "YAML"),
        ("\ufeffa: 1\n", ""),
    ],
)
def test_yaml_that_lies(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text(text, "utf-8")
    if not said:
        assert read_structured(path, "file") == {"a": 1}
        return
    with pytest.raises(MotionError, match=said):
        read_structured(path, "file")


def test_a_loop_repeated_for_ever(tmp_path: Path) -> None:
    path = tmp_path / "a.bvh"
    path.write_text(readers.BVH, "utf-8")
    with pytest.raises(MotionError, match="900000 times: 10,800,000"):
        load_clip(path, loop=900_000)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "is empty"),
        ('{"fit_seconds": 1e400}', "holds 1e400"),
        ('{"levels": 5}', "levels is 5, no list of objects"),
        ('{"unmet": {"a": 1}}', "unmet is a mapping, no list of objects"),
        ('{"notes": "abc"}', "notes are 'abc', no list of text"),
        ('{"unmet": [{"constraint": "a", "frames": [], "residual_mm": 1}]}', "no frames"),
        ('{"unmet": [{"constraint": "a", "frames": [1]}]}', "no residual"),
    ],
)
def test_reports_that_lie(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "report.json"
    path.write_text(text, "utf-8")
    with pytest.raises(MotionError, match=said):
        EVERY["report"].read(path)
