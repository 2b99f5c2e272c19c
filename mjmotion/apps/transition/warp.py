"""Time warping over an overlap: both clips' heel strikes and toe-offs fall together.

    warp = find_warp(first, second, contacts, overlap)
    warp.first, warp.second        # which place of each clip belongs to each frame of the overlap
    warp.share                     # how much of the second is in it

A smooth, rising curve maps the first clip's time on the second's: it begins and ends where the
overlap does, and in between goes near the pairs of like events. The tempo goes over from the first
clip's own to the second's own, so both are left and joined at the speed they have there.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mjmotion.apps.transition.overlap import Overlap, cadence_ratio, strikes
from mjmotion.body.motion import Motion
from mjmotion.exceptions import ClipError
from mjmotion.footsteps.contacts import Contact

Array = NDArray[np.float64]

_GRID = 96  # intervals of the curve
_NEAR = 0.35  # events of the two clips further apart than this share of the overlap are no pair
_STIFF = 3e-4  # weight of the curve's bends against the events, both in shares of the overlap
_PULL = 0.02  # weight of the straight line, which keeps the curve where no event is near
_LEAST = 0.35  # the curve's slope is never less than this share of the cadence's
_GIVE = 0.3  # share of its length that an overlap may be off what the clips' tempo makes it
_FINE = 20  # steps a frame, of the integral of the tempo


@dataclasses.dataclass(frozen=True, eq=False)
class Warp:
    """How two clips run together over an overlap.

    Attributes:
      first: (length + 1,) place in the first clip of every frame of the overlap, its first and its
        last whole.
      second: (length + 1,) place in the second clip, likewise.
      share: (length + 1,) of the second clip in the blend, from 0 to 1: cubic Hermite ease.
    """

    first: Array
    second: Array
    share: Array

    @property
    def length(self) -> int:
        """Frames from the last that is all the first clip's to the first all the second's."""
        return len(self.first) - 1

    def from_first(self, places: Array) -> Array:
        """Return when in the result places (n,) of the first clip come; after it, at its tempo."""
        return _extended(places, self.first, float(self.first[0]))

    def from_second(self, places: Array) -> Array:
        """Return when in the result places (n,) of the second clip come; before it, likewise."""
        return _extended(places, self.second, float(self.first[0]))

    def share_at(self, frames: Array) -> Array:
        """Return the second clip's share (n,) at frames of the result."""
        return hermite((frames - self.first[0]) / self.length)


def hermite(x: Array) -> Array:
    """Return the cubic Hermite step from 0 at x <= 0 to 1 at x >= 1, flat at both ends."""
    x = np.clip(x, 0.0, 1.0)
    return np.asarray(x * x * (3.0 - 2.0 * x))


def _extended(places: Array, curve: Array, begin: float) -> Array:
    """Return the frames at which a rising curve has values ``places``, with straight ends."""
    frames = begin + np.arange(len(curve))
    inside = np.interp(places, curve, frames)
    before = np.minimum(places - curve[0], 0.0)
    after = np.maximum(places - curve[-1], 0.0)
    return np.asarray(inside + before + after)


def find_warp(
    first: Motion,
    second: Motion,
    contacts: tuple[Sequence[Contact], Sequence[Contact]],
    overlap: Overlap,
    *,
    align: bool = True,
) -> Warp:
    """Return how two clips run together.

    Args:
      first: the clip that is left.
      second: the clip that is gone into, of the same model and rate.
      contacts: of the first, and of the second.
      overlap: where.
      align: whether events may move the place where the second clip begins, by a few frames; where
        that is the user's it may not.

    Raises:
      ClipError: an overlap that is not within the clips.
    """
    _check(first, second, overlap)
    begin, length = overlap.first, overlap.length
    ratio = cadence_ratio(first, second, contacts)
    span = 2.0 * length / (1.0 + ratio)  # of the first clip, about
    events = _pairs(first, second, contacts, overlap, ratio, span)
    other = float(overlap.second)
    if align and len(events):
        # The line through the events, at the clips' cadence.
        other += float(np.mean(events[:, 1] - other - ratio * (events[:, 0] - begin)))
        other = min(max(other, 0.0), second.nframe - 2.0)
    ends = (
        min(begin + max(2, round(span)), first.nframe - 1),
        min(round(other) + max(2, round(span * ratio)), second.nframe - 1),
    )
    curve = _curve(events, (begin, ends[0]), (round(other), ends[1]))
    return _run(curve, begin, ends[0], length)


def _check(first: Motion, second: Motion, overlap: Overlap) -> None:
    for name, clip, at in (("first", first, overlap.first), ("second", second, overlap.second)):
        if not 0 <= at < clip.nframe - 2:
            raise ClipError(
                f"the overlap begins at frame {at} of the {name} clip, which has frames 0 to"
                f" {clip.nframe - 1}: begin within them, and leave room for it"
            )
    if overlap.length < 2:
        raise ClipError(f"an overlap of {overlap.length} frames is none: give 2 at least")


def _pairs(
    first: Motion,
    second: Motion,
    contacts: tuple[Sequence[Contact], Sequence[Contact]],
    overlap: Overlap,
    ratio: float,
    span: float,
) -> Array:
    """Return places of like events in the first clip and the second (n, 2), both rising."""
    low, high = overlap.first - _NEAR * span, overlap.first + (1.0 + _NEAR) * span
    pairs: list[tuple[float, float]] = []
    for foot in first.character.feet:
        kinds = (
            strikes(foot, given, clip)
            for clip, given in ((first, contacts[0]), (second, contacts[1]))
        )
        for mine, others in zip(*kinds, strict=True):
            if len(others) == 0:
                continue
            for event in mine[(mine >= low) & (mine <= high)]:
                expected = overlap.second + ratio * (event - overlap.first)
                nearest = others[np.argmin(np.abs(others - expected))]
                if abs(nearest - expected) <= _NEAR * span * ratio:
                    pairs.append((event - 0.5, nearest - 0.5))
    rising: list[tuple[float, float]] = []
    for pair in sorted(pairs):
        # An event that would turn time back is left to the fit: its contact is carried over anyhow.
        if not rising or pair[1] > rising[-1][1]:
            rising.append(pair)
    return np.array(rising).reshape(-1, 2)


def _curve(events: Array, first: tuple[int, int], second: tuple[int, int]) -> tuple[Array, Array]:
    """Return the second clip's place over the first's: places (g,) and values (g,), rising.

    The straight line between the ends, bent smoothly to where the events are.
    """
    share = np.linspace(0.0, 1.0, _GRID + 1)
    line = second[0] + share * (second[1] - second[0])
    places = first[0] + share * (first[1] - first[0])
    at = (events[:, 0] - first[0]) / (first[1] - first[0])
    inside = (at > 0.0) & (at < 1.0)
    if not inside.any():
        return places, line
    at = at[inside] * _GRID
    wanted = events[inside, 1] - np.interp(at, np.arange(_GRID + 1), line)
    matrix = np.zeros((len(at), _GRID + 1))
    index = np.minimum(at.astype(int), _GRID - 1)
    matrix[np.arange(len(at)), index] = 1.0 - (at - index)
    matrix[np.arange(len(at)), index + 1] = at - index
    bends = np.diff(np.eye(_GRID + 1), n=2, axis=0) * _GRID**2
    normal = matrix.T @ matrix + (_STIFF * bends.T @ bends + _PULL * np.eye(_GRID + 1)) / (
        _GRID + 1
    )
    free = slice(1, _GRID)  # it keeps its ends
    bend = np.zeros(_GRID + 1)
    bend[free] = np.linalg.solve(normal[free, free], (matrix.T @ wanted)[free])
    # Time never goes back, nor nearly stands: less bend where it would.
    rise, step = np.diff(line), np.diff(bend)
    room = (1.0 - _LEAST) * rise
    most = np.where(step < 0.0, room / np.maximum(-step, 1e-12), np.inf).min()
    return places, line + min(1.0, float(most)) * bend


def _run(curve: tuple[Array, Array], begin: int, end: int, length: int) -> Warp:
    """Return the places of every frame: a frame takes as long as the blended tempo says.

    With s the second clip's share and W the curve, dt = (1 − s + s W') dx: at the begin a frame of
    the first clip, at the end a frame of the second.
    """
    from scipy.interpolate import CubicSpline

    spline = CubicSpline(*curve)
    fine = np.linspace(begin, end, (end - begin) * _FINE + 1)
    x = (fine - begin) / (end - begin)
    rate = 1.0 + hermite(x) * (spline(fine, 1) - 1.0)
    time = np.concatenate(([0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(fine))))
    if abs(length - time[-1]) > _GIVE * length:
        raise ClipError(
            f"an overlap of {length} frames from frame {begin} does not fit: what is left of the"
            f" clips makes {time[-1]:.0f}; begin earlier, or make it shorter"
        )
    # It lasts a whole number of frames: what is missing is added in its middle.
    time = time + (length - time[-1]) * x**3 * (10.0 - 15.0 * x + 6.0 * x * x)
    first = np.interp(np.arange(length + 1.0), time, fine)
    first[0], first[-1] = begin, end
    second = np.asarray(spline(first))
    share = hermite(np.arange(length + 1.0) / length)
    return Warp(first, second, share)
