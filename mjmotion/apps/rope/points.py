"""The rope of a model: where its points are in ``qpos``, and its centre line in the world."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.exceptions import ModelError
from mjmotion.scene.rope_scene import ROPE

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class RopePoints:
    """A rope of points that slide freely, hanging from its first.

    Attributes:
      address: (npoint - 1, 3) where the points' slides are in ``qpos``; the first has none.
      rest: (npoint, 3) the points at ``qpos0``, from the beam down [m].
      along: (npoint,) how far along the rope each point is [m].
      radius: of the rope [m].
    """

    address: NDArray[np.int64]
    rest: Array
    along: Array
    radius: float

    @property
    def length(self) -> float:
        """Length of the rope [m]."""
        return float(self.along[-1])

    def positions(self, qpos: Array) -> Array:
        """Return the points (..., npoint, 3) [m] of poses (..., nq)."""
        points = np.broadcast_to(self.rest, (*qpos.shape[:-1], *self.rest.shape)).copy()
        points[..., 1:, :] += qpos[..., self.address]
        return points

    def share(self, along: float) -> tuple[int, float]:
        """Return the edge that a place on the rope is on, and how far down that edge, in 0…1."""
        edge = int(np.clip(np.searchsorted(self.along, along) - 1, 0, len(self.along) - 2))
        return edge, (along - self.along[edge]) / (self.along[edge + 1] - self.along[edge])

    def at(self, points: Array, along: float) -> Array:
        """Return the place (..., 3) ``along`` the rope [m], of points (..., npoint, 3)."""
        edge, share = self.share(along)
        return np.asarray((1.0 - share) * points[..., edge, :] + share * points[..., edge + 1, :])


def rope_points(model: mujoco.MjModel) -> RopePoints:
    """Return the rope of a model.

    Raises:
      ModelError: it has no flex named ``rope``, as :func:`mjmotion.scene.rope_scene.rope` makes.
    """
    flex = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_FLEX, ROPE)
    if flex < 0 or model.flex_dim[flex] != 1:
        raise ModelError(f"the model has no 1-D flex named '{ROPE}': make it with 'scene rope'")
    first, count = model.flex_vertadr[flex], model.flex_vertnum[flex]
    bodies = model.flex_vertbodyid[first : first + count]
    if bodies[0] != 0 or (model.body_jntnum[bodies[1:]] != 3).any():
        raise ModelError(f"flex '{ROPE}' is no rope that hangs: it needs three slides a point")
    address = model.jnt_qposadr[model.body_jntadr[bodies[1:]]][:, None] + np.arange(3)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_flex(model, data)
    rest = data.flexvert_xpos[first : first + count].copy()
    edges = np.linalg.norm(np.diff(rest, axis=0), axis=1)
    along = np.concatenate(((0.0,), np.cumsum(edges)))
    return RopePoints(address, rest, along, float(model.flex_radius[flex]))


def nearest_on_rope(points: Array, to: Array) -> tuple[Array, Array]:
    """Return how far places are from a rope's centre line, and which edge is nearest.

    Args:
      points: (n, npoint, 3) the rope in ``n`` frames [m].
      to: (n, 3) a place in each [m].

    Returns:
      (n,) distances [m] and (n,) edges.
    """
    start, step = points[:, :-1], np.diff(points, axis=1)
    apart = to[:, None] - start
    square = np.maximum((step**2).sum(axis=-1), 1e-18)
    part = np.clip((apart * step).sum(axis=-1) / square, 0.0, 1.0)
    gap = np.linalg.norm(apart - part[..., None] * step, axis=-1)
    edge = gap.argmin(axis=1)
    return gap[np.arange(len(gap)), edge], edge
