"""A motion as a table (CSV), for spreadsheets and other programs.

The first line names the columns: ``time`` [s], then ``qpos`` in MuJoCo order, a joint with several
numbers as ``root.x root.y root.z root.qw root.qx root.qy root.qz`` or ``spine.qw … spine.qz``, a
hinge or slide by its name alone. The columns may stand in any order; lengths [m], angles [rad].
"""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.character import Character, CharacterLike
from mjmotion.body.motion import Motion, toe_joints
from mjmotion.boundary.limits import MOST_FRAMES, at_most
from mjmotion.boundary.whole import whole_file
from mjmotion.clips.skeleton import read_lines
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
    with whole_file(path) as aside, aside.open("w", encoding="utf-8") as file:
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
    lines = [line for line in read_lines(path, "CSV") if line.strip()]
    header = [name.strip().strip('"') for name in lines[0].split(",")]
    character = Character.of(character)
    columns = column_names(character.model)
    if twice := [name for name in (*columns, "time") if header.count(name) > 1]:
        raise ClipError(f"'{path}' has the column {twice[0]} twice: keep one of them")
    # A table from before the character had toes that bend has them at rest.
    toes = toe_joints(character)
    missing = [name for name in columns if name not in header]
    missing = [] if missing and set(missing) == set(toes) else missing
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
    at_most(len(lines) - 1, MOST_FRAMES, f"frames of '{path}'", ClipError)
    try:
        table = np.loadtxt(lines[1:], delimiter=",", ndmin=2)
    except ValueError as error:
        raise ClipError(f"'{path}' has a value that is not a number: {error}") from None
    if len(bad := np.flatnonzero(~np.isfinite(table).all(axis=1))):
        raise ClipError(
            f"'{path}' has values that are not finite at frames {frame_list(bad.tolist())}:"
            " mend the file",
            bad.tolist(),
        )
    if fps is None:
        fps = _rate(path, header, table)
    qpos = np.tile(character.model.qpos0, (len(table), 1))
    for address, name in enumerate(columns):
        if name in header:
            qpos[:, address] = table[:, header.index(name)]
    try:
        return Motion(character, qpos, fps)
    except ClipError as error:
        raise ClipError(f"'{path}': {error}", error.frames) from error


def _rate(path: str | Path, header: list[str], table: NDArray[np.float64]) -> float:
    """Return frames a second from the ``time`` column [s]."""
    if "time" not in header or len(table) < 2:
        raise ClipError(f"'{path}' does not say its rate: add a 'time' column or give fps")
    steps = np.diff(table[:, header.index("time")])
    # The median: one gap is one gap, and does not make all the other steps look short.
    usual = float(np.median(steps))
    if not usual > 0:
        raise ClipError(f"'{path}' has times that do not grow: {usual:g} s from row to row")
    uneven = np.flatnonzero(np.abs(steps - usual) >= 0.02 * usual)
    if len(uneven):
        raise ClipError(
            f"'{path}' has times that are not even after frames {frame_list(uneven.tolist())}:"
            " resample it",
            uneven.tolist(),
        )
    fps = float(1 / steps.mean())
    return float(round(fps)) if abs(fps - round(fps)) < 1e-4 * fps else fps
