"""A character put into a scene, taken out of it again, or put on a level floor.

character = compose("humanoid", "terrain")     # both in one model
character.model, character.spec
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.character import Character, CharacterLike
from mjmotion.body.joint_limits import LIMIT_PREFIX
from mjmotion.boundary.mjcf import MUJOCO_ERRORS
from mjmotion.exceptions import MotionError, SceneError, mujoco_message
from mjmotion.scene.quiet import quiet
from mjmotion.scene.renaming import asset_name, free_name, rename_shared
from mjmotion.scene.rest import drop_idle
from mjmotion.scene.scene import Scene, SceneLike, load_scene

_SUNSHINE = (-0.45, 0.25, -1.0)  # direction: the side to the right of the walk is lit
_INERTIA_SETTINGS = (
    *("balanceinertia", "boundmass", "boundinertia"),
    *("inertiafromgeom", "inertiagrouprange", "alignfree"),
)
_SUN_DISTANCE = 12.0  # nothing behind the light casts a shadow, so it stands over the scene


def compose(character: CharacterLike, scene: SceneLike, *, moving: bool = False) -> Character:
    """Return a character in a scene: one model of both.

    The scene stands still, as :meth:`mjmotion.scene.Scene.at_rest` says, so all joints are the
    character's; and what acts on nothing there, such as tendons, stays behind. The character's
    names stay as they are; where the scene has an element of the same name, that is renamed. What
    the character's file has directly in its world (a floor or lamp to look at it alone) stays
    behind. Options, lights and visual settings are the scene's; a scene without a light or a sky
    gets one, and the offscreen buffer is at least 1920 × 1080.

    Args:
      character: the character, or what names one.
      scene: the scene, or what names one.
      moving: keep the scene's joints, to simulate it. The root is the first joint all the same, so
        that ``qpos[:, :character.nq]`` is the character; names of joints and what refers to them
        must then differ.

    Raises:
      ModelError: the character does not exist, does not compile, or has no free root.
      SceneError: the scene cannot stand still, or not be put together with the character.
    """
    character, scene = Character.of(character), Scene.of(scene)
    scene = scene if moving else scene.at_rest()
    spec, stage = character.spec.copy(), scene.spec.copy()
    if moving:
        for key in list(stage.keys):  # states of the scene alone mean nothing with a character
            stage.delete(key)
    else:
        drop_idle(stage)
        _as_heavy_as(spec, stage)
    _strip_stage(spec, keep_sky=not any(_is_sky(texture) for texture in stage.textures))
    rename_shared(stage, spec)
    for group in ("option", "visual", "stat"):
        _copy_settings(getattr(spec, group), getattr(stage, group))
    spec.modelname = f"{spec.modelname} on {scene.name}"
    _name_faces_fully(stage)
    _attach(spec, stage, scene.name)
    _dress(spec, scene.start_pos)
    spec = spec.copy()  # a copy does not repeat the attachment's warnings at every compilation
    try:
        model = spec.compile()
    except MUJOCO_ERRORS as error:
        raise _clash(error, scene.name) from error
    return Character(model, spec, character.name)


def with_ground(character: CharacterLike) -> Character:
    """Return a character with the ground that its file has, or else on our level floor.

    Args:
      character: a character alone, or one in its scene such as the ``model.xml`` of a result
        folder; or what names one.

    Raises:
      ModelError: the character does not exist, does not compile, or has no free root.
    """
    character = Character.of(character)
    return compose(character, load_scene("flat")) if character.alone else character


def without_scene(character: CharacterLike) -> Character:
    """Return a character without the scene in which it stands; one alone is returned as it is.

    Raises:
      ModelError: the character does not exist, does not compile, or has no free root.
    """
    character = Character.of(character)
    if character.alone:
        return character
    spec = character.spec.copy()
    root = character.model.body(int(character.model.jnt_bodyid[0])).name
    for kind in ("geoms", "lights", "cameras", "sites"):
        for element in list(getattr(spec.worldbody, kind)):
            spec.delete(element)
    for body in list(spec.worldbody.bodies):
        if body.name != root:
            spec.delete(body)
    return Character(spec.compile(), spec, character.name)


def scene_of(character: CharacterLike) -> Scene | None:
    """Return the scene in which a model's character stands; None where it stands in nothing.

    Args:
      character: such as the ``model.xml`` of a result folder.

    Raises:
      ModelError: the character does not exist, does not compile, or has no free root.
      SceneError: what is left without the character is no scene.
    """
    character = Character.of(character)
    if character.alone:
        return None
    spec, model = character.spec.copy(), character.model
    spec.compile()  # numbers the copy's bodies as the model's
    name = spec.modelname.rsplit(" on ", 1)[-1]
    for kind in ("keys", "tuples", "sensors", "actuators", "tendons", "equalities", "excludes"):
        for element in list(getattr(spec, kind)):
            spec.delete(element)
    for numeric in [one for one in spec.numerics if one.name.startswith(LIMIT_PREFIX)]:
        spec.delete(numeric)
    root = model.jnt_bodyid[0]
    spec.delete(next(body for body in spec.bodies if body.id == root))
    for kind, used in (("meshes", "meshname"), ("materials", "material")):
        names = {getattr(geom, used) for geom in spec.geoms}
        for asset in [one for one in getattr(spec, kind) if asset_name(one) not in names]:
            spec.delete(asset)
    return Scene.from_spec(spec, name)


def _strip_stage(spec: mujoco.MjSpec, keep_sky: bool) -> None:
    """Delete what the character's file has in its world besides the character."""
    for element in [*spec.worldbody.geoms, *spec.worldbody.lights]:
        spec.delete(element)
    if not keep_sky:
        for texture in [texture for texture in spec.textures if _is_sky(texture)]:
            spec.delete(texture)


def _is_sky(texture: Any) -> bool:
    return bool(texture.type == mujoco.mjtTexture.mjTEXTURE_SKYBOX)


def _as_heavy_as(spec: mujoco.MjSpec, stage: mujoco.MjSpec) -> None:
    """Let masses of the scene, which stands still, be found by the character's settings.

    A file has one set of them: with two the model would compile but could not be saved.
    """
    for name in _INERTIA_SETTINGS:
        setattr(stage.compiler, name, getattr(spec.compiler, name))
    for body in stage.bodies:
        body.explicitinertial = False


def _name_faces_fully(stage: mujoco.MjSpec) -> None:
    """Write the files of cube textures with their folder, which once attached nobody knows."""
    for texture in stage.textures:
        folder = Path(stage.modelfiledir) / texture.compiler.texturedir
        faces = list(texture.cubefiles)
        if any(faces):
            there = [bool(face) and (folder / face).is_file() for face in faces]
            texture.cubefiles = [
                str((folder / face).resolve()) if found else face
                for face, found in zip(faces, there, strict=True)
            ]


def _copy_settings(target: Any, source: Any) -> None:
    """Copy every number of one of the spec's settings structures onto another."""
    for name in dir(source):
        if name.startswith("_"):
            continue
        value = getattr(source, name)
        if callable(value):
            continue
        if isinstance(value, (int, float, np.ndarray)) or hasattr(value, "__index__"):
            setattr(target, name, value)
        else:
            _copy_settings(getattr(target, name), value)


def _attach(spec: mujoco.MjSpec, stage: mujoco.MjSpec, name: str) -> None:
    """Attach the scene to the character's world without a prefix, and without MuJoCo's warning.

    MuJoCo warns that a model attached without a prefix may not save; :func:`save_model` writes
    the files of assets itself, so it does, and the warning would go to stderr and to a log file.
    """
    try:
        with quiet():
            spec.attach(stage, frame=spec.worldbody.add_frame(), prefix="")
    except MUJOCO_ERRORS as error:
        raise _clash(error, name) from error


def _clash(error: BaseException, name: str) -> MotionError:
    return SceneError(
        f"scene '{name}' cannot be put together with the character: {mujoco_message(error)};"
        " rename it in the scene"
    )


def _dress(spec: mujoco.MjSpec, start: NDArray[np.float64]) -> None:
    """Make sure that the model can be seen: light, sky, and a buffer that a video fits in."""
    if not spec.lights:
        add_sun(spec, (float(start[0]), float(start[1]), float(start[2])))
    if not any(_is_sky(texture) for texture in spec.textures):
        add_sky(spec)
    spec.visual.global_.offwidth = max(1920, spec.visual.global_.offwidth)
    spec.visual.global_.offheight = max(1080, spec.visual.global_.offheight)


def add_sky(spec: mujoco.MjSpec) -> None:
    """Add a skybox that pales towards the horizon."""
    spec.add_texture(
        name=free_name("sky", {texture.name for texture in spec.textures}),
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=(0.50, 0.66, 0.84),
        rgb2=(0.93, 0.95, 0.97),
        width=256,
        height=256,
    )


def add_sun(spec: mujoco.MjSpec, target: tuple[float, float, float]) -> None:
    """Add a directional light that shines on ``target`` [m] from ahead and the right.

    Its shadows reach as far around ``target`` as the model's extent.
    """
    spec.worldbody.add_light(
        name=free_name("sun", {light.name for light in spec.lights}),
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        pos=tuple(np.add(target, np.multiply(-_SUN_DISTANCE, _SUNSHINE))),
        dir=_SUNSHINE,
        diffuse=(0.6, 0.58, 0.54),
        specular=(0.15, 0.15, 0.15),
        ambient=(0.0, 0.0, 0.0),
        castshadow=True,
    )
