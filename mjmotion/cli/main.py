"""The command line: ``mjmotion COMMAND``.

Here are the list of commands and the errors; what a command takes and does is in its own module of
:mod:`mjmotion.cli`, which imports the library only once it is to run, so that ``--help``
answers at once. A new command is a file there and a word in ``COMMANDS``.

Exit codes: 0 well; 1 a threshold is broken or a constraint of the user's own is not met (the output
is written); 2 bad input (one line on stderr, nothing written).
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
from collections.abc import Sequence
from importlib import import_module
from types import ModuleType
from typing import Any, NoReturn

from mjmotion import __version__
from mjmotion.exceptions import MotionError

OK, BROKEN, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130  # exit codes

# In the order of the help; a module of mjmotion.cli each.
COMMANDS = (
    "demo",
    "adapt",
    "validate",
    "render",
    "info",
    "scene",
    "character",
    "retarget",
    "edit",
    "edit-frame",
    "replay",
    "view",
    "table1",
    "morph",
    "transition",
    "join",
    "rope",
)


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are one line, like every other error of the program."""

    def __init__(self, **settings: Any) -> None:
        # Examples stay on one line, to be copied.
        super().__init__(formatter_class=argparse.RawDescriptionHelpFormatter, **settings)

    def error(self, message: str) -> NoReturn:
        self.exit(BAD_INPUT, f"mjmotion: error: {message} (see '{self.prog} --help')\n")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
      argv: the arguments, without the program's name; ``None`` takes those of the process.

    Returns:
      The exit code.
    """
    args = parse(argv)
    # A kill must clean up what is half done, as Ctrl-C does: raise instead of dying on the spot.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    try:
        code: int = _module(args.command).run(args)
        sys.stdout.flush()
        return code
    except MotionError as error:
        print("mjmotion: error:", " ".join(str(error).split()), file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print("mjmotion: interrupted, nothing was written", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:  # the reader of our output, such as head, has gone
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return OK


def parse(argv: Sequence[str] | None = None) -> argparse.Namespace:
    """Return the parsed arguments; on an error the program ends with exit code 2."""
    return _parser().parse_args(argv)


def _module(command: str) -> ModuleType:
    return import_module(f"mjmotion.cli.{command.replace('-', '_')}")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="mjmotion",
        description="Adapt recorded walks to new ground: stairs, slopes, rough terrain, doorways.",
        epilog="try: mjmotion demo",
    )
    parser.add_argument("--version", action="version", version=f"mjmotion {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name in COMMANDS:
        module = _module(name)
        text, example = module.HELP, f"example: {module.EXAMPLE}"
        module.arguments(commands.add_parser(name, help=text, description=text, epilog=example))
    return parser
