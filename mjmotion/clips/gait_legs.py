"""The legs of the built-in gaits: how high the pelvis can be over the feet, and knees that fit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.character import Character
from mjmotion.body.limbs import Limb, Limbs
from mjmotion.body.reach import drop_to_reach
from mjmotion.exceptions import ModelError
from mjmotion.numerics.cubic import CubicSpline
from mjmotion.numerics.rotations import conjugate, exp, multiply

Array = NDArray[np.float64]

SIDES = ("left", "right")


def leg_of(character: Character, side: str) -> Limb:
    """Return a side's leg.

    Raises:
      ModelError: it is no ball, hinge, ball.
    """
    foot = int(character.model.joint(f"{side}_ankle").bodyid[0])
    for limb in character.limbs:
        if limb.end == foot:
            return limb
    raise ModelError(f"the built-in walk needs the humanoid: its {side} leg is no ball-hinge-ball")


def room_to_rise(legs: Limbs, qpos: Array, feet: tuple[Array, Array], knee: float) -> Array:
    """Return how far (n,) the pelvis can rise before a knee is straighter than ``knee`` [m].

    Args:
      legs: both legs.
      qpos: (n, nq) poses; of the legs, only where they hang counts.
      feet: ankles (n, 2, 3) [m] and orientations (n, 2, 4) of both feet.
      knee: [rad].
    """
    hip, _ = legs.bases(qpos)
    return np.asarray(-drop_to_reach(hip, feet[0], legs.distance(knee), 0.1).max(axis=1))


def pelvis_height(grid: Array, room: Array, psi: Array, near: int) -> Array:
    """Return a smooth height (n,) at phases ``psi`` that is nowhere over ``room`` [m].

    Args:
      grid: (m,) evenly spaced phases [cycles].
      room: (m,) most height there [m].
      psi: (n,) phases wanted.
      near: the pelvis keeps its height for this long about its lowest [samples of the grid].
    """
    from scipy.ndimage import gaussian_filter1d, minimum_filter1d

    low = minimum_filter1d(room, 2 * near + 1, mode="nearest")
    smooth = gaussian_filter1d(low, near / 3.0, mode="nearest", truncate=3.0)
    return CubicSpline(grid, smooth)(psi)


def close_legs(legs: Limbs, qpos: Array, feet: tuple[Array, Array]) -> Array:
    """Return the poses (n, nq) with both feet where they are to be.

    Args:
      legs: left and right.
      qpos: (n, nq) poses.
      feet: ankles (n, 2, 3) [m] and orientations (n, 2, 4).
    """
    model, qpos = legs.model, qpos.copy()
    state = legs.state(qpos)
    point = legs.end_anchor
    goal = legs.goal(state, feet[0], feet[1], point)
    end = multiply(conjugate(state.base_quat), feet[1])
    move = legs.close(state, goal, end)
    for column, side in enumerate(SIDES):
        for part, dofs in (("hip", slice(0, 3)), ("knee", 3), ("ankle", slice(4, 7))):
            address = int(model.joint(f"{side}_{part}").qposadr[0])
            if part == "knee":
                qpos[:, address] += move[:, column, dofs]
            else:
                quat = qpos[:, address : address + 4]
                qpos[:, address : address + 4] = multiply(quat, exp(move[:, column, dofs]))
    return qpos


def with_toes(character: Character, qpos: Array, bends: Sequence[Array]) -> Array:
    """Return the poses (n, nq) with the toes of both feet bent up by (n,) [rad], where they bend.

    Args:
      character: the humanoid.
      qpos: (n, nq) poses.
      bends: left and right.
    """
    for foot in character.feet:
        if foot.side in SIDES and foot.toes is not None:
            qpos = foot.toes.put(qpos, bends[SIDES.index(foot.side)])
    return qpos
