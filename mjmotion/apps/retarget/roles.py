"""Joint angles for a body of another make: its bones point where the motion's bones point.

    robot = with_soles(Character.load("g1.xml"))     # sites heel, toe and foot where it lacks them
    guess = map_bones(motion, robot)

Where joints are other joints, such as three hinges for a ball, angles cannot be copied. What two
bodies have in common are the roles of their bones: thighs, shanks and feet, upper arms and
forearms, pelvis, chest and head. Knees, ankles, elbows and wrists get places from the directions of
the motion's bones and the lengths of the body's own; pelvis, chest, head and feet turn from their
rest as the motion's do. The numeric solver finds the angles, every frame on its own.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mjmotion.apps.retarget.rest import BAND, SIDES, RestBody, world
from mjmotion.body.character import Character
from mjmotion.body.geom_points import body_points
from mjmotion.body.kinematics import Kinematics, Pose
from mjmotion.body.motion import Motion
from mjmotion.body.parts import LimbParts, Parts
from mjmotion.constraints import SiteConstraint, lay_out
from mjmotion.exceptions import ModelError
from mjmotion.ik.numeric import NumericIK
from mjmotion.ik.solver import default_rigidity
from mjmotion.numerics.rotations import from_matrix, normalized
from mjmotion.numerics.tangent import oplus

Array = NDArray[np.float64]

_FIRM = 0.99  # weight of a bone's direction: bodies differ, and their joints decide in the end
_LOOSE = 0.8  # of how feet and head are turned
_STEPS = 30  # Gauss–Newton steps from rest
_ROOTED = 1e9  # rigidity of a root that has its pose already


def with_soles(character: Character) -> Character:
    """Return a humanoid with sites ``<side>_heel``, ``_toe`` and ``_foot`` on its soles.

    Sites of those names that are on its feet already stay.

    Raises:
      ModelError: a foot that nothing of which collides, or a site of such a name elsewhere.
    """
    spec = character.spec.copy()
    spec.compile()  # numbers the copy's bodies as the model's
    rest = RestBody(character)
    bodies = {body.id: body for body in spec.bodies}
    owners = {site.name: site.parent.id for site in spec.sites}  # adding a site takes ids away
    for side in SIDES:
        leg = rest.limbs[f"{side}_leg"]
        sole = rest.sole(leg)
        foot = _carrying(rest, leg, sole)
        along, across = sole @ rest.forward, sole @ rest.left
        middle = (across.min() + across.max()) / 2
        places = {
            "heel": along.min(),
            "toe": along.max(),
            "foot": float(np.clip(leg.points[2] @ rest.forward, along.min(), along.max())),
        }
        for part, ahead in places.items():
            name = f"{side}_{part}"
            if name in owners:
                if owners[name] not in leg.bodies:
                    raise ModelError(f"site '{name}' is not on the {side} leg: name it otherwise")
                continue
            point = ahead * rest.forward + middle * rest.left
            point[2] = sole[:, 2].min()
            turn = rest.xmat[foot].T @ rest.frame
            bodies[foot].add_site(
                name=name, pos=rest.local(foot, point), quat=from_matrix(turn), group=4
            )
    return Character(spec.compile(), spec, character.name)


def _carrying(rest: RestBody, leg: LimbParts, sole: Array) -> int:
    """Return the body of a leg whose surface the sole is."""
    for body in reversed(leg.bodies):
        try:
            points = body_points(rest.model, body) @ rest.xmat[body].T + rest.xpos[body]
        except ModelError:
            continue
        if points[:, 2].min() < sole[:, 2].min() + BAND:
            return body
    raise ModelError("a leg has no geom that collides: it has no sole to stand on")


def map_bones(motion: Motion, character: Character) -> Motion:
    """Return a motion for a body of another make, its bones pointing as the motion's do.

    The root is where the motion's is; :func:`carry_root` carries it.

    Args:
      motion: the motion.
      character: the other body, alone.

    Raises:
      ModelError: one of the two has no legs, or the other has no knees.
    """
    model = character.model
    rest, theirs = RestBody(character), RestBody(motion.character)
    marked, turned = _marked(character, rest)
    pose = Kinematics(motion.model, motion.nframe).forward(motion.qpos)
    aligned = rest.frame @ theirs.frame.T  # turns their rest's facing on to ours
    qpos = np.tile(model.qpos0, (motion.nframe, 1))
    qpos[:, :3] = motion.qpos[:, :3]
    others = _turned(theirs.parts, theirs)
    root = int(model.jnt_bodyid[0])
    qpos[:, 3:7] = from_matrix(_follow(pose, theirs, others["pelvis"], aligned, rest, root))
    rigidity = default_rigidity(marked.model)
    rigidity[:6] = _ROOTED
    wanted = []
    frames = np.arange(motion.nframe)
    for name in turned.keys() & others.keys() - {"pelvis"}:
        turn = _follow(pose, theirs, others[name], aligned, rest, turned[name])
        weight = _FIRM if name == "chest" else _LOOSE
        wanted.append(SiteConstraint(f"role/{name}", frames, None, from_matrix(turn), weight))
    # The trunk first: only then is it known where the shoulders are.
    solver = NumericIK(marked, rigidity, iterations=_STEPS)
    trunk = [one for one in wanted if one.site in ("role/chest", "role/head")]
    start = _solved(solver, qpos, trunk)
    reached = Kinematics(marked.model, motion.nframe).forward(start)
    for name, limb in rest.limbs.items():
        if name not in theirs.limbs:
            continue
        lines = [world(pose, *joint) for joint in theirs.joints(theirs.limbs[name])]
        joint = world(reached, *rest.joints(limb)[0])
        lengths = np.linalg.norm(np.diff(limb.points, axis=0), axis=1)
        for part, before, after, length in zip(
            ("mid", "end"), lines[:-1], lines[1:], lengths, strict=True
        ):
            joint = joint + length * normalized(after - before)
            wanted.append(SiteConstraint(f"role/{name}_{part}", frames, joint, None, _FIRM))
    qpos = _solved(solver, qpos, wanted)
    return Motion(character, character.limits.clamp(qpos), motion.fps)


def _marked(character: Character, rest: RestBody) -> tuple[Character, dict[str, int]]:
    """Return the character with a site for every role, and the bodies whose turn is followed."""
    spec = character.spec.copy()
    spec.compile()  # numbers the copy's bodies as the model's
    bodies = {body.id: body for body in spec.bodies}
    marks: dict[str, tuple[int, Array]] = {}
    for name, limb in rest.limbs.items():
        if not limb.lower:
            raise ModelError("a limb of the other model has no knee or elbow: nothing maps to it")
        for part, (body, point) in zip(("mid", "end"), rest.joints(limb)[1:], strict=True):
            marks[f"{name}_{part}"] = (body, point)
    turned = _turned(rest.parts, rest)
    for name, body in turned.items():
        marks[name] = (body, np.zeros(3))
    for name, (body, point) in marks.items():
        bodies[body].add_site(name=f"role/{name}", pos=point)
    return Character(spec.compile(), spec, character.name), turned


def _turned(parts: Parts, rest: RestBody) -> dict[str, int]:
    """Bodies whose turn from rest is followed: pelvis, chest, head and feet."""
    bodies = {"pelvis": rest.base(parts.legs[0])}
    if parts.arms:
        bodies["chest"] = rest.base(parts.arms[0])
    if parts.head:
        bodies["head"] = parts.head[-1]
    for side in SIDES:
        leg = rest.limbs[f"{side}_leg"]
        if leg.end:
            bodies[f"{side}_foot"] = leg.end[-1]
    if bodies.get("chest") == bodies["pelvis"]:
        del bodies["chest"]
    return bodies


def _follow(
    pose: Pose, theirs: RestBody, their_body: int, aligned: Array, rest: RestBody, body: int
) -> Array:
    """Orientations (nframe, 3, 3) of a body that turns from its rest as theirs does."""
    turn = pose.xmat[:, their_body] @ theirs.xmat[their_body].T
    return np.asarray(turn @ aligned.T @ rest.xmat[body])


def _solved(solver: NumericIK, qpos: Array, wanted: list[SiteConstraint]) -> Array:
    if not wanted:
        return qpos
    targets = lay_out(wanted, solver.model, len(qpos))
    return oplus(solver.model, qpos, solver.prepare(targets).solve(qpos).displacement)
