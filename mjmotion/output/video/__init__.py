"""Videos and pictures of motions, rendered offscreen by MuJoCo.

OpenGL is bound when the first picture is made, never before: importing this package needs no
graphics library.
"""

from mjmotion.output.video.gl import Canvas, draws_in_any_thread, ensure_gl
from mjmotion.output.video.render import (
    render_frames,
    render_video,
    video_frames,
)
from mjmotion.output.video.strip import render_strip
from mjmotion.output.video.writer import VideoWriter

__all__ = [
    "Canvas",
    "VideoWriter",
    "draws_in_any_thread",
    "ensure_gl",
    "render_frames",
    "render_strip",
    "render_video",
    "video_frames",
]
