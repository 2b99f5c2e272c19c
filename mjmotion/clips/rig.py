"""Which joint of a clip's skeleton plays which role of the humanoid: by its place in the tree.

``mjmotion info CLIP`` shows what was found and why; ``--write-mapping FILE`` writes it as a mapping
file (see :mod:`mjmotion.clips.rig_file`), in which a user says what was not.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mjmotion.clips.joint_names import LIMB, OPTIONAL, REQUIRED, ROLES, SIDES, best_names
from mjmotion.clips.rig_file import read_mapping
from mjmotion.clips.sides import find_sides
from mjmotion.clips.skeleton import Clip
from mjmotion.clips.tree import PointTree
from mjmotion.clips.tree_roles import find_tree_roles
from mjmotion.exceptions import ClipError, unknown_name

__all__ = ["OPTIONAL", "REQUIRED", "ROLES", "SIDES", "FoundRoles", "Rig", "find_rig", "find_roles"]

_PLACES = {
    "pelvis": "where the legs meet",
    "neck": "over the shoulders",
    "head": "on top",
    "hip": "where the leg begins",
    "knee": "middle of the leg",
    "ankle": "end of the shank",
    "toe": "ahead of the ankle",
    "shoulder": "where the arm begins",
    "elbow": "middle of the arm",
    "wrist": "end of the forearm",
    "hand": "beyond the wrist",
}


@dataclasses.dataclass(frozen=True)
class Rig:
    """The joints of a clip that drive the humanoid.

    Attributes:
      joints: role to joint name; every role of ``REQUIRED`` is there.
      up: the file's vertical axis (``"y"``, ``"-z"``, ...), or None to find it in the clip.
      scale: metres of the humanoid per unit of the file, or None to take it from the legs.
      notes: what the reader of a report should know, a line each.
    """

    joints: Mapping[str, str]
    up: str | None = None
    scale: float | None = None
    notes: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class FoundRoles:
    """What was found about a skeleton, be it enough or not.

    Attributes:
      joints: role to joint name.
      reasons: role to why.
      notes: what is odd about the skeleton, a line each.
    """

    joints: Mapping[str, str]
    reasons: Mapping[str, str]
    notes: tuple[str, ...] = ()

    @property
    def missing(self) -> tuple[str, ...]:
        """The required roles without a joint."""
        return tuple(role for role in REQUIRED if role not in self.joints)


def find_rig(clip: Clip, mapping: str | Path | Mapping[str, Any] | None = None) -> Rig:
    """Find each role's joint, by the tree of joints and their names, or as a mapping says.

    Args:
      clip: the clip.
      mapping: a mapping file (:mod:`mjmotion.clips.rig_file`), or its content.

    Raises:
      ClipError: a required role has no joint, a joint has two roles, or the mapping is malformed or
        names unknown things.
    """
    content = read_mapping(mapping) if mapping is not None else {}
    where = f"mapping file '{mapping}'" if isinstance(mapping, (str, Path)) else "mapping"
    given: dict[str, str] = {}
    for role, joint in content.get("joints", {}).items():
        if role not in ROLES:
            raise ClipError(f"{where}: {unknown_name('role', str(role), ROLES)}")
        if joint is None:  # a line of a written mapping that was not filled in
            continue
        if joint not in clip.joint_names:
            raise ClipError(
                f"{where}: {role}: {unknown_name('joint', str(joint), clip.joint_names)}"
            )
        given[role] = str(joint)
    ignored = content.get("ignore", ())
    for role in ignored:
        if role not in OPTIONAL:
            raise ClipError(f"{where}: ignore: {unknown_name('role', str(role), OPTIONAL)}")
    roles = find_roles(clip, given)
    joints = {role: joint for role, joint in roles.joints.items() if role not in ignored}
    _check_once(joints, given)
    if roles.missing:
        raise ClipError(
            f"'{clip.name}': no joint found for {', '.join(roles.missing)} among"
            f" {', '.join(clip.joint_names[:12])}{', …' if len(clip.joint_names) > 12 else ''}:"
            " see 'mjmotion info' of it, whose --write-mapping writes a mapping file to fill in"
        )
    return Rig(joints, content.get("up"), content.get("scale"), roles.notes)


def find_roles(clip: Clip, given: Mapping[str, str] | None = None) -> FoundRoles:
    """Find which joint plays which role, as far as that can be seen.

    Args:
      clip: the clip.
      given: role to joint, as a user says; these are taken.
    """
    given = {} if given is None else given
    named = best_names(clip.joint_names)
    found = _by_tree(clip, named, given)
    if found is None:
        reasons = dict.fromkeys(named, "its name")
        found = FoundRoles(named, reasons)
    joints, reasons = dict(found.joints), dict(found.reasons)
    for role, joint in given.items():
        joints[role], reasons[role] = joint, "the mapping"
    ordered = {role: joints[role] for role in ROLES if role in joints}
    return FoundRoles(ordered, reasons, found.notes)


def _by_tree(clip: Clip, named: Mapping[str, str], given: Mapping[str, str]) -> FoundRoles | None:
    """Return the roles by the tree, or None where no body is seen in it."""
    tree = PointTree.of(clip)
    parts: dict[str, set[int]] = {}
    for role, joint in named.items():
        parts.setdefault(role.rpartition("_")[2], set()).add(clip.joint_names.index(joint))
    roles = find_tree_roles(tree, {part: frozenset(points) for part, points in parts.items()})
    if roles is None:
        return None
    sides = find_sides(tree, roles, clip.joint_names)
    first_is_left = _given_side(clip, tree, given, (roles.legs, roles.arms))
    notes: tuple[str, ...] = ()
    why = "the mapping"
    if first_is_left is None:
        if sides is None:
            return None
        first_is_left, why = sides.first_is_left, sides.why
        if sides.mirrored:
            notes = (
                f"the recording is mirrored: {why} is not to the sides that its names say;"
                " left and right were exchanged",
            )
    joints, reasons = {}, {}
    for role, point in roles.centre.items():
        joints[role], reasons[role] = clip.joint_names[point], _PLACES[role]
    for pair in (roles.legs, roles.arms):
        for side, limb in zip(SIDES, pair if first_is_left else pair[::-1], strict=True):
            for part, point in limb.items():
                joints[f"{side}_{part}"] = clip.joint_names[point]
                reasons[f"{side}_{part}"] = f"{_PLACES[part]}; {side} by {why}"
    chest = named.get("chest")
    if chest is not None and chest not in joints.values():
        line = tree.lines[roles.arms[0]["shoulder"]]
        if clip.joint_names.index(chest) in line:
            joints["chest"], reasons["chest"] = chest, "its name"
    for role, joint in joints.items():
        if named.get(role) == joint and reasons[role] != "its name":
            reasons[role] += ", and its name"
    return FoundRoles(joints, reasons, notes)


def _given_side(
    clip: Clip,
    tree: PointTree,
    given: Mapping[str, str],
    pairs: tuple[tuple[Mapping[str, int], Mapping[str, int]], ...],
) -> bool | None:
    """Return whether the first side is left by what the user says, or None where that is silent."""
    votes = 0
    for role, joint in given.items():
        side, _, part = role.rpartition("_")
        point = clip.joint_names.index(joint)
        for pair in pairs if part in LIMB else ():
            for sign, limb in zip((1, -1), pair, strict=True):
                last = max(limb.values(), key=lambda p: len(tree.lines[p]))
                # On the way to a limb's end, but below where both sides meet.
                other = pair[0] if sign < 0 else pair[1]
                shared = tree.lines[next(iter(other.values()))]
                if point in (*tree.lines[last], *tree.below[last]) and point not in shared:
                    votes += sign if side == "left" else -sign
    return None if votes == 0 else votes > 0


def _check_once(joints: Mapping[str, str], given: Mapping[str, str]) -> None:
    """Raise ClipError where a joint has two roles."""
    seen: dict[str, str] = {}
    for role, joint in joints.items():
        if joint in seen:
            first = seen[joint]
            by = [r + (" (the mapping)" if r in given else " (found)") for r in (first, role)]
            raise ClipError(
                f"joint '{joint}' has two roles, {by[0]} and {by[1]}: give each role a joint of"
                " its own in the mapping file"
            )
        seen[joint] = role
