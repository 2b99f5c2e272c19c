"""Motions of different characters side by side, each with its own model.

    render_side_by_side("rope.mp4", (original, climber), ("humanoid", "climber"), grasps=places)
    pictures = side_by_side_frames((original, climber), (0, 46, 84), ("humanoid", "climber"))

One camera serves all: it rises and moves with the mean of the figures, so that they compare.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.motion import Motion
from mjmotion.exceptions import RenderError
from mjmotion.numerics.progress import Progress, no_progress
from mjmotion.output.video import stage as staging
from mjmotion.output.video.camera import FOVY, CameraPath, figure_extent
from mjmotion.output.video.captions import write_label
from mjmotion.output.video.gl import Canvas, Image, ensure_gl
from mjmotion.output.video.markers import OTHER
from mjmotion.output.video.render import check_size, video_frames
from mjmotion.output.video.stage import Stage
from mjmotion.output.video.writer import VideoWriter

Array = NDArray[np.float64]

_FILL = 0.78  # of the picture's height that the figures take
_BEARING = np.radians(-62.0)  # of the camera, from its right and a little from ahead
_ELEVATION = np.radians(6.0)
_SIGMA = 0.5  # of the camera's path [s]
_BALL = 0.026  # radius of the mark on a held place [m]


@dataclasses.dataclass(frozen=True, eq=False)
class Grasp:
    """A place that is held: where, by whom, and when.

    Attributes:
      name: what holds it, as written on the picture.
      start, end: frames, ``end`` not included.
      point: (3,) [m].
    """

    name: str
    start: int
    end: int
    point: Array


# More than eight parameters: after the captions all are settings of the picture with defaults.
def render_side_by_side(
    path: str | Path,
    motions: Sequence[Motion],
    captions: Sequence[str],
    *,
    grasps: Sequence[Grasp] = (),
    bearing: float = _BEARING,
    width: int = 1280,
    height: int = 720,
    fps: float = 30.0,
    crf: int = 22,
    progress: Progress = no_progress,
) -> Path:
    """Render motions of the same frames side by side to an H.264 video.

    Args:
      path: the ``.mp4`` file; it appears only when it is complete.
      motions: each on its own model, all with the same number of frames and rate.
      captions: what they are called on the picture.
      grasps: places that are marked, in all panels, while they are held.
      bearing: direction of the camera, about z from +x [rad].
      width: of the video, even [pixel].
      height: of the video, even [pixel].
      fps: frames a second at most.
      crf: H.264 constant rate factor; lower is better and larger.
      progress: called with ("video", frames done, frames in all) after each frame.

    Raises:
      RenderError: no offscreen OpenGL, or motions and settings that do not go together.
      OutputError: the file cannot be written.
    """
    check_size(width, height)
    frames, rate = video_frames(motions[0], fps)
    with (
        _Panels(motions, captions, grasps, bearing, width, height) as panels,
        VideoWriter(path, width, height, rate, crf) as writer,
    ):
        for done, frame in enumerate(frames, start=1):
            writer.write(panels.picture(int(frame)))
            progress("video", done, len(frames))
    return Path(path)


def side_by_side_frames(
    motions: Sequence[Motion],
    frames: Sequence[int],
    captions: Sequence[str],
    *,
    grasps: Sequence[Grasp] = (),
    bearing: float = _BEARING,
    width: int = 1280,
    height: int = 720,
) -> list[Image]:
    """Return pictures (height, width, 3) of single frames.

    Arguments as :func:`render_side_by_side`.

    Raises:
      RenderError: no offscreen OpenGL, or a frame that the motions do not have.
    """
    check_size(width, height)
    outside = [int(frame) for frame in frames if not 0 <= frame < motions[0].nframe]
    if outside:
        raise RenderError(
            f"the motion has frames 0 to {motions[0].nframe - 1}, not {outside[0]}", outside
        )
    with _Panels(motions, captions, grasps, bearing, width, height) as panels:
        return [panels.picture(int(frame)) for frame in frames]


class _Panels:
    """A picture of several panels, each with a canvas of its own: models differ."""

    def __init__(
        self,
        motions: Sequence[Motion],
        captions: Sequence[str],
        grasps: Sequence[Grasp],
        bearing: float,
        width: int,
        height: int,
    ) -> None:
        ensure_gl()
        if len({(motion.nframe, motion.fps) for motion in motions}) != 1:
            raise RenderError("motions side by side must have the same frames and rate")
        if len(captions) != len(motions):
            raise RenderError(f"{len(motions)} motions want as many captions, not {len(captions)}")
        self._motions, self._captions, self._grasps = motions, captions, grasps
        edges = np.linspace(0, width, len(motions) + 1).round().astype(int)
        self._widths = np.diff(edges)
        self._height = height
        self._camera = _shared_camera(motions, bearing)
        self._models = [
            staging.picture_model(motion.model, int(w), height, fovy=FOVY)
            for motion, w in zip(motions, self._widths, strict=True)
        ]
        self._stages = [Stage(model, extra=len(grasps), bearing=bearing) for model in self._models]
        self._canvases: list[Canvas] = []
        self._stack = contextlib.ExitStack()

    def __enter__(self) -> _Panels:
        with contextlib.ExitStack() as stack:
            for model, w in zip(self._models, self._widths, strict=True):
                self._canvases.append(stack.enter_context(Canvas(model, int(w), self._height)))
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def picture(self, frame: int) -> Image:
        """Return the picture of one frame."""
        held = [grasp for grasp in self._grasps if grasp.start <= frame < grasp.end]
        parts: list[Image] = []
        size = max(self._height // 26, 10)
        for motion, stage, canvas, caption in zip(
            self._motions, self._stages, self._canvases, self._captions, strict=True
        ):
            rect = mujoco.MjrRect(0, 0, canvas.width, canvas.height)
            stage.begin(motion.qpos[frame], self._camera.at(frame), canvas.width / canvas.height)
            for grasp in held:
                stage.add(
                    mujoco.mjtGeom.mjGEOM_SPHERE,
                    (_BALL, _BALL, _BALL),
                    grasp.point,
                    (*OTHER, 0.55),
                    emission=0.4,
                )
            canvas.draw(rect, stage.scene)
            image = canvas.read()
            if parts:
                image[:, :1] = 255
            write_label(image, caption, size // 2, size // 2, size)
            parts.append(image)
        whole = np.concatenate(parts, axis=1)
        small, gap = max(self._height // 38, 9), size // 2
        seconds = frame / self._motions[0].fps
        write_label(whole, f"{seconds:5.2f} s    frame {frame}", gap, -gap, small)
        right = whole.shape[1] - gap
        for name in reversed(list(dict.fromkeys(grasp.name for grasp in self._grasps))):
            colour = OTHER if any(grasp.name == name for grasp in held) else (0.85, 0.85, 0.85)
            right -= write_label(whole, name, right, -gap, small, anchor="right", dot=colour)
            right -= gap // 2
        return whole


def _shared_camera(motions: Sequence[Motion], bearing: float) -> CameraPath:
    """Return a camera that follows the mean of the figures smoothly and sees all of each."""
    from scipy.ndimage import gaussian_filter1d

    low, high = (
        np.array(ends)
        for ends in zip(*(figure_extent(m.model, m.qpos) for m in motions), strict=True)
    )
    centre = np.mean([motion.qpos[:, :3] for motion in motions], axis=0)
    centre[:, 2] = 0.5 * (low.min(axis=0) + high.max(axis=0))
    fps = motions[0].fps
    lookat = gaussian_filter1d(centre, _SIGMA * fps, axis=0, mode="nearest")
    span = float((high.max(axis=0) - low.min(axis=0)).max())
    distance = span / (2.0 * _FILL * np.tan(np.radians(FOVY) / 2.0))
    still = np.ones(len(lookat))
    return CameraPath(lookat, bearing * still, _ELEVATION * still, float(distance))
