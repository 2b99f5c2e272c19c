"""Put the parts of a mapped clip together: where it begins, and the joints of its bodies."""

from __future__ import annotations

import mujoco
import numpy as np

from mjmotion.clips.rig import SIDES
from mjmotion.numerics import rotations as rot

Array = rot.Array


def start_of(root: Array, pelvis: Array, fps: float) -> tuple[float, Array]:
    """Return the heading [rad] in which the clip sets off, and where on the ground it begins."""
    start = root[0] * (1.0, 1.0, 0.0)
    away = (root - root[0])[:, :2]
    far = np.linalg.norm(away, axis=1)
    forward = rot.rotate(pelvis, np.array((1.0, 0.0, 0.0)))[:, :2]
    facing = forward[: max(1, int(fps))].mean(axis=0)
    goal = int(np.argmax(far > 1.0)) if (far > 1.0).any() else int(np.argmax(far))
    facing = rot.normalized(forward[: goal + 1].mean(axis=0) if far[goal] > 0.3 else facing)
    travel = away[goal] / max(far[goal], 1e-9)
    # Someone who walks backwards or sideways should face +x, not travel along it.
    heading = travel if far[goal] > 0.3 and travel @ facing > 0.5 else facing
    return float(np.arctan2(heading[1], heading[0])), start


def assemble(
    model: mujoco.MjModel, root: Array, body: dict[str, Array], knees: dict[str, Array]
) -> Array:
    """Return qpos (nframe, nq) from the root's position and the bodies' orientations."""
    qpos = np.tile(model.qpos0, (len(root), 1))
    zero = np.zeros(len(root))

    def put(joint: str, value: Array) -> None:
        at = model.jnt_qposadr[model.joint(joint).id]
        qpos[:, at : at + value.shape[1]] = value

    def ball(joint: str, parent: str, child: str) -> None:
        quat = rot.multiply(rot.conjugate(body[parent]), body[child])
        quat = rot.continuous(quat)
        put(joint, -quat if quat[:, 0].mean() < 0 else quat)

    put("root", np.concatenate([root, rot.continuous(body["pelvis"])], axis=1))
    ball("spine", "pelvis", "torso")
    ball("neck", "torso", "neck")
    ball("head", "neck", "head")
    for side in SIDES:
        arm = rot.multiply(rot.conjugate(body[f"{side}_upper_arm"]), body[f"{side}_forearm"])
        put(f"{side}_elbow", 2 * np.arctan2(-arm[:, 2:3], arm[:, :1]))
        ball(f"{side}_shoulder", "torso", f"{side}_upper_arm")
        ball(f"{side}_wrist", f"{side}_forearm", f"{side}_hand")
        put(f"{side}_knee", knees[side][:, None])
        bend = np.stack([np.cos(knees[side] / 2), zero, np.sin(knees[side] / 2), zero], axis=-1)
        body = body | {f"{side}_shank": rot.multiply(body[f"{side}_thigh"], bend)}
        ball(f"{side}_hip", "pelvis", f"{side}_thigh")
        ball(f"{side}_ankle", f"{side}_shank", f"{side}_foot")
    return qpos
