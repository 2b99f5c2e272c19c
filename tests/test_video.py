"""Videos are decoded and looked at; cameras, windows and errors are checked by their numbers."""

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from made_up import some

from mjmotion import exceptions
from mjmotion.body.kinematics import RayCaster
from mjmotion.body.motion import Motion
from mjmotion.footsteps.contacts import Contact
from mjmotion.output.video import (
    Canvas,
    VideoWriter,
    ensure_gl,
    render_frames,
    render_strip,
    render_video,
    video_frames,
)
from mjmotion.output.video.camera import FOVY, figure_extent, follow
from mjmotion.output.video.field import FieldWindow
from mjmotion.output.video.stage import picture_model, without_character

FIGURE = """
<mujoco>
  <worldbody>
    <body name="pelvis" pos="0 0 0.9">
      <freejoint name="root"/>
      <geom type="capsule" fromto="0 0 0.1 0 0 0.6" size="0.15" rgba="0.8 0.1 0.5 1"/>
      <geom type="sphere" pos="0 0 0.72" size="0.12" rgba="0.7 0.7 0.7 1"/>
      <body name="left_leg" pos="0 0.1 0">
        <joint name="left_hip" axis="0 -1 0"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.84" size="0.06" rgba="0.8 0.1 0.5 1"/>
        <site name="left_heel" pos="0 0 -0.9"/>
      </body>
      <body name="right_leg" pos="0 -0.1 0">
        <joint name="right_hip" axis="0 -1 0"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.84" size="0.06" rgba="0.8 0.1 0.5 1"/>
        <site name="right_toe" pos="0 0 -0.9"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


SideBySide = tuple[Path, list[tuple[str, int, int]], dict[str, Any], list[np.ndarray]]


def heights(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Hills [m] with the curvature of rough ground."""
    return 0.3 * np.sin(1.6 * x) * np.cos(1.4 * y)


def figure_on(add_scene: Callable[[mujoco.MjSpec], None]) -> mujoco.MjModel:
    spec = mujoco.MjSpec.from_string(FIGURE)
    add_scene(spec)
    return spec.compile()


def flat(spec: mujoco.MjSpec) -> None:
    spec.worldbody.add_geom(
        name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], rgba=[0.5, 0.6, 0.5, 1]
    )


def hills(spec: mujoco.MjSpec, rows: int = 241, columns: int = 361) -> None:
    x, y = np.linspace(-3, 15, columns), np.linspace(-6, 6, rows)
    z = heights(x[None], y[:, None])
    low, span = z.min(), np.ptp(z)
    spec.add_hfield(
        name="hills",
        nrow=rows,
        ncol=columns,
        size=[9, 6, span, 0.5],
        userdata=((z - low) / span).ravel(),
    )
    spec.worldbody.add_geom(
        name="hills",
        type=mujoco.mjtGeom.mjGEOM_HFIELD,
        hfieldname="hills",
        pos=[6, 0, low],
        rgba=[0.5, 0.6, 0.5, 1],
    )


def walk(
    model: mujoco.MjModel,
    nframe: int = 60,
    fps: float = 30.0,
    speed: float = 1.2,
    lift: float = 0.0,
) -> Motion:
    """The figure moves along +x and swings its legs."""
    time_ = np.arange(nframe) / fps
    qpos = np.tile(model.qpos0, (nframe, 1))
    qpos[:, 0] = speed * time_
    qpos[:, 2] += lift
    qpos[:, 7] = 0.5 * np.sin(6 * time_)
    qpos[:, 8] = -0.5 * np.sin(6 * time_)
    return Motion(model, qpos, fps)


@pytest.fixture(scope="module")
def gl() -> None:
    """Skip, with the reason, where there is no offscreen OpenGL."""
    model = mujoco.MjModel.from_xml_string(FIGURE)
    try:
        with Canvas(model, 64, 64):
            pass
    except exceptions.RenderError as error:
        pytest.skip(str(error))


def magenta(image: np.ndarray) -> np.ndarray:
    """Return (h, w) bool: pixels of the figure's own colour."""
    red, green, blue = (image[..., i].astype(int) for i in range(3))
    return (red > green + 40) & (blue > green + 15)


def orange(image: np.ndarray) -> np.ndarray:
    red, green, blue = (image[..., i].astype(int) for i in range(3))
    return (red > 150) & (red > green + 50) & (green > blue + 30)


def decode(path: Path) -> tuple[dict[str, Any], list[np.ndarray]]:
    import imageio.v3 as imageio

    return imageio.immeta(path, plugin="FFMPEG"), list(imageio.imiter(path, plugin="FFMPEG"))


# --- the video ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def side_by_side(gl: None, tmp_path_factory: pytest.TempPathFactory) -> SideBySide:
    folder = tmp_path_factory.mktemp("video")
    model = figure_on(hills)
    source = walk(model, nframe=96, fps=120.0)
    motion = source.replace(source.qpos + np.eye(model.nq)[2] * 0.3)
    calls: list[tuple[str, int, int]] = []
    path = render_video(
        folder / "walk.mp4",
        motion,
        source,
        contacts=[Contact("left_heel", 0, 96)],
        width=320,
        height=180,
        progress=lambda stage, done, of: calls.append((stage, done, of)),
    )
    return path, calls, *decode(path)


def test_video_has_the_size_rate_and_frames_asked_for(side_by_side: SideBySide) -> None:
    path, calls, meta, frames = side_by_side
    assert len(frames) == 24  # 96 frames at 120 a second are 24 at 30
    assert meta["fps"] == pytest.approx(30.0)
    assert meta["size"] == (320, 180)
    assert meta["codec"] == "h264"
    assert meta["pix_fmt"].startswith("yuv420p")
    assert calls == [("video", i, 24) for i in range(1, 25)]
    assert [p.name for p in path.parent.iterdir()] == ["walk.mp4"]


def test_players_can_start_before_the_file_is_read(side_by_side: SideBySide) -> None:
    content = side_by_side[0].read_bytes()
    assert 0 < content.index(b"moov") < content.index(b"mdat")


def test_video_shows_a_figure_in_both_panels_that_moves(side_by_side: SideBySide) -> None:
    frames = side_by_side[3]
    for image in frames:
        assert image.mean() > 60
        for panel in (image[:, :160], image[:, 160:]):
            assert 0.01 < magenta(panel).mean() < 0.4
    for left, right in ((0, 160), (160, 320)):
        first, later = magenta(frames[0][:, left:right]), magenta(frames[9][:, left:right])
        assert (first ^ later).sum() > 0.1 * first.sum()


def test_panels_differ(side_by_side: SideBySide) -> None:
    image = side_by_side[3][0].astype(int)
    assert np.abs(image[90:, :158] - image[90:, 162:]).mean() > 10


def test_frames_outside_the_motion_are_an_error(gl: None) -> None:
    with pytest.raises(exceptions.RenderError, match="0 to 59, not 60") as caught:
        render_frames(walk(figure_on(flat)), [3, 60])
    assert caught.value.frames == (60,)


# --- what is on a picture -------------------------------------------------------------------------


def test_captions_name_the_panels(gl: None) -> None:
    motion = walk(figure_on(flat), nframe=4)
    size: dict[str, Any] = {"width": 640, "height": 360, "source": motion, "layout": "side-by-side"}
    bare = render_frames(motion, [2], **size)[0]
    written = render_frames(motion, [2], **size, captions=("before", "after"))[0]
    changed = np.abs(bare.astype(int) - written).max(axis=2) > 20
    for x in (0, 320):
        corner = written[:40, x : x + 110]
        assert changed[:40, x : x + 110].mean() > 0.1
        assert corner.min() < 60 and corner.max() > 230  # dark ink on a pale plate
    assert changed[330:, :160].mean() > 0.05  # the time
    assert not changed[60:320].any()


def test_contacts_are_marked_while_they_last_and_after(gl: None) -> None:
    motion = walk(figure_on(flat), nframe=40, speed=0.5)
    contacts = [Contact("left_heel", 10, 20)]
    bare = render_frames(motion, [15], 640, 360)[0]
    before, during, after = render_frames(motion, [5, 15, 25], 640, 360, contacts=contacts)
    assert not orange(bare).any() and not orange(before).any()
    assert orange(during).sum() > orange(after).sum() > 0


def test_ghost_is_drawn_where_it_differs(gl: None) -> None:
    motion = walk(figure_on(flat), nframe=4)
    aside = motion.replace(motion.qpos + np.eye(motion.model.nq)[2] * 0.25)
    with_ghost = render_frames(motion, [2], 320, 180, source=aside, layout="ghost")[0].astype(int)
    without = render_frames(motion, [2], 320, 180)[0].astype(int)
    bluer = (with_ghost[..., 2] - with_ghost[..., 0]) - (without[..., 2] - without[..., 0]) > 25
    assert bluer.sum() > 100
    assert bluer[:, 100:220].sum() == bluer.sum()


def test_strip_shows_every_pose(gl: None) -> None:
    motion = walk(figure_on(flat), nframe=120, speed=1.5)
    image = render_strip(motion, 5, 800, 200)
    assert image.shape == (200, 800, 3)
    columns = magenta(image).any(axis=0).astype(int)
    assert (np.diff(np.r_[0, columns]) == 1).sum() == 5
    assert columns[:8].sum() == columns[-8:].sum() == 0


def test_the_motions_model_stays_as_it_was(gl: None) -> None:
    model = figure_on(hills)
    before = [np.array(a) for a in (model.geom_rgba, model.geom_pos, model.hfield_data)]
    render_frames(walk(model, nframe=3), [0, 2], 128, 96)
    after = (model.geom_rgba, model.geom_pos, model.hfield_data)
    assert all(np.array_equal(a, b) for a, b in zip(before, after, strict=True))
    assert (model.hfield_nrow[0], model.vis.global_.offwidth) == (241, 640)


# --- the camera -----------------------------------------------------------------------------------


def test_camera_keeps_the_figure_at_60_percent_of_the_height_without_jitter() -> None:
    motion = walk(figure_on(flat), nframe=150)
    noise = np.random.default_rng(0).normal(0, 0.01, motion.qpos[:, :3].shape)
    qpos = motion.qpos.copy()
    qpos[:, :3] += noise
    path = follow(motion.model, qpos, 30.0)
    low, high = figure_extent(motion.model, qpos)
    share = np.median(high - low) / (2 * path.distance * np.tan(np.radians(FOVY) / 2))
    assert share == pytest.approx(0.6, abs=0.02)
    shake = np.diff(path.position, n=3, axis=0)
    assert np.abs(shake).max() < 0.05 * np.abs(np.diff(qpos[:, :3], n=3, axis=0)).max()
    middle = path.lookat[:, :2] - motion.qpos[:, :2]
    assert np.linalg.norm(middle, axis=1).max() < 0.25


@pytest.mark.parametrize("side", [-1, 1])
def test_camera_stays_on_the_side_without_a_wall(side: int) -> None:
    def wall(spec: mujoco.MjSpec) -> None:
        flat(spec)
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX, pos=[3, side * 1.5, 2], size=[12, 0.1, 4]
        )

    model = figure_on(wall)
    motion = walk(model, nframe=120)
    path = follow(model, motion.qpos, 30.0)
    assert np.all(side * path.position[:, 1] < 0)
    ray = path.lookat - path.position
    hit, _, _ = RayCaster(without_character(model)).cast(path.position, ray)
    assert np.all((hit < 0) | (hit > 1))


def test_camera_stays_above_the_ground() -> None:
    def bank(spec: mujoco.MjSpec) -> None:
        flat(spec)
        for side in (-1, 1):
            spec.worldbody.add_geom(
                type=mujoco.mjtGeom.mjGEOM_BOX, pos=[3, side * 4.5, 1.2], size=[20, 3.0, 1.2]
            )

    motion = walk(figure_on(bank), nframe=90)
    position = follow(motion.model, motion.qpos, 30.0).position
    ground = np.where(np.abs(position[:, 1]) > 1.5, 2.4, 0.0)
    assert np.all(position[:, 2] > ground + 0.2)


def test_camera_of_a_single_frame() -> None:
    motion = walk(figure_on(flat), nframe=1)
    path = follow(motion.model, motion.qpos, 30.0)
    assert path.position.shape == (1, 3) and np.isfinite(path.position).all()


# --- heightfields ---------------------------------------------------------------------------------


@pytest.mark.parametrize("textured", [False, True])
@pytest.mark.parametrize("yaw", [0.0, 0.7])
def test_window_on_a_field_shows_the_true_ground(textured: bool, yaw: float) -> None:
    def scene(spec: mujoco.MjSpec) -> None:
        hills(spec)
        spec.geom("hills").quat = [np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)]
        if textured:
            checker = mujoco.mjtBuiltin.mjBUILTIN_CHECKER
            kind = mujoco.mjtTexture.mjTEXTURE_2D
            spec.add_texture(name="t", type=kind, builtin=checker, width=64, height=64)
            material = spec.add_material(name="m", texrepeat=[2, 2], texuniform=True)
            material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "t"
            spec.geom("hills").material = "m"

    model = without_character(figure_on(scene))
    shown = picture_model(model, 64, 64, fovy=30.0)
    window = FieldWindow(shown, side=6.3, nodes=64)
    down = np.array([0.0, 0.0, -1.0])
    shift = np.random.default_rng(1).uniform(-1.0, 1.0, (500, 3)) * (1, 1, 0)
    places = set()
    for point in ([2.0, 0.3, 0.0], [2.0, 0.3, 0.0], [6.0, -2.0, 0.0]):
        window.move(point)
        above = np.array(point) + shift + (0, 0, 5)
        truth, _, _ = RayCaster(model).cast(above, down)
        drawn, _, _ = RayCaster(shown).cast(above, down)
        assert truth.min() > 0 and np.abs(truth - drawn).max() < 0.010
        places.add(tuple(shown.geom_pos[0]))
        if textured:  # a checker that repeats every metre stays where it is
            middle = shown.geom_pos[0] - model.geom_pos[0]
            local = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]]) @ middle[:2]
            assert np.abs(local - np.round(local)).max() < 0.011
    assert len(places) == 2
    assert shown.hfield_nrow[0] * shown.hfield_ncol[0] < 0.05 * 241 * 361


def test_field_with_a_stretched_texture_is_shown_whole() -> None:
    def scene(spec: mujoco.MjSpec) -> None:
        hills(spec, 401, 601)
        kind, checker = mujoco.mjtTexture.mjTEXTURE_2D, mujoco.mjtBuiltin.mjBUILTIN_CHECKER
        spec.add_texture(name="t", type=kind, builtin=checker, width=64, height=64)
        spec.add_material(name="m").textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "t"
        spec.geom("hills").material = "m"

    shown = picture_model(figure_on(scene), 64, 64, fovy=30.0)
    window = FieldWindow(shown)
    assert window.move([0, 0, 0]) and not window.move([9, 3, 0])
    assert shown.hfield_size[0, :2] == pytest.approx([9, 6], abs=0.02)
    assert (shown.hfield_nrow[0], shown.hfield_ncol[0]) == (134, 201)


def test_small_field_is_left_alone() -> None:
    shown = picture_model(figure_on(lambda spec: hills(spec, 40, 60)), 64, 64, fovy=30.0)
    assert not FieldWindow(shown).move([1, 0, 0])
    assert (shown.hfield_nrow[0], shown.hfield_ncol[0]) == (40, 60)


# --- which frames, which settings -----------------------------------------------------------------


@pytest.mark.parametrize(
    ("fps", "limit", "rate", "count"),
    [
        (120, 30, 30, 15),
        (30, 30, 30, 60),
        (24, 30, 24, 60),
        (50, 30, 25, 30),
        (29.97, 30, 29.97, 60),
    ],
)
def test_fast_motions_are_thinned_evenly(fps: float, limit: float, rate: float, count: int) -> None:
    frames, got = video_frames(walk(figure_on(flat), nframe=60, fps=fps), limit)
    assert got == pytest.approx(rate)
    assert len(frames) == count and len(set(np.diff(frames))) == 1


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"layout": "mosaic"}, "unknown layout 'mosaic'"),
        ({"width": 321}, "must be even"),
        ({"fps": 0.0}, "positive"),
    ],
)
def test_settings_without_sense_are_one_line_and_leave_nothing(
    gl: None, tmp_path: Path, wrong: dict[str, Any], message: str
) -> None:
    with pytest.raises(exceptions.RenderError, match=message):
        render_video(tmp_path / "a.mp4", walk(figure_on(flat), nframe=4), **wrong)
    assert not list(tmp_path.iterdir())


def test_source_of_another_length_is_refused(gl: None, tmp_path: Path) -> None:
    model = figure_on(flat)
    with pytest.raises(exceptions.RenderError, match="5 frames and motion 4"):
        render_video(tmp_path / "a.mp4", walk(model, nframe=4), walk(model, nframe=5))


# --- the writer -----------------------------------------------------------------------------------


def frames_of_noise(count: int, height: int = 64, width: int = 96) -> np.ndarray:
    return np.random.default_rng(0).integers(0, 255, (count, height, width, 3), dtype=np.uint8)


def test_writer_replaces_a_file_only_when_it_is_complete(tmp_path: Path) -> None:
    path = tmp_path / "a.mp4"
    path.write_text("earlier")

    def broken() -> None:
        with VideoWriter(path, 96, 64, 30.0) as writer:
            writer.write(frames_of_noise(1)[0])
            raise KeyError("mid-way")

    with pytest.raises(KeyError):
        broken()
    assert path.read_text() == "earlier" and len(list(tmp_path.iterdir())) == 1
    with VideoWriter(path, 96, 64, 30.0) as writer:
        for image in frames_of_noise(7):
            writer.write(image)
    assert len(decode(path)[1]) == 7 and len(list(tmp_path.iterdir())) == 1


def test_colours_survive_encoding(tmp_path: Path) -> None:
    image = np.empty((64, 96, 3), np.uint8)
    image[:, :48], image[:, 48:] = (200, 60, 40), (30, 120, 210)
    with VideoWriter(tmp_path / "a.mp4", 96, 64, 30.0, crf=10) as writer:
        for _ in range(3):
            writer.write(image)
    got = decode(tmp_path / "a.mp4")[1][1]
    for x, colour in ((24, (200, 60, 40)), (72, (30, 120, 210))):
        assert np.abs(got[32, x].astype(int) - colour).max() <= 12


@pytest.mark.parametrize("path", ["nowhere/a.mp4", "a.avi"])
def test_writer_refuses_what_it_cannot_write(tmp_path: Path, path: str) -> None:
    with pytest.raises(exceptions.OutputError):
        VideoWriter(tmp_path / path, 96, 64, 30.0)
    assert not list(tmp_path.iterdir())


def test_a_failing_encoder_is_an_output_error_and_does_not_hang(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", some(shutil.which("false")))

    def write_much() -> None:
        with VideoWriter(tmp_path / "a.mp4", 96, 64, 30.0) as writer:
            for image in frames_of_noise(60):
                writer.write(image)

    with pytest.raises(exceptions.OutputError, match=r"a\.mp4"):
        write_much()
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs Linux's /proc")
def test_encoder_has_a_low_priority_and_the_caller_keeps_its_own(tmp_path: Path) -> None:
    def encoder() -> int | None:
        for folder in Path("/proc").glob("[0-9]*"):
            try:
                fields = (folder / "stat").read_text().rpartition(")")[2].split()
                name = (folder / "cmdline").read_bytes()
            except OSError:
                continue
            if int(fields[1]) == os.getpid() and str(tmp_path).encode() in name:
                return int(folder.name)
        return None

    own = os.getpriority(os.PRIO_PROCESS, 0)
    with VideoWriter(tmp_path / "a.mp4", 96, 64, 30.0) as writer:
        writer.write(frames_of_noise(1)[0])
        deadline = time.monotonic() + 10
        while (pid := encoder()) is None and time.monotonic() < deadline:
            time.sleep(0.01)
        assert pid is not None
        assert os.getpriority(os.PRIO_PROCESS, pid) >= max(10, own)
        assert os.getpriority(os.PRIO_PROCESS, 0) == own


# --- machines without OpenGL ----------------------------------------------------------------------

NO_LIBRARY = """
import ctypes, ctypes.util, sys
find, load = ctypes.util.find_library, ctypes.CDLL
def gone(name): return any(part in str(name) for part in ("EGL", "GL.so", "OSMesa", "OpenGL"))
ctypes.util.find_library = lambda name: None if name in ("EGL", "GL", "OSMesa") else find(name)
class CDLL(load):
    def __init__(self, name, *args, **kwargs):
        if gone(name):
            raise OSError(f"{name}: cannot open shared object file")
        super().__init__(name, *args, **kwargs)
ctypes.CDLL = CDLL
import mujoco, mjmotion
from mjmotion.output.video import ensure_gl, render_video
from mjmotion.body.motion import Motion
from mjmotion.exceptions import RenderError
model = mujoco.MjModel.from_xml_string(sys.argv[1])
try:
    render_video(sys.argv[2], Motion(model, model.qpos0[None], 30.0))
except RenderError as error:
    print(error)
"""


def run(code: str, *args: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code, *args],
        capture_output=True,
        text=True,
        timeout=60,
        env={k: v for k, v in os.environ.items() if k != "MUJOCO_GL"} | environment,
    )


def test_missing_library_names_the_packages(tmp_path: Path) -> None:
    done = run(NO_LIBRARY, FIGURE, str(tmp_path / "a.mp4"))
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "offscreen OpenGL is missing: apt-get install libegl1 libgl1"
    assert not list(tmp_path.iterdir())


def test_importing_binds_no_graphics_and_no_encoder() -> None:
    done = run(
        "import sys, mjmotion.output.video\n"
        "print([m for m in ('OpenGL', 'imageio', 'imageio_ffmpeg', 'PIL', 'matplotlib', 'scipy')"
        " if m in sys.modules])"
    )
    assert done.stdout.strip() == "[]", done.stderr


@pytest.mark.parametrize(
    ("value", "message"), [("off", "switches rendering off"), ("vulkan", "is no backend")]
)
def test_the_users_choice_of_backend_is_honoured(
    monkeypatch: pytest.MonkeyPatch, value: str, message: str
) -> None:
    monkeypatch.setenv("MUJOCO_GL", value)
    with pytest.raises(exceptions.RenderError, match=message):
        ensure_gl()
