"""The built-in sneaking: crouched, careful, on its toes first, and a gait like the walk."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from made_up import humanoid, loop_quats, loop_sites, mixed

from mjmotion.body.motion import Motion
from mjmotion.clips import load_clip
from mjmotion.clips.sneak import KNEE, SPEED, STRIDE, make_sneak
from mjmotion.exceptions import ClipError, ModelError
from mjmotion.footsteps.contacts import detect_contacts
from mjmotion.numerics.rotations import rotate
from mjmotion.numerics.tangent import ominus
from mjmotion.validation.figures import joint_jerk_ratio

TOES = 0.077  # from the ball to the tip of the toes [m]


@pytest.fixture(scope="module")
def sneak() -> Motion:
    return make_sneak(humanoid())


@pytest.fixture(scope="module")
def places(sneak: Motion) -> dict[str, np.ndarray]:
    sites = loop_sites(sneak.model, sneak.qpos)
    return {sneak.model.site(i).name: sites[:, i] for i in range(sneak.model.nsite)}


def test_it_is_built_in(sneak: Motion) -> None:
    assert np.allclose(load_clip("sneak").qpos, sneak.qpos, atol=1e-9)


def test_knees_stay_bent_and_the_pelvis_low(sneak: Motion) -> None:
    walk = load_clip("straight")
    for side in ("left", "right"):
        knee = sneak.qpos[:, sneak.model.joint(f"{side}_knee").qposadr[0]]
        assert knee.min() > KNEE - np.deg2rad(1.0)
    assert sneak.qpos[:, 2].max() < walk.qpos[:, 2].min() - 0.08


def test_the_trunk_leans_and_the_face_looks_ahead(
    sneak: Motion, places: dict[str, np.ndarray]
) -> None:
    shoulders = rotate(sneak.qpos[:, 3:7], np.array((0.0, 0.0, 1.0)))
    assert np.rad2deg(np.arctan2(shoulders[:, 0], shoulders[:, 2])).min() > 10.0  # the pelvis
    lean = places["head_top"] - places["pelvis"]
    assert np.rad2deg(np.arctan2(lean[:, 0], lean[:, 2])).min() > 20.0
    gaze = rotate(loop_quats(sneak.model, sneak.qpos, "face"), np.array((1.0, 0.0, 0.0)))
    assert np.abs(np.rad2deg(np.arcsin(gaze[:, 2]))).max() < 20.0


def test_hands_are_held_before_the_body(places: dict[str, np.ndarray]) -> None:
    for side in ("left", "right"):
        ahead = places[f"{side}_hand"] - places["pelvis"]
        assert ahead[:, 0].min() > 0.2 and ahead[:, 2].min() > -0.05


def test_feet_are_lifted_high_and_land_toes_first(
    sneak: Motion, places: dict[str, np.ndarray]
) -> None:
    contacts = detect_contacts(sneak)
    for side in ("left", "right"):
        assert places[f"{side}_heel"][:, 2].max() > 0.2
        assert places[f"{side}_toe"][:, 2].max() > 0.12
        for toe in (c for c in contacts if c.site == f"{side}_toe" and c.start > 0):
            heel = [c for c in contacts if c.site == f"{side}_heel" and c.end > toe.start]
            if heel:
                assert heel[0].start > toe.start


def test_it_is_slow_and_goes_where_its_speed_says(sneak: Motion) -> None:
    count = round(2 * STRIDE / SPEED * sneak.fps)
    way = sneak.qpos[count, 0] - sneak.qpos[0, 0]
    assert way == pytest.approx(count / sneak.fps * SPEED, abs=0.02)
    assert np.linalg.norm(np.diff(sneak.qpos[:, :2], axis=0), axis=1).max() * sneak.fps < 0.75


def test_a_stride_ends_as_it_begins() -> None:
    period = 1.6
    motion = make_sneak(humanoid(), strides=3.0, stride=0.8, speed=0.5)
    count = round(period * motion.fps)
    moved = ominus(motion.model, motion.qpos[count : 2 * count], motion.qpos[:count])
    moved[:, 0] -= 0.8
    assert np.abs(moved).max() < 2e-3  # the first is a millimetre lower, being the first


def test_the_right_side_does_what_the_left_did_half_a_stride_before() -> None:
    motion = make_sneak(humanoid(), strides=3.0, stride=0.8, speed=0.5)
    sites = loop_sites(motion.model, motion.qpos)
    left, right = (motion.model.site(f"{side}_toe").id for side in ("left", "right"))
    later = sites[24:120, right] - (0.4, 0.0, 0.0)
    assert np.abs(later - sites[:96, left] * (1.0, -1.0, 1.0)).max() < 1e-6


def test_it_is_the_same_at_any_rate() -> None:
    slow, fast = (make_sneak(humanoid(), strides=1.0, fps=fps) for fps in (30.0, 120.0))
    assert np.abs(ominus(slow.model, fast.qpos[::4][: slow.nframe], slow.qpos)).max() < 1e-9


def test_it_is_within_limits_and_smoother_than_the_walk(sneak: Motion) -> None:
    assert sneak.character.limits.excess(sneak.qpos).max(initial=0.0) < 1e-9
    assert joint_jerk_ratio(sneak, [load_clip("straight")]) < 0.5


@pytest.mark.parametrize(
    ("settings", "word"),
    [
        ({"stride": 2.0}, "stride"),
        ({"speed": 3.0}, "speed"),
        ({"stride": 0.5, "speed": 0.9}, "seconds a stride"),
        ({"strides": 0.3}, "multiple of 0.5"),
        ({"fps": 0.0}, "fps"),
    ],
)
def test_what_makes_no_sneaking_is_refused(settings: dict[str, float], word: str) -> None:
    with pytest.raises(ClipError, match=word):
        make_sneak(humanoid(), **settings)


def test_it_needs_the_humanoid() -> None:
    with pytest.raises(ModelError, match="humanoid"):
        make_sneak(mixed())


def test_balance(sneak: Motion) -> None:
    """The centre of mass stays over the feet's length, as it must in something so slow."""
    model, data = sneak.model, mujoco.MjData(sneak.model)
    sites = loop_sites(model, sneak.qpos)
    feet = [
        model.site(f"{side}_{part}").id for side in ("left", "right") for part in ("heel", "toe")
    ]
    for frame in range(0, sneak.nframe, 5):
        data.qpos[:] = sneak.qpos[frame]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        centre = data.subtree_com[model.jnt_bodyid[0], 0]
        down = [sites[frame, foot, 0] for foot in feet if sites[frame, foot, 2] < 0.12]
        assert min(down) - 0.05 < centre < max(down) + TOES + 0.05
