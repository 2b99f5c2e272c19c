"""The strip of poses, drawn in a thread while figures are measured and files are written.

MuJoCo and the driver do that without Python's lock, and it takes three times as long as measuring.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Strip = Callable[[], NDArray[np.uint8]]
    """Returns the picture, or raises RenderError where there is no OpenGL for it."""


@contextlib.contextmanager
def strip_ahead(motion: Any, **settings: Any) -> Iterator[Strip]:
    """Start to draw a strip of poses; what is yielded waits for it and returns it.

    At the end the thread is through, whatever happened. Where a window library wants the main
    thread, the strip is drawn there, when it is asked for.

    Args:
      motion: what is shown.
      settings: of :func:`mjmotion.output.video.render_strip`.
    """
    from mjmotion.output import video

    if not video.draws_in_any_thread():
        yield lambda: video.render_strip(motion, **settings)
        return
    with ThreadPoolExecutor(1, "strip of poses") as pool:
        yield pool.submit(video.render_strip, motion, **settings).result
