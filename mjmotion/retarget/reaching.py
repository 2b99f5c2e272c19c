"""What a body does whose legs are short for the steps: heels rise further, and the hips sink.

A leg that trails behind reaches further when its foot rolls on over the toe. So that is done first,
as far as a foot goes; what is lacking then, the root sinks (§4.5), and where it has to, it sinks a
little further than it must: a knee that is all but straight turns fast for little way.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mjmotion.contacts import Contact, contact_mask
from mjmotion.footholds import Foot
from mjmotion.footpaths import FootPath
from mjmotion.ik.limb import find_limbs, limbs_of
from mjmotion.kinematics import Pose, site_id
from mjmotion.motion import Motion
from mjmotion.planning import REACH_FREE, REACH_MOST, drop
from mjmotion.rotations import cross, dot, exp, multiply, normalized, rotate
from mjmotion.smoothing import envelope

Array = NDArray[np.float64]

EASY = (0.93, 0.95)  # of a leg's length that steps may ask for that are long for it
SHORT = (0.05, 0.15)  # lack of reach, as a share of a leg, from which that is so, and fully so
TIP_MOST = 0.5  # how far a foot may roll on over its toe for a leg to reach [rad]
TIP_TIME = 0.06  # scale of its rise and fall [s]
TIP_RISE = 0.15  # time after which it may be as far as that [s]
OFF_SHARE = 0.5  # share of the swing after in which that may fade
_LEVER = 0.4  # a foot is tipped where that brings its ankle nearer by this share of its length


def reach_of(
    source: Motion, pose: Pose, paths: Sequence[FootPath], shift: Array
) -> tuple[float, float]:
    """Return the shares of a leg's length that steps may ask for, often and at most.

    Those of every plan where the legs are long enough; less where they are short for the steps.

    Args:
      source: joint angles copied, the root carried over.
      pose: its poses.
      paths: where the feet are to be.
      shift: (nframe, 3) how far the root is moved [m].
    """
    lack = float(drop(source, pose, paths, shift).max())
    share = np.interp(lack / _leg_length(source), SHORT, (0.0, 1.0))
    low, high = REACH_FREE, REACH_MOST
    return float(low + share * (EASY[0] - low)), float(high + share * (EASY[1] - high))


def roll_on(
    source: Motion,
    pose: Pose,
    feet: Sequence[Foot],
    paths: Sequence[FootPath],
    shift: Array,
    contacts: Sequence[Contact],
    reach: tuple[float, float],
) -> tuple[FootPath, ...]:
    """Return paths whose feet roll on over the toe where the leg behind would not reach.

    Args:
      source: joint angles copied, the root carried over.
      pose: its poses.
      feet: the feet of the paths.
      paths: where they are to be.
      shift: (nframe, 3) how far the root is moved [m].
      contacts: who stands when: a heel that stands does not rise.
      reach: shares of a leg's length, of :func:`reach_of`.
    """
    from scipy.ndimage import distance_transform_edt

    limbs = {limb.end: limb for limb in find_limbs(source.model)}
    rolled = []
    for foot, path in zip(feet, paths, strict=True):
        limb = limbs.get(foot.body)
        if limb is None:
            rolled.append(path)
            continue
        model = source.model
        hip = pose.xanchor[:, model.body_jntadr[limb.upper]] + shift
        joint = model.body_jntadr[limb.end]
        local = model.jnt_pos[joint] - model.site_pos[site_id(model, foot.site)]
        ankle = path.position + rotate(path.quat, np.broadcast_to(local, path.position.shape))
        toe = path.position + rotate(path.quat, foot.toe)
        away = ankle - hip
        far = np.linalg.norm(away, axis=1)
        across = rotate(path.quat, np.array((0.0, 1.0, 0.0)))
        arm = ankle - toe
        nearer = -dot(cross(across, arm), normalized(away))
        behind = dot(away, rotate(path.quat, np.array((1.0, 0.0, 0.0)))) < 0.0
        useful = behind & (nearer > _LEVER * np.linalg.norm(arm, axis=1))
        long = float(limbs_of(model, (limb,)).reach[0])
        was = np.linalg.norm(pose.xanchor[:, joint] - hip + shift, axis=1)
        lack = far - np.clip(was, reach[0] * long, reach[1] * long)
        need = np.where(useful, lack / np.maximum(nearer, 1e-9), -np.inf)
        free = _rolling(foot, contacts, source)
        # A foot cannot have rolled far at once: a tip is bounded by how long it may have risen.
        apart = distance_transform_edt(free) / source.fps
        most = TIP_MOST * np.minimum(1.0, apart / TIP_RISE) ** 2
        tip = envelope(np.minimum(need, most), ~free, TIP_TIME * source.fps)
        zero = np.zeros_like(tip)
        quat = multiply(path.quat, exp(np.stack((zero, tip, zero), axis=-1)))
        rolled.append(dataclasses.replace(path, quat=quat, position=toe - rotate(quat, foot.toe)))
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


def _leg_length(motion: Motion) -> float:
    """Return the reach of the shortest limb that is a leg [m]; infinite where there is none."""
    from mjmotion.character import find_parts

    ends = {body for leg in find_parts(motion.model).legs for body in leg.end}
    legs = [limb for limb in find_limbs(motion.model) if limb.end in ends]
    return float(limbs_of(motion.model, tuple(legs)).reach.min()) if legs else np.inf
