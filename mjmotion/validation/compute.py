"""Put the figures of one motion together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.joint_limits import JointLimits
from mjmotion.body.morph_body import MorphBody
from mjmotion.body.motion import Motion
from mjmotion.footsteps.contacts import Contact
from mjmotion.validation.changing import Changing
from mjmotion.validation.figures import (
    Poses,
    check_pair,
    contact_frames,
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
from mjmotion.validation.ground import ground_of
from mjmotion.validation.penetration import Character, character_of, penetration
from mjmotion.validation.result import LABELS, Validation, Worst, asked_clearance
from mjmotion.validation.thresholds import THRESHOLDS, merge_thresholds

_MM = 1000.0


def validate(
    source: Motion,
    motion: Motion,
    contacts: Sequence[Contact],
    *,
    thresholds: Mapping[str, object] | None = None,
    body: MorphBody | None = None,
) -> Validation:
    """Compute every figure of an adapted motion.

    What is known of a model's shapes is kept for the next motion on the same ``MjModel``: compile
    a new one rather than change geoms in place.

    Args:
      source: the motion before adaptation, on flat ground; same joints and frames.
      motion: the adapted motion; its model holds the character and the scene.
      contacts: who stands when. Their bodies are the feet.
      thresholds: changes to ``THRESHOLDS``, by name.
      body: the character's size in every frame of ``motion``, where that changes.

    Returns:
      The figures.

    Raises:
      MotionError: source, motion and contacts do not belong together, or a threshold is unknown.
    """
    merged = merge_thresholds(thresholds)
    check_pair(source, motion, contacts)
    return _Validator(source, motion, tuple(contacts), body).run(merged)


class _Validator:
    """Collects figures, and where each is worst, from one pair of motions."""

    def __init__(
        self,
        source: Motion,
        motion: Motion,
        contacts: tuple[Contact, ...],
        body: MorphBody | None,
    ) -> None:
        self.source, self.motion, self.contacts = source, motion, contacts
        self.model: mujoco.MjModel = motion.model
        self.sites = sole_sites(self.model, contacts)
        self.feet = tuple(sorted({int(self.model.site_bodyid[site]) for site in self.sites}))
        self.ground = ground_of(self.model)
        self.character: Character = character_of(self.model, self.feet)
        self.changing = (
            None if body is None else Changing(motion, body, self.character, self.ground)
        )
        self.poses: Poses = (
            poses_of(motion, self.character) if self.changing is None else self.changing.poses
        )
        self.metrics = dict.fromkeys(LABELS, np.nan)
        self.worst: dict[str, Worst] = {}
        self.per_frame: dict[str, NDArray[Any]] = {}
        self.per_contact: list[dict[str, Any]] = []
        self.per_swing: list[dict[str, Any]] = []
        self.per_joint: dict[str, tuple[float, float]] = {}

    def run(self, thresholds: dict[str, Any]) -> Validation:
        self.standing()
        self.penetrations()
        self.swinging()
        self.joint_limits()
        self.jerks()
        self.travelling()
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

    def note(self, name: str, value: float, frame: int | None, where: str) -> None:
        self.metrics[name] = value
        self.worst[name] = Worst(frame, where)

    def standing(self) -> None:
        """Drift, gap and skate of every contact, and heights of soles over all frames."""
        column = {site: i for i, site in enumerate(self.sites)}
        place = self.poses.site[:, self.sites]
        height, under = self.ground.heights(place.reshape(-1, 3))
        height, under = height.reshape(place.shape[:2]), under.reshape(place.shape[:2])
        gap = np.abs(place[:, :, 2] - height)
        gap[under < 0] = np.inf  # stands on nothing
        soft = (under >= 0) & (
            self.model.geom_type[np.maximum(under, 0)] == mujoco.mjtGeom.mjGEOM_HFIELD
        )
        which, frame = contact_frames(self.contacts)
        held = np.zeros(place.shape[:2], dtype=bool)
        skate: list[NDArray[np.float64]] = []
        for contact in self.contacts:
            i = column[self.model.site(contact.site).id]
            span = slice(contact.start, contact.end)
            held[span, i] = True
            drift = np.linalg.norm(place[span, i] - place[span, i].mean(axis=0), axis=1)
            speed = np.linalg.norm(np.diff(place[span, i, :2], axis=0), axis=1) * self.motion.fps
            skate.append(speed)
            drifted = int(drift.argmax())
            gapped = int(gap[span, i].argmax())
            geom = int(under[contact.start + gapped, i])
            self.per_contact.append(
                {
                    "site": contact.site,
                    "start": contact.start,
                    "end": contact.end,
                    "drift_mm": float(drift[drifted] * _MM),
                    "drift_frame": contact.start + drifted,
                    "gap_mm": float(gap[contact.start + gapped, i] * _MM),
                    "gap_frame": contact.start + gapped,
                    "skate_mm_s": float(speed.mean() * _MM) if len(speed) else 0.0,
                    "ground": self.ground.name(geom),
                    "ground_kind": "hfield" if soft[contact.start + gapped, i] else "solid",
                }
            )
        for i, site in enumerate(self.sites):
            name = self.model.site(site).name
            self.per_frame[f"height_m/{name}"] = place[:, i, 2].copy()
            self.per_frame[f"ground_m/{name}"] = height[:, i].copy()
            self.per_frame[f"gap_mm/{name}"] = np.where(held[:, i], gap[:, i] * _MM, np.nan)
            self.per_frame[f"contact/{name}"] = held[:, i].copy()
        if not self.contacts:
            return
        drifts = [entry["drift_mm"] for entry in self.per_contact]
        worst = self.per_contact[int(np.argmax(drifts))]
        self.note("stance_drift_mm", worst["drift_mm"], worst["drift_frame"], worst["site"])
        speeds = np.concatenate(skate)
        if len(speeds):
            fastest = max(self.per_contact, key=lambda entry: entry["skate_mm_s"])
            self.note(
                "foot_skate_mm_s",
                float(speeds.mean() * _MM),
                None,
                f"{fastest['site']} from frame {fastest['start']}: {fastest['skate_mm_s']:.1f}",
            )
        columns = np.array([column[self.model.site(c.site).id] for c in self.contacts])[which]
        gaps, on_field = gap[frame, columns] * _MM, soft[frame, columns]
        stands = np.array([contact.stands for contact in self.contacts])[which]
        for name, group, share in (
            ("stance_gap_max_mm", stands & ~on_field, 100.0),
            ("stance_gap_hfield_p95_mm", stands & on_field, 95.0),
        ):
            if group.any():
                value = gaps[group].max() if share == 100 else np.percentile(gaps[group], share)
                k = np.flatnonzero(group)[gaps[group].argmax()]
                geom = int(under[frame[k], columns[k]])
                site = self.contacts[which[k]].site
                where = f"{site} over {self.ground.name(geom)}"
                if share != 100:
                    where += f": {gaps[k]:.2f} mm"
                self.note(name, float(value), int(frame[k]), where)

    def penetrations(self) -> None:
        """How deep feet and all other bodies are in the scene."""
        depth, other = (
            penetration(self.ground, self.character, self.poses.geom, self.poses.turn)
            if self.changing is None
            else self.changing.penetration()
        )
        foot = self.character.foot
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
                body = int(self.model.geom_bodyid[self.character.geoms[columns[i]]])
                against = self.ground.name(int(other[frame, columns[i]]))
                self.worst[name] = Worst(int(frame), f"{self.model.body(body).name} in {against}")

    def swinging(self) -> None:
        """How high soles pass over the ground, beside the source's own."""
        swings = swings_of(self.feet, self.model, self.contacts, self.motion)
        if not swings:
            return
        mine = (
            swing_clearances(swings, self.ground, self.character, self.poses)
            if self.changing is None
            else self.changing.clearances(swings)
        )
        before = poses_of(self.source, self.character)
        theirs = source_clearances(swings, self.contacts, self.model, self.character, before)
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
        limits = JointLimits(self.model)
        excess = limits.excess(self.motion.qpos)
        self.per_frame["joint_limit_rad"] = excess.max(axis=1, initial=0.0)
        self.metrics["joint_limit_rad"] = float(excess.max(initial=0.0))
        if self.metrics["joint_limit_rad"] > 0:
            frame, i = np.unravel_index(excess.argmax(), excess.shape)
            self.worst["joint_limit_rad"] = Worst(int(frame), limits.names[i])

    def jerks(self) -> None:
        """Third derivatives of joint angles, adapted over source."""
        adapted, own = joint_jerk(self.motion), joint_jerk(self.source)
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
        frame, i = np.unravel_index(np.abs(adapted).argmax(), adapted.shape)
        where = self.model.joint(int(dof_joint[i])).name
        self.note(
            "jerk_ratio_rms",
            ratio(float(np.sqrt(np.mean(adapted**2))), float(np.sqrt(np.mean(own**2)))),
            None,
            max(self.per_joint, key=lambda name: self.per_joint[name][0] - self.per_joint[name][1]),
        )
        high = [float(np.percentile(np.abs(jerk), 99.9)) for jerk in (adapted, own)]
        self.note("jerk_ratio_p999", ratio(*high), int(frame), where)

    def travelling(self) -> None:
        """How far the root goes over the ground."""
        (path, away), (own_path, own_away) = travel(self.motion.qpos), travel(self.source.qpos)
        if own_path > 0:
            self.note(
                "root_travel_ratio", path / own_path, None, f"{path:.2f} m of {own_path:.2f} m"
            )
        if own_away > 0:
            self.note(
                "root_displacement_ratio",
                away / own_away,
                None,
                f"{away:.2f} m of {own_away:.2f} m",
            )
