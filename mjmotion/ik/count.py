"""How many numbers an IK problem has: all degrees of freedom that serve, and the reduced ones."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mjmotion.body.character import Character
from mjmotion.body.kinematics import body_dofs, site_id


def parameters(character: Character, sites: Sequence[str]) -> tuple[int, int]:
    """Return the degrees of freedom that move some sites, and how many hybrid IK finds (§5.2).

    The reduced ones are those of the body that carries the limbs, and a swivel a limb: 8 of 20 for
    two feet, 13 of 37 for hands and feet (Table 1). Joints that follow others do not count.

    Raises:
      ModelError: an unknown site.
    """
    model = character.model
    bodies = {int(model.site_bodyid[site_id(model, site)]) for site in sites}
    limbs = [limb for limb in character.limbs if limb.end in bodies]
    others = bodies - {limb.end for limb in limbs}
    carrying = {limb.base for limb in limbs} | others
    return _leading(character, bodies), _leading(character, carrying) + len(limbs)


def _leading(character: Character, bodies: set[int]) -> int:
    """Return how many degrees of freedom move any of some bodies, followers not counted."""
    moves = np.any([body_dofs(character.model, body) for body in bodies], axis=0)
    tied = character.coupling
    moves[tied.leader[moves[tied.follower]]] = True
    moves[tied.follower] = False
    return int(moves.sum())
