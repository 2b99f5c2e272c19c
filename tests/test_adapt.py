"""The whole of an adaptation, small: a made-up walk on grounds, through doors, with wishes."""

from __future__ import annotations

import functools
import itertools
import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
from made_up import character, humanoid, loop_sites, some, walk

from mjmotion.apps.adaptation import adapt, stiff_root
from mjmotion.apps.edit import edit_frame
from mjmotion.apps.retarget import leg_ratio
from mjmotion.body.character import Character
from mjmotion.body.kinematics import character_geoms
from mjmotion.body.motion import Motion
from mjmotion.body.proportions import Proportions, make_character
from mjmotion.clips import load_clip
from mjmotion.constraints import SiteConstraint
from mjmotion.exceptions import (
    ClipError,
    ConstraintError,
    ContactError,
    FitError,
    ModelError,
    SceneError,
)
from mjmotion.footsteps.contacts import Contact, detect_contacts
from mjmotion.footsteps.planning import make_plan, place
from mjmotion.footsteps.settings import PlanSettings
from mjmotion.ik.solver import default_rigidity
from mjmotion.numerics.tangent import ominus
from mjmotion.output.result import Result
from mjmotion.scene import (
    Doorway,
    Scene,
    compose,
    doors,
    flat,
    load_scene,
    save_model,
    slope,
    stairs,
)

DRIFT = 1e-3  # of a contact's site over its contact [m]
GAP = 2e-3  # of a contact's site over planes and steps [m]
LIMIT = 1e-4  # [rad]


@functools.cache
def clip() -> Motion:
    return walk(3.6)


SCENES = {
    "flat": lambda: Scene.from_spec(flat(), "flat"),
    "slope": lambda: Scene.from_spec(slope(angle=7.0, distance=0.4, length=2.0), "slope"),
    "stairs": lambda: Scene.from_spec(stairs(steps=2, rise=0.1, tread=0.5, distance=0.5), "stairs"),
    "doors": lambda: Scene.from_spec(doors((Doorway(x=0.9, height=1.66, width=1.2),), base=flat())),
}


@functools.cache
def scene(name: str) -> Scene:
    return SCENES[name]()


@functools.cache
def adapted(name: str, ik: str = "hybrid") -> Result:
    return adapt(clip(), scene(name), ik=ik)


def drift_and_gap(result: Result, where: Scene) -> tuple[float, float]:
    """Largest drift of a contact's site, and height over the ground, from MuJoCo itself [m]."""
    sites, ground = loop_sites(result.motion.model, result.motion.qpos), where.ground
    drift, gap = 0.0, 0.0
    for contact in result.contacts:
        site = result.motion.model.site(contact.site).id
        points = sites[contact.start : contact.end, site]
        drift = max(drift, float(np.linalg.norm(points - points.mean(axis=0), axis=1).max()))
        gap = max(gap, float(np.abs(points[:, 2] - ground.under(points)[0]).max()))
    return drift, gap


@pytest.mark.parametrize("name", sorted(SCENES))
def test_contacts_hold_and_limits_are_kept(name: str) -> None:
    result = adapted(name)
    drift, gap = drift_and_gap(result, scene(name))
    assert drift < DRIFT and gap < GAP
    assert result.motion.character.limits.excess(result.motion.qpos).max() < LIMIT
    assert len(result.contacts) >= 8 and result.unmet == ()
    assert result.motion.nframe == result.source.nframe == clip().nframe
    assert result.motion.fps == result.source.fps == 30.0


@pytest.mark.parametrize("name", sorted(SCENES))
def test_motions_are_on_the_composed_model(name: str) -> None:
    result = adapted(name)
    model = result.motion.character.spec.copy().compile()
    assert model.ngeom > humanoid().ngeom
    for motion in (result.source, result.motion):
        assert motion.model.nq == model.nq == humanoid().nq
        assert motion.model.ngeom == model.ngeom
    expected = place(clip(), scene(name))
    np.testing.assert_array_equal(result.source.qpos, expected.qpos)


def test_on_level_ground_little_changes() -> None:
    """The root stays to a few millimetres, the joints to a few degrees, the head altogether."""
    result = adapted("flat")
    moved = ominus(humanoid(), result.motion.qpos, result.source.qpos)
    assert np.abs(moved[:, :3]).max() < 0.01  # [m]
    assert np.abs(moved[:, 3:]).max() < 0.2  # [rad], where swings are lifted
    assert np.median(np.abs(moved).max(axis=1)) < 0.06
    upper = np.concatenate(
        [humanoid().joint(n).dofadr[0] + np.arange(3) for n in ("neck", "head", "left_shoulder")]
    )
    assert (moved[:, upper] == 0.0).all()


def test_both_solvers_agree() -> None:
    one, other = adapted("slope"), adapted("slope", "numeric")
    apart = ominus(humanoid(), one.motion.qpos, other.motion.qpos)
    assert np.abs(apart[:, :3]).max() < 0.02  # [m]
    assert np.abs(apart).max() < 0.15 and np.abs(apart).mean() < 0.01  # [rad]
    drift, gap = drift_and_gap(other, scene("slope"))
    assert drift < DRIFT and gap < GAP


def test_on_a_slope_the_root_climbs_with_the_ground() -> None:
    result = adapted("slope")
    source, motion = result.source.qpos, result.motion.qpos
    ramp = np.tan(np.radians(7.0)) * np.clip(source[:, 0] - 0.4, 0.0, 2.0)
    np.testing.assert_allclose(motion[:, 2] - source[:, 2], ramp, atol=0.05)
    assert np.ptp(motion[:, 0]) == pytest.approx(np.ptp(source[:, 0]), rel=0.03)


def test_the_trace_tells_the_levels() -> None:
    trace = some(adapted("slope").trace)
    assert [one.frames_per_knot for one in trace.levels][:4] == [16, 8, 4, 2]
    errors = [one.max_error_percent for one in trace.levels]
    assert errors[-1] < errors[0] and trace.exact_error_percent < 0.1
    assert trace.fit_seconds > 0.0 and trace.nscalar == 12 * clip().nframe


def body_in_solids(result: Result) -> float:
    """How deep any geom but the feet's is in any box of the scene, by mj_geomDistance [m]."""
    model = result.motion.model
    data = mujoco.MjData(model)
    feet = {model.body(f"{side}_foot").id for side in ("left", "right")}
    mine = [g for g in character_geoms(model, colliding=True) if model.geom_bodyid[g] not in feet]
    solid = np.flatnonzero(
        (model.geom_type == mujoco.mjtGeom.mjGEOM_BOX) & (model.geom_contype > 0)
    )
    boxes = [b for b in solid if model.body_weldid[model.geom_bodyid[b]] == 0]
    depth = 0.0
    for pose in result.motion.qpos:
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        for box in boxes:
            near = np.linalg.norm(data.geom_xpos[mine] - data.geom_xpos[box], axis=1)
            for geom in np.array(mine)[near < model.geom_rbound[box] + 0.3]:
                distance = mujoco.mj_geomDistance(model, data, int(geom), int(box), 0.1, None)
                depth = max(depth, -distance)
    return depth


def test_it_ducks_under_a_low_door() -> None:
    result = adapted("doors")
    assert body_in_solids(result) == 0.0
    source, motion = (
        loop_sites(m.model, m.qpos)[:, m.model.site("head_top").id]
        for m in (result.source, result.motion)
    )
    under = np.abs(source[:, 0] - 0.9) < 0.06
    away = np.abs(source[:, 0] - 0.9) > 1.0
    assert under.any() and motion[under, 2].max() < 1.66
    assert source[under, 2].min() > 1.66 - 0.03
    if away.any():
        assert np.abs(motion[away, 2] - source[away, 2]).max() < 0.03
    # It goes on walking: the way through is not a way around.
    assert np.ptp(result.motion.qpos[:, 0]) == pytest.approx(
        np.ptp(result.source.qpos[:, 0]), rel=0.03
    )
    assert np.abs(result.motion.qpos[:, 1] - result.source.qpos[:, 1]).max() < 0.1


@pytest.mark.parametrize(
    "door", [Doorway(x=0.9, height=0.9, width=1.2), Doorway(x=0.9, height=2.1, width=0.22)]
)
def test_doors_that_cannot_be_passed(door: Doorway) -> None:
    """The nearest is returned and says what bars it; nothing is, if that is asked for."""
    scene = Scene.from_spec(doors((door,), base=flat()))
    result = adapt(clip(), scene, planning=PlanSettings(path="keep"))
    assert result.barred.startswith("there is no way: ") and "door1_" in result.barred
    assert result.barred in result.report().notes
    strict = PlanSettings(path="keep", strict=True)
    with pytest.raises(SceneError, match="there is no way") as caught:
        adapt(clip(), scene, planning=strict)
    assert "\n" not in str(caught.value)


def platform(length: float, away: float = 0.0) -> Scene:
    """A box that ends so far ahead of the start, and nothing else."""
    half = 0.5 * (length + 0.5)
    box = f'<geom type="box" size="{half} .5 .1" pos="{half - 0.5} {away} -.1"/>'
    return Scene.from_spec(
        mujoco.MjSpec.from_string(f"<mujoco><worldbody>{box}</worldbody></mujoco>")
    )


def test_no_ground_under_the_walk() -> None:
    with pytest.raises(SceneError, match="no ground under the walk"):
        adapt(clip(), platform(0.5, away=5.0))


def test_a_walk_whose_ground_ends_is_told_where() -> None:
    """It stays on the ground with shorter steps, does not get where it was to go, and says so."""
    result = adapt(clip(), platform(0.5))
    assert result.plan is not None
    assert max(one.position[0] for one in result.plan.footholds) < 0.5
    assert result.motion.qpos[-1, 0] < 0.5 < result.source.qpos[-1, 0] - 0.5
    said = re.fullmatch(
        r"there is no way: a gap bars it at x=(.+), y=.+, by (\d+) cm", result.barred
    )
    assert said is not None
    grid = 0.15  # ground is looked at every 0.1 m, the line every 0.05 m
    assert float(said[1]) == pytest.approx(0.5, abs=grid)
    assert float(said[2]) / 100 == pytest.approx(result.source.qpos[-1, 0] - 0.5, abs=grid)
    assert result.barred in result.report().notes
    with pytest.raises(SceneError, match="there is no way: a gap"):
        adapt(clip(), platform(0.5), planning=PlanSettings(strict=True))
    assert adapt(clip(), platform(2.0)).barred == ""


def test_the_scenes_start_turns_and_moves_the_walk() -> None:
    spec = flat()
    for site in spec.sites:
        if site.name == "start":
            site.pos, site.quat = (2.0, -1.0, 0.0), (np.cos(0.6), 0.0, 0.0, np.sin(0.6))
    there = Scene.from_spec(spec)
    placed = place(clip(), there)
    way = placed.qpos[-1, :2] - placed.qpos[0, :2]
    assert np.arctan2(way[1], way[0]) == pytest.approx(1.2, abs=0.01)
    np.testing.assert_allclose(placed.qpos[0, :2], (2.0, -1.0), atol=0.01)
    result = adapt(clip(), there)
    assert drift_and_gap(result, there)[0] < DRIFT
    moved = ominus(humanoid(), result.motion.qpos, result.source.qpos)
    flat_moved = ominus(humanoid(), adapted("flat").motion.qpos, adapted("flat").source.qpos)
    np.testing.assert_allclose(moved[:, 6:], flat_moved[:, 6:], atol=5e-3)


def test_wishes_of_the_users() -> None:
    """A hand on a rail for a while, on top of what the ground asks."""
    sites = loop_sites(humanoid(), clip().qpos)
    frames = np.arange(50, 60)
    start = sites[frames, humanoid().site("left_hand").id] + (0.05, 0.1, 0.25)
    rail = SiteConstraint("left_hand", frames, start)
    result = adapt(clip(), scene("flat"), constraints=[rail])
    found = loop_sites(result.motion.model, result.motion.qpos)
    site = result.motion.model.site("left_hand").id
    assert np.linalg.norm(found[frames, site] - start, axis=1).max() < 1e-3
    assert drift_and_gap(result, scene("flat"))[0] < DRIFT
    away = np.abs(ominus(humanoid(), result.motion.qpos, adapted("flat").motion.qpos)).max(axis=1)
    assert away[55] > 0.1 and away[[0, 108]].max() < 0.01


def test_wishes_out_of_reach_are_reported() -> None:
    far = SiteConstraint("right_hand", np.arange(40, 44), np.array((0.4, -0.2, 4.0)))
    result = adapt(clip(), scene("flat"), constraints=[far])
    (unmet,) = [one for one in result.unmet if "right_hand" in one.constraint]
    assert unmet.frames == (40, 41, 42, 43) and some(unmet.residual_mm) > 1000.0
    other = SiteConstraint("left_hand", np.arange(40, 42), np.array((0.4, 0.2, 4.0)))
    both = adapt(clip(), scene("flat"), constraints=[other, far]).unmet
    own = [(one.constraint, one.index) for one in both if one.source == "user"]
    assert own == [("position of left_hand", 0), ("position of right_hand", 1)]
    with pytest.raises(ConstraintError):
        adapt(
            clip(),
            scene("flat"),
            constraints=[SiteConstraint("face", np.array((999,)), np.array((0, 0, 1)))],
        )


def test_contacts_of_the_users() -> None:
    found = detect_contacts(clip())
    own = tuple(Contact(c.site, c.start + 1, c.end - 1) for c in found if c.end - c.start > 6)
    result = adapt(clip(), scene("slope"), contacts=own[::-1])
    # What is left of the given contacts: where an ankle has to give, the heel rises sooner.
    for contact in result.contacts:
        spans = [(c.start, c.end) for c in own if c.site == contact.site]
        assert any(a <= contact.start and contact.end <= b for a, b in spans)
    assert {c.site for c in result.contacts} == {c.site for c in own}
    assert drift_and_gap(result, scene("slope"))[0] < DRIFT
    with pytest.raises(ContactError, match="109 frames"):
        adapt(clip(), scene("flat"), contacts=(Contact("left_toe", 0, 500),))
    with pytest.raises(ContactError, match="no contacts"):
        adapt(clip(), scene("flat"), contacts=())


def test_bad_settings() -> None:
    with pytest.raises(FitError, match="IK solver"):
        adapt(clip(), scene("flat"), ik="newton")
    with pytest.raises(FitError, match="levels"):
        adapt(clip(), scene("flat"), levels=())


def test_the_plan_and_its_parts() -> None:
    what = make_plan(clip(), scene("doors"))
    assert {o.name for o in what.obstacles if o.tall}
    assert what.root_shift.shape == (clip().nframe, 3)
    assert [c.site for c in what.constraints()] == ["left_foot", "right_foot"]
    assert make_plan(clip(), scene("flat")).obstacles == ()
    told: list[tuple[str, int, int]] = []
    adapt(clip(), scene("doors"), progress=lambda *what: told.append(what))
    stages = [stage for stage, _ in itertools.groupby(stage for stage, _, _ in told)]
    assert stages == ["contacts and footholds", "fit", "clearances", "fit"]
    assert all(0 <= done <= of for _, done, of in told)
    assert [done for stage, done, _ in told if stage == "fit"][-1] > 0
    stiffer = stiff_root(character()) / default_rigidity(humanoid())
    assert (stiffer[:6] > 1.0).all() and (stiffer[6:] == 1.0).all()


def test_arguments_stay() -> None:
    """Neither motion nor character nor scene is changed, and the same asked again is the same."""
    before, there = clip(), scene("slope")
    kept = before.qpos.copy()
    specs = [one.spec.to_xml() for one in (before.character, there)]
    sizes = before.model.ngeom, there.model.ngeom
    again = adapt(before, there)
    np.testing.assert_array_equal(before.qpos, kept)
    assert before.character is character() and before.character.alone
    assert [one.spec.to_xml() for one in (before.character, there)] == specs
    assert (before.model.ngeom, there.model.ngeom) == sizes
    np.testing.assert_array_equal(again.motion.qpos, adapted("slope").motion.qpos)
    with pytest.raises(ValueError, match="read-only"):
        again.motion.qpos[0, 0] = 1.0


# Whose motion it is


@functools.cache
def tall() -> Character:
    return make_character("humanoid", Proportions(legs=1.2))


def test_a_motion_stays_on_the_body_it_is_on() -> None:
    """A walk on longer legs is fitted with longer legs, without anyone naming the body again."""
    steps = load_clip("walk")
    steps = steps.replace(steps.qpos[:110])
    walk_on_tall = carried(steps, tall())
    result = adapt(walk_on_tall, "flat")
    body = result.motion.character
    assert body.different_from(tall()) == ""
    assert body.different_from(character()) != ""
    shank = body.model.body("left_shank").id
    np.testing.assert_allclose(
        body.model.body_pos[shank], 1.2 * humanoid().body_pos[humanoid().body("left_shank").id]
    )
    figures = result.validate()
    assert figures.metrics["stance_drift_mm"] < 1.0 and figures.broken() == []
    assert result.unmet == ()
    drift, gap = drift_and_gap(result, load_scene("flat"))
    assert drift < DRIFT and gap < GAP


def carried(motion: Motion, character: Character) -> Motion:
    """Joint angles as they are, the root as much higher and further as the legs are longer."""
    qpos = np.array(motion.qpos)
    qpos[:, :3] *= leg_ratio(motion.character, character)
    return Motion(character, qpos, motion.fps)


def test_a_motion_cannot_end_up_on_another_body() -> None:
    for other in (character(), "humanoid", humanoid()):
        with pytest.raises(ModelError, match=r"is another body than .* retarget") as caught:
            carried(clip(), tall()).on(other)
        assert "\n" not in str(caught.value)
    with pytest.raises(ModelError, match="is another body than"):
        clip().on(compose(tall(), "flat"))
    # The same body is the same, however it was come by.
    assert clip().on("humanoid").character is not clip().character
    again = carried(clip(), tall()).on(make_character("humanoid", Proportions(legs=1.2)))
    np.testing.assert_array_equal(again.qpos, carried(clip(), tall()).qpos)


def test_an_edit_leaves_the_result_that_it_is_made_from() -> None:
    before = adapted("stairs")
    kept, model = before.motion.qpos.copy(), before.motion.model
    spec = before.motion.character.spec.to_xml()
    edited = edit_frame(before.motion, 50, "left_hand", by=(0.1, 0.0, 0.2), levels=(4, 2))
    assert edited.source.qpos.tobytes() == kept.tobytes() == before.motion.qpos.tobytes()
    assert before.motion.model is model and before.motion.character.spec.to_xml() == spec
    assert edited.motion.character is before.motion.character  # it has its ground already
    moved = np.flatnonzero((edited.motion.qpos != kept).any(axis=1))
    assert (moved[0], moved[-1]) == (39, 61)


@pytest.mark.parametrize("name", ["doors", "slope"])
def test_a_result_is_adapted_to_another_scene(name: str) -> None:
    """It comes in its scene, which is left behind: nothing of it is in the new one."""
    before = adapted(name)
    result = adapt(before.motion, scene("stairs"))
    models = [compose(character(), scene(one)).model for one in ("stairs", name)]
    there, here = (np.hstack((m.geom_type[:, None], m.geom_size, m.geom_pos)) for m in models)
    model = result.motion.model
    mine = np.hstack((model.geom_type[:, None], model.geom_size, model.geom_pos))
    np.testing.assert_array_equal(mine, there)
    assert not np.array_equal(mine, here)
    placed = place(before.motion, scene("stairs"))
    np.testing.assert_array_equal(result.source.qpos, placed.qpos)
    assert result.validate().metrics["stance_drift_mm"] < 1.0
    drift, _ = drift_and_gap(result, scene("stairs"))
    assert drift < DRIFT
    assert before.motion.model.ngeom == len(here)  # the argument is as it was


def test_names_and_files_do_in_place_of_things(tmp_path: Path) -> None:
    by_name = adapt("straight", "slope", levels=(8, 2))
    by_hand = adapt(load_clip("straight"), load_scene("slope"), levels=(8, 2))
    np.testing.assert_array_equal(by_name.motion.qpos, by_hand.motion.qpos)
    assert by_name.contacts == by_hand.contacts
    assert by_name.motion.character.name == "humanoid"
    load_clip("straight").save(tmp_path / "clip.npz")
    save_model(load_scene("slope").spec, tmp_path, "scene.xml")
    by_file = adapt(tmp_path / "clip.npz", tmp_path / "scene.xml", levels=(8, 2))
    np.testing.assert_allclose(by_file.motion.qpos, by_hand.motion.qpos, atol=1e-9)
    for wrong, error, said in (
        (("straigth", "slope"), ClipError, "Did you mean 'straight'"),
        (("straight", "slop"), SceneError, "Did you mean 'slope'"),
        ((tmp_path / "none.npz", "slope"), ClipError, "none.npz"),
        (("straight", tmp_path / "none.xml"), SceneError, "none.xml"),
    ):
        with pytest.raises(error, match=said):
            adapt(*wrong)


def test_a_body_without_its_mjcf_cannot_be_put_into_a_scene() -> None:
    bare = Motion(humanoid(), clip().qpos, 30.0)
    with pytest.raises(ModelError, match=r"without its MJCF: use Character\.load"):
        adapt(bare, scene("flat"))


def test_the_shipped_terrain() -> None:
    """On a heightfield: contacts hold, and the soles are on the ground to a centimetre."""
    where = load_scene("terrain")
    result = adapt(clip(), where)
    drift, gap = drift_and_gap(result, where)
    assert drift < DRIFT and gap < 0.03  # [m]
    assert result.motion.character.limits.excess(result.motion.qpos).max() < LIMIT
