"""The command line where the terminal is not as one would wish, and where something goes wrong."""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import command_line
import pytest

from mjmotion.cli import info, main
from mjmotion.cli.written import Written
from mjmotion.constraints.unmet import Unmet

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
        ("mjmotion adapt --help > /dev/full", 2),
        ("mjmotion --version > /dev/full", 2),
        ("mjmotion --version >&-", 0),
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


def test_ctrl_c_while_c_is_imported_is_no_fault(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """NumPy and others, interrupted as they are imported, raise an ImportError of it."""

    def interrupted(args: argparse.Namespace) -> int:
        try:
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(1.0)
        except KeyboardInterrupt:
            raise ImportError("initialization failed") from None
        return 0

    before = signal.getsignal(signal.SIGINT)
    monkeypatch.setattr(info, "run", interrupted)
    assert main.main(["info", "walk"]) == 130
    assert capsys.readouterr().err == "mjmotion: interrupted, nothing was written\n"
    assert signal.getsignal(signal.SIGINT) is before


def test_what_c_writes_to_stderr_is_a_note(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def writes(args: argparse.Namespace) -> int:
        os.write(2, b"QH6154 \x1b[31m flat\n\nQH6154 \x1b[31m flat\n")
        print("own", file=sys.stderr)
        return 0

    monkeypatch.setattr(info, "run", writes)
    assert main.main(["info", "walk"]) == 0
    assert capfd.readouterr().err == "own\nmjmotion: note: QH6154 \\x1b[31m flat\n"


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("adapt walk --scene flat --no-video --out .", "other files than results"),
        ("adapt walk --scene flat --no-video --out circle", "nowhere"),
        ("adapt walk --scene flat --no-video --out file/x", "file' is a file, not a folder"),
        ("adapt walk --scene folder --no-video --out o", "'folder' is a folder"),
        ("adapt walk --scene flat --no-video --out o --mapping m.yaml", "leave --mapping"),
        ("adapt walk --scene flat --no-video --out o --loop 2", "leave --loop"),
        ("adapt walk --scene flat --no-video --out o --loop 3000000", "from 1 to 1,000,000"),
        ("validate .", "is not a result"),
        ("validate file", "'file' is a file: give the folder of a result"),
        ("render file --out .", "needs --model"),
        ("edit-frame walk --frame 3 --site pelvis --by 0 0 1e9 --out o", "beyond 10,000"),
        ("edit-frame walk --frame 3 --site pelvis --out o", "--by or --to 0"),
        ("transition walk climb --out o --no-video", "use left_heel, left_toe"),
        ("info nothing.csv", "file 'nothing.csv' does not exist"),
    ],
)
def test_words_tell_what_is_at_fault(
    line: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "circle").symlink_to("circle")
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").write_text("x", "utf-8")
    before = sorted(tmp_path.iterdir())
    done = command_line.run(*line.split())
    assert done.returncode == 2 and done.stderr.count("\n") == 1 and said in done.stderr, done
    assert sorted(tmp_path.iterdir()) == before


def test_a_wrong_mujoco_gl_is_no_fault_of_ours(tmp_path: Path) -> None:
    done = shell("mjmotion info walk", tmp_path, MUJOCO_GL="foo")
    assert done.returncode == 2 and done.stderr.count(b"\n") == 1
    assert b"MUJOCO_GL" in done.stderr and b"fault" not in done.stderr


def test_far_residuals_are_told_in_metres() -> None:
    assert str(Unmet("position of x", (3,), 8.25)).endswith("off by 8.2 mm")
    assert str(Unmet("position of x", (3,), 15072.5)).endswith("off by 15.1 m")
