"""One edit after another: what a motion comes to when a session's edits are made in their order.

    step = start(motion, contacts)
    for edit in edits:
        step = apply(edit, step)
    step.motion, step.contacts

Each is a function of what is there before it and of the edit alone, so the same edits give the same
bytes. What edits asked for is kept by those that come after, unless they drag the same body.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.apps.edit import Span
from mjmotion.apps.edit.hold import Held, keep
from mjmotion.apps.edit.local import LocalEdit
from mjmotion.apps.edit.window import Window
from mjmotion.apps.session.edits import Drag, Edit, Footprint, Pin, Settings, Vector
from mjmotion.body.kinematics import site_id, site_positions
from mjmotion.body.motion import Motion
from mjmotion.constraints import SiteConstraint
from mjmotion.exceptions import SessionError, unknown_name
from mjmotion.fitting import TOLERANCE, Trace
from mjmotion.footsteps.contacts import Contact
from mjmotion.footsteps.footholds import Foothold, find_footholds
from mjmotion.footsteps.stances import Stance
from mjmotion.ik.solver import default_rigidity
from mjmotion.numerics.rotations import conjugate, exp, log, multiply, rotate, yaw_quat
from mjmotion.numerics.smoothing import ease
from mjmotion.scene.ground import Ground

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class Step:
    """What a motion has come to.

    Attributes:
      motion: so far.
      contacts: who stands when.
      pinned: what edits asked for, with one entry an edit that counts.
      trace: what the last edit's fit did; None before the first.
      frames: (n,) frames that the last edit may have changed.
    """

    motion: Motion
    contacts: tuple[Contact, ...]
    pinned: tuple[SiteConstraint, ...] = ()
    trace: Trace | None = None
    frames: NDArray[np.int64] = dataclasses.field(default_factory=lambda: np.empty(0, np.int64))


def apply(edit: Edit, before: Step, ground: Ground | None = None) -> Step:
    """Return what a motion comes to with one edit more.

    Frames out of the edit's reach stay to the bit.

    Args:
      edit: what is asked.
      before: what is there; it is not touched.
      ground: what a moved footprint stands on; level ground at its own height without.

    Raises:
      SessionError: frames that there are not, or a foot that does not stand there.
      ModelError: an unknown site.
    """
    _check_frames(edit.frames, before.motion)
    if isinstance(edit, Drag):
        return Grab.of(before, edit.site, edit.frame, edit.settings).to(edit.position)
    if isinstance(edit, Pin):
        return _pin(edit, before)
    return _footprint(edit, before, ground)


def _check_frames(frames: tuple[int, int], motion: Motion) -> None:
    first, end = frames
    if not 0 <= first < end <= motion.nframe:
        raise SessionError(
            f"frames {first} to {end - 1} are not within the clip's 0 to {motion.nframe - 1}"
        )


def _pin(edit: Pin, before: Step) -> Step:
    motion, frames = before.motion, np.arange(edit.start, edit.end)
    site = site_id(motion.model, edit.site)
    if edit.position is None:
        place = site_positions(motion.model, motion.qpos[frames], np.array([site]))[:, 0]
        pinned = (*before.pinned, SiteConstraint(edit.site, frames, place))
        return dataclasses.replace(before, pinned=pinned, frames=np.empty(0, np.int64))
    span = Span(edit.start, edit.settings.frames_per_knot, motion.nframe, len(frames))
    asked = SiteConstraint(edit.site, frames, np.tile(edit.position, (len(frames), 1)))
    return _made(*_prepared(before, span, [asked], edit.settings), [asked], edit.settings)


@dataclasses.dataclass(frozen=True, eq=False)
class Grab:
    """A site taken hold of at one frame: what drags to one place after another have in common.

    Attributes:
      site: name of the site.
      frame: at which frame.
      before: what there is.
      settings: how edits are carried out.
      window: the frames that follow.
      local: what is done to them.
      pinned: what earlier edits asked for and this does not replace.
    """

    site: str
    frame: int
    before: Step
    settings: Settings
    window: Window
    local: LocalEdit
    pinned: tuple[SiteConstraint, ...]

    @classmethod
    def of(cls, before: Step, site: str, frame: int, settings: Settings) -> Grab:
        """Take hold.

        Raises:
          SessionError: a frame that there is not.
          ModelError: an unknown site.
        """
        _check_frames((frame, frame + 1), before.motion)
        span = Span(frame, settings.frames_per_knot, before.motion.nframe)
        here = SiteConstraint(site, np.array([frame]), np.zeros((1, 3)))
        return cls(site, frame, before, settings, *_prepared(before, span, [here], settings))

    def to(self, position: Vector) -> Step:
        """Return what the motion comes to when the site is dragged there [m]."""
        asked = SiteConstraint(self.site, np.array([self.frame]), np.array([position]))
        return _made(self.window, self.local, self.pinned, [asked], self.settings)


def _prepared(
    before: Step, span: Span, asked: list[SiteConstraint], settings: Settings
) -> tuple[Window, LocalEdit, tuple[SiteConstraint, ...]]:
    """Return what an edit of some sites at some frames needs, wherever they are to go."""
    motion = before.motion
    pinned = _not_replaced(before.pinned, asked, motion.model, settings.frames_per_knot)
    window = Window.of(motion, before.contacts, span, pinned)
    mine = window.constraints(asked)
    held = keep(window.motion, window.contacts, window.span, mine, settings.hold, window.pinned)
    rigidity = rigidity_of(motion.model, settings)
    return window, LocalEdit(window.motion, window.span, held, rigidity, ik=settings.ik), pinned


def _made(
    window: Window,
    local: LocalEdit,
    pinned: tuple[SiteConstraint, ...],
    asked: list[SiteConstraint],
    settings: Settings,
) -> Step:
    """Return the step after an edit that asks for sites at places."""
    mine = window.constraints(asked)
    moved, held, trace = local.run(mine, settings.knots, TOLERANCE, settings.exact)
    reached = window.whole_constraints([_reached(one, moved, local) for one in mine])
    whole, contacts = window.put_back(moved, held.contacts)
    return Step(whole, contacts, (*pinned, *reached), trace, window.low + window.span.frames)


def _reached(asked: SiteConstraint, moved: Motion, local: LocalEdit) -> SiteConstraint:
    """Return a constraint on where its site came: what is out of reach must not pull again."""
    site = np.array([site_id(moved.model, asked.site)])
    place = local.positions(moved.qpos[asked.frames], site)[:, 0]
    wanted = np.asarray(asked.position)
    off = np.linalg.norm(place - wanted, axis=1) > TOLERANCE
    return dataclasses.replace(asked, position=np.where(off[:, None], place, wanted))


def rigidity_of(model: mujoco.MjModel, settings: Settings) -> Array:
    """Return the rigidities α (nv,) of Eq. 4, with those of a session's joints.

    Raises:
      SessionError: a joint that there is not.
    """
    rigidity = default_rigidity(model)
    names = {model.joint(i).name: i for i in range(model.njnt)}
    for name, factor in settings.rigidity:
        if name not in names:
            raise SessionError(unknown_name("joint", name, names))
        rigidity[model.dof_jntid == names[name]] *= factor
    return rigidity


def _not_replaced(
    pinned: Sequence[SiteConstraint],
    asked: Sequence[SiteConstraint],
    model: mujoco.MjModel,
    near: int,
) -> tuple[SiteConstraint, ...]:
    """Return what earlier edits asked for and new ones do not: the newest of a body wins nearby."""

    def body(one: SiteConstraint) -> int:
        return int(model.site_bodyid[site_id(model, one.site)])

    left = []
    for old in pinned:
        rivals = [new for new in asked if body(new) == body(old)]
        rest = np.ones(len(old.frames), dtype=bool)
        for new in rivals:
            rest &= (old.frames <= new.frames.min() - near) | (
                old.frames >= new.frames.max() + near
            )
        if rest.all():
            left.append(old)
        elif rest.any() and old.position is not None:
            frames, position = old.frames[rest], old.position[rest]
            left.append(dataclasses.replace(old, frames=frames, position=position))
    return tuple(left)


# Footprints


def _footprint(edit: Footprint, before: Step, ground: Ground | None) -> Step:
    motion = before.motion
    sides = [foot.side for foot in motion.character.feet]
    if edit.side not in sides:
        raise SessionError(unknown_name("foot", edit.side, sides))
    number = sides.index(edit.side)
    start, end = stay(before.contacts, edit.side, edit.frame)
    span = Span(start, edit.settings.frames_per_knot, motion.nframe, end - start)
    window = Window.of(motion, before.contacts, span, before.pinned)
    part = window.span
    held = keep(window.motion, window.contacts, part, (), "feet", window.pinned)
    stance = part.frame, part.last + 1
    share = _share(window.contacts, edit.side, stance, part)
    path = held.paths[number]
    old, new = _moved_foothold(edit, window.motion, number, held, stance, ground)
    move = new.position - old.position
    turn = log(multiply(new.quat, conjugate(old.quat)))
    quat = multiply(exp(share[:, None] * turn), path.quat)
    # About the foot's own place on the ground, which goes along.
    place = path.position - old.position
    position = old.position + share[:, None] * move + rotate(exp(share[:, None] * turn), place)
    moved_path = dataclasses.replace(path, position=position, quat=quat)
    paths = (*held.paths[:number], moved_path, *held.paths[number + 1 :])
    local = LocalEdit(
        window.motion,
        part,
        dataclasses.replace(held, paths=paths),
        rigidity_of(motion.model, edit.settings),
        guess=share[:, None] * move / len(sides),
        ik=edit.settings.ik,
    )
    moved, held, trace = local.run((), edit.settings.knots, TOLERANCE, edit.settings.exact)
    whole, contacts = window.put_back(moved, held.contacts)
    return Step(whole, contacts, before.pinned, trace, span.frames)


def stay(contacts: Sequence[Contact], side: str, frame: int) -> tuple[int, int]:
    """Return the frames ``(start, end)`` of a foot's stay on the spot where it is at a frame.

    Raises:
      SessionError: it does not stand then.
    """
    mine = [one for one in contacts if one.site in (f"{side}_heel", f"{side}_toe")]
    start, end = frame, frame
    if not any(one.start <= frame < one.end for one in mine):
        raise SessionError(f"the {side} foot does not stand at frame {frame}: choose a contact")
    for _ in mine:  # heel and toe overlap
        near = [one for one in mine if one.start <= end and one.end >= start]
        start = min(one.start for one in near)
        end = max(one.end for one in near)
    return start, end


def _share(contacts: Sequence[Contact], side: str, stance: tuple[int, int], span: Span) -> Array:
    """Return how much of a footprint's move a foot has made at each frame (nframe,)."""
    mine = [one for one in contacts if one.site in (f"{side}_heel", f"{side}_toe")]
    first, last = int(span.frames[0]), int(span.frames[-1])
    before = max([first, *(one.end for one in mine if one.end <= stance[0])])
    after = min([last + 1, *(one.start for one in mine if one.start >= stance[1])])
    share = np.zeros(span.nframe)
    share[stance[0] : stance[1]] = 1.0
    rise, fall = stance[0] - before, after - stance[1]
    share[before : stance[0]] = ease((np.arange(rise) + 1.0) / (rise + 1.0))
    share[stance[1] : after] = 1.0 - ease((np.arange(fall) + 1.0) / (fall + 1.0))
    return share


def _moved_foothold(
    edit: Footprint,
    motion: Motion,
    number: int,
    held: Held,
    frames: tuple[int, int],
    ground: Ground | None,
) -> tuple[Foothold, Foothold]:
    """Return where a foot stands, and where it is to."""
    foot, path = motion.character.feet[number], held.paths[number]
    middle = (frames[0] + frames[1]) // 2
    position, quat = path.position[middle], path.quat[middle]
    along = rotate(quat, foot.toe - foot.heel)
    local = foot.toe - foot.heel
    yaw = np.arctan2(along[1], along[0]) - np.arctan2(local[1], local[0])
    up = rotate(quat, np.array((0.0, 0.0, 1.0)))
    old = Foothold(position, quat, up, 0.0)
    spun = yaw_quat(np.asarray(edit.turn))
    spot = position + np.asarray(edit.move)
    if ground is None:
        return old, Foothold(spot, multiply(spun, quat), up, 0.0)
    stance = Stance(number, frames, frames, spot, multiply(spun, yaw_quat(np.asarray(yaw))))
    (new,) = find_footholds([stance], motion.character.feet, ground, float(spot[2]))
    return old, new
