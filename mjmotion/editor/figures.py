"""The validation's figures of what is shown beside the source's, measured after a release."""

from __future__ import annotations

import dataclasses
import time

from mjmotion.editor.shown import Shown
from mjmotion.editor.work import Task
from mjmotion.validation import Validation, validate

REST = 0.4  # how long nothing is done before figures are measured [s]


@dataclasses.dataclass(frozen=True)
class Figure:
    """One figure.

    Attributes:
      label: what it is, in words.
      unit: its unit; "" of a ratio.
      value, source: of the motion, and of the motion that it came from; NaN where there was
        nothing to measure.
      threshold: in words; "" without.
      ok: whether it keeps it; None where it has none.
      where: frame and body of the worst.
    """

    label: str
    unit: str
    value: float
    source: float
    threshold: str
    ok: bool | None
    where: str


def beside(mine: Validation, origin: Validation) -> tuple[Figure, ...]:
    """Return the figures of a motion beside those of its source."""
    sources = {row.figure: row.value for row in origin.summary()}
    return tuple(
        Figure(
            row.label,
            row.unit,
            row.value,
            sources.get(row.figure, float("nan")),
            row.threshold,
            row.ok,
            row.where,
        )
        for row in mine.summary()
        if not row.figure.startswith("source_")  # the other column says it
    )


class Figures:
    """Measures in a thread aside, once nothing has changed for a while.

    Attributes:
      rows: the figures; empty before the first are known.
      error: why there are none; "" otherwise.
    """

    def __init__(self) -> None:
        self.rows: tuple[Figure, ...] = ()
        self.error = ""
        self._of: Shown | None = None
        self._asked: Shown | None = None
        self._since = 0.0
        self._task: Task | None = None
        self._origin: tuple[Shown, Validation] | None = None

    @property
    def fresh(self) -> bool:
        """Whether the rows are of what was asked for last."""
        return self._of is self._asked

    def ask(self, shown: Shown) -> None:
        """Want the figures of something else."""
        self._asked, self._since = shown, time.monotonic()

    def tick(self, shown: Shown, idle: bool) -> None:
        """Take what was measured; begin to measure when all has been still for a while."""
        task = self._task
        if task is not None and not task.running:
            self._task = None
            if task.value is not None:
                self._of, self.rows = task.value
                self.error = ""
            elif task.error is not None:
                self._of, self.rows, self.error = self._asked, (), str(task.error)
        waited = time.monotonic() - self._since > REST
        if self._task is None and idle and waited and not self.fresh and shown is self._asked:
            self._task = Task("figures", lambda _: (shown, self._measure(shown)))

    def _measure(self, shown: Shown) -> tuple[Figure, ...]:
        """Return the figures; in the thread aside."""
        mine = validate(shown.source, shown.motion, shown.contacts)
        known = self._origin
        if known is None or (known[0].source, known[0].contacts) != (shown.source, shown.contacts):
            known = self._origin = (shown, validate(shown.source, shown.source, shown.contacts))
        return beside(mine, known[1])

    def close(self) -> None:
        """Wait for what is being measured."""
        if self._task is not None:
            self._task.join(10.0)
