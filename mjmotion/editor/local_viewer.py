"""MuJoCo Studio's web viewer, on this machine alone, with what its version 4.0.0 lacks.

All private names of Studio that this project relies on are in this file.

- It would listen on every interface without a password: the socket is bound to one address.
- Any web site that is open in the same browser could connect: other origins are refused.
- A page that connects in the first frames ends the process: the server starts after them.
- It keeps every model that it showed: as many bytes as ``MODEL_CACHE`` are kept.
- It tells stdout of every model: it does not.
- It sends the page's windows 60 times a second, and the page draws all of them one by one: one
  that draws slower lags ever more behind. No window is sent before the page has drawn.
"""

from __future__ import annotations

import logging
import socket
import threading
import time
from collections.abc import Awaitable, Callable, Sequence
from typing import Any

import mujoco
from mujoco.studio import endpoints, messages, plugin, viewer_protocol, web_viewer
from mujoco.studio.web import web_server

MODEL_CACHE = 8 << 20  # models of before that are kept for pages [bytes]
LATE = 5  # frames before which no page may connect

AHEAD = 2  # frames that the page may be behind
_HIDDEN = 1.0  # a page that tells nothing for so long is hidden: it gets a frame so often [s]
_ALONE = 0.05  # between two frames that no page draws [s]
_NAP = 0.004  # between two looks whether the page has drawn [s]

_serve = web_server.serve


class Pace:
    """How far ahead of the page its windows are: the page sends its mouse and keys every frame."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._pages = self._ahead = 0
        self._last = 0.0

    @property
    def alone(self) -> bool:
        """Whether there is no page that could draw."""
        return not self._pages

    def may_go_on(self) -> bool:
        """Whether another frame may be made."""
        with self._lock:
            waited = time.monotonic() - self._last
            return not self._pages or self._ahead < AHEAD or waited > _HIDDEN

    def made(self) -> None:
        """Count a frame that was made."""
        with self._lock:
            self._ahead += 1
            self._last = time.monotonic()

    def drawn(self) -> None:
        """Count a frame that the page has drawn."""
        with self._lock:
            self._ahead = max(0, self._ahead - 1)

    def came(self, pages: int) -> None:
        """Count a page that came (1) or went (−1)."""
        with self._lock:
            self._pages += pages
            self._ahead = 0

    async def count(self, handler: Callable[[Any], Awaitable[None]], connection: Any) -> None:
        """Handle a page's connection, and count what it tells."""
        if connection.request is None or not connection.request.path.startswith("/ui"):
            await handler(connection)
            return
        receive = connection.recv

        async def counted(*args: Any, **settings: Any) -> Any:
            message = await receive(*args, **settings)
            self.drawn()
            return message

        connection.recv = counted
        self.came(1)
        try:
            await handler(connection)
        finally:
            self.came(-1)


class LocalViewer(web_viewer.WebViewer):
    """The web viewer, bound to one address, for pages of few origins.

    Args:
      config: Studio's; has a port.
      endpoint: Studio's.
      model: what is shown at first.
      page: the plugin that makes the page.
      host: address to listen at.
      origins: of a port, the origins of pages that may connect; None in it is a client that is no
        browser.
      started: called with the port once pages may connect.

    Raises:
      RuntimeError: the port is in use.
      OSError: the address is not this machine's.
    """

    def __init__(
        self,
        config: viewer_protocol.ViewerConfig,
        endpoint: endpoints.ViewerEndpoint,
        model: mujoco.MjModel,
        page: plugin.ViewerPlugin,
        host: str,
        origins: Callable[[int], Sequence[str | None]],
        started: Callable[[int], None] | None = None,
    ) -> None:
        self._listens_at, self._origins, self._started = host, origins, started
        self._frames = 0
        self._pace = Pace()
        logging.getLogger("WebServer").setLevel(logging.ERROR)
        super().__init__(config, endpoint, model=model, plugins=[page])

    # Studio sets it to every interface, and then binds.
    @property
    def _host(self) -> str:
        return self._listens_at

    @_host.setter
    def _host(self, _: str) -> None:
        pass

    def _start_server(self) -> None:
        origins, pace = self._origins(self._http_port), self._pace

        def serve(handler: Callable[[Any], Awaitable[None]], **settings: Any) -> Any:
            return _serve(lambda one: pace.count(handler, one), origins=origins, **settings)

        web_server.serve = serve
        start = web_server.WebServer.start
        web_server.WebServer.start = lambda _: None
        try:
            super()._start_server()
        finally:
            web_server.WebServer.start = start
        self._web_server.model_cache_bytes = MODEL_CACHE

    def prepare_next_frame(self) -> bool:
        """Advance to the next frame; False if there is none, for the page has not drawn the last.

        The server starts when a few are done.
        """
        if not self._pace.may_go_on():
            time.sleep(_NAP)
            return False
        if self._frames > LATE and self._pace.alone:
            time.sleep(_ALONE)
        frame = bool(super().prepare_next_frame())
        if frame:
            self._pace.made()
        self._frames += 1
        if self._frames == LATE:
            self._web_server.start()
        elif self._frames > LATE and self._started is not None and self._listens():
            self._started(self._http_port)
            self._started = None
        return frame

    def _listens(self) -> bool:
        """Whether the server's thread has come so far that a page is answered."""
        return bool(self._http_sock.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN))

    @messages.handler(priority=messages.Priority.INTERNAL)
    def _on_post_model(self, event: messages.PostModelEvent) -> None:
        del event
        self._update_model()
