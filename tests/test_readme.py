"""What README and guide show works: Python runs, commands parse, files are read, links lead on."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

import pytest
import yaml
from made_up import missed

from mjmotion import adapt, load_clip
from mjmotion.body.character import Character
from mjmotion.cli import main as cli
from mjmotion.clips import ROLES, find_rig, read_clip
from mjmotion.clips.rig import REQUIRED
from mjmotion.constraints import load_constraints
from mjmotion.footsteps.contacts import load_contacts

ROOT = Path(__file__).parents[1]
PAGES = {name: (ROOT / name).read_text("utf-8") for name in ("README.md", "docs/guide.md")}
CHEAP = ("info", "scene")  # commands that are run and not only parsed

# Runs before a snippet: its videos are small and rough, or there are none without OpenGL.
QUICK_VIDEO = """
import mjmotion.output.video as _video
from mjmotion.exceptions import RenderError as _RenderError

_render = _video.render_video

def _quick(*args, **options):
    try:
        _video.ensure_gl()
    except _RenderError:
        return
    _render(*args, **{**options, "preview": True, "width": 320, "height": 180})

_video.render_video = _quick
"""


def blocks(language: str, pages: Iterable[str] = PAGES) -> list[str]:
    pattern = re.compile(rf"^```{language}\n(.*?)^```", re.MULTILINE | re.DOTALL)
    return [block for page in pages for block in pattern.findall(PAGES[page])]


def commands() -> list[list[str]]:
    """The words of every shown command line, with continued lines put together."""
    lines = [line for block in blocks("bash") for line in block.replace("\\\n", " ").splitlines()]
    return [words for line in lines if (words := shlex.split(line, comments=True))]


def named(words: list[str]) -> str:
    return " ".join(words)


def test_the_readme_is_short_and_shows_what_to_do_first() -> None:
    assert len(PAGES["README.md"].splitlines()) <= 150
    assert len(blocks("python", ["README.md"])) >= 3
    assert all(len(block.splitlines()) <= 6 for block in blocks("python", ["README.md"]))
    assert ["make", "demo"] in commands() and ["pip", "install", "."] in commands()


def test_every_command_is_shown() -> None:
    shown = {words[1] for words in commands() if words[0] == "mjmotion"}
    assert shown == set(cli.COMMANDS)


@pytest.mark.parametrize("code", blocks("python"), ids=lambda code: code.strip().splitlines()[0])
def test_python_runs(code: str, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", QUICK_VIDEO + code],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=240,
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
        assert program in ("pip", "cd", "git", "sudo"), f"an untested {program} is shown"


def test_the_files_that_are_shown_are_taken(tmp_path: Path) -> None:
    model = Character.of(ROOT / "models" / "mjcf" / "humanoid.xml").model
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
    loaded = load_constraints(path, model, 464)
    assert [one.site for one in loaded] == [entry["site"] for entry in constraints]
    assert loaded[0].frames.tolist() == list(range(*constraints[0]["frames"]))
    path = tmp_path / "contacts.json"
    path.write_text(blocks("json")[0], "utf-8")
    assert len(load_contacts(path, model, 464)) == 2


def test_the_constraints_that_are_shown_hold_as_they_stand(tmp_path: Path) -> None:
    (tmp_path / "constraints.yaml").write_text(blocks("yaml")[1], "utf-8")
    walk = load_clip("walk")
    asked = load_constraints(tmp_path / "constraints.yaml", walk.model, walk.nframe)
    result = adapt(walk, "terrain", constraints=asked)
    assert not result.unmet and not missed(result.validate())


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_somewhere(page: str) -> None:
    targets = re.findall(r"\]\(([^)#]+)\)", PAGES[page])
    assert len(targets) > 5
    for target in targets:
        if not target.startswith(("http:", "https:")):
            path = (ROOT / page).parent / target
            assert path.exists(), target
            assert path.suffix not in (".jpg", ".png") or path.stat().st_size < 300_000, target
