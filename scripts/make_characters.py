"""Make the characters of models/mjcf from our humanoid: climber, child, and the flexible spine.

python scripts/make_characters.py            # writes models/mjcf/{climber,child,...}.xml
"""

from __future__ import annotations

import re
import textwrap
from pathlib import Path

import mujoco

from mjmotion.body.assets import asset_folder
from mjmotion.body.proportions import Proportions, flexible_spine, make_character

DECIMALS = 6  # of every number in the files

# Figure 5c of Lee and Shin (1999): "longer legs and shorter body and arms".
CLIMBER = Proportions(legs=1.25, torso=0.8, arms=0.85)

# A child of six, in round figures near those of the works named, not copied from their tables:
# stature 1.16 m and mass 21 kg as the medians of the CDC growth charts (2000); sitting height
# 0.547 of stature, against 0.52 of adults, after Fredriks et al., Arch. Dis. Child. 90 (2005);
# head 0.195 m from chin to crown, foot 0.178 m after Snyder et al., Anthropometry of Infants,
# Children and Youths to Age 18 (1977). Our adult has 1.75, 0.52, 0.228 and 0.255 m. The mass is
# not set: 21.2 kg come out.
STATURE, SITTING, HEAD, FOOT = 1.16, 0.547, 0.195, 0.178
ADULT_STATURE, ADULT_SITTING, ADULT_HEAD, ADULT_FOOT = 1.75, 0.52, 0.228, 0.255
# Of our adult [m]: hip over the sole, sole to ankle, hip to the neck's foot, that to the crown.
HIP, ANKLE, TRUNK, CROWN = 0.9275, 0.0682, 0.5625, 0.26

# Shares of the flexible spine's turn, from the lowest joint up: the lumbar spine bends most.
SPINE = (0.4, 0.3, 0.3)


def child() -> Proportions:
    """Return the proportions of a child of six, from the figures above."""
    size = STATURE / ADULT_STATURE
    head, feet = HEAD / ADULT_HEAD / size, FOOT / ADULT_FOOT / size
    # What sits higher is taken from the legs: the hip is as much lower as the seat.
    hip = (HIP / ADULT_STATURE + ADULT_SITTING - SITTING) * STATURE
    legs = (hip / size - feet * ANKLE) / (HIP - ANKLE)
    torso = (STATURE - hip - CROWN * head * size) / (TRUNK * size)
    return Proportions(
        legs=round(legs, 3),
        torso=round(torso, 3),
        head=round(head, 3),
        feet=round(feet, 3),
        size=round(size, 4),
    )


def write(path: Path, spec: mujoco.MjSpec, words: str) -> None:
    """Write a spec as an MJCF file of our own: a comment, rounded numbers, short lines."""
    spec.modelname = path.stem
    xml = re.sub(r"-?\d+\.?\d*(e[+-]\d+)?(?=[ \"])", _rounded, spec.to_xml())
    xml = re.sub(r'(vertex=")([^"]*)"', _wrapped, xml)
    made = (
        "Made by scripts/make_characters.py from humanoid.xml, which says where its figures are"
        " from."
    )
    comment = textwrap.fill(f"{words} {made}", 112, initial_indent="  ", subsequent_indent="  ")
    path.write_text(f"<!--\n{comment}\n-->\n{xml}", encoding="utf-8")


def _rounded(match: re.Match[str]) -> str:
    number = round(float(match[0]), DECIMALS)
    return f"{number:.{DECIMALS}f}".rstrip("0").rstrip(".") if number else "0"


def _wrapped(match: re.Match[str]) -> str:
    lines = textwrap.fill(match[2], 112, initial_indent="      ", subsequent_indent="      ")
    return f'{match[1]}\n{lines}"'


def main() -> None:
    """Write the files and say what came out."""
    folder = asset_folder("model")
    small = child()
    characters = {
        "climber": (
            make_character("humanoid", CLIMBER),
            "The rope climber: the humanoid with longer legs (1.25) and shorter body (0.8) and arms"
            " (0.85).",
        ),
        "child": (
            make_character("humanoid", small),
            f"A child of six, 1.16 m: the humanoid at size {small.size:g} with legs {small.legs:g},"
            f" torso {small.torso:g}, head {small.head:g} and feet {small.feet:g}.",
        ),
        "humanoid_flexible": (
            flexible_spine("humanoid", SPINE),
            "The humanoid with a spine of three segments that share the three DOFs of one ball"
            " joint: spine_i turns by exp(share_i w), with the shares of the tuple couple_spine.",
        ),
    }
    for name, (character, words) in characters.items():
        path = folder / f"{name}.xml"
        write(path, character.spec.copy(), words)
        model = mujoco.MjModel.from_xml_path(str(path))
        print(f"{path.name}: {model.nv} DOFs, {model.body_mass.sum():.1f} kg")


if __name__ == "__main__":
    main()
