"""Figures of how a body moves, each beside the source's own: posture, effort, stances kept."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.motion import Motion
from mjmotion.validation.anatomy import Anatomy, find_anatomy
from mjmotion.validation.effort import acceleration_rms, unexplained_force, unexplained_share
from mjmotion.validation.figures import ratio
from mjmotion.validation.ground import Ground
from mjmotion.validation.inputs import ChangingBody, Contact, stands
from mjmotion.validation.posture import (
    body_states,
    further_back,
    knee_bend,
    level_frames,
    pitch,
)
from mjmotion.validation.self_overlap import SelfOverlap, beyond
from mjmotion.validation.sheet import Sheet
from mjmotion.validation.support import (
    ground_support,
    kept_share,
    level_support,
    standing_frames,
)

Array = NDArray[np.float64]
_MM = 1000.0
_STEEP = np.cos(np.radians(3.0))  # ground whose normal is closer to upright is level
_SOLES = ("heel", "toe", "_knee", "_palm", "seat")  # endings of the sites that stand


class Body:
    """What is found out once of a model for these figures.

    Attributes:
      anatomy: its parts.
      overlap: its geoms that collide.
      rest: where it is at ``qpos0``, one frame.
      sites: ids of its heels and toes, and of knees, palms and a seat that rest.

    Args:
      model: holds the character.
      geoms: ids of the character's geoms that collide.
      sites: ids of sites that feet stand with, and hands.
    """

    def __init__(
        self, model: mujoco.MjModel, geoms: NDArray[np.int64], sites: Sequence[int]
    ) -> None:
        self.model = model
        self.anatomy: Anatomy = find_anatomy(model)
        self.overlap = SelfOverlap(model, geoms)
        self.rest = body_states(model, model.qpos0[None])
        self.sites = tuple(site for site in sites if model.site(site).name.endswith(_SOLES))


class BesideSource:
    """Measures one motion beside its source, and notes it on a sheet.

    Args:
      sheet: where to.
      body: the character.
      source, motion: the two, of as many frames.
      contacts: who stands when.
      changing: the character's size in every frame of the motion, where that changes.
      recording: the source in its own time, where that is another.
    """

    def __init__(
        self,
        sheet: Sheet,
        body: Body,
        source: Motion,
        motion: Motion,
        contacts: Sequence[Contact],
        *,
        changing: ChangingBody | None = None,
        recording: Motion | None = None,
    ) -> None:
        self._recording = recording
        self._sheet, self._body, self._model = sheet, body, body.model
        self._source, self._motion, self._contacts = source, motion, contacts
        self._changes = changing is not None
        self._held = standing_frames(self._model, body.sites, contacts, motion.nframe)
        self._own = body_states(self._model, motion.qpos, changing)
        self._before = body_states(self._model, source.qpos)

    @property
    def sites(self) -> tuple[int, ...]:
        """Ids of heels and toes."""
        return self._body.sites

    def posture(self) -> None:
        """How far trunk and head lean back."""
        anatomy = self._body.anatomy
        for part, body in (("trunk", anatomy.trunk), ("head", anatomy.head)):
            if body is None:
                continue
            own, before = (
                pitch(states, self._body.rest, body, anatomy.root)
                for states in (self._own, self._before)
            )
            name = f"{part}_pitch_deg"
            self._sheet.per_frame |= {name: own, f"source_{name}": before}
            value, frame = further_back(own, before)
            if not np.isnan(value):
                self._sheet.note(f"{part}_back_deg", value, frame, self._model.body(body).name)

    def stances(self, ground: Ground, place: Array, source_place: Array) -> None:
        """Bent knees, stances kept, and the force that the ground cannot give.

        Args:
          ground: the scene.
          place: (nframe, nsite, 3) all sites of the motion [m].
          source_place: those of the source.
        """
        sites, model = self._body.sites, self._model
        own = ground_support(ground, sites, place[:, sites], self._held)
        before = level_support(model, sites, source_place[:, sites], self._held)
        fps, sheet = self._motion.fps, self._sheet
        owner = model.site_bodyid[list(sites)]
        above = [owner == model.body_parentid[body] for body in owner]
        kneels = np.zeros_like(self._held)
        for column, one in enumerate(above):
            kneels[:, column] = self._held[:, one].any(axis=1)
        kept = kept_share(before.place, self._held, fps, owner, kneels)
        sheet.metrics["contact_kept_percent"] = kept
        flat = self._held & (own.normal[..., 2] >= _STEEP)
        flat &= level_frames(own.height, fps)[:, None]
        legs = self._body.anatomy.legs
        frames = [flat[:, owner == leg.foot].any(axis=1) for leg in legs]
        bend, worst = knee_bend(self._body.anatomy, self._own, self._before, frames)
        if worst is not None:
            where = f"{model.joint(legs[worst].knee).name}, {int(frames[worst].sum())} frames"
            sheet.note("stance_knee_bend_deg", bend, None, where)
        if self._changes or not all(stands(contact) for contact in self._contacts):
            return  # a hand that holds on may pull: what it gives is not known
        share = []
        for name, motion, support in (
            ("unexplained", self._motion, own),
            ("source_unexplained", self._source, before),
        ):
            force = unexplained_force(model, motion.qpos, fps, support)
            share.append(unexplained_share(force))
            sheet.per_frame[f"{name}_bw"] = force
            sheet.metrics[f"{name}_percent"] = share[-1]
            if not np.isnan(share[-1]):
                frame = int(np.nanargmax(force))
                sheet.note(f"{name}_percent", share[-1], frame, f"{force[frame]:.2f} body weights")
        sheet.metrics["unexplained_more_points"] = share[0] - share[1]
        if "unexplained_percent" in sheet.worst:
            sheet.worst["unexplained_more_points"] = sheet.worst["unexplained_percent"]

    def centre_of_mass(self) -> None:
        """How hard the centre of mass is pushed about."""
        fps = self._motion.fps
        level = self._before
        if self._recording is not None:
            level = body_states(self._model, self._recording.qpos)
        own, before = (acceleration_rms(one.com, fps) for one in (self._own, level))
        if not np.isnan(own + before):
            where = f"{own:.2f} m/s² of {before:.2f}"
            self._sheet.note("com_acceleration_ratio", ratio(own, before), None, where)

    def self_overlap(self) -> None:
        """How deep parts of the body are in one another."""
        if self._changes:
            return
        overlap, sheet = self._body.overlap, self._sheet
        own, before = overlap.overlaps(self._motion.qpos), overlap.overlaps(self._source.qpos)
        more = beyond(own, before)
        for name, one, depth in (
            ("self_overlap_mm", own, more),
            ("source_self_overlap_mm", before, before.depth),
        ):
            whole = np.zeros(self._motion.nframe)
            np.maximum.at(whole, one.frame, depth * _MM)
            sheet.per_frame[name] = whole
            sheet.metrics[name] = float(whole.max())
            if sheet.metrics[name] > 0:
                worst = int(depth.argmax())
                where = overlap.names(int(one.pair[worst]))
                sheet.note(name, sheet.metrics[name], int(one.frame[worst]), where)
