"""Put the figures of one motion together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

from mjmotion.body.motion import Motion
from mjmotion.exceptions import MotionError
from mjmotion.validation.beside_source import BesideSource, Body
from mjmotion.validation.changing import Changing
from mjmotion.validation.figures import (
    JERK_CUTOFF,
    STILL,
    Poses,
    check_pair,
    jerk_dofs,
    joint_jerk,
    poses_of,
    ratio,
    sole_sites,
    source_clearances,
    swing_clearances,
    swings_of,
    travel,
)
from mjmotion.validation.ground import Ground
from mjmotion.validation.inputs import ChangingBody, Contact
from mjmotion.validation.limits import limit_excess
from mjmotion.validation.mapping import floating, mapping_figures
from mjmotion.validation.penetration import CharacterGeoms, penetration
from mjmotion.validation.result import Validation, Worst, asked_clearance
from mjmotion.validation.sheet import Sheet
from mjmotion.validation.stance import Stance
from mjmotion.validation.support import footprint_line, standing_frames
from mjmotion.validation.thresholds import THRESHOLDS, Threshold, merge_thresholds

_MM = 1000.0
TOLD = 0.1  # of a change of the footprints' line by which the root's path may be off that


def validate(
    source: Motion,
    motion: Motion,
    contacts: Sequence[Contact],
    *,
    thresholds: Mapping[str, object] | None = None,
    body: ChangingBody | None = None,
    recording: Motion | None = None,
) -> Validation:
    """Compute every figure of an adapted motion.

    The model is looked at as it is now. To measure many motions on one model, keep a
    :class:`Judge`.

    Args:
      source: the motion before adaptation, on flat ground; same joints and frames.
      motion: the adapted motion; its model holds the character and the scene.
      contacts: who stands when: anything with ``site``, ``start`` and ``end``. Their bodies are
        the feet.
      thresholds: changes to ``THRESHOLDS``, by name.
      body: the character's size in every frame of ``motion``, where that changes.
      recording: the source in its own time, of other frames, where the motion's is another.

    Returns:
      The figures.

    Raises:
      MotionError: source, motion and contacts do not belong together, or a threshold is unknown.
    """
    merge_thresholds(thresholds)  # a wrong one is told before any work is done
    check_pair(source, motion, contacts)
    return Judge(motion.model, contacts).validate(
        source, motion, thresholds=thresholds, body=body, recording=recording
    )


class Judge:
    """The shapes of a model's scene and character, kept for many motions with the same contacts.

        judge = Judge(motion.model, contacts)
        judge.validate(source, motion).broken()

    They are those of when it was made: after a change of the model make a new one.

    Args:
      model: holds the character and the scene.
      contacts: who stands when. Their bodies are the feet.
    """

    def __init__(self, model: mujoco.MjModel, contacts: Sequence[Contact]) -> None:
        self.model, self.contacts = model, tuple(contacts)
        self.sites = sole_sites(model, self.contacts)
        self.feet = tuple(sorted({int(model.site_bodyid[site]) for site in self.sites}))
        self.ground = Ground(model)
        self.geoms = CharacterGeoms.of(model, self.feet)
        self.body = Body(model, self.geoms.ids, self.sites)

    def validate(
        self,
        source: Motion,
        motion: Motion,
        *,
        thresholds: Mapping[str, object] | None = None,
        body: ChangingBody | None = None,
        recording: Motion | None = None,
    ) -> Validation:
        """Compute every figure of an adapted motion: arguments and errors as :func:`validate`.

        Raises:
          MotionError: also if the motion is on another model than this is for.
        """
        merged = merge_thresholds(thresholds)
        if motion.model is not self.model:
            raise MotionError("the motion is on another model: make a Judge of motion.model")
        check_pair(source, motion, self.contacts)
        if recording is not None:
            check_pair(recording, recording, ())
            if recording.model.nq != motion.model.nq:
                raise MotionError("the recording is of another character than the motion")
        return _Figures(self, source, motion, body, recording).collect(merged)


class _Figures(Sheet):
    """Collects figures, and where each is worst, from one pair of motions."""

    def __init__(
        self,
        judge: Judge,
        source: Motion,
        motion: Motion,
        body: ChangingBody | None,
        recording: Motion | None = None,
    ) -> None:
        super().__init__()
        self.source, self.motion, self.contacts = source, motion, judge.contacts
        self.recorded = source if recording is None else recording
        self.model, self.ground, self.geoms = judge.model, judge.ground, judge.geoms
        self.sites, self.feet = judge.sites, judge.feet
        self.changing = None if body is None else Changing(motion, body, self.geoms, self.ground)
        self.poses: Poses = (
            poses_of(motion, self.geoms) if self.changing is None else self.changing.poses
        )
        self.before = poses_of(source, self.geoms)
        self.beside = BesideSource(
            self,
            judge.body,
            source,
            motion,
            judge.contacts,
            changing=body,
            recording=recording,
        )
        self.per_contact: list[dict[str, Any]] = []
        self.per_swing: list[dict[str, Any]] = []
        self.per_joint: dict[str, tuple[float, float]] = {}

    def collect(self, thresholds: dict[str, Threshold]) -> Validation:
        """Return all figures, beside the thresholds given."""
        self.standing()
        self.penetrations()
        self.swinging()
        self.joint_limits()
        self.jerks()
        self.travelling()
        self.beside.posture()
        self.beside.stances(self.ground, self.poses.site, self.before.site)
        self.beside.centre_of_mass()
        self.beside.self_overlap()
        floating(self, self.contacts, self.motion)
        if self.recorded.recording is not None:
            mapping_figures(self, self.recorded, self.recorded.recording)
        return Validation(
            metrics={name: float(value) for name, value in self.metrics.items()},
            worst=self.worst,
            per_contact=self.per_contact,
            per_swing=self.per_swing,
            per_frame=self.per_frame,
            per_joint=self.per_joint,
            thresholds=thresholds,
            fps=self.motion.fps,
            nframe=self.motion.nframe,
        )

    def standing(self) -> None:
        """Drift, gap and skate of every contact, and heights of soles over all frames."""
        position = self.poses.site[:, self.sites]
        stance = Stance(self.ground, self.sites, position, self.contacts, self.motion.fps)
        self.per_contact, frames = stance.per_contact(), stance.per_frame()
        self.per_frame.update(frames)
        if not self.contacts:
            return
        worst = max(self.per_contact, key=lambda entry: entry["drift_mm"])
        self.note("stance_drift_mm", worst["drift_mm"], worst["drift_frame"], worst["site"])
        speed = stance.mean_speed()
        if not np.isnan(speed):
            fastest = max(self.per_contact, key=lambda entry: entry["skate_mm_s"])
            place = f"{fastest['site']} from frame {fastest['start']}"
            self.note("foot_skate_mm_s", speed, None, f"{place}: {fastest['skate_mm_s']:.1f}")
        for gap in stance.gaps():
            self.metrics[gap.name], self.worst[gap.name] = gap.value, gap.worst

    def penetrations(self) -> None:
        """How deep feet and all other bodies are in the scene."""
        depth, other = (
            penetration(self.ground, self.geoms, self.poses.geom, self.poses.turn)
            if self.changing is None
            else self.changing.penetration()
        )
        foot = self.geoms.foot
        for name, group in (
            ("sole_penetration_mm", foot),
            ("obstacle_penetration_mm", ~foot),
        ):
            columns = np.flatnonzero(group)
            if len(columns) == 0:
                self.per_frame[name] = np.zeros(self.motion.nframe)
                continue
            deep = depth[:, columns] * _MM
            self.per_frame[name] = deep.max(axis=1)
            frame, i = np.unravel_index(deep.argmax(), deep.shape)
            value = float(deep[frame, i])
            self.metrics[name] = value
            if value > 0:
                body = int(self.model.geom_bodyid[self.geoms.ids[columns[i]]])
                against = self.ground.name(int(other[frame, columns[i]]))
                self.worst[name] = Worst(int(frame), f"{self.model.body(body).name} in {against}")

    def swinging(self) -> None:
        """How high soles pass over the ground, beside the source's own."""
        swings = swings_of(self.feet, self.model, self.contacts, self.motion)
        if not swings:
            return
        mine = (
            swing_clearances(swings, self.ground, self.geoms, self.poses)
            if self.changing is None
            else self.changing.clearances(swings)
        )
        theirs = source_clearances(swings, self.contacts, self.model, self.geoms, self.before)
        for swing, (clear, frame), (own, _) in zip(swings, mine, theirs, strict=True):
            self.per_swing.append(
                {
                    "foot": self.model.body(swing.foot).name,
                    "start": swing.start,
                    "end": swing.end,
                    "clearance_mm": clear * _MM,
                    "frame": frame,
                    "source_clearance_mm": own * _MM,
                }
            )
        # The swing that comes out worst against what is asked of it, beside its own source.
        least = THRESHOLDS["swing_clearance_mm"]
        assert isinstance(least, float)
        spare = [
            swing["clearance_mm"] - asked_clearance(least, swing["source_clearance_mm"])
            for swing in self.per_swing
        ]
        number = int(np.argmin(spare))
        foot = self.per_swing[number]["foot"]
        for name, (clear, frame) in (
            ("swing_clearance_mm", mine[number]),
            ("source_swing_clearance_mm", theirs[number]),
        ):
            if np.isfinite(clear):
                self.note(name, clear * _MM, frame, foot)

    def joint_limits(self) -> None:
        """Excess over joint ranges."""
        excess, names = limit_excess(self.model, self.motion.qpos)
        self.per_frame["joint_limit_rad"] = excess.max(axis=1, initial=0.0)
        self.metrics["joint_limit_rad"] = float(excess.max(initial=0.0))
        if self.metrics["joint_limit_rad"] > 0:
            frame, i = np.unravel_index(excess.argmax(), excess.shape)
            self.worst["joint_limit_rad"] = Worst(int(frame), names[i])

    def jerks(self) -> None:
        """Third derivatives of joint angles, adapted over source: low-passed, and as they come."""
        both = (self.motion, self.source)
        adapted, own = (joint_jerk(one, JERK_CUTOFF) for one in both)
        for name, jerk in (("jerk_rms", adapted), ("source_jerk_rms", own)):
            whole = np.full(self.motion.nframe, np.nan)
            if jerk.size:
                whole[: len(jerk)] = np.sqrt(np.mean(jerk**2, axis=1))
            self.per_frame[name] = whole
        if adapted.size == 0:
            return
        dof_joint = self.model.dof_jntid[jerk_dofs(self.model)]
        for joint in np.unique(dof_joint):
            columns = dof_joint == joint
            self.per_joint[self.model.joint(int(joint)).name] = (
                float(np.sqrt(np.mean(adapted[:, columns] ** 2))),
                float(np.sqrt(np.mean(own[:, columns] ** 2))),
            )
        roughest = max(
            self.per_joint, key=lambda name: self.per_joint[name][0] - self.per_joint[name][1]
        )
        for prefix, pair in (("", (adapted, own)), ("raw_", [joint_jerk(one) for one in both])):
            size = [float(np.sqrt(np.mean(jerk**2))) for jerk in pair]
            high = [float(np.percentile(np.abs(jerk), 99.9)) for jerk in pair]
            self.note(f"{prefix}jerk_ratio_rms", ratio(size[0], size[1]), None, roughest)
            frame, i = np.unravel_index(np.abs(pair[0]).argmax(), adapted.shape)
            where = self.model.joint(int(dof_joint[i])).name
            self.note(f"{prefix}jerk_ratio_p999", ratio(high[0], high[1]), int(frame), where)

    def travelling(self) -> None:
        """How far the root goes over the ground, and from where to where."""
        (path, away), (own_path, own_away) = travel(self.motion.qpos), travel(self.source.qpos)
        sites = self.beside.sites
        held = standing_frames(self.model, sites, self.contacts, self.motion.nframe)
        line, own_line = (
            footprint_line(poses.site[:, sites], held) for poses in (self.poses, self.before)
        )
        # Steps of other lengths, and another way, take the root along: as far as they tell.
        change, told = line - own_line, TOLD * abs(line - own_line)
        asked = float(np.clip(path, own_path + change - told, own_path + change + told))
        for name, own, before in (
            ("root_travel_ratio", path, asked),
            ("root_displacement_ratio", away, own_away),
        ):
            self.note(name, ratio(own, before, STILL), None, f"{own:.2f} m of {before:.2f} m")
