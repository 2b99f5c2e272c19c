"""The fit's side and the judge's share no code, and follow one rule of what is ground and obstacle.

The rule is docs/figures.md, "What is solid". Its two implementations are held against what the rule
says of each scene, and against each other.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from collections.abc import Set as AbstractSet

import mujoco
import numpy as np
import pytest
import trimesh

from mjmotion.footsteps.obstacles import convex_obstacles
from mjmotion.scene import Scene, load_scene
from mjmotion.validation import ground as judges

EXACT = 1e-6  # [m]
ABOVE = 0.3  # from where the fit looks on, over what is highest there [m]
FLOOR = '<geom name="floor" type="plane" size="9 9 .1"/>'


def blocks(
    x: list[float], y: list[float], z: list[float], hollow: AbstractSet[tuple[int, ...]]
) -> str:
    """The surface of a pile of blocks between the coordinates given, without the hollow ones."""
    filled = set(np.ndindex(len(x) - 1, len(y) - 1, len(z) - 1)) - hollow
    number: dict[tuple[int, ...], int] = {}
    faces = []
    for block, axis, end in itertools.product(sorted(filled), range(3), (0, 1)):
        beside = tuple(b + (2 * end - 1) * (i == axis) for i, b in enumerate(block))
        if beside in filled:
            continue
        first, second = (axis + 1) % 3, (axis + 2) % 3
        quad = []
        for u, v in ((0, 0), (1, 0), (1, 1), (0, 1)):
            corner = np.array(block)
            corner[[axis, first, second]] += (end, u, v)
            quad.append(number.setdefault(tuple(corner.tolist()), len(number)))
        quad = quad if end else quad[::-1]
        faces += [[quad[0], quad[1], quad[2]], [quad[0], quad[2], quad[3]]]
    vertex = " ".join(f"{x[i]} {y[j]} {z[k]}" for i, j, k in number)
    return f'vertex="{vertex}" face="{" ".join(str(n) for face in faces for n in face)}"'


def pit(depth: float) -> str:
    """A box of 1 m by 1 m by 30 cm with a hole of 20 cm by 20 cm in its top."""
    side = [-0.5, -0.1, 0.1, 0.5]
    return blocks(side, side, [0.0, 0.3 - depth, 0.3], {(1, 1, 1)})


def arch(thickness: float) -> str:
    """A wall of 2.2 m with a doorway of 90 cm by 2 m."""
    return blocks([-1.0, -0.45, 0.45, 1.0], [0.0, thickness], [0.0, 2.0, 2.2], {(1, 0, 0)})


def grooves(depth: float) -> str:
    """The box with fourteen grooves of 30 cm in its top: of 2 mm they are a thousandth of it."""
    along = np.linspace(-0.5, 0.5, 31).round(4).tolist()
    hollow = {(i, 1, 1) for i in range(1, 29, 2)}
    return blocks(along, [-0.5, -0.15, 0.15, 0.5], [0.0, 0.3 - depth, 0.3], hollow)


# Open below, and closed: the roof of a tent, whose triangles all are on its hull.
TENT = 'inertia="shell" vertex="-.5 -.5 0 .5 -.5 0 0 .5 0 0 0 .6" face="0 1 3 1 2 3 2 0 3{}"'
PICTURE, TOUCHED, TOUCHES = ((0, 0), (0, 2), (4, 0))  # contype, conaffinity


def mesh(shape: str, turn: str = "0 0 0") -> tuple[str, str]:
    """A geom named ``it`` of a mesh, and the mesh."""
    return f'<geom name="it" type="mesh" mesh="m" euler="{turn}"/>', f'<mesh name="m" {shape}/>'


def wall(bits: tuple[int, int], more: str = "") -> tuple[str, str]:
    """A wall named ``it`` that collides by ``contype`` and ``conaffinity``."""
    contype, conaffinity = bits
    collides = f'contype="{contype}" conaffinity="{conaffinity}"'
    return f'<geom name="it" type="box" size=".1 1 .4" pos="0 0 .4" {collides} {more}/>', ""


def ball() -> str:
    """A ball of 162 corners, of which MuJoCo is told to keep 20 for collisions."""
    shape = trimesh.creation.icosphere(subdivisions=2, radius=0.4)
    vertex, face = (" ".join(map(str, part.ravel())) for part in (shape.vertices, shape.faces))
    return f'maxhullvert="20" vertex="{vertex}" face="{face}"'


SOLID = {
    "box": ('<geom name="it" type="box" size=".5 .4 .1" pos="0 0 .1"/>', ""),
    "turned box": ('<geom name="it" type="box" size=".5 .4 .1" euler="8 6 40"/>', ""),
    "box as a mesh": mesh(blocks([0, 1], [0, 1], [0, 1], set())),
    "turned box as a mesh": mesh(blocks([0, 0.5, 1], [0, 1], [0, 0.3], set()), "8 6 40"),
    "ball with a coarse hull": mesh(ball()),
    "closed tent": mesh(TENT.format(" 0 2 1")),
    "wall with contype alone": wall(TOUCHES),
    "wall with conaffinity alone": wall(TOUCHED),
    "wall that is not seen": wall((1, 1), 'rgba="0 0 0 0" group="5"'),
    "box on a fixed body": (
        '<body pos="0 0 .1" euler="0 0 20"><geom name="it" type="box" size=".5 .5 .1"/></body>',
        "",
    ),
}
NOT_CONVEX = {
    "box with a pit": mesh(pit(0.05)),
    "box with a pit of 2 mm": mesh(pit(0.002)),
    "box with grooves of 2 mm": mesh(grooves(0.002)),
    "wall with a doorway": mesh(arch(0.2)),
    "board with a doorway": mesh(arch(0.004)),
    "sheet with a doorway": mesh(arch(0.0008)),
    "open tent": mesh(TENT.format("")),
}
NOT_THERE = {
    "picture of a wall": wall(PICTURE),
    "picture of a pit": (
        '<geom name="it" type="mesh" mesh="m" contype="0" conaffinity="0"/>',
        f'<mesh name="m" {pit(0.05)}/>',
    ),
    "door on a hinge": (
        '<body pos="0 0 .5"><joint/><geom name="it" type="box" size=".1 1 .4"/></body>',
        "",
    ),
    "box moved by mocap": (
        '<body mocap="true"><geom name="it" type="box" size=".5 .5 .3"/></body>',
        "",
    ),
}
ALL = SOLID | NOT_CONVEX | NOT_THERE


def scene(case: tuple[str, str], floor: str = FLOOR) -> Scene:
    body, asset = case
    xml = f"<mujoco><asset>{asset}</asset><worldbody>{floor}{body}</worldbody></mujoco>"
    return Scene.from_spec(mujoco.MjSpec.from_string(xml))


@pytest.mark.parametrize("name", ALL)
def test_the_obstacles_are_the_same(name: str) -> None:
    place = scene(ALL[name])
    obstacles, ground = convex_obstacles(place.model).tolist(), judges.Ground(place.model)
    assert ground.convex == obstacles
    assert obstacles == ([place.model.geom("it").id] if name in SOLID else [])
    assert ground.surfaces == ([place.model.geom("it").id] if name in NOT_CONVEX else [])


@pytest.mark.parametrize(("depth", "solid"), [(0.0009, True), (0.0011, False)])
@pytest.mark.parametrize("shape", [pit, grooves])
def test_a_millimetre_makes_a_mesh_hollow(
    shape: Callable[[float], str], depth: float, solid: bool
) -> None:
    place = scene(mesh(shape(depth)))
    assert len(convex_obstacles(place.model)) == solid
    assert len(judges.Ground(place.model).convex) == solid


def test_a_signed_distance_field_is_ground_alone() -> None:
    plugin = '<plugin plugin="mujoco.sdf.torus"><instance name="t"/></plugin>'
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><extension>{plugin}</extension>
        <asset><mesh name="t"><plugin instance="t"/></mesh></asset><worldbody>
        <geom type="sdf" mesh="t"><plugin instance="t"/></geom></worldbody></mujoco>"""
    )
    ground = judges.Ground(model)
    assert convex_obstacles(model).tolist() == ground.convex == []
    assert ground.surfaces == [0]


def from_above(place: Scene, seed: int = 1, count: int = 3000) -> tuple[np.ndarray, np.ndarray]:
    """Compare heights all over a scene.

    Returns:
      height: (n,) what both found [m], NaN where both found nothing.
      steep: (n,) where the judge found ground too steep for the fit to stand on.
    """
    ground, rng = judges.Ground(place.model), np.random.default_rng(seed)
    xyz = np.column_stack((rng.uniform(-1.4, 1.4, (count, 2)), np.full(count, 9.0)))
    height, geom = ground.heights(xyz)
    # The fit looks down from 1 m over a point, and sees from there what the judge had not seen.
    xyz[:, 2] = np.where(geom >= 0, height + ABOVE, xyz[:, 2])
    found, _ = place.ground.under(xyz)
    stood = np.isfinite(found)
    np.testing.assert_allclose(height[stood], found[stood], rtol=0.0, atol=EXACT)
    return found, ~stood & (geom >= 0)


@pytest.mark.parametrize("floor", [FLOOR, ""])
@pytest.mark.parametrize("name", ALL)
def test_the_heights_are_the_same(name: str, floor: str) -> None:
    found, steep = from_above(scene(ALL[name], floor))
    assert steep.mean() < 0.15  # sides of what is turned, and of the tents
    levels = np.unique(found[np.isfinite(found)].round(6))
    if name in NOT_THERE:
        assert levels.tolist() == ([0.0] if floor else [])
    else:
        assert levels.max() > 0.03  # it was stood on
    assert (~np.isfinite(found) & ~steep).any() == (not floor)


def test_the_heights_on_a_slope_are_the_same() -> None:
    slope = '<geom type="plane" size="9 9 .1" pos=".1 .2 .3" euler="10 -15 20"/>'
    found, steep = from_above(scene(SOLID["turned box"], slope))
    assert not steep[np.isfinite(found)].any() and np.ptp(found[np.isfinite(found)]) > 0.5


@pytest.mark.parametrize("name", ["flat", "slope", "stairs", "blocks", "terrain_doors"])
def test_the_projects_own_scenes(name: str) -> None:
    place = load_scene(name)
    assert convex_obstacles(place.model).tolist() == judges.Ground(place.model).convex
    heights, _ = from_above(place, count=1000)
    assert np.isfinite(heights).any()


@pytest.mark.parametrize(
    ("case", "point", "height"),
    [
        (mesh(arch(0.2)), (0.1, 0.1, 0.02), 0.0),  # on the threshold
        (mesh(arch(0.2)), (0.7, 0.1, 2.3), 2.2),  # on top
        (mesh(arch(0.2)), (0.1, 0.1, 2.3), 2.2),  # on the lintel
        (mesh(pit(0.05)), (0.05, 0.0, 0.27), 0.25),  # in the pit
        (mesh(pit(0.05)), (0.3, 0.3, 0.32), 0.3),  # beside it
        (mesh(pit(0.05)), (0.3, 0.3, 0.28), 0.3),  # sunk into its edge
        (wall(PICTURE), (0.0, 0.0, 0.02), 0.0),
        (wall(TOUCHES), (0.0, 0.0, 0.02), 0.8),
        (wall(TOUCHED), (0.0, 0.0, 0.02), 0.8),
    ],
)
def test_known_heights(case: tuple[str, str], point: tuple[float, ...], height: float) -> None:
    place = scene(case)
    found, _ = place.ground.under(np.array([point]))
    judged, _ = judges.Ground(place.model).heights(np.array([point]))
    assert (found[0], judged[0]) == pytest.approx((height, height), abs=EXACT)
