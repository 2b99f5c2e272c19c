"""The line that a walk goes along: its root's way over the ground without sway, by arc length.

line = Centreline.of(motion)
there = line.along(points, motion)      # the same walk along another line, as a Bend
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.motion import Motion
from mjmotion.numerics.smoothing import follow
from mjmotion.route.bend import Bend

Array = NDArray[np.float64]

SWAY = 0.3  # τ of the line: what is shorter than about 2π τ is sway [m]
STEP = 0.1  # spacing of a line's points [m]
_STILL = 0.08  # a root that stays nearer than this to where it was goes nowhere [m]
_EVEN = 0.05  # τ of arc length over time [s]


@dataclasses.dataclass(frozen=True, eq=False)
class Centreline:
    """Where a walk goes, without its sway.

    Attributes:
      points: (nframe, 2) at every frame [m].
      length: (nframe,) arc length up to each frame [m].
      sway: (nframe, 2) what the root is off the line [m].
      fps: frames a second.
    """

    points: Array
    length: Array
    sway: Array
    fps: float

    @classmethod
    def of(cls, motion: Motion) -> Centreline:
        """Return the line of a motion."""
        root = motion.qpos[:, :2]
        kept = [0]
        for frame in range(1, len(root)):  # each from where the one before it went
            if np.hypot(*(root[frame] - root[kept[-1]])) > _STILL:
                kept.append(frame)
        if len(kept) < 3:
            points = np.repeat(root.mean(axis=0)[None], len(root), axis=0)
            return cls(points, np.zeros(len(root)), root - points, motion.fps)
        steps = np.linalg.norm(np.diff(root[kept], axis=0), axis=1)
        rough = np.concatenate(([0.0], np.cumsum(steps)))
        even = np.arange(0.0, rough[-1] + _STILL, _STILL / 2.0)
        line = follow(
            at_lengths(root[kept], rough, even), np.ones(len(even)), SWAY / (_STILL / 2.0)
        )
        steps = np.linalg.norm(np.diff(line, axis=0), axis=1)
        along = np.concatenate(([0.0], np.cumsum(steps)))
        lengths = np.interp(np.interp(np.arange(len(root)), kept, rough), even, along)
        lengths = follow(lengths[:, None], np.ones(len(root)), _EVEN * motion.fps)[:, 0]
        lengths = np.maximum.accumulate(np.clip(lengths, 0.0, None))
        points = at_lengths(line, along, lengths)
        return cls(points, lengths - lengths[0], root - points, motion.fps)

    @property
    def whole(self) -> float:
        """Its length [m]."""
        return float(self.length[-1])

    def spaced(self, step: float = STEP, further: float = 0.0) -> Array:
        """Return points (n, 2) a step apart along the line [m], the last at its end or just past.

        A walk that stays where it is has one.

        Args:
          step: apart [m].
          further: how far they go on beyond the end [m].
        """
        count = int(np.ceil((self.whole + further) / step - 1e-9)) + 1
        return at_lengths(self.points, self.length, step * np.arange(count, dtype=np.float64))

    def bend(self, points: Array) -> Bend:
        """Return the bend that takes the walk along other points, every frame as far along.

        ``p' = c'(s) + R(θ' − θ) (p − c(s))``, with s the frame's arc length, and θ and θ' the
        headings of the old line and of the new one there.

        Args:
          points: (n, 2) of the new line, from where the walk begins [m]; it goes straight on where
            they end.
        """
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        length = np.concatenate(([0.0], np.cumsum(steps)))
        places = at_lengths(points, length, self.length)
        new, old = (
            headings(line, lengths, self.length)
            for line, lengths in ((points, length), (self.points, self.length))
        )
        turn = np.unwrap(new - old)
        turn -= 2.0 * np.pi * np.round(turn[0] / (2.0 * np.pi))
        cosine, sine = np.cos(turn), np.sin(turn)
        x, y = self.sway.T
        swayed = np.column_stack((cosine * x - sine * y, sine * x + cosine * y))
        return Bend(places + swayed - self.points - self.sway, turn)


def at_lengths(points: Array, length: Array, wanted: NDArray[np.floating]) -> Array:
    """Return points (m, 2) at arc lengths (m,) of a line (n, 2), straight on past its end."""
    inside = np.column_stack([np.interp(wanted, length, column) for column in points.T])
    over = np.maximum(wanted - length[-1], 0.0)
    return np.asarray(inside + over[:, None] * direction_at_end(points))


def direction_at_end(points: Array) -> Array:
    """Return the way (2,) in which a line ends; +x where it is one place."""
    back = points[-1] - points
    far = np.flatnonzero(np.hypot(back[:, 0], back[:, 1]) > STEP)
    way = back[far[-1]] if len(far) else np.zeros(2)
    size = float(np.hypot(*way))
    return way / size if size > 0.0 else np.array((1.0, 0.0))


def headings(points: Array, length: Array, wanted: Array) -> Array:
    """Return headings (m,) of a line at arc lengths (m,), over :data:`STEP` either way [rad]."""
    ahead = at_lengths(points, length, wanted + STEP)
    behind = at_lengths(points, length, np.clip(wanted - STEP, 0.0, length[-1]))
    way = ahead - behind
    return np.unwrap(np.arctan2(way[:, 1], way[:, 0]))
