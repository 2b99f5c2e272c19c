"""Figures of a climb: how near holds are to the rope, and how far all else keeps from it.

Drift, jerk and joint limits are the validation's own; a rope is no ground to stand on, so its other
figures say nothing here.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.apps.rope.points import RopePoints, nearest_on_rope, rope_points
from mjmotion.body.kinematics import Kinematics, Pose, character_geoms, site_id
from mjmotion.body.motion import Motion
from mjmotion.clips.climb_grip import Grip
from mjmotion.clips.climb_plan import Hold

Array = NDArray[np.float64]

HELD_MM, FREE_MM, DRIFT_MM, LIMIT_RAD = 5.0, 0.0, 1.0, 1e-4  # what the figures should keep to
_FAR = 0.25  # distances are not looked for beyond this [m]


@dataclasses.dataclass(frozen=True)
class RopeFigures:
    """What was measured of one climber and its rope.

    Attributes:
      held_mm: greatest distance of a held point from the rope's centre line, any frame.
      free_mm: least distance between the rope and a part of the body that does not hold it;
        negative where it is inside.
      free_part, free_frame: which geom that is, and when.
      drift_mm: greatest distance of a held site from its mean over the hold.
      limit_rad: greatest excess over a joint's range.
      swing_mm: how far the rope's lower end swings, across.
      bend_deg: the sharpest angle between neighbouring edges of the rope.
    """

    held_mm: float
    free_mm: float
    free_part: str
    free_frame: int
    drift_mm: float
    limit_rad: float
    swing_mm: float
    bend_deg: float

    def broken(self) -> list[str]:
        """Return one line for every figure that is not what it should be."""
        lines = []
        if self.held_mm > HELD_MM:
            lines.append(f"held_mm is {self.held_mm:.3g}, wanted <= {HELD_MM:g}")
        if self.free_mm < FREE_MM:
            where = f"{self.free_part} at frame {self.free_frame}"
            lines.append(f"free_mm is {self.free_mm:.3g}, wanted >= {FREE_MM:g} ({where})")
        if self.drift_mm > DRIFT_MM:
            lines.append(f"drift_mm is {self.drift_mm:.3g}, wanted <= {DRIFT_MM:g}")
        if self.limit_rad > LIMIT_RAD:
            lines.append(f"limit_rad is {self.limit_rad:.3g}, wanted <= {LIMIT_RAD:g}")
        return lines


def measure(motion: Motion, holds: Sequence[Hold], grips: Mapping[str, Grip]) -> RopeFigures:
    """Measure a climber and its rope.

    Args:
      motion: both in one.
      holds: who holds what when.
      grips: how this character's hands and feet lie against the rope.
    """
    model, rope = motion.model, rope_points(motion.model)
    points = rope.positions(motion.qpos)
    pose = Kinematics(model, motion.nframe, geoms=True).forward(motion.qpos)
    held, drift = 0.0, 0.0
    for hold in holds:
        frames = np.arange(hold.start, hold.end)
        site = site_id(model, hold.site)
        place = pose.site_xpos[frames, site]
        drift = max(drift, float(np.linalg.norm(place - place.mean(axis=0), axis=1).max()))
        grip = place + pose.site_xmat[frames, site] @ grips[hold.site].to_rope
        held = max(held, float(nearest_on_rope(points[frames], grip)[0].max()))
    gap, geom, frame = least_distance(motion.character.spec, rope, pose, points, holds)
    edges = np.diff(points, axis=1)
    edges /= np.linalg.norm(edges, axis=2, keepdims=True)
    bend = np.arccos(np.clip((edges[:, 1:] * edges[:, :-1]).sum(axis=2), -1.0, 1.0))
    tip = points[:, -1, :2]
    return RopeFigures(
        held_mm=1000.0 * held,
        free_mm=1000.0 * gap,
        free_part=_name(model, geom),
        free_frame=frame,
        drift_mm=1000.0 * drift,
        limit_rad=float(motion.character.limits.excess(motion.qpos).max(initial=0.0)),
        swing_mm=1000.0 * float(np.linalg.norm(np.ptp(tip, axis=0))),
        bend_deg=float(np.degrees(bend.max(initial=0.0))),
    )


def least_distance(
    spec: mujoco.MjSpec, rope: RopePoints, pose: Pose, points: Array, holds: Sequence[Hold]
) -> tuple[float, int, int]:
    """Return the least distance [m] of the rope to what does not hold it, the geom and the frame.

    A hand or foot is left out, whole, at the frames of its holds.
    """
    model = pose.model
    geoms = character_geoms(model)
    free = np.ones((len(points), len(geoms)), dtype=bool)
    for hold in holds:
        body = model.site_bodyid[site_id(model, hold.site)]
        free[hold.start : hold.end, model.geom_bodyid[geoms] == body] = False
    assert pose.geom_xpos is not None
    # Spheres around geoms first: few pairs are near enough to be measured.
    rough = np.full(free.shape, np.inf)
    for column, geom in enumerate(geoms):
        apart, _ = nearest_on_rope(points, pose.geom_xpos[:, geom])
        rough[:, column] = apart - model.geom_rbound[geom] - rope.radius
    rough[~free] = np.inf
    probe = _Probe(spec, rope, pose, points)
    best, worst_geom, worst_frame = _FAR, -1, -1
    order = np.argsort(rough, axis=None)
    for frame, column in zip(*np.unravel_index(order, rough.shape), strict=True):
        if rough[frame, column] >= best:
            break
        gap = probe.distance(int(geoms[column]), int(frame), best)
        if gap < best:
            best, worst_geom, worst_frame = gap, int(geoms[column]), int(frame)
    return best, worst_geom, worst_frame


class _Probe:
    """A capsule that stands for one edge of the rope after the other."""

    def __init__(self, spec: mujoco.MjSpec, rope: RopePoints, pose: Pose, points: Array) -> None:
        spec = spec.copy()
        body = spec.worldbody.add_body(mocap=True)  # last, so that no other id changes
        half = 0.5 * float(np.diff(rope.along).max())
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=(rope.radius, half, 0.0))
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self.geom = self.model.ngeom - 1
        self.pose, self.middle = pose, 0.5 * (points[:, 1:] + points[:, :-1])
        self.step, self.around = np.diff(points, axis=1), rope.radius + half

    def distance(self, geom: int, frame: int, most: float) -> float:
        """Return the distance of a geom to the rope at a frame, or ``most`` if that is less [m]."""
        assert self.pose.geom_xpos is not None and self.pose.geom_xmat is not None
        data, model = self.data, self.model
        place = self.pose.geom_xpos[frame, geom]
        data.geom_xpos[geom] = place
        data.geom_xmat[geom] = self.pose.geom_xmat[frame, geom].ravel()
        apart = np.linalg.norm(self.middle[frame] - place, axis=1)
        near = np.flatnonzero(apart - self.around - model.geom_rbound[geom] < most)
        for edge in near:
            quat, matrix = np.empty(4), np.empty(9)
            mujoco.mju_quatZ2Vec(quat, self.step[frame, edge])
            mujoco.mju_quat2Mat(matrix, quat)
            data.geom_xpos[self.geom], data.geom_xmat[self.geom] = self.middle[frame, edge], matrix
            most = min(
                most,
                mujoco.mj_geomDistance(model, data, geom, self.geom, most + 1e-3, np.zeros(6)),
            )
        return most


def _name(model: mujoco.MjModel, geom: int) -> str:
    if geom < 0:
        return "nothing near"
    own = model.geom(geom).name
    return own or f"a geom of {model.body(model.geom_bodyid[geom]).name}"
