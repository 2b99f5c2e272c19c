"""The command line: ``mjmotion COMMAND``.

Here are the list of commands and the errors; what a command takes and does is in its own module of
:mod:`mjmotion.cli`, which imports the library only once it is to run, so that ``--help``
answers at once. A new command is a file there and a word in ``COMMANDS``.

Exit codes: 0 well; 1 a threshold is broken or a constraint of the user's own is not met (the output
is written); 2 bad input (one line on stderr, nothing written); 3 a fault of mjmotion itself (one
line, and the traceback with ``--debug``); 130 interrupted.
"""

from __future__ import annotations

import argparse
import contextlib
import errno
import io
import os
import signal
import sys
import traceback
from collections.abc import Iterator, Sequence
from importlib import import_module
from pathlib import Path
from types import FrameType, ModuleType
from typing import Any, NoReturn

from mjmotion import __version__
from mjmotion.boundary.words import first_line, one_line
from mjmotion.cli.written import Written
from mjmotion.exceptions import MotionError

_LONGEST = 500  # letters of a message about arguments, which may be anything
_NOTES = 5  # warnings that are told one by one
OK, BROKEN, BAD_INPUT, FAULT, INTERRUPTED = 0, 1, 2, 3, 130  # exit codes

# In the order of the help; a module of mjmotion.cli each.
COMMANDS = (
    "demo",
    "adapt",
    "plan",
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
    "batch",
)


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are one line, like every other error of the program."""

    def __init__(self, **settings: Any) -> None:
        # Examples stay on one line, to be copied.
        super().__init__(formatter_class=argparse.RawDescriptionHelpFormatter, **settings)

    def _print_message(self, message: str, file: Any = None) -> None:
        """Say a help page or version; where stdout takes nothing, say that."""
        try:
            (file or sys.stderr).write(message)
            (file or sys.stderr).flush()
        except BrokenPipeError:
            _drop_stdout()
        except OSError as error:
            _drop_stdout()
            _say(f"error: cannot write: {error.strerror}")
            sys.exit(BAD_INPUT)

    def error(self, message: str) -> NoReturn:
        said = one_line(message)
        said = said if len(said) <= _LONGEST else said[:_LONGEST] + "…"
        self.exit(BAD_INPUT, f"mjmotion: error: {said} (see '{self.prog} --help')\n")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
      argv: the arguments, without the program's name; ``None`` takes those of the process.

    Returns:
      The exit code.
    """
    _any_streams()
    args = parse(argv)
    # A kill must clean up what is half done, as Ctrl-C does: raise instead of dying on the spot.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    written = Written(args)
    with _interrupts() as interrupts:
        code = _run(args, written, interrupts)
        if argv is None:  # all is written and said: nothing is left to be interrupted
            signal.signal(signal.SIGINT, signal.SIG_IGN)
    return code


def _run(args: argparse.Namespace, written: Written, interrupts: list[int]) -> int:
    """Run a command and say how it ended; return the exit code."""
    try:
        with _told():
            code: int = _module(args.command).run(args)
        sys.stdout.flush()
        return code
    except MotionError as error:
        if args.debug:
            traceback.print_exc()
        _say(f"error: {one_line(str(error))}")
        return BAD_INPUT
    except KeyboardInterrupt:
        _say(f"interrupted, {written.said()}")
        return INTERRUPTED
    except BrokenPipeError:  # the reader of our output, such as head, has gone
        _drop_stdout()
        return OK
    except MemoryError:
        _say(
            f"error: there is not enough memory for this, {written.said()}: give something smaller"
        )
        return BAD_INPUT
    except Exception as error:
        # The last catch: what no reader foresaw is told as what it is, and never as exit code 1.
        if args.debug:
            traceback.print_exc()
        if interrupts:  # modules in C that are being imported make an ImportError of Ctrl-C
            _say(f"interrupted, {written.said()}")
            return INTERRUPTED
        return _last(error, written)


@contextlib.contextmanager
def _interrupts() -> Iterator[list[int]]:
    """Note what is interrupted, which otherwise goes on as Python does it."""
    noted: list[int] = []
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield noted  # someone else's, or ignored
        return

    def note(number: int, frame: FrameType | None) -> None:
        noted.append(number)
        signal.default_int_handler(number, frame)

    signal.signal(signal.SIGINT, note)
    try:
        yield noted
    finally:
        if signal.getsignal(signal.SIGINT) is note:
            signal.signal(signal.SIGINT, signal.default_int_handler)


def _last(error: Exception, written: Written) -> int:
    """Tell of an error that nothing foresaw."""
    if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EIO):
        _drop_stdout()  # a full disk or terminal is no fault of ours
        _say(f"error: cannot write: {error.strerror}, {written.said()}")
        return BAD_INPUT
    if "MUJOCO_GL" in str(error):  # MuJoCo's own words, as it is imported
        _say("error: the environment variable MUJOCO_GL is none of egl, osmesa and glfw: unset it")
        return BAD_INPUT
    what = f"{type(error).__name__}: {first_line(error)}"
    _say(f"a fault of mjmotion, {written.said()}: please report it with what --debug shows: {what}")
    return FAULT


@contextlib.contextmanager
def _told() -> Iterator[None]:
    """Gather warnings; where the command ends well, each is told in one line."""
    from mjmotion.boundary.quiet import c_errors_kept, gathered
    from mjmotion.cli.terminal import warn

    with gathered() as notes, c_errors_kept() as said:
        yield
    notes += said
    for line in notes[:_NOTES]:
        warn(f"note: {line}")
    if len(notes) > _NOTES:
        warn(f"note: {len(notes) - _NOTES} more warnings")


def _say(line: str) -> None:
    with contextlib.suppress(OSError, ValueError):  # stderr may be closed or full, too
        print(f"mjmotion: {line}", file=sys.stderr, flush=True)


def _any_streams() -> None:
    """Have streams that take any text, whatever their encoding, and that are there at all."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:  # closed by the shell: >&-
            sink = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115  # for good
            setattr(sys, name, sink)
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _drop_stdout() -> None:
    """Send what is still to be written nowhere, so that the interpreter does not fail on it."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


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
    parser.add_argument("--debug", action="store_true", help="show the traceback of an error")
    parser.add_argument("--version", action="version", version=f"mjmotion {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name in COMMANDS:
        module = _module(name)
        text, example = module.HELP, f"example: {module.EXAMPLE}"
        own = commands.add_parser(name, help=text, description=text, epilog=example)
        own.add_argument(
            "--debug", action="store_true", default=argparse.SUPPRESS, help=argparse.SUPPRESS
        )
        module.arguments(own)
    return parser
