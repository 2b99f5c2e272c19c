"""The sheet that figures are noted on while they are measured."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mjmotion.validation.result import LABELS, Worst


class Sheet:
    """Figures by name, NaN until they are noted; where each is worst; arrays of all frames."""

    def __init__(self) -> None:
        self.metrics = dict.fromkeys(LABELS, np.nan)
        self.worst: dict[str, Worst] = {}
        self.per_frame: dict[str, NDArray[Any]] = {}

    def note(self, name: str, value: float, frame: int | None, where: str) -> None:
        """Keep a figure, and where it is worst."""
        self.metrics[name] = value
        self.worst[name] = Worst(frame, where)
