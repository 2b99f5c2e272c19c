"""What the names of a clip's joints say: the sets of common skeletons, and words for the sides."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence

SIDES = ("left", "right")
_CENTRE = ("pelvis", "chest", "neck", "head")
LIMB = ("hip", "knee", "ankle", "toe", "shoulder", "elbow", "wrist", "hand")
ROLES = _CENTRE + tuple(f"{side}_{part}" for side in SIDES for part in LIMB)
OPTIONAL = {"chest", "neck", "head"} | {
    f"{side}_{part}" for side in SIDES for part in ("toe", "wrist", "hand")
}
REQUIRED = tuple(role for role in ROLES if role not in OPTIONAL)

# Role to names, best first, lower case and without separators; {s} stands for the side.
_NAME_SETS: dict[str, dict[str, str]] = {
    "CMU": {
        "pelvis": "root",
        "chest": "thorax",
        "neck": "lowerneck",
        "head": "upperneck head",  # the skull begins there; 'head' is its upper half
        "hip": "{s}femur",
        "knee": "{s}tibia",
        "ankle": "{s}foot",
        "toe": "{s}toes",
        "shoulder": "{s}humerus",
        "elbow": "{s}radius",
        # CMU splits the forearm: 'wrist' is the half that turns, 'hand' begins at the wrist.
        "wrist": "{s}hand {s}wrist",
        "hand": "{s}fingers",
    },
    "CMU under MotionBuilder's names": {
        "pelvis": "hips",
        "chest": "spine1",
        "neck": "neck",
        "head": "neck1",
        "hip": "{s}upleg",
        "knee": "{s}leg",
        "ankle": "{s}foot",
        "toe": "{s}toebase",
        "shoulder": "{s}arm",
        "elbow": "{s}forearm",
        "wrist": "{s}fingerbase",
        "hand": "{s}handindex1",
    },
    "Mixamo, LAFAN1, MotionBuilder": {
        "pelvis": "hips hip pelvis",
        "chest": "",
        "neck": "neck",
        "head": "head",
        "hip": "{s}upleg {s}upperleg {s}thigh",
        "knee": "{s}leg {s}lowleg {s}lowerleg {s}shin {s}calf",
        "ankle": "{s}foot",
        "toe": "{s}toebase {s}toe {s}toes {s}toe0",
        "shoulder": "{s}arm {s}uparm {s}upperarm {s}shldr",
        "elbow": "{s}forearm {s}lowarm {s}lowerarm",
        "wrist": "{s}hand",
        "hand": "{s}handindex1 {s}handmiddle1 {s}finger0",
    },
    "joints by their anatomy": {
        "pelvis": "hips pelvis root hip spinebase",
        "chest": "",
        "neck": "neck",
        "head": "head",
        "hip": "{s}hip",
        "knee": "{s}knee",
        "ankle": "{s}ankle",
        "toe": "{s}toe {s}toes {s}toebase {s}foot",
        "shoulder": "{s}shoulder",
        "elbow": "{s}elbow",
        "wrist": "{s}wrist",
        "hand": "{s}hand",
    },
}
# Left and right, whole words first: in a pair of names one has the one where the other the other.
_SIDE_WORDS = (
    ("left", "right"),
    ("links", "rechts"),
    ("linke", "rechte"),
    ("link", "recht"),
    ("gauche", "droite"),
    ("gauche", "droit"),
    ("izquierda", "derecha"),
    ("izquierdo", "derecho"),
    ("izq", "der"),
    ("sinistra", "destra"),
    ("sinistro", "destro"),
    ("sinistr", "destr"),
    ("esquerda", "direita"),
    ("esquerdo", "direito"),
    ("esq", "dir"),
    ("lewa", "prawa"),
    ("lewy", "prawy"),
    ("vanster", "hoger"),
    ("vänster", "höger"),
    ("лев", "прав"),
    ("左", "右"),
    ("왼", "오른"),
    ("hidari", "migi"),
    ("sol", "sag"),
    ("lt", "rt"),
    ("lft", "rgt"),
    ("l", "r"),
    ("g", "d"),
)


def best_names(joint_names: Sequence[str]) -> dict[str, str]:
    """Return role to joint from the name set that finds most roles."""
    plain: dict[str, str] = {}
    for name, short in zip(joint_names, simplified(joint_names), strict=True):
        plain.setdefault(short, name)
    best: dict[str, str] = {}
    for names in _NAME_SETS.values():
        found = {}
        for role in ROLES:
            side, _, part = role.rpartition("_")
            for pattern in names[part].split():
                matches = [name for name in _spellings(pattern, side) if name in plain]
                if matches:
                    found[role] = plain[matches[0]]
                    break
        required = sum(role in found for role in REQUIRED), len(found)
        if required > (sum(role in best for role in REQUIRED), len(best)):
            best = found
    # Only a whole skeleton counts: one lone match may well be a chance.
    return best


def simplified(joint_names: Sequence[str]) -> list[str]:
    """Return joint names without namespace, what all have in common, separators and case."""
    names = [re.split(r"[:|]", name)[-1].strip() for name in joint_names]
    for forward in (True, False):
        while (shared := _shared_word(names, forward)) is not None:
            if forward:
                names = [name[len(shared) :] if name.startswith(shared) else name for name in names]
            else:
                names = [name.removesuffix(shared) for name in names]
    names = [re.sub(r"^[Cc]_(?=.)", "", name) for name in names]
    plain = [re.sub(r"[\s_.\-]", "", name).lower() for name in names]
    pattern = r"^(mixamorig\d*|bip0*1|character\d+|skeleton|skel)(?=.)"
    return [re.sub(pattern, "", name) for name in plain]


def _shared_word(names: Sequence[str], forward: bool) -> str | None:
    """Return the first or last word that most names have, with its separator, or None."""
    pattern = r"^[^\s_.\-]+[\s_.\-]+(?=.)" if forward else r"(?<=.)[\s_.\-]+[^\s_.\-]+$"
    words = [match[0] for name in names if (match := re.search(pattern, name))]
    if not words:
        return None
    word, count = Counter(words).most_common(1)[0]
    # More than all of one side, and than the numbers behind the joints of a chain.
    return word if count > 0.6 * len(names) and count > 2 else None


def which_side(first: str, second: str) -> int:
    """Return 1 where two names differ in that the first is left's, -1 if right's, else 0."""
    one, other = first.lower(), second.lower()
    for left, right in _SIDE_WORDS:
        for sign, a, b in ((1, left, right), (-1, right, left)):
            starts = [match.start() for match in re.finditer(re.escape(a), one)]
            if any(one[:at] + b + one[at + len(a) :] == other for at in starts):
                return sign
    return 0


def _spellings(pattern: str, side: str) -> list[str]:
    """Return the ways to write a side and a part: leftarm, larm, armleft, arml."""
    if not side:
        return [pattern]
    part = pattern.replace("{s}", "")
    return [side + part, side[0] + part, part + side, part + side[0]]
