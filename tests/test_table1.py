"""Table 1, on small made-up jobs: what is counted and measured, and how it is told."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from made_up import loop_sites, pin, some, walk

from mjmotion.cli.main import COMMANDS
from mjmotion.constraints import SiteConstraint
from mjmotion.exceptions import FitError
from mjmotion.footsteps.contacts import detect_contacts
from mjmotion.numerics.bspline import basis_matrix, fit_level
from mjmotion.paper import table1
from mjmotion.paper.ablations import (
    COMPARISONS,
    METHODS,
    Ablation,
    Measure,
    compare,
    first_guess,
    interpolating,
    local_levels,
    multilevel,
    natural_spline,
    normal_equations,
    pseudo_inverse,
)
from mjmotion.paper.job import Job
from mjmotion.paper.jobs import PAPER
from mjmotion.paper.print_table1 import lines, markdown
from mjmotion.paper.table1 import Table1, drift_mm, make_job
from mjmotion.paper.timing import median_seconds, run_in_turns

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "scripts"))

import table1 as script  # noqa: E402


def raised(name: str = "made up", height: float = 0.03) -> Job:
    """A walk whose stance feet are to stand on steps: held only while they stand."""
    motion = walk(2.0)
    contacts = detect_contacts(motion)
    constraints: list[SiteConstraint] = []
    for side in ("left", "right"):
        whole = pin(motion.model, motion.qpos, f"{side}_foot")
        stands = [c for c in contacts if c.site == f"{side}_heel"]
        for number, contact in enumerate(stands):
            at = np.arange(contact.start, contact.end)
            lift = np.array((0.0, 0.0, height * (number % 2)))
            middle = (contact.start + contact.end) // 2
            place = some(whole.position)[middle] + lift
            constraints.append(
                SiteConstraint(f"{side}_foot", at, place, some(whole.quat)[middle], contact=True)
            )
    return Job(name, motion, tuple(constraints), contacts=contacts)


def posed() -> Job:
    """A walk both of whose feet are to be 5 cm further out, at every frame."""
    motion = walk(2.0)
    constraints = tuple(
        pin(motion.model, motion.qpos, f"{side}_foot", (0.0, out, 0.0))
        for side, out in (("left", 0.05), ("right", -0.05))
    )
    return Job("posed", motion, constraints, first_guess=np.zeros((motion.nframe, 3)))


@pytest.fixture(scope="module")
def job() -> Job:
    return raised()


@pytest.fixture(scope="module")
def found(job: Job) -> Table1:
    jobs = {"terrain": job, "rope": posed()}
    return table1.run(["terrain", "rope"], 2, ablations=False, make=jobs.__getitem__)


# What the paper prints


def test_the_paper_s_columns() -> None:
    assert list(PAPER) == ["terrain", "rope", "morph", "transition"]
    for column in PAPER.values():
        assert column.frames_per_knot == (16.0, 8.0, 4.0, 2.0)
        assert len(column.seconds) == len(column.max_error_percent) == 4
        assert list(column.max_error_percent) == sorted(column.max_error_percent, reverse=True)
    assert PAPER["terrain"].nscalar == 464 * 2 * 6
    # Sums of what is printed, so that a slip of the pen shows.
    assert sum(PAPER["rope"].seconds) == pytest.approx(12.03)
    assert sum(c.nscalar for c in PAPER.values()) == 12720
    assert sum(sum(c.max_error_percent) for c in PAPER.values()) == pytest.approx(82.64)


# Our columns


def test_a_column_is_what_the_fit_says(job: Job, found: Table1) -> None:
    ours = found.columns["terrain"]
    trace = job.fit().trace
    assert (ours.column.ndof, ours.column.nreduced) == (20, 8)
    assert ours.column.nframe == job.motion.nframe
    assert ours.column.nscalar == 6 * sum(len(one.frames) for one in job.constraints)
    assert ours.column.frames_per_knot == (16.0, 8.0, 4.0, 2.0)
    np.testing.assert_allclose(
        ours.column.max_error_percent,
        [level.max_error_percent for level in trace.levels[:4]],
        rtol=1e-6,
    )
    assert ours.extra_levels == len(trace.levels) - 4
    assert ours.exact_error_percent < 0.01
    assert 0.0 < ours.column.preprocessing_seconds < ours.fit_seconds  # type: ignore[operator]
    assert sum(ours.column.seconds) < ours.fit_seconds


def test_solvers_are_compared_on_every_job(found: Table1) -> None:
    assert [(row.job, row.ik) for row in found.solvers] == [
        ("made up", "hybrid"),
        ("made up", "numeric"),
        ("posed", "hybrid"),
        ("posed", "numeric"),
    ]
    assert [row.parameters for row in found.solvers] == [8, 20, 8, 20]
    for name, speedup in found.speedups().items():
        hybrid, numeric = (row for row in found.solvers if row.job == name)
        assert speedup == pytest.approx(numeric.fit_seconds / hybrid.fit_seconds)
        assert hybrid.exact_error_percent < 0.01 and numeric.exact_error_percent < 0.01


def test_what_is_missed_is_told(found: Table1) -> None:
    told = "\n".join(found.missed())
    assert "terrain: frames: 61, wanted 464" in told
    assert "rope: parameters: 20, wanted 37" in told
    assert "drift" not in told
    bad = dataclasses.replace(
        found.columns["terrain"], drift_mm=3.0, jerk_ratio=1.5, exact_error_percent=0.2
    )
    bad = dataclasses.replace(
        bad, column=dataclasses.replace(bad.column, max_error_percent=(20.0, 1.0, 1.0, 1.0))
    )
    slow = [dataclasses.replace(row, job=PAPER["rope"].name) for row in found.solvers[2:]]
    slow[1] = dataclasses.replace(slow[1], fit_seconds=1.5 * slow[0].fit_seconds)
    worse = dataclasses.replace(found, columns={"terrain": bad}, solvers=tuple(slow))
    told = "\n".join(worse.missed())
    for words in (
        "level 1: 20 %, wanted ≤ 14.31",
        "drift of contacts: 3 mm, wanted ≤ 1",
        "joint jerk over source, RMS: 1.5, wanted ≤ 1.3",
        "exact pass: 0.2 %, wanted ≤ 0.01",
        "rope: time of numeric over hybrid IK: 1.5 x, wanted ≥ 2",
    ):
        assert words in told, words
    assert "level 2" not in told


def test_what_holds_by_construction_is_checked_and_no_row(found: Table1) -> None:
    figures = {figure.name: figure for figure in found.figures()}
    exact = figures["terrain: error after the exact pass"]
    assert exact.ok and not exact.in_table
    assert figures["terrain: frames"].in_table  # it is missed here: a miss is never hidden
    assert figures["terrain: drift of contacts"].in_table
    assert not figures["rope: drift of contacts"].in_table


def test_drift_is_that_of_the_contacts(job: Job) -> None:
    fit = job.fit()
    assert drift_mm(job, fit) < 1e-3
    slid = np.array(fit.motion.qpos)
    contact = job.contacts[0]
    middle = (contact.start + contact.end) // 2
    slid[middle, 0] += 0.01
    moved = dataclasses.replace(fit, motion=fit.motion.replace(slid))
    assert 8.0 < drift_mm(job, moved) < 10.0
    assert drift_mm(dataclasses.replace(job, contacts=()), moved) == 0.0


def test_preprocessing_of_a_guess_of_one_s_own_is_the_paper_s() -> None:
    job = posed()
    assert table1.preprocessing(job, [job.fit()]) == 0.0  # nothing stands, so nothing is guessed
    stands = tuple(dataclasses.replace(one, contact=True) for one in job.constraints)
    job = dataclasses.replace(job, constraints=stands)
    assert 0.0 < table1.preprocessing(job, [job.fit()]) < 0.5


def test_a_job_that_there_is_not() -> None:
    with pytest.raises(FitError, match="terrain"):
        make_job("terain")


# How it is told


def test_lines_show_both_sides(found: Table1) -> None:
    text = "\n".join(lines(found))
    for words in ("20 (8)", "37 (13)", "5568", "14.31   9.24    3.48    1.06", "170", "numeric"):
        assert words in text, words
    assert "§7" not in text
    assert all(len(line) <= 120 for line in lines(found))


def test_markdown_is_a_table(found: Table1) -> None:
    table = markdown(found).splitlines()
    assert len(table) == 2 + 4 + 2 * 4 + 2
    assert {line.count("|") for line in table} == {4}
    assert table[2] == "| parameters (reduced) | 20 (8) | 20 (8) / 37 (13) |"
    assert table[6].endswith(" / 11.09 |") and " / 14.31 |" in table[6]
    assert " / 2500 |" in table[7]


def test_all_is_there_as_data(found: Table1) -> None:
    data = json.loads(json.dumps(found.as_dict(), allow_nan=False))
    assert data["table1"]["rope"]["paper"]["nscalar"] == 5898
    assert data["machine"]["cores"] and data["missed"]


def test_the_script_writes_the_table_into_the_page(
    found: Table1, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    page = tmp_path / "results.md"
    page.write_text("a\n<!-- table1 --><!-- /table1 -->\nb", "utf-8")
    monkeypatch.setattr(script.results_page, "PAGE", page)
    monkeypatch.setattr(table1, "run", lambda *args, **settings: found)
    assert script.main(["--write", "--no-ablations"]) == 1  # made-up jobs miss the paper's counts
    assert markdown(found) in page.read_text("utf-8")
    before = page.read_text("utf-8")
    with pytest.raises(SystemExit):
        script.main(["--write", "--jobs", "rope"])  # a table of one job would replace all four
    assert "all four jobs" in capsys.readouterr().err
    assert page.read_text("utf-8") == before


# Curves in place of Eq. 2


def test_a_spline_through_all_data() -> None:
    frames, data = np.array([3, 5, 6, 11]), np.array([[1.0], [-2.0], [0.5], [4.0]])
    values = natural_spline(frames, data, 15, 4.0)
    np.testing.assert_allclose(values[frames], data, atol=1e-12)
    assert (values[:3] == values[3]).all() and (values[12:] == values[11]).all()
    third = np.diff(
        natural_spline(np.arange(0, 20, 2), np.arange(0, 20.0, 2)[:, None], 20, 1.0), n=2, axis=0
    )
    assert np.abs(third[:-2]).max() < 1e-12  # a straight line stays one
    assert (natural_spline(np.array([4]), np.array([[2.0, 3.0]]), 6, 1.0) == (2.0, 3.0)).all()


@pytest.mark.parametrize("frames_per_knot", [2.0, 5.0, 16.0])
def test_global_least_squares_is_the_pseudo_inverse(frames_per_knot: float) -> None:
    rng = np.random.default_rng(0)
    frames = np.concatenate((np.arange(0, 20), np.arange(34, 50)))
    data = rng.normal(size=(len(frames), 3))
    basis = basis_matrix(frames, 60, frames_per_knot).toarray()
    everywhere = basis_matrix(np.arange(60), 60, frames_per_knot).toarray()
    wanted = everywhere @ (np.linalg.pinv(basis, rcond=1e-12) @ data)
    np.testing.assert_allclose(pseudo_inverse(frames, data, 60, frames_per_knot), wanted, atol=1e-6)
    # Least squares: nothing at these knots is nearer to the data.
    left = np.linalg.norm(pseudo_inverse(frames, data, 60, frames_per_knot)[frames] - data)
    assert left <= np.linalg.norm(
        fit_level(frames, data, 60, frames_per_knot, passes=2)[frames] - data
    )


def test_banded_normal_equations_find_the_same() -> None:
    rng = np.random.default_rng(1)
    frames, data = np.arange(0, 60), rng.normal(size=(60, 2))
    for frames_per_knot in (4.0, 16.0):
        np.testing.assert_allclose(
            normal_equations(frames, data, 60, frames_per_knot),
            pseudo_inverse(frames, data, 60, frames_per_knot),
            atol=1e-6,
        )


def test_global_fits_overshoot_beside_gaps_and_eq_2_does_not() -> None:
    """A step, held on both sides of a gap: what the paper says of the pseudo inverse."""
    frames = np.concatenate((np.arange(0, 21), np.arange(37, 60)))
    data = np.where(frames < 30, 0.0, 1.0)[:, None]
    data += 0.02 * np.random.default_rng(2).normal(size=data.shape)
    everywhere = {
        curve.__name__: curve(frames, data, 60, 4.0) for curve in (pseudo_inverse, fit_level)
    }
    over = {
        name: max(values.max() - data.max(), data.min() - values.min())
        for name, values in everywhere.items()
    }
    assert over["pseudo_inverse"] > 2.0 * over["fit_level"], over


# The methods on a job


@pytest.fixture(scope="module")
def ablations(job: Job) -> dict[tuple[str, str], Ablation]:
    return {(one.comparison, one.name): one for one in compare(job, 1)}


def test_every_method_is_run_and_measured(
    job: Job, ablations: dict[tuple[str, str], Ablation]
) -> None:
    assert list(ablations) == [(c, name) for c in COMPARISONS for name in METHODS[c]]
    for one in ablations.values():
        assert one.job == job.name and one.seconds > 0.0
        assert np.isfinite(dataclasses.astuple(one)[3:]).all(), one
    exact = [one for (c, _), one in ablations.items() if c in ("curve", "optimisation")]
    assert max(one.max_error_percent for one in exact) < 0.05
    assert ablations["optimisation", "many small"].deviation == pytest.approx(
        ablations["curve", "multilevel B-splines, exact pass"].deviation
    )


def test_overshoot_counts_what_is_beyond_the_data_near_by(job: Job) -> None:
    measure = Measure(job)
    guess = job.motion.replace(first_guess(job))
    assert measure.overshoot(guess).max() == 0.0  # no displacement is beyond nothing
    # A spline through the data is within them where they are: a leg, while its foot is held.
    over = measure.overshoot(interpolating(job))
    for side in ("left", "right"):
        held = np.unique(np.concatenate([c.frames for c in job.constraints if side in c.site]))
        knee = job.motion.model.joint(f"{side}_knee").id
        column = list(measure.joints).index(int(job.motion.model.jnt_dofadr[knee]))
        assert over[held, column].max() < 1e-6
    # A joint that nothing asks for turns by 0.3 rad at one frame.
    model, qpos = job.motion.model, np.array(guess.qpos)
    elbow = model.joint("left_elbow")
    qpos[30, elbow.qposadr[0]] += 0.3
    over = measure.overshoot(guess.replace(qpos))
    column = list(measure.joints).index(int(model.jnt_dofadr[elbow.id]))
    assert over[30, column] == pytest.approx(0.3) and (over > 0).sum() == 1
    ablation = measure("curve", "made up", 1.0, guess.replace(qpos))
    assert ablation.overshoot_deg == pytest.approx(np.degrees(0.3))
    assert ablation.jerk_ratio > 1.5


def test_the_error_of_a_method_is_the_farthest_site(job: Job) -> None:
    motion = job.motion.replace(first_guess(job))
    worst = 0.0
    sites = loop_sites(motion.model, motion.qpos)
    for one in job.constraints:
        gap = sites[one.frames, motion.model.site(one.site).id] - one.position
        worst = max(worst, np.linalg.norm(gap, axis=1).max())
    ablation = Measure(job)("curve", "nothing", 1.0, motion)
    percent = 100 * worst / motion.character.height
    assert ablation.max_error_percent == pytest.approx(percent)
    assert ablation.deviation == 0.0


def test_interpolation_meets_every_frame_and_levels_do_not(job: Job) -> None:
    measure = Measure(job)
    through, levels = (
        measure("curve", method.__name__, 1.0, method(job))
        for method in (interpolating, local_levels)
    )
    assert through.max_error_percent < 1e-3 < levels.max_error_percent < 2.0


def test_a_job_of_all_frames_has_smoother_levels_than_interpolation() -> None:
    """IK of every frame on its own, noise and all: the interpolating spline keeps the noise."""
    job = posed()
    rng = np.random.default_rng(3)
    noisy = tuple(
        dataclasses.replace(
            one, position=some(one.position) + 0.004 * rng.normal(size=(len(one.frames), 3))
        )
        for one in job.constraints
    )
    job = dataclasses.replace(job, constraints=noisy)
    measure = Measure(job)
    through, levels = (
        measure("curve", method.__name__, 1.0, method(job))
        for method in (interpolating, local_levels)
    )
    assert levels.jerk_ratio < 0.8 * through.jerk_ratio
    whole = measure("curve", "exact", 1.0, multilevel(job))
    assert whole.max_error_percent < 1e-3


# Timing


def test_tasks_take_turns() -> None:
    order: list[str] = []

    def place(name: str) -> int:
        order.append(name)
        return len(order)

    tasks = {name: partial(place, name) for name in ("a", "b")}
    runs = run_in_turns(tasks, 2)
    assert order == ["a", "b", "a", "b", "a", "b"]  # the first two do not count
    assert [result for _, result in runs["b"]] == [4, 6]
    assert run_in_turns(tasks, 1, warm=False)["a"][0][1] == 7
    assert median_seconds(tasks, 3).keys() == {"a", "b"}


# The command


def run(*words: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "mjmotion", "table1", *map(str, words)],
        capture_output=True,
        text=True,
        timeout=120,
    )


def test_the_command_runs_a_job_of_the_paper(tmp_path: Path) -> None:
    assert "table1" in COMMANDS
    out = tmp_path / "table1.json"
    words = ("--jobs", "transition", "--repeats", 1, "--no-ablations", "--json", out)
    done = run(*words)
    assert done.returncode == 0, done.stderr
    assert "119" in done.stdout and "20 (8)" in done.stdout
    column = json.loads(out.read_text("utf-8"))["table1"]["transition"]["column"]
    assert (column["nframe"], column["nscalar"]) == (119, 834)
    assert run(*words).returncode == 2  # it is there already


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--repeats", "0"), "'0'"),
        (("--jobs", "walk"), "terrain"),
        (("--json", "no/such/folder/t.json"), "no/such/folder"),
    ],
)
def test_bad_words(words: tuple[str, ...], said: str) -> None:
    done = run(*words)
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1 and said in done.stderr, done.stderr


def test_names_are_those_of_the_command() -> None:
    from mjmotion.cli.table1 import JOBS

    assert tuple(PAPER) == JOBS
