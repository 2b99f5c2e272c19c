"""Postures of the humanoid that are known: on its knees, on all fours, sitting, on tiptoe."""

from __future__ import annotations

import mujoco
import numpy as np
from made_up import character

from mjmotion.body.kinematics import site_id, site_positions
from mjmotion.body.motion import Motion
from mjmotion.constraints import SiteConstraint
from mjmotion.fitting import fit
from mjmotion.numerics.rotations import conjugate, exp, from_matrix, multiply

FPS = 30.0
_ARM_LEANS = -14.0  # so that a wrist need not bend at a right angle [degrees]
_Y = np.array((0.0, 1.0, 0.0))


def pitch(angle: float) -> np.ndarray:
    """Return the quaternion of a turn about y, forwards [degrees]."""
    return exp(np.radians(angle) * _Y)


def posed(bodies: dict[str, np.ndarray], hinges: dict[str, float]) -> np.ndarray:
    """Return a pose from how bodies are turned in the world, and hinges [degrees].

    Bodies that are not named are turned as what they hang on.
    """
    model = character().model
    pose = np.array(model.qpos0)
    world: dict[str, np.ndarray] = {}
    for body in range(1, model.nbody):
        name = model.body(body).name
        parent = model.body(int(model.body_parentid[body])).name
        above = world.get(parent, np.array((1.0, 0.0, 0.0, 0.0)))
        joint = int(model.body_jntadr[body])
        at, kind = int(model.jnt_qposadr[joint]), int(model.jnt_type[joint])
        if kind == mujoco.mjtJoint.mjJNT_HINGE:
            pose[at] = np.radians(hinges.get(name, 0.0))
            world[name] = multiply(above, exp(pose[at] * model.jnt_axis[joint]))
            continue
        world[name] = bodies.get(name, above)
        at += 3 if kind == mujoco.mjtJoint.mjJNT_FREE else 0
        pose[at : at + 4] = multiply(conjugate(above), world[name])
    return pose


def both(**bodies: np.ndarray) -> dict[str, np.ndarray]:
    return {f"{side}_{name}": q for side in ("left", "right") for name, q in bodies.items()}


def site_heights(pose: np.ndarray, *sites: str) -> np.ndarray:
    """Return the heights of sites in a pose [m]."""
    model = character().model
    ids = np.array([site_id(model, site) for site in sites])
    return site_positions(model, pose[None], ids)[0, :, 2]


def dropped(pose: np.ndarray, *sites: str) -> np.ndarray:
    """Return a pose moved up or down so that the lowest of sites is at z = 0."""
    pose = pose.copy()
    pose[2] -= site_heights(pose, *sites).min()
    return pose


def palm_down(side: str) -> np.ndarray:
    """Return how a hand lies flat on the ground, its fingers ahead."""
    out = 1.0 if side == "left" else -1.0
    return from_matrix(np.array([(0.0, 0.0, -1.0), (-out, 0.0, 0.0), (0.0, out, 0.0)]))


def arm_down(side: str) -> np.ndarray:
    """Return how an arm hangs whose palm shows back."""
    out = 1.0 if side == "left" else -1.0
    return multiply(pitch(_ARM_LEANS), exp(np.array((0.0, 0.0, -0.5 * np.pi * out))))


def both_angles(**hinges: float) -> dict[str, float]:
    return {f"{side}_{name}": angle for side in ("left", "right") for name, angle in hinges.items()}


_KNEELING = both_angles(shank=90.0, toes=-28.0)


def all_fours(trunk: float = 77.66) -> np.ndarray:
    """On hands and knees, the trunk so far forwards that palms and knees are at one height."""
    bodies = {"pelvis": pitch(trunk), "torso": pitch(trunk), "neck": pitch(45.0)}
    bodies |= {"head": pitch(25.0)} | both(thigh=pitch(0.0), foot=pitch(150.0))
    for side in ("left", "right"):
        bodies |= {f"{side}_upper_arm": arm_down(side), f"{side}_hand": palm_down(side)}
    return dropped(posed(bodies, _KNEELING), "left_knee", "left_palm")


def on_knees() -> np.ndarray:
    """Kneeling upright on both knees."""
    return dropped(posed(both(foot=pitch(150.0)), _KNEELING), "left_knee")


def on_one_knee() -> np.ndarray:
    """Kneeling on the right knee, the left foot ahead, flat."""
    bodies = {"left_thigh": pitch(-90.0), "left_foot": pitch(0.0), "right_foot": pitch(150.0)}
    return dropped(posed(bodies, _KNEELING | {"left_toes": 0.0}), "right_knee", "left_heel")


def seated() -> np.ndarray:
    """Sitting on the floor, soles flat on it, hands on the knees."""
    bodies = {"pelvis": pitch(-10.0), "torso": pitch(10.0)} | both(
        thigh=pitch(-136.0), foot=pitch(0.0), upper_arm=pitch(-40.0)
    )
    hinges = {
        "left_shank": 105.0,
        "right_shank": 105.0,
        "left_forearm": 40.0,
        "right_forearm": 40.0,
    }
    return dropped(posed(bodies, hinges), "seat", "left_heel")


def held(*poses: np.ndarray, seconds: float = 1.0, moving: float = 1.0) -> Motion:
    """Return a motion that holds poses for a while each, and moves smoothly between."""
    hold, move = round(seconds * FPS), round(moving * FPS)
    frames = []
    for number, pose in enumerate(poses):
        frames += [pose] * hold
        if number + 1 < len(poses):
            after = poses[number + 1]
            for share in np.arange(1, move) / move:
                s = share * share * (3.0 - 2.0 * share)
                frames.append(_between(pose, after, s))
    model = character().model
    sites = [model.site(i).name for i in range(model.nsite)]
    return Motion(character(), np.array([dropped(pose, *sites) for pose in frames]), FPS)


def _between(first: np.ndarray, second: np.ndarray, share: float) -> np.ndarray:
    model = character().model
    pose = first + share * (second - first)
    for joint in range(model.njnt):
        kind, at = int(model.jnt_type[joint]), int(model.jnt_qposadr[joint])
        if kind > 1:
            continue
        at += 3 if kind == 0 else 0
        one, other = first[at : at + 4], second[at : at + 4]
        blend = one + share * (np.copysign(1.0, one @ other) * other - one)
        pose[at : at + 4] = blend / np.linalg.norm(blend)
    return pose


def crawl(cycles: int = 3, stride: float = 0.25) -> Motion:
    """On all fours, ahead: one knee and the hand across at a time."""
    still = all_fours()
    step = round(0.5 * FPS)
    nframe = 2 * cycles * step + step
    frames = np.arange(nframe)
    pose = np.tile(still, (nframe, 1))
    pose[:, 0] += stride * frames / (2 * step)
    motion = Motion(character(), pose, FPS)
    constraints = []
    sites = ("left_knee", "right_palm"), ("right_knee", "left_palm")
    for parity, pair in enumerate(sites):
        begin = 0.0 if parity == 0 else 0.5
        for name in pair:
            own = site_positions(
                character().model, still[None], np.array([site_id(character().model, name)])
            )[0, 0]
            # It moves for half of each cycle, and stands for the other half.
            phase = frames / (2 * step) - begin
            whole, part = np.floor(phase), phase - np.floor(phase)
            s = np.clip(part / 0.5, 0.0, 1.0)
            ahead = stride * (whole + s * s * (3.0 - 2.0 * s) - 0.25 + begin)
            place = np.tile(own, (nframe, 1))
            place[:, 0] += ahead
            place[:, 2] = 0.05 * np.sin(np.pi * s) ** 2
            constraints.append(SiteConstraint(name, frames, place))
    return fit(motion, constraints, ik="numeric", first_guess=False).motion
