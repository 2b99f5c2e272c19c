"""What a session asks of its clip, and what undo and redo go back and forth between."""

from __future__ import annotations

import dataclasses
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from mjmotion.apps.session.edits import Edit, Settings
from mjmotion.body.motion import Motion
from mjmotion.constraints import SiteConstraint
from mjmotion.fitting import Trace
from mjmotion.footsteps.contacts import Contact

Array = NDArray[np.float64]
Moves: TypeAlias = tuple[tuple[str, tuple[float, float, float]], ...]


@dataclasses.dataclass(frozen=True)
class State:
    """What a session asks of its clip.

    Attributes:
      edits: in their order.
      contacts: who stands when in the clip; None for those that are found in it.
      scene_moves: how far parts of the scene were moved, by name [m].
      settings: of the next edit.
    """

    edits: tuple[Edit, ...] = ()
    contacts: tuple[Contact, ...] | None = None
    scene_moves: Moves = ()
    settings: Settings = dataclasses.field(default_factory=Settings)


@dataclasses.dataclass(frozen=True, eq=False)
class Side:
    """One side of a change: the state, what goes with it, and the rows of the motion that differ.

    ``motions`` are source and motion as a whole where the model is another one.
    """

    state: State
    contacts: tuple[Contact, ...]
    pinned: tuple[SiteConstraint, ...]
    trace: Trace | None
    frames: NDArray[np.int64]
    rows: Array
    motions: tuple[Motion, Motion] | None


@dataclasses.dataclass(frozen=True, eq=False)
class Change:
    """What undo and redo go back and forth between, from ``first`` up to ``end``."""

    first: int
    end: int
    before: Side
    after: Side
