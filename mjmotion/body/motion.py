"""A motion: ``qpos`` of every frame, at a fixed rate, on the MuJoCo model it belongs to.

    motion = Motion(model, qpos, fps=30.0)
    motion.save("walk.npz")
    again = Motion.load("walk.npz", model)

A motion is never changed in place: its arrays are read-only and every edit returns a new one.
"""

from __future__ import annotations

import dataclasses
import zipfile
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjmotion.exceptions import ClipError, ModelError, frame_list

_ROUNDING = 1e-15  # by how much a normalised quaternion's length may differ from 1


@dataclasses.dataclass(frozen=True, eq=False)
class Motion:
    """Frames of one model at a fixed rate.

    Attributes:
      model: the MuJoCo model; its first joint is the free root.
      qpos: (nframe, nq) float64, read-only, MuJoCo order: root x y z [m], root quaternion wxyz,
        then the joints ([rad] for hinges, wxyz for balls). Quaternions are normalised.
      fps: frames a second.

    Raises:
      ModelError: the model has no free root.
      ClipError: wrong shape, no frames, values that are not finite, a rate that is not positive.
    """

    model: mujoco.MjModel
    qpos: NDArray[np.float64]
    fps: float

    def __post_init__(self) -> None:
        check_free_root(self.model)
        qpos = np.array(self.qpos, dtype=np.float64, order="C")
        if qpos.ndim != 2 or qpos.shape[1] != self.model.nq:
            raise ClipError(
                f"qpos has shape {qpos.shape}, the model wants (nframe, {self.model.nq}):"
                " use the model that the motion was made for"
            )
        if len(qpos) == 0:
            raise ClipError("the motion has no frames: check the clip it came from")
        bad = np.flatnonzero(~np.isfinite(qpos).all(axis=1))
        if len(bad):
            raise ClipError(f"qpos is not finite at frames {frame_list(bad)}: mend the clip", bad)
        if not (np.isfinite(self.fps) and self.fps > 0):
            raise ClipError(f"fps is {self.fps}: it must be a positive number")
        columns = np.array(quaternion_addresses(self.model))[:, None] + np.arange(4)
        quats = qpos[:, columns]
        norm = np.sqrt(np.einsum("fqi,fqi->fq", quats, quats))
        bad = np.flatnonzero((norm < 1e-6).any(axis=1))
        if len(bad):
            raise ClipError(f"a quaternion is zero at frames {frame_list(bad)}", bad)
        # What is of unit length but for rounding stays to the bit: frames that no edit touches are
        # those they were, however often they are copied and saved.
        norm[np.abs(norm - 1.0) < _ROUNDING] = 1.0
        qpos[:, columns] = quats / norm[..., None]
        qpos.flags.writeable = False
        object.__setattr__(self, "qpos", qpos)
        object.__setattr__(self, "fps", float(self.fps))

    @property
    def nframe(self) -> int:
        """Number of frames."""
        return len(self.qpos)

    @property
    def duration(self) -> float:
        """Time from the first frame to the last [s]."""
        return (self.nframe - 1) / self.fps

    @property
    def joint_names(self) -> list[str]:
        """Names of the model's joints, in ``qpos`` order."""
        return [self.model.joint(i).name for i in range(self.model.njnt)]

    def replace(self, qpos: ArrayLike) -> Motion:
        """Return the same motion with other frames; ``qpos`` (nframe, nq)."""
        return Motion(self.model, np.asarray(qpos, dtype=np.float64), self.fps)

    def on(self, model: mujoco.MjModel) -> Motion:
        """Return the motion on another model with the same joints, such as one with a scene added.

        Raises:
          ModelError: the joints differ.
        """
        names = [model.joint(i).name for i in range(model.njnt)]
        if names != self.joint_names or model.nq != self.model.nq:
            raise ModelError("the two models have different joints: retarget the motion instead")
        return Motion(model, self.qpos, self.fps)

    def save(self, path: str | Path) -> None:
        """Write the motion file (.npz): ``qpos``, ``fps``, ``joint_names``."""
        with Path(path).open("wb") as file:
            np.savez_compressed(
                file,
                qpos=self.qpos,
                fps=np.float64(self.fps),
                joint_names=np.array(self.joint_names),
            )

    @classmethod
    def load(cls, path: str | Path, model: mujoco.MjModel) -> Motion:
        """Read a motion file.

        Raises:
          ClipError: the file is missing, damaged, or made for other joints.
        """
        path = Path(path)
        if not path.is_file():
            raise ClipError(f"motion file '{path}' does not exist: check the path")
        try:
            with np.load(path, allow_pickle=False) as data:
                qpos, fps, names = data["qpos"], float(data["fps"]), list(data["joint_names"])
        except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
            raise ClipError(
                f"'{path}' is not a motion file ({error}): it needs qpos, fps and joint_names"
            ) from error
        wanted = [model.joint(i).name for i in range(model.njnt)]
        if [str(name) for name in names] != wanted:
            raise ClipError(f"'{path}' was made for other joints than the model's: retarget it")
        return cls(model, qpos, fps)


def check_free_root(model: mujoco.MjModel) -> None:
    """Raise ModelError unless the model's first joint is free and is the only free one."""
    free = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)
    if len(free) != 1 or free[0] != 0:
        raise ModelError(
            "the model's first joint must be its only free one, the root:"
            f" it has {len(free)} free joints"
        )


def quaternion_addresses(model: mujoco.MjModel) -> list[int]:
    """Return where in ``qpos`` each quaternion begins: the root's and every ball's."""
    addresses = []
    for joint in range(model.njnt):
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
            addresses.append(int(model.jnt_qposadr[joint]) + 3)
        elif model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_BALL:
            addresses.append(int(model.jnt_qposadr[joint]))
    return addresses
