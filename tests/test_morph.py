"""A body that changes over frames: its geometry, the fit on it, its figures, pictures, command."""

from __future__ import annotations

import functools
import json
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest
from made_up import STEP_TIME, foot_track, humanoid, mixed, random_poses, some, walk

from mjmotion.apps.morph import MorphBody, morph
from mjmotion.body.assets import find_asset
from mjmotion.body.character import Character
from mjmotion.body.kinematics import Kinematics
from mjmotion.body.morph_body import shares
from mjmotion.body.motion import Motion
from mjmotion.body.proportions import Proportions, make_character
from mjmotion.cli import main as cli
from mjmotion.exceptions import ContactError, ModelError, MotionError, RenderError
from mjmotion.footsteps.contacts import Contact, contact_mask, detect_contacts, save_contacts
from mjmotion.output.folder import result_folder
from mjmotion.output.reading import read_motion, read_results
from mjmotion.output.result import Result, write_results
from mjmotion.paper.morph import make_job
from mjmotion.scene import with_ground
from mjmotion.validation import validate
from mjmotion.validation.morph_poses import body_poses

FRAMES = 62
PAPER = (6.98, 5.35, 3.08, 1.10)  # greatest errors of Table 1 [% of height]


@functools.cache
def sized(**factors: float) -> mujoco.MjModel:
    return make_character("humanoid", Proportions(**factors)).model


def long_legs() -> mujoco.MjModel:
    return sized(legs=1.5, torso=0.65, arms=0.8)


def short_legs() -> mujoco.MjModel:
    return sized(legs=0.7, torso=1.4, arms=1.2)


@functools.cache
def body() -> MorphBody:
    return MorphBody.between(humanoid(), [(20, long_legs()), (52, short_legs())], FRAMES)


def stances(motion: Motion) -> tuple[Contact, ...]:
    """Who stands when in the made-up walk, as it was made: heel and toe together."""
    found = []
    for side, phase in (("left", 0.0), ("right", STEP_TIME)):
        down = foot_track(np.arange(motion.nframe) / motion.fps, phase)[2]
        edges = np.flatnonzero(np.diff(np.concatenate(([0], down.astype(int), [0]))))
        for start, end in edges.reshape(-1, 2).tolist():
            found += [Contact(f"{side}_{part}", start, end) for part in ("heel", "toe")]
    return tuple(found)


@functools.cache
def morphed() -> Result:
    """The made-up walk, flat-footed and of known footprints, on the body above."""
    motion = walk(seconds=(FRAMES - 1) / 30.0)
    keys = [(20, long_legs()), (52, short_legs())]
    return morph(motion, keys, contacts=stances(motion))


def standing(model: mujoco.MjModel, frames: int = 3) -> Motion:
    return Motion(model, np.tile(humanoid().qpos0, (frames, 1)), 30.0)


def surface(model: mujoco.MjModel, qpos: np.ndarray) -> np.ndarray:
    """World positions and normals (n, 6) of all vertices of all meshes in one pose."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    parts = []
    for geom in np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_MESH):
        mesh, matrix = model.geom_dataid[geom], data.geom_xmat[geom].reshape(3, 3)
        vertex = model.mesh_vertadr[mesh] + np.arange(model.mesh_vertnum[mesh])
        normal = model.mesh_normaladr[mesh] + np.arange(model.mesh_normalnum[mesh])
        place = model.mesh_vert[vertex] @ matrix.T + data.geom_xpos[geom]
        parts.append(np.hstack((place, model.mesh_normal[normal] @ matrix.T)))
    return np.concatenate(parts)


# The body


def test_shares_are_smooth_and_hit_their_keys() -> None:
    share = shares([0, 200, 500], 600)
    assert np.allclose(share.sum(axis=1), 1.0) and (share >= 0.0).all()
    assert np.array_equal(share[[0, 200, 500, 599]], np.eye(3)[[0, 1, 2, 2]])
    assert np.allclose(share[100], (0.5, 0.5, 0.0))
    # Two continuous derivatives: the second one goes through zero at the keys, and never jumps.
    second = np.diff(share, n=2, axis=0) * 200**2
    assert np.abs(np.diff(second, axis=0)).max() < 0.4
    assert np.abs(second[198:201]).max() < 0.5


def test_key_frames_have_their_models_geometry() -> None:
    pose = random_poses(humanoid(), 1, seed=3)[0]
    keys = {0: humanoid(), 20: long_legs(), 52: short_legs(), 61: short_legs()}
    for frame, model in keys.items():
        here = body().model_at(frame)
        # MuJoCo lays the meshes of long and of short bodies out about other axes.
        assert np.allclose(surface(here, pose), surface(model, pose), atol=2e-6)
        boxes = [geom for geom in range(here.ngeom) if here.geom_type[geom] != 7]
        assert np.allclose(here.geom_size[boxes], model.geom_size[boxes])
        assert np.allclose(here.site_pos, model.site_pos)
    turned = np.abs((long_legs().mesh_quat * short_legs().mesh_quat).sum(axis=1)).min()
    assert turned < 0.9, "no mesh turned: the test shows nothing"


def test_halfway_lengths_are_the_mean() -> None:
    half = MorphBody.between(humanoid(), [(2, long_legs())], 3).at(1)
    for name in ("body_pos", "site_pos", "jnt_pos"):
        mean = (getattr(humanoid(), name) + getattr(long_legs(), name)) / 2
        assert np.allclose(half[name], mean)


def test_users_models_are_left_alone() -> None:
    before = humanoid().mesh_vert.copy(), humanoid().body_pos.copy()
    body().model_at(30)
    body_poses(body(), np.tile(humanoid().qpos0, (FRAMES, 1)))
    assert np.array_equal(humanoid().mesh_vert, before[0])
    assert np.array_equal(humanoid().body_pos, before[1])


def test_batched_kinematics_agrees_with_a_loop_over_bodies() -> None:
    qpos = random_poses(humanoid(), FRAMES, seed=5)
    loop = body_poses(body(), qpos)
    batch = Kinematics(humanoid(), FRAMES, bones=body().bones).forward(qpos)
    assert np.allclose(batch.site_xpos, loop.site, atol=1e-12)
    assert np.allclose(batch.site_xmat, loop.site_matrix, atol=1e-12)


def test_body_in_a_scene_is_the_same_body() -> None:
    model = with_ground("humanoid").model
    there = body().on(model)
    qpos = random_poses(humanoid(), FRAMES, seed=7)
    ours, theirs = body_poses(body(), qpos), body_poses(there, qpos)
    for site in range(humanoid().nsite):
        other = model.site(humanoid().site(site).name).id
        assert np.allclose(ours.site[:, site], theirs.site[:, other], atol=1e-12)
    floor = model.geom("floor").id
    assert np.array_equal(there.fields["geom_pos"][40, floor], model.geom_pos[floor])
    with pytest.raises(ModelError, match="no body"):
        body().on(mixed())


def test_body_is_written_and_read(tmp_path: Path) -> None:
    body().save(tmp_path / "body.npz")
    again = MorphBody.load(tmp_path / "body.npz", humanoid())
    for name, values in body().fields.items():
        assert np.allclose(again.fields[name], values, atol=1e-6), name
    (tmp_path / "bad.npz").write_bytes(b"PK nothing")
    with pytest.raises(ModelError, match="no body of a morph"):
        MorphBody.load(tmp_path / "bad.npz", humanoid())
    with pytest.raises(ModelError, match="does not exist"):
        MorphBody.load(tmp_path / "none.npz", humanoid())
    with pytest.raises(ModelError, match="the model wants"):
        MorphBody.load(tmp_path / "body.npz", mixed())


def turned_humanoid() -> mujoco.MjModel:
    spec = mujoco.MjSpec.from_file(str(find_asset("model", "humanoid")))
    for part in spec.bodies:
        if part.name == "torso":
            part.quat = (0.99, 0.14, 0.0, 0.0)
    return spec.compile()


@pytest.mark.parametrize(
    ("keys", "error", "words"),
    [
        (lambda: [], MotionError, "at least one"),
        (lambda: [(62, long_legs())], MotionError, "frames 0 to 61"),
        (lambda: [(-1, long_legs())], MotionError, "frames 0 to 61"),
        (lambda: [(30, long_legs()), (30, short_legs())], MotionError, "must rise"),
        (lambda: [(30, mixed())], ModelError, "frame 30: its model has other bodies"),
        (lambda: [(30, turned_humanoid())], ModelError, "turns its bodies"),
    ],
)
def test_keys_that_make_no_body(
    keys: Callable[[], list[tuple[int, mujoco.MjModel]]], error: type[MotionError], words: str
) -> None:
    with pytest.raises(error, match=words) as caught:
        MorphBody.between(humanoid(), keys(), FRAMES)
    assert "\n" not in str(caught.value)


# The fit


def test_footprints_and_timing_stay_those_of_the_walk() -> None:
    result = morphed()
    before = Kinematics(result.source.model, FRAMES).forward(result.source.qpos).site_xpos
    after = body_poses(some(result.body), result.motion.qpos).site
    assert {contact.site for contact in result.contacts} == {
        f"{side}_{part}" for side in ("left", "right") for part in ("heel", "toe")
    }
    for contact in result.contacts:
        site = result.source.model.site(contact.site).id
        span = slice(contact.start, contact.end)
        assert np.abs(after[span, site] - before[span, site]).max() < 1e-3
        drift = after[span, site] - after[span, site].mean(axis=0)
        assert np.linalg.norm(drift, axis=1).max() < 1e-4


def test_body_is_higher_on_long_legs_and_nothing_breaks() -> None:
    result = morphed()
    height, was = result.motion.qpos[:, 2], result.source.qpos[:, 2]
    assert height[20] / was[20] == pytest.approx(1.5, abs=0.06)
    assert height[55] / was[55] == pytest.approx(0.7, abs=0.06)
    assert result.motion.character.limits.excess(result.motion.qpos).max() < 1e-6
    figures = validate(result.source, result.motion, result.contacts, body=result.body)
    assert figures.broken() == []
    assert figures.metrics["sole_penetration_mm"] < 1.0
    assert result.unmet == ()


def test_levels_close_in_and_only_contacts_count() -> None:
    trace = some(morphed().trace)
    errors = [level.max_error_percent for level in trace.levels]
    assert errors == sorted(errors, reverse=True) and errors[-1] < 0.2 * errors[0]
    assert trace.exact_error_percent < 0.01
    held = functools.partial(contact_mask, morphed().contacts, nframe=FRAMES)
    feet = [held(f"{side}_heel") | held(f"{side}_toe") for side in ("left", "right")]
    assert trace.nscalar == 6 * int(np.sum(feet))
    assert 0.0 < trace.preprocessing_seconds < trace.fit_seconds


def test_numeric_ik_comes_to_the_same_footprints() -> None:
    motion = walk(seconds=1.0)
    keys = [(12, sized(legs=1.2)), (28, sized(legs=0.9))]
    result = morph(motion, keys, contacts=stances(motion), ik="numeric")
    figures = validate(result.source, result.motion, result.contacts, body=result.body)
    assert figures.metrics["stance_drift_mm"] < 0.1 and result.unmet == ()


def test_body_that_does_not_change_walks_as_before() -> None:
    motion = walk(seconds=1.0)
    result = morph(motion, [(20, humanoid())], contacts=stances(motion))
    # A leg never gets quite straight, which lowers the made-up walk by some millimetres.
    assert np.abs(result.motion.qpos - motion.qpos).max() < 0.03
    assert some(result.trace).levels[0].max_error_percent < 0.1


def test_larger_feet_stand_in_the_middle_of_their_footprints() -> None:
    motion = walk(seconds=1.0)
    result = morph(motion, [(0, sized(feet=1.3))], contacts=stances(motion))
    figures = validate(result.source, result.motion, result.contacts, body=result.body)
    assert figures.metrics["stance_drift_mm"] < 0.1
    model = result.motion.model
    sites = body_poses(some(result.body), result.motion.qpos).site
    before = Kinematics(model, result.motion.nframe).forward(result.source.qpos).site_xpos
    heel, toe = (model.site(f"left_{part}").id for part in ("heel", "toe"))
    frame = 15
    assert contact_mask(result.contacts, "left_heel", motion.nframe)[frame]
    length = np.linalg.norm(sites[frame, toe] - sites[frame, heel])
    assert length == pytest.approx(1.3 * 0.178, abs=1e-3)
    middle = sites[frame, toe] + sites[frame, heel] - before[frame, toe] - before[frame, heel]
    assert np.abs(middle[:2]).max() < 2e-3


def test_legs_too_short_for_the_stride_are_told() -> None:
    result = morph(walk(seconds=1.5), [(30, sized(legs=0.25))])
    assert result.unmet and all("foot" in one.constraint for one in result.unmet)
    assert max(some(one.residual_mm) for one in result.unmet) > 5.0
    assert min(min(one.frames) for one in result.unmet) > 10, "long legs reach"
    assert np.isfinite(result.motion.qpos).all()
    assert result.motion.character.limits.excess(result.motion.qpos).max() < 1e-6


def test_a_motion_that_never_stands_is_refused() -> None:
    motion = walk(seconds=1.0)
    qpos = motion.qpos + np.eye(motion.model.nq)[0] * np.arange(motion.nframe)[:, None]
    with pytest.raises(ContactError, match="no contacts"):
        morph(motion.replace(qpos), [(9, long_legs())])


def test_the_papers_job() -> None:
    job = make_job()
    assert (job.nframe, job.ndof, job.nreduced, job.nscalar) == (62, 20, 8, 420)
    result = job.fit()
    errors = [level.max_error_percent for level in some(result.trace).levels]
    assert len(errors) == 4 and all(np.array(errors) <= PAPER)
    assert some(result.trace).exact_error_percent < 0.01 and some(result.trace).nscalar == 420
    assert job.body is not None
    figures = validate(job.motion, result.motion, job.contacts, body=job.body)
    assert figures.metrics["stance_drift_mm"] < 1.0
    assert figures.metrics["jerk_ratio_rms"] < 1.3
    assert figures.metrics["joint_limit_rad"] < 1e-6
    # What stands in the window alone stands in the job too: no contact is left out.
    for side in ("left", "right"):
        for part in ("heel", "toe"):
            found = contact_mask(detect_contacts(job.motion), f"{side}_{part}", job.nframe)
            held = contact_mask(job.contacts, f"{side}_{part}", job.nframe)
            assert (found & ~held).sum() <= 1
    legs = job.body.fields["body_pos"][:, job.motion.model.body("left_shank").id, 2]
    assert legs.min() / legs[0] == pytest.approx(1.5, abs=0.01)
    assert legs.max() / legs[0] == pytest.approx(0.6, abs=0.01)


# Figures


def test_figures_of_one_body_are_the_same_either_way() -> None:
    result = morphed()
    model = result.source.model
    still = MorphBody.between(model, [(0, model)], FRAMES)
    plain = validate(result.source, result.source, result.contacts)
    as_body = validate(result.source, result.source, result.contacts, body=still)
    unknown = ("self_overlap", "com_acceleration", "unexplained")  # of a body that changes
    for name, value in plain.metrics.items():
        if any(word in name for word in unknown):
            assert np.isnan(as_body.metrics[name])
            continue
        assert as_body.metrics[name] == pytest.approx(value, abs=1e-3, nan_ok=True), name


def test_penetration_is_measured_on_each_frames_own_body() -> None:
    model = with_ground("humanoid").model
    longer = MorphBody.between(humanoid(), [(0, humanoid()), (2, sized(legs=1.1))], 3)
    motion = standing(model)
    figures = validate(motion, motion, (), body=longer)
    # Legs that grow by a tenth from hip to ankle (0.8593 m) push standing soles so far down.
    assert np.allclose(figures.per_frame["sole_penetration_mm"], (0.0, 42.965, 85.93), atol=1e-3)
    with pytest.raises(MotionError, match="frames"):
        validate(standing(model, 4), standing(model, 4), (), body=longer)


# Pictures


@pytest.fixture(scope="module")
def gl() -> None:
    from mjmotion.output.video import Canvas

    try:
        with Canvas(humanoid(), 64, 64):
            pass
    except RenderError as error:
        pytest.skip(str(error))


def tall(image: np.ndarray) -> int:
    """How many rows there are from the hair to the end of the trousers: both are dark."""
    rows = np.flatnonzero((image.max(axis=2) < 75).any(axis=1))
    return int(np.ptp(rows)) if len(rows) else 0


@pytest.mark.usefixtures("gl")
def test_pictures_show_each_frames_body() -> None:
    from mjmotion.output.video import render_frames, render_strip

    model = with_ground("humanoid").model
    changing = MorphBody.between(humanoid(), [(2, sized(legs=1.6))], 3)
    source = standing(model)
    raised = np.array(source.qpos)
    raised[:, 2] += np.array((0.0, 0.3, 0.6)) * 0.8593  # legs from hip to ankle [m]
    motion = source.replace(raised)
    first, last = render_frames(motion, [0, 2], 160, 240, body=changing, shadows=False)
    assert tall(last) > 1.15 * tall(first) > 40
    # The source keeps its body, frame after frame, though both share the driver's meshes.
    pair = render_frames(
        motion,
        [0, 2, 0],
        320,
        240,
        source=source,
        body=changing,
        layout="side-by-side",
        shadows=False,
    )
    # To a grey level: the driver rounds what it is given anew.
    apart = np.abs(pair[0].astype(int) - pair[2].astype(int))
    assert apart.max() <= 1, "a body of another frame was left behind"
    assert tall(pair[0][:, :150]) == tall(pair[1][:, :150])
    assert tall(pair[1][:, 170:]) > 1.15 * tall(pair[0][:, 170:])
    strip = render_strip(motion, [0, 2], 320, 240, body=changing, spread=1.0)
    columns = np.flatnonzero((strip.max(axis=2) < 75).any(axis=0))
    middle = int((columns[0] + columns[-1]) / 2)
    assert tall(strip[:, middle:]) > 1.15 * tall(strip[:, :middle]) > 20
    with pytest.raises(RenderError, match="ghost"):
        render_frames(motion, [0], 160, 160, source=motion, body=changing, layout="ghost")
    assert np.array_equal(model.geom_pos, with_ground("humanoid").model.geom_pos)


# Files and the command


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("morph") / "result"
    result = morphed()
    figures = validate(result.source, result.motion, result.contacts, body=result.body)
    with pytest.MonkeyPatch.context() as patch, result_folder(out) as aside:
        patch.setenv("MUJOCO_GL", "off")  # the page's strip of poses takes seconds
        write_results(aside, result, figures, video=False)
    return out


def test_folder_holds_the_body_and_is_measured_again(folder: Path) -> None:
    results = read_results(folder)
    assert results.body is not None
    ours = body_poses(some(morphed().body), morphed().motion.qpos)
    theirs = body_poses(results.body, results.motion.qpos)
    assert np.allclose(ours.site, theirs.site, atol=1e-6)
    again = results.report()
    assert again.broken == [] and again.metrics["stance_drift_mm"] < 0.01
    report = json.loads((folder / "report.json").read_text("utf-8"))
    assert len(report["levels"]) == len(some(morphed().trace).levels)
    with pytest.raises(MotionError, match="whose body changes"):
        read_motion(folder)
    assert Character.of(folder / "model.xml").model.ngeom == results.model.ngeom


def test_command_morphs_a_clip(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MUJOCO_GL", "off")
    motion, out = walk(seconds=1.0), tmp_path / "out"
    motion.save(tmp_path / "walk.npz")
    save_contacts(tmp_path / "contacts.json", stances(motion))
    words = ["morph", tmp_path / "walk.npz", "--contacts", tmp_path / "contacts.json"]
    words += ["--key", "10:legs=1.3,torso=0.8", "--key", "28:legs=.9"]
    assert cli.main([*map(str, words), "--out", str(out), "--no-video"]) == 0
    names = {path.name for path in out.iterdir()}
    assert {"motion.npz", "source.npz", "body.npz", "model.xml", "report.json"} <= names
    shown = capsys.readouterr().out
    assert "stance drift" in shown and "BROKEN" not in shown
    results = read_results(out)
    assert results.body is not None
    shank = results.model.body("left_shank").id
    share = results.body.fields["body_pos"][:, shank, 2] / results.model.body_pos[shank, 2]
    assert share[[0, 10, 28, 30]] == pytest.approx([1.0, 1.3, 0.9, 0.9], abs=1e-6)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--key", "70:legs=1.5"], "frames 0 to 61"),
        (["--key", "20:legs=1.5", "--key", "10:legs=0.7"], "must rise"),
        (["--key", "20:legs=0.001"], "vanish"),
        (["--key", "20:legs=0"], "positive"),
        (["--key", "20:legz=2"], "Did you mean 'legs'"),
        (["--key", "20"], "is not a frame"),
        (["--key", "x:legs=2"], "is not a frame"),
        (["--key", "20:legs=1.2,legs=1.3"], "is not a frame"),
        (["walk"], "needs --key"),
        (["wolk", "--key", "20:legs=2"], "unknown clip"),
        (["--ik", "quick"], "invalid choice"),
    ],
)
def test_bad_input_is_one_line_and_nothing_is_written(
    words: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        code = cli.main(["morph", *words, "--out", str(tmp_path / "out"), "--no-video"])
    except SystemExit as end:  # what argparse refuses
        code = int(str(end.code))
    error = capsys.readouterr().err
    assert code == 2 and said in error
    assert error.count("\n") == 1 and error.startswith("mjmotion: error: ")
    assert not list(tmp_path.iterdir())
