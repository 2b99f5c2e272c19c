"""Scenes on which steps have to be chosen: building stairs up and down, stepping stones, a gap.

Every kind comes by seed, so that some can be tuned on and others held back.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from benchmarks.figures import Print
from benchmarks.quality import MOCAP, SHARE
from mjmotion.apps.adaptation import adapt
from mjmotion.body.kinematics import Kinematics, site_id
from mjmotion.body.motion import Motion
from mjmotion.clips import load_clip
from mjmotion.exceptions import MotionError
from mjmotion.footsteps.contacts import contact_mask
from mjmotion.output.result import Result
from mjmotion.paper.figures import Figure
from mjmotion.scene import Scene

Array = NDArray[np.float64]

TUNED, HELD_BACK = range(6), range(100, 108)
"""Seeds of scenes that were tuned on, and of others."""
MOST_TURN = 60.0  # a step's turn [degrees]
GAP = 2  # before which stone it is
RISER = 0.05  # a step of the ground that counts as one [m]
CLIPS = ("walk", "02_01", "07_01", "16_58")


def _scene(start_height: float) -> mujoco.MjSpec:
    spec = mujoco.MjSpec()
    spec.worldbody.add_light(pos=(0.0, 0.0, 6.0))
    spec.worldbody.add_site(name="start", pos=(0.0, 0.0, start_height))
    spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=(40.0, 40.0, 0.1))
    return spec


def _block(spec: mujoco.MjSpec, name: str, low: Array, high: Array, yaw: float = 0.0) -> None:
    spec.worldbody.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=0.5 * (low + high),
        size=0.5 * (high - low),
        quat=(np.cos(0.5 * yaw), 0.0, 0.0, np.sin(0.5 * yaw)),
    )


def _flight(
    spec: mujoco.MjSpec, name: str, x: float, heights: Sequence[float], tread: float, last: float
) -> float:
    """Add treads of some heights from x on, the last one so long; return where they end [m]."""
    for number, height in enumerate(heights):
        end = x + (last if number == len(heights) - 1 else tread)
        _block(spec, f"{name}{number}", np.array((x, -5.0, 0.0)), np.array((end, 5.0, height)))
        x = end
    return x


def stairs_up(seed: int) -> mujoco.MjSpec:
    """Return stairs up, 0.12–0.20 m by 0.25–0.35 m."""
    random = np.random.default_rng(seed)
    rise, tread = random.uniform(0.12, 0.20), random.uniform(0.25, 0.35)
    spec = _scene(0.0)
    heights = rise * np.arange(1, random.integers(5, 12))
    _flight(spec, "tread", random.uniform(0.8, 1.6), heights.tolist(), tread, 20.0)
    return spec


def stairs_down(seed: int) -> mujoco.MjSpec:
    """Return stairs down from a landing, 0.12–0.20 m by 0.25–0.35 m."""
    random = np.random.default_rng(seed)
    rise, tread = random.uniform(0.12, 0.20), random.uniform(0.25, 0.35)
    count = int(random.integers(5, 12))
    spec = _scene(rise * count)
    edge = random.uniform(0.8, 1.6)
    _block(spec, "top", np.array((-3.0, -5.0, 0.0)), np.array((edge, 5.0, rise * count)))
    _flight(spec, "tread", edge, (rise * np.arange(count - 1, 0, -1)).tolist(), tread, tread)
    return spec


def stairs_over(seed: int) -> mujoco.MjSpec:
    """Return a few treads up, a landing, and as many down."""
    random = np.random.default_rng(seed)
    rise, tread = random.uniform(0.12, 0.20), random.uniform(0.25, 0.35)
    spec = _scene(0.0)
    up = (rise * np.arange(1, random.integers(3, 6))).tolist()
    x = _flight(spec, "up", random.uniform(0.8, 1.4), up, tread, random.uniform(0.9, 2.0))
    _flight(spec, "down", x, up[-2::-1], tread, tread)
    return spec


def _stones(seed: int, gap: float) -> mujoco.MjSpec:
    random = np.random.default_rng(seed)
    high = 0.35
    spec = _scene(high)
    edge = random.uniform(0.3, 0.7)
    _block(spec, "bank0", np.array((-2.0, -1.2, 0.0)), np.array((edge, 1.2, high)))
    spacing = random.uniform(0.35, 0.8)
    x, side = edge, random.choice((-1.0, 1.0))
    for number in range(10):
        size = random.uniform(0.3, 0.5, 2)
        size[0] = min(size[0], spacing - 0.05)
        x += spacing * random.uniform(0.9, 1.1) + (gap if number == GAP else 0.0)
        y = side * random.uniform(0.05, 0.15)
        top = high + random.uniform(-0.15, 0.15)
        middle = np.array((x, y, 0.5 * top))
        half = np.array((*(0.5 * size), 0.5 * top))
        _block(
            spec,
            f"stone{number}",
            middle - half,
            middle + half,
            np.radians(random.uniform(-20, 20)),
        )
        side = -side
    far = x + spacing
    _block(spec, "bank1", np.array((far - 0.2, -4.0, 0.0)), np.array((far + 15.0, 8.0, high)))
    return spec


def stones(seed: int) -> mujoco.MjSpec:
    """Return ten stones 0.35–0.8 m apart, 0.3–0.5 m large, whose heights differ by up to 0.3 m."""
    return _stones(seed, 0.0)


def stones_gap(seed: int) -> mujoco.MjSpec:
    """Return the same with one gap that is wider."""
    return _stones(seed, 0.2)


KINDS: dict[str, Callable[[int], mujoco.MjSpec]] = {
    "stairs_up": stairs_up,
    "stairs_down": stairs_down,
    "stairs_over": stairs_over,
    "stones": stones,
    "stones_gap": stones_gap,
}


def make(kind: str, seed: int) -> Scene:
    """Return one scene of a kind."""
    return Scene.from_spec(KINDS[kind](seed), f"{kind}{seed}")


@dataclasses.dataclass(frozen=True, eq=False)
class Steps:
    """Steps of a motion and of its source, one a row.

    Attributes:
      foot: (n,) which foot steps.
      again: (n,) whether it is the one that stepped before.
      length, source_length: (n,) along the way [m].
      width, source_width: (n,) to the stepping foot's own side [m].
      rise: (n,) [m].
      turn: (n,) more than the source's [degrees].
      risers: (n,) that lie between one foot and the next.
    """

    foot: NDArray[np.int64]
    again: NDArray[np.bool_]
    length: Array
    source_length: Array
    width: Array
    source_width: Array
    rise: Array
    turn: Array
    risers: NDArray[np.int64]


def steps_of(result: Result, scene: Scene) -> Steps:
    """Measure the steps of a result: from the middle of each stance to that of the next."""
    motion = result.motion
    sides = sorted({one.site.rsplit("_", 1)[0] for one in result.contacts if one.stands})
    stances = []
    for foot, side in enumerate(sides):
        held = contact_mask(result.contacts, f"{side}_heel", motion.nframe)
        held |= contact_mask(result.contacts, f"{side}_toe", motion.nframe)
        edges = np.flatnonzero(np.diff(np.concatenate(([0], held, [0])))).reshape(-1, 2)
        stances += [(int(start), int(end), foot) for start, end in edges]
    stances.sort()
    middle = np.array([(start + end) // 2 for start, end, _ in stances])
    feet = np.array([one[2] for one in stances])
    place, yaw = _soles(motion, sides, middle, feet)
    own, own_yaw = _soles(result.source, sides, middle, feet)
    own_side = np.where(np.array([side == "left" for side in sides])[feet[1:]], 1.0, -1.0)
    length, width = _across(place, yaw)
    source_length, source_width = _across(own, own_yaw)
    turn = np.diff(np.unwrap(yaw)) - np.diff(np.unwrap(own_yaw))
    return Steps(
        feet[1:],
        feet[1:] == feet[:-1],
        length,
        source_length,
        own_side * width,
        own_side * source_width,
        np.diff(place[:, 2]),
        np.degrees(np.abs((turn + np.pi) % (2.0 * np.pi) - np.pi)),
        _risers(scene, place),
    )


def _soles(
    motion: Motion, sides: Sequence[str], frames: NDArray[np.int64], foot: NDArray[np.int64]
) -> tuple[Array, Array]:
    """Where feet are (n, 3) [m] and which way they point (n,) [rad], one at each frame."""
    pose = Kinematics(motion.model, len(frames)).forward(motion.qpos[frames])
    row = np.arange(len(frames))
    heel, toe = (
        pose.site_xpos[row, sites[foot]]
        for sites in (
            np.array([site_id(motion.model, f"{side}_{part}") for side in sides])
            for part in ("heel", "toe")
        )
    )
    along = toe - heel
    return 0.5 * (heel + toe), np.arctan2(along[:, 1], along[:, 0])


def _across(place: Array, yaw: Array) -> tuple[Array, Array]:
    """Return steps along the mean way of both feet, and to its left (n,) [m]."""
    yaw = np.unwrap(yaw)
    heading = 0.5 * (yaw[1:] + yaw[:-1])
    step = np.diff(place, axis=0)
    cosine, sine = np.cos(heading), np.sin(heading)
    return step[:, 0] * cosine + step[:, 1] * sine, step[:, 1] * cosine - step[:, 0] * sine


def _risers(scene: Scene, place: Array) -> NDArray[np.int64]:
    """How many risers lie between feet (n,), on stairs that have no gaps."""
    share = np.linspace(0.0, 1.0, 120)[:, None]
    points = place[:-1, None] + share * np.diff(place, axis=0)[:, None]
    height, _ = scene.ground.under(points)
    return np.asarray((np.abs(np.diff(height, axis=1)) > RISER).sum(axis=1))


@dataclasses.dataclass(frozen=True, eq=False)
class Footing:
    """One clip on one scene.

    Attributes:
      clip, scene: their names.
      broken: bars that were missed; "refused" where there is no result.
      line: what there is to say.
    """

    clip: str
    scene: str
    broken: tuple[str, ...]
    line: str


def measure(name: str, clip: Motion, kind: str, seed: int) -> Footing:
    """Adapt a clip to a scene, and measure its figures and its steps."""
    scene = make(kind, seed)
    began = time.perf_counter()
    try:
        result = adapt(clip, scene)
    except MotionError as error:
        return Footing(name, scene.name, ("refused",), str(error)[:120])
    seconds = time.perf_counter() - began
    validation, steps = result.validate(), steps_of(result, scene)
    broken = list(validation.broken())
    said = [f"{one} {validation.metrics[one]:.2f}" for one in broken]
    again = _repeats(steps)
    for what, missed in (
        ("more than a tread a step", kind.startswith("stairs") and steps.risers.max(initial=0) > 1),
        ("steps turn", steps.turn.max(initial=0.0) > MOST_TURN),
        ("a foot steps twice", again),
    ):
        if missed:
            broken.append(what)
            said.append(what)
    ranges = (
        f"length {steps.length.min():.2f}-{steps.length.max():.2f}"
        f" ({steps.source_length.min():.2f}-{steps.source_length.max():.2f})"
        f" width {steps.width.min():.2f}-{steps.width.max():.2f}"
        f" ({steps.source_width.min():.2f}-{steps.source_width.max():.2f})"
        f" rise {steps.rise.min():.2f}-{steps.rise.max():.2f}"
        f" com {validation.metrics['com_acceleration_ratio']:.2f} {seconds:.1f} s"
    )
    return Footing(name, scene.name, tuple(broken), f"{ranges} {'; '.join(said) or 'ok'}")


def _repeats(steps: Steps) -> bool:
    """Whether a foot steps twice where it goes further than it would to stay."""
    far = np.abs(steps.length) > 2.0 * np.abs(steps.source_length) + 0.05
    return bool((steps.again & far).any())


def run(
    clips: Sequence[str], seeds: Sequence[int], print_line: Print, kinds: Sequence[str] = ()
) -> list[Footing]:
    """Measure clips on all kinds of scenes by some seeds, and print a line for each."""
    found = []
    for name in clips:
        file = MOCAP / f"{name}.bvh"
        clip = load_clip(file if file.is_file() else name)
        for kind in kinds or tuple(KINDS):
            for seed in seeds:
                found.append(measure(name, clip, kind, seed))
                print_line(f"{name:8} {found[-1].scene:16} {found[-1].line}")
    return found


def summary(what: str, found: Sequence[Footing]) -> list[Figure]:
    """Return the share of pairs that reach every bar, for each kind of scene."""
    figures = []
    for kind in KINDS:
        mine = [one for one in found if one.scene.rstrip("0123456789") == kind]
        if mine:
            share = 100.0 * sum(not one.broken for one in mine) / len(mine)
            figures.append(
                Figure("footing", f"{kind}, {what}: pairs in every bar", share, "%", least=SHARE)
            )
    return figures
