"""Show a recording's own skeleton: the tree of its joints with the role found for each, and why."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mjmotion.body.motion import Motion
from mjmotion.boundary.whole import write_whole
from mjmotion.cli.describe import describe_motion
from mjmotion.clips import Clip
from mjmotion.clips.in_place import going
from mjmotion.clips.rig import FoundRoles, find_rig, find_roles
from mjmotion.clips.rig_file import mapping_text
from mjmotion.exceptions import ClipError, OutputError
from mjmotion.footsteps.contacts import detect_contacts
from mjmotion.validation.mapping import beside_recording
from mjmotion.validation.text import number

WIDTH = 44  # of the tree, in characters; what is said about a joint stands behind it


def describe_recording(
    clip: Clip, what: str, how: Mapping[str, Any], write: Path | None
) -> list[str]:
    """Return lines about a recording: its tree with roles, and the motion that comes of it.

    Args:
      clip: the recording.
      what: what the user calls it.
      how: how it is read, as keywords of ``load_clip``: mapping, in_place, loop and floor count.
      write: where to write what was found as a mapping file.

    Raises:
      ClipError: the mapping is wrong.
      OutputError: the mapping file cannot be written.
    """
    roles, mapping = find_roles(clip), how["mapping"]
    going_on = {name: how[name] for name in ("in_place", "loop", "floor")}
    lines = [
        f"clip        {what}",
        f"skeleton    {len(clip.joint_names)} joints",
    ]
    if mapping is None and roles.missing:
        lines += [
            f"recorded    {clip.nframe} frames at {clip.fps:g} fps",
            *tree_lines(clip, roles),
            f"missing     {', '.join(roles.missing)}: give --write-mapping FILE, fill in the file,"
            " and give it as --mapping FILE",
        ]
    else:
        rig = find_rig(clip, mapping)
        changed = {role for role, joint in rig.joints.items() if roles.joints.get(role) != joint}
        reasons = {**roles.reasons, **dict.fromkeys(changed, "the mapping")}
        roles = FoundRoles(rig.joints, reasons, rig.notes)
        lines += tree_lines(clip, roles)
        try:
            mapped = going(clip, "humanoid", rig, **going_on)
        except ClipError as error:
            lines.append(f"note        it cannot be put on the humanoid: {error}")
        else:
            lines += describe_motion(what, mapped.motion)[1:]
            lines += mapping_lines(mapped.motion)
            lines += [f"note        {note}" for note in mapped.notes]
    if write is not None:
        _write(write, clip, roles)
        lines.append(f"written     {write}")
    return lines


def mapping_lines(motion: Motion) -> list[str]:
    """Return lines on how a motion stands beside the recording that it was made of."""
    if motion.recording is None:
        return []
    found = beside_recording(motion, motion.recording, detect_contacts(motion))
    return [
        f"floating    no foot stands in {number(found['floating_percent'])} % of the frames,"
        f" {number(found['floating_longest_s'])} s at most",
        f"noise       {number(found['recording_noise_deg'])}° a joint",
        f"floor       levelled by {number(found['recording_floor_mm'])} mm",
        f"mapping     bones {number(found['mapping_bone_deg'])}° off the recording,"
        f" {number(found['mapping_bone_p95_deg'])}° p95;"
        f" facing {number(found['mapping_facing_deg'])}°;"
        f" standing feet turn {number(found['mapping_foot_turn_deg_s'])}°/s otherwise,"
        f" {number(found['mapping_foot_height_mm'])} mm higher or lower",
    ]


def tree_lines(clip: Clip, roles: FoundRoles) -> list[str]:
    """Return the tree of joints, one a line, in the order of the file, with role and reason."""
    played: dict[str, list[str]] = {}
    for role, joint in roles.joints.items():
        played.setdefault(joint, []).append(role)
    depth: list[int] = []
    lines = []
    for name, parent in zip(clip.joint_names, clip.parents, strict=True):
        depth.append(depth[parent] + 1 if parent >= 0 else 0)
        text = "  " + "  " * depth[-1] + name
        said = "; ".join(f"{r} ({roles.reasons.get(r, 'found')})" for r in played.get(name, ()))
        lines.append(f"{text:<{WIDTH}}  {said}".rstrip())
    return lines


def _write(path: Path, clip: Clip, roles: FoundRoles) -> None:
    """Write what was found as a mapping file."""
    text = mapping_text(Path(clip.name).name, clip.joint_names, roles.joints, roles.reasons)
    if path.exists():
        raise OutputError(f"'{path}' is there already: give another name")
    try:
        write_whole(path, text)
    except OSError as error:
        raise OutputError(f"'{path}' cannot be written: {error.strerror}") from None
