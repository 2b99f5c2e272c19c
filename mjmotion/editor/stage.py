"""The model that the page shows: character and scene, and the source as a ghost beside them.

    stage = Stage(shown)
    stage.pose(data, shown, frame)
    stage.part_geoms("door1")

The ghost is a second character in the model, for the page draws no meshes besides those of its
model. It is in a geom group of its own, which hides it.
"""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjmotion.body.character import Character
from mjmotion.body.kinematics import root_body
from mjmotion.editor.shown import Shown
from mjmotion.exceptions import ModelError
from mjmotion.scene.composing import without_scene

PREFIX = "ghost_"
GHOST_GROUP = 5
GHOST_RGBA = (0.25, 0.50, 0.95, 0.28)


class Stage:
    """A model to look at, made of the model of a motion.

    Args:
      shown: what it is to show.

    Attributes:
      of: the model of the motions that it shows.
      model: that, with a ghost.
      has_ghost: whether there is one: a character without its MJCF has none.
    """

    def __init__(self, shown: Shown) -> None:
        self.of = shown.model
        self.model, self.has_ghost = with_ghost(shown.motion.character)
        self._own = _addresses(self.of, self.model, "")
        self._ghost = _addresses(self.of, self.model, PREFIX) if self.has_ghost else None

    def pose(
        self, data: mujoco.MjData, shown: Shown, frame: int, behind: ArrayLike = (0.0, 0.0, 0.0)
    ) -> None:
        """Put a frame's poses, of motion and source, into the data of this stage's model.

        Args:
          data: of :attr:`model`.
          shown: source and motion.
          frame: which frame.
          behind: (3,) how far the ghost is moved, so that it does not flicker where both agree [m].
        """
        model, (to, origin) = self.model, self._own
        data.qpos[to] = shown.motion.qpos[frame][origin]
        if self._ghost is not None:
            to, origin = self._ghost
            data.qpos[to] = shown.source.qpos[frame][origin]
            data.qpos[to[:3]] += behind
        data.time = frame / shown.motion.fps
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_camlight(model, data)

    def without_ghost(self, option: mujoco.MjvOption) -> mujoco.MjvOption:
        """Return what is to be picked from: what is seen, but no ghost."""
        own = mujoco.MjvOption()
        own.geomgroup[:] = option.geomgroup
        own.geomgroup[GHOST_GROUP] = 0
        return own

    def character_bodies(self) -> NDArray[np.bool_]:
        """Return which bodies (nbody,) are the character's own, and no ghost's."""
        return np.asarray(self.model.body_rootid == root_body(self.model))


def with_ghost(character: Character) -> tuple[mujoco.MjModel, bool]:
    """Return the model of a character in its scene with a ghost of the character, and whether so.

    Without the MJCF, or where MuJoCo does not take both, the model is the character's own.
    """
    if not character.has_spec:
        return character.model, False
    try:
        spec = character.spec.copy()
        spec.attach(ghost_spec(character), prefix=PREFIX, frame=spec.worldbody.add_frame())
        for key in list(spec.keys):  # of the character alone
            spec.delete(key)
        return spec.copy().compile(), True
    except (ValueError, ModelError, mujoco.FatalError):
        return character.model, False


def ghost_spec(character: Character) -> mujoco.MjSpec:
    """Return a character that is seen and does nothing."""
    spec = without_scene(character).spec.copy()
    for kind in (
        "keys",
        "tuples",
        "sensors",
        "actuators",
        "tendons",
        "equalities",
        "excludes",
        "numerics",
        "texts",
    ):
        for element in list(getattr(spec, kind)):
            spec.delete(element)
    used = {geom.meshname for geom in spec.geoms}
    for geom in spec.geoms:
        # What is hidden by its own group, such as shapes for collision, stays hidden.
        hidden = geom.group > 2
        geom.rgba = (*GHOST_RGBA[:3], 0.0) if hidden else GHOST_RGBA
        geom.group, geom.material = GHOST_GROUP, ""
        geom.contype = geom.conaffinity = 0
    for kind in ("materials", "textures", "hfields"):
        for element in list(getattr(spec, kind)):
            spec.delete(element)
    for mesh in [one for one in spec.meshes if one.name not in used]:
        spec.delete(mesh)
    return spec


def _addresses(
    of: mujoco.MjModel, model: mujoco.MjModel, prefix: str
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return where in ``model`` joints of ``of`` have their coordinates, and where in ``of``."""
    wide: Mapping[int, int] = {
        int(mujoco.mjtJoint.mjJNT_FREE): 7,
        int(mujoco.mjtJoint.mjJNT_BALL): 4,
    }
    to: list[int] = []
    origin: list[int] = []
    for joint in range(of.njnt):
        name = prefix + of.joint(joint).name
        other = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name)
        if not of.joint(joint).name:
            other = -1 if prefix else joint  # nameless joints are where they were
        if other < 0:
            continue
        width = wide.get(int(of.jnt_type[joint]), 1)
        to += range(model.jnt_qposadr[other], model.jnt_qposadr[other] + width)
        origin += range(of.jnt_qposadr[joint], of.jnt_qposadr[joint] + width)
    return np.array(to, dtype=np.int64), np.array(origin, dtype=np.int64)
