"""A motion: ``qpos`` of every frame, at a fixed rate, on the character it belongs to.

    motion = Motion("humanoid", qpos, fps=30.0)
    motion.save("walk.npz")
    again = Motion.load("walk.npz", "humanoid")

A motion is never changed in place: its arrays are read-only and every edit returns a new one.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjmotion.body.character import (
    Character,
    CharacterLike,
    bone_offsets,
    joint_names,
    quaternion_addresses,
)
from mjmotion.body.kinematics import check_free_root
from mjmotion.body.recording import Recording
from mjmotion.boundary.arrays import read_archive
from mjmotion.boundary.files import check_plain
from mjmotion.boundary.limits import (
    MOST_ANGLE,
    MOST_FRAMES,
    MOST_LENGTH,
    at_most,
    rate,
    real_array,
    real_number,
)
from mjmotion.boundary.whole import whole_file
from mjmotion.exceptions import ClipError, ModelError, MotionError, frame_list
from mjmotion.numerics.rotations import multiply, rotate, yaw_quat

Array = NDArray[np.float64]

SAME_BONES = 1e-4  # how far a file's bones may be off: written MJCF has six digits [m]
_ROUNDING = 1e-15  # by how much a normalised quaternion's length may differ from 1


@dataclasses.dataclass(frozen=True, eq=False, init=False)
class Motion:
    """Frames of one character at a fixed rate.

    Args:
      character: the character, alone or in a scene, or what names one.
      qpos: (nframe, nq) frames.
      fps: frames a second.
      recording: what it was made of, if that is known.

    Attributes:
      character: its first joint is the free root.
      qpos: (nframe, nq) float64, read-only, MuJoCo order: root x y z [m], root quaternion wxyz,
        then the joints ([rad] for hinges, wxyz for balls). Quaternions are normalised.
      fps: frames a second.
      recording: the recording that these very frames were made of, wherever they are on the ground;
        None of frames that are others, and of those that no recording is behind.

    Raises:
      ModelError: the model has no free root, or something else in it is free too.
      ClipError: wrong shape, no frames, values that are not finite, a rate that is not positive,
        or a recording of another number of frames.
    """

    character: Character
    qpos: NDArray[np.float64]
    fps: float
    recording: Recording | None

    def __init__(
        self,
        character: CharacterLike,
        qpos: ArrayLike,
        fps: float,
        recording: Recording | None = None,
    ) -> None:
        object.__setattr__(self, "character", Character.of(character))
        object.__setattr__(self, "qpos", self._checked(qpos))
        object.__setattr__(self, "fps", rate(fps, "fps", ClipError))
        if recording is not None and recording.nframe != self.nframe:
            raise ClipError(
                f"the recording has {recording.nframe} frames and the motion {self.nframe}: they"
                " are not of one another"
            )
        object.__setattr__(self, "recording", recording)

    def _checked(self, given: ArrayLike) -> NDArray[np.float64]:
        """Return frames as they are kept: a read-only copy, quaternions normalised."""
        model = self.model
        check_free_root(model)
        qpos = np.array(real_array(given, "qpos", ClipError), order="C")
        if qpos.ndim != 2 or qpos.shape[1] != model.nq:
            raise ClipError(
                f"qpos has shape {qpos.shape}, the model wants (nframe, {model.nq}):"
                " use the model that the motion was made for"
            )
        if len(qpos) == 0:
            raise ClipError("the motion has no frames: check the clip it came from")
        bad = np.flatnonzero(~np.isfinite(qpos).all(axis=1))
        if len(bad):
            raise ClipError(f"qpos is not finite at frames {frame_list(bad)}: mend the clip", bad)
        at_most(len(qpos), MOST_FRAMES, "frames of a motion", ClipError)
        for what, values, most in (
            ("root position [m]", qpos[:, :3], MOST_LENGTH),
            ("qpos", qpos, max(MOST_ANGLE, MOST_LENGTH)),
        ):
            bad = np.flatnonzero((np.abs(values) > most).any(axis=1))
            if len(bad):
                raise ClipError(
                    f"{what} is beyond {most:,.0f} at frames {frame_list(bad)}: mend the clip", bad
                )
        columns = np.array(quaternion_addresses(model))[:, None] + np.arange(4)
        quats = qpos[:, columns]
        norm = np.sqrt(np.einsum("fqi,fqi->fq", quats, quats))
        bad = np.flatnonzero((norm < 1e-6).any(axis=1))
        if len(bad):
            raise ClipError(f"a quaternion is zero at frames {frame_list(bad)}", bad)
        # What is of unit length but for rounding stays to the bit: frames that no edit touches are
        # those they were, however often they are copied and saved.
        norm[np.abs(norm - 1.0) < _ROUNDING] = 1.0
        if (norm != 1.0).any():
            qpos[:, columns] = quats / norm[..., None]
        qpos.flags.writeable = False
        return qpos

    def __repr__(self) -> str:
        return f"<Motion: {self.nframe} frames at {self.fps:g} fps on {self.character.name}>"

    @property
    def model(self) -> mujoco.MjModel:
        """The character's compiled model."""
        return self.character.model

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
        return joint_names(self.model)

    def replace(self, qpos: ArrayLike) -> Motion:
        """Return the same motion with other frames; ``qpos`` (nframe, nq)."""
        return Motion(self.character, qpos, self.fps)

    def put(self, qpos: Array) -> Motion:
        """Return the same motion with frames (nframe, nq) that are known to be good.

        For frames that come of a motion's own and are checked, or looked at, no further: they are
        neither checked nor normalised nor copied, so the array must stay as it is.
        """
        moved = object.__new__(Motion)
        frames = qpos.view()
        frames.flags.writeable = False
        fields = {"character": self.character, "qpos": frames, "fps": self.fps, "recording": None}
        for name, value in fields.items():
            object.__setattr__(moved, name, value)
        return moved

    def moved(self, yaw: float, pivot: ArrayLike, shift: ArrayLike) -> Motion:
        """Return the motion as a whole elsewhere on the ground: no pose of it is another.

        Args:
          yaw: by how much it is turned about the vertical [rad].
          pivot: (3,) about which point [m].
          shift: (3,) by which it is moved after that [m].
        """
        qpos, centre = np.array(self.qpos), np.asarray(pivot, dtype=np.float64)
        turn = yaw_quat(np.full(len(qpos), yaw))
        qpos[:, :3] = rotate(turn, qpos[:, :3] - centre) + (centre + np.asarray(shift))
        qpos[:, 3:7] = multiply(turn, qpos[:, 3:7])
        return Motion(self.character, qpos, self.fps, self.recording)

    def on(self, character: CharacterLike) -> Motion:
        """Return the motion on the same body elsewhere, such as with a scene added.

        Raises:
          ModelError: the body is another: other joints, bones of other lengths, other shapes.
        """
        other = Character.of(character)
        names = joint_names(other.model)
        if names != self.joint_names or other.model.nq != self.model.nq:
            raise ModelError("the two models have different joints: retarget the motion instead")
        if difference := self.character.different_from(other):
            raise ModelError(
                f"'{other.name}' is another body than '{self.character.name}' ({difference}):"
                " retarget the motion instead"
            )
        return Motion(other, self.qpos, self.fps, self.recording)

    def save(self, path: str | Path, *, compressed: bool = True) -> None:
        """Write the motion file (.npz): ``qpos``, ``fps``, ``joint_names``, bones; whole or not.

        Uncompressed it is about an eighth larger, and written in a thirtieth of the time.
        """
        bones = bone_offsets(self.model)
        with whole_file(path) as aside, aside.open("wb") as file:
            (np.savez_compressed if compressed else np.savez)(
                file,
                qpos=self.qpos,
                fps=np.float64(self.fps),
                joint_names=np.array(self.joint_names),
                body_names=np.array(list(bones)),
                body_pos=np.array(list(bones.values())),
            )

    @classmethod
    def load(cls, path: str | Path, character: CharacterLike) -> Motion:
        """Read a motion file.

        Args:
          path: an ``.npz`` file.
          character: the character that it was made for, or what names one.

        Raises:
          ClipError: the file is missing, damaged, or made for other joints or bones. A file that
            says nothing of bones (``body_names``, ``body_pos``) is taken for its joints alone. One
            from before the character had toes that bend is read with its toes at rest.
        """
        path = Path(path)
        check_plain(path, "motion file", ClipError)
        try:
            data = read_archive(
                path, ("qpos", "fps", "joint_names"), optional=("body_names", "body_pos")
            )
            qpos = real_array(data["qpos"], "qpos")
            names = data["joint_names"].ravel().tolist()
            if data["fps"].size != 1:
                raise ValueError(f"fps has the shape {data['fps'].shape}: it must be one number")
            fps = real_number(data["fps"].ravel()[0], "fps")
            bones = dict[str, Array]()
            if "body_names" in data and "body_pos" in data:
                places = real_array(data["body_pos"], "body_pos").reshape(-1, 3)
                bodies = [str(name) for name in data["body_names"].ravel()]
                if len(bodies) != len(places):
                    raise ValueError(
                        f"it has {len(bodies)} body_names and {len(places)} rows of body_pos"
                    )
                bones = dict(zip(bodies, places, strict=True))
        except (ValueError, MotionError) as error:
            raise ClipError(
                f"'{path}' is not a motion file ({error}): it needs qpos, fps and joint_names"
            ) from error
        character = Character.of(character)
        toes = toe_joints(character)
        own = joint_names(character.model)
        if toes and names == [name for name in own if name not in toes]:
            qpos = _with_toes_at_rest(character, qpos, toes)
        elif [str(name) for name in names] != own:
            raise ClipError(f"'{path}' was made for other joints than the model's: retarget it")
        if other := _other_bones(bones, bone_offsets(character.model)):
            more = f" and {len(other) - 1} more" if len(other) > 1 else ""
            raise ClipError(
                f"'{path}' was made for another body than '{character.name}' (bone of"
                f" {other[0]}{more}): give the character it was made for, or retarget it"
            )
        try:
            return cls(character, qpos, fps)
        except ClipError as error:
            raise ClipError(f"'{path}': {error}", error.frames) from error


def toe_joints(character: Character) -> dict[str, int]:
    """Return the hinges of a character's toes: joint name to address in ``qpos``."""
    try:
        feet = character.feet
    except ModelError:
        return {}
    addresses = [foot.toes.address for foot in feet if foot.toes is not None]
    model = character.model
    return {
        model.joint(int(np.flatnonzero(model.jnt_qposadr == address)[0])).name: address
        for address in sorted(addresses)
    }


def _with_toes_at_rest(character: Character, qpos: Array, toes: dict[str, int]) -> Array:
    """Return frames (nframe, nq) of a body without toes (nframe, nq - k) with those at rest."""
    whole = character.model.nq
    if qpos.ndim != 2 or qpos.shape[1] != whole - len(toes):
        return qpos  # refused by its shape
    full = np.tile(character.model.qpos0, (len(qpos), 1))
    full[:, np.setdiff1d(np.arange(whole), list(toes.values()))] = qpos
    return full


def _other_bones(bones: dict[str, Array], own: dict[str, Array]) -> list[str]:
    """Return which of a file's bones a character lacks, or has of another length or direction."""
    return [
        name
        for name, place in bones.items()
        if name not in own or not np.abs(own[name] - place).max() <= SAME_BONES
    ]
