"""What a foot's contacts hold while it stands, and how far it may roll on its toe."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.feet import Foot
from mjmotion.footsteps.footholds import Foothold
from mjmotion.footsteps.soles import STEP
from mjmotion.footsteps.stances import Stance
from mjmotion.footsteps.swings import STUCK
from mjmotion.footsteps.toes import ball_over_tip, pitch_between
from mjmotion.numerics.rotations import exp, multiply, normalized, rotate
from mjmotion.numerics.smoothing import envelope
from mjmotion.scene.ground import Ground

Array = NDArray[np.float64]

BEFORE_RISER = 0.008  # how far before a riser a foot that rolls on its toe keeps [m]
BACK_RUNG = 0.06  # steps in which it is tried how much less a foot must roll [rad]
MOST_BACK = 0.48  # the most by which a foot rolls less, for the sake of a riser [rad]


class Holds:
    """What a foot's contacts hold at each frame."""

    def __init__(self, foot: Foot, mine: Sequence[tuple[Stance, Foothold]], nframe: int) -> None:
        self.foot = foot
        self.heel = np.zeros(nframe, dtype=bool)
        self.toe = np.zeros(nframe, dtype=bool)
        self.position = np.zeros((nframe, 3))
        self.quat = np.tile((1.0, 0.0, 0.0, 0.0), (nframe, 1))
        self.toes = np.zeros(nframe)
        for stance, foothold in mine:
            span = slice(stance.start, stance.end)
            self.position[span], self.quat[span] = foothold.position, foothold.quat
            self.toes[span] = foothold.toes
            self.heel[slice(*stance.heel)] = True
            self.toe[slice(*stance.toe)] = True
            for mask, gaps in ((self.heel, stance.heel_off), (self.toe, stance.toe_off)):
                for gap in gaps:
                    mask[slice(*gap)] = False
            if (pivot := stance.pivot) is not None:
                count = stance.end - stance.start
                position, quat = pivot.posed(foot, foothold.position, foothold.quat)
                self.position[span], self.quat[span] = position[:count], quat[:count]
        self.any = self.heel | self.toe
        self.flat = self.heel & self.toe

    def site_position(self, quat: Array) -> Array:
        """Where the posed site is when the contact that holds stays and the foot is turned.

        Where toes cannot bend as far as a foot is rolled over its ball, it goes on over their tip.
        """
        local = np.where(self.heel[:, None], self.foot.heel, self.foot.toe)
        raised = np.where(
            self.heel[:, None], 0.0, ball_over_tip(self.foot, self.bend(quat), self.toes)
        )
        point = self.position + rotate(self.quat, local + raised)
        return np.where(self.flat[:, None], self.position, point - rotate(quat, local))

    def bend(self, quat: Array) -> Array:
        """Return how far toes on the ground are bent up (nframe,) [rad], however far they can."""
        return pitch_between(self.quat, quat) + self.toes

    def arms(self) -> Array:
        """Return where the sole is from the contact that holds (nframe, k, 3) [m], in the foot.

        Toes ahead of a ball that holds lie on the ground however the foot turns about it.
        """
        foot, local = self.foot, np.where(self.heel[:, None], self.foot.heel, self.foot.toe)
        lying = foot.bends[: len(foot.sole)] & ~self.heel[:, None]
        return np.where(lying[..., None], 0.0, foot.sole - local[:, None])


def rolled_less(holds: Holds, quat: Array, ground: Ground, time: float) -> Array:
    """Tip a foot on its toe back down where it would roll into a riser before it.

    Where no less of a roll would do, it rolls as it would.

    Args:
      holds: what its contacts hold.
      quat: (nframe, 4) how it would be turned.
      ground: the scene's surfaces.
      time: over how long a roll is less to either side [frames].
    """
    frames = np.flatnonzero(holds.toe & ~holds.heel)
    back, less = np.zeros(len(quat)), np.zeros(len(frames))
    inside = _in_riser(holds, quat, ground, frames)
    if not inside.any():
        return quat
    left = np.flatnonzero(inside)
    for rung in np.arange(1, round(MOST_BACK / BACK_RUNG) + 1) * BACK_RUNG:
        tried = multiply(quat, exp(np.array((0.0, -rung, 0.0))))
        clear = ~_in_riser(holds, tried, ground, frames[left])
        less[left[clear]] = rung
        left = left[~clear]
        if len(left) == 0:
            break
    back[frames] = less
    tip = envelope(back, holds.flat | holds.heel, time)
    zero = np.zeros_like(tip)
    return multiply(quat, exp(np.stack((zero, -tip, zero), axis=-1)))


def _in_riser(
    holds: Holds, quat: Array, ground: Ground, frames: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Whether a foot that turns about its toe is in ground that rises over its foothold's (n,)."""
    foot, bend = holds.foot, holds.bend(quat)[frames]
    shape = foot.shape_at(bend if foot.toes is None else foot.toes.settled(bend))
    position = holds.site_position(quat)[frames]
    ahead = normalized(rotate(quat[frames], foot.toe - foot.heel) * (1.0, 1.0, 0.0))
    points = position[:, None] + rotate(quat[frames, None], shape)
    points = points + BEFORE_RISER * ahead[:, None]
    height, _ = ground.under(points)
    top = np.where(np.isnan(height), -np.inf, height)
    over = points - holds.position[frames, None]
    over[..., 2] = top - holds.position[frames, None, 2]
    normal = rotate(holds.quat[frames], np.array((0.0, 0.0, 1.0)))
    rises = (over * normal[:, None]).sum(axis=2) > STEP
    return np.asarray((rises & (top - points[..., 2] > STUCK)).any(axis=1))
