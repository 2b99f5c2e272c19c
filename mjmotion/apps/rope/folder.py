"""The output folder of a rope climb.

    with result_folder("out/rope") as folder:
        write_climb(folder, climb)

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

from mjmotion.apps.rope.climb import ORIGINAL, RopeClimb
from mjmotion.constraints import SiteConstraint
from mjmotion.exceptions import OutputError
from mjmotion.footsteps.contacts import save_contacts
from mjmotion.numerics.progress import Progress
from mjmotion.output.folder import CONTACTS, MODEL, MOTION, REPORT, SOURCE, VIDEO
from mjmotion.output.video.side_by_side import Grasp, render_side_by_side
from mjmotion.scene import save_model

ORIGINAL_MOTION, ORIGINAL_MODEL = "original.npz", "original.xml"
CONSTRAINTS = "constraints.json"


def write_climb(
    folder: str | Path,
    climb: RopeClimb,
    *,
    video: bool = True,
    progress: Progress | None = None,
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
        raise OutputError(f"cannot write into '{folder}': {error.strerror or error}") from error
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
    progress: Progress | None = None,
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
