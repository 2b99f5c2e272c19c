"""What the README shows works: its Python runs, its commands parse, its links lead somewhere."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from mjmotion.cli import main as cli
from mjmotion.clips import ROLES, find_rig, read_clip
from mjmotion.clips.rig import REQUIRED
from mjmotion.constraints import load_constraints
from mjmotion.footsteps.contacts import load_contacts
from mjmotion.output.reading import load_model

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "README.md").read_text("utf-8")
CHEAP = ("info", "scene")  # commands that are run and not only parsed


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", TEXT, re.MULTILINE | re.DOTALL)


def commands() -> list[list[str]]:
    """The words of every shown command line, with continued lines put together."""
    lines = [line for block in blocks("bash") for line in block.replace("\\\n", " ").splitlines()]
    return [words for line in lines if (words := shlex.split(line, comments=True))]


def named(words: list[str]) -> str:
    return " ".join(words)


def test_the_readme_shows_something() -> None:
    assert len(blocks("python")) >= 1
    assert ["make", "demo"] in commands()
    assert ["make", "test"] in commands()


@pytest.mark.parametrize("code", blocks("python"), ids=lambda code: code.strip().splitlines()[0])
def test_python_runs(code: str, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("words", commands(), ids=named)
def test_commands_are_real(words: list[str], tmp_path: Path) -> None:
    program, *rest = words
    if program == "make":
        makefile = (ROOT / "Makefile").read_text("utf-8")
        assert all(re.search(rf"^{re.escape(target)}:", makefile, re.MULTILINE) for target in rest)
    elif program == "mjmotion":
        args = cli.parse(rest)
        about = getattr(args, "what", "") or getattr(args, "source", "")
        if args.command in CHEAP and not Path(about).suffix and "/" not in about:
            done = subprocess.run(
                [sys.executable, "-m", "mjmotion", *rest], cwd=tmp_path, capture_output=True
            )
            assert done.returncode == 0, done.stderr
    elif program == "python":
        assert (ROOT / rest[0]).is_file(), rest[0]
    else:
        assert program in ("pip", "cd", "git", "sudo"), f"the README shows an untested {program}"


def test_the_files_that_are_shown_are_taken(tmp_path: Path) -> None:
    model = load_model(ROOT / "models" / "mjcf" / "humanoid.xml")
    mapping, constraints = (yaml.safe_load(block) for block in blocks("yaml"))
    assert mapping.keys() == {"joints", "up", "scale", "ignore"}
    assert set(mapping["joints"]) | set(mapping["ignore"]) <= set(ROLES)
    clip = tmp_path / "clip.bvh"
    joints = "".join(
        f"JOINT {name} {{ OFFSET 0 1 0 CHANNELS 3 Zrotation Xrotation Yrotation }}\n"
        for name in (*list(mapping["joints"].values())[1:], *(set(REQUIRED) - {"pelvis"}))
    )
    root = "OFFSET 0 0 0 CHANNELS 3 Xposition Yposition Zposition"
    row = " ".join(["0"] * (3 + 3 * joints.count("JOINT")))
    clip.write_text(
        f"HIERARCHY ROOT {mapping['joints']['pelvis']} {{ {root} {joints} }}\n"
        f"MOTION\nFrames: 1\nFrame Time: 0.1\n{row}\n",
        "utf-8",
    )
    rig = find_rig(read_clip(clip), mapping)
    assert rig.up == "z" and rig.joints["left_hip"] == mapping["joints"]["left_hip"]

    path = tmp_path / "constraints.yaml"
    path.write_text(blocks("yaml")[1], "utf-8")
    wishes = load_constraints(path, model, 464)
    assert [wish.site for wish in wishes] == [entry["site"] for entry in constraints]
    assert len(wishes[0].frames) == 20
    path = tmp_path / "contacts.json"
    path.write_text(blocks("json")[0], "utf-8")
    assert len(load_contacts(path, model, 464)) == 2


def test_links_lead_somewhere() -> None:
    targets = re.findall(r"\]\(([^)#]+)\)", TEXT)
    assert len(targets) > 5
    for target in targets:
        if not target.startswith(("http:", "https:")):
            assert (ROOT / target).exists(), target
    for picture in (target for target in targets if target.endswith((".jpg", ".png"))):
        assert (ROOT / picture).stat().st_size < 300_000, picture
