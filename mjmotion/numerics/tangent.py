"""⊕ and ⊖ over all frames (Eq. 1): displacement maps live in the model's tangent space.

    moved = oplus(model, qpos, displacement)      # m ⊕ d
    displacement = ominus(model, moved, qpos)     # m' ⊖ m

A displacement row has ``nv`` numbers: the root's translation in world axes [m], then a rotation
vector [rad] for the root and for every ball in its own body frame, and an angle [rad] for a hinge.
Rotations are right-multiplied, ``q = q0 exp(v)``, with ``|v|`` the angle turned. ⊖ inverts ⊕ while
every rotation stays below π. MuJoCo does both, a frame a call: that is faster than NumPy over all
frames, because a frame costs half a microsecond.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray


def oplus(
    model: mujoco.MjModel, qpos: NDArray[np.float64], displacement: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return ``qpos ⊕ displacement``.

    Args:
      model: the MuJoCo model.
      qpos: (nframe, nq) poses.
      displacement: (nframe, nv) tangent vectors.

    Returns:
      (nframe, nq) new poses; the arguments are untouched.
    """
    moved = np.array(qpos, dtype=np.float64, order="C")
    step = np.ascontiguousarray(displacement, dtype=np.float64)
    integrate = mujoco.mj_integratePos
    for pose, velocity in zip(moved, step, strict=True):
        integrate(model, pose, velocity, 1.0)
    return moved


def ominus(
    model: mujoco.MjModel, qpos: NDArray[np.float64], reference: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return ``qpos ⊖ reference``: the displacement that moves ``reference`` to ``qpos``.

    Args:
      model: the MuJoCo model.
      qpos: (nframe, nq) poses.
      reference: (nframe, nq) poses.

    Returns:
      (nframe, nv) tangent vectors.
    """
    displacement = np.empty((len(qpos), model.nv))
    target = np.ascontiguousarray(qpos, dtype=np.float64)
    origin = np.ascontiguousarray(reference, dtype=np.float64)
    differentiate = mujoco.mj_differentiatePos
    for row, old, new in zip(displacement, origin, target, strict=True):
        differentiate(model, row, 1.0, old, new)
    return displacement
