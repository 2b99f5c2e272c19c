"""The built-in rope climb: its schedule, its constraints, and how it looks in numbers."""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import mujoco
import numpy as np
import pytest
from made_up import humanoid, mixed, some

from mjmotion.body.kinematics import Kinematics, site_id
from mjmotion.body.motion import Motion
from mjmotion.clips import load_clip
from mjmotion.clips.climb import climb_constraints, climb_contacts, make_climb
from mjmotion.clips.climb_grip import FEET, HANDS, LIMBS, find_grips
from mjmotion.clips.climb_plan import FRAMES, RISE, hold_constraints, limb_path, plan_holds
from mjmotion.exceptions import ModelError
from mjmotion.footsteps.contacts import check_contacts, contact_mask
from mjmotion.numerics.rotations import conjugate, log, multiply, rotate


@cache
def climb() -> Motion:
    return make_climb(humanoid())


def held() -> dict[str, np.ndarray]:
    return {site: contact_mask(climb_contacts(), site, FRAMES) for site in LIMBS}


def test_it_is_the_papers_clip() -> None:
    motion = load_clip("climb", humanoid())
    assert (motion.nframe, motion.fps) == (275, 30.0)
    constraints = climb_constraints(humanoid())
    assert sum(constraint.nscalar for constraint in constraints) == 5898
    assert sum(contact.end - contact.start for contact in climb_contacts()) == 983
    assert check_contacts(climb_contacts(), humanoid(), 275) == climb_contacts()


def test_it_is_a_climb() -> None:
    on = held()
    assert all(on[hand][0] for hand in HANDS)  # it starts from a hang by both hands
    assert not any(on[foot][0] for foot in FEET)
    holding = np.sum([mask.astype(int) for mask in on.values()], axis=0)
    assert holding.min() >= 2  # the feet go while both hands hold, a hand while all else does
    assert (on["left_hand"] | on["right_hand"]).all()
    assert (on["left_foot"] == on["right_foot"]).all()
    assert all(on[hand][~on["left_foot"]].all() for hand in HANDS)
    # Hand over hand, and every hold the same way up.
    reaches = sorted(
        (contact.start, contact.site)
        for contact in climb_contacts()
        if contact.site in HANDS and contact.start > 0
    )
    assert all(a[1] != b[1] for a, b in pairwise(reaches))
    for site in LIMBS:
        heights = [hold.point[2] for hold in plan_holds() if hold.site == site]
        np.testing.assert_allclose(np.diff(heights), RISE)
    assert 0.9 < np.ptp(climb().qpos[:, 2]) < 1.4


def test_constraints_hold_in_the_clip() -> None:
    motion = climb()
    pose = Kinematics(motion.model, motion.nframe).forward(motion.qpos)
    for constraint in climb_constraints(motion.model):
        site = site_id(motion.model, constraint.site)
        gap = pose.site_xpos[constraint.frames, site] - constraint.position
        assert np.linalg.norm(gap, axis=1).max() < 1e-6
        quat = pose.xquat[constraint.frames, motion.model.site_bodyid[site]]
        turned = log(multiply(conjugate(np.broadcast_to(some(constraint.quat), quat.shape)), quat))
        assert np.linalg.norm(turned, axis=1).max() < 1e-6


def test_the_body_allows_it() -> None:
    motion = climb()
    assert motion.character.limits.excess(motion.qpos).max() < 1e-9
    speed = np.linalg.norm(np.diff(motion.qpos[:, :3], axis=0), axis=1) * motion.fps
    assert speed.max() < 1.0


@pytest.mark.parametrize("site", LIMBS)
def test_ways_between_holds_are_smooth_and_keep_off_the_rope(site: str) -> None:
    holds, grip = plan_holds(), find_grips(humanoid())[site]
    position, quat = limb_path(site, holds, grip, FRAMES)
    point = position + rotate(quat, np.broadcast_to(grip.to_rope, position.shape))
    on = held()[site]
    side = 1.0 if site.startswith("left") else -1.0
    home = np.median(point[on], axis=0)
    away = side * (point[:, 1] - home[1])
    assert away.min() > -1e-9  # never through the rope to the other side
    gaps = [(a.end - 1, b.start) for a, b in pairwise(h for h in holds if h.site == site)]
    assert gaps
    for start, end in gaps:  # the last frame of a hold and the first of the next
        assert away[start:end].max() > 0.05
        # Acceleration begins and ends at nothing: with quintic ease it is linear in time there.
        bend = np.linalg.norm(np.diff(point[start - 1 : end + 2], n=2, axis=0), axis=1)
        assert max(bend[0], bend[-1]) < 0.4 * bend.max()


def test_rope_touches_skin_and_does_not_enter_it() -> None:
    """Measured with MuJoCo on the whole character, standing, turned so that the limb holds."""
    model = humanoid()
    for site, grip in find_grips(model).items():
        assert abs(np.linalg.norm(grip.quat) - 1.0) < 1e-12
        least = _distance_to_rope(site, grip.quat, grip.to_rope)
        assert 0.001 < least < 0.003, site
        assert _distance_to_rope(site, grip.quat, 0.9 * grip.to_rope) < least


def _distance_to_rope(site: str, quat: np.ndarray, to_rope: np.ndarray) -> float:
    """Least distance [m] of a rope to the geoms of the body of ``site`` of the humanoid."""
    from mjmotion.body.assets import find_asset

    spec = mujoco.MjSpec.from_file(str(find_asset("model", "humanoid")))
    rope = spec.worldbody.add_body(name="rope", mocap=True)
    rope.add_geom(name="rope", type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=(0.018, 0.3, 0.0))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    index = model.site(site).id
    up = rotate(conjugate(quat), np.array((0.0, 0.0, 1.0)))
    data.mocap_pos[0] = data.site_xpos[index] + to_rope  # every body is upright at qpos0
    mujoco.mju_quatZ2Vec(data.mocap_quat[0], up)
    mujoco.mj_kinematics(model, data)
    geoms = np.flatnonzero(model.geom_bodyid == model.site_bodyid[index])
    return min(
        mujoco.mj_geomDistance(model, data, model.geom("rope").id, int(geom), 1.0, np.zeros(6))
        for geom in geoms
    )


def test_another_rope_another_grip() -> None:
    thin, thick = find_grips(humanoid(), 0.012), find_grips(humanoid(), 0.022)
    for site in LIMBS:
        more = np.linalg.norm(thick[site].to_rope - thin[site].to_rope)
        assert 0.008 < more < 0.013, site
    moved = hold_constraints(plan_holds(), thick)
    assert sum(constraint.nscalar for constraint in moved) == 5898


def test_bad_models() -> None:
    with pytest.raises(ModelError, match="left_hand"):
        make_climb(mixed())
    with pytest.raises(ModelError, match="left_hand"):
        load_clip("climb", mixed())
