"""A rope climb that was simulated and measured, and its output folder.

    climb.save("out/rope", video=True)

| file | what it holds |
|---|---|
| motion.npz, source.npz, model.xml | the climb fitted, and before; character and rope |
| original.npz, original.xml | the humanoid's climb; humanoid and rope |
| contacts.json, constraints.json | who holds the rope when, and where |
| report.json | the figures |
| video.mp4 | both climbs, side by side |

The first three and contacts.json are those of every result, so ``render`` and ``info`` work on it.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mjmotion.apps.rope.measuring import RopeFigures
from mjmotion.body.motion import Motion
from mjmotion.clips.climb_plan import Hold
from mjmotion.constraints import SiteConstraint
from mjmotion.constraints.unmet import Unmet
from mjmotion.exceptions import OutputError
from mjmotion.fitting import Trace
from mjmotion.footsteps.contacts import Contact, save_contacts
from mjmotion.numerics.progress import Progress, no_progress
from mjmotion.output.folder import (
    CONTACTS,
    MODEL,
    MOTION,
    REPORT,
    SOURCE,
    VIDEO,
    check_file,
    result_folder,
)
from mjmotion.output.video.side_by_side import Grasp, render_side_by_side
from mjmotion.scene import save_model

ORIGINAL_MOTION, ORIGINAL_MODEL = "original.npz", "original.xml"
CONSTRAINTS = "constraints.json"
ORIGINAL = "humanoid"
JERK_RATIO = 1.3  # the most that it should be


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class RopeClimb:
    """A climb, and the same on another character, each with its own simulated rope.

    Attributes:
      character: the other character's name.
      original: the humanoid's climb, humanoid and rope in one model.
      source: its joint angles on the other character, before the fit; the rope is the original's.
      motion: the fitted climb, character and rope in one model.
      holds: who holds what of the rope when.
      contacts: the same as contacts.
      constraints: position and orientation of the character's hands and feet.
      trace: what the fit did.
      unmet: constraints that could not be met.
      original_figures, figures: what was measured of the humanoid, and of the character.
      jerk_ratio: RMS joint jerk of the fitted climb over the original's.
    """

    character: str
    original: Motion
    source: Motion
    motion: Motion
    holds: tuple[Hold, ...]
    contacts: tuple[Contact, ...]
    constraints: tuple[SiteConstraint, ...]
    trace: Trace
    unmet: tuple[Unmet, ...]
    original_figures: RopeFigures
    figures: RopeFigures
    jerk_ratio: float

    def broken(self) -> list[str]:
        """Return one line for every figure that is not what it should be."""
        both = ((ORIGINAL, self.original_figures), (self.character, self.figures))
        lines = [f"{name}: {line}" for name, figures in both for line in figures.broken()]
        if self.jerk_ratio > JERK_RATIO:
            lines.append(
                f"{self.character}: jerk_ratio is {self.jerk_ratio:.3g}, wanted <= {JERK_RATIO:g}"
            )
        return lines

    def __repr__(self) -> str:
        motion, broken = self.motion, len(self.broken())
        figures = f"{broken} figures missed" if broken else "all figures reached"
        return f"<RopeClimb of {self.character}: {motion.nframe} frames, {figures}>"

    def save(
        self,
        folder: str | Path,
        *,
        video: bool = False,
        force: bool = False,
        progress: Progress = no_progress,
    ) -> Path:
        """Write everything of the climb into a folder, whole or not at all.

        Args:
          folder: where; it is made.
          video: whether to render ``video.mp4`` too.
          force: whether earlier results in ``folder`` are replaced.
          progress: called with stage, done, of.

        Raises:
          OutputError: the folder holds something already or cannot be written.
          RenderError: a video was asked for and there is no offscreen OpenGL.
        """
        with result_folder(folder, force) as aside:
            write_climb(aside, self, video=video, progress=progress)
        return Path(folder)

    def render(self, file: str | Path, *, force: bool = False, **options: Any) -> Path:
        """Render the humanoid's climb and the character's side by side, each with its own rope.

        Args:
          file: the ``.mp4`` file.
          force: whether an existing file is replaced.
          options: of :func:`render_climb`, such as ``width=640``.

        Raises:
          OutputError: the file exists and ``force`` was not given, or it cannot be written.
          RenderError: no offscreen OpenGL.
        """
        check_file(file, force)
        return render_climb(file, self, **options)


def write_climb(
    folder: str | Path,
    climb: RopeClimb,
    *,
    video: bool = True,
    progress: Progress = no_progress,
) -> None:
    """Write everything of a climb into a folder that is there.

    Args:
      folder: where; :func:`mjmotion.output.folder.result_folder` has it appear whole or not.
      climb: what :func:`mjmotion.apps.rope.climb_rope` returned.
      video: whether to render ``video.mp4`` too.
      progress: told of every frame of the video.

    Raises:
      OutputError: a file cannot be written.
      RenderError: a video was asked for and there is no offscreen OpenGL.
    """
    folder = Path(folder)
    try:
        climb.motion.save(folder / MOTION)
        climb.source.save(folder / SOURCE)
        climb.original.save(folder / ORIGINAL_MOTION)
        save_contacts(folder / CONTACTS, climb.contacts)
        for name, content in (
            (CONSTRAINTS, constraint_entries(climb.constraints)),
            (REPORT, climb_report(climb)),
        ):
            text = json.dumps(content, indent=2, allow_nan=False)
            (folder / name).write_text(text + "\n", encoding="utf-8")
    except OSError as error:
        raise OutputError(f"cannot write the result: {error.strerror or error}") from error
    save_model(climb.motion.character.spec, folder, MODEL)
    save_model(climb.original.character.spec, folder, ORIGINAL_MODEL)
    if video:
        render_climb(folder / VIDEO, climb, progress=progress)


def render_climb(
    path: str | Path,
    climb: RopeClimb,
    *,
    width: int = 1280,
    height: int = 720,
    progress: Progress = no_progress,
) -> Path:
    """Render the humanoid's climb and the character's side by side, each with its own rope.

    Raises:
      RenderError: no offscreen OpenGL.
      OutputError: the file cannot be written.
    """
    return render_side_by_side(
        path,
        (climb.original, climb.motion),
        (ORIGINAL, climb.character),
        grasps=marks(climb),
        width=width,
        height=height,
        progress=progress,
    )


def marks(climb: RopeClimb) -> list[Grasp]:
    """Return the holds of a climb as places to mark in pictures."""
    return [
        Grasp(hold.site.replace("_", " "), hold.start, hold.end, hold.point) for hold in climb.holds
    ]


def constraint_entries(constraints: Sequence[SiteConstraint]) -> list[dict[str, Any]]:
    """Return constraints of one place each as entries of a constraints file."""
    entries = []
    for constraint in constraints:
        if constraint.position is None or constraint.quat is None:
            continue
        entries.append(
            {
                "site": constraint.site,
                "frames": [int(constraint.frames[0]), int(constraint.frames[-1]) + 1],
                "position": [float(x) for x in constraint.position.reshape(-1, 3)[0]],
                "quat": [float(x) for x in constraint.quat.reshape(-1, 4)[0]],
            }
        )
    return entries


def climb_report(climb: RopeClimb) -> dict[str, Any]:
    """Return the contents of ``report.json``."""
    trace = climb.trace
    figures = {ORIGINAL: climb.original_figures, climb.character: climb.figures}
    metrics = {
        name: value
        for name, value in dataclasses.asdict(climb.figures).items()
        if isinstance(value, float)
    }
    return {
        "title": f"Climbing a rope: {ORIGINAL} and {climb.character}",
        "frames": climb.motion.nframe,
        "fps": climb.motion.fps,
        "scalar_constraints": trace.nscalar,
        "levels": [dataclasses.asdict(level) for level in trace.levels],
        "fit_seconds": trace.fit_seconds,
        "first_error_percent": trace.first_error_percent,
        "exact_error_percent": trace.exact_error_percent,
        "metrics": metrics | {"jerk_ratio_rms": climb.jerk_ratio},
        "figures": {name: dataclasses.asdict(value) for name, value in figures.items()},
        "broken": climb.broken(),
        "unmet": [dataclasses.asdict(one) for one in climb.unmet],
    }
