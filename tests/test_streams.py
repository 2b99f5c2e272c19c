"""The command line where the terminal is not as one would wish, and where something goes wrong."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mjmotion.cli import info, main
from mjmotion.cli.written import Written

ROOT = Path(__file__).parents[1]


def shell(line: str, folder: Path, **more: str) -> subprocess.CompletedProcess[bytes]:
    program = f"{sys.executable} -m mjmotion"
    return subprocess.run(
        ["bash", "-c", line.replace("mjmotion", program, 1)],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT), **more},
        capture_output=True,
    )


@pytest.mark.parametrize("encoding", ["cp1252", "ascii", "latin-1", "utf-16"])
def test_any_encoding(encoding: str, tmp_path: Path) -> None:
    done = shell("mjmotion info walk", tmp_path, PYTHONIOENCODING=encoding)
    assert done.returncode == 0, done.stderr
    assert b"Traceback" not in done.stderr
    done = shell("mjmotion info 'n\u00f6\u4e2d'", tmp_path, PYTHONIOENCODING=encoding)
    assert done.returncode == 2
    assert b"Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("line", "code"),
    [
        ("mjmotion info walk >&-", 0),
        ("mjmotion info walk 2>&-", 0),
        ("mjmotion info nothing >&- 2>&-", 2),
        ("mjmotion info walk > /dev/full", 2),
        ("mjmotion info nothing 2> /dev/full", 2),
        ("mjmotion info walk | head -c 1 > /dev/null; exit ${PIPESTATUS[0]}", 0),
    ],
)
def test_streams_that_are_closed_or_full(line: str, code: int, tmp_path: Path) -> None:
    done = shell(line, tmp_path)
    assert done.returncode == code, done.stderr
    assert b"Traceback" not in done.stderr and b"Exception" not in done.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["\x1b[31mred", "a\nb", "a\u202eb", "a\x07b", "a\rb"])
def test_a_name_does_nothing_to_the_terminal(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main.main(["info", name]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert said.rstrip("\n").isprintable()


def test_the_last_catch(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails(args: argparse.Namespace) -> int:
        raise KeyError("rq\nsecond line")

    monkeypatch.setattr(info, "run", fails)
    assert main.main(["info", "walk"]) == 3
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "KeyError" in said and "please report" in said
    for words in (["--debug", "info", "walk"], ["info", "walk", "--debug"]):
        assert main.main(words) == 3
        assert "Traceback" in capsys.readouterr().err


def test_an_interrupt_tells_what_was_written(tmp_path: Path) -> None:
    out = tmp_path / "out"
    written = Written(argparse.Namespace(out=out))
    assert written.said() == "nothing was written"
    out.mkdir()
    (out / "report.json").write_text("{}", "utf-8")
    assert written.said().endswith(str(out))
    later = Written(argparse.Namespace(folder=out))
    assert later.said() == "nothing was written"
    time.sleep(0.02)
    (out / "report.json").write_text("{} ", "utf-8")
    assert later.said().endswith("report.json")


def test_warnings_are_notes_and_no_log_file_is_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import mujoco
    import numpy as np

    def warns(args: argparse.Namespace) -> int:
        model = mujoco.MjModel.from_xml_string(
            "<mujoco><worldbody><body><freejoint/><geom size='1'/></body></worldbody></mujoco>"
        )
        data = mujoco.MjData(model)
        data.qpos[0] = 1e30
        for _ in range(3):
            mujoco.mj_step(model, data)
        np.float64(1e300) * np.float64(1e300)
        return 0

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(info, "run", warns)
    assert main.main(["info", "walk"]) == 0
    lines = capsys.readouterr().err.splitlines()
    assert lines and all(line.startswith("mjmotion: note: ") for line in lines)
    assert any("MuJoCo" in line for line in lines) and any("overflow" in line for line in lines)
    assert not list(tmp_path.iterdir())
