"""Models, poses and a walk that tests make up, with everything about them known."""

from __future__ import annotations

import functools
from typing import TypeVar

import mujoco
import numpy as np

from mjmotion.body.character import Character
from mjmotion.body.motion import Motion
from mjmotion.constraints import Constraint, SiteConstraint
from mjmotion.validation import Validation

T = TypeVar("T")

# What a fit does not look at yet: figures of how a body moves, beside its source. That these hold
# is not claimed of real clips on real scenes; ``make bench`` counts where they are missed.
BESIDE_SOURCE = (
    "trunk_back_deg",
    "head_back_deg",
    "stance_knee_bend_deg",
    "self_overlap_mm",
    "com_acceleration_ratio",
    "contact_kept_percent",
    "unexplained_more_points",
)
# The same for the command line, whose exit code is then that of all other figures.
NOT_BESIDE_SOURCE = tuple(w for name in BESIDE_SOURCE for w in ("--threshold", f"{name}=none"))

# Joints of every kind, off-centre anchors, turned bodies, two sites.
MIXED = """
<mujoco><compiler angle="radian"/><worldbody>
<geom type="plane" size="5 5 .1"/>
<body name="root" pos="0 0 1"><freejoint name="root"/><geom size=".1"/>
  <body name="turned" pos=".1 .05 0" euler=".3 -.2 .5">
    <joint name="ball" type="ball" pos=".02 -.01 .03"/><geom size=".05"/>
    <body name="lower" pos="0 0 -.4" euler="0 .1 0">
      <joint name="hinge" axis=".2 1 .1" pos="0 .01 0" ref=".2"/><geom size=".05"/>
      <body name="tip" pos="0 .02 -.3">
        <joint name="slide" type="slide" axis="0 .3 1"/>
        <joint name="last" type="hinge" axis="1 0 0"/><geom size=".05"/>
        <site name="tip" pos=".05 .01 -.1" euler=".4 .1 0"/>
      </body>
    </body>
  </body>
  <body name="other" pos="-.1 0 0"><joint name="other" axis="0 1 0"/><geom size=".05"/>
    <site name="other" pos="0 0 -.3"/>
  </body>
</body></worldbody></mujoco>"""

HIP, THIGH, SHANK, SOLE = 0.9275, 0.4288, 0.4305, 0.0682  # of the humanoid [m]
STEP_TIME, SWING_TIME = 0.6, 0.4  # of the walk [s]
STEP_LENGTH, STEP_HEIGHT, CROUCH = 0.26, 0.06, 0.05  # [m]


@functools.cache
def character() -> Character:
    """The humanoid, with what it was compiled from: it can be put into scenes."""
    return Character.load("humanoid")


def humanoid() -> mujoco.MjModel:
    return character().model


@functools.cache
def mixed() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(MIXED)


def random_poses(model: mujoco.MjModel, count: int, seed: int, size: float = 0.3) -> np.ndarray:
    """Poses about qpos0, every joint within its limits, knees and elbows well bent."""
    rng = np.random.default_rng(seed)
    qpos = np.tile(model.qpos0, (count, 1))
    for row, step in zip(qpos, size * rng.normal(size=(count, model.nv)), strict=True):
        mujoco.mj_integratePos(model, row, step, 1.0)
    for joint in range(model.njnt):
        if model.joint(joint).name.endswith(("_knee", "_elbow")):
            qpos[:, model.jnt_qposadr[joint]] = rng.uniform(0.5, 1.2, count)
    return Character.of(model).limits.clamp(qpos)


def loop_sites(model: mujoco.MjModel, qpos: np.ndarray) -> np.ndarray:
    """World positions (n, nsite, 3) of all sites, from MuJoCo frame by frame."""
    data = mujoco.MjData(model)
    positions = np.empty((len(qpos), model.nsite, 3))
    for row, pose in enumerate(qpos):
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        positions[row] = data.site_xpos
    return positions


def loop_quats(model: mujoco.MjModel, qpos: np.ndarray, site: str) -> np.ndarray:
    """World orientations (n, 4) of a site, from MuJoCo frame by frame."""
    data, quats = mujoco.MjData(model), np.empty((len(qpos), 4))
    for row, pose in enumerate(qpos):
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        mujoco.mju_mat2Quat(quats[row], data.site(site).xmat)
    return quats


def missed(validation: Validation) -> list[str]:
    """What is beyond its threshold, but for figures that no fit looks at yet."""
    return [name for name in validation.broken() if name not in BESIDE_SOURCE]


def some(value: T | None) -> T:
    """What is there, where the types say that it may be missing."""
    assert value is not None
    return value


def of_site(constraint: Constraint) -> SiteConstraint:
    """A constraint of one site in the world, where the types say that it may be another kind."""
    assert isinstance(constraint, SiteConstraint)
    return constraint


def pin(
    model: mujoco.MjModel, qpos: np.ndarray, site: str, shift: object = 0.0, **options: object
) -> SiteConstraint:
    """A constraint on a site's own pose in every frame, moved by ``shift`` [m]."""
    position = loop_sites(model, qpos)[:, model.site(site).id] + np.asarray(shift)
    quat = loop_quats(model, qpos, site)
    frames = np.arange(len(qpos))
    return SiteConstraint(site, frames, position, quat, **options)  # type: ignore[arg-type]


def foot_track(time: np.ndarray, phase: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A foot's x and height [m] and whether it stands; swings at ``phase`` and every 1.2 s."""
    cycle = 2.0 * STEP_TIME
    count = np.floor((time - phase) / cycle)
    s = np.clip((time - phase - count * cycle) / SWING_TIME, 0.0, 1.0)
    ease = s**3 * (10.0 - 15.0 * s + 6.0 * s * s)
    # In the middle of its stance it is under the hip, which moves evenly.
    middle = STEP_LENGTH / STEP_TIME * (phase + 0.5 * (SWING_TIME + cycle))
    along = middle + 2.0 * STEP_LENGTH * (count + ease - 1.0)
    return along, STEP_HEIGHT * np.sin(np.pi * s) ** 2 * (s < 1.0), (s <= 0.0) | (s >= 1.0)


def walk(seconds: float = 3.0, fps: float = 30.0) -> Motion:
    """A flat-footed walk along +x, legs closed by the law of cosines in the sagittal plane."""
    model = humanoid()
    time = np.arange(round(seconds * fps) + 1) / fps
    qpos = np.tile(model.qpos0, (len(time), 1))
    root_x = STEP_LENGTH / STEP_TIME * time
    root_z = HIP - CROUCH + 0.01 * np.cos(2.0 * np.pi * time / STEP_TIME)
    qpos[:, 0], qpos[:, 2] = root_x, root_z
    for side, phase in (("left", 0.0), ("right", STEP_TIME)):
        along, height, _ = foot_track(time, phase)
        x, z = along - root_x, height + SOLE - root_z
        square = x * x + z * z
        knee = np.arccos((square - THIGH**2 - SHANK**2) / (2.0 * THIGH * SHANK))
        # Turning by +angle about y carries -z towards -x; a bent knee puts the shank further back.
        lead = np.arctan2(SHANK * np.sin(knee), THIGH + SHANK * np.cos(knee))
        hip = np.arctan2(-x, -z) - lead
        for name, angle in ((f"{side}_hip", hip), (f"{side}_ankle", -hip - knee)):
            at = model.joint(name).qposadr[0]
            qpos[:, at], qpos[:, at + 2] = np.cos(angle / 2.0), np.sin(angle / 2.0)
        qpos[:, model.joint(f"{side}_knee").qposadr[0]] = knee
        at = model.joint(f"{side}_shoulder").qposadr[0]
        swing = 0.3 * np.sin(2.0 * np.pi * (time - phase) / (2.0 * STEP_TIME))
        # The arms hang beside the thighs: a little out, so that they touch nothing.
        out = 0.15 if side == "left" else -0.15
        turn = np.column_stack((np.full_like(swing, out), swing, np.zeros_like(swing)))
        for row, vector in zip(qpos, turn, strict=True):
            size = float(np.linalg.norm(vector))
            mujoco.mju_axisAngle2Quat(row[at : at + 4], vector / size, size)
        qpos[:, model.joint(f"{side}_elbow").qposadr[0]] = 0.3
    return Motion(character(), qpos, fps)
