"""Which way a walk goes: free space, the way through it, the bend that takes a clip there."""

from __future__ import annotations

import functools
import json
from pathlib import Path

import mujoco
import numpy as np
import pytest
from made_up import walk

from mjmotion.body.motion import Motion
from mjmotion.exceptions import ContactError, MotionError, SceneError
from mjmotion.footsteps.contacts import detect_contacts
from mjmotion.footsteps.plan_file import load_plan, save_plan
from mjmotion.footsteps.planning import make_plan, place
from mjmotion.footsteps.settings import PlanSettings
from mjmotion.output.plan_drawing import draw_plan, plan_svg
from mjmotion.route.barriers import barrier
from mjmotion.route.bend import Bend
from mjmotion.route.centreline import Centreline, headings
from mjmotion.route.free_space import NO_GROUND, FreeSpace, find_free_space
from mjmotion.route.given import check_way, read_way, rounded, way_sites
from mjmotion.route.shapes import hull, outline_distance
from mjmotion.route.way import Route, find_route
from mjmotion.route.width import BodyWidth
from mjmotion.scene import Scene, flat, load_scene

BOX, CYLINDER = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CYLINDER
SIDE_WALL = 2.0  # half length of a wall beside a door [m]


@functools.cache
def clip(seconds: float = 10.0) -> Motion:
    """A made-up walk straight ahead, 0.43 m/s."""
    return walk(seconds, 30.0)


def with_solids(*solids: tuple[str, mujoco.mjtGeom, tuple[float, ...], tuple[float, ...]]) -> Scene:
    """A floor with solids: name, kind, place, sizes."""
    spec = flat()
    for name, kind, pos, size in solids:
        spec.worldbody.add_geom(name=name, type=kind, pos=pos, size=size)
    return Scene.from_spec(spec)


def door(aside: float, width: float = 0.9, x: float = 2.0) -> Scene:
    """A wall with a door to one side."""
    half = 0.5 * width + SIDE_WALL
    return with_solids(
        ("left", BOX, (x, aside + half, 1.2), (0.06, SIDE_WALL, 1.2)),
        ("right", BOX, (x, aside - half, 1.2), (0.06, SIDE_WALL, 1.2)),
    )


def route(scene: Scene, motion: Motion | None = None, **settings: object) -> Route:
    """Where the made-up walk goes."""
    motion = clip() if motion is None else motion
    return find_route(place(motion, scene), scene, **settings)  # type: ignore[arg-type]


def apart(scene: Scene, line: np.ndarray, name: str) -> float:
    """How near a line comes to a solid, seen from above [m]."""
    geom = scene.model.geom(name)
    kind = int(scene.model.geom_type[geom.id])
    if kind == int(CYLINDER):
        return float((np.linalg.norm(line - geom.pos[:2], axis=1) - geom.size[0]).min())
    corners = geom.pos[:2] + geom.size[:2] * np.array(((-1, -1), (1, -1), (1, 1), (-1, 1)))
    return float(outline_distance(corners, line).min())


@pytest.mark.parametrize("aside", [0.3, -0.3, 0.6])
def test_a_door_beside_the_way_is_walked_through(aside: float) -> None:
    """It passes the door with its own width, and comes back, no stride longer than it was."""
    scene, motion = door(aside), clip()
    found = route(scene)
    assert found.bent and found.lack < 0.003
    width = BodyWidth.of(motion, Centreline.of(motion))
    for side in ("left", "right"):
        assert apart(scene, found.line, side) > width.trunk[:, :3].max() + 0.02
    line = found.bend.apply(place(motion, scene)).qpos[:, :2]
    assert line[0] == pytest.approx(motion.qpos[0, :2], abs=1e-4)
    assert np.sign(line[np.abs(line[:, 0] - 2.0).argmin(), 1]) == np.sign(aside)
    assert abs(line[-1, 1]) < 0.6 * abs(aside)
    before, after = (
        np.linalg.norm(np.diff(one, axis=0), axis=1).sum() for one in (motion.qpos[:, :2], line)
    )
    assert after == pytest.approx(before, rel=0.02)


def test_a_way_that_is_free_is_the_clips_own() -> None:
    """Bit for bit: also where there is a door on it, steps and a beam to bow under."""
    beam = with_solids(
        ("step", BOX, (1.0, 0.0, 0.1), (0.3, 1.0, 0.1)),
        ("beam", BOX, (2.0, 0.0, 1.3), (0.1, 2.0, 0.1)),
    )
    for scene in (Scene.from_spec(flat()), door(0.0), beam, load_scene("stairs")):
        plan = make_plan(clip(4.0), scene)
        assert plan.route is not None and not plan.route.bent
        assert not plan.route.bend.shift.any() and not plan.route.bend.turn.any()
        assert plan.route.lack <= 0.02


def test_contacts_are_carried() -> None:
    """Who stands when is what the clip shows before it is bent."""
    scene = door(0.3)
    plan = make_plan(clip(), scene)
    assert plan.recorded is not None and plan.route is not None and plan.route.bent
    assert plan.detected == detect_contacts(place(clip(), scene))
    assert np.array_equal(plan.recorded.qpos, place(clip(), scene).qpos)
    assert not np.array_equal(plan.source.qpos, plan.recorded.qpos)
    joints = plan.source.qpos[:, 7:] - plan.recorded.qpos[:, 7:]
    assert not joints.any()


def test_two_walls_are_passed_on_either_side() -> None:
    """A maze: first on the left, then on the right."""
    scene = with_solids(
        ("first", BOX, (1.2, -1.8, 1.2), (0.06, 2.0, 1.2)),
        ("second", BOX, (3.0, 1.8, 1.2), (0.06, 2.0, 1.2)),
    )
    found = route(scene)
    assert found.bent and found.lack < 0.003
    y = [found.line[np.abs(found.line[:, 0] - x).argmin(), 1] for x in (1.2, 3.0)]
    assert y[0] > 0.35 and y[1] < -0.35


@pytest.mark.parametrize("left", [True, False])
def test_a_corner_is_walked_round(left: bool) -> None:
    """A corridor turns by 90°: the walk goes on along its new way."""
    side = 1.0 if left else -1.0
    scene = with_solids(
        ("outer", BOX, (0.8, -0.66 * side, 1.2), (2.4, 0.06, 1.2)),
        ("end", BOX, (3.2, 2.0 * side, 1.2), (0.06, 2.7, 1.2)),
        ("inner", BOX, (-0.2, 0.66 * side, 1.2), (2.0, 0.06, 1.2)),
        ("side", BOX, (1.8, 2.6 * side, 1.2), (0.06, 1.9, 1.2)),
    )
    found = route(scene, clip(12.0))
    assert found.bent and found.lack < 0.02
    assert np.degrees(found.bend.turn[-1]) * side == pytest.approx(90.0, abs=25.0)
    rate = np.degrees(np.abs(np.gradient(found.bend.turn)) * 30.0)
    assert rate.max() < 100.0


@pytest.mark.parametrize("seed", range(6))
def test_no_point_of_the_way_is_inside_what_bars_it(seed: int) -> None:
    """Posts by chance: the line keeps clear of all of them, by what trunk and legs take up."""
    random = np.random.default_rng(seed)
    places = [(1.3, random.uniform(-0.15, 0.15))]
    for _ in range(200):
        place_ = random.uniform((1.0, -1.8), (4.5, 1.8))
        if min(np.hypot(*(place_ - np.array(other))) for other in places) > 1.1:
            places.append(tuple(place_))
    posts = [
        (f"post{number}", CYLINDER, (*at, 0.8), (random.uniform(0.03, 0.08), 0.8, 0.0))
        for number, at in enumerate(places)
    ]
    scene = with_solids(*posts)
    found = route(scene)
    assert found.bent
    width = BodyWidth.of(clip(), Centreline.of(clip()))
    reached = found.line[: len(found.own)]
    for name, *_ in posts:
        assert apart(scene, reached, name) > width.trunk.max() - 0.005


def test_strides_are_kept() -> None:
    """Every frame is as far along the new line as along the old; a corner turns the body."""
    line = Centreline.of(clip())
    corner = np.array(((0.0, 0.0), (2.0, 0.0), (2.0, 5.0)))
    bend = line.bend(rounded(corner))
    moved = Centreline.of(bend.apply(clip()))
    assert moved.whole == pytest.approx(line.whole, rel=0.02)
    assert np.degrees(bend.turn[-1]) == pytest.approx(90.0, abs=1.0)
    same = line.bend(line.spaced(0.05))
    assert np.abs(same.shift).max() < 0.01 and np.abs(same.turn).max() < np.radians(2.0)


def test_who_stays_has_a_line_without_length() -> None:
    still = clip().replace(np.repeat(clip().qpos[:1], 60, axis=0))
    line = Centreline.of(still)
    assert line.whole == 0.0 and len(line.spaced()) == 1
    found = route(Scene.from_spec(flat()), still)
    assert not found.bent


def test_a_bend_moves_the_root_alone() -> None:
    turn = np.full(clip().nframe, 0.3)
    bend = Bend(np.ones((clip().nframe, 2)), turn).then(Bend.none(clip().nframe))
    moved = bend.apply(clip())
    assert np.array_equal(moved.qpos[:, 7:], clip().qpos[:, 7:])
    assert np.array_equal(moved.qpos[:, 2], clip().qpos[:, 2])
    assert moved.qpos[:, :2] == pytest.approx(clip().qpos[:, :2] + 1.0)


# --- free space -----------------------------------------------------------------------------------


def space_of(scene: Scene, **settings: object) -> FreeSpace:
    points = np.column_stack((np.linspace(0.0, 4.0, 41), np.zeros(41)))
    return find_free_space(scene, points, 1.5, 1.75, **settings)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("low", "high", "barred", "overhead"),
    [
        (0.0, 0.4, False, False),  # a step
        (0.0, 0.7, True, False),
        (0.6, 0.9, True, False),
        (1.2, 1.4, False, True),  # bowed under
        (2.0, 2.4, False, False),
    ],
)
def test_what_bars(low: float, high: float, barred: bool, overhead: bool) -> None:
    """A box a metre long, by where it is from and to."""
    half = 0.5 * (high - low)
    box = ("box", BOX, (2.0, 0.0, low + half), (0.3, 0.5, half))
    space = space_of(with_solids(box))
    assert (space.distance[:, :, :].min() < 0.0) == barred
    assert (space.overhead.min() < 0.0) == overhead
    at = space.distances(np.array(((2.0, 0.75),)))[0]
    if barred:
        assert at[:4].min() == pytest.approx(0.25, abs=0.003)
    if overhead:
        assert at[-2] == pytest.approx(0.25, abs=0.003)


def test_climbing_is_asked_for() -> None:
    box = ("box", BOX, (2.0, 0.0, 0.35), (0.3, 1.0, 0.35))
    assert route(with_solids(box)).bent
    assert not route(with_solids(box), climb=True).bent


def test_ground_that_is_walked_on_is_no_obstacle() -> None:
    """A ramp rises by far more than a step, and so do stairs; beside them are ledges."""
    assert space_of(load_scene("slope")).lack(np.array(((2.0, 0.0),)), np.full(5, 0.2)) == 0.0
    steps = [
        (f"step{k}", BOX, (1.0 + 0.3 * k, 0.0, 0.085 * (k + 1)), (0.15, 1.0, 0.085 * (k + 1)))
        for k in range(8)
    ]
    space = space_of(with_solids(*steps))
    on = np.array(((3.0, 0.0),))
    assert space.lack(on, np.full(5, 0.25)) == 0.0
    assert space.ground.at(on)[0] == pytest.approx(8 * 0.17 - 0.17, abs=0.18)
    edge = np.array(((3.0, 1.0),))
    geom, short = space.worst(edge[0], np.full(5, 0.12))
    assert geom == NO_GROUND and short > 0.0


def test_a_gap_bars_and_a_crack_does_not() -> None:
    """Two slabs with nothing between: 0.2 m is stepped over, 1.2 m is not."""
    for gap, barred in ((0.2, False), (1.2, True)):
        spec = mujoco.MjSpec()
        spec.worldbody.add_site(name="start")
        for name, middle in (("near", -1.0), ("far", 5.0 + gap)):
            half = 3.0
            spec.worldbody.add_geom(
                name=name, type=BOX, pos=(middle, 0.0, -0.1), size=(half, 3.0, 0.1)
            )
        space = space_of(Scene.from_spec(spec))
        over = np.array(((2.0 + 0.5 * gap, 0.0),))
        assert bool(space.lack(over, np.full(5, 0.12))[0] > 0.0) == barred


def test_a_mesh_with_an_arch_is_passed_under() -> None:
    """One mesh of two legs and a beam, which does not fill its hull."""
    spec = flat()
    corners = np.stack(np.meshgrid((-1, 1), (-1, 1), (-1, 1)), axis=-1).reshape(-1, 3)
    faces = np.array(
        ((0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1))
        + ((2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3))
    )
    parts = [((2, 0.9, 0.7), (0.1, 0.2, 0.7)), ((2, -0.9, 0.7), (0.1, 0.2, 0.7))]
    parts.append(((2, 0, 1.6), (0.1, 1.1, 0.15)))
    vertices = np.concatenate([np.array(p) + np.array(s) * corners for p, s in parts])
    every = np.concatenate([faces + 8 * k for k in range(3)])
    spec.add_mesh(name="arch", uservert=vertices.ravel().tolist(), userface=every.ravel().tolist())
    spec.worldbody.add_geom(name="arch", type=mujoco.mjtGeom.mjGEOM_MESH, meshname="arch")
    scene = Scene.from_spec(spec)
    geom = scene.model.geom("arch")
    shift = np.array(geom.pos)  # MuJoCo puts a mesh's middle at its geom's
    space = space_of(scene)
    at = space.distances(np.array(((2.0, 0.0), (2.0, 0.9))) + 0.0 * shift[:2])
    assert at[0, :-3].min() > 0.6 and at[0, -2] < 0.05  # under the beam
    assert at[1, :-3].min() < 0.15  # in a leg


def test_distances_to_an_outline() -> None:
    square = hull(np.array(((0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (0.0, 2.0), (1.0, 1.0))))
    assert len(square) == 4
    points = np.array(((1.0, 1.5), (3.0, 1.0), (3.0, 3.0), (2.0, 1.0)))
    assert outline_distance(square, points) == pytest.approx([-0.5, 1.0, 2.0**0.5, 0.0])
    ends = hull(np.array(((0.0, 0.0), (1.0, 0.0), (2.0, 0.0))))
    assert outline_distance(ends, np.array(((1.0, 0.7),))) == pytest.approx([0.7])


@pytest.mark.parametrize(
    ("kind", "pos", "size", "word"),
    [
        (BOX, (0, 0, 2.2), (0.1, 0.5, 0.2), "lintel"),
        (BOX, (0, 0, 1.2), (0.1, 2.0, 1.2), "wall"),
        (CYLINDER, (0, 0, 0.8), (0.05, 0.8, 0.0), "post"),
        (BOX, (0, 0, 0.3), (0.2, 0.2, 0.3), "box"),
    ],
)
def test_what_bars_is_told_by_what_it_is(
    kind: mujoco.mjtGeom, pos: tuple[float, ...], size: tuple[float, ...], word: str
) -> None:
    scene = with_solids(("it", kind, pos, size))
    assert barrier(scene.model, scene.model.geom("it").id, 0.0) == f"{word} 'it'"


# --- ways that are given --------------------------------------------------------------------------


def test_a_way_is_read_from_any_file(tmp_path: Path) -> None:
    way = [[0.0, 0.0], [2.0, 0.5], [4.0, 0.0]]
    texts = {
        "way.csv": "x,y\n0,0\n2,0.5\n\n4,0\n",
        "bare.csv": "0,0\n2,.5\n4,0\n",
        "way.json": json.dumps(way),
        "way.yaml": "- [0, 0]\n- [2, 0.5]\n- [4, 0]\n",
    }
    for name, text in texts.items():
        (tmp_path / name).write_text(text, "utf-8")
        assert read_way(tmp_path / name).tolist() == way


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.csv", "", "two points"),
        ("a.csv", "0,0\n1,one\n", "point 2"),
        ("a.csv", "0,0,1\n1,1,1\n", "two numbers"),
        ("a.csv", "0,0\nnan,1\n", "finite"),
        ("a.csv", "0,0\n1e9,1\n", "at most"),
        ("a.csv", "1,1\n1,1\n", "two points"),
        ("a.json", '{"x": 1}', "list of points"),
        ("a.json", "[[0, 0], [1, true]]", "two numbers"),
        ("a.yaml", "- [0, 0]\n- far\n", "two numbers"),
    ],
)
def test_a_file_that_is_no_way_is_refused(tmp_path: Path, name: str, text: str, said: str) -> None:
    (tmp_path / name).write_text(text, "utf-8")
    with pytest.raises(SceneError, match=said):
        read_way(tmp_path / name)
    with pytest.raises(SceneError, match="cannot read"):
        read_way(tmp_path / "absent.csv")


def test_sites_of_a_scene_give_a_way() -> None:
    """In the order of their numbers, from the start; the clip is cut where they end."""
    spec = flat()
    for name, pos in (
        ("way_10", (2.0, 1.5, 0.0)),
        ("way_2", (2.0, 0.0, 0.0)),
        ("way_x", (9, 9, 0)),
    ):
        spec.worldbody.add_site(name=name, pos=pos)
    scene = Scene.from_spec(spec)
    way = way_sites(scene)
    assert way is not None and way.tolist() == [[0.0, 0.0], [2.0, 0.0], [2.0, 1.5]]
    assert way_sites(Scene.from_spec(flat())) is None
    plan = make_plan(clip(), scene)
    end = plan.source.qpos[-1, :2]
    assert end == pytest.approx([2.0, 1.5], abs=0.2)
    assert plan.original is not None and plan.original.nframe == clip().nframe
    assert plan.recorded is not None and plan.recorded.nframe == plan.source.nframe < clip().nframe
    kept = make_plan(clip(), scene, settings=PlanSettings(path="keep"))
    assert kept.recorded is None and kept.source.nframe == clip().nframe


def test_a_given_way_begins_where_it_says() -> None:
    way = np.array(((1.0, 1.0), (1.0, 6.0)))
    plan = make_plan(clip(), Scene.from_spec(flat()), settings=PlanSettings(path=way))
    line = plan.source.qpos[:, :2]
    assert line[0] == pytest.approx([1.0, 1.0], abs=0.1)
    assert np.abs(line[:, 0] - 1.0).max() < 0.1 and line[-1, 1] > 3.0
    ahead = headings(way, np.array((0.0, 5.0)), np.array((1.0,)))
    assert np.degrees(ahead[0]) == pytest.approx(90.0)
    with pytest.raises(SceneError):
        check_way([[0.0, 0.0]])
    with pytest.raises(MotionError, match="bend"):
        PlanSettings(path="around")


# --- plan.json and its drawing --------------------------------------------------------------------


def test_a_plan_is_taken_back_as_it_was(tmp_path: Path) -> None:
    scene = door(0.3)
    plan = make_plan(clip(), scene)
    save_plan(tmp_path / "plan.json", plan, "walk", "door")
    contacts, settings = load_plan(tmp_path / "plan.json", clip())
    again = make_plan(clip(), scene, contacts, settings)
    assert again.contacts == plan.contacts
    assert np.abs(again.source.qpos - plan.source.qpos).max() < 5e-3
    for one, other in zip(again.footholds, plan.footholds, strict=True):
        assert one.position == pytest.approx(other.position, abs=3e-3)


def test_an_edited_foothold_is_where_it_was_put(tmp_path: Path) -> None:
    """0.1 m further to the left; the root goes along, the others stay."""
    scene = Scene.from_spec(flat())
    plan = make_plan(clip(), scene)
    save_plan(tmp_path / "plan.json", plan)
    entries = json.loads((tmp_path / "plan.json").read_text("utf-8"))
    assert entries["path"] is None
    entries["footholds"][4]["y"] += 0.1
    (tmp_path / "plan.json").write_text(json.dumps(entries), "utf-8")
    contacts, settings = load_plan(tmp_path / "plan.json", clip())
    again = make_plan(clip(), scene, contacts, settings)
    moved = [
        float(np.hypot(*(b.position - a.position)[:2]))
        for a, b in zip(plan.footholds, again.footholds, strict=True)
    ]
    assert moved[4] == pytest.approx(0.1, abs=0.01)
    assert max(moved[:4] + moved[5:]) < 0.01


def test_plans_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    plan = make_plan(clip(), Scene.from_spec(flat()))
    save_plan(path, plan)
    good = json.loads(path.read_text("utf-8"))
    for change in (
        {"nframe": 3},
        {"contacts": [{"site": 1, "start": 0, "end": 3}]},
        {"contacts": "none"},
        {"footholds": [{"x": "a", "y": 0, "yaw_deg": 0}]},
        {"footholds": [{"x": 1e9, "y": 0, "yaw_deg": 0}]},
        {"path": [[0, 0]]},
    ):
        path.write_text(json.dumps({**good, **change}), "utf-8")
        with pytest.raises(MotionError):
            load_plan(path, clip())
    path.write_text(json.dumps({**good, "footholds": good["footholds"][:2]}), "utf-8")
    contacts, settings = load_plan(path, clip())
    with pytest.raises(ContactError, match="2 footholds"):
        make_plan(clip(), Scene.from_spec(flat()), contacts, settings)


def test_a_plan_is_drawn(tmp_path: Path) -> None:
    """Obstacles by name, both ways, one sole a foothold."""
    plan = make_plan(clip(), door(0.3))
    text = plan_svg(plan, np.array(((1.0, 0.0),)))
    assert text.count("<polygon") == len(plan.footholds) + len(plan.obstacles)
    assert ">left<" in text and ">right<" in text and text.count("<circle") == 1
    draw_plan(tmp_path / "plan.png", plan)
    assert (tmp_path / "plan.png").read_bytes().startswith(b"\x89PNG")
