"""Text on pictures: what a panel shows, the time, and what the marks mean."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mjmotion.boundary.words import one_line
from mjmotion.output.video.gl import Image

_LETTERS = 120  # of a caption

_INK = (28, 34, 42)
_PALE = (255, 255, 255)


@lru_cache(maxsize=512)
def _label(
    text: str, size: int, dot: tuple[int, int, int] | None
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return colour × opacity (h, w, 3) and 1 − opacity (h, w, 1) of a line of text on a plate."""
    from PIL import Image as Pillow
    from PIL import ImageDraw, ImageFont

    text = one_line(text)[:_LETTERS]  # a name may hold a line break, or have a thousand letters
    font: Any = ImageFont.load_default(size=size)
    _, top, _, bottom = font.getbbox("Ag|")
    indent = size if dot is not None else 0
    pad = max(size // 3, 2)
    width = int(font.getlength(text)) + indent + 2 * pad
    height = int(bottom - top) + 2 * pad
    plate = Pillow.new("RGBA", (width, height), (*_PALE, 0))
    draw = ImageDraw.Draw(plate)
    draw.rounded_rectangle((0, 0, width - 1, height - 1), radius=pad, fill=(*_PALE, 190))
    if dot is not None:
        r = 0.32 * size
        x, y = pad + r, height / 2
        draw.ellipse((x - r, y - r, x + r, y + r), fill=(*dot, 255))
    ink = Pillow.new("L", (width, height), 0)
    ImageDraw.Draw(ink).text((pad + indent, pad - top), text, font=font, fill=255)
    plate.paste((*_INK, 255), (0, 0), ink)
    pixels = np.asarray(plate, dtype=np.float32)
    opacity = pixels[..., 3:] / 255.0
    return pixels[..., :3] * opacity, 1.0 - opacity


def write_label(
    image: Image,
    text: str,
    x: int,
    y: int,
    size: int,
    *,
    anchor: str = "left",
    dot: tuple[float, float, float] | None = None,
) -> int:
    """Write one line onto ``image`` in place; return the width of its plate [pixel].

    Args:
      image: (height, width, 3), changed.
      text: the line.
      x: left of the plate, or its right with ``anchor="right"`` [pixel].
      y: top of the plate; negative: its bottom, from the picture's bottom [pixel].
      size: of the letters [pixel].
      anchor: ``"left"`` or ``"right"``.
      dot: a coloured dot before the text, RGB in 0…1.
    """
    colour = tuple(int(255 * c) for c in dot) if dot is not None else None
    ink, clear = _label(text, size, colour)
    height, width = ink.shape[:2]
    top = y if y >= 0 else image.shape[0] + y - height
    left = x if anchor == "left" else x - width
    top, left = max(top, 0), max(left, 0)
    part = image[top : top + height, left : left + width]
    h, w = part.shape[:2]
    part[:] = (ink[:h, :w] + clear[:h, :w] * part).astype(np.uint8)
    return int(width)
