"""What stays where it was while a frame is edited: feet on their paths, and whatever is held."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Literal, TypeAlias

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.apps.edit.span import Span
from mjmotion.body.character import Character
from mjmotion.body.feet import Foot
from mjmotion.body.kinematics import Kinematics, Pose, site_id
from mjmotion.body.motion import Motion
from mjmotion.constraints import SiteConstraint
from mjmotion.exceptions import ModelError
from mjmotion.footsteps.ankles import relax_ankles, trim_heel_contacts
from mjmotion.footsteps.contacts import Contact
from mjmotion.footsteps.paths import FootPath, turned_about_toes
from mjmotion.numerics.rotations import (
    conjugate,
    continuous,
    exp,
    from_matrix,
    log,
    multiply,
)

Array = NDArray[np.float64]
Hold = Literal["feet", "contacts", "frame"]

Paths: TypeAlias = tuple[FootPath, ...]
HOLDS: tuple[Hold, ...] = ("feet", "contacts", "frame")
SHORTEST = 0.07  # what is left of a heel's contact is dropped when it is shorter [s]


@dataclasses.dataclass(frozen=True, eq=False)
class Held:
    """What stays where it was.

    Attributes:
      feet: the feet.
      paths: where each foot is at every frame; ``stance`` says at which frames it is held there.
      others: what else is held, such as hands.
      contacts: who stands when.
    """

    feet: tuple[Foot, ...]
    paths: tuple[FootPath, ...]
    others: tuple[SiteConstraint, ...]
    contacts: tuple[Contact, ...]

    def constraints(self) -> list[SiteConstraint]:
        """Return the feet posed at the frames at which they are held, and the others."""
        posed = [
            SiteConstraint(
                path.site, at, path.position[at], path.quat[at], contact=True, source="scene"
            )
            for path in self.paths
            if len(at := np.flatnonzero(path.stance))
        ]
        return [*posed, *self.others]

    def at(self, frame: int) -> Held:
        """Return what is held at one frame, as frame 0 of a motion of that frame alone."""
        row = slice(frame, frame + 1)
        paths = tuple(
            dataclasses.replace(
                path,
                **{
                    name: getattr(path, name)[row]
                    for name in ("position", "quat", "shift", "stance", "lift", "toes")
                },
            )
            for path in self.paths
        )
        others = tuple(
            dataclasses.replace(
                one, frames=np.zeros(1, np.int64), position=one.position[one.frames == frame]
            )
            for one in self.others
            if one.position is not None and frame in one.frames
        )
        return Held(self.feet, paths, others, ())

    def own(self, source: Motion) -> Paths:
        """Return the feet's paths as the source's own ankles can follow them."""
        return relax_ankles(source, self.feet, self.paths, ())[0]

    def relaxed(self, moved: Motion, fade: Array, before: Paths) -> Held:
        """Return it with heels raised where the moved body's ankles could not follow otherwise.

        Args:
          moved: the motion with its body where it is to be.
          fade: (nframe,) how much of that each frame may take.
          before: what :meth:`own` returns for the motion before.
        """
        after, _ = relax_ankles(moved, self.feet, self.paths, ())
        if after == self.paths:
            return self
        paths, contacts = [], list(self.contacts)
        for foot, path, old, new in zip(self.feet, self.paths, before, after, strict=True):
            # What the source lacked already is its own.
            turn = log(multiply(conjugate(old.quat), new.quat)) * fade[:, None]
            if not np.abs(turn).max(initial=0.0) > 0.0:
                paths.append(path)
                continue
            quat = multiply(path.quat, exp(turn))
            paths.append(turned_about_toes(path, foot, quat))
            contacts = trim_heel_contacts(contacts, foot, path, paths[-1], SHORTEST * moved.fps)
        return dataclasses.replace(self, paths=tuple(paths), contacts=tuple(contacts))


def keep(
    motion: Motion,
    contacts: Sequence[Contact],
    span: Span,
    drags: Sequence[SiteConstraint],
    hold: Hold,
    pinned: Sequence[SiteConstraint] = (),
) -> Held:
    """Return what stays where it was.

    A body that is dragged is not held on its path, nor in a contact that holds it at the edited
    frame, but in those before and after.

    Args:
      motion: the motion before.
      contacts: who stands when.
      span: the frames that may change.
      drags: what the user asks for.
      hold: see :func:`mjmotion.apps.edit.edit_frame`.
      pinned: what earlier edits asked for, which stays unless its body is dragged.
    """
    model = motion.model
    pose = Kinematics(model, motion.nframe).forward(motion.qpos)
    dragged = {int(model.site_bodyid[site_id(model, drag.site)]) for drag in drags}
    allowed = np.zeros(motion.nframe, dtype=bool)
    allowed[[span.frame] if hold == "frame" else span.frames] = True
    feet = {foot.body: foot for foot in _feet(motion.character)}
    stands = {body: np.zeros(motion.nframe, dtype=bool) for body in feet}
    others, left = [], []
    for contact in contacts:
        index = site_id(model, contact.site)
        body = int(model.site_bodyid[index])
        if body in dragged and contact.start <= span.frame < contact.end:
            left += _outside(contact, span)
            continue
        left.append(contact)
        within = allowed.copy()
        within[: contact.start] = within[contact.end :] = False
        if body in feet:
            stands[body] |= within
        elif within.any():
            at = np.flatnonzero(within)
            place = pose.site_xpos[at, index]
            others.append(SiteConstraint(contact.site, at, place, contact=True, source="scene"))
    others += _within(pinned, span, model, dragged)
    paths = []
    for body, foot in feet.items():
        held = allowed if hold == "feet" and body not in dragged else stands[body]
        paths.append(_own_path(foot, pose, held))
    return Held(tuple(feet.values()), tuple(paths), tuple(others), tuple(left))


def _own_path(foot: Foot, pose: Pose, held: NDArray[np.bool_]) -> FootPath:
    """Return the path that a foot goes, held there at some frames (nframe,)."""
    site, nframe = site_id(pose.model, foot.site), len(held)
    return FootPath(
        foot.site,
        np.array(pose.site_xpos[:, site]),
        continuous(from_matrix(pose.site_xmat[:, site])),
        np.zeros((nframe, 3)),
        held,
        np.zeros(nframe),
        foot.bend(pose) if foot.toes is None else foot.toes.wanted(foot.bend(pose)),
    )


def _within(
    pinned: Sequence[SiteConstraint], span: Span, model: mujoco.MjModel, dragged: set[int]
) -> list[SiteConstraint]:
    """Return what of earlier constraints lies within a span and is not of a dragged body."""
    left = []
    for one in pinned:
        inside = np.isin(one.frames, span.frames)
        mine = int(model.site_bodyid[site_id(model, one.site)]) in dragged
        if one.position is not None and inside.any() and not mine:
            frames, position = one.frames[inside], one.position[inside]
            left.append(dataclasses.replace(one, frames=frames, position=position))
    return left


def _outside(contact: Contact, span: Span) -> list[Contact]:
    """Return what is left of a contact that ends with a drag: what lies outside the span."""
    first, last = int(span.frames[0]), int(span.frames[-1])
    before = dataclasses.replace(contact, end=min(contact.end, first))
    after = dataclasses.replace(contact, start=max(contact.start, last + 1))
    return [part for part in (before, after) if part.end - part.start > 1]


def _feet(character: Character) -> tuple[Foot, ...]:
    """Return the feet; none where the model has none that can be posed."""
    try:
        return character.feet
    except ModelError:
        return ()
