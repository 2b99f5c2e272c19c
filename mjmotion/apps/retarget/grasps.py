"""What a motion holds, as constraints on another body: hands on a rope, a rail, the ground.

held = hold_constraints(motion, [Contact("left_hand", 12, 60)])
check_span(model, held)                 # can the other body be at all of them at once?
shift = held_shift(guess, held)         # first guess of §4.5 on the other body
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from itertools import combinations

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.kinematics import Kinematics, site_id
from mjmotion.body.motion import Motion
from mjmotion.constraints import Constraint, SiteConstraint, lay_out
from mjmotion.exceptions import ConstraintError, frame_list
from mjmotion.fitting import contact_shift, default_levels
from mjmotion.footsteps.contacts import Contact
from mjmotion.numerics.rotations import from_matrix

Array = NDArray[np.float64]


def hold_constraints(motion: Motion, holds: Sequence[Contact]) -> tuple[SiteConstraint, ...]:
    """Return constraints that hold sites where a motion has them, and turned as it has them.

    A site keeps the mean place of its hold: what drifts in the motion does not on the other body.

    Args:
      motion: the motion that holds, on its own character.
      holds: which sites hold when, such as ``Contact("left_hand", 12, 60)``.

    Raises:
      ModelError: an unknown site.
    """
    if not holds:
        return ()
    pose = Kinematics(motion.model, motion.nframe).forward(motion.qpos)
    constraints = []
    for hold in holds:
        site = site_id(motion.model, hold.site)
        frames = np.arange(hold.start, hold.end)
        constraints.append(
            SiteConstraint(
                hold.site,
                frames,
                pose.site_xpos[frames, site].mean(axis=0),
                from_matrix(pose.site_xmat[frames, site]),
                contact=True,
                source="scene",
            )
        )
    return tuple(constraints)


def held_shift(guess: Motion, constraints: Sequence[Constraint]) -> Array:
    """Return the first guess of §4.5 (nframe, 3) [m] for a body that only holds, as on a rope.

    On the other body with its joint angles copied, the mean way from where held sites are to where
    they are to be holds both what its limbs are longer and what the contacts moved. It jumps where
    a hand or foot lets go, so only the coarsest knots are for the root to follow.

    Args:
      guess: joint angles copied on the other body.
      constraints: what holds; those with ``contact=True`` count, all where none has it.
    """
    places = [one for one in constraints if isinstance(one, SiteConstraint)]
    places = [one for one in places if one.position is not None]
    chosen = [one for one in places if one.contact] or places
    if not chosen:
        return np.zeros((guess.nframe, 3))
    targets = lay_out(
        [dataclasses.replace(one, contact=True) for one in chosen], guess.model, guess.nframe
    )
    return contact_shift(guess, targets, default_levels(guess.fps)[:1] * 2)


def check_span(model: mujoco.MjModel, constraints: Sequence[Constraint]) -> None:
    """Raise ConstraintError where a body cannot be at two held places at once, in whatever pose.

    No two of its points get further apart than the bones between them are long.

    Args:
      model: the body.
      constraints: what holds; those of sites count.
    """
    held = [
        (one.site, one.frames, one.position)
        for one in constraints
        if isinstance(one, SiteConstraint) and one.position is not None
    ]
    for (site, frames, place), (other, others, there) in combinations(held, 2):
        common, mine, theirs = np.intersect1d(frames, others, return_indices=True)
        if site == other or len(common) == 0:
            continue
        apart = np.linalg.norm(place[mine] - there[theirs], axis=1)
        span = _span(model, site_id(model, site), site_id(model, other))
        far = apart > span
        if far.any():
            raise ConstraintError(
                f"{site} and {other} hold places {apart.max():.2f} m apart at frames"
                f" {frame_list(common[far])}, and the body spans {span:.2f} m between them: it"
                " is out of reach; move the holds or take a larger body",
                common[far],
            )


def _span(model: mujoco.MjModel, site: int, other: int) -> float:
    """Return the length of the bones from one site to another [m]; infinite over a slide."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    lines = [_line(model, int(model.site_bodyid[one])) for one in (site, other)]
    shared = set(lines[0]) & set(lines[1])
    joints = [
        joint for line in lines for body in line if body not in shared for joint in line[body]
    ]
    if (model.jnt_type[joints] == mujoco.mjtJoint.mjJNT_SLIDE).any():
        return float("inf")
    up, down = (
        [data.xanchor[joint] for body in line if body not in shared for joint in line[body]]
        for line in lines
    )
    points = np.array([data.site_xpos[site], *up, *reversed(down), data.site_xpos[other]])
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def _line(model: mujoco.MjModel, body: int) -> dict[int, list[int]]:
    """Return the bodies from one up to the world, with their joints from the last to the first."""
    line = {}
    while body > 0:
        first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        line[body] = list(range(first + count - 1, first - 1, -1)) if count else []
        body = int(model.body_parentid[body])
    return line


__all__ = ["check_span", "held_shift", "hold_constraints"]
