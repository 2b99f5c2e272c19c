"""What the documents name is there: functions of the method's tables, packages of the map."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import pytest
from test_architecture import MAP

ROOT = Path(__file__).parents[1]
METHOD = (ROOT / "docs" / "method.md").read_text("utf-8")
TABLES = ("From the paper to the code", "Data flow")


def section(title: str) -> str:
    """What is under a heading, up to the next of its kind."""
    found = re.search(
        rf"^## {re.escape(title)}\n(.*?)(?=^## |\Z)", METHOD, re.MULTILINE | re.DOTALL
    )
    assert found, title
    return found[1]


def rows(title: str) -> list[list[str]]:
    """The cells of the table under a heading, without its head."""
    lines = [line for line in section(title).splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


def named() -> list[str]:
    """Functions of the last column of the tables, each once."""
    cells = [row[-1] for title in TABLES for row in rows(title)]
    return sorted({name for cell in cells for name in re.findall(r"`([^`]+)`", cell)})


def find(name: str) -> object:
    """Return what a dotted name without ``mjmotion.`` stands for."""
    parts = name.split(".")
    for count in range(len(parts), 0, -1):
        try:
            thing: object = importlib.import_module(".".join(("mjmotion", *parts[:count])))
        except ModuleNotFoundError:
            continue
        for part in parts[count:]:
            thing = getattr(thing, part)
        return thing
    raise ModuleNotFoundError(name)


@pytest.mark.parametrize("name", named())
def test_functions_of_the_method_exist(name: str) -> None:
    assert callable(find(name)), name
    assert name.split(".")[0] in MAP


def test_every_row_names_a_function() -> None:
    for title in TABLES:
        for row in rows(title):
            assert len(row) == 3 and "`" in row[2], row


def test_all_of_the_paper_is_in_the_table() -> None:
    text = " ".join(row[0] for row in rows(TABLES[0]))
    equations = [f"Eq. {number}" for number in range(1, 8)]
    sections = ["§3.1", "§3.2", "§4.1", "§4.2", "§4.3", "§4.4", "§4.5", "§5.1", "§5.2", "§5.3"]
    algorithm = ["Algorithm 1", "lines 1 and 10", "lines 2, 3, 6 and 7", "line 4", "line 5"]
    for wanted in (*equations, *sections, *algorithm, "line 8", "line 9", "§6", "§7", "Table 1"):
        assert wanted in text, wanted


def test_modules_and_tests_that_are_mentioned_exist() -> None:
    for path in re.findall(r"`([a-z_]+/[a-z_/]+\.py)`", METHOD):
        inside = ROOT if path.startswith("tests/") else ROOT / "mjmotion"
        assert (inside / path).is_file(), path
    shared = (ROOT / "tests" / "test_shared.py").read_text("utf-8")
    for name in re.findall(r"`(test_\w+)`", METHOD):
        assert f"def {name}(" in shared, name


def test_the_map_is_that_of_the_code() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text("utf-8")
    shown = re.findall(r"^\| `(\w+)` \|", text, re.MULTILINE)
    assert tuple(shown) == MAP
