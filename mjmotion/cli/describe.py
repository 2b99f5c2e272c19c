"""Say in a few lines what a clip, a scene, a model or a result folder holds."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from mjmotion.body.assets import asset_names, find_asset
from mjmotion.body.character import Character
from mjmotion.body.kinematics import Kinematics, character_geoms, root_body
from mjmotion.body.motion import Motion
from mjmotion.boundary.files import check_plain
from mjmotion.clips import builtin_clips, load_clip
from mjmotion.exceptions import MotionError, unknown_name
from mjmotion.footsteps.contacts import Contact, detect_contacts
from mjmotion.output.reading import load_model, read_results
from mjmotion.output.result import Result
from mjmotion.scene import Scene, load_scene

_GEOMS = {
    mujoco.mjtGeom.mjGEOM_PLANE: "plane",
    mujoco.mjtGeom.mjGEOM_HFIELD: "heightfield",
    mujoco.mjtGeom.mjGEOM_BOX: "box",
    mujoco.mjtGeom.mjGEOM_MESH: "mesh",
    mujoco.mjtGeom.mjGEOM_SPHERE: "sphere",
    mujoco.mjtGeom.mjGEOM_CAPSULE: "capsule",
    mujoco.mjtGeom.mjGEOM_ELLIPSOID: "ellipsoid",
    mujoco.mjtGeom.mjGEOM_CYLINDER: "cylinder",
}


def describe(what: str) -> list[str]:
    """Return lines about a result folder, a file, or a name of ours.

    Args:
      what: an output folder, a clip (BVH, AMC, CSV, NPZ), an MJCF file, or the name of a built-in
        clip, scene or model.

    Raises:
      MotionError: there is no such thing, or it is damaged.
    """
    path = Path(what)
    if path.is_dir():
        return describe_result(path, read_results(path))
    if path.suffix.lower() == ".xml":
        return describe_model(what, load_model(path))
    if path.is_file() or what in builtin_clips():
        return describe_motion(what, load_clip(what))
    if what in asset_names("scene"):
        return describe_scene(load_scene(what))
    if what in asset_names("model"):
        return describe_model(what, load_model(find_asset("model", what)))
    if path.suffix or path.parent != Path():
        check_plain(path, "file")
    names = [*builtin_clips(), *asset_names("scene"), *asset_names("model")]
    raise MotionError(unknown_name("clip, scene or model", what, names))


def describe_motion(name: str, motion: Motion) -> list[str]:
    """Return lines about a motion: frames, joints, travel, box, contacts."""
    lines = [f"clip        {name}", *_motion_lines(motion)]
    return [*lines, _contact_line(detect_contacts(motion))]


def describe_result(folder: Path, result: Result) -> list[str]:
    """Return lines about an output folder: motion, contacts, ground, figures of its report."""
    lines = [f"result      {folder}", *_motion_lines(result.motion)]
    lines += [_contact_line(result.contacts), _ground_line(result.model)]
    metrics = result.saved_report.get("metrics", {})
    for name, value in metrics.items():
        lines.append(f"  {name:<28} {value:.4g}" if value is not None else f"  {name:<28} -")
    return lines


def describe_scene(scene: Scene) -> list[str]:
    """Return lines about a scene: its ground and where a walk starts."""
    x, y, z = scene.start_pos
    start = f"start       {x:.2f} {y:.2f} {z:.2f} m, yaw {np.degrees(scene.start_yaw):.0f} degrees"
    return [f"scene       {scene.name}", _ground_line(scene.model), start]


def describe_model(name: str, model: mujoco.MjModel) -> list[str]:
    """Return lines about an MJCF file: a character if it has a free root, else a scene."""
    if model.njnt == 0 or model.jnt_type[0] != mujoco.mjtJoint.mjJNT_FREE:
        return describe_scene(load_scene(name))
    root = model.body(root_body(model)).name
    mass = float(model.body_subtreemass[root_body(model)])
    mine = model.body_rootid[model.site_bodyid] == root_body(model)
    sites = [model.site(int(index)).name for index in np.flatnonzero(mine)]
    lines = [
        f"model       {name}",
        f"size        nq {model.nq}, nv {model.nv}, {model.njnt} joints, {model.nbody - 1} bodies",
        f"character   {root}: {Character(model).height:.2f} m, {mass:.1f} kg",
        f"sites       {', '.join(sites) or 'none'}",
    ]
    if len(character_geoms(model)) < model.ngeom:
        lines.append(_ground_line(model))
    return lines


def _motion_lines(motion: Motion) -> list[str]:
    root = motion.qpos[:, :3]
    path = float(np.linalg.norm(np.diff(root[:, :2], axis=0), axis=1).sum())
    straight = float(np.linalg.norm(root[-1, :2] - root[0, :2]))
    points = Kinematics(motion.model, motion.nframe).forward(motion.qpos).xpos[:, 1:]
    low, high = points.min(axis=(0, 1)), points.max(axis=(0, 1))
    box = ", ".join(
        f"{axis} {a:.2f} to {b:.2f}" for axis, a, b in zip("xyz", low, high, strict=True)
    )
    return [
        f"frames      {motion.nframe} at {motion.fps:g} fps, {motion.duration:.2f} s",
        f"joints      {motion.model.njnt} (nq {motion.model.nq}, nv {motion.model.nv})",
        f"travel      {path:.2f} m, {straight:.2f} m from start to end",
        f"box         {box} m (joint centres)",
    ]


def _contact_line(contacts: tuple[Contact, ...]) -> str:
    count: dict[str, int] = {}
    for contact in contacts:
        count[contact.site] = count.get(contact.site, 0) + 1
    each = ", ".join(f"{site} {number}" for site, number in sorted(count.items()))
    return f"contacts    {len(contacts)}" + (f" ({each})" if each else "")


def _ground_line(model: mujoco.MjModel) -> str:
    """Count the geoms that belong to no moving body by type."""
    count: dict[str, int] = {}
    for geom in range(model.ngeom):
        if model.body_weldid[model.geom_bodyid[geom]] == 0:
            kind = _GEOMS.get(mujoco.mjtGeom(int(model.geom_type[geom])), "other")
            count[kind] = count.get(kind, 0) + 1
    return "ground      " + (
        ", ".join(f"{n} {kind}" for kind, n in sorted(count.items())) or "none"
    )
