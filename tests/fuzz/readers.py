"""Every reader with a small file that it reads, to be damaged, and a judge of what comes of it."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import itertools
import json
import os
import random
import signal
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import mutations
import numpy as np
import samples

from mjmotion.apps.session import load_session
from mjmotion.body.character import Character
from mjmotion.body.morph_body import MorphBody
from mjmotion.body.motion import Motion
from mjmotion.boundary.quiet import gathered
from mjmotion.cli.main import parse
from mjmotion.clips import load_clip, read_clip
from mjmotion.constraints import load_constraints
from mjmotion.exceptions import MotionError
from mjmotion.footsteps.contacts import load_contacts
from mjmotion.output.reading import _read_report
from mjmotion.scene import load_scene
from mjmotion.scene.heights import from_heights
from mjmotion.validation import read_thresholds

SECONDS = 5
BESIDE = ("a.asf", "a.amc", "c.bvh", "c.xml", "c.npz")  # what readers here put beside a file
FRAMES = 12
ROOT = Path(__file__).parents[2]

Make = Callable[[random.Random], bytes]


class TooLong(BaseException):
    """A reader took more than it may."""


@dataclasses.dataclass(frozen=True)
class Reader:
    """Something that reads.

    Attributes:
      name: of the file that is written for it.
      whole: the file as it should be.
      make: a damaged one.
      read: reads it.
    """

    name: str
    whole: bytes
    make: Make
    read: Callable[[Path], object]


def readers() -> dict[str, Reader]:
    """All of them, by name."""
    humanoid = Character.load("humanoid")
    walk = load_clip("walk", humanoid)
    clip = Motion(humanoid, walk.qpos[:FRAMES], walk.fps)
    model, nframe = humanoid.model, clip.nframe

    def text(name: str, content: str | bytes, read: Callable[[Path], object]) -> Reader:
        data = content if isinstance(content, bytes) else content.encode()
        return Reader(name, data, lambda chance: mutations.damaged(data, chance), read)

    def clip_of(path: Path) -> object:
        return load_clip(path, humanoid)

    arrays = _arrays(clip)
    poses, body = samples.amass(FRAMES), samples.body(clip)

    def archive(name: str, of: dict[str, Any], read: Callable[[Path], object]) -> Reader:
        return Reader(
            name, _archive(of), lambda chance: mutations.damaged_archive(of, chance), read
        )

    def session_of(path: Path) -> object:
        (path.parent / "c.npz").write_bytes(_archive(arrays))
        return load_session(path)

    def asset(name: str, element: str, geom: str = "") -> Callable[[Path], object]:
        scene = f"<mujoco><asset>{element}</asset><worldbody>{FLOOR}{geom}</worldbody></mujoco>"
        whole = scene.replace("FILE", name)
        times = itertools.count()

        def read(path: Path) -> object:
            # MuJoCo keeps what it read, by name and time: each case is of another second.
            second = next(times)
            os.utime(path, (second, second))
            return _beside(path, "c.xml", whole, load_scene)

        return read

    return {
        "npz": archive("a.npz", arrays, clip_of),
        "amass": archive("a.npz", poses, read_clip),
        "body": archive("body.npz", body, lambda path: MorphBody.load(path, model)),
        "glb": text("a.glb", samples.gltf(samples.BONES, FRAMES, binary=True), read_clip),
        "gltf": text("a.gltf", samples.gltf(samples.BONES, FRAMES, binary=False), read_clip),
        "session": text("s.mjsession", samples.session(clip, "c.npz"), session_of),
        "bvh": text("a.bvh", BVH, clip_of),
        "asf": text("a.asf", ASF, lambda path: _beside(path, "a.amc", AMC, clip_of)),
        "amc": text("a.amc", AMC, lambda path: _beside(path, "a.asf", ASF, clip_of, swap=True)),
        "csv": text("a.csv", _csv(clip), clip_of),
        "contacts": text("a.json", CONTACTS, lambda path: load_contacts(path, model, nframe)),
        "constraints.yaml": text(
            "a.yaml", WISHES, lambda path: load_constraints(path, model, nframe)
        ),
        "constraints.json": text(
            "a.json", WISHES_JSON, lambda path: load_constraints(path, model, nframe)
        ),
        "mapping": text("m.yaml", MAPPING, lambda path: _mapped(path, humanoid)),
        "thresholds": text(
            "t.yaml", "stance_drift_mm: 2\nroot_travel_ratio: [0.9, 1.1]\n", read_thresholds
        ),
        "report": text("report.json", REPORT, _read_report),
        "scene": text("s.xml", SCENE, load_scene),
        "model": text("m.xml", MODEL, lambda path: Character.load(path).height),
        "heightfield": text("h.bin", _hfield(), _scene_of),
        "heights.npy": text("h.npy", _npy(), from_heights),
        "heights.png": text("h.png", _png(), from_heights),
        "mesh": text("h.obj", OBJ, from_heights),
        **{
            f"mesh.{kind}": text(f"h.{kind}", samples.mesh(kind), from_heights)
            for kind in ("stl", "ply", "off", "glb")
        },
        "keyframe": text("s.xml", MOVING, lambda path: load_scene(path).at_rest("k")),
        "texture": text("t.png", _png(), asset("t.png", '<texture type="2d" file="FILE"/>')),
        "asset.obj": text("m.obj", SOLID, asset("m.obj", MESH, MESHED)),
        "asset.stl": text("m.stl", _stl(), asset("m.stl", MESH, MESHED)),
        "options": Reader("words", b"info\0walk", _words, _parsed),
    }


def judged(reader: Reader, data: bytes, folder: Path) -> str:
    """Return what comes of a file: ``read``, ``refused``, or what is wrong with how it is."""
    path = folder / reader.name
    path.write_bytes(data)
    try:
        with _timed(), warnings.catch_warnings(), gathered():
            warnings.simplefilter("ignore")
            reader.read(path)
    except MotionError as error:
        said = str(error)
        return "refused" if said and len(said) < 2000 else f"traceback: of {len(said)} letters"
    except TooLong:
        return "over 5 s"
    except MemoryError:
        return "over 1 GB"
    except Exception as error:
        return f"traceback: {type(error).__name__}: {str(error)[:200]}"
    finally:
        for left in folder.iterdir():
            if left.name != reader.name and left.name not in BESIDE:
                left.unlink()
                raise AssertionError(f"left: {left.name}")
            left.unlink()
    return "read"


@contextlib.contextmanager
def _timed() -> Iterator[None]:
    def stop(*_: object) -> None:
        raise TooLong

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, SECONDS)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def _beside(
    path: Path, name: str, content: str, read: Callable[[Path], object], *, swap: bool = False
) -> object:
    """Read a file that needs another; the one that is damaged is the other where not ``swap``."""
    (path.parent / name).write_text(content, "utf-8")
    return read(path if swap else path.parent / name)


def _mapped(path: Path, humanoid: Character) -> object:
    (path.parent / "c.bvh").write_text(BVH, "utf-8")
    return load_clip(path.parent / "c.bvh", humanoid, mapping=path)


def _scene_of(path: Path) -> object:
    (path.parent / "c.xml").write_text(HFIELD, "utf-8")
    return load_scene(path.parent / "c.xml")


def _parsed(path: Path) -> object:
    words = [word.decode("utf-8", "surrogateescape") for word in path.read_bytes().split(b"\0")]
    with (
        contextlib.redirect_stderr(io.StringIO()) as said,
        contextlib.redirect_stdout(io.StringIO()),
    ):
        try:
            return parse(words)
        except SystemExit as end:
            if end.code and len(said.getvalue().splitlines()) != 1:
                raise AssertionError("not one line") from None
            raise MotionError(said.getvalue() or "help") from None


def _words(chance: random.Random) -> bytes:
    line = chance.choice(
        (
            b"adapt walk --scene flat --out o --fps 30 --levels 8,4 --tolerance 0.1",
            b"scene stairs --steps 4 --rise 0.1 --out o.xml",
            b"scene terrain --x-range=-2,10 --cell 0.1 --seed 3 --out o.xml",
            b"scene doors --door x=2.5,width=0.6 --out o.xml",
            b"render o --size 640x480 --layout ghost",
            b"edit-frame walk --frame 3 --out o",
            b"morph walk --key 10:legs=1.2 --out o",
            b"transition --overlap 10,20,30 --out o",
            b"rope --beam 4 --length 3 --edge 0.05 --out o",
            b"retarget walk --to humanoid --stride scale --scene flat --keyframe k --out o",
            b"replay s.mjsession --clip walk --out o --threshold stance_drift_mm=2",
            b"edit walk --scene flat --port 8123 --no-open",
            b"character --legs 1.2 --arms 0.9 --from humanoid --out o.xml",
            b"adapt a.bvh --scene flat --in-place 1.2 --loop 3 --heading keep --out o",
            b"join walk sneak --length 20 --levels 8,4 --ik numeric --out o",
            b"info a.bvh --fps 30 --write-mapping m.yaml",
            b"scene heights h.png --cell 0.1 --height 2 --scale 1 --start 1,2 --up y --out o.xml",
            b"edit-frame walk --frame 3 --site pelvis --by 0 0 0.1 --hold frame --out o",
        )
    )
    words = line.split()
    for _ in range(chance.choice((1, 2))):
        at = chance.randrange(len(words))
        words[at] = mutations.damaged(words[at], chance)
    return b"\0".join(word.replace(b"\0", b"") for word in words)


def _stl() -> bytes:
    import trimesh

    return bytes(trimesh.creation.box().export(file_type="stl"))


def _arrays(clip: Motion) -> dict[str, Any]:
    names = np.array(clip.joint_names)
    return {"qpos": clip.qpos, "fps": np.array(clip.fps), "joint_names": names}


def _archive(arrays: dict[str, Any]) -> bytes:
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def _csv(clip: Motion) -> str:
    from mjmotion.clips.table import column_names

    rows = [",".join(["time", *column_names(clip.model)])]
    for number, qpos in enumerate(clip.qpos):
        rows.append(",".join(f"{value:.6g}" for value in (number / clip.fps, *qpos)))
    return "\n".join(rows) + "\n"


def _hfield() -> bytes:
    return np.array([6, 6], "<i4").tobytes() + np.linspace(0, 1, 36, dtype="<f4").tobytes()


def _npy() -> bytes:
    file = io.BytesIO()
    np.save(file, np.linspace(0, 0.3, 2500).reshape(50, 50))
    return file.getvalue()


def _png() -> bytes:
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(np.arange(2500, dtype=np.uint8).reshape(50, 50)).save(file, "PNG")
    return file.getvalue()


BVH = samples.bvh(FRAMES)
ASF, AMC = samples.asf(FRAMES)
CONTACTS = """[
 {"site": "left_toe", "start": 0, "end": 4},
 {"site": "right_heel", "start": 2, "end": 9}
]
"""
WISHES = """\
- site: left_hand
  frames: [3, 8]
  position: [1.2, 0.4, 1.1]
  quat: [1, 0, 0, 0]
  weight: 0.5
  free: [x, yaw]
- {site: left_hand, frames: 2, to: pelvis, position: [0.0, 0.2, 0.05]}
- &a {site: face, frames: [3, 5], look_at: [2.0, 0.0, 1.0], axis: [1, 0, 0]}
"""
WISHES_JSON = json.dumps(
    [
        {"site": "left_hand", "frames": [3, 8], "position": [1.2, 0.4, 1.1], "weight": 0.5},
        {"site": "face", "frames": 4, "look_at": [[2, 0, 1]]},
    ]
)
MAPPING = (
    "joints:\n  left_knee: LeftLeg\n  pelvis: Hips\nup: y\nscale: 0.01\nignore: [left_wrist]\n"
)
REPORT = json.dumps(
    {
        "title": "t",
        "fit_seconds": 0.1,
        "levels": [{"level": 1, "frames_per_knot": 8.0, "seconds": 0.1, "max_error_percent": 0.2}],
        "unmet": [
            {"constraint": "c", "frames": [1, 2], "residual_mm": 3.0, "index": 0, "source": "user"}
        ],
    }
)
SCENE = """<mujoco><option timestep="0.01"/><size memory="1M"/><asset>
<hfield name="h" nrow="2" ncol="2" size="5 5 1 .1" elevation="0 0 0 1"/>
<texture name="t" type="2d" builtin="checker" width="16" height="16"/>
<material name="m" texture="t"/>
</asset><worldbody><geom name="floor" type="plane" size="0 0 1" material="m"/>
<replicate count="3" offset="0 .4 0"><geom type="box" size=".1 .1 .1" pos="2 0 .1"/></replicate>
<body pos="3 0 1"><joint type="hinge" axis="0 1 0" range="-10 10"/><geom size=".1"/></body>
<site name="start" pos="0 0 0" euler="0 0 10"/><geom type="hfield" hfield="h" pos="0 9 0"/>
</worldbody></mujoco>"""
MODEL = """<mujoco model="m"><compiler angle="degree"/><worldbody><body name="pelvis" pos="0 0 1">
<freejoint name="root"/><geom type="capsule" fromto="0 -.1 0 0 .1 0" size=".08"/>
<body name="left_thigh" pos="0 .1 0"><joint name="left_hip" type="ball" range="0 90"/>
<geom type="capsule" fromto="0 0 0 0 0 -.4" size=".05"/>
<body name="left_shank" pos="0 0 -.4">
<joint name="left_knee" axis="0 1 0" range="0 150"/>
<geom type="capsule" fromto="0 0 0 0 0 -.4" size=".04"/>
<site name="left_heel" pos="-.05 0 -.45"/></body></body></body></worldbody></mujoco>"""
HFIELD = """<mujoco><asset><hfield name="h" file="h.bin" size="5 5 1 .1"/></asset><worldbody>
<geom type="hfield" hfield="h"/></worldbody></mujoco>"""
MESH, MESHED = '<mesh name="m" file="FILE"/>', '<geom type="mesh" mesh="m"/>'
FLOOR = '<geom type="plane" size="0 0 1"/>'
MOVING = f"""<mujoco><worldbody>{FLOOR}<body name="b" pos="2 0 1"><freejoint name="f"/>
<geom size=".1"/><body><joint name="h" range="-1 1" limited="true"/><geom size=".2"/></body></body>
</worldbody><actuator><motor joint="h"/></actuator>
<keyframe><key name="k" qpos="3 0 1 1 0 0 0 .5"/></keyframe></mujoco>"""
SOLID = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
OBJ = "".join(
    f"v {x} {y} {0.1 * (x + y) % 0.3:.3f}\n" for y in range(4) for x in range(4)
) + "".join(
    f"f {n} {n + 1} {n + 5}\nf {n} {n + 5} {n + 4}\n" for n in (1, 2, 3, 5, 6, 7, 9, 10, 11)
)
