"""Steps are chosen together: stones, a gap, treads; their pace; the bend that goes with them."""

from __future__ import annotations

import dataclasses
from functools import cache
from itertools import pairwise

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from mjmotion.body.character import Character
from mjmotion.body.kinematics import Kinematics
from mjmotion.body.motion import Motion
from mjmotion.clips import load_clip
from mjmotion.exceptions import FitError, SceneError
from mjmotion.footsteps.chain import Chain, find_chain
from mjmotion.footsteps.changes import changes
from mjmotion.footsteps.contacts import Contact, detect_contacts
from mjmotion.footsteps.footholds import Foothold
from mjmotion.footsteps.pace import Pace, find_pace
from mjmotion.footsteps.plan import Plan
from mjmotion.footsteps.planning import make_plan
from mjmotion.footsteps.settings import PlanSettings
from mjmotion.footsteps.spots import Spots
from mjmotion.footsteps.stances import Stance, find_stances
from mjmotion.footsteps.steps import bend_along, choose_footholds, loose_ends
from mjmotion.footsteps.way import Way
from mjmotion.scene import Scene
from mjmotion.scene.ground import Ground

Array = NDArray[np.float64]

LENGTH = 0.6  # of a step of the made-up walk [m]
WIDTH = 0.2  # between its feet [m]
NEAR = 0.03  # a spot on a grid of 2 cm is this near to where it should be [m]


@cache
def character() -> Character:
    return Character.of("humanoid")


def boxes(*tops: tuple[float, float, float, float, float], start: float = 0.0) -> Scene:
    """Return a floor with boxes from x to x, y to y, of some height [m]."""
    spec = mujoco.MjSpec()
    spec.worldbody.add_site(name="start", pos=(0.0, 0.0, start))
    spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=(20.0, 20.0, 1.0))
    for number, (x0, x1, y0, y1, height) in enumerate(tops):
        spec.worldbody.add_geom(
            name=f"box{number}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=(0.5 * (x0 + x1), 0.5 * (y0 + y1), 0.5 * height),
            size=(0.5 * (x1 - x0), 0.5 * (y1 - y0), 0.5 * height),
        )
    return Scene.from_spec(spec)


def walk(count: int, heading: float = 0.0) -> tuple[Stance, ...]:
    """Return stances of a straight walk: right, left, right, …, 20 frames each, 15 apart."""
    made = []
    names = [foot.side for foot in character().feet]
    turn = np.array(((np.cos(heading), -np.sin(heading)), (np.sin(heading), np.cos(heading))))
    for number in range(count):
        side = ("right", "left")[number % 2]
        at = turn @ (LENGTH * number, 0.5 * WIDTH * (1.0 if side == "left" else -1.0))
        start = 15 * number
        quat = np.array((np.cos(0.5 * heading), 0.0, 0.0, np.sin(0.5 * heading)))
        span = (start, start + 20)
        made.append(Stance(names.index(side), span, span, np.array((*at, 0.0)), quat))
    return tuple(made)


def chain(scene: Scene, stances: tuple[Stance, ...], start: float = 0.0) -> Chain:
    return find_chain(stances, character().feet, scene.ground, start)


def test_on_level_ground_every_foot_stays_where_it_is_to_the_bit() -> None:
    stances = walk(9, heading=0.4)
    found = chain(boxes(), stances)
    assert (found.spots == np.array([stance.source_pos[:2] for stance in stances])).all()
    assert not found.turns.any() and not found.costs.any()
    footholds, turns = choose_footholds(stances, character().feet, boxes().ground, 0.0)
    assert turns is None
    for stance, foothold in zip(stances, footholds, strict=True):
        assert (foothold.position[:2] == stance.source_pos[:2]).all()


def test_two_stones_in_water_are_stepped_on_one_foot_each() -> None:
    """Stones where the third and the fourth step would be short: the feet do not step between."""
    bank, far = (-2.0, 0.45, -1.0, 1.0, 0.3), (1.75, 9.0, -2.0, 2.0, 0.3)
    right, left = (0.75, 1.05, -0.3, 0.0, 0.3), (1.25, 1.55, -0.0, 0.3, 0.3)
    found = chain(boxes(bank, far, right, left, start=0.3), walk(7), 0.3)
    on_right = (found.spots[:, 0] > 0.75) & (found.spots[:, 0] < 1.05)
    on_left = (found.spots[:, 0] > 1.25) & (found.spots[:, 0] < 1.55)
    assert on_right.sum() == 1 and on_left.sum() == 1
    assert np.flatnonzero(on_right)[0] % 2 == 0 and np.flatnonzero(on_left)[0] % 2 == 1
    assert found.heights == pytest.approx(0.3)


def test_a_gap_is_stepped_over() -> None:
    """0.3 m of nothing where a foot would stand: it stands before, or behind."""
    before, behind = (-2.0, 1.05, -2.0, 2.0, 0.6), (1.35, 9.0, -2.0, 2.0, 0.6)
    found = chain(boxes(before, behind, start=0.6), walk(6), 0.6)
    feet = character().feet
    for number, spot in enumerate(found.spots):
        sole = feet[walk(6)[number].foot].sole[:2, 0] + spot[0]
        assert sole.max() < 1.05 + 0.08 or sole.min() > 1.35, f"step {number} at {spot}"
    assert found.heights == pytest.approx(0.6)
    assert np.diff(found.spots[:, 0]).min() > 0.2


@pytest.mark.parametrize("rise", [0.17, 0.14])
def test_three_treads_take_three_steps(rise: float) -> None:
    treads = [(1.0 + 0.29 * k, 1.29 + 0.29 * k, -3.0, 3.0, rise * (k + 1)) for k in range(3)]
    top = (1.87, 9.0, -3.0, 3.0, 4.0 * rise)
    found = chain(boxes(*treads, top), walk(9))
    level = np.rint(found.heights / rise).astype(int)
    assert level.max() == 4 and (np.diff(level) <= 1).all() and (np.diff(level) >= 0).all()
    climbing = np.flatnonzero(np.diff(level) == 1)
    assert (np.diff(climbing) == 1).all()
    assert np.diff(found.spots[:, 0])[climbing[1:-1]] == pytest.approx(0.29, abs=2.0 * NEAR)
    # The displacement is carried forward: behind the stairs steps are as long as ever.
    last = np.diff(found.spots[:, 0])[climbing[-1] + 1 :]
    assert last == pytest.approx(LENGTH, abs=0.1)


def test_feet_that_do_not_stand_in_turn_take_no_steps_together() -> None:
    """Of a runner whose one foot alone is seen to stand, stances are flights apart."""
    treads = [(1.0 + 0.29 * k, 1.29 + 0.29 * k, -3.0, 3.0, 0.17 * (k + 1)) for k in range(3)]
    ground = boxes(*treads, (1.87, 9.0, -3.0, 3.0, 0.68)).ground
    stances = walk(9)
    _, together = choose_footholds(stances, character().feet, ground, 0.0)
    footholds, alone = choose_footholds(stances[::2], character().feet, ground, 0.0)
    assert together is not None and alone is None
    for stance, foothold in zip(stances[::2], footholds, strict=True):
        assert np.linalg.norm((foothold.position - stance.source_pos)[:2]) < 0.35


def test_steps_alternate_to_their_own_sides() -> None:
    random = np.random.default_rng(3)
    stones = [
        (0.6 * k + 0.5, 0.6 * k + 0.9, y - 0.17, y + 0.17, 0.3)
        for k, y in enumerate((-1) ** k * -random.uniform(0.08, 0.14) for k in range(8))
    ]
    scene = boxes((-2.0, 0.3, -1.0, 1.0, 0.3), *stones, (5.6, 9.0, -2.0, 2.0, 0.3), start=0.3)
    found = chain(scene, walk(10), 0.3)
    across = np.diff(found.spots[:, 1]) * np.where(np.arange(1, 10) % 2 == 1, 1.0, -1.0)
    assert (across > 0.0).all()
    assert found.heights == pytest.approx(0.3)


def test_what_is_to_be_avoided_is_not_stood_on() -> None:
    carpet = (0.9, 1.5, -0.4, 0.4, 0.01)
    scene, feet = boxes(carpet), character().feet
    ground = scene.ground_without(("box0",))
    footholds, turns = choose_footholds(walk(6), feet, ground, 0.0)
    assert turns is not None
    for foothold in footholds:
        sole = foothold.position[:2] + feet[0].sole[:, :2]
        on = (np.abs(sole[:, 0] - 1.2) < 0.3) & (np.abs(sole[:, 1]) < 0.4)
        assert not on.any()
    with pytest.raises(SceneError, match="geom to avoid 'water'"):
        scene.ground_without(("water",))
    assert scene.ground_without(()) is scene.ground


def test_where_nobody_can_stand_is_told_with_its_place() -> None:
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX, size=(0.5, 3.0, 0.1), pos=(0.0, 0.0, -0.1)
    )
    with pytest.raises(SceneError, match="nothing to stand on within a step of x="):
        chain(Scene.from_spec(spec), walk(12))


def test_a_foot_fits_on_a_floor_and_not_over_an_edge() -> None:
    ground = boxes((0.0, 1.0, -1.0, 1.0, 0.3)).ground
    foot = character().feet[0]
    x = np.array((-1.0, 0.0, 0.5, 1.0))
    window = Spots(ground).window(np.array((-2.0, -1.0)), np.array((2.0, 1.0)), 0.0)
    fit = window.fits(foot, 0.0, np.column_stack((x, np.zeros(4))))
    assert fit.cost[[0, 2]] == pytest.approx(0.0) and np.isinf(fit.cost[[1, 3]]).all()
    assert fit.height[[0, 2]] == pytest.approx((0.0, 0.3))


def test_a_way_and_its_coordinates() -> None:
    spots = np.array([(0.0, 0.1), (0.5, -0.1), (1.0, 0.1), (1.5, -0.1), (1.5, 0.6), (1.3, 1.0)])
    way = Way.between(spots, np.array((0, 1, 0, 1, 0, 1)), 0.0)
    points = np.array([(0.6, 0.05), (0.8, -0.1)])
    along, beside = way.coordinates(points, 0.5)
    assert way.points(along, beside) == pytest.approx(points)
    assert along == pytest.approx(points[:, 0] - way.corners[0, 0])
    still = Way.between(np.zeros((2, 2)), np.array((0, 1)), 0.7)
    assert still.direction(np.zeros(1)) == pytest.approx(0.7)


def placed(stances: tuple[Stance, ...], move: Array) -> tuple[Foothold, ...]:
    """Return footholds on the stances' spots, moved by (n, 3) [m]."""
    up = np.array((0.0, 0.0, 1.0))
    return tuple(
        Foothold(stance.source_pos + way, stance.source_quat, up, float(np.hypot(*way[:2])))
        for stance, way in zip(stances, move, strict=True)
    )


def test_a_climb_is_slower_and_level_steps_are_not() -> None:
    stances = walk(10)
    level = placed(stances, np.zeros((10, 3)))
    assert find_pace(stances, level, 160, 30.0).same
    up = np.zeros((10, 3))
    up[:, 2] = 0.17 * np.arange(10)
    pace = find_pace(stances, placed(stances, up), 160, 30.0)
    assert len(pace.at) == pytest.approx(160 * 1.17, abs=2)
    assert pace.at[0] == 0.0 and pace.at[-1] == 159.0 and (np.diff(pace.at) > 0.0).all()
    short = np.zeros((10, 3))
    short[:, 0] = -0.3 * np.arange(10)
    assert len(find_pace(stances, placed(stances, short), 160, 30.0).at) < 160


def test_contacts_are_carried_exactly() -> None:
    """In order, none lost, none over a frame that shows anything outside of it."""
    random = np.random.default_rng(5)
    at = np.concatenate(([0.0], np.cumsum(random.uniform(0.6, 1.4, 150))))
    at *= 159.0 / at[-1]
    pace = Pace(at, 160)
    contacts = [
        Contact(f"{side}_{part}", start, start + length)
        for start, length in ((0, 20), (15, 1), (30, 25), (50, 2), (120, 40))
        for side in ("left", "right")
        for part in ("heel", "toe")
    ]
    carried = pace.contacts(contacts)
    assert [one.site for one in carried] == [one.site for one in contacts]
    for old, new in zip(contacts, carried, strict=True):
        assert 0 <= new.start < new.end <= len(at)
        shown = at[new.start : new.end]
        if old.end - old.start > 2:
            assert shown.min() >= old.start - 1e-6 and shown.max() <= old.end - 1.0 + 1e-6
            assert new.start == 0 or at[new.start - 1] < old.start
            assert new.end == len(at) or at[new.end] > old.end - 1.0
    assert carried[0].start == 0 and carried[-1].end == len(at)
    assert Pace.none(160).contacts(contacts) == tuple(contacts)
    assert Pace.none(160).span(0, 0) == (0, 0)


def clip() -> Motion:
    return load_clip("walk")


def test_a_bend_takes_the_root_along_with_its_feet() -> None:
    motion = clip()
    pose = Kinematics(motion.model, motion.nframe).forward(motion.qpos)
    stances = find_stances(motion, pose, character().feet, detect_contacts(motion))
    count = len(stances)
    same = placed(stances, np.zeros((count, 3)))
    loose = loose_ends(stances, same, motion.nframe)
    bend = bend_along(motion, stances, same, (np.zeros(count), loose))
    assert np.abs(bend.shift).max() < 1e-9 and not bend.turn.any()
    aside = placed(stances, np.tile((0.3, -0.2, 0.0), (count, 1)))
    bend = bend_along(motion, stances, aside, (np.zeros(count), loose))
    assert bend.shift == pytest.approx(np.tile((0.3, -0.2), (motion.nframe, 1)), abs=1e-6)
    # Each stance 0.1 m shorter: the root is as much behind as the feet are on average.
    behind = np.zeros((count, 3))
    behind[:, 0] = -0.1 * np.arange(count)
    feet = placed(stances, behind)
    loose = loose_ends(stances, feet, motion.nframe)
    bend = bend_along(motion, stances, feet, (np.zeros(count), loose))
    middle = [0.5 * (stance.start + stance.end) for stance in stances]
    wanted = np.interp(np.arange(motion.nframe), middle, behind[:, 0])
    inside = slice(80, 400)
    assert np.abs(bend.shift[inside, 0] - wanted[inside]).max() < 0.06


@cache
def on_stairs(pace: str = "steps") -> Plan:
    treads = [(1.0 + 0.29 * k, 1.29 + 0.29 * k, -3.0, 3.0, 0.17 * (k + 1)) for k in range(6)]
    scene = boxes(*treads, (2.74, 20.0, -9.0, 9.0, 1.02))
    return make_plan(clip(), scene, settings=PlanSettings(pace=pace))


def test_a_plan_of_stairs_is_one_tread_a_step_and_slower() -> None:
    plan = on_stairs()
    assert plan.original is not None and plan.recorded is not None
    assert plan.original.nframe < plan.source.nframe == plan.recorded.nframe
    heights = np.array([foothold.position[2] for foothold in plan.footholds])
    assert np.abs(np.diff(heights)).max() == pytest.approx(0.17, abs=0.01)
    feet = [stance.foot for stance in plan.stances]
    assert all(a != b for a, b in pairwise(feet[2:]))
    assert all(0 <= one.start < one.end <= plan.source.nframe for one in plan.contacts)
    lines = changes(plan)
    assert "steps have another length" in lines[0]
    assert f"in the recording {plan.original.duration:.1f} s" in lines[1]


def test_pace_can_be_kept() -> None:
    plan = on_stairs("keep")
    assert plan.original is None and plan.source.nframe == clip().nframe
    with pytest.raises(FitError, match="pace"):
        PlanSettings(pace="slow")


def test_on_level_ground_nothing_is_told() -> None:
    plan = make_plan(clip(), boxes())
    assert plan.original is None and not plan.loose and changes(plan) == ()


def test_ground_is_sampled_once() -> None:
    class Counting(Ground):
        looks = 0

        def firm(self, points: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
            Counting.looks += points.size // 3
            return super().firm(points)

    spots = Spots(Counting(boxes().model))
    corners = np.array((0.0, 0.0)), np.array((1.0, 1.0))
    first = spots.window(*corners, 0.0)
    looked = Counting.looks
    again = spots.window(*corners, 0.1)
    assert Counting.looks == looked > 0
    assert (first.heights == again.heights).all()
    assert dataclasses.astuple(first)[0] == pytest.approx(again.corner)
