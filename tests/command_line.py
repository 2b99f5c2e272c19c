"""The command line called in this process: what it takes to start Python anew is saved.

Everything that a shell would see is caught: the streams of Python, what C writes to their files,
and warnings, which pytest would keep to itself. That the program starts at all is for
``test_cli.py``, which starts it.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import traceback
import warnings
from collections.abc import Iterator
from typing import IO

from mjmotion.cli.main import main


def run(*words: object) -> subprocess.CompletedProcess[str]:
    """Run ``mjmotion`` with these words, to the end."""
    arguments = [str(word) for word in words]
    handler = signal.getsignal(signal.SIGTERM)
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as error:
        try:
            with _into(1, out), _into(2, error):
                code = _called(arguments)
        finally:
            signal.signal(signal.SIGTERM, handler)
        texts = []
        for file in (out, error):
            file.seek(0)
            texts.append(file.read())
    return subprocess.CompletedProcess(arguments, code, *texts)


def _called(arguments: list[str]) -> int:
    """The exit code, as the interpreter would make it."""
    with (
        contextlib.redirect_stdout(os.fdopen(os.dup(1), "w")) as out,
        contextlib.redirect_stderr(os.fdopen(os.dup(2), "w", buffering=1)) as error,
        warnings.catch_warnings(),
        out,
        error,
    ):
        warnings.simplefilter("default")
        warnings.showwarning = _show
        try:
            return main(arguments)
        except SystemExit as end:
            if isinstance(end.code, str):
                print(end.code, file=sys.stderr)
            return end.code if isinstance(end.code, int) else int(end.code is not None)
        except Exception:
            traceback.print_exc()
            return 1


def _show(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: IO[str] | None = None,
    line: str | None = None,
) -> None:
    print(warnings.formatwarning(message, category, filename, lineno, line), file=sys.stderr)


@contextlib.contextmanager
def _into(number: int, file: IO[str]) -> Iterator[None]:
    """Have what is written to a file descriptor in a file."""
    kept = os.dup(number)
    os.dup2(file.fileno(), number)
    try:
        yield
    finally:
        os.dup2(kept, number)
        os.close(kept)
