"""Roles of joints from the tree alone: two legs, two arms, what is between them and above.

What is looked for is a body's plan: three joints in line on each of two branches that mirror each
other, with the proportions of legs and of arms, one pair under the other, and a head on top. Each
property is judged by how far it is from usual, in units of how much people and skeletons differ:

    score = -1/2 Σ ((x - usual) / spread)²

and the combination with the highest score is taken. Names may add to it, and no more.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from mjmotion.clips.tree import PointTree

Array = NDArray[np.float64]

_NAMED = 1.5  # what a joint with the name of its role adds to the score
_WORST = 12.0  # the most that one property takes off: one odd bone is no other body
_KEPT = 24  # the best of each kind that are looked at further


@dataclasses.dataclass(frozen=True)
class _Plan:
    """What a kind of limb looks like, as (usual, spread); lengths in units of its two long bones.

    Attributes:
      parts: the roles of its three joints.
      ratio: logarithm of the upper bone over the lower.
      rest: from its third joint to the tip.
      root: from where the two branches part to its first joint.
      ends: whether its third joint may be the end of a bone, with no joint there.
    """

    parts: tuple[str, str, str]
    ratio: tuple[float, float]
    rest: tuple[float, float]
    root: tuple[float, float]
    ends: bool


# Of the skeletons of CMU, Mixamo, SMPL, LAFAN1, Biped and the humanoid.
_LEG = _Plan(("hip", "knee", "ankle"), (0.0, 0.2), (0.25, 0.12), (0.12, 0.1), False)
_ARM = _Plan(("shoulder", "elbow", "wrist"), (0.12, 0.2), (0.28, 0.15), (0.35, 0.25), True)
_BENT = 0.03  # spread of how much shorter than its bones a thigh or forearm is, as a share
_UNEQUAL = 0.08  # spread of the logarithm of one side's bone over the other's
_ARM_OF_LEG = (float(np.log(0.63)), 0.18)  # logarithm of the arm's two long bones over the leg's
# The rest in units of the leg's two long bones.
_TRUNK = (0.58, 0.15)  # from between the hips to between the shoulders
_NECK = (0.13, 0.06)  # from the neck's joint to the head's
_NECK_OVER = (0.07, 0.1)  # the neck's joint over the shoulders, along the trunk
_HEAD = (0.22, 0.1)  # from the head's joint to its top
_HAIR = 1.5  # the most that long hair takes off what may be a head
_TOE = (0.18, 0.07)  # from the ankle to the ball
_KNUCKLE = (0.1, 0.05)  # from the wrist to the fingers
_ASIDE = 0.06  # spread of how much nearer one side's shoulder is to what lies in the middle
_SIZE = 2.0  # what halves when a pair of legs is e times shorter than the longest pair
_ALONE = 3.0  # what a neck without head takes off, and a head without neck


@dataclasses.dataclass(frozen=True)
class _Pair:
    """Two limbs that mirror each other: where they part, and three points on each side."""

    meet: int
    first: tuple[int, ...]
    second: tuple[int, ...]
    branches: tuple[int, int]
    length: float
    score: float


@dataclasses.dataclass(frozen=True)
class TreeRoles:
    """A body found in a tree, whose two sides have no names yet.

    Attributes:
      centre: pelvis, and neck and head where there are such, to point.
      legs: hip, knee, ankle and perhaps toe to point, of the one and of the other side.
      arms: shoulder, elbow and perhaps wrist and hand to point, of the sides in the same order.
      leg: length of thigh and shank together, in the file's units.
    """

    centre: Mapping[str, int]
    legs: tuple[Mapping[str, int], Mapping[str, int]]
    arms: tuple[Mapping[str, int], Mapping[str, int]]
    leg: float


def find_tree_roles(tree: PointTree, named: Mapping[str, frozenset[int]]) -> TreeRoles | None:
    """Find a body in a tree of points.

    Args:
      tree: the points.
      named: part (``"knee"``, ``"head"``) to the joints with such a name, of both sides.

    Returns:
      What was found, or None where nothing in the tree looks like a body.
    """
    legs, arms = (_pairs(tree, plan, named) for plan in (_LEG, _ARM))
    if not legs or not arms:
        return None
    longest = max(pair.length for pair in legs)
    best: tuple[float, _Pair, _Pair] | None = None
    for leg, arm in itertools.product(legs, arms):
        if _share(tree, leg, arm):
            continue
        score = _SIZE * np.log(leg.length / longest) + _body_score(tree, leg, arm)
        score += leg.score + arm.score
        if best is None or score > best[0]:
            best = score, leg, arm
    if best is None:
        return None
    _, leg, arm = best
    if _apart(tree, leg, arm) < 0:  # the sides in the same order
        arm = dataclasses.replace(arm, first=arm.second, second=arm.first)
    centre = {"pelvis": leg.meet, **_head(tree, leg, arm, named)}
    limbs = []
    for pair, plan, further in ((leg, _LEG, ("toe", _TOE)), (arm, _ARM, ("hand", _KNUCKLE))):
        for points in (pair.first, pair.second):
            limb = dict(zip(plan.parts, points, strict=True))
            limb = {part: point for part, point in limb.items() if point < tree.njoint}
            last = limb.get(plan.parts[2])
            tip = _further(tree, last, leg.length, named, *further) if last is not None else None
            limbs.append(limb if tip is None else limb | {further[0]: tip})
    return TreeRoles(centre, (limbs[0], limbs[1]), (limbs[2], limbs[3]), leg.length)


def _off(value: Array | float, usual: tuple[float, float]) -> Array:
    """Return the score of values by how far they are from usual."""
    return -np.minimum(0.5 * ((np.asarray(value) - usual[0]) / usual[1]) ** 2, _WORST)


def _pairs(tree: PointTree, plan: _Plan, named: Mapping[str, frozenset[int]]) -> list[_Pair]:
    """Return the best pairs of branches that look like a kind of limb."""
    found = []
    for meet in range(tree.njoint):
        limbs = [
            (child, *_triples(tree, meet, child, plan, named)) for child in tree.children[meet]
        ]
        limbs = [limb for limb in limbs if len(limb[1])]
        for one, other in itertools.combinations(limbs, 2):
            bones = [np.diff(tree.along[limb[1]], axis=1) for limb in (one, other)]
            unequal = np.log(bones[0][:, None] / bones[1][None])
            score = one[2][:, None] + other[2][None] + _off(unequal, (0.0, _UNEQUAL)).sum(axis=-1)
            a, b = np.unravel_index(int(np.argmax(score)), score.shape)
            length = float(bones[0][a].sum() + bones[1][b].sum()) / 2
            first, second = (tuple(map(int, limb[1][k])) for limb, k in ((one, a), (other, b)))
            branches = (one[0], other[0])
            found.append(_Pair(meet, first, second, branches, length, float(score[a, b])))
    if not found:
        return []
    longest = max(pair.length for pair in found)
    # Every hand has pairs of fingers that bend like legs; they are small.
    found.sort(key=lambda pair: pair.score + _SIZE * np.log(pair.length / longest), reverse=True)
    return found[:_KEPT]


def _triples(
    tree: PointTree, meet: int, branch: int, plan: _Plan, named: Mapping[str, frozenset[int]]
) -> tuple[NDArray[np.int64], Array]:
    """Return the best (n, 3) points in line on a branch that may be such a limb, with scores."""
    start = len(tree.lines[meet])
    rows, scores = [], []
    for last in tree.below[branch]:
        if last >= tree.njoint and not plan.ends:
            continue
        line = np.array(tree.lines[last][start:-1], dtype=np.int64)
        if len(line) < 2 or (last >= tree.njoint and len(line) > 4):
            continue
        first, middle = (line[k] for k in np.triu_indices(len(line), 1))
        upper, lower = tree.along[middle] - tree.along[first], tree.along[last] - tree.along[middle]
        long = (upper > 2 * tree.together) & (lower > 2 * tree.together)
        first, middle, upper, lower = (x[long] for x in (first, middle, upper, lower))
        if not len(first):
            continue
        length = upper + lower
        score = _off(np.log(upper / lower), plan.ratio)
        score += _off((tree.along[first] - tree.along[meet]) / length, plan.root)
        tips = tree.along[list(tree.tips[last])] - tree.along[last]
        # The best of all tips: a hand may hold a stick.
        score += _off(tips[:, None] / length, plan.rest).max(axis=0)
        score += _straight(tree, first, middle, upper)
        score += _straight(tree, middle, np.full_like(middle, last), lower)
        for part, points in zip(
            plan.parts, (first, middle, np.full_like(first, last)), strict=True
        ):
            score += _NAMED * np.isin(points, list(named.get(part, ())))
        # Of joints at one place the last one has all of the turning.
        score -= 1e-3 * _followed(tree, middle, last) + 1e-3 * _followed(tree, first, last)
        rows.append(np.stack([first, middle, np.full_like(first, last)], axis=1))
        scores.append(score)
    if not rows:
        return np.zeros((0, 3), dtype=np.int64), np.zeros(0)
    row, points = np.concatenate(scores), np.concatenate(rows)
    best = np.argsort(-row, kind="stable")[:_KEPT]
    return points[best], row[best]


def _straight(
    tree: PointTree, first: NDArray[np.int64], second: NDArray[np.int64], length: Array
) -> Array:
    """Return the score of bones by how straight what lies between their ends stays."""
    reach = np.linalg.norm(tree.places[:, first] - tree.places[:, second], axis=2)
    return _off(1 - np.median(reach, axis=0) / length, (0.0, _BENT))


def _followed(tree: PointTree, points: NDArray[np.int64], last: int) -> Array:
    """Return for points on the way to ``last`` whether the next one is at the same place."""
    line = tree.lines[last]
    following = np.array([line[line.index(int(point)) + 1] for point in points])
    return (tree.along[following] - tree.along[points] < tree.together).astype(float)


def _share(tree: PointTree, leg: _Pair, arm: _Pair) -> bool:
    """Return whether two pairs of limbs are not apart in the tree."""
    inside = [point in tree.below[b] for point in arm.branches for b in leg.branches]
    outside = [point in tree.below[b] for point in leg.branches for b in arm.branches]
    return any(inside) or any(outside)


def _body_score(tree: PointTree, leg: _Pair, arm: _Pair) -> float:
    """Return how much two pairs of limbs look like the legs and arms of one body."""
    hips = tree.middle(leg.first[0], leg.second[0])
    trunk = tree.middle(arm.first[0], arm.second[0]) - hips
    legs = hips - tree.middle(leg.first[2], leg.second[2])
    tall, far = np.linalg.norm(trunk, axis=1), np.linalg.norm(legs, axis=1)
    along = float(np.median((trunk * legs).sum(axis=1) / np.maximum(tall * far, 1e-12)))
    score = _off(np.log(arm.length / leg.length), _ARM_OF_LEG)
    score = score + _off(float(np.median(tall)) / leg.length, _TRUNK) + _off(1 - along, (0.0, 0.4))
    return float(score + _off(1 - _apart(tree, leg, arm) ** 2, (0.0, 0.5)))


def _apart(tree: PointTree, leg: _Pair, arm: _Pair) -> float:
    """Return the median cosine between the lines through the hips and through the shoulders."""
    hips = tree.places[:, leg.first[0]] - tree.places[:, leg.second[0]]
    shoulders = tree.places[:, arm.first[0]] - tree.places[:, arm.second[0]]
    size = np.linalg.norm(hips, axis=1) * np.linalg.norm(shoulders, axis=1)
    return float(np.median((hips * shoulders).sum(axis=1) / np.maximum(size, 1e-12)))


def _head(
    tree: PointTree, leg: _Pair, arm: _Pair, named: Mapping[str, frozenset[int]]
) -> dict[str, int]:
    """Return the joints of neck and head, as far as there are such."""
    limbs = {point for b in (*leg.branches, *arm.branches) for point in tree.below[b]}
    above = set(tree.lines[arm.meet][:-1]) | set(tree.lines[leg.meet])
    free = [point for point in range(tree.njoint) if point not in limbs and point not in above]
    hips, shoulders = (
        tree.middle(leg.first[0], leg.second[0]),
        tree.middle(arm.first[0], arm.second[0]),
    )
    trunk = (shoulders - hips) / np.linalg.norm(shoulders - hips, axis=1, keepdims=True)
    over, aside = {}, {}
    for point in free:
        height = ((tree.places[:, point] - shoulders) * trunk).sum(axis=1)
        over[point] = float(np.median(height)) / leg.length
        sides = [tree.distance(point, side[0]) for side in (arm.first, arm.second)]
        aside[point] = float(_off((sides[0] - sides[1]) / leg.length, (0.0, _ASIDE)))
    best: tuple[float, dict[str, int]] = -2 * _ALONE - 2 * _NAMED, {}

    def top(point: int) -> float:
        tips = (tree.along[list(tree.tips[point])] - tree.along[point]) / leg.length
        hair = np.where(tips > _HEAD[0], -_HAIR, -_WORST)
        return float(np.maximum(_off(tips, _HEAD), hair).max())

    def called(part: str, point: int) -> float:
        return _NAMED * (point in named.get(part, ()))

    for head in free:
        if over[head] < 0:
            continue
        alone = called("head", head) + aside[head] + top(head)
        options = [(alone - _ALONE + float(_off(over[head], (0.2, 0.1))), {"head": head})]
        neck_alone = called("neck", head) + aside[head] + float(_off(over[head], _NECK_OVER))
        options.append((neck_alone - _ALONE - 1.0, {"neck": head}))
        for neck in tree.lines[head][:-1]:
            if neck in over:
                way = (tree.along[head] - tree.along[neck]) / leg.length
                score = alone + called("neck", neck) + aside[neck] + float(_off(way, _NECK))
                score += float(_off(over[neck], _NECK_OVER))
                options.append((score, {"neck": neck, "head": head}))
        best = max(best, *options, key=lambda option: option[0])
    return best[1]


def _further(
    tree: PointTree,
    joint: int,
    leg: float,
    named: Mapping[str, frozenset[int]],
    part: str,
    usual: tuple[float, float],
) -> int | None:
    """Return the joint of the ball beyond an ankle, or of the fingers beyond a wrist."""
    points = [point for point in tree.below[joint][1:] if point < tree.njoint]
    points = [p for p in points if tree.along[p] - tree.along[joint] > tree.together]
    if not points:
        return None
    way = np.array([tree.distance(joint, point) for point in points]) / leg
    score = _off(way, usual) + _NAMED * np.isin(points, list(named.get(part, ())))
    # Of several toes or fingers the middle one, which points where the foot or hand does.
    near = score > score.max() - 1.0
    rays = tree.places[:, points] - tree.places[:, [joint]]
    rays /= np.maximum(np.linalg.norm(rays, axis=2, keepdims=True), 1e-12)
    common = (rays[:, near].mean(axis=1)[:, None] * rays).sum(axis=2).mean(axis=0)
    return points[int(np.argmax(np.where(near, common + 0.1 * score, -np.inf)))]
