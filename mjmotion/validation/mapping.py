"""Figures of a motion beside the recording that it was made of: bones, feet, facing, noise.

The recording comes as plain arrays, by role; where each role's joint is to be, is told by a body of
the character. It may be elsewhere on the ground and turned about the vertical, and everything is
measured after one turn for the whole clip, which brings its bones nearest to the motion's.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.motion import Motion
from mjmotion.validation.inputs import Contact, Recorded
from mjmotion.validation.lowpass import HIGHEST, low_pass
from mjmotion.validation.sheet import Sheet

Array = NDArray[np.float64]

TURN_CUTOFF = 6.0  # [Hz] of the low-pass of what a foot turns
TURN_SHARE = 95.0  # percentile of the differences in that which counts
STANDS = 0.4  # [m/s] a recorded ball that is slower stands
NOISE_CUTOFF = 10.0  # [Hz] what a recorded joint does faster is taken for noise
HEIGHT_SHARE = 5.0  # percentile of a foot's heights at which it stands
_MM = 1000.0
_PARTS = (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"))
_SIDES = ("left", "right")
_PARENTS = {"hip": "pelvis", "knee": "hip", "ankle": "knee", "elbow": "shoulder", "wrist": "elbow"}


@dataclasses.dataclass(frozen=True, eq=False)
class _Pair:
    """A recording and a motion, both by role.

    Attributes:
      roles: role to column.
      recorded: (nframe, nrole, 3) after the turn [m].
      motion: (nframe, nrole, 3) origins of the bodies [m].
      floor: (nframe, nrole) under the recorded joints [m].
    """

    roles: dict[str, int]
    recorded: Array
    motion: Array
    floor: Array

    def line(self, first: str, last: str) -> tuple[Array, Array]:
        """Return directions (nframe, 3) from one role to another: recorded, and the motion's."""
        a, b = self.roles[first], self.roles[last]
        return _unit(self.recorded[:, b] - self.recorded[:, a]), _unit(
            self.motion[:, b] - self.motion[:, a]
        )


def mapping_figures(sheet: Sheet, source: Motion, recording: Recorded) -> None:
    """Note how a motion differs from its recording.

    Args:
      sheet: where to.
      source: the motion that was made of it.
      recording: what it was made of, as many frames.
    """
    sheet.note("recording_noise_deg", *noise(recording, source.fps))
    model = source.model
    names = {model.body(i).name: i for i in range(model.nbody)}
    known = [i for i, body in enumerate(recording.bodies) if body in names]
    if not known:
        return
    place, turn = _bodies(source, [names[recording.bodies[i]] for i in known])
    roles = {recording.roles[i]: column for column, i in enumerate(known)}
    pair = _turned(_Pair(roles, recording.positions[:, known], place, recording.floor[:, known]))
    _bones(sheet, pair)
    _facing(sheet, pair)
    _foot_heights(sheet, pair)
    _foot_turns(sheet, pair, (np.asarray(recording.turns)[:, known], turn), source.fps)


def _foot_turns(sheet: Sheet, pair: _Pair, turns: tuple[Array, Array], fps: float) -> None:
    """How much faster or slower feet that stand turn about the vertical than recorded.

    Args:
      sheet: where to.
      pair: both, by role.
      turns: (nframe, nrole, 4) orientations, recorded and of the motion.
      fps: frames a second.
    """
    for side in _SIDES:
        column = pair.roles.get(f"{side}_ankle")
        if column is None:
            continue
        before, own = (turn_rate(quats[:, column], fps) for quats in turns)
        sheet.per_frame[f"foot_turn_deg_s/{side}"] = own
        sheet.per_frame[f"recorded_foot_turn_deg_s/{side}"] = before
        ball = pair.recorded[:, pair.roles.get(f"{side}_toe", column)]
        smooth = low_pass(ball, TURN_CUTOFF, fps)
        speed = np.linalg.norm(np.gradient(smooth, axis=0), axis=1) * fps if len(ball) > 1 else 0.0
        stands = np.broadcast_to(speed < STANDS, own.shape)
        if not stands.any():
            continue
        off = np.where(stands, np.abs(own - before), 0.0)
        worst, value = int(off.argmax()), float(np.percentile(off[stands], TURN_SHARE))
        if not value <= sheet.metrics["mapping_foot_turn_deg_s"]:
            where = f"{side} foot: {own[worst]:.0f}°/s, recorded {before[worst]:.0f}"
            sheet.note("mapping_foot_turn_deg_s", value, worst, where)


def beside_recording(
    source: Motion, recording: Recorded, contacts: Sequence[Contact]
) -> dict[str, float]:
    """Return the figures of a motion beside its recording by name, without judging anything else.

    Args:
      source: the motion that was made of it.
      recording: what it was made of, as many frames.
      contacts: who stands when in the motion.
    """
    sheet = Sheet()
    floating(sheet, contacts, source)
    mapping_figures(sheet, source, recording)
    return dict(sheet.metrics)


def floating(sheet: Sheet, contacts: Sequence[Contact], motion: Motion) -> None:
    """Note how many contacts there are, and for how long there is none.

    Args:
      sheet: where to.
      contacts: who stands when.
      motion: says how many frames there are, at which rate.
    """
    free = np.ones(motion.nframe, dtype=bool)
    for contact in contacts:
        free[contact.start : contact.end] = False
    edges = np.flatnonzero(np.diff(np.concatenate(([0], free.astype(np.int8), [0]))))
    sheet.metrics["contact_count"] = len(contacts)
    sheet.metrics["floating_percent"] = 100.0 * float(free.mean())
    if len(edges) == 0:
        sheet.metrics["floating_longest_s"] = 0.0
        return
    start, end = max(edges.reshape(-1, 2).tolist(), key=lambda run: run[1] - run[0])
    length = (end - start) / motion.fps
    sheet.note("floating_longest_s", length, start, f"to {end - 1}")


def turn_rate(quats: Array, fps: float) -> Array:
    """Return how fast something turns about the vertical (nframe,) [°/s], low-passed at 6 Hz.

    Args:
      quats: (nframe, 4) its orientations in the world, wxyz.
      fps: frames a second.
    """
    step = np.zeros(len(quats))
    step[1:] = 2.0 * _local_log(quats[:-1], quats[1:], world=True)[:, 2]
    path = low_pass(np.cumsum(step), TURN_CUTOFF, fps)
    if len(path) < 2:
        return np.zeros(len(path))
    return np.asarray(np.degrees(np.gradient(path)) * fps)


def noise(recording: Recorded, fps: float) -> tuple[float, None, str]:
    """Return how noisy a recording is [°], and which of its joints is noisiest.

    Of each joint of arms and legs, and of the pelvis, the turns against the joint that it hangs on,
    from frame to frame, are added up; what of that is faster than :data:`NOISE_CUTOFF` has an RMS
    over frames and axes. White noise has only part of its power up there, which is taken into
    account: the figure is what noise as great at all frequencies would be. It is the median over
    the joints. NaN where the frame rate tells nothing so fast.
    """
    share = 1.0 - 2.0 * NOISE_CUTOFF / fps
    if HIGHEST * fps <= NOISE_CUTOFF or len(recording.turns) < 5:
        return np.nan, None, ""
    columns = {role: i for i, role in enumerate(recording.roles)}
    found = {}
    for role, column in columns.items():
        side, _, part = role.rpartition("_")
        above = _PARENTS.get(part)
        if above is None and part != "pelvis":
            continue
        turns = np.asarray(recording.turns[:, column])
        if above is not None:
            parent = columns.get(above if above == "pelvis" else f"{side}_{above}")
            if parent is None:
                continue
            turns = _product(_inverse(np.asarray(recording.turns[:, parent])), turns)
        path = np.zeros((len(turns), 3))
        path[1:] = np.cumsum(2.0 * _local_log(turns[:-1], turns[1:]), axis=0)
        fast = path - low_pass(path, NOISE_CUTOFF, fps)
        found[role] = float(np.degrees(np.sqrt(np.mean(fast**2) / share)))
    if not found:
        return np.nan, None, ""
    worst = max(found, key=lambda role: found[role])
    return float(np.median(list(found.values()))), None, f"{worst}: {found[worst]:.2f}"


def _bones(sheet: Sheet, pair: _Pair) -> None:
    """Angles between the recorded bones of arms and legs, and the trunk, and the motion's."""
    angles = {}
    for side in _SIDES:
        for first, last in _PARTS:
            ends = f"{side}_{first}", f"{side}_{last}"
            if all(role in pair.roles for role in ends):
                angles[f"{side} {first} to {last}"] = _angle(*pair.line(*ends))
    low_ends, high_ends = _middles(pair, "hip"), _middles(pair, "shoulder")
    if low_ends is not None and high_ends is not None:
        (low, own_low), (high, own_high) = low_ends, high_ends
        angles["hips to shoulders"] = _angle(_unit(high - low), _unit(own_high - own_low))
    if not angles:
        return
    table = np.stack(list(angles.values()))
    frame = int(table.max(axis=0).argmax())
    means = {name: float(angle.mean()) for name, angle in angles.items()}
    worst = max(means, key=lambda name: means[name])
    sheet.per_frame["mapping_bone_deg"] = table.mean(axis=0)
    sheet.note("mapping_bone_deg", float(table.mean()), None, f"{worst}: {means[worst]:.1f}")
    name = list(angles)[int(table[:, frame].argmax())]
    most = f"{name}: {table[:, frame].max():.1f}"
    sheet.note("mapping_bone_p95_deg", float(np.percentile(table, 95.0)), frame, most)


def _facing(sheet: Sheet, pair: _Pair) -> None:
    """How far the motion faces another way than the recording: the line from hip to hip."""
    if not {"left_hip", "right_hip"} <= set(pair.roles):
        return
    before, own = pair.line("right_hip", "left_hip")
    off = np.degrees(np.abs(_plane_angle(before, own)))
    frame = int(off.argmax())
    sheet.per_frame["mapping_facing_deg"] = off
    sheet.note("mapping_facing_deg", float(np.percentile(off, 95.0)), frame, f"{off[frame]:.1f}")


def _foot_heights(sheet: Sheet, pair: _Pair) -> None:
    """How much higher or lower over the floor ankles are than recorded.

    What an ankle has over the floor as its foot stands is its body's own: the lowest 5 % of its
    heights are taken for one another.
    """
    name = "mapping_foot_height_mm"
    for side in _SIDES:
        column = pair.roles.get(f"{side}_ankle")
        if column is None:
            continue
        before = pair.recorded[:, column, 2] - pair.floor[:, column]
        own = pair.motion[:, column, 2]
        before, own = (h - np.percentile(h, HEIGHT_SHARE) for h in (before, own))
        sheet.per_frame[f"{name}/{side}"] = (own - before) * _MM
        off = np.abs(own - before) * _MM
        value, frame = float(np.percentile(off, 95.0)), int(off.argmax())
        if not value <= sheet.metrics[name]:
            sheet.note(name, value, frame, f"{side} ankle: {off[frame]:.0f}")
    used = [pair.roles[f"{side}_ankle"] for side in _SIDES if f"{side}_ankle" in pair.roles]
    if used:
        sheet.note("recording_floor_mm", float(np.ptp(pair.floor[:, used])) * _MM, None, "")


def _turned(pair: _Pair) -> _Pair:
    """Return the pair after the one turn about z that brings all recorded lines nearest."""
    before, own = (
        places - places[:, pair.roles.get("pelvis", 0)][:, None]
        for places in (pair.recorded, pair.motion)
    )
    cross = (before[..., 0] * own[..., 1] - before[..., 1] * own[..., 0]).sum()
    yaw = np.arctan2(cross, (before[..., :2] * own[..., :2]).sum())
    cos, sin = np.cos(yaw), np.sin(yaw)
    turn = np.array(((cos, -sin, 0.0), (sin, cos, 0.0), (0.0, 0.0, 1.0)))
    return dataclasses.replace(pair, recorded=pair.recorded @ turn.T)


def _bodies(motion: Motion, bodies: list[int]) -> tuple[Array, Array]:
    """Return places (nframe, n, 3) [m] and orientations (nframe, n, 4) of bodies."""
    data = mujoco.MjData(motion.model)
    place, turn = (
        np.empty((motion.nframe, len(bodies), 3)),
        np.empty((motion.nframe, len(bodies), 4)),
    )
    for frame, pose in enumerate(motion.qpos):  # MuJoCo poses one frame at a time
        data.qpos[:] = pose
        mujoco.mj_kinematics(motion.model, data)
        place[frame], turn[frame] = data.xpos[bodies], data.xquat[bodies]
    return place, turn


def _middles(pair: _Pair, part: str) -> tuple[Array, Array] | None:
    columns = [pair.roles[f"{side}_{part}"] for side in _SIDES if f"{side}_{part}" in pair.roles]
    if len(columns) < 2:
        return None
    return pair.recorded[:, columns].mean(axis=1), pair.motion[:, columns].mean(axis=1)


def _unit(vector: Array) -> Array:
    return np.asarray(vector / np.maximum(np.linalg.norm(vector, axis=-1, keepdims=True), 1e-9))


def _angle(a: Array, b: Array) -> Array:
    """Return the angles [°] between unit vectors (nframe, 3)."""
    return np.asarray(np.degrees(np.arccos(np.clip((a * b).sum(axis=-1), -1.0, 1.0))))


def _plane_angle(a: Array, b: Array) -> Array:
    """Return the angles (nframe,) [rad] from a to b, seen from above."""
    cross = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return np.asarray(np.arctan2(cross, (a[:, :2] * b[:, :2]).sum(axis=1)))


def _inverse(quat: Array) -> Array:
    return np.asarray(quat * (1.0, -1.0, -1.0, -1.0))


def _product(a: Array, b: Array) -> Array:
    """Return products of quaternions (n, 4)."""
    scalar = a[:, :1] * b[:, :1] - (a[:, 1:] * b[:, 1:]).sum(axis=1, keepdims=True)
    vector = a[:, :1] * b[:, 1:] + b[:, :1] * a[:, 1:] + np.cross(a[:, 1:], b[:, 1:])
    return np.concatenate((scalar, vector), axis=1)


def _local_log(first: Array, last: Array, *, world: bool = False) -> Array:
    """Return half rotation vectors (n, 3) [rad] from one orientation to another.

    In the axes of the first, or in those of the world.
    """
    step = _product(last, _inverse(first)) if world else _product(_inverse(first), last)
    step = np.where(step[:, :1] < 0.0, -step, step)
    size = np.linalg.norm(step[:, 1:], axis=1, keepdims=True)
    half = np.arctan2(size, step[:, :1])
    return np.asarray(step[:, 1:] * np.where(size > 1e-12, half / np.maximum(size, 1e-12), 1.0))
