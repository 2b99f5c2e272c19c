"""What the page shows: a session as it was when the last change was done, and what follows of it.

The session may be changed in another thread meanwhile; this does not change.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from functools import cached_property

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.apps.session import EditSession, Settings, Step
from mjmotion.apps.session.edits import Edit
from mjmotion.body.kinematics import root_body, site_positions
from mjmotion.body.motion import Motion
from mjmotion.exceptions import ModelError
from mjmotion.fitting import Trace
from mjmotion.footsteps.contacts import Contact

Array = NDArray[np.float64]

_UNSEEN = ("_palm", "seat")  # sites beside others that are dragged in their place


@dataclasses.dataclass(frozen=True, eq=False)
class Shown:
    """A source, a motion and what is known of them.

    Attributes:
      source: the motion before, on the same model.
      motion: the motion.
      contacts: who stands when.
      edits: what was asked, in order.
      residuals: how far each is from its place [m]; NaN where that means nothing.
      settings: of the next edit.
      trace: what the last fit did.
      changed: frames that the last edit may have changed.
      undo, redo: how many changes there are to go back to, and forth.
      base: of a preview, what it is a preview of: other frames than ``changed`` are the same.
    """

    source: Motion
    motion: Motion
    contacts: tuple[Contact, ...]
    edits: tuple[Edit, ...] = ()
    residuals: tuple[float, ...] = ()
    settings: Settings = dataclasses.field(default_factory=Settings)
    trace: Trace | None = None
    changed: NDArray[np.int64] = dataclasses.field(default_factory=lambda: np.empty(0, np.int64))
    undo: int = 0
    redo: int = 0
    base: Shown | None = None

    @classmethod
    def of(cls, session: EditSession) -> Shown:
        """Return what a session has come to."""
        return cls(
            session.source,
            session.motion,
            session.contacts,
            session.edits,
            tuple(session.residuals()),
            session.state.settings,
            session.step.trace,
            session.step.frames,
            session.can_undo,
            session.can_redo,
        )

    def previewed(self, step: Step) -> Shown:
        """Return the same with what a drag would come to."""
        return dataclasses.replace(
            self, motion=step.motion, trace=step.trace, changed=step.frames, base=self
        )

    @property
    def model(self) -> mujoco.MjModel:
        """Character and scene."""
        return self.motion.model

    @property
    def nframe(self) -> int:
        """How many frames there are."""
        return self.motion.nframe

    @cached_property
    def sites(self) -> Mapping[str, int]:
        """The character's sites, which can be dragged: name to id."""
        model = self.model
        root = root_body(model)
        return {
            model.site(i).name: i
            for i in range(model.nsite)
            if model.body_rootid[model.site_bodyid[i]] == root
            and model.site(i).name
            # What only rests on the ground is no handle: it would lie upon another.
            and not model.site(i).name.endswith(_UNSEEN)
        }

    def sites_near(self, body: str) -> tuple[str, ...]:
        """Return the sites on a body, or on that which is the fewest joints away.

        Of two bodies as near it is those of both: a thigh is moved by its knee or by the pelvis.
        """
        model = self.model
        start = model.body(body).id
        above = _ancestors(model, start)
        best: int | None = None
        found: list[str] = []
        for name, site in self.sites.items():
            chain = _ancestors(model, int(model.site_bodyid[site]))
            meet = next(i for i, one in enumerate(chain) if one in above)
            rank = meet + above.index(chain[meet])
            if best is None or rank < best:
                best, found = rank, []
            if rank == best:
                found.append(name)
        return tuple(found)

    @cached_property
    def feet(self) -> Mapping[str, str]:
        """The sides of the feet by their sites: ``left_heel`` to ``left``; empty without feet."""
        try:
            feet = self.motion.character.feet
        except ModelError:
            return {}
        names = {foot.body: foot.side for foot in feet}
        return {
            name: names[int(self.model.site_bodyid[site])]
            for name, site in self.sites.items()
            if int(self.model.site_bodyid[site]) in names
        }

    @cached_property
    def traced(self) -> tuple[str, ...]:
        """The sites whose paths are drawn: a hand or a foot of each limb, and one of the root.

        Of a body without such limbs, such as many robots, one of every body that has a site.
        """
        model, root = self.model, root_body(self.model)
        others = {int(model.site_bodyid[site]) for site in self.sites.values()} - {root}
        ends = [root, *sorted(self.motion.character.limb_by_end or others)]
        found = []
        for body in ends:
            mine = [name for name, site in self.sites.items() if model.site_bodyid[site] == body]
            # Of a foot the site that is posed, which is the last; of a hand its only one.
            found += mine[-1:]
        return tuple(found)

    @cached_property
    def table(self) -> Array:
        """Where all sites are (nframe, nsite, 3) [m], in the order of :attr:`sites`."""
        ids = np.array(list(self.sites.values()), dtype=np.int64)
        qpos = self.motion.qpos
        if not len(ids):
            return np.zeros((len(qpos), 0, 3))
        if self.base is None:
            return site_positions(self.model, qpos, ids)
        table = self.base.table.copy()
        if len(self.changed):
            table[self.changed] = site_positions(self.model, qpos[self.changed], ids)
        return table

    @cached_property
    def columns(self) -> Mapping[str, int]:
        """Where in :attr:`table` each site is."""
        return {name: column for column, name in enumerate(self.sites)}

    def places(self, names: Sequence[str], frames: slice = slice(None)) -> Array:
        """Return where some sites are (n, k, 3) [m] at some frames."""
        return self.table[frames][:, [self.columns[name] for name in names]]

    def place(self, name: str, frame: int) -> Array:
        """Return where a site is (3,) [m] at a frame."""
        return np.array(self.table[frame, self.columns[name]])


def _ancestors(model: mujoco.MjModel, body: int) -> list[int]:
    """Return a body and all that carry it, up to the world."""
    chain = [body]
    while chain[-1]:
        chain.append(int(model.body_parentid[chain[-1]]))
    return chain
