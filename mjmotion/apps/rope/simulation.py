"""The rope simulated by MuJoCo against a climber who moves as given.

    states = simulate(model_spec, motion, holds)        # (nframe, 3 * points): the rope's qpos

The climber is moved, and cannot be moved by the rope. Where hands and feet hold the rope, equality
constraints that are on from the grasp to the release keep it where they are; all other parts of the
body push it away. In the last moment before a grasp the hand draws the rope in.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.apps.rope.grasps import places_along
from mjmotion.apps.rope.points import RopePoints, rope_points
from mjmotion.body.kinematics import character_geoms
from mjmotion.body.motion import Motion
from mjmotion.clips.climb_plan import Hold
from mjmotion.exceptions import FitError
from mjmotion.numerics.progress import Progress, no_progress
from mjmotion.numerics.tangent import ominus

Array = NDArray[np.float64]

SETTLE = 2.0  # the rope comes to rest in the first hold for this long before the first frame [s]
DRAW = 4.0  # frames before a grasp from which a hand draws the rope in
_HEAVY = 1e8  # inertia of a body that a rope does not move
_MARGIN = 0.004  # bodies push the rope from this distance on [m]
_HELD = (0.004, 1.0)  # solref of a hold
_HELD_IMPEDANCE = (0.995, 0.9999, 0.001, 0.5, 2.0)
_AXES = "xyz"


def simulate(
    spec: mujoco.MjSpec,
    motion: Motion,
    holds: Sequence[Hold],
    progress: Progress = no_progress,
) -> Array:
    """Return the poses (nframe, nq) of climber and rope in one.

    Args:
      spec: character and rope in one; the character's joints come first. It is not changed.
      motion: the climber's motion, on the character alone or on ``spec``'s model.
      holds: who holds what of the rope when.
      progress: called with ``"rope"``, frames done and frames in all.

    Raises:
      ModelError: there is no rope in ``spec``.
      ConstraintError: a hold is out of the rope's reach.
      FitError: the simulation went astray.
    """
    bare = spec.copy().compile()
    rope = rope_points(bare)
    along = places_along(holds, rope.rest[0], rope.length)
    model = _with_holds(spec, rope, along)
    nq = motion.model.nq if motion.model.nq < bare.nq else int(rope.address.min())
    return _Simulation(model, rope, holds, along, motion.qpos[:, :nq], motion.fps).run(progress)


def _with_holds(spec: mujoco.MjSpec, rope: RopePoints, along: Array) -> mujoco.MjModel:
    """Return the model with an equality, off as yet, for every hold and axis; bodies immovable.

    A place between two points of the rope is a fixed tendon over their slides.
    """
    spec = spec.copy()
    for joint in spec.joints:
        if not joint.name.startswith("rope"):
            joint.armature = _HEAVY
            joint.limited = mujoco.mjtLimited.mjLIMITED_FALSE
    for flex in spec.flexes:
        flex.margin = _MARGIN
    for number, place in enumerate(along):
        edge, share = rope.share(float(place))
        for axis in _AXES:
            tendon = spec.add_tendon(name=f"hold{number}_{axis}")
            for point, weight in ((edge, 1.0 - share), (edge + 1, share)):
                if point > 0:
                    tendon.wrap_joint(f"rope{point}_{axis}", weight)
            spec.add_equality(
                name=f"hold{number}_{axis}",
                type=mujoco.mjtEq.mjEQ_TENDON,
                objtype=mujoco.mjtObj.mjOBJ_TENDON,
                name1=f"hold{number}_{axis}",
                active=False,
                solref=_HELD,
                solimp=_HELD_IMPEDANCE,
            )
    return spec.compile()


class _Simulation:
    """One run: the rope's state, and who holds it."""

    def __init__(
        self,
        model: mujoco.MjModel,
        rope: RopePoints,
        holds: Sequence[Hold],
        along: Array,
        qpos: Array,
        fps: float,
    ) -> None:
        self.model, self.rope, self.holds, self.along = model, rope, holds, along
        self.data = mujoco.MjData(model)
        self.fps, self.nq = fps, qpos.shape[1]
        self.steps = max(1, round(1.0 / fps / model.opt.timestep))
        model.opt.timestep = 1.0 / fps / self.steps
        whole = np.tile(model.qpos0, (len(qpos), 1))
        whole[:, : self.nq] = qpos
        self.whole = whole
        self.nv = int(model.jnt_dofadr[model.joint("rope1_x").id])
        self.velocity = np.zeros((len(qpos), self.nv))
        if len(qpos) > 1:
            self.velocity[:-1] = ominus(model, whole[1:], whole[:-1])[:, : self.nv] * fps
        self.rest = np.array([rope.at(rope.rest, float(place)) for place in along])
        self.rows = np.array(
            [[model.equality(f"hold{i}_{axis}").id for axis in _AXES] for i in range(len(holds))]
        )
        self.geoms = [
            [
                geom
                for geom in character_geoms(model)
                if model.geom_bodyid[geom] == model.site_bodyid[model.site(hold.site).id]
            ]
            for hold in holds
        ]
        self.collide = model.geom_conaffinity.copy()
        self.drawn: dict[int, tuple[Array, Array]] = {}

    def run(self, progress: Progress) -> Array:
        """Return the poses (nframe, nq) of all frames."""
        count = len(self.whole)
        self._settle()
        poses = np.empty_like(self.whole)
        for frame in range(count):
            poses[frame] = self.data.qpos
            poses[frame, : self.nq] = self.whole[frame, : self.nq]
            for step in range(self.steps if frame + 1 < count else 0):
                self._step(frame, step / self.steps)
            progress("rope", frame + 1, count)
        if not np.isfinite(poses).all() or any(warning.number for warning in self.data.warning):
            bad = np.flatnonzero(~np.isfinite(poses).all(axis=1))
            raise FitError("the rope's simulation went astray: make its edges longer", bad)
        return poses

    def _settle(self) -> None:
        """Let the rope come to rest, held and pushed as in the first frame."""
        self.data.qpos[:] = self.whole[0]
        for step in range(round(SETTLE * self.fps * self.steps)):
            self._step(0, 0.0, moving=False, drawn=min(1.0, step / (0.5 * self.fps * self.steps)))

    def _step(self, frame: int, part: float, *, moving: bool = True, drawn: float = 1.0) -> None:
        """Simulate one step, the climber ``part`` of the way from ``frame`` to the next."""
        data, nv = self.data, self.nv
        data.qpos[: self.nq] = self.whole[frame, : self.nq]
        data.qvel[:nv] = self.velocity[frame] if moving else 0.0
        if part > 0.0:
            pose, step = self.whole[frame].copy(), np.zeros(self.model.nv)
            step[:nv] = self.velocity[frame]
            mujoco.mj_integratePos(self.model, pose, step, part / self.fps)
            data.qpos[: self.nq] = pose[: self.nq]
        self._hold(frame + part, drawn)
        mujoco.mj_step(self.model, data)

    def _hold(self, now: float, drawn: float) -> None:
        """Switch the holds of the moment ``now`` [frames] on, and all others off."""
        self.model.geom_conaffinity[:] = self.collide
        for index, hold in enumerate(self.holds):
            on = hold.start - DRAW < now < hold.end - 0.5
            self.data.eq_active[self.rows[index]] = on
            if not on:
                self.drawn.pop(index, None)
                continue
            self.model.geom_conaffinity[self.geoms[index]] = 0
            if index not in self.drawn:
                self.drawn[index] = self._state(index)
            if drawn < 1.0:
                place = _towards(self.drawn[index], hold.point, drawn, 0.5)
            else:
                part = 1.0 - (hold.start - now) / DRAW
                place = _towards(self.drawn[index], hold.point, part, DRAW / self.fps)
            self.model.eq_data[self.rows[index], 0] = place - self.rest[index]

    def _state(self, index: int) -> tuple[Array, Array]:
        """Return where the place that a hold takes is [m], and how fast it moves [m/s]."""
        edge, share = self.rope.share(float(self.along[index]))
        position = self.rope.at(self.rope.positions(self.data.qpos), float(self.along[index]))
        velocity = np.zeros(3)
        for point, weight in ((edge, 1.0 - share), (edge + 1, share)):
            if point > 0:
                first = self.model.jnt_dofadr[self.model.joint(f"rope{point}_x").id]
                velocity += weight * self.data.qvel[first : first + 3]
        return position, velocity


def _towards(state: tuple[Array, Array], goal: Array, part: float, time: float) -> Array:
    """Return the point ``part`` of the way from a moving state to rest at ``goal``.

    The quintic with the state's velocity and no acceleration at its begin, none of both at its end.
    """
    if part >= 1.0:
        return goal
    position, velocity = state
    u = part
    rest = u**3 * (10.0 - 15.0 * u + 6.0 * u * u)
    swing = u - u**3 * (6.0 - 8.0 * u + 3.0 * u * u)
    return np.asarray(position + rest * (goal - position) + swing * time * velocity)
