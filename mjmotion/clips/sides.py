"""Which of two legs is the left one: by names, and by where toes and knees of a body point."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from mjmotion.clips.joint_names import which_side
from mjmotion.clips.tree import PointTree
from mjmotion.clips.tree_roles import TreeRoles

Array = NDArray[np.float64]

_SURE = 0.4  # cosine between the hinge that a leg shows and the line through the hips
_MOST = 0.8  # of the frames that must agree
_BENT = 0.015  # of thigh and shank: a knee that is less out of line shows no direction
_FOOT = 0.05  # of thigh and shank: what is shorter is no foot that points anywhere
_TRAVEL = 0.5  # of thigh and shank: who moves less goes nowhere


@dataclasses.dataclass(frozen=True)
class Sides:
    """Which of two sides is the left one.

    Attributes:
      first_is_left: whether the first one is.
      why: by what that was seen.
      mirrored: whether the names say otherwise.
    """

    first_is_left: bool
    why: str
    mirrored: bool = False


def find_sides(tree: PointTree, roles: TreeRoles, names: tuple[str, ...]) -> Sides | None:
    """Find which side of a body is the left one.

    The body decides where it is sure: toes point ahead of the shank and knees bend forward, so
    that up × ahead is left. What the names say counts where the body is not sure.

    Returns:
      The sides, or None where neither body nor names tell.
    """
    called = _by_names(roles, names)
    toes, knees, travel = _by_toes(tree, roles), _by_knees(tree, roles), _by_travel(tree, roles)
    body, why = 0, ""
    if toes and toes * knees >= 0:
        body, why = toes, "where the toes point"
    elif knees and not toes:
        body, why = knees, "how the knees bend"
    if body and called and body != called:
        return Sides(body > 0, why, mirrored=True)
    if called:
        return Sides(called > 0, "the names")
    if body:
        return Sides(body > 0, why)
    return Sides(travel > 0, "the way it walks") if travel else None


def _by_names(roles: TreeRoles, names: tuple[str, ...]) -> int:
    """Return 1 where the names call the first side left, -1 right, 0 where they do not tell."""
    votes = 0
    for first, second in (roles.legs, roles.arms):
        for part in set(first) & set(second):
            votes += which_side(names[first[part]], names[second[part]])
    return int(np.sign(votes))


def _by_toes(tree: PointTree, roles: TreeRoles) -> int:
    """Return 1 where the toes say that the first side is left, -1 right, 0 where they do not."""
    hinges = []
    for leg in roles.legs:
        ankle = leg["ankle"]
        tips = [leg["toe"]] if "toe" in leg else list(tree.tips[ankle])
        tip = max(tips, key=lambda point: tree.distance(ankle, point))
        if tree.distance(ankle, tip) > _FOOT * roles.leg:
            shank = tree.places[:, leg["knee"]] - tree.places[:, ankle]
            hinges.append(
                np.cross(_unit(shank), _unit(tree.places[:, tip] - tree.places[:, ankle]))
            )
    return _agreed(hinges, _across(tree, roles))


def _by_knees(tree: PointTree, roles: TreeRoles) -> int:
    """Return the same as by toes from the frames in which a knee is bent."""
    across, hinges, lines = _across(tree, roles), [], []
    for leg in roles.legs:
        hip, knee, ankle = (tree.places[:, leg[part]] for part in ("hip", "knee", "ankle"))
        line = _unit(hip - ankle)
        out = knee - ankle - ((knee - ankle) * line).sum(axis=1, keepdims=True) * line
        bent = np.linalg.norm(out, axis=1) > _BENT * roles.leg
        hinges.append(np.cross(line, _unit(out))[bent])
        lines.append(across[bent])
    hinge = np.concatenate(hinges)
    return _agreed([hinge], np.concatenate(lines)) if len(hinge) else 0


def _by_travel(tree: PointTree, roles: TreeRoles) -> int:
    """Return the same from the way the pelvis goes, for those who walk forward."""
    hips = [tree.places[:, leg["hip"]] for leg in roles.legs]
    pelvis = (hips[0] + hips[1]) / 2
    shoulders = [tree.places[:, arm["shoulder"]] for arm in roles.arms]
    way = np.gradient(pelvis, axis=0) if len(pelvis) > 1 else np.zeros_like(pelvis)
    if np.linalg.norm(pelvis[-1] - pelvis[0]) < _TRAVEL * roles.leg:
        return 0
    up = _unit((shoulders[0] + shoulders[1]) / 2 - pelvis)
    return _agreed([np.cross(up, _unit(way))], _across(tree, roles))


def _across(tree: PointTree, roles: TreeRoles) -> Array:
    """Return (nsample, 3) unit vectors from the second side's hip to the first's."""
    first, second = (leg["hip"] for leg in roles.legs)
    return _unit(tree.places[:, first] - tree.places[:, second])


def _agreed(hinges: list[Array], across: Array) -> int:
    """Return the sign in which hinges (n, 3) lie along lines (n, 3), or 0 where they disagree."""
    if not hinges:
        return 0
    cosine = np.concatenate([(hinge * across).sum(axis=1) for hinge in hinges])
    middle = float(np.median(cosine))
    sign = int(np.sign(middle))
    return sign if abs(middle) > _SURE and (cosine * sign > 0).mean() >= _MOST else 0


def _unit(vectors: Array) -> Array:
    size = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.maximum(size, 1e-12))
