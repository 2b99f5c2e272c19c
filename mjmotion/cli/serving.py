"""What the commands share that serve a page: their options, the browser, what they say."""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mjmotion.editor.intents import Intents

_MOST_PORT = 65535


def port(text: str) -> int:
    """Return a port from its number; 0 for any that is free."""
    if not (text.isdecimal() and int(text) <= _MOST_PORT):
        raise argparse.ArgumentTypeError(f"'{text}' is not a port: give 0 to {_MOST_PORT}")
    return int(text)


def add_serving(parser: argparse.ArgumentParser) -> None:
    """Add where the page is served and whether it is opened."""
    parser.add_argument(
        "--web",
        action="store_true",
        help="a page in the browser, even where there could be a window",
    )
    parser.add_argument("--port", type=port, default=0, help="of the page: first free from 8080")
    parser.add_argument(
        "--host",
        default="127.0.0.1",
        help="address to listen at; at another than this machine's own, anyone who reaches it can"
        " edit and write files: 127.0.0.1",
    )
    parser.add_argument("--no-open", action="store_true", help="open no browser")


def serve_page(args: argparse.Namespace, do: Intents, name: str) -> int:
    """Serve a page until it is ended, and tell its address.

    Args:
      args: of :func:`add_serving`.
      do: what the page is for.
      name: under which it proposes to write.

    Raises:
      EditorError: it cannot be served.
    """
    from mjmotion.cli.terminal import say, warn
    from mjmotion.editor.files import Files
    from mjmotion.editor.server import is_loopback, no_window, serve

    if not is_loopback(args.host):
        warn(
            f"warning: anyone who can reach {args.host} can edit here and write files as you:"
            " there is no password"
        )
    if not args.web:
        warn(f"note: {no_window()}; a page in the browser instead")

    def started(address: str) -> None:
        say(f"page    {address}", "end     Ctrl-C")
        sys.stdout.flush()
        if args.no_open:
            return
        if not has_display():
            warn(f"no display here: open {address} in a browser, over ssh with -L")
        else:
            _open(address)

    title = f"mjmotion {args.command} {args.what}"
    with contextlib.suppress(KeyboardInterrupt):  # how it is ended
        serve(do, Files(do, name), title=title, port=args.port, host=args.host, started=started)
    kept = do.autosave
    if kept is not None and kept.path.is_file():
        warn(f"note: edits that were not saved are in '{kept.path}', and offered at the next start")
    return 0


def has_display() -> bool:
    """Whether a browser could be opened here."""
    if not sys.platform.startswith("linux"):
        return True
    return any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"))


def _open(address: str) -> None:
    """Open the browser, which may take its time."""
    import threading
    import webbrowser

    threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()
