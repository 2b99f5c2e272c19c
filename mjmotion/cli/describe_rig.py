"""Show a recording's own skeleton: the tree of its joints with the role found for each, and why."""

from __future__ import annotations

from pathlib import Path

from mjmotion.boundary.whole import write_whole
from mjmotion.cli.describe import describe_motion
from mjmotion.clips import Clip
from mjmotion.clips.in_place import going
from mjmotion.clips.rig import FoundRoles, find_rig, find_roles
from mjmotion.clips.rig_file import mapping_text
from mjmotion.exceptions import ClipError, OutputError

WIDTH = 44  # of the tree, in characters; what is said about a joint stands behind it


def describe_recording(
    clip: Clip, what: str, mapping: Path | None, write: Path | None
) -> list[str]:
    """Return lines about a recording: its tree with roles, and the motion that comes of it.

    Args:
      clip: the recording.
      what: what the user calls it.
      mapping: a mapping file of the user.
      write: where to write what was found as a mapping file.

    Raises:
      ClipError: the mapping is wrong.
      OutputError: the mapping file cannot be written.
    """
    roles = find_roles(clip)
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
            mapped = going(clip, "humanoid", rig)
        except ClipError as error:
            lines.append(f"note        it cannot be put on the humanoid: {error}")
        else:
            lines += describe_motion(what, mapped.motion)[1:]
            lines += [f"note        {note}" for note in mapped.notes]
    if write is not None:
        _write(write, clip, roles)
        lines.append(f"written     {write}")
    return lines


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
