"""What surrounds the code: lock file, licence, citation, make targets, no traces of a machine."""

from __future__ import annotations

import os
import re
import subprocess
import tomllib
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
TEXT = {
    ".py",
    ".md",
    ".toml",
    ".yml",
    ".yaml",
    ".cff",
    ".xml",
    ".json",
    ".lock",
    ".txt",
    ".html",
    "",
}


def locked() -> dict[str, str]:
    lines = (ROOT / "requirements.lock").read_text("utf-8").splitlines()
    pairs = [line.split(" ")[0].split("==") for line in lines if re.match(r"[A-Za-z0-9]", line)]
    return {canonicalize_name(name): version for name, version in pairs}


def tracked() -> list[Path]:
    """Files that the project ships; without git (an unpacked archive), the ones that are known."""
    result = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True)
    if result.returncode:
        pytest.skip("not a git checkout")
    return [path for name in result.stdout.split("\0") if name and (path := ROOT / name).is_file()]


def test_lock_is_names_versions_and_hashes_only() -> None:
    text = (ROOT / "requirements.lock").read_text("utf-8")
    assert "://" not in text
    name, hashed = r"[A-Za-z0-9._-]+==[A-Za-z0-9.]+", r"--hash=sha256:[0-9a-f]{64}"
    for entry in text.replace("\\\n", " ").splitlines():
        whole = rf"{name}( ; [^;]+?)?(\s+{hashed})+"
        assert entry.startswith("#") or re.fullmatch(whole, entry.strip()), entry[:80]


def test_system_packages_are_installed_only_when_told() -> None:
    for script in ("setup", "opengl"):
        lines = (ROOT / ".ci" / script).read_text("utf-8").splitlines()
        installs = [n for n, line in enumerate(lines) if "apt-get update" in line]
        for number in installs:
            assert any('"${APT:-}" = 1' in line for line in lines[number - 3 : number]), script
    assert "export APT" in (ROOT / "Makefile").read_text("utf-8")


def test_lock_holds_everything_that_pyproject_asks_for() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    project = settings["project"]
    wanted = [*project["dependencies"], *settings["build-system"]["requires"]]
    for extra in project["optional-dependencies"].values():
        wanted += extra
    versions = locked()
    for text in wanted:
        requirement = Requirement(text)
        name = canonicalize_name(requirement.name)
        assert name in versions, f"{name} is not in requirements.lock: run make lock"
        assert requirement.specifier.contains(versions[name]), f"{text}: locked {versions[name]}"


def test_no_file_names_a_machine_or_a_registry() -> None:
    # Put together here, so that this file does not name what it looks for.
    hosts = ["pypi" + ".org", "pythonhosted" + ".org", "files." + "python", "--index" + "-url"]
    homes = ["/" + "root/", "/" + "work/", "/" + "tmp/", "/" + "home/"]
    for path in tracked():
        if path.suffix not in TEXT:
            continue
        text = path.read_text("utf-8", errors="replace")
        for word in hosts + homes:
            assert word not in text, f"{path.relative_to(ROOT)} names {word}"


def test_documents_that_are_mentioned_exist() -> None:
    for path in tracked():
        if path.suffix in (".py", ".md") and path.parent.name != "tests":
            for name in re.findall(r"docs/[a-z_]+\.md", path.read_text("utf-8")):
                assert (ROOT / name).is_file(), f"{path.relative_to(ROOT)} mentions {name}"


def test_no_recording_is_in_the_project() -> None:
    for path in tracked():
        assert path.suffix.lower() not in {".bvh", ".amc", ".asf", ".c3d", ".fbx"}, path


def test_licence_and_citation() -> None:
    assert "Apache License" in (ROOT / "LICENSE").read_text("utf-8")[:200]
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))
    paper = citation["references"][0]
    assert [author["family-names"] for author in paper["authors"]] == ["Lee", "Shin"]
    assert (paper["year"], paper["start"], paper["end"]) == (1999, 39, 48)


def test_version_is_the_same_everywhere() -> None:
    import mjmotion

    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))
    assert citation["version"] == mjmotion.__version__
    assert f"## {mjmotion.__version__}" in (ROOT / "CHANGELOG.md").read_text("utf-8")


def test_ci_runs_make_test_and_stops_at_errors() -> None:
    run = ROOT / ".ci" / "run"
    assert os.access(run, os.X_OK)
    text = run.read_text("utf-8")
    assert "set -euo pipefail" in text
    assert text.rstrip().endswith("make test")


@pytest.mark.parametrize("script", sorted((ROOT / ".ci").iterdir()), ids=lambda path: path.name)
def test_shell_scripts_parse(script: Path) -> None:
    subprocess.run(["bash", "-n", str(script)], check=True)


def test_make_targets_are_there() -> None:
    listed = subprocess.run(
        ["make", "-s", "help"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    for target in ("demo", "test", "lint", "bench", "scenes", "fuzz", "kills", "lock", "clean"):
        assert re.search(rf"^{target}\s+\S", listed, re.MULTILINE), target
