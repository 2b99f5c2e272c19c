"""Reader for AMASS: poses of SMPL, SMPL-H or SMPL-X as axis-angles, on a mean person's skeleton.

Such a file holds angles and a place, and no bones: those are in a body model, which is not needed.
A humanoid's bones are not the recorded person's in any case; what counts is where the joints of
these models are within a body, and that is nearly the same for all shapes.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mjmotion.boundary.arrays import read_archive
from mjmotion.boundary.files import check_plain
from mjmotion.boundary.limits import MOST_FRAMES, MOST_LENGTH, at_most, real_array
from mjmotion.clips.skeleton import Clip, checked_rate, pose_skeleton
from mjmotion.exceptions import ClipError, frame_list
from mjmotion.numerics import rotations as rot

Array = NDArray[np.float64]

# Offset of each joint from its parent [m] at rest (y up, x to the left, z ahead): the mean shape of
# SMPL (Loper et al., SIGGRAPH Asia 2015; joints 0 to 21 are those of SMPL-H and SMPL-X too), made
# symmetric and rounded to a millimetre.
_JOINTS: tuple[tuple[str, int, tuple[float, float, float]], ...] = (
    ("pelvis", -1, (0.0, 0.0, 0.0)),
    ("left_hip", 0, (0.069, -0.091, -0.006)),
    ("right_hip", 0, (-0.069, -0.091, -0.006)),
    ("spine1", 0, (0.0, 0.109, -0.027)),
    ("left_knee", 1, (0.036, -0.379, -0.007)),
    ("right_knee", 2, (-0.036, -0.379, -0.007)),
    ("spine2", 3, (0.0, 0.135, 0.001)),
    ("left_ankle", 4, (-0.015, -0.398, -0.043)),
    ("right_ankle", 5, (0.015, -0.398, -0.043)),
    ("spine3", 6, (0.0, 0.053, 0.025)),
    ("left_foot", 7, (0.026, -0.052, 0.121)),
    ("right_foot", 8, (-0.026, -0.052, 0.121)),
    ("neck", 9, (0.0, 0.214, -0.043)),
    ("left_collar", 9, (0.08, 0.121, -0.036)),
    ("right_collar", 9, (-0.08, 0.121, -0.036)),
    ("head", 12, (0.0, 0.065, 0.051)),
    ("left_shoulder", 13, (0.094, 0.032, -0.009)),
    ("right_shoulder", 14, (-0.094, 0.032, -0.009)),
    ("left_elbow", 16, (0.257, -0.013, -0.024)),
    ("right_elbow", 17, (-0.257, -0.013, -0.024)),
    ("left_wrist", 18, (0.252, 0.008, -0.003)),
    ("right_wrist", 19, (-0.252, 0.008, -0.003)),
)
_RATES = ("mocap_framerate", "mocap_frame_rate", "fps", "framerate", "frame_rate")


def read_amass(path: str | Path, *, fps: float | None = None) -> Clip:
    """Read an AMASS file: ``poses`` (or ``root_orient`` and ``pose_body``), ``trans`` and a rate.

    Hands and face are left out; ``betas``, the shape, is not needed.

    Args:
      path: the .npz file.
      fps: frames a second in place of the file's.

    Raises:
      ClipError: the file is missing, damaged, or holds something else.
    """
    arrays = _load(Path(path))
    poses = _poses(path, arrays)
    nframe, njoint = len(poses), len(_JOINTS)
    at_most(nframe, MOST_FRAMES, f"frames of '{path}'", ClipError)
    trans = np.zeros((nframe, 3))
    if "trans" in arrays:
        trans = _numbers(path, "trans", arrays["trans"])
        if trans.shape != (nframe, 3):
            raise ClipError(f"'{path}': trans is {trans.shape}, not {nframe} frames of 3")
        far = np.flatnonzero((np.abs(trans) > MOST_LENGTH).any(axis=1))
        if len(far):
            raise ClipError(
                f"'{path}': trans is beyond {MOST_LENGTH:,.0f} m at frames"
                f" {frame_list(far.tolist())}: mend the file",
                far.tolist(),
            )
    if fps is None:
        named = next((name for name in _RATES if name in arrays), None)
        if named is None:
            raise ClipError(f"'{path}' has no {_RATES[0]}: give its rate as --fps")
        rate = _numbers(path, named, arrays[named])
        if rate.size != 1:
            raise ClipError(f"'{path}': {named} is no one number: give the rate as --fps")
        fps = float(rate.reshape(()))
    fps = checked_rate(str(path), fps)
    names, parents, offsets = zip(*_JOINTS, strict=True)
    translations = np.tile(np.array(offsets), (nframe, 1, 1))
    translations[:, 0] += trans
    vectors = poses[:, : 3 * njoint].reshape(nframe, njoint, 3)
    turns = rot.to_matrix(rot.exp(vectors))
    return pose_skeleton(
        str(path), names, np.array(parents), np.array(offsets), translations, turns, fps, {}
    )


def _poses(path: str | Path, arrays: Mapping[str, NDArray[Any]]) -> Array:
    """Return (nframe, 66 or more) axis-angles of root and body."""
    if "poses" in arrays:
        poses = _numbers(path, "poses", arrays["poses"])
    elif "root_orient" in arrays and "pose_body" in arrays:
        parts = [_numbers(path, name, arrays[name]) for name in ("root_orient", "pose_body")]
        if any(part.ndim != 2 for part in parts) or len(parts[0]) != len(parts[1]):
            raise ClipError(f"'{path}': root_orient and pose_body have not the same frames")
        poses = np.concatenate(parts, axis=1)
    else:
        raise ClipError(f"'{path}' has no poses: it is neither a motion of ours nor of AMASS")
    if poses.ndim == 3:  # one row a joint
        poses = poses.reshape(len(poses), -1)
    if poses.ndim != 2 or poses.shape[1] < 3 * len(_JOINTS):
        raise ClipError(
            f"'{path}': poses is {poses.shape}: it needs {3 * len(_JOINTS)} or more angles a frame"
        )
    return poses


def _numbers(path: str | Path, name: str, values: NDArray[Any]) -> Array:
    """Return an array of finite or other numbers."""
    return real_array(values, f"'{path}': {name}", ClipError)


def _load(path: Path) -> dict[str, NDArray[Any]]:
    """Return the arrays of the file that are of use."""
    check_plain(path, "AMASS file", ClipError)
    try:
        return read_archive(path, (), ("poses", "root_orient", "pose_body", "trans", *_RATES))
    except ValueError as error:
        raise ClipError(f"'{path}' is damaged ({error}): get it again") from None
