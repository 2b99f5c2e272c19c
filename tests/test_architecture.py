"""The map of the project, read from its imports: a package imports only from those before it."""

from __future__ import annotations

import ast
import io
import re
import subprocess
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "mjmotion"

# The map, from the ground up, as CONTRIBUTING has it. Lazy and type-only imports count.
MAP = (
    "exceptions",
    "boundary",
    "numerics",
    "body",
    "constraints",
    "scene",
    "ik",
    "fitting",
    "route",
    "footsteps",
    "clips",
    "validation",
    "output",
    "apps",
    "paper",
    "editor",
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


def imported(tree: ast.Module) -> Iterator[tuple[ast.stmt, str]]:
    """What a file imports anywhere, by its dotted name, with the statement."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((node, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative import"
            yield from ((node, f"{node.module}.{alias.name}") for alias in node.names)


def imports(tree: ast.Module) -> dict[str, int]:
    """Modules of mjmotion that a file imports anywhere, with the line."""
    found: dict[str, int] = {}
    for node, name in imported(tree):
        if name.startswith("mjmotion."):
            inside = name.removeprefix("mjmotion.")
            while inside and inside not in MODULES:
                inside = inside.rpartition(".")[0]
            if inside:
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

    Three more, where they are used: scipy for hulls that MuJoCo has not made and for non-negative
    least squares, and a reader of files of thresholds, which measures nothing.
    """
    allowed = {"mujoco", "numpy", "numpy.typing.NDArray", "mjmotion.body.motion.Motion"}
    lazy = {
        "meshes": "scipy.spatial.ConvexHull",
        "thresholds": "mjmotion.boundary.structured.read_structured",
        "effort": "scipy.optimize.nnls",
    }
    foreign = []
    for module, tree in TREES.items():
        if module.split(".")[0] != "validation":
            continue
        for node, name in imported(tree):
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


# --- sizes, caches, calls -------------------------------------------------------------------------

FILES = {str(p.relative_to(PACKAGE)): p.read_text("utf-8") for p in sorted(PACKAGE.rglob("*.py"))}
CACHES = ("functools.lru_cache", "functools.cache")
# Of what a cache's keys may be made: values that are compared by what they are, and stay so.
PLAIN = {"None", "bool", "bytes", "float", "frozenset", "int", "str", "tuple", "Path"}
# Comments that are for tools give no reason.
FOR_TOOLS = re.compile(r"#\s*(noqa|type:|pragma|fmt:|ruff:|mypy:)[^#]*")
Function = ast.FunctionDef | ast.AsyncFunctionDef


def functions(tree: ast.Module) -> Iterator[tuple[Function, bool]]:
    """Every function however deep, and whether it is called on an object or a class."""
    for outer in ast.walk(tree):
        for node in ast.iter_child_nodes(outer):
            if isinstance(node, Function):
                static = any(ast.unparse(d) == "staticmethod" for d in node.decorator_list)
                yield node, isinstance(outer, ast.ClassDef) and not static


def parameters(node: Function) -> list[ast.arg]:
    """All parameters, also those after a star."""
    args = node.args
    stars = [star for star in (args.vararg, args.kwarg) if star is not None]
    return [*args.posonlyargs, *args.args, *args.kwonlyargs, *stars]


def reason(node: Function, comments: dict[int, str]) -> str:
    """The comment on the line of ``def`` and those right above; "" of fewer than three words."""
    first = node.lineno
    while first - 1 in comments:
        first -= 1
    said = " ".join(comments.get(line, "") for line in range(first, node.lineno + 1))
    return said if len(re.findall(r"[^\W\d_]+", said)) >= 3 else ""


def too_large(path: str, text: str) -> list[str]:
    """A file that is too long, and functions too long or of too many parameters without a reason.

    A reason is a comment on the line of ``def`` or on the one before it. Where it speaks of
    parameters, and not of lines as well, it is none for a length.
    """
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    written = [token for token in tokens if token.type == tokenize.COMMENT]
    comments = {token.start[0]: FOR_TOOLS.sub("", token.string) for token in written}
    found = []
    if (lines := len(text.splitlines())) > LINES:
        found.append(f"{path}: {lines} lines, more than {LINES}")
    for node, bound in functions(ast.parse(text)):
        given = reason(node, comments)
        where = f"{path}:{node.lineno} {node.name}"
        length = (node.end_lineno or node.lineno) - node.lineno + 1
        other = "parameters" in given and "lines" not in given
        if length > FUNCTION_LINES and (other or not given):
            found.append(f"{where}: {length} lines, more than {FUNCTION_LINES}")
        if (count := len(parameters(node)) - bound) > PARAMETERS and not given:
            found.append(f"{where}: {count} parameters, more than {PARAMETERS}")
    return found


def caches_by_identity(path: str, text: str) -> list[str]:
    """Caches of functools whose keys are not all plain values, as the annotations say.

    One by a model, a character or an array keeps it alive, and answers for what it no longer is.
    Caches are for decorators only: of a function that is wrapped later nothing is known here.
    """
    tree = ast.parse(text)
    # The names of the caches in this file: functools may come whole, and either under another name.
    names: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module == "functools":
            own = [a for a in node.names if f"functools.{a.name}" in CACHES]
            names |= {alias.asname or alias.name for alias in own}
        elif isinstance(node, ast.Import):
            own = [alias for alias in node.names if alias.name == "functools"]
            names |= {
                (a.asname or a.name) + c.removeprefix("functools") for a in own for c in CACHES
            }
    found: list[str] = []
    decorators: set[ast.AST] = set()
    for function, _ in functions(tree):
        for decorator in function.decorator_list:
            cache = decorator.func if isinstance(decorator, ast.Call) else decorator
            if ast.unparse(cache) not in names:
                continue
            decorators.add(cache)
            found += [
                f"{path}:{function.lineno} {function.name}: cached by {parameter.arg}"
                for parameter in parameters(function)
                if not plain(parameter.annotation)
            ]
    for node in ast.walk(tree):
        used = isinstance(node, ast.Name | ast.Attribute) and node not in decorators
        if used and (name := ast.unparse(node)) in names:
            found.append(f"{path}: {name} is not a decorator")
    return found


def plain(annotation: ast.expr | None) -> bool:
    """Whether an annotation is of plain values alone."""
    if annotation is None:
        return False
    for node in ast.walk(annotation):
        if isinstance(node, ast.Name | ast.Attribute) and ast.unparse(node) not in PLAIN:
            return False
        text = node.value if isinstance(node, ast.Constant) else None
        if isinstance(text, str) and not plain(ast.parse(text, mode="eval").body):
            return False
    return True


def star_tuples(path: str, text: str) -> list[str]:
    """Calls with ``*(a, b)`` among their arguments: the arguments can be written out."""
    return [
        f"{path}:{argument.lineno} {ast.unparse(argument)}"
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Call)
        for argument in node.args
        if isinstance(argument, ast.Starred) and isinstance(argument.value, ast.Tuple)
    ]


def test_files_and_functions_are_small() -> None:
    """What is larger says why, in a comment at its ``def``."""
    found = [line for path, text in FILES.items() for line in too_large(path, text)]
    assert not found, "too large, without a reason:\n" + "\n".join(found)


def test_caches_are_keyed_by_plain_values() -> None:
    found = [line for path, text in FILES.items() for line in caches_by_identity(path, text)]
    assert not found, "cached by what may change:\n" + "\n".join(found)


def test_no_call_unpacks_a_tuple_that_is_written_there() -> None:
    found = [line for path, text in FILES.items() for line in star_tuples(path, text)]
    assert not found, "write the arguments out:\n" + "\n".join(found)


def long(head: str, before: str = "") -> str:
    """The text of a function of one line too many."""
    return f"{before}\n{head}\n" + "    pass\n" * FUNCTION_LINES


EIGHT = "a, b, c, d, /, e, f, *, g, h"


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("x = 1\n" * LINES, ""),
        ("x = 1\n" * (LINES + 1), "f: 401 lines, more than 400"),
        (long("def g():").removesuffix("    pass\n"), ""),
        (long("def g():"), "f:2 g: 61 lines, more than 60"),
        (long("async def g():"), "f:2 g: 61 lines, more than 60"),
        (long("def g():  # one step after another"), ""),
        (long("def g():", "# one step after another"), ""),
        (long("def g():", "# one step after another\n"), "f:3 g: 61 lines, more than 60"),
        (long("def g():", "# nine parameters\n# have a default"), "f:3 g: 61 lines, more than 60"),
        (long("def g():", "# parameters and lines\n# as in the paper"), ""),
        (long("def g():  # noqa: not a reason"), "f:2 g: 61 lines, more than 60"),
        (long("def g():  # type: ignore[no-untyped-def]"), "f:2 g: 61 lines, more than 60"),
        (long("def g():  # noqa  # one step after another"), ""),
        (long("def g(a='# one step after another'):"), "f:2 g: 61 lines, more than 60"),
        (f"def g({EIGHT}): pass", ""),
        (f"def g({EIGHT}, i): pass", "f:1 g: 9 parameters, more than 8"),
        (f"def g({EIGHT.replace('*', '*i')}, **j): 0", "f:1 g: 10 parameters, more than 8"),
        (f"def g({EIGHT}, i): pass  # these are the paper's", ""),
        (f"class C:\n def g(self, {EIGHT}): pass", ""),
        (f"class C:\n def g(self, {EIGHT}, i): pass", "f:2 g: 9 parameters, more than 8"),
        (f"class C:\n @staticmethod\n def g({EIGHT}, i): 0", "f:3 g: 9 parameters, more than 8"),
        (f"def o():\n def g({EIGHT}, i): pass", "f:2 g: 9 parameters, more than 8"),
    ],
)
def test_what_is_too_large_is_found(text: str, found: str) -> None:
    assert "; ".join(too_large("f", text)) == found


@pytest.mark.parametrize(
    ("imported", "text", "found"),
    [
        ("from functools import cache", "@cache\ndef g(a: tuple[int, ...], *b: str): 0", ""),
        ("from functools import lru_cache", "@lru_cache(9)\ndef g(a: 'int | None'): 0", ""),
        ("from functools import cached_property", "@cached_property\ndef g(a): 0", ""),
        ("from ours import cache", "@cache\ndef g(a: Character): 0", ""),
        ("from functools import cache", "@cache\ndef g(a: Body, b: int): 0", "cached by a"),
        ("from functools import cache as keep", "@keep\ndef g(a: 'Body'): 0", "cached by a"),
        ("from functools import lru_cache", "@lru_cache(1)\ndef g(*a: Body): 0", "cached by a"),
        ("import functools", "@functools.cache\ndef g(*, a: mujoco.MjModel): 0", "cached by a"),
        ("import functools as f", "@f.cache\ndef g(a: tuple[int, 'Array']): 0", "cached by a"),
        ("from functools import cache", "@cache\ndef g(a): 0", "cached by a"),
        ("from functools import cache", "class C:\n @cache\n def g(a): 0", "cached by a"),
        ("from functools import cache", "h = cache(g)", "cache is not a decorator"),
        ("import functools", "h = functools.cache(g)", "functools.cache is not a decorator"),
    ],
)
def test_caches_by_identity_are_found(imported: str, text: str, found: str) -> None:
    told = caches_by_identity("f", f"{imported}\n{text}")
    assert [line.rpartition(": ")[2] for line in told] == ([found] if found else [])


def test_written_tuples_in_calls_are_found() -> None:
    assert star_tuples("f", "g(*(a, b), c)\nx.g(h(1, *(a,)))") == ["f:1 *(a, b)", "f:2 *(a,)"]
    assert star_tuples("f", "g(*a, (b, c), *h(b, c), k=(1, 2))\nx = [*(a, b), c]") == []
