"""Constraints: from Python, from YAML and JSON, good and bad, and laid out over frames."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from made_up import humanoid, of_site
from scipy.spatial.transform import Rotation

from mjmotion.constraints import (
    Constraint,
    LookAt,
    RelativeConstraint,
    SiteConstraint,
    lay_out,
    load_constraints,
)
from mjmotion.exceptions import ConstraintError, ModelError

GOOD = """
- site: left_hand
  frames: [10, 14]
  position: [1.2, 0.4, 1.1]
  weight: 0.5
- {site: head_top, frames: 3, quat: [2, 0, 0, 0]}
- site: right_hand
  frames: [0, 2]
  position: [[0, 0, 1], [0, 0, 2]]
  quat: [0, 0, 0, 1]
"""


OTHER_KINDS = """
- site: left_hand
  frames: [60, 80]
  to: pelvis
  position: [0.0, 0.2, 0.05]
  quat: [0, 0, 0, 3]
  weight: 0.5
- {site: right_hand, frames: 7, to: left_hand, quat: [1, 0, 0, 0]}
- site: face
  frames: [60, 62]
  look_at: [[2, 0, 1], [3, 0, 1]]
  axis: [0, 0, 5]
- {site: head_top, frames: [0, 3], look_at: [2, 0, 1], weight: 0.25}
- site: left_foot
  frames: [10, 30]
  position: [1, 0.1, 0]
  quat: [1, 0, 0, 0]
  free: [x, y, yaw]
"""


def write(folder: Path, text: str, name: str = "constraints.yaml") -> Path:
    path = folder / name
    path.write_text(text, "utf-8")
    return path


def check(*constraints: Constraint) -> None:
    first, second, third = (of_site(one) for one in constraints)
    assert (first.site, first.weight, first.quat) == ("left_hand", 0.5, None)
    np.testing.assert_array_equal(first.frames, range(10, 14))
    np.testing.assert_array_equal(first.position, np.tile((1.2, 0.4, 1.1), (4, 1)))
    np.testing.assert_array_equal(second.frames, [3])
    np.testing.assert_array_equal(second.quat, [[1, 0, 0, 0]])
    assert second.position is None and second.weight == 1.0 and not second.contact
    np.testing.assert_array_equal(third.position, [[0, 0, 1], [0, 0, 2]])
    np.testing.assert_array_equal(third.quat, [[0, 0, 0, 1]] * 2)
    assert (first.nscalar, second.nscalar, third.nscalar) == (12, 3, 12)


def test_yaml_and_json_read_the_same(tmp_path: Path) -> None:
    import yaml

    check(*load_constraints(write(tmp_path, GOOD), humanoid(), 20))
    text = json.dumps(yaml.safe_load(GOOD))
    check(*load_constraints(write(tmp_path, text, "constraints.JSON"), humanoid(), 20))


@pytest.mark.parametrize("kind", ["yaml", "json"])
def test_every_kind_is_read(kind: str, tmp_path: Path) -> None:
    """A hand on the hip, one in the other hand, two look-ats and a foothold that is free."""
    import yaml

    text = OTHER_KINDS if kind == "yaml" else json.dumps(yaml.safe_load(OTHER_KINDS))
    path = write(tmp_path, text, f"constraints.{kind}")
    hip, hands, look, mild, foot = load_constraints(path, humanoid(), 90)
    assert isinstance(hip, RelativeConstraint) and (hip.site, hip.to) == ("left_hand", "pelvis")
    np.testing.assert_array_equal(hip.frames, range(60, 80))
    np.testing.assert_array_equal(hip.position, np.tile((0.0, 0.2, 0.05), (20, 1)))
    np.testing.assert_array_equal(hip.quat, np.tile((0, 0, 0, 1), (20, 1)))
    assert hip.weight == 0.5 and hip.nscalar == 120
    assert isinstance(hands, RelativeConstraint) and hands.position is None
    assert hands.to == "left_hand" and hands.frames.tolist() == [7] and hands.nscalar == 3
    assert isinstance(look, LookAt) and look.frames.tolist() == [60, 61] and look.nscalar == 4
    np.testing.assert_array_equal(look.point, [(2, 0, 1), (3, 0, 1)])
    np.testing.assert_array_equal(look.axis, (0, 0, 1))
    assert isinstance(mild, LookAt) and mild.weight == 0.25
    np.testing.assert_array_equal(mild.axis, (1, 0, 0))
    assert isinstance(foot, SiteConstraint) and foot.free == ("x", "y", "yaw")
    assert not foot.contact and foot.nscalar == 120


def test_an_empty_list_is_fine(tmp_path: Path) -> None:
    assert load_constraints(write(tmp_path, "[]"), humanoid(), 20) == ()


BAD_FILES = {
    "mapping": ("site: left_hand", "list"),
    "empty": ("", "is empty"),
    "yaml": ("- [1, 2", "not YAML"),
    "no frames": ("- {site: left_hand, position: [0, 0, 1]}", "entry 0.*frames"),
    "no site": ("- {frames: 1, position: [0, 0, 1]}", "entry 0.*site"),
    "text entry": ("- left_hand", "entry 0.*mapping"),
    "unknown key": ("- {site: left_hand, frames: 1, pos: [0, 0, 1]}", "unknown key 'pos'"),
    "unknown site": ("- {site: left_hant, frames: 1, position: [0, 0, 1]}", "left_hand"),
    "past the end": ("- {site: left_hand, frames: [3, 21], position: [0, 0, 1]}", "0 to 20"),
    "negative": ("- {site: left_hand, frames: [-1, 3], position: [0, 0, 1]}", "0 to 20"),
    "backwards": ("- {site: left_hand, frames: [5, 5], position: [0, 0, 1]}", "are none"),
    "half a frame": ("- {site: left_hand, frames: [1.5, 3], position: [0, 0, 1]}", "frames"),
    "frame list": ("- {site: left_hand, frames: [1, 2, 3], position: [0, 0, 1]}", "start, end"),
    "true frames": ("- {site: left_hand, frames: [false, true], position: [0, 0, 1]}", "frames"),
    "wants nothing": ("- {site: left_hand, frames: 1}", "wants nothing"),
    "two numbers": ("- {site: left_hand, frames: 1, position: [0, 1]}", "3 numbers"),
    "words": ("- {site: left_hand, frames: 1, position: [a, b, c]}", "3 numbers"),
    "rows": ("- {site: left_hand, frames: [0, 3], position: [[0, 0, 1], [0, 0, 1]]}", "3 rows"),
    "nan": ("- {site: left_hand, frames: 1, position: [.nan, 0, 1]}", "not finite"),
    "zero quat": ("- {site: left_hand, frames: 1, quat: [0, 0, 0, 0]}", "quat is zero"),
    "no weight": ("- {site: left_hand, frames: 1, position: [0, 0, 1], weight: 0}", "weight"),
    "heavy": ("- {site: left_hand, frames: 1, position: [0, 0, 1], weight: 1.5}", "weight"),
    "weight word": ("- {site: left_hand, frames: 1, position: [0, 0, 1], weight: x}", "entry 0"),
    "free word": (
        "- {site: left_hand, frames: 1, position: [0, 0, 1], free: [x, roll]}",
        "free 'roll' is none of x, y, z, yaw",
    ),
    "free no list": ("- {site: left_hand, frames: 1, position: [0, 0, 1], free: x}", "a list"),
    "free of nothing": (
        "- {site: left_hand, frames: 1, quat: [1, 0, 0, 0], free: [yaw]}",
        "no position to move from",
    ),
    "free and to": (
        "- {site: left_hand, frames: 1, to: pelvis, position: [0, 0, 1], free: [x]}",
        "unknown key 'free'",
    ),
    "to nothing": ("- {site: left_hand, frames: 1, to: pelviss, position: [0, 0, 1]}", "'pelvis'"),
    "to itself": ("- {site: left_hand, frames: 1, to: left_hand, quat: [1, 0, 0, 0]}", "two sites"),
    "to and nothing": ("- {site: left_hand, frames: 1, to: pelvis}", "wants nothing"),
    "to two": ("- {site: left_hand, frames: 1, to: pelvis, position: [0, 1]}", "3 numbers"),
    "look and to": ("- {site: face, frames: 1, look_at: [0, 0, 1], to: pelvis}", "'look_at'"),
    "look and position": (
        "- {site: face, frames: 1, look_at: [0, 0, 1], position: [0, 0, 1]}",
        "unknown key 'position'",
    ),
    "look at two": ("- {site: face, frames: 1, look_at: [0, 1]}", "point must be 3 numbers"),
    "look at words": ("- {site: face, frames: 1, look_at: there}", "point must be 3 numbers"),
    "look at nothing": ("- {site: face, frames: 1, look_at: null}", "point is not finite"),
    "no axis": ("- {site: face, frames: 1, look_at: [0, 0, 1], axis: [0, 0, 0]}", "no length"),
    "axis alone": ("- {site: face, frames: 1, axis: [0, 0, 1]}", "unknown key 'axis'"),
    "no such face": ("- {site: faces, frames: 1, look_at: [0, 0, 1]}", "Did you mean 'face'"),
    "look weight": ("- {site: face, frames: 1, look_at: [0, 0, 1], weight: 2}", "weight"),
    "look late": ("- {site: face, frames: [15, 22], look_at: [0, 0, 1]}", "0 to 20"),
    "second entry": (
        "- {site: left_hand, frames: 1, position: [0, 0, 1]}\n- {site: head_top, frames: 1}",
        "entry 1",
    ),
}


@pytest.mark.parametrize("case", sorted(BAD_FILES))
def test_bad_files(case: str, tmp_path: Path) -> None:
    text, message = BAD_FILES[case]
    with pytest.raises(ConstraintError, match=message) as caught:
        load_constraints(write(tmp_path, text), humanoid(), 20)
    assert "\n" not in str(caught.value) and "constraints.yaml" in str(caught.value)


def test_bad_json_missing_file_and_bytes(tmp_path: Path) -> None:
    with pytest.raises(ConstraintError, match="not JSON"):
        load_constraints(write(tmp_path, "[{", "c.json"), humanoid(), 20)
    with pytest.raises(ConstraintError, match="does not exist"):
        load_constraints(tmp_path / "absent.yaml", humanoid(), 20)
    (tmp_path / "bytes.yaml").write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(ConstraintError, match="not text in UTF-8"):
        load_constraints(tmp_path / "bytes.yaml", humanoid(), 20)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"frames": []}, "no frames"),
        ({"frames": [1, 2, 1]}, "twice"),
        ({"position": None}, "wants nothing"),
        ({"weight": -0.1}, "weight"),
        ({"weight": float("nan")}, "weight"),
        ({"position": np.zeros((3, 3))}, "2 rows"),
        ({"position": (0, 0, np.inf)}, "not finite"),
        ({"quat": np.zeros(4)}, "zero"),
        ({"free": ("x", "w")}, "free 'w'"),
        ({"free": "yaw"}, "free 'a'"),
        ({"free": ("x",), "position": None, "quat": (1, 0, 0, 0)}, "no position to move from"),
    ],
)
def test_bad_constraints(options: dict[str, object], message: str) -> None:
    good: dict[str, object] = {"frames": [1, 2], "position": (0, 0, 1)}
    with pytest.raises(ConstraintError, match=message):
        SiteConstraint("left_hand", **{**good, **options})  # type: ignore[arg-type]


def test_arrays_are_copies() -> None:
    point = np.zeros((2, 3))
    constraint = SiteConstraint("left_hand", np.array((4, 5)), point)
    point[:] = 7.0
    assert constraint.position is not None and (constraint.position == 0.0).all()
    with pytest.raises(ValueError):
        constraint.position[0, 0] = 1.0


def test_lay_out() -> None:
    model = humanoid()
    turn = Rotation.from_euler("z", 0.7)
    constraints = [
        SiteConstraint(
            "left_foot", np.array((5, 2)), np.array([(0, 0, 1), (0, 0, 2)]), contact=True
        ),
        SiteConstraint(
            "head_top", np.array((2, 9)), quat=turn.as_quat(scalar_first=True), weight=0.3
        ),
        SiteConstraint("left_foot", np.array((5,)), np.array((3, 3, 3))),
    ]
    targets = lay_out(constraints, model, 10)
    np.testing.assert_array_equal(targets.frames, (2, 5, 9))
    assert [model.site(int(site)).name for site in targets.sites] == ["left_foot", "head_top"]
    np.testing.assert_array_equal(targets.position[:2, 0], [(0, 0, 2), (3, 3, 3)])
    np.testing.assert_array_equal(targets.position_weight, [(1, 0), (1, 0), (0, 0)])
    np.testing.assert_array_equal(targets.turn_weight, [(0, 0.3), (0, 0), (0, 0.3)])
    np.testing.assert_array_equal(targets.contact, [(True, False), (False, False), (False, False)])
    np.testing.assert_allclose(targets.matrix[2, 1], turn.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(targets.quat[0, 0], (1, 0, 0, 0))
    part = targets.at(np.array((2, 0)))
    np.testing.assert_array_equal(part.frames, (9, 2))
    np.testing.assert_array_equal(part.turn_weight, [(0, 0.3), (0, 0.3)])
    one = targets.columns(np.array((False, True)))
    assert one.sites.tolist() == targets.sites[1:].tolist() and one.matrix.shape == (3, 1, 3, 3)


def test_lay_out_of_what_is_not_there() -> None:
    model = humanoid()
    late = SiteConstraint("left_foot", np.arange(8, 12), np.array((0, 0, 0)))
    with pytest.raises(ConstraintError, match=r"left_foot.*10, 11") as caught:
        lay_out([late], model, 10)
    assert caught.value.frames == (10, 11)
    with pytest.raises(ModelError, match="no_such"):
        lay_out([SiteConstraint("no_such", np.array((1,)), np.array((0, 0, 0)))], model, 10)
    nothing = lay_out([], model, 10)
    assert len(nothing.frames) == 0 and len(nothing.sites) == 0
