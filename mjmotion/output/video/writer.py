"""H.264 video files, encoded while frames are rendered, without slowing that.

Software OpenGL keeps every core busy, so the encoder gets a cheap preset, one thread and a low
priority, and is fed from a bounded queue by a thread of its own.
"""

from __future__ import annotations

import contextlib
import os
import platform
import queue
import threading
from collections.abc import Generator
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mjmotion.boundary.whole import whole_file
from mjmotion.exceptions import OutputError, RenderError

_QUEUE = 8  # frames in flight: 22 MB at 1280×720
_NICE = 10

_COLOUR = [
    "-vf",
    "scale=out_color_matrix=bt709:out_range=tv",
    *("-colorspace", "bt709", "-color_primaries", "bt709", "-color_trc", "bt709"),
]  # without a tag players guess the colours of HD wrongly


class VideoWriter:
    """Writes frames to an mp4; the file appears only when the block ends without an error.

        with VideoWriter("walk.mp4", 1280, 720, fps=30.0) as writer:
            writer.write(image)

    Args:
      path: the file, ending in ``.mp4``; an existing one is replaced.
      width: even [pixel].
      height: even [pixel].
      fps: frames a second.
      crf: H.264 constant rate factor: 18 is visually lossless, 28 is small.

    Raises:
      OutputError: the folder does not exist or cannot be written, or the ending is not ``.mp4``.
    """

    def __init__(
        self, path: str | Path, width: int, height: int, fps: float, crf: int = 22
    ) -> None:
        self.path = Path(path)
        if self.path.suffix.lower() != ".mp4":
            raise OutputError(f"video '{self.path}' must end in .mp4")
        folder = self.path.parent
        if not folder.is_dir() or not os.access(folder, os.W_OK):
            raise OutputError(
                f"folder '{folder}' does not exist or cannot be written: choose another"
            )
        self._size, self._fps, self._crf = (width, height), fps, crf
        self._whole = whole_file(self.path, ".mp4")
        try:
            self._aside = self._whole.__enter__()
        except OSError as fault:
            raise OutputError(f"cannot write '{self.path}': {fault.strerror}") from fault
        self._queue: queue.Queue[NDArray[np.uint8] | None] = queue.Queue(_QUEUE)
        self._error: Exception | None = None
        self._frames = 0
        self._thread = threading.Thread(target=self._encode, name="video-writer", daemon=True)
        self._thread.start()

    def write(self, image: NDArray[np.uint8]) -> None:
        """Queue one frame, (height, width, 3) uint8; it must not be changed afterwards.

        Raises:
          OutputError: an earlier frame could not be written.
        """
        width, height = self._size
        if image.shape != (height, width, 3) or image.dtype != np.uint8:
            raise RenderError(
                f"frame is {image.shape} {image.dtype}, the video wants {(height, width, 3)} uint8"
            )
        self._check()
        self._frames += 1
        self._queue.put(np.ascontiguousarray(image))

    def __enter__(self) -> VideoWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._queue.put(None)
        self._thread.join()
        try:
            if error is None:
                self._check()
                self._verify()
        except BaseException as fault:
            with contextlib.suppress(type(fault)):
                self._whole.__exit__(type(fault), fault, fault.__traceback__)
            raise
        if error is None:
            self._whole.__exit__(None, None, None)
        else:
            with contextlib.suppress(type(error)):
                self._whole.__exit__(kind, error, trace)

    def _check(self) -> None:
        if self._error is not None:
            line = str(self._error).strip().splitlines()[0]
            raise OutputError(f"video '{self.path}' cannot be written: {line}") from self._error

    def _verify(self) -> None:
        """Read the header back: ffmpeg's exit code is not to be had from imageio."""
        import imageio_ffmpeg

        if self._frames == 0:
            raise RenderError(f"video '{self.path}' would have no frames: choose some")
        try:
            reader = imageio_ffmpeg.read_frames(self._aside)
            seconds = next(reader)["duration"]
            reader.close()
        except (OSError, RuntimeError, StopIteration, KeyError) as error:
            raise OutputError(
                f"video '{self.path}' was not written to its end: check the space on its disk"
            ) from error
        if abs(seconds - self._frames / self._fps) > 0.1 + 1.5 / self._fps:
            raise OutputError(
                f"video '{self.path}' lasts {seconds:.1f} s in place of"
                f" {self._frames / self._fps:.1f} s: check the space on its disk"
            )

    def _encode(self) -> None:
        """Feed the encoder until the queue says stop; after an error only empty the queue."""
        encoder: Generator[None, Any, None] | None = None
        try:
            encoder = self._start()
        except Exception as error:
            self._error = error
        while (image := self._queue.get()) is not None:
            if self._error is None and encoder is not None:
                try:
                    encoder.send(image)
                except Exception as error:
                    self._error = error
        if encoder is not None:
            encoder.close()

    def _start(self) -> Generator[None, Any, None]:
        """Start ffmpeg from a short-lived thread of low priority, which ffmpeg inherits."""
        import imageio_ffmpeg

        encoder: Generator[None, Any, None] = imageio_ffmpeg.write_frames(
            self._aside,
            self._size,
            fps=self._fps,
            codec="libx264",
            quality=None,
            macro_block_size=1,
            ffmpeg_log_level="error",
            output_params=[
                *_COLOUR,
                *("-preset", "superfast", "-threads", "1", "-crf", str(self._crf)),
                *("-movflags", "+faststart"),
            ],
        )
        failed: list[Exception] = []

        def launch() -> None:
            # On Linux a priority belongs to a thread, and this one ends here: nothing else slows.
            if platform.system() == "Linux":
                me = threading.get_native_id()
                own = os.getpriority(os.PRIO_PROCESS, me)
                os.setpriority(os.PRIO_PROCESS, me, max(own, _NICE))
            try:
                encoder.send(None)
            except Exception as error:
                failed.append(error)

        starter = threading.Thread(target=launch, name="video-encoder")
        starter.start()
        starter.join()
        if failed:
            raise failed[0]
        return encoder
