"""A motion as a table (CSV), for spreadsheets and other programs.

The first line names the columns: ``time`` [s], then ``qpos`` in MuJoCo order, a joint with several
numbers as ``root.x root.y root.z root.qw root.qx root.qy root.qz`` or ``spine.qw … spine.qz``, a
hinge or slide by its name alone. The columns may stand in any order; lengths [m], angles [rad].
"""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from mjmotion.body.character import Character, CharacterLike
from mjmotion.body.motion import Motion
from mjmotion.clips.skeleton import read_text
from mjmotion.exceptions import ClipError, frame_list

_PARTS = {
    int(mujoco.mjtJoint.mjJNT_FREE): ("x", "y", "z", "qw", "qx", "qy", "qz"),
    int(mujoco.mjtJoint.mjJNT_BALL): ("qw", "qx", "qy", "qz"),
}


def column_names(model: mujoco.MjModel) -> list[str]:
    """Return the names of the ``qpos`` columns (nq)."""
    names = []
    for joint in range(model.njnt):
        name = model.joint(joint).name
        parts = _PARTS.get(int(model.jnt_type[joint]))
        names += [f"{name}.{part}" for part in parts] if parts else [name]
    return names


def write_csv(path: str | Path, motion: Motion) -> None:
    """Write a motion as a table."""
    times = np.arange(motion.nframe)[:, None] / motion.fps
    header = ",".join(["time", *column_names(motion.model)])
    table = np.concatenate([times, motion.qpos], axis=1)
    with Path(path).open("w", encoding="utf-8") as file:
        np.savetxt(file, table, fmt="%.9g", delimiter=",", header=header, comments="")


def read_csv(path: str | Path, character: CharacterLike, *, fps: float | None = None) -> Motion:
    """Read a table as a motion.

    Args:
      path: the file.
      character: the character of the motion, or what names it.
      fps: frames a second in place of the ``time`` column.

    Raises:
      ClipError: the file is missing or malformed, lacks columns, or its times are not even.
    """
    lines = [line for line in read_text(str(path), "CSV").splitlines() if line.strip()]
    header = [name.strip().strip('"') for name in lines[0].split(",")]
    character = Character.of(character)
    columns = column_names(character.model)
    missing = [name for name in columns if name not in header]
    if missing:
        raise ClipError(
            f"'{path}' lacks the column{'s' * (len(missing) > 1)} {', '.join(missing[:4])}"
            f"{', …' if len(missing) > 4 else ''}: its first line must name every number of qpos"
        )
    if len(lines) == 1:
        raise ClipError(f"'{path}' has no frames: export the clip again")
    for number, line in enumerate(lines[1:]):
        if line.count(",") != len(header) - 1:
            raise ClipError(
                f"'{path}' frame {number} has {line.count(',') + 1} values, not {len(header)}:"
                " mend the file",
                (number,),
            )
    try:
        table = np.loadtxt(lines[1:], delimiter=",", ndmin=2)
    except ValueError as error:
        raise ClipError(f"'{path}' has a value that is not a number: {error}") from None
    if fps is None:
        if "time" not in header or len(table) < 2:
            raise ClipError(f"'{path}' does not say its rate: add a 'time' column or give fps")
        steps = np.diff(table[:, header.index("time")])
        uneven = np.flatnonzero(~(np.abs(steps - steps.mean()) < 0.02 * np.abs(steps.mean())))
        if len(uneven) or not steps.mean() > 0:
            raise ClipError(
                f"'{path}' has times that are not even at frames {frame_list(uneven.tolist())}:"
                " resample it",
                uneven.tolist(),
            )
        fps = 1 / steps.mean()
        fps = float(round(fps)) if abs(fps - round(fps)) < 1e-4 * fps else float(fps)
    return Motion(character, table[:, [header.index(name) for name in columns]], fps)
