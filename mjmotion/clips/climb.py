"""The built-in rope climb (Figure 5c): 275 frames, hand over hand, feet clamping the rope.

    motion = make_climb("humanoid")
    contacts = climb_contacts()
    constraints = climb_constraints("humanoid") # 5,898 scalars: six a frame and limb that holds

Where hands and feet go is planned (:mod:`mjmotion.clips.climb_plan`), and so is how the body rises,
leans and turns; arms and legs then follow from the project's own fit.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.character import Character, CharacterLike
from mjmotion.body.motion import Motion
from mjmotion.clips.climb_grip import LIMBS, ROPE_RADIUS, find_grips
from mjmotion.clips.climb_plan import (
    FPS,
    FRAMES,
    RISE,
    hold_constraints,
    hold_contacts,
    limb_path,
    plan_holds,
)
from mjmotion.constraints import SiteConstraint
from mjmotion.exceptions import ModelError
from mjmotion.fitting import fit
from mjmotion.footsteps.contacts import Contact
from mjmotion.ik import HybridIK
from mjmotion.numerics.rotations import cross, exp, from_matrix, log, multiply, normalized, yaw_quat

Array = NDArray[np.float64]

_PELVIS = 1.22  # height of the pelvis in the hang [m]

# Frames, and there: rise of the pelvis over the hang, its place in front of the rope and to the
# left [m]; pitch (back is negative), roll to the right and turn to the left of the pelvis, and of
# the torso against it, and how far the head looks up [degree].
_BODY = np.array(
    # frame  rise      x      y  pitch roll turn   spine: pitch roll turn   look
    [
        [0, -0.02, -0.25, 0.00, -4, 0, 0, 0, 0, 0, 22],
        [14, 0.05, -0.30, 0.00, -22, 0, 0.5, 12, 0, 0.5, 14],
        [20, 0.06, -0.30, 0.00, -23, 1, 1, 12, 1, 1, 16],
        [42, 0.25, -0.27, -0.01, -12, 3, -2.5, 4, 4, -3, 26],
        [51, 0.30, -0.26, -0.01, -8, 3, -3.5, 1, 6, -4, 26],
        [64, 0.33, -0.26, 0.00, -7, 0, -1, 1, 1, -1, 20],
        [80, 0.38, -0.26, 0.01, -6, -3, 2.5, 1, -4, 3, 24],
        [89, 0.40, -0.26, 0.01, -5, -3, 3.5, 0, -6, 4, 24],
        [102, 0.41, -0.27, 0.00, -6, 0, 1, 1, -1, 1, 16],
        [110, 0.42, -0.29, 0.00, -13, 0, 0, 7, 0, 0, 12],
        [119, 0.44, -0.30, 0.00, -22, 0, 0.5, 12, 0, 0.5, 12],
    ]
)
_HANG = 2  # of these lines are about the hang; the others come again and again
_CYCLE = 106  # frames
_LOOK = (0.6, 0.4)  # shares of neck and head
_STIFF = 2000.0  # the body keeps to its plan, arms and legs give

# How the limbs are bent where nothing else is said; they are closed on their targets from here.
# Directions of a left limb's upper and lower part in the frame of the body it hangs from.
_BENT = {
    ("shoulder", "elbow"): ((0.6, 0.7, 0.55), (0.1, -0.5, 0.85)),
    ("hip", "knee"): ((0.85, 0.5, -0.45), (-0.5, -0.25, -0.85)),
}


def climb_contacts() -> tuple[Contact, ...]:
    """Return who holds the rope when."""
    return hold_contacts(plan_holds())


def climb_constraints(character: CharacterLike) -> tuple[SiteConstraint, ...]:
    """Return position and orientation of every hold, for a character's own hands and feet.

    Raises:
      ModelError: the model has no hands and feet.
    """
    return hold_constraints(plan_holds(), find_grips(Character.of(character).model, ROPE_RADIUS))


def make_climb(character: CharacterLike) -> Motion:
    """Return the climb.

    Args:
      character: the humanoid, with or without a scene, or what names it.

    Raises:
      ModelError: the model is not the humanoid: joints, sites or limbs are missing.
    """
    character = Character.of(character)
    model = character.model
    grips, holds = find_grips(model, ROPE_RADIUS), plan_holds()
    frames = np.arange(FRAMES)
    targets = []
    for site in LIMBS:
        position, quat = limb_path(site, holds, grips[site], FRAMES)
        targets.append(SiteConstraint(site, frames, position, quat))
    rough = Motion(character, _body(model, frames), FPS)
    rigidity = np.ones(model.nv)
    for joint in ("root", "spine"):
        index = model.joint(joint).id
        rigidity[model.dof_jntid == index] = _STIFF
    solver = HybridIK(character, rigidity)
    return fit(rough, targets, ik=solver, tolerance=0.0, first_guess=False).motion


def _body(model: mujoco.MjModel, frames: NDArray[np.int64]) -> Array:
    """Return qpos (n, nq): root and spine as planned, the limbs only roughly."""
    from scipy.interpolate import CubicSpline

    table = _BODY
    while table[-1, 0] < frames[-1]:
        again = _BODY[_HANG:].copy()
        again[:, :2] += (len(table) // (len(_BODY) - _HANG)) * np.array((_CYCLE, RISE))
        table = np.concatenate((table, again))
    values = CubicSpline(table[:, 0], table[:, 1:], bc_type="clamped")(frames)
    rise, x, y = values[:, :3].T
    pitch, roll, turn, spine_pitch, spine_roll, spine_turn, look = np.deg2rad(values[:, 3:]).T
    zero = np.zeros_like(rise)
    qpos = np.tile(model.qpos0, (len(frames), 1))
    qpos[:, 0], qpos[:, 1], qpos[:, 2] = x, y, _PELVIS + rise
    qpos[:, 3:7] = multiply(yaw_quat(turn), exp(np.column_stack((roll, pitch, zero))))
    _set(model, qpos, "spine", np.column_stack((spine_roll, spine_pitch, spine_turn)))
    for name, share in zip(("neck", "head"), _LOOK, strict=True):
        _set(model, qpos, name, np.column_stack((zero, -share * look, zero)))
    for side, sign in (("left", 1.0), ("right", -1.0)):
        for (ball, hinge), directions in _BENT.items():
            upper, lower = (normalized(np.array((x, sign * y, z))) for x, y, z in directions)
            turn, angle = _bend(upper, lower, -1.0 if hinge == "elbow" else 1.0)
            _set(model, qpos, f"{side}_{ball}", np.tile(log(turn), (len(frames), 1)))
            _set(model, qpos, f"{side}_{hinge}", np.full((len(frames), 1), angle))
    return qpos


def _bend(upper: Array, lower: Array, way: float) -> tuple[Array, float]:
    """Return the ball's quaternion and the hinge's angle [rad] that give a limb these directions.

    Both parts lie along -z at rest; the hinge turns about y (``way`` 1) or -y (-1).
    """
    cosine = float(upper @ lower)
    x = -way * normalized(lower - cosine * upper)
    return from_matrix(np.column_stack((x, cross(-upper, x), -upper))), float(np.arccos(cosine))


def _set(model: mujoco.MjModel, qpos: Array, joint: str, angles: Array) -> None:
    """Set a joint in all frames of ``qpos``: a hinge's angle, or a ball's rotation vector [rad]."""
    index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, joint)
    if index < 0:
        raise ModelError(f"the built-in climb needs the humanoid: this model lacks '{joint}'")
    address = int(model.jnt_qposadr[index])
    if angles.shape[1] == 1:
        qpos[:, address] = angles[:, 0]
    else:
        qpos[:, address : address + 4] = exp(angles)
