"""The map of the project, read from the imports: a module imports only from those above it."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "mjmotion"

# The map, from the ground up. A name stands for a module or a whole package; modules of one line
# are at one level and do not import each other. New modules go in here, in this one place.
MAP: tuple[tuple[str, ...], ...] = (
    ("exceptions",),
    ("assets", "rotations"),
    ("tangent", "spline", "smoothing"),
    ("motion", "bones"),
    ("limits", "shapes"),
    ("kinematics",),
    ("contacts", "constraints", "coupling"),
    ("shared",),
    ("scene",),
    ("character",),
    ("footholds",),
    ("footpaths",),
    ("ik",),
    ("ankles", "clearance"),
    ("fit",),
    ("wishes",),
    ("clips",),
    ("planning",),
    ("adapt",),
    ("retarget", "morph", "transition", "edit", "spacetime"),
    ("validation",),
    ("video",),
    ("report",),
    ("results",),
    ("rope",),
    ("examples",),
    ("describe",),
    ("commands",),
    ("cli",),
)
LEVEL = {name: level for level, names in enumerate(MAP) for name in names}
MODULES = sorted(PACKAGE.rglob("*.py"))
HEAVY = (
    "matplotlib",
    "trimesh",
    "imageio",
    "PIL",
    "scipy.ndimage",
    "scipy.optimize",
    "tqdm",
    "yaml",
)


def part(path: Path) -> str:
    """The module or package of the map that a file belongs to; "" for mjmotion/__init__.py."""
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return "" if parts == ("__init__",) else parts[0]


def imported_parts(path: Path) -> dict[str, int]:
    """Parts of mjmotion that a file imports anywhere, lazily too, with the line."""
    found: dict[str, int] = {}
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.name}:{node.lineno}: relative import"
            names = [str(node.module)]
            if node.module == "mjmotion":
                names = [f"mjmotion.{alias.name}" for alias in node.names]
        for name in names:
            if name.startswith("mjmotion."):
                found.setdefault(name.split(".")[1], node.lineno)
    return found


def relative(path: Path) -> str:
    return str(path.relative_to(PACKAGE))


def test_every_module_is_on_the_map() -> None:
    missing = {part(path) for path in MODULES} - LEVEL.keys() - {"", "__main__"}
    assert not missing, f"add to MAP in {Path(__file__).name}: {sorted(missing)}"


@pytest.mark.parametrize("path", MODULES, ids=relative)
def test_imports_point_upwards(path: Path) -> None:
    own = part(path)
    if own in ("", "__main__"):  # the package's front door re-exports, lazily, whatever it likes
        return
    for other, line in imported_parts(path).items():
        if other == own or other == "__version__":
            continue
        assert LEVEL.get(other, len(MAP)) < LEVEL.get(own, 0), (
            f"mjmotion/{relative(path)}:{line} imports {other}, which is not above it on the map"
        )


@pytest.mark.parametrize("path", MODULES, ids=relative)
def test_public_things_have_docstrings(path: Path) -> None:
    tree = ast.parse(path.read_text("utf-8"))
    assert ast.get_docstring(tree), f"mjmotion/{relative(path)} says nowhere what it is for"
    for node in tree.body:
        if not isinstance(node, ast.FunctionDef | ast.ClassDef) or node.name.startswith("_"):
            continue
        assert ast.get_docstring(node), f"{relative(path)}:{node.lineno}: {node.name}"


@pytest.mark.parametrize("path", MODULES, ids=relative)
def test_only_the_command_line_prints(path: Path) -> None:
    if part(path) == "cli":
        return
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            assert node.func.id != "print", f"{relative(path)}:{node.lineno} prints"


@pytest.mark.parametrize("path", MODULES, ids=relative)
def test_files_are_short(path: Path) -> None:
    assert len(path.read_text("utf-8").splitlines()) <= 450, "one idea a file: split it"


def test_import_is_light() -> None:
    code = "import mjmotion, sys; print(*sys.modules)"
    loaded = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.split()
    assert "mjmotion" in loaded
    assert not {name for name in HEAVY if name in loaded}


def test_no_model_ever_loads_opengl() -> None:
    """Fit and validation run where there is no OpenGL: only the video may open a renderer."""
    for path in MODULES:
        if part(path) not in ("video", "report"):
            assert "mujoco.Renderer" not in path.read_text("utf-8"), relative(path)


def test_the_front_door_gives_what_it_names() -> None:
    code = (
        "import mjmotion, sys\n"
        "assert 'mujoco' not in sys.modules and set(mjmotion.__all__) <= set(dir(mjmotion))\n"
        "for name in mjmotion.__all__:\n"
        "    thing = getattr(mjmotion, name)\n"
        "    assert callable(thing) and thing.__name__ == name, name\n"
        "try:\n"
        "    mjmotion.nothing\n"
        "except AttributeError as error:\n"
        "    assert 'nothing' in str(error)\n"
        "else:\n"
        "    raise SystemExit('a name that is nowhere was found')\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
