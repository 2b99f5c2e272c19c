"""A motion and the body that it is on: the same body elsewhere is taken, another is refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest
from made_up import character, mixed, walk

from mjmotion.body.character import Character
from mjmotion.body.motion import Motion
from mjmotion.body.proportions import Proportions, make_character
from mjmotion.exceptions import ModelError
from mjmotion.scene import compose, without_scene
from mjmotion.scene.save import save_model

Change = Callable[[mujoco.MjSpec], object]


@pytest.fixture(scope="module")
def motion() -> Motion:
    return walk(0.5)


def changed(change: Change) -> Character:
    """The humanoid with something else about it."""
    spec = character().spec.copy()
    change(spec)
    return Character.load(spec)


@pytest.mark.parametrize("scene", ["flat", "terrain", "terrain_doors"])
def test_the_same_body_in_a_scene_is_taken(motion: Motion, scene: str) -> None:
    composed = compose(motion.character, scene)
    there = motion.on(composed)
    assert there.character is composed and there.model is composed.model
    assert there.fps == motion.fps
    np.testing.assert_array_equal(there.qpos, motion.qpos)
    back = there.on(without_scene(composed))
    assert back.character.alone
    np.testing.assert_array_equal(back.qpos, motion.qpos)
    np.testing.assert_array_equal(there.on("humanoid").qpos, motion.qpos)


def _set(kind: str, name: str, field: str, value: object) -> Change:
    return lambda spec: setattr(getattr(spec, kind)(name), field, value)


def _geom(body: str, field: str, value: object) -> Change:
    """Of the first geom of a body: the sphere of a heel, the capsule of the neck, else a mesh."""
    return lambda spec: setattr(spec.body(body).geoms[0], field, value)


def _ellipsoid_heel(spec: mujoco.MjSpec) -> None:
    heel = spec.body("left_foot").geoms[0]
    heel.type, heel.size = mujoco.mjtGeom.mjGEOM_ELLIPSOID, 3 * [heel.size[0]]


def _more(field: str, step: tuple[float, ...], body: str = "left_shank") -> Change:
    def change(spec: mujoco.MjSpec) -> None:
        one = spec.body(body)
        setattr(one, field, np.array(getattr(one, field)) + step)

    return change


SAME: dict[str, Change] = {
    "nothing": lambda spec: None,
    "its name": lambda spec: setattr(spec, "modelname", "somebody"),
    "where it stands at rest": _more("pos", (0.0, 3.0, 0.5), "pelvis"),
    "how it stands at rest": _set("body", "pelvis", "quat", (0.6, 0.0, 0.0, 0.8)),
    "a colour": _geom("left_shank", "rgba", (1.0, 0.0, 0.0, 1.0)),
    "a mass": _geom("left_shank", "density", 500.0),
    "a friction": _geom("left_foot", "friction", (2.0, 0.1, 0.1)),
    "a bone by less than rounding": _more("pos", (0.0, 0.0, 1e-8)),
    "the other sign of a turn": _set("body", "left_shank", "quat", (-1.0, 0.0, 0.0, 0.0)),
    "a ball in the world": lambda spec: spec.worldbody.add_geom(size=(0.1, 0, 0)),
    "another body in the world": lambda spec: spec.worldbody.add_body(
        name="thing", pos=(3, 0, 0)
    ).add_geom(size=(0.1, 0, 0)),
}


@pytest.mark.parametrize("case", sorted(SAME))
def test_what_is_not_of_the_body_may_differ(motion: Motion, case: str) -> None:
    other = changed(SAME[case])
    assert motion.character.different_from(other) == ""
    there = motion.on(other)
    assert there.character is other
    np.testing.assert_array_equal(there.qpos, motion.qpos)


OTHER: dict[str, tuple[Change, str]] = {
    "a longer bone": (_more("pos", (0.0, 0.0, -0.01)), "other sizes of bodies: left_shank"),
    "a bone of a tenth of a millimetre more": (
        _more("pos", (0.0, 0.0, -1e-4)),
        "other sizes of bodies: left_shank",
    ),
    "a turned bone": (
        _set("body", "left_shank", "quat", (0.9950042, 0.0998334, 0.0, 0.0)),
        "other sizes of bodies: left_shank",
    ),
    "an axis": (_set("joint", "left_knee", "axis", (0.0, 0.8, 0.6)), "joints: left_knee"),
    "an anchor": (_set("joint", "left_knee", "pos", (0.0, 0.0, 0.02)), "joints: left_knee"),
    "a sole": (_set("site", "left_toe", "pos", (0.3, 0.0, -0.05)), "sizes of sites: left_toe"),
    "a larger heel": (
        _geom("left_foot", "size", (0.0345, 0.0, 0.0)),
        "sizes of geoms: geom of left_foot of type 2",
    ),
    "a geom elsewhere": (
        _geom("left_foot", "pos", (0.0, 0.0, 0.01)),
        "sizes of geoms: geom of left_foot",
    ),
    "a turned geom": (
        lambda spec: setattr(spec.body("left_hand").geoms[1], "quat", (0.6, 0.8, 0.0, 0.0)),
        "sizes of geoms: geom of left_hand",
    ),
    "another shape as large": (_ellipsoid_heel, "other geoms"),
    "a geom more": (
        lambda spec: spec.body("left_hand").add_geom(size=(0.2, 0, 0)),
        "other geoms",
    ),
    "a geom less": (lambda spec: spec.delete(spec.body("left_shank").geoms[0]), "other geoms"),
    "a site more": (lambda spec: spec.body("left_hand").add_site(name="grip"), "other sites"),
    "a body more": (
        lambda spec: spec.body("left_hand").add_body(name="glove").add_geom(size=(0.02, 0, 0)),
        "other bodies",
    ),
}


@pytest.mark.parametrize("case", sorted(OTHER))
def test_another_body_is_refused(motion: Motion, case: str) -> None:
    """Joints and all names may be the same: what is drawn or touches the ground is not."""
    change, said = OTHER[case]
    other = changed(change)
    with pytest.raises(ModelError, match=f"is another body than .*{said}") as caught:
        motion.on(other)
    assert "retarget" in str(caught.value) and "\n" not in str(caught.value)
    # In a scene it is no less another one, and it is so either way round.
    with pytest.raises(ModelError, match="is another body than"):
        motion.on(compose(other, "flat"))
    with pytest.raises(ModelError, match="is another body than"):
        Motion(other, motion.qpos, motion.fps).on(motion.character)


@pytest.mark.parametrize("factors", [Proportions(legs=1.1), Proportions(torso=0.9)])
def test_other_proportions_are_another_body(motion: Motion, factors: Proportions) -> None:
    with pytest.raises(
        ModelError, match=r"is another body than 'humanoid' \(other sizes of .*more"
    ):
        motion.on(make_character("humanoid", factors))
    with pytest.raises(ModelError, match="is another body than 'humanoid'"):
        motion.on("child")


def test_other_joints_are_told_as_such(motion: Motion) -> None:
    for other in (Character.of(mixed()), "humanoid_flexible"):
        with pytest.raises(ModelError, match="different joints: retarget"):
            motion.on(other)


def test_a_half_turn_is_one_turn_whatever_its_sign() -> None:
    """Rounding gives its quaternion one sign or the other: no other body for that."""
    text = """<mujoco><worldbody><body name="a"><freejoint/><geom size=".1"/>
      <body name="b" quat="{}"><joint name="j"/><geom size=".1"/></body></body>
      </worldbody></mujoco>"""
    one, other = (
        Character.of(mujoco.MjModel.from_xml_string(text.format(quat)))
        for quat in ("1e-12 1 0 0", "-1e-12 1 0 0")
    )
    assert one.different_from(other) == other.different_from(one) == ""


@pytest.mark.parametrize("name", ["humanoid", "child", "humanoid_flexible"])
def test_a_body_written_with_its_scene_is_the_same_when_read_again(
    name: str, tmp_path: Path
) -> None:
    """Numbers are rounded in a file, meshes are written anew: no other body for that."""
    body = Character.load(name)
    again = Character.load(save_model(compose(body, "flat").spec, tmp_path / "out"))
    assert body.different_from(again) == again.different_from(body) == ""
