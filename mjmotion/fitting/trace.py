"""What a fit did: its levels with their times and errors."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Sequence


@dataclasses.dataclass(frozen=True)
class LevelTrace:
    """One level: its place (from 1), knots, time [s] and the error it left [% of height]."""

    level: int
    frames_per_knot: float
    seconds: float
    max_error_percent: float


@dataclasses.dataclass(frozen=True)
class Trace:
    """What a fit did.

    Attributes:
      levels: its levels.
      fit_seconds: its whole time [s].
      first_error_percent, exact_error_percent: the errors before and after [% of height].
      nscalar: number of scalar constraints.
      preprocessing_seconds: of the whole time, what the first guess took (§4.5) [s].
    """

    levels: tuple[LevelTrace, ...]
    fit_seconds: float
    first_error_percent: float
    exact_error_percent: float
    nscalar: int
    preprocessing_seconds: float = 0.0

    def __repr__(self) -> str:
        errors = ", ".join(f"{level.max_error_percent:.3g}" for level in self.levels)
        return f"<Trace: {1000 * self.fit_seconds:.0f} ms, errors {errors} % of height>"


class Stopwatch:
    """Notes levels as they are done; the error that one leaves is known at the next.

    Args:
      height: of the character [m].
    """

    def __init__(self, height: float) -> None:
        self._percent = 100.0 / height
        self._began = self._lap = time.perf_counter()
        self._levels: list[tuple[float, float, float]] = []
        self._guessed = 0.0

    def __len__(self) -> int:
        return len(self._levels)

    def guessed(self) -> None:
        """Note that the first guess is made."""
        now = time.perf_counter()
        self._guessed, self._lap = now - self._lap, now

    def start(self) -> None:
        """Begin to count anew for what comes next."""
        self._lap = time.perf_counter()

    def level(self, frames_per_knot: float, error: float) -> None:
        """Note a level that is done, and the error before it [m]."""
        now = time.perf_counter()
        self._levels.append((frames_per_knot, now - self._lap, error))
        self._lap = now

    def trace(self, last_error: float, left: float, nscalar: int) -> Trace:
        """Return the trace.

        Args:
          last_error: the error that the last level left [m].
          left: the error of the result [m].
          nscalar: number of scalar constraints.
        """
        errors = [error for _, _, error in self._levels]
        errors.append(last_error)
        rows = zip(self._levels, errors[1:], strict=True)
        return Trace(
            tuple(
                LevelTrace(number, frames_per_knot, seconds, self._percent * error)
                for number, ((frames_per_knot, seconds, _), error) in enumerate(rows, start=1)
            ),
            time.perf_counter() - self._began,
            self._percent * errors[0],
            self._percent * left,
            nscalar,
            self._guessed,
        )


def whole(traces: Sequence[Trace]) -> Trace:
    """Return the trace of fits one after the other: the first's levels, the last's error."""
    return dataclasses.replace(
        traces[0],
        fit_seconds=sum(trace.fit_seconds for trace in traces),
        exact_error_percent=traces[-1].exact_error_percent,
    )
