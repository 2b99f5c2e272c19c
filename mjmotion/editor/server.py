"""The page's server: MuJoCo Studio's, on this machine alone, with what its version 4.0.0 lacks.

Here is what can go wrong before the page is there, as one line each.
"""

from __future__ import annotations

import contextlib
import functools
import io
import ipaddress
import socket
from collections.abc import Callable
from typing import Any

from mjmotion.editor.files import Files
from mjmotion.editor.intents import Intents
from mjmotion.exceptions import EditorError

LOOPBACK = "127.0.0.1"
_MISSING = "the editor needs MuJoCo Studio, which comes with mujoco 4: pip install 'mujoco>=4.0'"


def serve(
    do: Intents,
    files: Files,
    *,
    title: str = "mjmotion",
    port: int = 0,
    host: str = LOOPBACK,
    started: Callable[[str], None] | None = None,
    observe: Callable[[Any], None] | None = None,
) -> None:
    """Serve the page until the process is interrupted. It runs on the calling thread.

    Args:
      do: what the person can do.
      files: what the page writes and reads.
      title: of the page.
      port: where to listen; 0 for the first that is free from 8080 on.
      host: address to listen at; others than this machine can connect to any but a loopback one.
      started: called with the page's address once it can be opened.
      observe: called with the plugin after every frame.

    Raises:
      EditorError: no Studio, the port is in use, or the address is not this machine's.
    """
    try:
        from mujoco.studio import launch_thread, viewer_protocol

        from mjmotion.editor.local_viewer import LocalViewer
        from mjmotion.editor.plugin import EditorPlugin
    except ImportError as error:
        raise EditorError(f"{_MISSING} ({error})") from error
    page = EditorPlugin(do, files, observe)
    viewer_end, _ = launch_thread.make_thread_endpoints()
    config = viewer_protocol.ViewerConfig(title=title, http_port=_checked(port, host))
    told = None if started is None else lambda at: started(address(host, at))
    try:
        with contextlib.redirect_stdout(io.StringIO()):  # a banner with addresses that are not ours
            viewer = LocalViewer(
                config, viewer_end, page.model, page, host, functools.partial(origins, host), told
            )
    except RuntimeError as error:
        raise _in_use(port) from error
    except OSError as error:
        raise EditorError(f"cannot listen at '{host}': {error.strerror or error}") from error
    try:
        viewer_protocol.run_viewer_loop(viewer)
    finally:
        files.close()
        do.close()


def no_window() -> str:
    """Return why there is a page and no window of its own."""
    return 'MuJoCo Studio\'s own window does not draw in mujoco 4.0 ("Target not found")'


def is_loopback(host: str) -> bool:
    """Whether an address is reached from this machine alone."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _checked(port: int, host: str) -> int:
    """Return a port, or the first that is free from 8080 on for 0.

    Raises:
      EditorError: it is in use, or the host is not this machine's.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    for candidate in [port] if port else range(8080, 8100):
        with socket.socket(family, socket.SOCK_STREAM) as trial:
            trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                trial.bind((host, candidate))
            except OSError as error:
                if error.errno in (98, 48, 10048):  # in use, as Linux, macOS and Windows say it
                    continue
                raise EditorError(f"cannot listen at '{host}': {error.strerror}") from error
            return candidate
    raise _in_use(port)


def _in_use(port: int) -> EditorError:
    if port:
        return EditorError(f"port {port} is in use: give another with --port, or none")
    return EditorError("ports 8080 to 8099 are all in use: give one with --port")


def address(host: str, port: int) -> str:
    """Return the page's address for this machine's browser."""
    name = LOOPBACK if host in ("0.0.0.0", "::", "localhost") else host
    return f"http://[{name}]:{port}/" if ":" in name else f"http://{name}:{port}/"


def origins(host: str, port: int) -> list[str | None]:
    """Return the origins of pages that may connect: those that this server itself has sent.

    None in the list stands for clients that are no browsers, such as scripts.
    """
    if host in ("0.0.0.0", "::"):
        names = {"localhost", LOOPBACK, "[::1]", socket.gethostname(), socket.getfqdn()}
        with contextlib.suppress(OSError):
            names |= {str(one[4][0]) for one in socket.getaddrinfo(socket.gethostname(), None)}
    else:
        names = {"localhost", LOOPBACK, f"[{host}]" if ":" in host else host}
    return [*(f"http://{name}:{port}" for name in sorted(names)), None]
