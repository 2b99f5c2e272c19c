"""The floor that a recording was made on, from where its feet stand.

A capture volume's floor may be a little tilted, and the floor of a suit without cameras drifts: it
sinks or rises slowly. A foot that stands on a drifting floor sinks with it, while a foot that
stands on a stair, a ramp or a box stays at its height; so the standing feet tell the one from the
other.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mjmotion.clips.recorded_feet import RecordedFoot, RecordedStance
from mjmotion.numerics.smoothing import follow

Array = NDArray[np.float64]

FLOORS = ("auto", "level", "follow")
"""A floor as the feet say; level in any case; one that goes with the standing feet in any case."""

EVEN = 0.04  # [m] stances on flat ground differ by less
_KNEE = 0.0515  # [m] height of a knee's joint that rests on the ground
_KNEELING_SHARE = 10.0  # percentile of the heights of knees that tells where they rest
_TILT = 0.04  # slope of a floor that was meant to be level
_SLOW = 0.25  # [Hz] what a floor drifts slower than
_DRIFT = 0.015  # [m] one that goes up and down by less does not drift
_FASTEST = 0.08  # [m/s] no floor drifts faster
_FELT = 0.5  # share of its drift that standing feet must go along with, or the inverse
_ALIKE, _FINE = 2.0, 0.006  # a tilted floor is taken that fits so much worse, or so well [m]
_THIN = 1e-3  # weight of what is drawn between stances beside what the stances say
_LONG = 0.1  # [s] a shorter flat stance does not tell how fast its foot sinks


@dataclasses.dataclass(frozen=True, eq=False)
class Floor:
    """The floor under a recording.

    Attributes:
      height: (nframe,) at x = y = 0 [m].
      slope: (2,) along x and y.
      uneven: whether stances are on several levels; height is then that of the lowest.
    """

    height: Array
    slope: Array
    uneven: bool

    @property
    def drift(self) -> float:
        """How far it goes up and down over the clip [m]."""
        return float(np.ptp(self.height))

    def under(self, points: Array) -> Array:
        """Return its height (nframe,) [m] under points (nframe, 3)."""
        return np.asarray(self.height + points[:, :2] @ self.slope)


def find_floor(
    feet: Sequence[RecordedFoot],
    stances: Sequence[Sequence[RecordedStance]],
    sole: float,
    fps: float,
    floor: str = "auto",
) -> Floor:
    """Return the floor under a clip, and whether it is uneven.

    A walk on a floor that was a little tilted sinks or climbs steadily; a plane takes that out.
    Where the stances do not lie on one nearly level plane, the recorded ground was uneven: the
    plane is then level, at the lowest stance. A floor that drifts is followed where standing feet
    go along with it.

    Args:
      feet: as recorded.
      stances: of each foot.
      sole: height of the ankle over the sole [m].
      fps: frames a second.
      floor: one of :data:`FLOORS`.
    """
    nframe = len(feet[0].ankle)
    told = [(foot, s) for foot, group in zip(feet, stances, strict=True) for s in group if s.level]
    if not told:
        lowest = min(float(foot.ankle[:, 2].min()) for foot in feet) - sole
        knees = [foot.knee[foot.lying, 2] - _KNEE for foot in feet if foot.knee is not None]
        lying = np.concatenate(knees) if knees else np.zeros(0)
        if len(lying):  # of one who only kneels or crawls
            lowest = float(np.percentile(lying, _KNEELING_SHARE))
        return Floor(np.full(nframe, lowest), np.zeros(2), True)
    table = np.array([(*foot.ball[s.start : s.end, :2].mean(axis=0), s.height) for foot, s in told])
    plane, uneven = _plane(table, tilts=floor == "auto")
    still = Floor(np.full(nframe, plane[0]), plane[1:], uneven)
    if floor == "level":
        return still
    curve = _followed(told, nframe, sole, fps)
    rest = np.array([s.height - float(curve[s.start : s.end].mean()) for _, s in told])
    if floor == "auto":
        # A tilted floor that does nearly as well is the simpler reason, and the likelier.
        tilted = _rms(table[:, 2] - plane[0] - table[:, :2] @ plane[1:])
        plain = tilted < max(_ALIKE * _rms(rest), _FINE)
        if plain or not _is_even(rest) or not _drifts(curve, told, fps):
            return still
    return Floor(curve, np.zeros(2), not _is_even(rest))


def _plane(table: Array, *, tilts: bool) -> tuple[Array, bool]:
    """Return the plane (height, slope along x, slope along y) under stances, and if it is uneven.

    Args:
      table: (n, 3) where each stands [m].
      tilts: whether the plane may be tilted.
    """
    height = table[:, 2]
    plane = np.array((float(np.median(height)), 0.0, 0.0))
    near = np.abs(height - plane[0]) < EVEN
    if tilts and near.sum() >= 4:
        # Slopes the stances do not show, such as across a straight walk, stay zero (ridge).
        centre = table[near, :2].mean(axis=0)
        spread = table[near, :2] - centre
        slope = np.linalg.solve(
            spread.T @ spread + 0.1 * np.eye(2), spread.T @ (height[near] - height[near].mean())
        )
        if np.linalg.norm(slope) < _TILT:
            plane = np.array((height[near].mean() - centre @ slope, *slope))
    if _is_even(height - plane[0] - table[:, :2] @ plane[1:]):
        return plane, False
    return np.array((float(height.min()), 0.0, 0.0)), True


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _is_even(rest: Array) -> bool:
    """Return whether stances this far over a floor (n,) [m] are all on it."""
    # A foot that stands still on its toes looks like a step; most stances tell the ground.
    return bool(np.mean(np.abs(rest) < EVEN / 2) >= 0.6 and np.abs(rest).max() < 2 * EVEN)


def _followed(
    told: Sequence[tuple[RecordedFoot, RecordedStance]], nframe: int, sole: float, fps: float
) -> Array:
    """Return the slow curve (nframe,) through the heights under standing feet [m]."""
    total, count = np.zeros(nframe), np.zeros(nframe)
    for foot, stance in told:
        frames = stance.flat
        if len(frames) == 0:
            frames = np.array([(stance.start + stance.end) // 2])
            np.add.at(total, frames, stance.height)
        else:
            np.add.at(total, frames, foot.ankle[frames, 2] - sole)
        np.add.at(count, frames, 1.0)
    known = np.flatnonzero(count)
    height = np.interp(np.arange(nframe), known, total[known] / count[known])
    if nframe < 4:
        return height
    time = 1.0 / (2.0 * np.sin(np.pi * min(_SLOW / fps, 0.5)))
    return follow(height[:, None], np.maximum(count, _THIN), time)[:, 0]


def _drifts(curve: Array, told: Sequence[tuple[RecordedFoot, RecordedStance]], fps: float) -> bool:
    """Return whether standing feet go along with a curve (nframe,) [m], as on a floor that drifts.

    Of all flat stances, the slopes r of the foot's height over time and those f of the curve are
    held against each other: ``b = Σ w r f / Σ w f²`` is 1 on a floor that drifts, and 0 on
    stairs, where a foot that stands stays at its height. The weights w are what a slope over so
    many frames is known to.
    """
    if len(curve) < 4 or np.ptp(curve) < _DRIFT:
        return False
    if np.abs(np.gradient(curve)).max() * fps > _FASTEST:
        return False
    along = whole = 0.0
    for foot, stance in told:
        frames = stance.flat
        if len(frames) < max(3, _LONG * fps):
            continue
        time = (frames - frames.mean()) / fps
        weight = float(time @ time)
        own, floors = time @ foot.ankle[frames, 2] / weight, time @ curve[frames] / weight
        along, whole = along + weight * own * floors, whole + weight * floors**2
    return whole > 0 and _FELT * whole < along < whole / _FELT
