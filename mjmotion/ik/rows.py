"""Rows of the least-deviation problem for what is asked of two sites, or of a site and a point.

Each returns what a small displacement changes, how much is still to change, and how much it counts.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.kinematics import Pose
from mjmotion.constraints import LookAtTarget, RelativeTarget
from mjmotion.numerics.rotations import between, cross, from_matrix, log, to_matrix

Array = NDArray[np.float64]


def relative_rows(
    pose: Pose, one: RelativeTarget, dofs: NDArray[np.int64]
) -> tuple[Array, Array, Array]:
    """Rows (n, 6, k) that hold one site in the frame of another, errors and weights (n, 6)."""
    model = pose.model
    wanted = one.world_position(pose)
    jacp, jacr = pose.jacobian(pose.site_xpos[:, one.site], int(model.site_bodyid[one.site]), dofs)
    # The wanted place moves with the body it belongs to.
    top, tor = pose.jacobian(wanted, int(model.site_bodyid[one.to]), dofs)
    turned = pose.site_xmat[:, one.to] @ to_matrix(one.quat)
    turn = turned @ np.swapaxes(pose.site_xmat[:, one.site], 1, 2)
    held = np.repeat(np.stack((one.position_weight, one.turn_weight), axis=1), 3, axis=1)
    gap = wanted - pose.site_xpos[:, one.site]
    return (
        np.concatenate((jacp - top, jacr - tor), axis=1),
        np.concatenate((gap, log(from_matrix(turn))), axis=1),
        held,
    )


def look_at_rows(
    pose: Pose, one: LookAtTarget, dofs: NDArray[np.int64]
) -> tuple[Array, Array, Array]:
    """Rows (n, 3, k) that turn an axis of a site to a point, errors and weights (n, 3).

    The error is the turn that is still to do [rad]; about the axis itself nothing is wanted.
    """
    origin = pose.site_xpos[:, one.site]
    axis = pose.site_xmat[:, one.site] @ one.axis
    away = one.point - origin
    length = np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-6)
    line = away / length
    jacp, jacr = pose.jacobian(origin, int(pose.model.site_bodyid[one.site]), dofs)
    error = log(between(axis, line))
    # A turn takes the axis along; a move v of the site turns the line by -line x v / length.
    swing = cross(line[:, None, :], np.swapaxes(jacp, 1, 2)) / length[:, None]
    across = np.eye(3) - axis[:, :, None] * axis[:, None, :]
    rows = across @ (jacr + np.swapaxes(swing, 1, 2))
    return rows, error, np.repeat(one.weight[:, None], 3, axis=1)
