"""Trunk, head and legs of a character, found from its tree and its pose at ``qpos0``.

Nothing here has to be there: a part that cannot be told is None, and its figures are not judged.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_ALIKE = 0.05  # relative difference of reach up to which two subtrees are a pair
_SHORT = 0.3  # a pair that reaches less far than this share of the longest is no pair of arms
_TWIST = 0.8  # of the cosine: a hinge this nearly along its bone only twists it
_SOLES = ("heel", "toe")  # endings of the sites that feet stand with
_HINGE = mujoco.mjtJoint.mjJNT_HINGE


@dataclasses.dataclass(frozen=True)
class Leg:
    """One leg: its foot's body, and the joints that are its hip, knee and ankle, by id."""

    foot: int
    hip: int
    knee: int
    ankle: int


@dataclasses.dataclass(frozen=True)
class Anatomy:
    """The parts of a character, as ids.

    Attributes:
      root: the body on the free root: the pelvis.
      trunk: the body that both arms hang from; without arms the highest body that is in no leg.
      head: the highest body that hangs from the trunk and is in no limb.
      legs: those with a hip, a knee and an ankle.
    """

    root: int
    trunk: int
    head: int | None
    legs: tuple[Leg, ...]


def find_anatomy(model: mujoco.MjModel) -> Anatomy:
    """Return the parts of the character with the free root.

    A leg is the branch that ends in a body with a site called ``…heel`` or ``…toe``, up to where
    it meets another. Arms are two branches of one body, with joints of the same kinds, that reach
    as far: the highest such pair that is not much shorter than the longest.
    """
    tree = _Tree(model)
    root = tree.bodies[0]
    feet = sorted(
        {
            int(model.site_bodyid[site])
            for site in range(model.nsite)
            if model.site(site).name.endswith(_SOLES)
            and model.site_bodyid[site] in tree.bodies
            and model.site_bodyid[site] != root
        }
    )
    chains = [tree.chain(foot, feet) for foot in feet]
    in_legs = {body for chain in chains for body in tree.subtree(chain[0])}
    pairs = [pair for pair in tree.pairs() if not in_legs & set(pair)]
    if not feet and pairs:  # legs that are not known by their feet are the lowest pair
        lowest = min(pairs, key=lambda pair: tree.low(pair[0]))
        pairs.remove(lowest)
        in_legs = {body for top in lowest for body in tree.subtree(top)}
    longest = max((tree.reach(pair[0]) for pair in pairs), default=0.0)
    arms = max(
        (pair for pair in pairs if tree.reach(pair[0]) >= _SHORT * longest),
        key=lambda pair: tree.anchor[pair[0], 2],
        default=None,
    )
    legs = tuple(leg for chain in chains if (leg := tree.leg(chain)) is not None)
    if arms is None:
        rest = [body for body in tree.bodies if body not in in_legs]
        return Anatomy(root, max(rest, key=lambda body: tree.place[body, 2]), None, legs)
    trunk = int(model.body_parentid[arms[0]])
    taken = in_legs | {body for pair in pairs for top in pair for body in tree.subtree(top)}
    heads = [b for b in tree.subtree(trunk) if b != trunk and b not in taken]
    above = [b for b in heads if tree.anchor[b, 2] > tree.place[trunk, 2]]
    return Anatomy(root, trunk, max(above, key=lambda b: tree.place[b, 2], default=None), legs)


class _Tree:
    """The bodies under the free root at ``qpos0``."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model = model
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        root = int(model.jnt_bodyid[0])
        self.bodies = np.flatnonzero(model.body_rootid == root).tolist()
        self.place, self.anchor = np.array(data.xpos), np.array(data.xpos)
        for body in self.bodies[1:]:
            if model.body_jntnum[body]:
                self.anchor[body] = data.xanchor[model.body_jntadr[body]]
        self._axis = np.array(data.xaxis)
        self._below: dict[int, list[int]] = {body: [body] for body in self.bodies}
        for body in reversed(self.bodies[1:]):  # a parent's number is lower than its child's
            self._below[int(model.body_parentid[body])] += self._below[body]

    def subtree(self, body: int) -> list[int]:
        """Return a body and all that hangs from it."""
        return self._below[body]

    def low(self, top: int) -> float:
        """Return how low the bodies of a branch go [m]."""
        return float(self.place[self.subtree(top), 2].min())

    def reach(self, top: int) -> float:
        """Return how far the bodies of a branch go from where it hangs [m]."""
        away = self.place[self.subtree(top)] - self.anchor[top]
        return float(np.linalg.norm(away, axis=1).max())

    def chain(self, foot: int, feet: Sequence[int]) -> list[int]:
        """Return the bodies of a leg from the top down to its foot."""
        path, root = [foot], self.bodies[0]
        while (parent := int(self.model.body_parentid[path[0]])) != root:
            if sum(other in self.subtree(parent) for other in feet) > 1:
                break
            path.insert(0, parent)
        return path

    def pairs(self) -> list[tuple[int, int]]:
        """Return branches of one body that have joints of the same kinds and reach as far."""
        found = []
        for i, a in enumerate(self.bodies[1:], start=1):
            for b in self.bodies[i + 1 :]:
                if self.model.body_parentid[a] != self.model.body_parentid[b]:
                    continue
                kinds, (one, other) = self._kinds(a), (self.reach(a), self.reach(b))
                level = abs(self.anchor[a, 2] - self.anchor[b, 2]) <= _ALIKE * max(one, other)
                alike = abs(one - other) <= _ALIKE * max(one, other)
                if len(kinds) > 1 and kinds == self._kinds(b) and level and alike:
                    found.append((a, b))
        return found

    def leg(self, chain: Sequence[int]) -> Leg | None:
        """Return the joints of a leg: the knee is nearest to its middle; None without all three."""
        jointed = [body for body in chain if self.model.body_jntnum[body]]
        if len(jointed) < 3:
            return None
        line = self.anchor[jointed]
        bone = np.diff(line, axis=0)
        length = np.linalg.norm(bone, axis=1)
        share = np.cumsum(length)[:-1] / max(float(length.sum()), 1e-9)
        off = np.abs(share - 0.5)
        joint = self.model.body_jntadr[jointed]
        for i, body in enumerate(jointed[1:-1]):
            along = abs(self._axis[joint[i + 1]] @ bone[i + 1])
            single = self.model.body_jntnum[body] == 1
            hinge = self.model.jnt_type[joint[i + 1]] == _HINGE
            off[i] += bool(single and hinge and along > _TWIST * length[i + 1])
        knee = 1 + int(off.argmin())
        return Leg(int(chain[-1]), int(joint[0]), int(joint[knee]), int(joint[-1]))

    def _kinds(self, top: int) -> list[int]:
        mine = np.isin(self.model.jnt_bodyid, self.subtree(top))
        return sorted(self.model.jnt_type[mine].tolist())
