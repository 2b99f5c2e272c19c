"""JSON and YAML files: what they hold, or one line that says why not.

No key may stand twice in a mapping, since readers disagree about which one counts. Depth, digits
and the values that aliases stand for are counted before anything is built.
"""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any, NoReturn

from mjmotion.boundary.files import file_bytes
from mjmotion.boundary.limits import (
    MOST_DEPTH,
    MOST_DIGITS,
    MOST_NODES,
    MOST_STRUCTURED,
    MOST_VALUES,
    MOST_YAML,
    at_most,
    shown,
)
from mjmotion.boundary.words import first_line
from mjmotion.exceptions import MotionError

# What stands between values of JSON, and within some texts.
_MARKS: dict[type, tuple[Any, ...]] = {str: (",", "["), bytes: (b",", b"[")}
_POWER = re.compile(r"[-+]?[0-9]+(\.[0-9]*)?[eE][-+]?[0-9]+")  # YAML 1.1 takes 1e5 for text


def read_structured(path: str | Path, what: str, error: type[MotionError] = MotionError) -> Any:
    """Return what a file holds: JSON where its name ends so, else YAML, of which JSON is a part.

    Args:
      path: the file.
      what: what it is called in messages, such as ``"contacts file"``.
      error: what is raised.

    Raises:
      MotionError: as ``error``: no such file, too large, too deep, damaged, or a key twice.
    """
    path = Path(path)
    if path.suffix.lower() == ".json":
        return read_json(path, what, error)
    text, name = _text(path, what, MOST_YAML, error), f"{what} '{path}'"
    return _yaml(text, name, error)


def read_json(path: str | Path, what: str, error: type[MotionError] = MotionError) -> Any:
    """Return what a JSON file holds; see :func:`read_structured`."""
    return parse_json(_text(Path(path), what, MOST_STRUCTURED, error), f"{what} '{path}'", error)


def parse_json(text: str | bytes, name: str, error: type[MotionError] = MotionError) -> Any:
    """Return what JSON says; ``name`` is what it is called in messages, its file with it.

    Raises:
      MotionError: as ``error``: too deep, damaged, or a key twice.
    """
    marks = sum(text.count(mark) for mark in _MARKS[type(text)])
    at_most(marks, MOST_VALUES, f"{name} holds too many values", error)
    if not text.strip():
        raise error(f"{name} is empty")

    def pairs(found: list[tuple[str, Any]]) -> dict[str, Any]:
        content = dict(found)
        if len(content) < len(found):
            keys = [key for key, _ in found]
            twice = next(key for key in keys if keys.count(key) > 1)
            raise error(f"{name} gives {shown(twice)} twice in one place: keep one of them")
        return content

    def constant(word: str) -> NoReturn:
        raise error(f"{name} holds {word}: numbers must be finite")

    def real(word: str) -> float:
        number = float(word)
        if math.isinf(number):  # written in digits, such as 1e400
            raise error(f"{name} holds {word[: MOST_DIGITS // 8]}: numbers must be finite")
        return number

    def whole(word: str) -> int:
        if len(word) > MOST_DIGITS:
            raise error(f"{name} holds a number of {len(word)} digits: {MOST_DIGITS} at most")
        return int(word)

    try:
        return json.loads(
            text,
            object_pairs_hook=pairs,
            parse_constant=constant,
            parse_int=whole,
            parse_float=real,
        )
    except RecursionError:
        raise error(f"{name} has lists within lists, far too deep") from None
    except ValueError as fault:
        raise error(f"{name} cannot be read, it is not JSON: {first_line(fault)}") from None


def _text(path: Path, what: str, most: int, error: type[MotionError]) -> str:
    try:
        return file_bytes(path, what, most, error).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise error(f"{what} '{path}' is not text in UTF-8: save it so") from None


def _yaml(text: str, name: str, error: type[MotionError]) -> Any:
    import yaml  # only here: a third of mjmotion's own import time

    if not text.strip():
        raise error(f"{name} is empty")
    loader = _loader(yaml)
    try:
        _check_events(yaml, text, name, error)
        return yaml.load(text, Loader=loader)
    except yaml.YAMLError as fault:
        mark, problem = getattr(fault, "problem_mark", None), getattr(fault, "problem", None)
        place = f" (line {mark.line + 1})" if mark is not None else ""
        said = " ".join(str(problem or fault).split())[:200]
        raise error(f"{name} cannot be read, it is not YAML: {said}{place}") from None
    except (ValueError, TypeError, OverflowError, RecursionError, AttributeError) as fault:
        # The reader's own constructors fail so on dates, digits and keys that make no sense.
        raise error(f"{name} cannot be read, it is not YAML: {first_line(fault)}") from None


def _check_events(yaml: Any, text: str, name: str, error: type[MotionError]) -> None:
    """Count depth and values, those that aliases stand for too, before anything is built."""
    weights: dict[str, int] = {}
    opened: list[tuple[str | None, int]] = []
    total = 0
    for event in yaml.parse(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader)):
        if isinstance(event, yaml.AliasEvent):
            if any(anchor == event.anchor for anchor, _ in opened):
                raise error(f"{name}: '*{event.anchor}' stands within what it names")
            total += weights.get(event.anchor, 0)
        elif isinstance(event, yaml.ScalarEvent):
            total += 1
            if len(event.value) > MOST_DIGITS and event.implicit[0]:
                _check_digits(event.value, name, error)
            if event.anchor:
                weights[event.anchor] = 1
        elif isinstance(event, yaml.CollectionStartEvent):
            opened.append((event.anchor, total))
            total += 1
            if len(opened) > MOST_DEPTH:
                raise error(f"{name} has lists within lists, more than {MOST_DEPTH} deep")
        elif isinstance(event, yaml.CollectionEndEvent):
            anchor, before = opened.pop()
            if anchor:
                weights[anchor] = total - before
        at_most(total, MOST_NODES, f"{name} holds too many values, its aliases followed", error)


def _check_digits(word: str, name: str, error: type[MotionError]) -> None:
    if re.fullmatch(r"[-+]?[0-9a-fA-FxXob_.:]+", word):
        raise error(f"{name} holds a number of {len(word)} digits: {MOST_DIGITS} at most")


def _loader(yaml: Any) -> Any:
    """Return a loader that takes no key twice, and no numbers that are not finite."""
    base = getattr(yaml, "CSafeLoader", yaml.SafeLoader)

    class Loader(base):  # type: ignore[misc, valid-type]
        def construct_mapping(self, node: Any, deep: bool = False) -> Any:
            seen = set()
            for key, _ in node.value:
                if isinstance(key, yaml.ScalarNode) and key.tag != "tag:yaml.org,2002:merge":
                    if key.value in seen:
                        raise yaml.constructor.ConstructorError(
                            None, None, f"{shown(key.value)} stands twice", key.start_mark
                        )
                    seen.add(key.value)
            return super().construct_mapping(node, deep=deep)

    Loader.add_implicit_resolver("tag:yaml.org,2002:float", _POWER, list("-+0123456789"))
    return Loader
