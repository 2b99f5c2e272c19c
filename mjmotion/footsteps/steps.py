"""Footholds of a walk: each by itself where that makes steps that can be walked, else all together.

footholds, turns = choose_footholds(stances, feet, ground, start_height)
loose = loose_ends(stances, footholds, motion.nframe)
bend = bend_along(motion, stances, footholds, (turns, loose))
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.feet import Foot
from mjmotion.body.motion import Motion
from mjmotion.exceptions import SceneError
from mjmotion.footsteps.chain import TOLERATED, find_chain, walkable_footholds
from mjmotion.footsteps.footholds import Foothold, find_footholds, footholds_at
from mjmotion.footsteps.stances import Stance
from mjmotion.numerics.rotations import multiply, rotate, yaw_quat
from mjmotion.numerics.smoothing import ease
from mjmotion.route.bend import Bend, smooth_bend
from mjmotion.scene.ground import Ground

Array = NDArray[np.float64]

ALTERNATE = 0.7  # share of steps that are taken with the other foot, at least, of one who walks
BEND_TIME = 0.4  # τ of the root's way that goes with the steps [s]


def choose_footholds(
    stances: Sequence[Stance], feet: Sequence[Foot], ground: Ground, start_height: float
) -> tuple[tuple[Foothold, ...], Array | None]:
    """Put every stance on the ground, so that its steps can be walked.

    Args:
      stances: in order of time, at their own spots.
      feet: the feet they are of.
      ground: the scene's surfaces.
      start_height: height of the ground where the walk begins [m].

    Returns:
      One foothold a stance; and how far each was turned about the vertical (n,) [rad] where all
      were chosen together, None where each one is near its own spot.

    Raises:
      SceneError: there is nothing to stand on within reach of a step.
    """
    if not stances:  # of one who only kneels or crawls
        return (), None
    if not _alternate(stances):
        return find_footholds(stances, feet, ground, start_height), None
    try:
        near = walkable_footholds(stances, feet, ground, start_height)
        if near is not None:
            return near, None
    except SceneError:
        pass  # nothing near where the source stands; there may be where its steps lead
    chain = find_chain(stances, feet, ground, start_height)
    moved = [
        dataclasses.replace(
            stance,
            source_pos=np.array((*spot, stance.source_pos[2])),
            source_quat=multiply(yaw_quat(np.asarray(turn)), stance.source_quat),
        )
        for stance, spot, turn in zip(stances, chain.spots, chain.turns, strict=True)
    ]
    return footholds_at(moved, feet, ground, chain.heights.tolist()), chain.turns


def _alternate(stances: Sequence[Stance]) -> bool:
    """Whether feet stand in turn, most of the time: else what is between two is no step."""
    pairs = list(pairwise(stances))
    turns = sum(before.foot != after.foot for before, after in pairs)
    return turns >= ALTERNATE * len(pairs)


def can_be_stepped(
    stances: Sequence[Stance], feet: Sequence[Foot], ground: Ground, start_height: float
) -> bool:
    """Return whether a chain of steps along the stances' own way is one that people walk."""
    try:
        costs = find_chain(stances, feet, ground, start_height).costs
    except SceneError:
        return False
    return bool((costs <= TOLERATED).all())


def loose_ends(
    stances: Sequence[Stance], footholds: Sequence[Foothold], nframe: int
) -> tuple[Array, ...]:
    """Return how much further feet go (nframe, 3) [m] before their first stance, after their last.

    The clip does not show where they come from or go to. As the last step was moved against the one
    before it, so is the next: a walk of short steps ends in one.

    Args:
      stances: all stances in order of time.
      footholds: one a stance.
      nframe: of the clip.
    """
    moved = np.array([f.position - s.source_pos for s, f in zip(stances, footholds, strict=True)])
    moved[:, 2] = 0.0
    loose = []
    for foot in range(max(stance.foot for stance in stances) + 1):
        mine = [index for index, stance in enumerate(stances) if stance.foot == foot]
        others = [index for index, stance in enumerate(stances) if stance.foot != foot]
        more = np.zeros((nframe, 3))
        swings = [
            stances[b].start - stances[a].end for one in (mine, others) for a, b in pairwise(one)
        ]
        if mine and others and swings:
            time = max(float(np.median(swings)), 1.0)
            begin, end = stances[mine[0]].start, stances[mine[-1]].end
            for frames, edge, own, other in (
                (np.arange(begin), begin, mine[0], others[0]),
                (np.arange(end, nframe), end - 1, mine[-1], others[-1]),
            ):
                # Only where the other foot stands nearer to that end is there a step to go on from.
                if (own < other) == (edge == begin):
                    continue
                share = ease(np.abs(frames - edge) / (time + 1.0))
                more[frames] = 2.0 * share[:, None] * (moved[other] - moved[own])
        loose.append(more)
    return tuple(loose)


def bend_along(
    motion: Motion,
    stances: Sequence[Stance],
    footholds: Sequence[Foothold],
    moves: tuple[Array, tuple[Array, ...]],
) -> Bend:
    """Return the bend that takes a clip along with footholds that are elsewhere.

    The body goes with the foot that stands as if it were one with it, with both where both stand,
    and evenly from one to the next; smoothly.

    Args:
      motion: the clip.
      stances: its stances, at their own spots.
      footholds: one a stance.
      moves: (n,) how far each was turned about the vertical [rad], and what :func:`loose_ends`
        says.
    """
    nframe, root = motion.nframe, motion.qpos[:, :3]
    turns, loose = moves
    asked = []
    for foot in sorted({stance.foot for stance in stances}):
        mine = [index for index, stance in enumerate(stances) if stance.foot == foot]
        move = np.empty((nframe, 3))
        for number, index in enumerate(mine):
            stance = stances[index]
            whole = np.empty((nframe, 3))
            arm = root - stance.source_pos
            turned = rotate(yaw_quat(np.full(nframe, turns[index])), arm)
            whole[:, :2] = (footholds[index].position - stance.source_pos + turned - arm)[:, :2]
            whole[:, 2] = turns[index]
            before = stances[mine[number - 1]].end if number else 0
            count = stance.start - before if number else 0
            share = ease((np.arange(count) + 1.0) / (count + 1.0))[:, None]
            swing = slice(before, before + count)
            move[swing] += share * (whole[swing] - move[swing])
            move[before + count :] = whole[before + count :]
        move[:, :2] += loose[foot][:, :2]
        asked.append(move)
    mean = np.mean(asked, axis=0)
    return smooth_bend(mean[:, :2], mean[:, 2], np.ones(nframe), BEND_TIME * motion.fps)
