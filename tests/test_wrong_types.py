"""Arguments of another type are told in one line, whichever function they are given to."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import mjmotion
from mjmotion import MotionError
from mjmotion.body.motion import Motion

# Of no type, as who makes such a mistake has no checker either.
adapt: Any = mjmotion.adapt
edit_frame: Any = mjmotion.edit_frame
fit: Any = mjmotion.fit
join: Any = mjmotion.join
load_clip: Any = mjmotion.load_clip
retarget: Any = mjmotion.retarget
LookAt: Any = mjmotion.LookAt
SiteConstraint: Any = mjmotion.SiteConstraint

HAND = SiteConstraint("left_hand", [3], [0.0, 0.0, 1.0])


class Holder:
    """As a result: it has a motion."""

    motion = "a motion"


@pytest.fixture(scope="module")
def clip() -> Motion:
    return mjmotion.load_clip("straight")


ASKED: list[tuple[str, Callable[..., Any], str]] = [
    ("a result as clip", lambda c: adapt(Holder(), "flat"), "type Holder.*its .motion"),
    ("a number as clip", lambda c: load_clip(5), "type int: give a file"),
    ("no scene", lambda c: adapt(c, None), "scene is of type NoneType"),
    ("a compiled scene", lambda c: adapt(c, c.model), "scene is of type MjModel"),
    ("a folder as scene", lambda c: adapt(c, "/tmp"), "is a folder"),
    ("a number as model", lambda c: retarget(c, 5), "model is of type int"),
    ("a name to fit", lambda c: fit("straight", []), "motion is of type str"),
    ("one constraint", lambda c: fit(c, HAND), "type SiteConstraint: give a list"),
    ("one constraint, adapted", lambda c: adapt(c, "flat", constraints=HAND), "give a list"),
    ("a file of constraints", lambda c: adapt(c, "flat", constraints="c.yaml"), "load_constraints"),
    ("numbers as constraints", lambda c: fit(c, [5]), "a constraint is of type int"),
    ("a file of contacts", lambda c: adapt(c, "flat", contacts="c.json"), "load_contacts"),
    ("numbers as contacts", lambda c: adapt(c, "flat", contacts=[5]), "type int: give a Contact"),
    ("a number for contacts", lambda c: adapt(c, "flat", contacts=5), "contacts is of type int"),
    ("a name to join", lambda c: join("straight"), "clips is of type str"),
    ("a tolerance below 0", lambda c: fit(c, [], tolerance=-1.0), "must be 0 m or more"),
    ("no tolerance", lambda c: fit(c, [], tolerance=float("nan")), "must be 0 m or more"),
    ("a text as tolerance", lambda c: fit(c, [], tolerance="1mm"), "must be a length"),
    (
        "an edit's tolerance",
        lambda c: edit_frame(c, 30, "pelvis", by=(0.0, 0.0, -0.1), tolerance=-1.0),
        "must be 0 m or more",
    ),
]


@pytest.mark.parametrize(("_", "ask", "said"), ASKED, ids=[name for name, *_ in ASKED])
def test_another_type_is_told(_: str, ask: Callable[..., Any], said: str, clip: Motion) -> None:
    with pytest.raises(MotionError, match=said) as error:
        ask(clip)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("frames", [[1.5], ["a"], [float("nan")]])
def test_frames_are_whole_numbers(frames: list[Any]) -> None:
    with pytest.raises(MotionError, match="whole numbers"):
        LookAt("face", frames, (1.0, 0.0, 0.0))


def test_frames_of_any_integer_kind_do() -> None:
    for frames in ([1.0, 2.0], range(1, 3), np.array([1, 2], dtype=np.int32)):
        one = SiteConstraint("left_hand", frames, [0.0, 0.0, 1.0])
        assert one.frames.tolist() == [1, 2]
