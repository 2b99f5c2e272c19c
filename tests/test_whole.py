"""Files and folders whole or not at all: nothing of a user's is lost, leftovers are tidied."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from pathlib import Path

import pytest

from mjmotion.boundary import whole
from mjmotion.boundary.whole import exchange, leftovers, locked, put_in_place, tidy, write_whole
from mjmotion.exceptions import OutputError
from mjmotion.output.folder import check_output, result_folder

MODEL = '<mujoco><asset><hfield name="h" file="terrain.bin"/></asset></mujoco>'


@pytest.fixture
def umask() -> Iterator[None]:
    before = os.umask(0o027)
    yield
    os.umask(before)


def result(out: Path, motion: str = "old") -> Path:
    out.mkdir()
    files = {"motion.npz": motion, "model.xml": MODEL, "terrain.bin": "asset", "video.mp4": "v"}
    for name, text in files.items():
        (out / name).write_text(text, "utf-8")
    return out


@pytest.mark.parametrize("own", ["notes.txt", ".hidden", "takes", "terrain.png", "video2.mp4"])
def test_a_user_s_own_file_in_a_result_is_never_lost(own: str, tmp_path: Path) -> None:
    out = result(tmp_path / "out")
    if own == "takes":
        (out / own).mkdir()
        (out / own / "mine").write_text("mine", "utf-8")
    else:
        (out / own).write_text("mine", "utf-8")
    with pytest.raises(OutputError, match=own.replace(".", r"\.")):
        check_output(out, force=True)
    with pytest.raises(OutputError, match="did not write"), result_folder(out, force=True):
        pass
    assert (out / own).exists()
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_what_comes_while_it_works_is_kept(tmp_path: Path) -> None:
    out = result(tmp_path / "out")
    with pytest.raises(OutputError, match=r"notes\.txt"), result_folder(out, True) as folder:
        (folder / "motion.npz").write_text("new", "utf-8")
        (out / "notes.txt").write_text("mine", "utf-8")
    assert (out / "notes.txt").read_text("utf-8") == "mine"
    assert (out / "motion.npz").read_text("utf-8") == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


@pytest.mark.parametrize("can_exchange", [True, False])
def test_the_old_result_gives_way_to_the_new(
    can_exchange: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not can_exchange:
        monkeypatch.setattr(whole, "exchange", lambda *_: False)
    out = result(tmp_path / "out")
    with result_folder(out, force=True) as folder:
        (folder / "motion.npz").write_text("new", "utf-8")
    assert [path.name for path in out.iterdir()] == ["motion.npz"]
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_names_are_exchanged_in_one_step(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "b").write_text("b", "utf-8")
    if not exchange(tmp_path / "a", tmp_path / "b"):
        pytest.skip("this system or disk exchanges no names")
    assert (tmp_path / "a").is_file() and (tmp_path / "b").is_dir()
    assert not exchange(tmp_path / "a", tmp_path / "none")


def test_what_a_killed_run_took_away_is_put_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The moment between two renames, where names cannot be exchanged."""
    monkeypatch.setattr(whole, "exchange", lambda *_: False)
    out, aside = result(tmp_path / "out"), tmp_path / ".out.mjmotion-0123abcd"
    aside.mkdir()
    assert put_in_place(aside, out) == tmp_path / ".out.mjmotion-0123abcd.old"
    out.rename(aside)  # as if the second rename had not been
    with pytest.warns(UserWarning, match="put back"):
        tidy(out)
    assert (out / "motion.npz").read_text("utf-8") == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_leftovers_are_tidied_and_told_but_not_those_of_the_living(tmp_path: Path) -> None:
    out = tmp_path / "out"
    dead, living = tmp_path / ".out.mjmotion-00000000", tmp_path / ".out.mjmotion-11111111"
    others = [tmp_path / ".out.mjmotion-mine", tmp_path / ".out2.mjmotion-22222222"]
    for folder in (dead, living, *others):
        folder.mkdir()
    (dead / "half").write_text("half", "utf-8")
    with locked(living):
        assert leftovers(out) == [dead]
        with pytest.warns(UserWarning, match="tidied.*00000000"), result_folder(out) as folder:
            (folder / "motion.npz").write_text("new", "utf-8")
        assert not dead.exists()
        assert all(path.is_dir() for path in (living, *others))


def test_the_umask_is_honoured(tmp_path: Path, umask: None) -> None:
    write_whole(tmp_path / "file", "text")
    with result_folder(tmp_path / "out") as folder:
        (folder / "motion.npz").write_text("new", "utf-8")
    rights = [stat.S_IMODE((tmp_path / name).stat().st_mode) for name in ("file", "out")]
    assert rights == [0o640, 0o750]


def test_a_file_stays_as_it_was_when_writing_fails(tmp_path: Path) -> None:
    write_whole(tmp_path / "file", "old")
    with pytest.raises(KeyboardInterrupt), whole.whole_file(tmp_path / "file") as aside:
        aside.write_text("half", "utf-8")
        raise KeyboardInterrupt
    assert (tmp_path / "file").read_text("utf-8") == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
