"""Steps take the time that they take: a walk slows on a climb, and hurries where steps are short.

    pace = find_pace(stances, footholds, nframe, fps)
    slower = pace.apply(motion)
    stances, contacts = pace.stances(stances), pace.contacts(contacts)

A smooth rising map from the frames of the new motion to places between those of the clip. Whole
steps get longer or shorter; who stands when is carried along, in the same order.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.motion import Motion
from mjmotion.body.sampling import sample
from mjmotion.footsteps.contacts import Contact
from mjmotion.footsteps.footholds import Foothold
from mjmotion.footsteps.stances import Stance
from mjmotion.numerics.smoothing import follow

Array = NDArray[np.float64]

CLIMB = 1.0  # how much longer a step takes for each metre that it rises or falls [1/m]
SHORT = 0.25  # how much shorter one takes that goes nowhere
LEVEL = 0.1  # a step that rises more than this is not hurried for being short [m]
LONG = 0.5  # how much longer one takes for each share of its length that it is longer
LEAST, MOST = 0.8, 1.5  # how much longer a step may take
SAME = 0.01  # steps that take longer by no more than this are left as they are
PACE_TIME = 0.2  # τ of a change of pace [s]
_ROUND = 1e-9  # a place this near to a frame is that frame [frames]


@dataclasses.dataclass(frozen=True, eq=False)
class Pace:
    """Which place of a clip each frame of the new motion shows.

    Attributes:
      at: (nframe,) frames of the clip, whole or not, rising from its first to its last.
      nframe: frames of the clip.
    """

    at: Array
    nframe: int

    @classmethod
    def none(cls, nframe: int) -> Pace:
        """Return the clip's own."""
        return cls(np.arange(nframe, dtype=np.float64), nframe)

    @property
    def same(self) -> bool:
        """Whether the new motion is the clip."""
        return len(self.at) == self.nframe and bool((self.at == np.arange(self.nframe)).all())

    def apply(self, motion: Motion) -> Motion:
        """Return a motion of the clip's frames at the new pace, by cubic splines."""
        return motion if self.same else motion.replace(sample(motion, self.at))

    def span(self, start: int, end: int) -> tuple[int, int]:
        """Return the new frames that show frames ``start`` to ``end`` and nothing outside of them.

        One at least, the nearest; an empty span stays empty.
        """
        if end <= start:
            return start, end
        first = int(np.searchsorted(self.at, start - _ROUND))
        last = int(np.searchsorted(self.at, end - 1 + _ROUND, side="right"))
        if last <= first:
            first = int(np.abs(self.at - 0.5 * (start + end - 1)).argmin())
            last = first + 1
        return first, last

    def stances(self, stances: Sequence[Stance]) -> tuple[Stance, ...]:
        """Return the stances at the new pace, on the same spots."""
        return tuple(self._stance(stance) for stance in stances)

    def _stance(self, stance: Stance) -> Stance:
        """Return a stance at the new pace."""
        new = dataclasses.replace(
            stance,
            heel=self.span(*stance.heel),
            toe=self.span(*stance.toe),
            heel_off=tuple(self.span(*gap) for gap in stance.heel_off),
            toe_off=tuple(self.span(*gap) for gap in stance.toe_off),
        )
        if stance.pivot is None:
            return new
        shown = self.at[new.start : new.end] - stance.start
        turn = np.interp(shown, np.arange(len(stance.pivot.turn)), stance.pivot.turn)
        return dataclasses.replace(new, pivot=dataclasses.replace(stance.pivot, turn=turn))

    def contacts(self, contacts: Sequence[Contact]) -> tuple[Contact, ...]:
        """Return the contacts at the new pace."""
        return tuple(Contact(one.site, *self.span(one.start, one.end)) for one in contacts)


def find_pace(
    stances: Sequence[Stance], footholds: Sequence[Foothold], nframe: int, fps: float
) -> Pace:
    """Return the pace at which steps are walked that are moved.

    Args:
      stances: all stances in order of time, at their own spots.
      footholds: one a stance.
      nframe: frames of the clip.
      fps: frames a second.
    """
    times, longer = [], []
    for number in range(1, len(stances)):
        before, after = stances[number - 1], stances[number]
        if before.foot == after.foot or after.start <= before.start:
            continue
        own = float(np.hypot(*(after.source_pos - before.source_pos)[:2]))
        step = footholds[number].position - footholds[number - 1].position
        times.append(0.5 * (before.start + after.start))
        longer.append(_longer(float(np.hypot(*step[:2])), own, abs(float(step[2]))))
    if nframe < 5 or not times or np.abs(np.array(longer) - 1.0).max() <= SAME:
        return Pace.none(nframe)
    slow = np.interp(np.arange(nframe), times, longer)
    slow = follow(slow[:, None], np.ones(nframe), PACE_TIME * fps)[:, 0]
    slow = np.clip(slow, LEAST, MOST)
    passed = np.concatenate(([0.0], np.cumsum(0.5 * (slow[1:] + slow[:-1]))))
    count = round(float(passed[-1])) + 1
    at = np.interp(np.linspace(0.0, passed[-1], count), passed, np.arange(nframe))
    return Pace(at, nframe)


def _longer(step: float, own: float, rise: float) -> float:
    """Return how many times the time of its own a step takes of some length and rise [m]."""
    share = step / own if own > LEVEL else 1.0
    level = max(0.0, 1.0 - rise / LEVEL)
    shorter = SHORT * max(0.0, 1.0 - share) * level
    more = CLIMB * rise - shorter + LONG * max(0.0, share - 1.0)
    return float(np.clip(1.0 + more, LEAST, MOST))
