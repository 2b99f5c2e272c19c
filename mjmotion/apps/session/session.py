"""An editing session, without any window: drag, pin, move footprints, undo, save (Figure 6).

    session = EditSession("walk", "terrain_doors")
    session.do(Drag("right_hand", 120, (1.9, -0.4, 1.6)))
    session.undo()
    save_session("lift.mjsession", session)

A session is a clip, perhaps in a scene, and a state: edits in their order, contacts, what of the
scene was moved, and settings. The motion is a function of those alone. What is undone comes back as
the same bytes.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjmotion.apps.adaptation import adapt, as_clip
from mjmotion.apps.edit.span import Span
from mjmotion.apps.session.applying import Grab, Step, apply
from mjmotion.apps.session.edits import Drag, Edit, Footprint, Settings
from mjmotion.apps.session.history import Change, Moves, Side, State
from mjmotion.apps.session.scene_parts import moved_scene
from mjmotion.body.kinematics import site_id, site_positions
from mjmotion.body.motion import Motion
from mjmotion.clips import load_clip
from mjmotion.constraints import SiteConstraint, lay_out
from mjmotion.constraints.unmet import find_unmet
from mjmotion.exceptions import SessionError
from mjmotion.footsteps.contacts import Contact, check_contacts, detect_contacts
from mjmotion.footsteps.settings import PlanSettings
from mjmotion.output.result import Result
from mjmotion.scene import Scene, SceneLike, with_ground
from mjmotion.scene.ground import Ground

Array = NDArray[np.float64]

PLANNING = PlanSettings(pace="keep")  # edits and contacts name frames of the clip


class EditSession:
    """A clip that is edited.

    Args:
      clip: a motion, or a file or built-in name.
      scene: where the clip is adapted to first; without, it is edited as it is, on its own ground.
      contacts: who stands when in the clip; found in it without.
      settings: of the first edits.
      name: what the clip is called where it is a motion: the file it can be read from again.
      character: what names the body that a clip's file is put on.

    Attributes:
      name: what the clip is called: its file or built-in name.
      character: the same of the body.
      clip: the clip, untouched.
      scene: where it is; None on its own ground.
      scene_name: what names that.

    Raises:
      MotionError: a clip or scene that cannot be read or adapted.
    """

    def __init__(
        self,
        clip: Motion | str | Path,
        scene: SceneLike | None = None,
        *,
        contacts: Sequence[Contact] | None = None,
        settings: Settings | None = None,
        name: str | None = None,
        character: str = "humanoid",
    ) -> None:
        given_name = "motion" if isinstance(clip, Motion) else str(clip)
        self.name = given_name if name is None else name
        self.character = character
        self.clip = clip if isinstance(clip, Motion) else load_clip(clip, character)
        self.scene = None if scene is None else Scene.of(scene).at_rest()
        named = isinstance(scene, str | Path) or scene is None
        self.scene_name = (None if scene is None else str(scene)) if named else self._called()
        given = None if contacts is None else tuple(contacts)
        self._state = State(contacts=given, settings=settings or Settings())
        self._bases: dict[tuple[object, Moves], tuple[Motion, Step]] = {}
        self._source, self._step = self._base(self._state)
        self._grab: Grab | None = None
        self._done: list[Change] = []
        self._undone: list[Change] = []

    # What there is

    @property
    def state(self) -> State:
        """What is asked."""
        return self._state

    @property
    def edits(self) -> tuple[Edit, ...]:
        """All edits, in their order."""
        return self._state.edits

    @property
    def source(self) -> Motion:
        """The clip before, on the same model as the motion."""
        return self._source

    @property
    def motion(self) -> Motion:
        """The motion as it is now."""
        return self._step.motion

    @property
    def contacts(self) -> tuple[Contact, ...]:
        """Who stands when, now."""
        return self._step.contacts

    @property
    def step(self) -> Step:
        """The motion as it is now, with what the last edit's fit did."""
        return self._step

    @property
    def can_undo(self) -> int:
        """How many changes can be undone."""
        return len(self._done)

    @property
    def can_redo(self) -> int:
        """How many changes can be done again."""
        return len(self._undone)

    def span(self, frame: int, length: int = 1) -> Span:
        """Return the frames that an edit of some frames reaches, with the present settings."""
        return Span(frame, self._state.settings.frames_per_knot, self.motion.nframe, length)

    def residuals(self) -> list[float]:
        """Return how far each edit's site is from where it was asked to be, at worst [m].

        NaN of edits that are disabled or ask for no place.
        """
        motion, found = self.motion, []
        for edit in self.edits:
            place = None if isinstance(edit, Footprint) else edit.position
            if place is None or not edit.enabled or isinstance(edit, Footprint):
                found.append(float("nan"))
                continue
            site = np.array([site_id(motion.model, edit.site)])
            at = site_positions(motion.model, motion.qpos[slice(*edit.frames)], site)[:, 0]
            found.append(float(np.linalg.norm(at - place, axis=1).max()))
        return found

    def result(self) -> Result:
        """Return the session's motion as what every application returns."""
        asked = [
            SiteConstraint(edit.site, np.arange(*edit.frames), np.asarray(edit.position))
            for edit in self.edits
            if edit.enabled and not isinstance(edit, Footprint) and edit.position is not None
        ]
        motion = self.motion
        unmet = find_unmet(motion, lay_out(asked, motion.model, motion.nframe), asked)
        title = f"{Path(self.name).stem} edited"
        return Result(self._source, motion, self.contacts, self._step.trace, unmet, title=title)

    # What can be done

    def preview(self, edit: Edit) -> Step:
        """Return what the motion comes to with one edit more, and do not keep it.

        Raises:
          SessionError, ModelError: as :func:`mjmotion.apps.session.apply`.
        """
        if not isinstance(edit, Drag):
            return apply(edit, self._step, self._ground(self._state))
        grab = self._grab  # of the drag before: the same site, dragged on
        if grab is None or (grab.before, grab.site, grab.frame, grab.settings) != (
            self._step,
            edit.site,
            edit.frame,
            edit.settings,
        ):
            grab = Grab.of(self._step, edit.site, edit.frame, edit.settings)
        self._grab = grab
        return grab.to(edit.position)

    def do(self, edit: Edit, step: Step | None = None) -> None:
        """Add an edit.

        Args:
          edit: what is asked.
          step: what :meth:`preview` gave for it; found without.

        Raises:
          SessionError, ModelError: as :func:`mjmotion.apps.session.apply`.
        """
        after = self.preview(edit) if step is None else step
        self._keep(dataclasses.replace(self._state, edits=(*self.edits, edit)), after)

    def change(self, index: int, edit: Edit) -> None:
        """Put another edit in the place of one; all that come after it are made again.

        Raises:
          SessionError: there is no such edit.
        """
        edits = list(self.edits)
        edits[self._index(index)] = edit
        self._redo_all(dataclasses.replace(self._state, edits=tuple(edits)))

    def enable(self, index: int, enabled: bool) -> None:
        """Let an edit count, or not."""
        self.change(index, dataclasses.replace(self.edits[self._index(index)], enabled=enabled))

    def delete(self, index: int) -> None:
        """Take an edit away.

        Raises:
          SessionError: there is no such edit.
        """
        edits = list(self.edits)
        del edits[self._index(index)]
        self._redo_all(dataclasses.replace(self._state, edits=tuple(edits)))

    def set_contacts(self, contacts: Sequence[Contact]) -> None:
        """Say who stands when in the clip; in a scene the clip is adapted anew.

        Raises:
          ContactError: they do not fit the clip.
        """
        checked = tuple(check_contacts(contacts, self.clip.model, self.clip.nframe))
        self._redo_all(dataclasses.replace(self._state, contacts=checked))

    def move_scene(self, name: str, by: ArrayLike) -> None:
        """Move a part of the scene, such as a door; the clip is adapted to it anew.

        Args:
          name: of :func:`mjmotion.apps.session.scene_parts.parts`.
          by: (3,) how much further [m].

        Raises:
          SessionError: there is no scene, or no such part.
          SceneError: the clip cannot be adapted to it: all stays as it was.
        """
        moves = dict(self._state.scene_moves)
        x, y, z = np.asarray(moves.get(name, (0.0, 0.0, 0.0))) + np.asarray(by, dtype=np.float64)
        moves[name] = (float(x), float(y), float(z))
        self._redo_all(dataclasses.replace(self._state, scene_moves=tuple(sorted(moves.items()))))

    def set_settings(self, settings: Settings) -> None:
        """Change the settings of the next edits."""
        self._keep(dataclasses.replace(self._state, settings=settings), self._step)

    def undo(self) -> bool:
        """Take the last change back; False when there is none."""
        if not self._done:
            return False
        done = self._done.pop()
        self._undone.append(done)
        self._go(done, done.before)
        return True

    def redo(self) -> bool:
        """Do again what was undone last; False when there is nothing."""
        if not self._undone:
            return False
        done = self._undone.pop()
        self._done.append(done)
        self._go(done, done.after)
        return True

    def restore(self, state: State) -> None:
        """Start from a state, as a session's file holds it; nothing can be undone then.

        Raises:
          MotionError: what it asks for cannot be done.
        """
        self._source, self._step = self._chain(state)
        self._state, self._done, self._undone = state, [], []

    # How

    def _called(self) -> str | None:
        return None if self.scene is None else self.scene.name

    def _index(self, index: int) -> int:
        if not 0 <= index < len(self.edits):
            raise SessionError(f"there is no edit {index}: there are {len(self.edits)}")
        return index

    def _scene(self, state: State) -> Scene | None:
        if self.scene is None:
            if state.scene_moves:
                raise SessionError("there is no scene to move anything of: give one")
            return None
        return moved_scene(self.scene, state.scene_moves) if state.scene_moves else self.scene

    def _ground(self, state: State) -> Ground | None:
        scene = self._scene(state)
        return None if scene is None else scene.ground

    def _base(self, state: State) -> tuple[Motion, Step]:
        """Return the source and the motion before any edit."""
        key = (state.contacts, state.scene_moves)
        if key not in self._bases:
            scene = self._scene(state)
            if scene is None:
                source = self.clip.on(with_ground(self.clip.character))
                contacts = state.contacts
                found = detect_contacts(source) if contacts is None else contacts
                base = source, Step(source, tuple(found))
            else:
                result = adapt(
                    as_clip(self.clip), scene, contacts=state.contacts, planning=PLANNING
                )
                base = result.source, Step(result.motion, result.contacts, trace=result.trace)
            self._bases = {key: base}
        return self._bases[key]

    def _chain(self, state: State) -> tuple[Motion, Step]:
        source, step = self._base(state)
        ground = self._ground(state) if state.edits else None
        for edit in state.edits:
            if edit.enabled:
                step = apply(edit, step, ground)
        return source, step

    def _redo_all(self, state: State) -> None:
        source, step = self._chain(state)
        self._keep(state, step, source)

    def _keep(self, state: State, step: Step, source: Motion | None = None) -> None:
        """Go to a state, remembering only the frames in which the motion changed."""
        source = self._source if source is None else source
        old, new = self._step.motion.qpos, step.motion.qpos
        other = self._step.motion.model is not step.motion.model
        # To the bit: a zero with a sign counts.
        differ = np.flatnonzero((old.view(np.int64) != new.view(np.int64)).any(axis=1))
        first, end = (int(differ[0]), int(differ[-1]) + 1) if len(differ) else (0, 0)
        sides = [
            Side(
                what,
                one.contacts,
                one.pinned,
                one.trace,
                one.frames,
                one.motion.qpos[first:end].copy(),
                (origin, one.motion) if other else None,
            )
            for what, one, origin in (
                (self._state, self._step, self._source),
                (state, step, source),
            )
        ]
        self._done.append(Change(first, end, sides[0], sides[1]))
        self._undone.clear()
        self._state, self._step, self._source = state, step, source

    def _go(self, change: Change, side: Side) -> None:
        """Put one side of a change in place of the other."""
        if side.motions is not None:
            self._source, motion = side.motions
        else:
            qpos = np.array(self._step.motion.qpos)
            qpos[change.first : change.end] = side.rows
            motion = self._step.motion.replace(qpos)
        self._state = side.state
        self._step = Step(motion, side.contacts, side.pinned, side.trace, side.frames)
