"""``mjmotion edit``: the editor's page, in the browser (Figure 6)."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from mjmotion.cli.serving import add_serving, serve_page

if TYPE_CHECKING:
    from mjmotion.apps.session import EditSession
    from mjmotion.editor.autosave import Autosave

HELP = "drag a body in the browser and watch the clip deform"
EXAMPLE = "mjmotion edit walk --scene terrain_doors"


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument(
        "what",
        metavar="WHAT",
        nargs="?",
        default="demo",
        help="a clip (BVH, AMC, CSV or NPZ file, or a built-in name), a result folder, a session"
        " (.mjsession), or demo: the walk on terrain with doors",
    )
    parser.add_argument("--scene", help="MJCF file or the name of a scene: adapt the clip first")
    parser.add_argument("--character", help="MJCF file or the name of a model: humanoid")
    add_serving(parser)


def run(args: argparse.Namespace) -> int:
    """Serve the editor's page until it is ended."""
    from mjmotion.cli.terminal import Bar, warn
    from mjmotion.editor.autosave import Autosave
    from mjmotion.editor.intents import Intents
    from mjmotion.editor.opening import open_session

    with Bar() as bar:
        bar("reading and adapting")
        session, name = open_session(args.what, args.scene, args.character)
    autosave = Autosave.of(name)
    if autosave.offered:
        warn(f"note: an earlier start left edits that were not saved in '{autosave.path}'")
    return serve_page(args, Intents(session, autosave=autosave), _first_name(session, autosave))


def _first_name(session: EditSession, autosave: Autosave) -> str:
    """Return the name that the page proposes for what it writes."""
    from mjmotion.editor.autosave import SUFFIX

    stem = autosave.path.name.removesuffix(SUFFIX)
    return stem if session.edits else f"{stem}-edited"
