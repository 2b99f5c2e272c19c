"""Offscreen OpenGL, bound only when rendering starts.

``import mujoco`` picks an OpenGL backend from ``MUJOCO_GL`` once and for all, before anyone knows
whether a picture will be wanted. Here the context class is taken from MuJoCo's backend modules
themselves, late, so neither ``import mujoco`` nor ``import mjmotion`` needs an OpenGL library and
nobody has to set ``MUJOCO_GL`` first. The libraries are tried before MuJoCo touches them, because a
missing one would otherwise end in an error that names no package.
"""

from __future__ import annotations

import contextlib
import ctypes
import ctypes.util
import importlib
import os
import platform
from collections.abc import Iterator
from types import TracebackType
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.exceptions import RenderError

Image = NDArray[np.uint8]
"""A picture: (height, width, 3) uint8, RGB, top row first."""

_OFF = ("disable", "disabled", "off", "false", "0")
_DEFAULT = ("", "enable", "enabled", "on", "true", "1")
_LIBRARIES = {"egl": ("EGL", "GL"), "osmesa": ("OSMesa",), "glfw": ("GL",)}
_INSTALL = {"egl": "libegl1 libgl1", "osmesa": "libosmesa6", "glfw": "libgl1"}  # Debian packages


def ensure_gl() -> type[Any]:
    """Return MuJoCo's OpenGL context class, after checking that its libraries load.

    EGL unless the environment's ``MUJOCO_GL`` says otherwise.

    Raises:
      RenderError: a library is missing (with the packages to install), or ``MUJOCO_GL`` forbids
        rendering or names no backend.
    """
    choice = os.environ.get("MUJOCO_GL", "").lower().strip()
    if choice in _OFF:
        raise RenderError(f"MUJOCO_GL={choice} switches rendering off: unset it to get pictures")
    if platform.system() != "Linux":
        return _context_class("mujoco.gl_context")
    backend = "egl" if choice in _DEFAULT else {"glx": "glfw"}.get(choice, choice)
    if backend not in _LIBRARIES:
        raise RenderError(f"MUJOCO_GL={choice} is no backend: use egl, osmesa or glfw")
    if not all(_loads(name) for name in _LIBRARIES[backend]):
        raise RenderError(f"offscreen OpenGL is missing: apt-get install {_INSTALL[backend]}")
    return _context_class(f"mujoco.{backend}")


def draws_in_any_thread() -> bool:
    """Return whether pictures may be drawn outside the main thread: GLFW's may not."""
    choice = os.environ.get("MUJOCO_GL", "").lower().strip()
    return platform.system() == "Linux" and choice in (*_DEFAULT, *_OFF, "egl", "osmesa")


class Canvas:
    """An offscreen picture that MuJoCo scenes are drawn into; a context manager.

    Args:
      model: what is drawn; its ``vis`` settings say how (samples, shadows, fog).
      width: [pixel].
      height: [pixel].

    Raises:
      RenderError: there is no offscreen OpenGL, or its driver refuses.
    """

    def __init__(self, model: mujoco.MjModel, width: int, height: int) -> None:
        self.width, self.height = width, height
        self._gl: Any = None
        self._context: mujoco.MjrContext | None = None
        context_class = ensure_gl()
        with _driver_errors():
            self._gl = context_class(width, height)
            self._gl.make_current()
            self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
            mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._context)
        self._buffer: Image = np.empty((height, width, 3), np.uint8)

    def draw(self, rect: mujoco.MjrRect, scene: mujoco.MjvScene) -> None:
        """Draw ``scene`` into the rectangle ``rect`` [pixel, origin at the bottom left]."""
        self._gl.make_current()  # there may be other canvases
        mujoco.mjr_render(rect, scene, self._context)

    def upload_hfield(self, model: mujoco.MjModel, hfield: int) -> None:
        """Give the driver the heights of a heightfield that changed."""
        mujoco.mjr_uploadHField(model, self._context, hfield)

    def upload_meshes(self, model: mujoco.MjModel) -> None:
        """Give the driver the vertices of all meshes, which changed."""
        for mesh in range(model.nmesh):
            mujoco.mjr_uploadMesh(model, self._context, mesh)

    def read_depth(self) -> NDArray[np.float32]:
        """Return how far every pixel is, (height, width) in 0…1: nearer is less."""
        depth = np.empty((self.height, self.width), np.float32)
        whole = mujoco.MjrRect(0, 0, self.width, self.height)
        mujoco.mjr_readPixels(None, depth, whole, self._context)
        return depth[::-1]

    def read(self) -> Image:
        """Return a copy of the picture."""
        self._gl.make_current()
        whole = mujoco.MjrRect(0, 0, self.width, self.height)
        mujoco.mjr_readPixels(self._buffer, None, whole, self._context)
        return self._buffer[::-1].copy()

    def close(self) -> None:
        """Give the driver's memory back."""
        if self._context is not None:
            self._context.free()
            self._context = None
        if self._gl is not None:
            self._gl.free()
            self._gl = None

    def __enter__(self) -> Canvas:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def _loads(name: str) -> bool:
    """Return whether the dynamic linker can load a library."""
    try:
        ctypes.CDLL(ctypes.util.find_library(name) or f"lib{name}.so.1")
    except OSError:
        return False
    return True


def _context_class(module: str) -> type[Any]:
    with _driver_errors():
        context: type[Any] = importlib.import_module(module).GLContext
        return context


@contextlib.contextmanager
def _driver_errors() -> Iterator[None]:
    """Turn what bindings and drivers raise, which shares no base class, into RenderError."""
    try:
        yield
    except RenderError:
        raise
    except Exception as error:
        line = (str(error).strip().splitlines() or [type(error).__name__])[0]
        raise RenderError(
            f"offscreen OpenGL does not start ({line}): apt-get install {_INSTALL['egl']},"
            " or set MUJOCO_GL to egl, osmesa or glfw"
        ) from error
