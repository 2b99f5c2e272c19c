"""How many numbers an IK problem has: all degrees of freedom that serve, and the reduced ones."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from mjmotion.body.joint_coupling import coupling
from mjmotion.body.kinematics import body_dofs, site_id
from mjmotion.body.limbs import find_limbs


def parameters(model: mujoco.MjModel, sites: Sequence[str]) -> tuple[int, int]:
    """Return the degrees of freedom that move some sites, and how many hybrid IK finds (§5.2).

    The reduced ones are those of the body that carries the limbs, and a swivel a limb: 8 of 20 for
    two feet, 13 of 37 for hands and feet (Table 1). Joints that follow others do not count.

    Raises:
      ModelError: an unknown site.
    """
    bodies = {int(model.site_bodyid[site_id(model, site)]) for site in sites}
    limbs = [limb for limb in find_limbs(model) if limb.end in bodies]
    others = bodies - {limb.end for limb in limbs}
    carrying = {limb.base for limb in limbs} | others
    return _leading(model, bodies), _leading(model, carrying) + len(limbs)


def _leading(model: mujoco.MjModel, bodies: set[int]) -> int:
    """Return how many degrees of freedom move any of some bodies, followers not counted."""
    moves = np.any([body_dofs(model, body) for body in bodies], axis=0)
    tied = coupling(model)
    moves[tied.leader[moves[tied.follower]]] = True
    moves[tied.follower] = False
    return int(moves.sum())
