"""What the README shows works: its Python runs, its commands parse, its links lead somewhere."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from mjmotion import cli

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "README.md").read_text("utf-8")
CHEAP = ("info", "scene")  # commands that are run and not only parsed


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", TEXT, re.MULTILINE | re.DOTALL)


def commands() -> list[list[str]]:
    """The words of every shown command line, with continued lines put together."""
    lines = [line for block in blocks("bash") for line in block.replace("\\\n", " ").splitlines()]
    return [words for line in lines if (words := shlex.split(line, comments=True))]


def named(words: list[str]) -> str:
    return " ".join(words)


def test_the_readme_shows_something() -> None:
    assert len(blocks("python")) >= 1
    assert ["make", "demo"] in commands()
    assert ["make", "test"] in commands()


@pytest.mark.parametrize("code", blocks("python"), ids=lambda code: code.strip().splitlines()[0])
def test_python_runs(code: str, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("words", commands(), ids=named)
def test_commands_are_real(words: list[str], tmp_path: Path) -> None:
    program, *rest = words
    if program == "make":
        makefile = (ROOT / "Makefile").read_text("utf-8")
        assert all(re.search(rf"^{re.escape(target)}:", makefile, re.MULTILINE) for target in rest)
    elif program == "mjmotion":
        args = cli.parse(rest)
        about = getattr(args, "what", "") or getattr(args, "source", "")
        if args.command in CHEAP and not Path(about).suffix and "/" not in about:
            done = subprocess.run(
                [sys.executable, "-m", "mjmotion", *rest], cwd=tmp_path, capture_output=True
            )
            assert done.returncode == 0, done.stderr
    elif program == "python":
        assert (ROOT / rest[0]).is_file(), rest[0]
    else:
        assert program in ("pip", "cd", "git", "sudo"), f"the README shows an untested {program}"


def test_links_lead_somewhere() -> None:
    for target in re.findall(r"\]\(([^)#]+)\)", TEXT):
        if not target.startswith(("http:", "https:")):
            assert (ROOT / target).exists(), target
