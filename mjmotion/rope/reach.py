"""Whether a character can hold a rope where it is to be held, by lengths of bones alone."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.constraints import SiteConstraint
from mjmotion.exceptions import ConstraintError
from mjmotion.kinematics import site_id

Array = NDArray[np.float64]


def span(model: mujoco.MjModel, one: str, other: str) -> float:
    """Return the most that two sites of a character can be apart, all joints free to turn [m].

    The way from one to the other goes from joint to joint, each pair of which is on one body.

    Raises:
      ModelError: there is no such site.
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    ways = [_joints_above(model, site_id(model, site)) for site in (one, other)]
    shared = set(ways[0]) & set(ways[1])
    joints = [joint for joint in ways[0] if joint not in shared]
    joints += [joint for joint in reversed(ways[1]) if joint not in shared]
    places = [data.site_xpos[site_id(model, one)]]
    places += [data.xanchor[joint] for joint in joints]
    places.append(data.site_xpos[site_id(model, other)])
    return float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())


def _joints_above(model: mujoco.MjModel, site: int) -> list[int]:
    """Return the joints between a site and the world, from the site on."""
    joints, body = [], int(model.site_bodyid[site])
    while body > 0:
        first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        joints += [first + number for number in reversed(range(count))]
        body = int(model.body_parentid[body])
    return joints


def check_reach(model: mujoco.MjModel, constraints: Sequence[SiteConstraint]) -> None:
    """Raise ConstraintError where two sites are to be further apart than the character spans.

    Args:
      model: the character.
      constraints: with a position each.
    """
    where: dict[str, dict[int, Array]] = {}
    for constraint in constraints:
        if constraint.position is not None:
            points = np.broadcast_to(constraint.position, (len(constraint.frames), 3))
            mine = where.setdefault(constraint.site, {})
            mine.update(zip(constraint.frames.tolist(), points, strict=True))
    for one, other in combinations(where, 2):
        most = span(model, one, other)
        both = sorted(where[one].keys() & where[other].keys())
        apart = [float(np.linalg.norm(where[one][f] - where[other][f])) for f in both]
        bad = [frame for frame, length in zip(both, apart, strict=True) if length > most]
        if bad:
            raise ConstraintError(
                f"the rope is out of reach: {one} and {other} hold it {max(apart):.2f} m apart at"
                f" frame {bad[0]}, and this character spans {most:.2f} m between them:"
                " take one with longer limbs",
                bad,
            )
