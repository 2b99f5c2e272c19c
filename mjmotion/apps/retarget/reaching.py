"""What a body does whose legs are short for the steps: heels rise further, and the hips sink.

A leg that trails behind reaches further when its foot rolls on over the toe. So that is done first,
as far as a foot goes; what is lacking then, the root sinks (§4.5), and where it has to, it sinks a
little further than it must: a knee that is all but straight turns fast for little way.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.apps.retarget.rest import RestBody, world
from mjmotion.body.feet import Foot
from mjmotion.body.kinematics import Pose, site_id
from mjmotion.body.motion import Motion
from mjmotion.body.reach import drop_to_reach
from mjmotion.footsteps.contacts import Contact, contact_mask
from mjmotion.footsteps.paths import FootPath, turned_about_toes
from mjmotion.footsteps.pelvis import DROP_TIME, LEAST_HEIGHT, REACH_FREE, REACH_MOST
from mjmotion.numerics.rotations import cross, dot, exp, multiply, normalized, rotate
from mjmotion.numerics.smoothing import cover, envelope

Array = NDArray[np.float64]

EASY = (0.93, 0.95)  # of a leg's length that steps may ask for that are long for it
SHORT = (0.05, 0.15)  # lack of reach, as a share of a leg, from which that is so, and fully so
TIP_MOST = 0.5  # how far a foot may roll on over its toe for a leg to reach [rad]
TIP_TIME = 0.06  # scale of its rise and fall [s]
TIP_RISE = 0.15  # time after which it may be as far as that [s]
OFF_SHARE = 0.5  # share of the swing after in which that may fade
_LEVER = 0.4  # a foot is tipped where that brings its ankle nearer by this share of its length


class Legs:
    """Hips and ankles of a motion, for legs of any make.

    Args:
      source: joint angles on the body, the root carried over.
      pose: its poses.
    """

    def __init__(self, source: Motion, pose: Pose) -> None:
        self.source, self._pose = source, pose
        rest = RestBody(source.character)
        self._rest = rest
        self._legs = {body: leg for leg in rest.parts.legs for body in leg.end}

    def length(self, foot: Foot) -> float:
        """Return the length of a foot's leg when straight [m]."""
        leg = self._legs[foot.body]
        return float(np.linalg.norm(np.diff(leg.points, axis=0), axis=1).sum())

    def hip(self, foot: Foot) -> Array:
        """Return the hip (nframe, 3) [m]."""
        return world(self._pose, *self._rest.joints(self._legs[foot.body])[0])

    def extent(self, foot: Foot) -> Array:
        """Return the distance from hip to ankle (nframe,) [m]."""
        ankle = world(self._pose, *self._rest.joints(self._legs[foot.body])[2])
        return np.asarray(np.linalg.norm(ankle - self.hip(foot), axis=1))

    def ankle(self, foot: Foot, path: FootPath) -> Array:
        """Return where a path has the ankle (nframe, 3) [m]."""
        model, rest = self.source.model, self._rest
        site = site_id(model, foot.site)
        turn = np.empty(9)
        mujoco.mju_quat2Mat(turn, model.site_quat[site])
        place = rest.local(foot.body, self._legs[foot.body].points[2]) - model.site_pos[site]
        local = turn.reshape(3, 3).T @ place
        return path.position + rotate(path.quat, np.broadcast_to(local, path.position.shape))

    def sinking(
        self,
        feet: Sequence[Foot],
        paths: Sequence[FootPath],
        shift: Array,
        reach: tuple[float, float] = (REACH_FREE, REACH_MOST),
    ) -> Array:
        """Return how far the root must go down for every foot to be in reach (nframe,) [m].

        Args:
          feet: the feet of the paths.
          paths: where they are to be.
          shift: (nframe, 3) how far the root is moved already [m].
          reach: shares of a leg's length: that may always be asked for, and that may be asked for
            where the motion did.
        """
        need = np.full(self.source.nframe, -np.inf)
        for foot, path in zip(feet, paths, strict=True):
            if foot.body not in self._legs:
                continue
            most = self.most(foot, reach)
            hip, least = self.hip(foot) + shift, LEAST_HEIGHT * self.length(foot)
            need = np.maximum(need, drop_to_reach(hip, self.ankle(foot, path), most, least))
        return cover(need, DROP_TIME * self.source.fps)

    def most(self, foot: Foot, reach: tuple[float, float]) -> Array:
        """Return how far an ankle may be from its hip (nframe,) [m]."""
        low, high = (share * self.length(foot) for share in reach)
        return np.clip(self.extent(foot), low, high)

    def reach(
        self, feet: Sequence[Foot], paths: Sequence[FootPath], shift: Array
    ) -> tuple[float, float]:
        """Return the shares of a leg's length that steps may ask for, often and at most.

        Those of every plan where the legs are long enough; less where they are short for the steps.

        Args:
          feet: the feet of the paths.
          paths: where they are to be.
          shift: (nframe, 3) how far the root is moved [m].
        """
        lengths = [self.length(foot) for foot in feet if foot.body in self._legs]
        lack = float(self.sinking(feet, paths, shift).max()) / min(lengths, default=np.inf)
        share = np.interp(lack, SHORT, (0.0, 1.0))
        low, high = REACH_FREE, REACH_MOST
        return float(low + share * (EASY[0] - low)), float(high + share * (EASY[1] - high))

    def roll_on(
        self,
        feet: Sequence[Foot],
        paths: Sequence[FootPath],
        shift: Array,
        contacts: Sequence[Contact],
        reach: tuple[float, float],
    ) -> tuple[FootPath, ...]:
        """Return paths whose feet roll on over the toe where the leg behind would not reach.

        Args:
          feet: the feet of the paths.
          paths: where they are to be.
          shift: (nframe, 3) how far the root is moved [m].
          contacts: who stands when: a heel that stands does not rise.
          reach: shares of a leg's length, of :meth:`reach`.
        """
        from scipy.ndimage import distance_transform_edt

        rolled, fps = [], self.source.fps
        for foot, path in zip(feet, paths, strict=True):
            if foot.body not in self._legs:
                rolled.append(path)
                continue
            ankle = self.ankle(foot, path)
            toe = path.position + rotate(path.quat, foot.toe)
            away = ankle - self.hip(foot) - shift
            across = rotate(path.quat, np.array((0.0, 1.0, 0.0)))
            arm = ankle - toe
            nearer = -dot(cross(across, arm), normalized(away))
            behind = dot(away, rotate(path.quat, np.array((1.0, 0.0, 0.0)))) < 0.0
            useful = behind & (nearer > _LEVER * np.linalg.norm(arm, axis=1))
            lack = np.linalg.norm(away, axis=1) - self.most(foot, reach)
            need = np.where(useful, lack / np.maximum(nearer, 1e-9), -np.inf)
            free = _rolling(foot, contacts, self.source)
            # A foot cannot have rolled far at once: a tip is bounded by how long it may have risen.
            apart = distance_transform_edt(free) / fps
            most = TIP_MOST * np.minimum(1.0, apart / TIP_RISE) ** 2
            tip = envelope(np.minimum(need, most), ~free, TIP_TIME * fps)
            zero = np.zeros_like(tip)
            quat = multiply(path.quat, exp(np.stack((zero, tip, zero), axis=-1)))
            rolled.append(turned_about_toes(path, foot, quat))
        return tuple(rolled)


def _rolling(foot: Foot, contacts: Sequence[Contact], motion: Motion) -> NDArray[np.bool_]:
    """Return when a foot stands on its toe alone, or has left the ground not long ago (nframe,)."""
    heel = contact_mask(contacts, f"{foot.side}_heel", motion.nframe)
    toe = contact_mask(contacts, f"{foot.side}_toe", motion.nframe)
    free = toe & ~heel
    swing = ~toe & ~heel
    starts = np.flatnonzero(swing[1:] & ~swing[:-1]) + 1
    for start in starts:
        stop = start + int(np.argmax(~swing[start:])) if (~swing[start:]).any() else len(swing)
        free[start : start + round(OFF_SHARE * (stop - start))] = True
    return free
