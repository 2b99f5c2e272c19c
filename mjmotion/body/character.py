"""A character: its MJCF, its compiled model, and what is found out about the two once.

    character = Character.load("humanoid")      # or a path to any MJCF with a free root, or a spec
    character.model, character.feet, character.limits.excess(qpos)

A motion carries its character, so frames cannot end up on another body. A character may stand in a
scene: then ``model`` and ``spec`` hold both, and what is found out is about the character alone.
"""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import TypeAlias

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjmotion.body.assets import find_asset
from mjmotion.body.bones import Bones
from mjmotion.body.feet import Foot, find_feet
from mjmotion.body.geom_points import geom_points
from mjmotion.body.joint_coupling import Coupling
from mjmotion.body.joint_limits import JointLimits
from mjmotion.body.kinematics import character_geoms, check_free_root, root_body
from mjmotion.body.limbs import Limb, Limbs, find_limbs
from mjmotion.body.parts import Parts, find_parts
from mjmotion.boundary.mjcf import MUJOCO_ERRORS, check_mjcf, check_model
from mjmotion.exceptions import ModelError, mujoco_message
from mjmotion.numerics.rotations import to_matrix

Array = NDArray[np.float64]

CharacterLike: TypeAlias = "Character | mujoco.MjModel | mujoco.MjSpec | str | Path"
"""What names a character: itself, a compiled model, a spec, a model's name or an MJCF file."""

SAME_BODY = 1e-6  # how far two bodies' sizes and axes may differ and still be one body [m, rad]


class Character:
    """One body with a free root.

    Args:
      model: the compiled model; its first joint is the free root.
      spec: what it was compiled from; without it the character cannot be put into a scene.
      name: short name for messages and reports; the model's own without.

    Raises:
      ModelError: the model's first joint is not free. Others may be: those of a scene that moves.
    """

    def __init__(
        self, model: mujoco.MjModel, spec: mujoco.MjSpec | None = None, name: str = ""
    ) -> None:
        check_free_root(model, only=False)
        self.model = model
        self.name = name or model.names[: model.names.index(b"\0")].decode() or "character"
        self._spec = spec
        self._chains: dict[tuple[Limb, ...], Limbs] = {}

    @classmethod
    def load(cls, source: str | Path | mujoco.MjSpec) -> Character:
        """Return the character of a model's name, an MJCF file, or a spec; a new one.

        Raises:
          ModelError: there is no such model, it does not compile, or it has no free root.
        """
        spec, name = read_spec(source)
        try:
            model = spec.compile()
        except MUJOCO_ERRORS as error:
            raise ModelError(
                f"character '{name}' does not compile: {mujoco_message(error)}"
            ) from error
        check_model(model, f"character '{name}'", ModelError)
        short = spec.modelname or name
        if not isinstance(source, mujoco.MjSpec):
            short = Path(name).stem
        try:
            check_free_root(model)
            return cls(model, spec, short)
        except ModelError as error:
            raise ModelError(f"character '{name}': {error}") from error

    @classmethod
    def of(cls, source: CharacterLike) -> Character:
        """Return a character from whatever names one; a character itself is returned as it is.

        Raises:
          ModelError: as :meth:`load`.
        """
        if isinstance(source, Character):
            return source
        if isinstance(source, mujoco.MjModel):
            check_free_root(source)
            return cls(source)
        return cls.load(source)

    def __repr__(self) -> str:
        model = self.model
        return f"<Character {self.name!r}: {model.nbody - 1} bodies, {model.nv} DOFs>"

    @property
    def spec(self) -> mujoco.MjSpec:
        """What the model was compiled from; treat it as read-only, copy it to change it.

        Raises:
          ModelError: the character was made from a compiled model, which does not know it.
        """
        if self._spec is None:
            raise ModelError(
                f"character '{self.name}' was made from a compiled model, without its MJCF: use"
                " Character.load(name, file or spec) to put it into a scene or write it"
            )
        return self._spec

    @property
    def has_spec(self) -> bool:
        """Whether :attr:`spec` is known."""
        return self._spec is not None

    @cached_property
    def geoms(self) -> NDArray[np.int64]:
        """The geoms of the bodies under the free root."""
        return character_geoms(self.model)

    @property
    def alone(self) -> bool:
        """Whether the model holds nothing but the character."""
        return len(self.geoms) == self.model.ngeom

    @cached_property
    def bones(self) -> Bones:
        """Where joints, bodies and sites sit in their parents."""
        return Bones.of(self.model)

    @cached_property
    def limits(self) -> JointLimits:
        """Joint limits; ModelError where the model says them wrongly."""
        return JointLimits(self.model)

    @cached_property
    def coupling(self) -> Coupling:
        """Joints that share degrees of freedom (§4.2); ModelError where said wrongly."""
        return Coupling(self.model, self.limits)

    @cached_property
    def feet(self) -> tuple[Foot, ...]:
        """Its feet; ModelError where it has none."""
        return find_feet(self.model)

    @cached_property
    def limbs(self) -> tuple[Limb, ...]:
        """Its ball–hinge–ball chains, which close in form (§5.2)."""
        return find_limbs(self.model)

    @cached_property
    def limb_by_end(self) -> dict[int, Limb]:
        """The limbs by the id of their end's body: foot or hand."""
        return {limb.end: limb for limb in self.limbs}

    @cached_property
    def parts(self) -> Parts:
        """The roles of its bodies: legs, arms, trunk, head; ModelError where it has no legs."""
        return find_parts(self.model)

    @cached_property
    def height(self) -> float:
        """Height at ``qpos0`` [m]: from its lowest point to its highest.

        Points of the surfaces of all geoms under the free root, and their sites and bodies.
        """
        model = self.model
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        root = root_body(model)
        heights = [
            data.xpos[model.body_rootid == root, 2],
            data.site_xpos[model.body_rootid[model.site_bodyid] == root, 2],
        ]
        for geom in self.geoms:
            upwards = data.geom_xmat[geom].reshape(3, 3)[2]
            heights.append(data.geom_xpos[geom, 2] + geom_points(model, int(geom)) @ upwards)
        return float(np.ptp(np.concatenate(heights)))

    def chains(self, limbs: tuple[Limb, ...]) -> Limbs:
        """Return some of its limbs, to be solved together; found once."""
        if limbs not in self._chains:
            self._chains[limbs] = Limbs(self.model, limbs)
        return self._chains[limbs]

    def within_limits(self, qpos: ArrayLike) -> Array:
        """Return poses (n, nq) within joint limits, coupled joints with their shares (§4.2)."""
        return self.coupling.couple(self.limits.clamp(qpos))

    def different_from(self, other: Character) -> str:
        """Return in words how another character's body differs from this one; "" where it is alike.

        Bodies are compared by their names, their tree, the sizes of their bones, their joints,
        sites and geoms; not by what else is in their models, nor by masses and joint limits.
        """
        if self.model is other.model:
            return ""
        mine, theirs = (_anatomy(one.model) for one in (self, other))
        for kind, (names, _) in mine.items():
            if names != theirs[kind][0]:
                return f"other {kind}"
        for kind, (names, sizes) in mine.items():
            apart = np.abs(sizes - theirs[kind][1]).max(axis=1, initial=0.0)
            far = [names[i] for i in np.flatnonzero(apart > SAME_BODY)]
            if far:
                more = f" and {len(far) - 1} more" if len(far) > 1 else ""
                return f"other sizes of {kind}: {far[0]}{more}"
        return ""


def bone_offsets(model: mujoco.MjModel) -> dict[str, Array]:
    """Return where each body under the free root is in its parent: name to (3,) [m]; the root 0."""
    root = root_body(model)
    return {
        model.body(int(body)).name: model.body_pos[body] * (body != root)
        for body in np.flatnonzero(model.body_rootid == root)
    }


def read_spec(source: str | Path | mujoco.MjSpec) -> tuple[mujoco.MjSpec, str]:
    """Return the spec of a model's name, an MJCF file or a spec, always a new one, and its name.

    Raises:
      ModelError: there is no such model, or MuJoCo cannot read it.
    """
    if isinstance(source, mujoco.MjSpec):
        return source.copy(), source.modelname or "the model"
    path = find_asset("model", source).resolve()
    check_mjcf(path, ModelError)
    try:
        return mujoco.MjSpec.from_file(str(path)), str(path)
    except MUJOCO_ERRORS as error:
        raise ModelError(f"model '{path}' cannot be read: {mujoco_message(error)}") from error


def quaternion_addresses(model: mujoco.MjModel) -> list[int]:
    """Return where in ``qpos`` each quaternion begins: the root's and every ball's."""
    kind, address = model.jnt_type, model.jnt_qposadr
    free = kind == mujoco.mjtJoint.mjJNT_FREE
    turns = free | (kind == mujoco.mjtJoint.mjJNT_BALL)
    return list((address + 3 * free)[turns].tolist())


def joint_names(model: mujoco.MjModel) -> list[str]:
    """Return the names of a model's joints, in ``qpos`` order."""
    return [model.joint(joint).name for joint in range(model.njnt)]


def _anatomy(model: mujoco.MjModel) -> dict[str, tuple[list[str], Array]]:
    """Return names (n,) and sizes (n, k) of a character's bodies, joints, sites and geoms."""
    mine = model.body_rootid == root_body(model)
    bodies = np.flatnonzero(mine)
    joints = np.flatnonzero(mine[model.jnt_bodyid])
    sites = np.flatnonzero(mine[model.site_bodyid])
    geoms = np.flatnonzero(mine[model.geom_bodyid])
    parent = {int(body): model.body(int(model.body_parentid[body])).name for body in bodies}
    root = int(bodies[0])
    parent[root] = "world"
    # Where the root stands at rest, and how it is turned, says nothing about the body.
    place, turn = model.body_pos.copy(), model.body_quat.copy()
    place[root], turn[root] = 0.0, (1.0, 0.0, 0.0, 0.0)
    return {
        "bodies": (
            [f"{model.body(int(b)).name} on {parent[int(b)]}" for b in bodies],
            np.hstack((place[bodies], _turn(turn[bodies]))),
        ),
        "joints": (
            [f"{model.joint(int(j)).name} of type {model.jnt_type[j]}" for j in joints],
            np.hstack((model.jnt_pos[joints], model.jnt_axis[joints])),
        ),
        "sites": (
            [model.site(int(s)).name for s in sites],
            np.hstack((model.site_pos[sites], _turn(model.site_quat[sites]))),
        ),
        "geoms": (
            [
                f"geom of {model.body(int(model.geom_bodyid[g])).name} of type {model.geom_type[g]}"
                for g in geoms
            ],
            np.hstack(
                (model.geom_pos[geoms], _turn(model.geom_quat[geoms]), model.geom_aabb[geoms])
            ),
        ),
    }


def _turn(quat: Array) -> Array:
    """Return rotations (n, 9) without the sign that their quaternions (n, 4) are free to have."""
    return to_matrix(quat).reshape(-1, 9)
