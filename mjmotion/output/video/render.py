"""Videos and pictures of motions.

render_video("walk.mp4", adapted, source, contacts=contacts)
pictures = render_frames(adapted, [0, 30, 60])
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.motion import Motion
from mjmotion.exceptions import RenderError
from mjmotion.footsteps.contacts import Contact
from mjmotion.numerics.progress import Progress, no_progress
from mjmotion.output.video import stage as staging
from mjmotion.output.video.camera import FOVY, CameraPath, figure_extent, follow
from mjmotion.output.video.captions import write_label
from mjmotion.output.video.field import FieldWindow
from mjmotion.output.video.gl import Canvas, Image, ensure_gl
from mjmotion.output.video.markers import HEEL, TOE, ContactMarks
from mjmotion.output.video.stage import Stage
from mjmotion.output.video.writer import VideoWriter

if TYPE_CHECKING:
    from mjmotion.body.morph_body import MorphBody

LAYOUTS = ("side-by-side", "ghost", "single")

_MAX_FPS = 30.0
_GHOST = (0.20, 0.42, 0.85, 0.38)
_GHOST_BEHIND = 0.02  # [m]: where both poses agree, the ghost hides in place of flickering
_WINDOW_BEYOND = 2.0  # the figure, seen from the camera [m]: the ground before it is not in view
_MIN_SIZE = 64


# More than eight parameters here and in render_frames: after the motion all are settings of the
# picture with defaults, given by name, and a class for them would be one more name to learn.
def render_video(
    path: str | Path,
    motion: Motion,
    source: Motion | None = None,
    *,
    contacts: Sequence[Contact] = (),
    body: MorphBody | None = None,
    layout: str = "side-by-side",
    width: int = 1280,
    height: int = 720,
    fps: float | None = None,
    crf: int = 22,
    preview: bool = False,
    captions: tuple[str, str] | None = None,
    progress: Progress = no_progress,
) -> Path:
    """Render a motion to an H.264 video.

    Args:
      path: the ``.mp4`` file; it appears only when it is complete.
      motion: the motion, on a model with its scene.
      source: the motion before adaptation, same model and frames.
      contacts: contacts to mark, of both motions.
      body: the character's size in every frame of ``motion``, where that changes; the source keeps
        the model's.
      layout: ``"side-by-side"`` (left the source on a flat floor, right the motion in its scene),
        ``"ghost"`` (source as a ghost in the motion's scene), or ``"single"``; without a source,
        always single.
      width: of the video, even [pixel].
      height: of the video, even [pixel].
      fps: frames a second at most; default 30. Faster motions are thinned evenly.
      crf: H.264 constant rate factor; lower is better and larger.
      preview: quicker and rougher: no shadows, no smoothing, 15 frames a second.
      captions: what source and motion are called on the picture; "source", and "adapted" or, of a
        body that changes, "morphing" without.
      progress: called with ("video", frames done, frames in all) after each frame.

    Returns:
      the file.

    Raises:
      RenderError: no offscreen OpenGL, or settings that make no sense.
      OutputError: the file cannot be written.
      ModelError: source and motion have different joints, or a contact's site does not exist.
    """
    ensure_gl()
    if captions is None:
        captions = ("source", "adapted" if body is None else "morphing")
    frames, rate = video_frames(motion, fps if fps is not None else _MAX_FPS / (1 + preview))
    settings = _Settings(layout, width, height, not preview, 0 if preview else 4, captions)
    renderer = _Renderer(motion, source, contacts, body, settings)
    with (
        Canvas(renderer.model, width, height) as canvas,
        VideoWriter(path, width, height, rate, crf) as writer,
    ):
        for done, frame in enumerate(frames, start=1):
            writer.write(renderer.picture(canvas, int(frame)))
            progress("video", done, len(frames))
    return Path(path)


# As many parameters as render_video, for the same reason.
def render_frames(
    motion: Motion,
    frames: Sequence[int],
    width: int = 640,
    height: int = 360,
    *,
    source: Motion | None = None,
    contacts: Sequence[Contact] = (),
    body: MorphBody | None = None,
    layout: str = "single",
    shadows: bool = True,
    captions: tuple[str, str] | None = None,
) -> list[Image]:
    """Return pictures (height, width, 3) of single frames; arguments as :func:`render_video`.

    Raises:
      RenderError: no offscreen OpenGL, or a frame that the motion does not have.
    """
    outside = [int(f) for f in frames if not 0 <= f < motion.nframe]
    if outside:
        raise RenderError(
            f"the motion has frames 0 to {motion.nframe - 1}, not {outside[0]}", outside
        )
    settings = _Settings(layout, width, height, shadows, 4, captions)
    renderer = _Renderer(motion, source, contacts, body, settings)
    with Canvas(renderer.model, width, height) as canvas:
        return [renderer.picture(canvas, int(frame)) for frame in frames]


def video_frames(motion: Motion, fps: float) -> tuple[NDArray[np.int64], float]:
    """Return the frames that a video at no more than ``fps`` shows, and its frames a second.

    Every k-th frame, so that motion is as even in the video as in the clip.
    """
    if not (np.isfinite(fps) and fps > 0):
        raise RenderError(f"fps is {fps}: it must be a positive number")
    step = max(int(np.ceil(motion.fps / fps - 1e-6)), 1)
    return np.arange(0, motion.nframe, step), motion.fps / step


@dataclasses.dataclass(frozen=True)
class _Settings:
    """How pictures look.

    Attributes:
      layout: one of :data:`LAYOUTS`.
      width, height: [pixel].
      shadows: whether the key light casts them.
      samples: of a pixel, against jagged edges; 0 for none.
      captions: what source and motion are called; None for pictures without any text.
    """

    layout: str
    width: int
    height: int
    shadows: bool
    samples: int
    captions: tuple[str, str] | None


@dataclasses.dataclass(frozen=True, eq=False)
class _Ghost:
    """Another motion of the same character, to be drawn in one colour."""

    model: mujoco.MjModel
    data: mujoco.MjData
    motion: Motion


@dataclasses.dataclass(frozen=True, eq=False)
class _Panel:
    """A rectangle of the picture that shows one motion, maybe with a ghost in it."""

    rect: mujoco.MjrRect
    stage: Stage
    motion: Motion
    camera: CameraPath
    marks: ContactMarks
    window: FieldWindow | None
    caption: str | None
    ghost: _Ghost | None = None
    body: MorphBody | None = None
    own_meshes: bool = False  # the panels' meshes differ, and the driver holds one set

    def draw(self, canvas: Canvas, frame: int) -> None:
        if self.body is not None:
            self.body.write(self.stage.model, frame)
        if self.own_meshes:
            canvas.upload_meshes(self.stage.model)
        if self.window is not None:
            ahead = self.camera.lookat[frame] - self.camera.position[frame]
            ahead *= _WINDOW_BEYOND / np.linalg.norm(ahead)
            self.window.move(self.camera.lookat[frame] + ahead, canvas)
        camera = self.camera.at(frame)
        self.stage.begin(self.motion.qpos[frame], camera, self.rect.width / self.rect.height)
        if self.ghost is not None:
            away = self.camera.lookat[frame] - self.camera.position[frame]
            qpos = self.ghost.motion.qpos[frame].copy()
            qpos[:3] += _GHOST_BEHIND * away / np.linalg.norm(away)
            self.stage.add_figure(self.ghost.model, qpos, self.ghost.data)
        self.marks.draw(self.stage, frame)
        canvas.draw(self.rect, self.stage.scene)


class _Renderer:
    """Everything that the pictures of one motion need, made once."""

    def __init__(
        self,
        motion: Motion,
        source: Motion | None,
        contacts: Sequence[Contact],
        body: MorphBody | None,
        settings: _Settings,
    ) -> None:
        layout, width, height = settings.layout, settings.width, settings.height
        if layout not in LAYOUTS:
            raise RenderError(f"unknown layout '{layout}': use one of {', '.join(LAYOUTS)}")
        check_size(width, height)
        if source is not None:
            source = _source_on(motion, source)
        if body is not None:
            body = _body_on(motion, body, layout if source is not None else "single")
        self._fps, self._contacts, self._body = motion.fps, contacts, body
        self._shadows, self._captioned = settings.shadows, settings.captions is not None
        self.model = staging.picture_model(
            motion.model,
            width,
            height,
            fovy=FOVY,
            shadows=settings.shadows,
            samples=settings.samples,
        )
        names = settings.captions if settings.captions is not None else (None, None)
        camera = follow(motion.model, motion.qpos, motion.fps, body=body)
        self._panels: list[_Panel] = []
        left, ghost = 0, None
        self._legend: list[tuple[str, tuple[float, float, float]]] = []
        if source is not None and layout == "side-by-side":
            left = width // 2
            rect = mujoco.MjrRect(0, 0, left, height)
            self._panels.append(self._source_panel(rect, source, camera, names[0]))
        elif source is not None and layout == "ghost":
            tinted = staging.ghost(self.model, _GHOST)
            ghost = _Ghost(tinted, mujoco.MjData(tinted), source)
            if names[0] is not None:
                self._legend.append((names[0], _GHOST[:3]))
        rect = mujoco.MjrRect(left, 0, width - left, height)
        self._panels.append(self._motion_panel(rect, motion, camera, names[1], ghost))

    def _source_panel(
        self, rect: mujoco.MjrRect, source: Motion, camera: CameraPath, caption: str | None
    ) -> _Panel:
        """Return a panel with the source on a flat floor, seen as ``camera`` sees the motion."""
        marks = ContactMarks.of(source, self._contacts, flat=True)
        stage = Stage(
            staging.without_scene(self.model),
            extra=len(self._contacts),
            bearing=float(np.median(camera.bearing)),
            floor=_floor_height(source, marks),
            shadows=self._shadows,
        )
        return _Panel(
            rect,
            stage,
            source,
            _source_camera(source, camera),
            marks,
            window=None,
            caption=caption,
            own_meshes=self._body is not None,
        )

    def _motion_panel(
        self,
        rect: mujoco.MjrRect,
        motion: Motion,
        camera: CameraPath,
        caption: str | None,
        ghost: _Ghost | None,
    ) -> _Panel:
        """Return a panel with the motion in its scene."""
        stage = Stage(
            self.model,
            extra=len(self._contacts),
            bearing=float(np.median(camera.bearing)),
            shadows=self._shadows,
        )
        return _Panel(
            rect,
            stage,
            motion,
            camera,
            ContactMarks.of(motion, self._contacts, body=self._body),
            FieldWindow(self.model),
            caption,
            ghost,
            self._body,
            own_meshes=self._body is not None,
        )

    def picture(self, canvas: Canvas, frame: int) -> Image:
        """Return the picture of one frame."""
        for panel in self._panels:
            panel.draw(canvas, frame)
        image = canvas.read()
        for panel in self._panels[1:]:
            image[:, panel.rect.left - 1 : panel.rect.left + 1] = 255
        if self._captioned:
            self._write(image, frame)
        return image

    def _write(self, image: Image, frame: int) -> None:
        height, width = image.shape[:2]
        size = max(height // 26, 10)
        small = max(height // 38, 9)
        gap = size // 2
        for panel in self._panels:
            if panel.caption is not None:
                write_label(image, panel.caption, panel.rect.left + gap, gap, size)
        y = 2 * gap + size + size // 2
        for text, colour in self._legend:
            write_label(image, text, gap, y, small, dot=colour)
        write_label(image, f"{frame / self._fps:5.2f} s    frame {frame}", gap, -gap, small)
        if len(self._contacts):
            x = width - gap
            x -= write_label(image, "toe", x, -gap, small, anchor="right", dot=TOE) + gap // 2
            write_label(image, "heel", x, -gap, small, anchor="right", dot=HEEL)


def _source_on(motion: Motion, source: Motion) -> Motion:
    """Return the source on the motion's model; RenderError where their frames differ."""
    source = source.on(motion.model)
    if source.nframe != motion.nframe:
        raise RenderError(
            f"source has {source.nframe} frames and motion {motion.nframe}: they must have the same"
        )
    return source


def _body_on(motion: Motion, body: MorphBody, layout: str) -> MorphBody:
    """Return the body on the motion's model; RenderError where it cannot be shown."""
    if layout == "ghost":
        raise RenderError("a body that changes has no ghost: take side-by-side or single")
    if body.nframe != motion.nframe:
        raise RenderError(
            f"the body has {body.nframe} frames and the motion {motion.nframe}: they must have the"
            " same"
        )
    return body.on(motion.model)


def _source_camera(source: Motion, camera: CameraPath) -> CameraPath:
    """Return the view of the motion's camera, of the source in place of the motion."""
    own = follow(source.model, source.qpos, source.fps, scene=False)
    return dataclasses.replace(
        camera, lookat=own.lookat, elevation=np.maximum(camera.elevation, np.radians(8.0))
    )


def _floor_height(source: Motion, marks: ContactMarks) -> float:
    """Return where the flat floor under the source is [m]: where its contacts stand."""
    if len(marks.start):
        return float(np.median(marks.position[:, 2]))
    return float(np.median(figure_extent(source.model, source.qpos)[0]))


def check_size(width: int, height: int) -> None:
    """Raise RenderError for what H.264 with 4:2:0 colours does not have: its sizes are even."""
    if width % 2 or height % 2 or min(width, height) < _MIN_SIZE:
        raise RenderError(
            f"size {width}×{height}: both must be even and at least {_MIN_SIZE} pixels"
        )
