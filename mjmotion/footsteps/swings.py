"""How a swing foot gets over the ground: lifted in time, and held back where it cannot be.

A foot between two stances keeps the clearance of its source, up to a bound, over whatever ground it
now passes. It rises no faster than a leg could, so before a riser it waits in the plane first.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mjmotion.footsteps.footholds import Foothold
from mjmotion.footsteps.stances import Stance
from mjmotion.numerics.rotations import rotate
from mjmotion.numerics.smoothing import envelope
from mjmotion.scene.ground import Ground

Array = NDArray[np.float64]

FADE_FRAMES = 1.5  # the same at least, so that a few frames share what one would show [frames]
DIP = 0.001  # how far a foot that rolls on one contact may dig in with its side [m]
STUCK = 0.0015  # how far in a step a lifted foot may be before it is held back [m]
BEHIND = 0.06  # how far behind its last stand a foot may be held back, or before its next [m]
HOLDS = 3  # times that it is looked whether a foot must be held back
LIFT_PULL = 30.0  # acceleration with which a foot can be lifted off, or set down [m/s²]
LIFT_TIME = 0.05  # scale of a lift's rise and fall [s]
SHORT_LIFT = 0.015  # the most that a foot is lifted in a hurry, where it scrapes [m]
SHORT_LIFT_TIME = 0.03  # scale of that [s]
SCRAPE = 0.001  # how far a foot may scrape before it is [m]
CLEARANCE = 0.022  # most clearance that a swing is given on its own account [m]
CLEARANCE_MORE = 0.0015  # clearance that a swing gets over its source's, up to that [m]
CLEARANCE_TIME = 0.1  # time from a stance in which a swing comes to its clearance [s]
PULL_BACK = 0.7  # share of a swing in which a foot may be held back from a step, at either end


def wanted_clearance(
    sole: Array,
    source_pos: Array,
    source_quat: Array,
    mine: Sequence[tuple[Stance, Foothold]],
    nframe: int,
) -> Array:
    """Clearance that a swing should have at each frame (nframe,) [m]: the source's, up to a bound.

    The source stands on level ground, at the heights that its own stances show.

    Args:
      sole: (nframe, k, 3) points of the foot's sole, in the frame of its posed site [m].
      source_pos: (nframe, 3) that site in the source [m].
      source_quat: (nframe, 4) how it is turned there.
      mine: the foot's stances and footholds.
      nframe: of the source.
    """
    frames = [0.5 * (stance.start + stance.end) for stance, _ in mine]
    level = np.interp(np.arange(nframe), frames, [stance.source_pos[2] for stance, _ in mine])
    placed = source_pos[:, None] + rotate(source_quat[:, None], sole)
    over = placed[..., 2].min(axis=1) - level
    return np.where(over > 0.0, np.minimum(over + CLEARANCE_MORE, CLEARANCE), 0.0)


class StepOver:
    """Takes a foot over the ground between its stances: lifted, and held back before steps.

    Args:
      shape: (nframe, k, 3) points of its underside, in the frame of its posed site [m].
      quat: (nframe, 4) how it is turned.
      wanted: (nframe,) clearance that it should have [m].
      stance: (nframe,) when it stands.
      ground: the scene's surfaces.
      fps: frames a second.
    """

    def __init__(
        self,
        shape: Array,
        quat: Array,
        wanted: Array,
        stance: NDArray[np.bool_],
        ground: Ground,
        fps: float,
    ) -> None:
        self._shape = rotate(quat[:, None], shape)
        self._stance, self._ground, self._fps = stance, ground, fps
        self._swing = np.flatnonzero(~stance)
        # A foot cannot be up at once: a lift is bounded by what it could rise since its stance.
        apart = frames_to(stance) / fps
        # Close to a stance it is enough to be over the ground; what is wanted comes in time.
        s = np.clip(apart / CLEARANCE_TIME, 0.0, 1.0)
        self._wanted = wanted * s * s * (3.0 - 2.0 * s)
        self._most = np.where(np.isfinite(apart), 0.5 * LIFT_PULL * apart**2, 10.0)

    def __call__(
        self, position: Array, mine: Sequence[tuple[Stance, Foothold]]
    ) -> tuple[Array, Array]:
        """Return positions (nframe, 3) that clear the ground, and the lifts (nframe,) [m]."""
        lacking = self._lacking(position, self._swing)
        lift = self._lift(lacking)
        for _ in range(HOLDS):
            inside = lacking - self._wanted - lift
            stuck = self._swing[inside[self._swing] > STUCK]
            if len(stuck) == 0:
                break
            # A foot that is held back lacks less, so it is lifted less: look once more.
            position = self._held_back(position, lift, stuck, mine)
            lacking = self._lacking(position, self._swing)
            lift = self._lift(lacking)
        lift = lift + self._short_lift(lacking, lift)
        lifted = position.copy()
        lifted[:, 2] += lift
        return lifted, lift

    def _lacking(self, position: Array, frames: NDArray[np.int64]) -> Array:
        """How much higher the foot would have to be (nframe,) [m]; -inf elsewhere."""
        points = position[frames, None] + self._shape[frames]
        height, _ = self._ground.under(points)
        over = np.where(np.isnan(height), np.inf, points[..., 2] - height).min(axis=1)
        lacking = np.full(len(position), -np.inf)
        lacking[frames] = self._wanted[frames] - over
        return lacking

    def _lift(self, lacking: Array) -> Array:
        return envelope(np.minimum(lacking, self._most), self._stance, LIFT_TIME * self._fps)

    def _short_lift(self, lacking: Array, lift: Array) -> Array:
        """Lift quickly and little where the foot still scrapes next to a contact (nframe,) [m]."""
        scrape = lacking - self._wanted - lift
        if scrape.max() < SCRAPE:
            return np.zeros(len(lift))
        time = max(SHORT_LIFT_TIME * self._fps, FADE_FRAMES)
        return envelope(np.minimum(scrape, SHORT_LIFT), self._stance, time)

    def _held_back(
        self,
        position: Array,
        lift: Array,
        stuck: NDArray[np.int64],
        mine: Sequence[tuple[Stance, Foothold]],
    ) -> Array:
        """Hold the foot back in the plane where it cannot be lifted in time, as before a riser."""
        back, nframe = position.copy(), len(position)
        margin = max(1, round(0.1 * self._fps))
        for number, (stance, _) in enumerate(mine):
            before = mine[number - 1][0].end if number > 0 else 0
            after = mine[number + 1][0].start if number + 1 < len(mine) else nframe
            # Off this stance, and on to it: the swing, and the part of it that may be held; all of
            # it where the clip shows no stance before or after.
            first, last = number == 0, number + 1 == len(mine)
            reach_off = nframe if last else stance.end + round(PULL_BACK * (after - stance.end))
            reach_on = 0 if first else stance.start - round(PULL_BACK * (stance.start - before))
            for anchor, begin, stop, low, high, whole in (
                (stance.end - 1, stance.end, after, stance.end - margin, reach_off, last),
                (stance.start, before, stance.start, reach_on, stance.start + margin, first),
            ):
                middle = 0.5 * (begin + stop)
                mine_too = (stuck <= middle) if anchor < begin else (stuck >= middle)
                mine_too |= whole
                frames = stuck[(stuck >= begin) & (stuck < stop) & mine_too]
                need = self._share_held(position, lift, frames, anchor)
                if np.isfinite(need).any():
                    closed = np.ones(nframe, dtype=bool)
                    closed[max(0, low) : high] = False
                    curve = np.minimum(envelope(need, closed, LIFT_TIME * self._fps), 2.0)
                    part = slice(begin, stop)
                    back[part, :2] += _backwards(position[part], position[anchor], curve[part])
        return back

    def _share_held(
        self, position: Array, lift: Array, frames: NDArray[np.int64], anchor: int
    ) -> Array:
        """Least share (nframe,) of the way back to ``anchor`` that clears ``frames``; -inf else."""
        need = np.full(len(position), -np.inf)
        for share in (2.0, 1.5, 1.0, 0.75, 0.5, 0.25) if len(frames) else ():
            trial = position.copy()
            shares = np.full(len(frames), share)
            trial[frames, :2] += _backwards(position[frames], position[anchor], shares)
            inside = self._lacking(trial, frames)[frames] - self._wanted[frames] - lift[frames]
            need[frames[inside <= DIP]] = share
        return need


def _backwards(position: Array, anchor: Array, share: Array) -> Array:
    """Return the way back (n, 2) [m] to an anchor, for shares (n,) of it; above 1 behind it."""
    way = (anchor - position)[:, :2]
    length = np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9)
    beyond = BEHIND * np.maximum(share - 1.0, 0.0)[:, None] * way / length
    # Next to the anchor itself there is no way that it could be behind.
    return np.asarray(
        np.minimum(share, 1.0)[:, None] * way + beyond * np.minimum(length / BEHIND, 1.0)
    )


def frames_to(mask: NDArray[np.bool_]) -> Array:
    """Distance of each frame to the nearest one in the mask; inf when there is none."""
    index = np.arange(len(mask))
    before = np.maximum.accumulate(np.where(mask, index, -np.inf))
    after = np.minimum.accumulate(np.where(mask, index, np.inf)[::-1])[::-1]
    return np.minimum(index - before, after - index)
