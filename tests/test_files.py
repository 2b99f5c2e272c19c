"""What is no plain file, or far too large a one, is refused in words: nothing hangs or floods."""

from __future__ import annotations

import io
import os
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import command_line
import numpy as np
import pytest

from mjmotion.boundary import files
from mjmotion.boundary.arrays import names_in_archive, read_archive
from mjmotion.boundary.files import check_plain, file_bytes
from mjmotion.boundary.limits import MOST_LINE, MOST_LINES
from mjmotion.clips import read_bvh
from mjmotion.exceptions import ClipError, MotionError, SceneError
from mjmotion.scene import load_scene

KINDS: dict[str, tuple[Callable[[Path], object], str]] = {
    "missing": (lambda path: None, "does not exist: check the path"),
    "folder": (lambda path: path.mkdir(), "is a folder"),
    "pipe": (lambda path: os.mkfifo(path), "is a pipe or a device"),
    "endless": (lambda path: path.symlink_to("/dev/zero"), "is a pipe or a device"),
    "circle": (lambda path: path.symlink_to(path.name), "cannot be read"),
}
# The command, with X for the file; the name of the file.
READ = {
    **{
        f"motion{end}": f"adapt X{end} --scene flat --out O --no-video"
        for end in (".bvh", ".amc", ".npz", ".csv", ".glb")
    },
    "asf.asf": "adapt A.amc --asf X.asf --scene flat --out O --no-video",
    "contacts.json": "adapt walk --contacts X.json --scene flat --out O --no-video",
    "constraints.yaml": "adapt walk --constraints X.yaml --scene flat --out O --no-video",
    "scene.xml": "adapt walk --scene ./X.xml --out O --no-video",
    "model.xml": "retarget walk --to ./X.xml --out O --no-video",
    "session.mjsession": "replay X.mjsession --out O --no-video",
    "heights.npy": "scene heights X.npy --out O.xml",
    "heights.png": "scene heights X.png --out O.xml",
    "heights.obj": "scene heights X.obj --out O.xml",
}


@pytest.mark.parametrize("name", READ)
@pytest.mark.parametrize("kind", KINDS)
def test_what_is_no_plain_file(
    kind: str, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    make, said = KINDS[kind]
    make(tmp_path / f"X{Path(name).suffix}")
    before = sorted(tmp_path.iterdir())
    done = command_line.run(*READ[name].split())
    assert done.returncode == 2 and done.stderr.count("\n") == 1, done.stderr
    # Some say "does not exist" of all that cannot be followed, which is as good.
    assert said in done.stderr or (kind == "circle" and "does not exist" in done.stderr)
    assert sorted(tmp_path.iterdir()) == before


def test_a_size_is_bounded_even_where_it_is_not_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"12345678")
    assert file_bytes(path, "file", 8) == b"12345678"
    with pytest.raises(MotionError, match="8 bytes or more: at most 7"):
        file_bytes(path, "file", 7)
    monkeypatch.setattr(files, "check_plain", lambda *_: 0)  # as of a file in /proc
    with pytest.raises(MotionError, match="at most 7"):
        file_bytes(path, "file", 7)


def test_a_file_that_may_not_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"1")

    def refuses(*_: object, **__: object) -> object:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", refuses)
    with pytest.raises(MotionError, match="a' cannot be read: Permission denied"):
        file_bytes(path, "file", 8)
    monkeypatch.undo()
    with pytest.raises(ClipError, match="is a folder"):
        check_plain(tmp_path, "file", ClipError)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("HIERARCHY\n" + "{" * (MOST_LINE + 1), "line 2 has 1,048,577 letters"),
        ("HIERARCHY\n" + "\n" * (MOST_LINES + 1), "lines of"),
        ("HIERARCHY\n" + "{  \n" * 2_200_000, "letters of the skeleton"),
        ("HIERARCHY\nROOT a {\nJOINT b { }\nJOINT b { } }", "line 4: a second joint 'b'"),
    ],
)
def test_text_that_is_too_large_for_what_it_says(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "a.bvh"
    path.write_text(text, "utf-8")
    with pytest.raises(ClipError, match=said):
        read_bvh(path)


def test_a_joint_of_a_very_long_name(tmp_path: Path) -> None:
    path = tmp_path / "a.bvh"
    head = f"HIERARCHY\nROOT {'a' * 300} {{ CHANNELS 1 Xrotation }}\nMOTION\n"
    path.write_text(f"{head}Frames: 1\nFrame Time: 0.1\n0\n", "utf-8")
    with pytest.raises(ClipError, match=r"letters of a joint's name in .*: 300, and at most 256"):
        read_bvh(path)
    path.write_text(path.read_text("utf-8").replace("Time: 0.1", "Time: 1e-320"), "utf-8")
    with pytest.raises(ClipError, match="a rate of inf frames a second"):
        read_bvh(path)


def test_an_archive_of_very_many_members(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    with zipfile.ZipFile(path, "w") as archive:
        for number in range(30_000):
            archive.writestr(f"{number}.npy", b"")
    with pytest.raises(ValueError, match="far more files"):
        read_archive(path, ("qpos",))
    assert names_in_archive(path) == set()
    np.savez(path, qpos=np.zeros(3))
    assert names_in_archive(path) == {"qpos"}
    assert read_archive(path, ("qpos",))["qpos"].tolist() == [0.0, 0.0, 0.0]


def test_an_array_is_read_as_numpy_reads_it(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    large = np.arange(3e6).reshape(1000, 3000)
    np.savez_compressed(path, a=large, b=large.T, c=np.array(["x", "yz"]), d=np.zeros((0, 3)))
    found = read_archive(path, ("a", "b", "c", "d"))
    with np.load(path) as known:
        for name, array in found.items():
            np.testing.assert_array_equal(array, known[name])


FLOOR = '<geom type="plane" size="0 0 1"/>'
TEXTURE = '<texture name="t{}" type="2d" builtin="flat" width="7900" height="7900"/>'
FIELD = '<hfield name="h{}" nrow="1500" ncol="1500" size="1 1 1 1"/>'
SCENES = {
    "wide texture": ('<texture type="2d" builtin="flat" width="20000" height="10"/>', "16,384"),
    "cube": ('<texture type="cube" builtin="flat" width="8000" height="8000"/>', "64,000,000"),
    "many textures": ("".join(TEXTURE.format(n) for n in range(9)), "points of every texture"),
    "many heightfields": ("".join(FIELD.format(n) for n in range(9)), "points of every hfield"),
    "vertex": ('<mesh name="m" vertex="0 0 0 1 0 0 0 1 0 0 0 nan"/>', "vertex of mesh"),
    "far vertex": ('<mesh name="m" vertex="0 0 0 1 0 0 0 1 0 0 0 1e30"/>', "vertex of mesh"),
}


@pytest.mark.parametrize("name", SCENES)
def test_scenes_that_ask_for_too_much(name: str, tmp_path: Path) -> None:
    assets, said = SCENES[name]
    path = tmp_path / "s.xml"
    path.write_text(f"<mujoco><asset>{assets}</asset><worldbody>{FLOOR}</worldbody></mujoco>")
    with pytest.raises(SceneError, match=f"line 1.*{said}"):
        load_scene(path)


def test_a_scene_whose_start_or_text_is_at_fault(tmp_path: Path) -> None:
    path = tmp_path / "s.xml"
    body = f'<mujoco><worldbody>{FLOOR}<site name="start" pos="9999 0 0"/></worldbody></mujoco>'
    path.write_text(body)
    with pytest.raises(SceneError, match=r"site 'start' of scene .*s.xml"):
        load_scene(path)
    path.write_bytes(body.replace("start", "caf\xe9").encode("latin-1"))
    with pytest.raises(SceneError, match="line 1: it is not text in UTF-8"):
        load_scene(path)
    (tmp_path / "part.xml").write_text("<mujoco><geom\n<")
    path.write_text('<mujoco><include file="part.xml"/></mujoco>')
    with pytest.raises(SceneError, match=r"part.xml' line 2: it is not well-formed"):
        load_scene(path)


def test_a_chunk_of_glb_that_lies(tmp_path: Path) -> None:
    path = tmp_path / "a.glb"
    for data, said in (
        (b"glTF" + struct.pack("<II", 2, 99), "cut off: 12 of 99 bytes"),
        (b"glTF" + struct.pack("<IIII", 2, 20, 9999, 0x4E4F534A), "a chunk is longer"),
        (b"hello", "begins neither"),
        (b"{}", "no animation"),
        (b'{"nodes": {"a": 1}}', "nodes are a mapping"),
        (b'{"nodes": [], "nodes": []}', "twice"),
    ):
        path.write_bytes(data)
        done = command_line.run("info", path)
        assert done.returncode == 2 and said in done.stderr, done.stderr


def test_npz_with_bones_that_lie(tmp_path: Path) -> None:
    file = io.BytesIO()
    np.savez(
        file,
        qpos=np.zeros((2, 57)),
        fps=30.0,
        joint_names=np.array(["root"]),
        body_names=np.array(["a", "b"]),
        body_pos=np.zeros((1, 3)),
    )
    (tmp_path / "a.npz").write_bytes(file.getvalue())
    done = command_line.run("info", tmp_path / "a.npz")
    assert "2 body_names and 1 rows of body_pos" in done.stderr
