"""The map of the project, read from its imports: a package imports only from those before it."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "mjmotion"

# The map, from the ground up, as CONTRIBUTING has it. Lazy and type-only imports count.
MAP = (
    "exceptions",
    "numerics",
    "body",
    "constraints",
    "scene",
    "ik",
    "fitting",
    "footsteps",
    "clips",
    "validation",
    "output",
    "apps",
    "paper",
    "cli",
)
LINES, FUNCTION_LINES, PARAMETERS = 400, 60, 8
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


def modules() -> dict[str, Path]:
    """Every module but the front door, by its dotted name without ``mjmotion.``."""
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        if name not in ("", "__main__"):
            found[name] = path
    return found


MODULES = modules()
TREES = {name: ast.parse(path.read_text("utf-8")) for name, path in MODULES.items()}


def imports(tree: ast.Module) -> dict[str, int]:
    """Modules of mjmotion that a file imports anywhere, with the line."""
    found: dict[str, int] = {}
    for node in ast.walk(tree):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative import"
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        for name in names:
            if name.startswith("mjmotion."):
                inside = name.removeprefix("mjmotion.")
                while inside and inside not in MODULES:
                    inside = inside.rpartition(".")[0]
                if inside:
                    assert isinstance(node, ast.Import | ast.ImportFrom)
                    found.setdefault(inside, node.lineno)
    return found


def circles(graph: dict[str, set[str]]) -> list[str]:
    """Modules from which imports lead back to themselves."""
    reach = {name: set(others) for name, others in graph.items()}
    for middle in graph:
        for others in reach.values():
            if middle in others:
                others |= reach[middle]
    return sorted(name for name, others in reach.items() if name in others)


def test_the_map() -> None:
    """Packages import from those before them, files in no circle, all of them on the map."""
    assert {name.split(".")[0] for name in MODULES} == set(MAP)
    level = {name: number for number, name in enumerate(MAP)}
    graph = {name: imports(tree) for name, tree in TREES.items()}
    upwards = [
        f"{name}:{line} imports {other}"
        for name, others in graph.items()
        for other, line in others.items()
        if level[other.split(".")[0]] > level[name.split(".")[0]]
    ]
    assert not upwards, "not before it on the map: " + "; ".join(upwards)
    assert not circles({name: set(others) for name, others in graph.items()})


def test_the_validation_is_independent() -> None:
    """It imports motions and errors, numpy and mujoco: nothing that fits or plans can reach it.

    Two more, where they are used: scipy for hulls that MuJoCo has not made, and a reader of YAML
    for files of thresholds, which measures nothing.
    """
    allowed = {"mujoco", "numpy", "numpy.typing.NDArray", "mjmotion.body.motion.Motion"}
    lazy = {"meshes": "scipy.spatial.ConvexHull", "thresholds": "yaml"}
    foreign = []
    for module, tree in TREES.items():
        if module.split(".")[0] != "validation":
            continue
        for node in ast.walk(tree):
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                names = [f"{node.module}.{alias.name}" for alias in node.names]
            else:
                continue
            for name in names:
                inside = name.startswith(("mjmotion.validation.", "mjmotion.exceptions."))
                late = name == lazy.get(module.rpartition(".")[2]) and node not in tree.body
                standard = name.split(".")[0] in sys.stdlib_module_names
                if not (inside or late or standard or name in allowed):
                    foreign.append(f"{module}:{node.lineno} {name}")
    assert not foreign, "not for the validation to know: " + "; ".join(foreign)


def test_circles_are_found() -> None:
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"b"}}) == ["b", "c"]


def test_public_things_have_docstrings() -> None:
    missing = []
    for name, tree in TREES.items():
        if not ast.get_docstring(tree):
            missing.append(name)
        for node in tree.body:
            if not isinstance(node, ast.FunctionDef | ast.ClassDef) or node.name[0] == "_":
                continue
            if not ast.get_docstring(node):
                missing.append(f"{name}.{node.name}")
    assert not missing


def test_only_the_command_line_prints() -> None:
    printing = [
        f"{name}:{node.lineno}"
        for name, tree in TREES.items()
        if not name.startswith("cli")
        for node in ast.walk(tree)
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Name)
        and node.func.id == "print"
    ]
    assert not printing


def test_import_is_light() -> None:
    code = "import mjmotion, sys; print(*sys.modules)"
    loaded = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.split()
    assert "mjmotion" in loaded
    assert not {name for name in HEAVY if name in loaded}


def test_no_model_ever_loads_opengl() -> None:
    """Fit and validation run where there is no OpenGL: only the output may open a renderer."""
    for name, path in MODULES.items():
        if not name.startswith("output"):
            assert "mujoco.Renderer" not in path.read_text("utf-8"), name


def test_the_front_door_gives_what_it_names() -> None:
    code = (
        "import mjmotion, sys\n"
        "assert 'mujoco' not in sys.modules and set(mjmotion.__all__) <= set(dir(mjmotion))\n"
        "for name in mjmotion.__all__:\n"
        "    thing = getattr(mjmotion, name)\n"
        "    assert callable(thing) and thing.__name__ == name, name\n"
        "for name in mjmotion.__all__:\n"
        "    assert callable(getattr(mjmotion, name)), f'{name} became a module'\n"
        "try:\n"
        "    mjmotion.nothing\n"
        "except AttributeError as error:\n"
        "    assert 'nothing' in str(error)\n"
        "else:\n"
        "    raise SystemExit('a name that is nowhere was found')\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
