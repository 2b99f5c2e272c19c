"""What is in the hand: a site, a standing foot's footprint, or a part of the scene.

    drag = take(shown, site="right_hand", frame=120)
    drag = drag.to(place)
    drag.edit(settings)                 # the edit that it comes to

Immutable: every move of the mouse makes another.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjmotion.apps.session.edits import Drag, Edit, Footprint, Pin, Settings, Vector
from mjmotion.editor.shown import Shown
from mjmotion.exceptions import SessionError

Array = NDArray[np.float64]

STILL = 1e-4  # what is moved by less was a click, and no drag [m]
STILL_TURN = 1e-3  # the same of a turn [rad]


@dataclasses.dataclass(frozen=True, eq=False)
class Dragged:
    """What is in the hand.

    Attributes:
      name: the site, the foot's side, or the part of the scene.
      kind: ``"site"``, ``"footprint"``, ``"part"``, or ``"edit"`` for the place of an edit.
      frame: at which frame.
      start: (3,) where it was [m].
      place: (3,) where it is to be [m].
      turn: how far a footprint was turned [rad].
      index: of an edit in the list, for ``"edit"``.
    """

    name: str
    kind: str
    frame: int
    start: Array
    place: Array
    turn: float = 0.0
    index: int = -1

    @property
    def move(self) -> Vector:
        """How far it was moved [m]."""
        x, y, z = self.place - self.start
        return float(x), float(y), float(z)

    @property
    def level(self) -> bool:
        """Whether the mouse moves it along the ground, and not in the plane of the picture."""
        return self.kind in ("footprint", "part")

    @property
    def moved(self) -> bool:
        """Whether it was dragged at all, and not clicked."""
        return float(np.linalg.norm(self.place - self.start)) > STILL or abs(self.turn) > STILL_TURN

    def to(self, place: ArrayLike) -> Dragged:
        """Return it at another place (3,) [m]."""
        return dataclasses.replace(self, place=np.asarray(place, dtype=np.float64))

    def turned(self, by: float) -> Dragged:
        """Return it turned [rad]; what is no footprint does not turn."""
        return dataclasses.replace(self, turn=by) if self.kind == "footprint" else self

    def edit(self, settings: Settings) -> Edit:
        """Return the edit that it comes to.

        Raises:
          SessionError: a part of the scene, which is no edit of the motion.
        """
        if self.kind == "site":
            x, y, z = (float(one) for one in self.place)
            return Drag(self.name, self.frame, (x, y, z), settings)
        if self.kind == "footprint":
            return Footprint(self.name, self.frame, self.move, self.turn, settings)
        raise SessionError(f"'{self.name}' is no site")


def standing(shown: Shown, site: str, frame: int) -> str | None:
    """Return the side of the foot that a site is on, if it stands at a frame; None else."""
    side = shown.feet.get(site)
    sites = (f"{side}_heel", f"{side}_toe")
    if side is None:
        return None
    stand = any(c.site in sites and c.start <= frame < c.end for c in shown.contacts)
    return side if stand else None


def take(shown: Shown, site: str, frame: int) -> Dragged:
    """Take a site in hand: of a foot that stands the whole footprint, else the site alone."""
    place = shown.place(site, frame)
    side = standing(shown, site, frame)
    if side is not None:
        return Dragged(side, "footprint", frame, place, place)
    return Dragged(site, "site", frame, place, place)


def take_edit(shown: Shown, index: int) -> Dragged | None:
    """Take the place of an edit in hand; None of an edit that has none."""
    edit = shown.edits[index]
    if isinstance(edit, Footprint):
        site = next((name for name, side in shown.feet.items() if side == edit.side), None)
        if site is None:
            return None
        place = shown.place(site, edit.frame)
        return Dragged(edit.side, "edit", edit.frame, place, place, index=index)
    if edit.position is None:
        return None
    place = np.asarray(edit.position)
    return Dragged(edit.site, "edit", edit.frames[0], place, place, index=index)


def moved_edit(edit: Edit, by: Vector) -> Edit:
    """Return an edit whose place is moved [m]; a pin without a place stays as it is."""
    if isinstance(edit, Footprint):
        return dataclasses.replace(edit, move=_sum(edit.move, by))
    if isinstance(edit, Pin) and edit.position is None:
        return edit
    assert edit.position is not None
    return dataclasses.replace(edit, position=_sum(edit.position, by))


def _sum(one: Vector, other: Vector) -> Vector:
    return one[0] + other[0], one[1] + other[1], one[2] + other[2]
