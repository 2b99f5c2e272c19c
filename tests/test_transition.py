"""Transitions: overlaps found, phases warped together, blends smooth, contacts kept."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from command_line import run
from made_up import NOT_BESIDE_SOURCE, character, mixed, some

from mjmotion.apps.adaptation import adapt
from mjmotion.apps.transition import (
    Overlap,
    Warp,
    blend,
    blend_clips,
    find_overlap,
    find_warp,
    join,
    resample,
    resample_contacts,
    sample,
    transition,
)
from mjmotion.apps.transition.overlap import headings, stride_frames
from mjmotion.apps.transition.warp import hermite
from mjmotion.body.kinematics import Kinematics
from mjmotion.body.motion import Motion
from mjmotion.clips import load_clip
from mjmotion.clips.gait import STRIDE, make_walk
from mjmotion.clips.gait_plan import Segment
from mjmotion.exceptions import ClipError, ContactError
from mjmotion.footsteps.contacts import Contact, contact_mask, detect_contacts
from mjmotion.numerics.rotations import multiply, rotate, yaw_quat
from mjmotion.numerics.tangent import ominus
from mjmotion.output.reading import read_results
from mjmotion.output.result import Result
from mjmotion.paper.transition import FRAMES, make_clips, make_job, make_walk_464
from mjmotion.scene import compose, load_scene
from mjmotion.validation import Validation, validate
from mjmotion.validation.figures import joint_jerk_ratio

RECORDINGS = Path(__file__).parents[2] / "shared" / "mocap" / "bvh"
PAPER = (7.17, 4.71, 2.14, 0.74)  # greatest error of Table 1 after each level [% of height]
Clips = tuple[Motion, Motion]


@pytest.fixture(scope="module")
def clips() -> Clips:
    return make_clips(character())


@pytest.fixture(scope="module")
def joined(clips: Clips) -> Result:
    walk, sneak = clips
    return join([walk, sneak, walk])


def measured(result: Result, motion: Motion | None = None) -> Validation:
    return validate(result.source, motion or result.motion, result.contacts)


def straight(strides: float = 4.0, speed: float = 1.22, fps: float = 30.0) -> Motion:
    return make_walk(character(), segments=[Segment("straight", strides)], speed=speed, fps=fps)


def moved(motion: Motion, yaw: float, place: tuple[float, float]) -> Motion:
    """The motion elsewhere in the plane."""
    qpos, turn = np.array(motion.qpos), yaw_quat(np.full(motion.nframe, yaw))
    qpos[:, :3] = rotate(turn, qpos[:, :3]) + (*place, 0.0)
    qpos[:, 3:7] = multiply(turn, qpos[:, 3:7])
    return motion.replace(qpos)


def cut(motion: Motion, first: int, last: int) -> Motion:
    return motion.replace(motion.qpos[first:last])


def found(motion: Motion) -> tuple[Contact, ...]:
    return detect_contacts(motion)


# Between frames, and other rates


def test_whole_frames_are_sampled_as_they_are() -> None:
    motion = straight(1.0)
    back = sample(motion, np.arange(motion.nframe))
    assert np.abs(ominus(motion.model, back, motion.qpos)).max() < 1e-12


def test_between_frames_of_an_even_turn_is_half_of_it() -> None:
    model = mixed()
    qpos = np.tile(model.qpos0, (12, 1))
    angle = 0.1 * np.arange(12)
    qpos[:, 0] = 0.5 * np.arange(12)
    qpos[:, 3:7] = np.column_stack((np.cos(angle), 0 * angle, 0 * angle, np.sin(angle)))
    middle = sample(Motion(model, qpos, 30.0), [4.5])[0]
    assert middle[0] == pytest.approx(2.25)
    assert np.allclose(middle[3:7], (np.cos(0.45), 0.0, 0.0, np.sin(0.45)), atol=1e-6)


def test_a_rate_up_and_down_again_changes_nothing() -> None:
    motion = straight(1.0)
    fast = resample(motion, 120.0)
    assert fast.fps == 120.0 and fast.nframe == 4 * (motion.nframe - 1) + 1
    again = resample(fast, 30.0)
    assert np.abs(ominus(motion.model, again.qpos, motion.qpos)).max() < 1e-9


def test_contacts_follow_the_rate() -> None:
    contacts = (Contact("left_heel", 3, 9), Contact("left_toe", 5, 6))
    fast = resample_contacts(contacts, 30.0, 120.0, 40)
    assert [(c.start, c.end) for c in fast] == [(12, 36), (20, 24)]
    assert [(c.start, c.end) for c in resample_contacts(fast, 120.0, 30.0, 10)] == [(3, 9), (5, 6)]
    assert resample_contacts((Contact("left_toe", 9, 10),), 120.0, 30.0, 3) == ()


def test_no_rate_is_refused() -> None:
    with pytest.raises(ClipError, match="fps"):
        resample(straight(1.0), 0.0)


# Where


def test_clips_that_share_frames_overlap_there() -> None:
    """Two cuts of one walk, the second elsewhere and turned: joined, they are that walk again."""
    whole = straight(4.0)
    first, second = cut(whole, 0, 95), moved(cut(whole, 60, 130), 0.8, (3.0, -2.0))
    where = find_overlap(first, second, (found(first), found(second)))
    assert where.first - where.second == 60 or (where.first - where.second - 60) % 33 in (0, 1)
    both = blend_clips([first, second], overlaps=[(66, 6, 20)])
    assert both.motion.nframe == 130
    # The window is put at its first frame's place.
    there = blend_clips([whole, whole], overlaps=[(66, 66, 20)]).motion
    assert np.abs(ominus(whole.model, both.motion.qpos, there.qpos[:130])).max() < 2e-3
    assert np.abs(ominus(whole.model, there.qpos[:130], whole.qpos[:130])[:, 6:]).max() < 1e-6


def test_the_place_of_clips_in_the_plane_does_not_matter(clips: Clips) -> None:
    walk, sneak = clips
    here = blend_clips([walk, sneak])
    there = blend_clips([moved(walk, 2.0, (5.0, 1.0)), moved(sneak, -1.0, (0.0, 9.0))])
    assert there.places == here.places and there.contacts == here.contacts
    back = moved(there.motion, -2.0, (0.0, 0.0))
    change = ominus(walk.model, back.qpos, here.motion.qpos)
    assert np.ptp(change, axis=0).max() < 1e-6 and np.abs(change[:, 2:]).max() < 1e-6


def test_the_best_overlap_is_in_step(clips: Clips) -> None:
    """Of any two places half a stride apart, that where the same foot stands is taken."""
    walk, sneak = clips
    contacts = found(walk), found(sneak)
    where = find_overlap(walk, sneak, contacts)
    warp = find_warp(walk, sneak, contacts, where)
    frames = np.arange(warp.length + 1)
    agree = []
    for site in ("left_heel", "left_toe", "right_heel", "right_toe"):
        masks = [
            contact_mask(given, site, clip.nframe)[np.round(place).astype(int)]
            for given, clip, place in zip(
                contacts, (walk, sneak), (warp.first, warp.second), strict=True
            )
        ]
        agree.append(masks[0] == masks[1])
    assert np.mean(agree) > 0.75 and len(frames) == len(agree[0])


def test_clips_are_used_as_far_as_they_go(clips: Clips) -> None:
    walk, sneak = clips
    where = find_overlap(walk, sneak, (found(walk), found(sneak)))
    assert where.first > walk.nframe - 40 and where.second < 30


def test_a_short_end_is_not_left_for_a_better_place_far_back() -> None:
    """A walk that ends in sneaking goes over from the sneaking, though it has walked before."""
    walk, sneak = straight(3.0), load_clip("sneak")
    mixed_gait = blend_clips([walk, sneak])
    places = blend_clips([mixed_gait.motion, walk], contacts=[mixed_gait.contacts, None]).places
    assert places[0].first > mixed_gait.overlaps[0][1] + 30


def test_strides_are_counted() -> None:
    assert stride_frames(straight(3.0), found(straight(3.0))) == pytest.approx(
        30.0 * STRIDE / 1.22, abs=1.0
    )
    still = straight(1.0).replace(np.repeat(straight(1.0).qpos[:1], 40, axis=0))
    assert stride_frames(still, found(still)) is None


# When


@pytest.mark.parametrize("speed", [0.95, 1.22, 1.5])
def test_steps_of_both_clips_fall_together(speed: float) -> None:
    """Two walks of other cadence: strikes and toe-offs come at the same frames of the result."""
    first, second = straight(4.0), straight(4.0, speed)
    contacts = found(first), found(second)
    where = find_overlap(first, second, contacts, length=40)
    warp = find_warp(first, second, contacts, where)
    for site in ("left_heel", "right_heel"):
        mine, others = (
            when(np.array([c.start - 0.5 for c in given if c.site == site]))
            for given, when in zip(contacts, (warp.from_first, warp.from_second), strict=True)
        )
        inside = mine[(mine > warp.first[0] + 2) & (mine < warp.first[0] + warp.length - 2)]
        assert len(inside)
        for event in inside:
            assert np.abs(others - event).min() < 1.5


def test_time_rises_and_runs_as_each_clip_does_at_its_end(clips: Clips) -> None:
    walk, sneak = clips
    contacts = found(walk), found(sneak)
    warp = find_warp(walk, sneak, contacts, find_overlap(walk, sneak, contacts))
    for places in (warp.first, warp.second):
        assert np.diff(places).min() > 0.2 and places[0] == round(places[0])
        assert places[-1] == pytest.approx(round(places[-1]), abs=1e-9)
    assert np.diff(warp.first)[0] == pytest.approx(1.0, abs=0.03)
    assert np.diff(warp.second)[-1] == pytest.approx(1.0, abs=0.03)


def test_the_share_is_a_hermite_step() -> None:
    x = np.linspace(-0.5, 1.5, 201)
    share = hermite(x)
    assert share[0] == 0.0 and share[-1] == 1.0 and hermite(np.array(0.5)) == pytest.approx(0.5)
    slope = np.gradient(share, x)
    assert np.abs(slope[[50, 150]]).max() < 0.02 and slope.max() == pytest.approx(1.5, abs=0.01)


# The blend


def test_before_and_after_the_overlap_clips_are_themselves(clips: Clips) -> None:
    walk, sneak = clips
    both = blend_clips([walk, sneak])
    start, end = both.overlaps[0]
    model = walk.model
    own = both.motion.qpos
    assert np.abs(ominus(model, own[: start + 1], walk.qpos[: start + 1])[:, 6:]).max() < 1e-9
    rest = sneak.nframe - (both.motion.nframe - end)
    assert np.abs(ominus(model, own[end:], sneak.qpos[rest:])[:, 6:]).max() < 1e-9
    assert np.allclose(own[end:, 2], sneak.qpos[rest:, 2])
    steps, mine = (np.diff(one[:, :2], axis=0) for one in (own[end:], sneak.qpos[rest:]))
    assert np.allclose(np.linalg.norm(steps, axis=1), np.linalg.norm(mine, axis=1), atol=1e-9)


def test_no_velocity_jumps(clips: Clips) -> None:
    walk, sneak = clips
    both = blend_clips([walk, sneak, walk])
    change = np.abs(
        np.diff(ominus(walk.model, both.motion.qpos[1:], both.motion.qpos[:-1]), axis=0)
    )
    most = max(
        np.abs(np.diff(ominus(one.model, one.qpos[1:], one.qpos[:-1]), axis=0)).max(axis=0).max()
        for one in clips
    )
    for start, end in both.overlaps:
        assert change[start - 2 : end + 2].max() < 1.2 * most


def test_the_root_goes_as_its_standing_feet_let_it(clips: Clips) -> None:
    """Apart from its planted root, a blend slides by what two strides of other length differ."""
    walk, sneak = clips
    both = blend_clips([walk, sneak])
    sites = Kinematics(walk.model, both.motion.nframe).forward(both.motion.qpos).site_xpos
    worst = 0.0
    for contact in both.contacts:
        place = sites[contact.start : contact.end, walk.model.site(contact.site).id, :2]
        worst = max(worst, float(np.linalg.norm(place - place.mean(axis=0), axis=1).max()))
    assert 0.003 < worst < 0.06


def test_turning_clips_go_on_where_they_face() -> None:
    left = make_walk(character(), segments=[Segment("turn_left", 3.0)])
    both = blend_clips([left, left])
    turned = headings(both.motion)
    start, end = both.overlaps[0]
    assert np.abs(np.diff(turned)).max() < 1.3 * np.abs(np.diff(headings(left))).max()
    rest = left.nframe - (both.motion.nframe - end)
    expected = headings(left)[start] + headings(left)[-1] - headings(left)[rest]
    assert turned[-1] - turned[0] > expected - headings(left)[0]


def test_contacts_go_over_by_their_shares() -> None:
    """Runs in step: a contact of both lies between, one of the weaker clip alone is dropped."""
    motion = cut(straight(2.0), 0, 60)
    frames = np.arange(21.0)
    warp = Warp(20.0 + frames, 10.0 + frames, hermite(frames / 20.0))
    mine = (
        Contact("left_heel", 5, 25),
        Contact("left_toe", 28, 34),
        Contact("right_heel", 21, 24),
        Contact("right_toe", 37, 39),
    )
    others = (
        Contact("left_heel", 0, 17),
        Contact("left_toe", 16, 26),
        Contact("right_toe", 14, 17),
        Contact("right_toe", 28, 40),
    )
    both = blend(motion, motion, (mine, others), warp)
    spans = {(c.site, c.start, c.end) for c in both.contacts}
    heel = next(c for c in both.contacts if c.site == "left_heel")
    assert heel.start == 5 and 25 <= heel.end <= 27  # ends early in the overlap: mostly the first's
    toe = next(c for c in both.contacts if c.site == "left_toe")
    assert 26 < toe.start <= 28 and 34 < toe.end <= 36
    assert ("right_heel", 21, 24) in spans  # the first's alone, while it is the stronger
    assert ("right_toe", 38, 50) in spans and not any(
        c.end <= 30 and c.site == "right_toe" for c in both.contacts
    )


# What comes of it


def test_walk_to_sneak_and_back_slides_nowhere(joined: Result, clips: Clips) -> None:
    before, after = measured(joined, joined.source), measured(joined)
    assert before.metrics["stance_drift_mm"] > 5.0
    assert after.metrics["stance_drift_mm"] < 1.0 and after.broken() == []
    assert joined.unmet == () and some(joined.trace).exact_error_percent < 0.01
    errors = [level.max_error_percent for level in some(joined.trace).levels]
    assert all(error <= most for error, most in zip(errors, PAPER, strict=False))
    assert joint_jerk_ratio(joined.motion, clips) < 1.3


def test_the_source_is_the_blend(joined: Result, clips: Clips) -> None:
    walk, sneak = clips
    both = blend_clips([walk, sneak, walk])
    assert np.abs(ominus(walk.model, joined.source.qpos, both.motion.qpos)).max() < 1e-9


def test_far_from_the_overlaps_nothing_changes(joined: Result, clips: Clips) -> None:
    """The walk before and after is what the walk alone becomes on level ground."""
    walk, alone = clips[0], adapt(clips[0], load_scene("flat")).motion
    change = np.abs(ominus(walk.model, joined.motion.qpos[:60], alone.qpos[:60])).max(axis=1)
    assert change.max() < 0.025
    change = np.abs(ominus(walk.model, joined.motion.qpos[-40:], alone.qpos[-40:])[:, 6:])
    assert change.max() < 0.04


def test_it_goes_down_and_comes_up_again(joined: Result) -> None:
    height = joined.motion.qpos[:, 2]
    middle = slice(len(height) * 2 // 5, len(height) // 2)
    assert height[middle].min() < min(height[:40].min(), height[-40:].min()) - 0.08


def test_an_overlap_of_one_s_own(clips: Clips) -> None:
    walk, sneak = clips
    result = transition(walk, sneak, overlap=(60, 15, 24))
    assert (
        result.motion.nframe
        == blend_clips([walk, sneak], overlaps=[Overlap(60, 15, 24)]).motion.nframe
    )
    assert measured(result).metrics["stance_drift_mm"] < 1.0


def test_places_found_can_be_given_again(clips: Clips) -> None:
    walk, sneak = clips
    once = blend_clips([walk, sneak, walk])
    again = blend_clips([walk, sneak, walk], overlaps=once.places)
    assert again.overlaps == once.overlaps and again.contacts == once.contacts
    assert np.array_equal(again.motion.qpos, once.motion.qpos)


def test_clips_are_not_changed(clips: Clips) -> None:
    before = [clip.qpos.copy() for clip in clips]
    blend_clips([clips[0], clips[1], clips[0]])
    assert all(np.array_equal(clip.qpos, kept) for clip, kept in zip(clips, before, strict=True))


def test_another_rate_is_resampled(clips: Clips) -> None:
    walk, sneak = clips
    fast = straight(2.0, fps=60.0)
    both = blend_clips([walk, fast], contacts=[None, found(fast)])
    assert both.motion.fps == walk.fps and both.clips[1].nframe == (fast.nframe + 1) // 2
    assert blend_clips([fast, sneak]).motion.fps == 60.0


# The paper's


def test_the_job_is_the_paper_s() -> None:
    job = make_job()
    assert (job.nframe, job.ndof, job.nreduced, job.nscalar) == (FRAMES, 20, 8, 834)
    held = sum(len(constraint.frames) for constraint in job.constraints)
    stands = sum(
        np.count_nonzero(
            contact_mask(job.contacts, f"{side}_heel", FRAMES)
            | contact_mask(job.contacts, f"{side}_toe", FRAMES)
        )
        for side in ("left", "right")
    )
    assert held == stands == 139  # every frame that a foot stands, and no other


@pytest.mark.parametrize("ik", ["hybrid", "numeric"])
def test_the_job_is_met_better_than_in_the_paper(ik: str) -> None:
    job = make_job()
    result = job.fit(ik)
    errors = [level.max_error_percent for level in some(result.trace).levels]
    assert all(error <= most for error, most in zip(errors, PAPER, strict=False))
    assert some(result.trace).exact_error_percent < 0.01 and result.unmet == ()
    assert joint_jerk_ratio(result.motion, make_clips()) < 1.3
    figures = validate(job.motion, result.motion, job.contacts).metrics
    assert figures["stance_drift_mm"] < 1.0


def test_the_464_frames_are_joined_from_clips() -> None:
    result = make_walk_464()
    walk = load_clip("walk")
    assert result.motion.nframe == walk.nframe == 464
    assert measured(result).broken() == [] and result.unmet == ()
    assert joint_jerk_ratio(result.motion, [walk]) < 1.05
    turned = headings(result.motion)
    assert turned.max() > 0.5 and abs(turned[-1] - turned[0]) < 0.05
    still = np.linalg.norm(np.diff(result.motion.qpos[:, :2], axis=0), axis=1) * walk.fps
    assert still[:10].max() < 0.05 and still[-10:].max() < 0.05 and still[100:300].min() > 0.9


def test_recordings_go_over_and_back() -> None:
    names = ("02_01.bvh", "17_03.bvh")
    if not all((RECORDINGS / name).is_file() for name in names):
        pytest.skip("the recordings of shared/mocap are not here")
    walk, sneak = (load_clip(RECORDINGS / name) for name in names)
    result = join([walk, sneak, walk])
    errors = [level.max_error_percent for level in some(result.trace).levels]
    # Of its own clips; a sneak that stands on its heels as well has more to meet.
    assert all(error <= 1.05 * most for error, most in zip(errors, PAPER, strict=False))
    figures = measured(result)
    assert figures.metrics["stance_drift_mm"] < 1.0 and figures.broken() == []
    assert measured(result, result.source).metrics["stance_drift_mm"] > 10.0
    assert joint_jerk_ratio(result.motion, [walk, sneak]) < 1.3


# Bad input


@pytest.mark.parametrize(
    ("overlap", "word"),
    [
        ((500, 0, 20), "begins at frame 500 of the first clip"),
        ((60, 500, 20), "begins at frame 500 of the second clip"),
        ((60, 0, 1), "overlap of 1 frames"),
        ((90, 0, 40), "does not fit"),
    ],
)
def test_overlaps_outside_are_refused(
    clips: Clips, overlap: tuple[int, int, int], word: str
) -> None:
    with pytest.raises(ClipError, match=word):
        transition(*clips, overlap=overlap)


def test_what_cannot_be_joined_is_refused(clips: Clips) -> None:
    walk, sneak = clips
    other = Motion(mixed(), np.tile(mixed().qpos0, (50, 1)), 30.0)
    with pytest.raises(ClipError, match="two at least"):
        join([walk])
    with pytest.raises(ClipError, match="clip 2 has another model"):
        join([walk, other])
    with pytest.raises(ClipError, match="second clip has 6 frames, too few"):
        join([walk, cut(sneak, 0, 6)])
    with pytest.raises(ClipError, match="first clip is too short"):
        blend_clips([cut(walk, 0, 20), sneak], length=60)
    with pytest.raises(ClipError, match="3 overlaps for 2 clips"):
        blend_clips([walk, sneak], overlaps=[None] * 3)
    with pytest.raises(ClipError, match="begin later"):
        blend_clips([walk, sneak, walk], overlaps=[(70, 30, 20), (31, 0, 20)])
    with pytest.raises(ContactError, match="ends at frame"):
        transition(walk, sneak, contacts_a=[Contact("left_heel", 0, 1000)])


def test_a_clip_on_uneven_ground_is_refused(clips: Clips) -> None:
    model = compose("humanoid", load_scene("slope")).model
    with pytest.raises(ClipError, match="clip 2 is on ground that is not level"):
        join([clips[0], clips[1].on(model)])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What ``mjmotion transition`` left behind."""
    out = tmp_path_factory.mktemp("transition") / "sneak"
    done = run("transition", "straight", "sneak", "--out", out, "--no-video", *NOT_BESIDE_SOURCE)
    assert done.returncode == 0, done.stderr
    assert "straight, frame" in done.stdout and "joint jerk over" in done.stdout
    return out


def test_the_command_writes_what_it_says(folder: Path) -> None:
    result = read_results(folder)
    assert result.motion.nframe == result.source.nframe and result.saved_report["broken"] == []
    assert result.contacts and result.saved_report["metrics"]["stance_drift_mm"] < 1.0


def test_results_serve_as_clips(folder: Path, tmp_path: Path) -> None:
    """Their contacts are kept, and their character."""
    out = tmp_path / "more"
    done = run("join", folder, "straight", "--length", "18", "--out", out, "--no-video")
    assert done.returncode == 0, done.stderr
    assert read_results(out).motion.nframe > read_results(folder).motion.nframe


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("join", "straight"), "two at least"),
        (("join", "straight", "nothing"), "unknown clip"),
        (("transition", "straight", "sneak", "--overlap", "1,2"), "not an overlap"),
        (("transition", "straight", "sneak", "--overlap", "99,0,20"), "begins at frame 99"),
        (("transition", "straight", "sneak", "--length", "400"), "too short to overlap"),
    ],
)
def test_bad_input_is_one_line_and_writes_nothing(
    words: tuple[str, ...], message: str, tmp_path: Path
) -> None:
    done = run(*words, "--out", tmp_path / "out", "--no-video")
    assert done.returncode == 2 and message in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1 and done.stdout == ""
    assert list(tmp_path.iterdir()) == []
