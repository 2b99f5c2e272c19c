"""Fit the coefficients of the built-in walk to recorded walks.

    python scripts/fit_gait.py ../shared/mocap/bvh

Strides are cut at heel strikes, brought to one length, turned to walk along x, averaged with their
mirror images (so that left and right are the same, half a cycle apart), each walker counting the
same, and written as Fourier coefficients to mjmotion/clips/gait.json.
"""

from __future__ import annotations

import argparse
import itertools
import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.motion import Motion
from mjmotion.clips import load_clip
from mjmotion.footsteps.contacts import detect_contacts
from mjmotion.numerics.rotations import continuous, log, multiply, rotate, yaw_quat

Array = NDArray[np.float64]

RECORDINGS = {  # walker: clips
    "02": ("02_01",),
    "07": ("07_01",),
    "12": ("12_01_other_rig",),
    "16": ("16_58", "16_31", "16_34"),
}
CREDIT = (
    "Fitted to recordings from mocap.cs.cmu.edu. The database was created with funding from"
    " NSF EIA-0196217."
)
SAMPLES = 128  # of one cycle
HARMONICS_LEG, HARMONICS = 8, 4
DURATION = (0.9, 1.4)  # of a stride of steady walking [s]
SPEED = (0.9, 1.6)  # [m/s]
STEADY = 0.15  # greatest change of speed from one half of a stride to the other
CENTRE = ("spine", "neck", "head")
LIMB = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
_FLIP = np.array((-1.0, 1.0, -1.0))  # a rotation vector in the mirror; -_FLIP for a place


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="where the .bvh recordings are")
    default = Path(__file__).parents[1] / "mjmotion" / "clips" / "gait.json"
    parser.add_argument("--out", type=Path, default=default)
    options = parser.parse_args()
    walkers, facts = [], []
    for walker, clips in RECORDINGS.items():
        strides = []
        for clip in clips:
            motion = load_clip(options.folder / f"{clip}.bvh")
            for cycle, fact in find_strides(motion):
                strides.append(cycle)
                facts.append(fact)
        print(f"walker {walker}: {len(strides)} strides")
        walkers.append({name: np.mean([s[name] for s in strides], axis=0) for name in strides[0]})
    mean = {name: np.mean([w[name] for w in walkers], axis=0) for name in walkers[0]}
    mean = symmetric(mean)
    table = {
        "credit": CREDIT,
        "speed": round(float(np.mean([f["speed"] for f in facts])), 3),
        "stride": round(float(np.mean([f["stride"] for f in facts])), 3),
        "channels": {
            name: coefficients(values, name)
            for name, values in mean.items()
            if not name.startswith("right_")
        },
    }
    options.out.write_text(layout(table), encoding="utf-8")
    print(f"{len(facts)} strides, {table['speed']} m/s, {table['stride']} m")
    print(options.out)


def find_strides(motion: Motion) -> list[tuple[dict[str, Array], dict[str, float]]]:
    """Return the steady strides of both feet, each as begun by the left, with their figures."""
    contacts = detect_contacts(motion)
    found = []
    for side in ("left", "right"):
        heel = [c for c in contacts if c.site == f"{side}_heel"]
        for first, second in itertools.pairwise(heel):
            if first.start == 0:
                continue
            start, end = first.start, second.start
            middle = (start + end) // 2
            at = motion.qpos[[start, middle, end], :2]
            duration = (end - start) / motion.fps
            stride = float(np.linalg.norm(at[2] - at[0]))
            halves = np.linalg.norm(np.diff(at, axis=0), axis=1)
            if not DURATION[0] < duration < DURATION[1]:
                continue
            if not SPEED[0] < stride / duration < SPEED[1]:
                continue
            if abs(halves[1] - halves[0]) / halves.mean() > STEADY:
                continue
            fact = {"speed": stride / duration, "stride": stride}
            cycle = one_cycle(motion, start, end)
            if side == "right":
                cycle = mirrored(cycle)
            found.append((cycle, fact))
    return found


def one_cycle(motion: Motion, start: int, end: int) -> dict[str, Array]:
    """Return channel to (SAMPLES, 1 or 3) over one stride, along x, from its heel strike on."""
    frames = np.linspace(start, end, SAMPLES + 1)
    every = np.arange(motion.nframe)

    def at(values: Array) -> Array:
        return np.stack([np.interp(frames, every, column) for column in values.T], axis=-1)

    root = motion.qpos[:, :3]
    way = root[end, :2] - root[start, :2]
    heading = np.arctan2(way[1], way[0])
    back = np.broadcast_to(yaw_quat(np.array(-heading)), (motion.nframe, 4))
    cycle = {
        "root_position": at(rotate(back, root)),
        "root_rotation": at(log(multiply(back, continuous(motion.qpos[:, 3:7])))),
    }
    model = motion.model
    names = CENTRE + tuple(f"{side}_{part}" for side in ("left", "right") for part in LIMB)
    for name in names:
        address = int(model.joint(name).qposadr[0])
        if name.endswith(("knee", "elbow")):
            cycle[name] = at(motion.qpos[:, address : address + 1])
        else:
            cycle[name] = at(log(continuous(motion.qpos[:, address : address + 4])))
    # What changes from one heel strike to the next (progress, drift) is taken out evenly.
    ramp = np.linspace(0.0, 1.0, SAMPLES + 1)[:, None]
    for name, values in cycle.items():
        level = values - ramp * (values[-1] - values[0])
        if name == "root_position":
            level[:, :2] -= level[:-1, :2].mean(axis=0)
        cycle[name] = level[:-1]
    return cycle


def mirrored(cycle: dict[str, Array]) -> dict[str, Array]:
    """Return the cycle in the mirror: left is right."""
    result = {}
    for name, values in cycle.items():
        if name.startswith(("left_", "right_")):
            side, part = name.split("_")
            name = f"{'right' if side == 'left' else 'left'}_{part}"
        sign = -_FLIP if name == "root_position" else _FLIP
        result[name] = values if values.shape[1] == 1 else values * sign
    return result


def symmetric(cycle: dict[str, Array]) -> dict[str, Array]:
    """Return the mean of the cycle and its mirror image half a cycle later."""
    other = mirrored(cycle)
    return {
        name: 0.5 * (values + np.roll(other[name], SAMPLES // 2, axis=0))
        for name, values in cycle.items()
    }


def coefficients(values: Array, name: str) -> list[list[float]]:
    """Return (columns) x (mean, cos 1, sin 1, cos 2, sin 2, ...) [m or rad]."""
    leg = name.endswith(("hip", "knee", "ankle"))
    spectrum = np.fft.rfft(values, axis=0) / len(values)
    rows = []
    for column in spectrum.T:
        row = [column[0].real]
        for harmonic in column[1 : 1 + (HARMONICS_LEG if leg else HARMONICS)]:
            row += [2.0 * harmonic.real, -2.0 * harmonic.imag]
        rows.append([round(float(value), 5) + 0.0 for value in row])
    return rows


def layout(table: dict[str, object]) -> str:
    """Return the table as JSON with one row of coefficients a line."""
    channels = table["channels"]
    assert isinstance(channels, dict)
    head = json.dumps({k: v for k, v in table.items() if k != "channels"}, indent=2)
    parts = []
    for name, rows in channels.items():
        lines = ",\n      ".join(json.dumps(row) for row in rows)
        parts.append(f'    "{name}": [\n      {lines}\n    ]')
    return head.rstrip("}\n ") + ',\n  "channels": {\n' + ",\n".join(parts) + "\n  }\n}\n"


if __name__ == "__main__":
    main()
