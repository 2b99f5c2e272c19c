"""Editing: a drag beside a plain sweep of the kinematics, and many edits undone and done again."""

from __future__ import annotations

import resource
from collections.abc import Callable

import numpy as np

from benchmarks.figures import Print, print_figures
from benchmarks.speed import sweep
from mjmotion.apps.session import Drag, Edit, EditSession, Footprint, Pin
from mjmotion.body.kinematics import site_id, site_positions
from mjmotion.exceptions import MotionError
from mjmotion.paper.figures import Figure
from mjmotion.paper.job import Job
from mjmotion.paper.timing import median_seconds

STEP, REPEATS = 10.0, 41  # most of a drag over a sweep; how often both are timed
FRAME = 90
DRAGGED = {
    "right_hand": (0.0, 0.0, 0.15),
    "pelvis": (0.0, 0.0, -0.1),
    "head_top": (0.05, 0.0, -0.05),
    "left_toe": (0.03, 0.0, 0.06),
}
MORE = {  # drags that are shown beside those: the trunk gives, or the place is out of reach
    "right_elbow": (0.05, 0.0, 0.05),
    "right_knee": (0.05, 0.0, 0.02),
    "left_hand": (0.5, 0.5, 0.8),
}
EDITS, ROUNDS, GROWTH = 500, 3, 8.0  # random edits; times all are undone and redone; most [MB]


def run(job: Job, print_line: Print) -> list[Figure]:
    """Return the figures of editing."""
    return [
        *print_figures(drags(job), print_line),
        *print_figures(many_edits(print_line), print_line),
    ]


def drags(job: Job) -> list[Figure]:
    """Return the time of one drag, ready to be drawn, over that of a sweep of the whole clip."""
    session = EditSession("walk")
    tasks: dict[str, Callable[[], object]] = {"sweep": sweep(job)}
    for name, by in (DRAGGED | MORE).items():
        x, y, z = place(session, name, FRAME) + by
        edit = Drag(name, FRAME, (float(x), float(y), float(z)))
        # As a mouse drags on: what one site has in common from place to place is prepared once.
        tasks[name] = Dragging(EditSession("walk"), edit)
    seconds = median_seconds(tasks, REPEATS)
    figures = [
        Figure("editing", f"drag of {name} over sweep", seconds[name] / seconds["sweep"], "x")
        for name in DRAGGED | MORE
    ]
    worst = max(seconds[name] for name in DRAGGED)
    figures.append(
        Figure("editing", "drag step over sweep", worst / seconds["sweep"], "x", most=STEP)
    )
    return figures


class Dragging:
    """Drags a site to and fro about a place, a step a call."""

    def __init__(self, session: EditSession, edit: Drag) -> None:
        self._session, self._edit, self._count = session, edit, 0

    def __call__(self) -> None:
        """Drag on."""
        x, y, z = self._edit.position
        self._count += 1
        to = (x, y + 0.001 * (self._count % 5), z)
        self._session.preview(Drag(self._edit.site, self._edit.frame, to))


def many_edits(print_line: Print) -> list[Figure]:
    """Return what many random edits, undone and done again, leave behind."""
    session, rng = EditSession("walk"), np.random.default_rng(3)
    first, refused = session.motion.qpos.tobytes(), 0
    while session.can_undo < EDITS:
        try:
            session.do(random_edit(session, rng))
        except MotionError:  # such as a footprint of a contact that an earlier edit took away
            refused += 1
    last = session.motion.qpos.tobytes()
    other, sizes = 0, []
    for _ in range(ROUNDS):
        while session.undo():
            pass
        other += session.motion.qpos.tobytes() != first
        while session.redo():
            pass
        other += session.motion.qpos.tobytes() != last
        sizes.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0)
    print_line(f"{EDITS} random edits, {refused} more were refused")
    return [
        Figure("editing", f"{EDITS} edits undone and redone: other bytes", float(other), most=0.0),
        Figure("editing", "memory that undo and redo add", sizes[-1] - sizes[0], "MB", most=GROWTH),
    ]


def random_edit(session: EditSession, rng: np.random.Generator) -> Edit:
    """Return an edit of any kind, somewhere."""
    frame = int(rng.integers(session.motion.nframe))
    kind = rng.random()
    if kind < 0.1:
        return Pin(str(rng.choice(list(DRAGGED))), max(0, frame - 5), frame + 1)
    if kind < 0.25:
        contact = session.contacts[int(rng.integers(len(session.contacts)))]
        x, y = rng.uniform(-0.04, 0.04, 2)
        return Footprint(contact.site.rpartition("_")[0], contact.start, (float(x), float(y), 0.0))
    name = str(rng.choice(list(DRAGGED)))
    x, y, z = place(session, name, frame) + rng.uniform(-0.05, 0.05, 3)
    return Drag(name, frame, (float(x), float(y), float(z)))


def place(session: EditSession, site: str, frame: int) -> np.ndarray:
    """Return where a site is at a frame (3,) [m]."""
    motion = session.motion
    index = np.array([site_id(motion.model, site)])
    return site_positions(motion.model, motion.qpos[frame : frame + 1], index)[0, 0]
