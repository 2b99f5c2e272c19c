"""MuJoCo Studio's web viewer, on this machine alone, with what its version 4.0.0 lacks.

All private names of Studio that this project relies on are in this file.

- It would listen on every interface without a password: the socket is bound to one address.
- Any web site that is open in the same browser could connect: other origins are refused.
- A page that connects in the first frames ends the process: the server starts after them.
- It keeps every model that it showed: as many bytes as ``MODEL_CACHE`` are kept.
- It tells stdout of every model: it does not.
"""

from __future__ import annotations

import functools
import logging
from collections.abc import Callable, Sequence

import mujoco
from mujoco.studio import endpoints, messages, plugin, viewer_protocol, web_viewer
from mujoco.studio.web import web_server

MODEL_CACHE = 8 << 20  # models of before that are kept for pages [bytes]
LATE = 5  # frames before which no page may connect

_serve = web_server.serve


class LocalViewer(web_viewer.WebViewer):  # type: ignore[misc]
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
        web_server.serve = functools.partial(_serve, origins=self._origins(self._http_port))
        start = web_server.WebServer.start
        web_server.WebServer.start = lambda _: None
        try:
            super()._start_server()
        finally:
            web_server.WebServer.start = start
        self._web_server.model_cache_bytes = MODEL_CACHE

    def prepare_next_frame(self) -> bool:
        """Advance to the next frame; the server starts when a few are done."""
        frame = bool(super().prepare_next_frame())
        self._frames += 1
        if self._frames == LATE:
            self._web_server.start()
            if self._started is not None:
                self._started(self._http_port)
        return frame

    @messages.handler(priority=messages.Priority.INTERNAL)  # type: ignore[untyped-decorator]
    def _on_post_model(self, event: messages.PostModelEvent) -> None:
        del event
        self._update_model()
