"""MuJoCo without its own warnings: they would go to stderr and into a log file."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Iterator

import mujoco


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Keep MuJoCo's own warnings off stderr and out of its log file."""
    previous = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda message: None)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # it gives some of them to Python
            yield
    finally:
        mujoco.set_mju_user_warning(previous)
