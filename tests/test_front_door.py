"""What a newcomer writes first: names at the top, ten lines an application, run as they stand."""

from __future__ import annotations

import importlib
import pkgutil
import subprocess
import sys
import types
from pathlib import Path

import numpy as np
import pytest
from made_up import missed
from numpy.typing import NDArray

import mjmotion
from mjmotion import (
    Character,
    LookAt,
    Motion,
    MotionError,
    Proportions,
    RelativeConstraint,
    SiteConstraint,
    adapt,
    climb_rope,
    edit_frame,
    fit,
    join,
    load_clip,
    make_character,
    morph,
    retarget,
    transition,
    validate,
)
from mjmotion.body.kinematics import site_id, site_positions
from mjmotion.constraints import Targets
from mjmotion.constraints.shared_targets import Sensitivity
from mjmotion.exceptions import ClipError, FitError, ModelError
from mjmotion.ik import NumericIK
from mjmotion.ik.solver import Clearance, Deviation, Solution
from mjmotion.output.result import Result

Array = NDArray[np.float64]

DRIFT_MM = 1.0  # of a foot that stands
HELD = 1e-3  # [m]
HOLD = np.arange(44, 56)  # frames in which a hand is held at
PLACE = np.array((0.6, 0.3, 0.95))  # in front of the walker [m]

FUNCTIONS = ("adapt", "retarget", "morph", "join", "transition", "edit_frame", "fit", "validate")


def short(name: str = "walk", count: int = 90) -> Motion:
    clip = load_clip(name)
    return clip.replace(clip.qpos[:count])


# --- names ----------------------------------------------------------------------------------------


def test_the_applications_are_functions_however_they_are_reached() -> None:
    code = "import mjmotion\n" + "".join(f"from mjmotion import {name}\n" for name in FUNCTIONS)
    code += "import mjmotion.fitting.algorithm, mjmotion.apps.edit, mjmotion.validation\n"
    code += "".join(f"assert callable(mjmotion.{name}), '{name}'\n" for name in FUNCTIONS)
    code += "".join(f"assert mjmotion.{name} is {name}\n" for name in FUNCTIONS)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert set(FUNCTIONS) <= set(mjmotion.__all__)


# --- ten lines each -------------------------------------------------------------------------------


def test_no_function_hides_a_module() -> None:
    """A package gives nothing by the name of one of its modules: one would hide the other."""
    hidden = []
    for module in pkgutil.walk_packages(mjmotion.__path__, "mjmotion."):
        package, _, leaf = module.name.rpartition(".")
        if leaf != "__main__":
            importlib.import_module(module.name)
            if not isinstance(
                getattr(importlib.import_module(package), leaf, None), types.ModuleType
            ):
                hidden.append(module.name)
    assert not hidden


def test_adapt_by_names(tmp_path: Path) -> None:
    result = adapt("straight", "stairs")
    figures = result.validate()
    assert not missed(figures) and not result.unmet
    folder = result.save(tmp_path / "out")
    assert (folder / "report.html").is_file() and (folder / "model.xml").is_file()
    # Climbing takes longer than the clip, which is kept in its own time.
    assert result.recording is not None and result.recording.nframe == 100 < result.motion.nframe
    said = repr(result)
    assert said.startswith(f"<Result: {result.motion.nframe} frames at 30 fps") and len(said) < 100


def test_adapt_a_file_to_a_scene_of_ones_own(tmp_path: Path) -> None:
    short().save(tmp_path / "walk.npz")
    scene = tmp_path / "step.xml"
    scene.write_text(
        "<mujoco><worldbody><geom type='plane' size='0 0 1'/>"
        "<geom type='box' pos='1.5 0 0' size='.4 1 .1'/></worldbody></mujoco>",
        "utf-8",
    )
    result = adapt(tmp_path / "walk.npz", scene)
    assert result.validate().metrics["stance_drift_mm"] < DRIFT_MM
    assert result.motion.qpos[:, 2].max() > short().qpos[:, 2].max() + 0.05  # over the step


def test_retarget_by_names() -> None:
    result = retarget("straight", "child", stride="scale")
    assert result.motion.character.name == "child"
    assert result.validate().metrics["stance_drift_mm"] < DRIFT_MM


def test_morph_by_names() -> None:
    taller = make_character("humanoid", Proportions(legs=1.15, torso=0.95))
    result = morph(short(), [(80, taller)])
    assert result.body is not None and result.body.nframe == 90
    assert result.validate().metrics["stance_drift_mm"] < DRIFT_MM


def test_join_and_transition_by_names() -> None:
    chain = join(["straight", "turn_left"])
    assert chain.validate().metrics["stance_drift_mm"] < DRIFT_MM
    over = transition("straight", "sneak")
    assert over.validate().metrics["stance_drift_mm"] < DRIFT_MM


def test_edit_a_frame() -> None:
    result = edit_frame("straight", 60, "pelvis", by=(0.0, 0.0, -0.1), levels=(8, 4, 2))
    sunk = result.source.qpos[60, 2] - result.motion.qpos[60, 2]
    assert sunk == pytest.approx(0.1, abs=0.01)
    untouched = np.abs(np.arange(result.motion.nframe) - 60) >= 24
    np.testing.assert_array_equal(result.motion.qpos[untouched], result.source.qpos[untouched])


def test_climb() -> None:
    climb = climb_rope("climber", levels=(16, 8, 4, 2))
    assert not climb.broken() and "climber" in repr(climb)


def test_fit_and_validate() -> None:
    clip = short()
    result = fit(clip, [hand()])
    site = np.array([site_id(clip.model, "left_hand")])
    reached = site_positions(clip.model, result.motion.qpos[HOLD], site)[:, 0]
    assert np.abs(reached - PLACE).max() < HELD and not result.unmet
    on_floor = adapt(clip, "flat")
    figures = validate(on_floor.source, on_floor.motion, on_floor.contacts)
    assert figures.metrics == on_floor.validate().metrics


def test_levels_mean_the_same_everywhere() -> None:
    """Frames a knot of each level: two of them are two levels, and the first is the coarser."""
    clip = short()
    for result in (
        adapt(clip, "flat", levels=(8, 4), tolerance=0.0),
        retarget(clip, "climber", levels=(8, 4), tolerance=0.0),
        edit_frame(clip, 40, "pelvis", by=(0, 0, -0.05), levels=(8, 4), hold="contacts"),
    ):
        assert result.trace is not None
        levels = [level.frames_per_knot for level in result.trace.levels]
        assert levels[:2] == [8.0, 4.0] and set(levels[2:]) <= {4.0}
    for wrong in ((4, 8), (), (0,), 4):
        with pytest.raises(FitError, match="levels"):
            adapt(clip, "flat", levels=wrong)  # type: ignore[arg-type]
        with pytest.raises(FitError, match="levels"):
            edit_frame(clip, 40, "pelvis", by=(0, 0, 1), levels=wrong)  # type: ignore[arg-type]


def test_progress_is_one_type_everywhere() -> None:
    taller = make_character("humanoid", Proportions(legs=1.1))
    for run in (
        lambda told: adapt(short(), "flat", progress=told),
        lambda told: retarget(short(), "climber", progress=told),
        lambda told: join(["straight", "stop"], progress=told),
        lambda told: morph(short(), [(80, taller)], progress=told),
    ):
        seen: list[tuple[str, int, int]] = []
        run(lambda *told, seen=seen: seen.append(told))
        assert any(told[0] == "fit" and told[1] == 1 and told[2] >= 4 for told in seen)
        assert all(len(told) == 3 for told in seen)


# --- the wrong body -------------------------------------------------------------------------------


def test_a_motion_stays_on_its_own_body() -> None:
    tall = make_character("humanoid", Proportions(legs=1.2))
    clip = retarget(short(), tall, stride="scale").motion
    result = adapt(clip, "flat")
    assert result.motion.character.height == pytest.approx(tall.height)
    figures = result.validate().metrics
    assert figures["stance_drift_mm"] < DRIFT_MM and figures["stance_gap_max_mm"] < DRIFT_MM
    assert not result.unmet


def test_another_body_is_refused() -> None:
    tall = make_character("humanoid", Proportions(legs=1.2))
    with pytest.raises(ModelError, match=r"another body.*shank.*retarget"):
        short().on(tall)
    with pytest.raises(ModelError, match="retarget"):
        retarget(short(), tall).motion.on("humanoid")
    with pytest.raises(MotionError, match="retarget"):
        join([short(), retarget(short(), tall).motion])
    same = short().on(Character.load("humanoid"))
    np.testing.assert_array_equal(same.qpos, short().qpos)


def test_a_compiled_model_alone_cannot_be_put_into_a_scene() -> None:
    model = Character.load("humanoid").model
    with pytest.raises(ModelError, match=r"without its MJCF.*Character\.load"):
        adapt(Motion(model, short().qpos, 30.0), "flat")


# --- a solver of one's own ------------------------------------------------------------------------


class ToyIK:
    """Damped least squares, one step a level, on the places of sites: nothing else."""

    def __init__(self, character: Character, damping: float = 1e-4) -> None:
        self.character, self.damping = character, damping

    def prepare(self, targets: Targets, clearance: Clearance | None = None) -> ToyProblem:
        return ToyProblem(self, targets)


class ToyProblem:
    def __init__(self, solver: ToyIK, targets: Targets) -> None:
        self.solver, self.targets = solver, targets

    def solve(
        self, qpos: Array, last: Solution | None = None, deviation: Deviation | None = None
    ) -> Solution:
        pose = NumericIK(self.solver.character).pose(qpos, self.targets.frames)
        site, dofs = int(self.targets.sites[0]), np.arange(pose.model.nv)
        point = pose.site_xpos[:, site]
        gap = self.targets.position[:, 0] - point
        jac, _ = pose.jacobian(point, int(pose.model.site_bodyid[site]), dofs)
        dual = jac @ jac.swapaxes(1, 2) + self.solver.damping * np.eye(3)
        step = (jac.swapaxes(1, 2) @ np.linalg.solve(dual, gap[..., None]))[..., 0]
        return Solution(step, np.linalg.norm(gap, axis=1))

    def enforce(self, qpos: Array) -> Solution:
        return self.solve(qpos)


class ToyWithFreeTargets(ToyIK):
    """The toy, with what targets cost taken from the library's numeric solver."""

    def prepare(self, targets: Targets, clearance: Clearance | None = None) -> ToyProblem:
        return ToySensitiveProblem(self, targets)


class ToySensitiveProblem(ToyProblem):
    def sensitivity(
        self, qpos: Array, deviation: Deviation | None = None, last: Solution | None = None
    ) -> Sensitivity:
        return NumericIK(self.solver.character).prepare(self.targets).sensitivity(qpos, deviation)


def hand(free: tuple[str, ...] = ()) -> SiteConstraint:
    return SiteConstraint("left_hand", HOLD, position=PLACE, free=free)


def slide(result: mjmotion.fitting.Fit) -> float:
    """How far the hand is from its mean while it is held [m]."""
    site = np.array([site_id(result.motion.model, "left_hand")])
    place = site_positions(result.motion.model, result.motion.qpos[HOLD], site)[:, 0]
    return float(np.abs(place - place.mean(axis=0)).max())


def test_a_toy_solver_fits() -> None:
    clip = short()
    result = fit(clip, [hand()], ik=ToyIK(clip.character))
    assert result.trace.levels[-1].max_error_percent < result.trace.first_error_percent / 10
    assert slide(result) < 0.01


def test_a_toy_solver_refuses_a_free_target_in_one_line() -> None:
    clip = short()
    with pytest.raises(FitError, match=r"ToyIK has no sensitivity\(\)") as refused:
        fit(clip, [hand(free=("x", "y"))], ik=ToyIK(clip.character))
    assert "\n" not in str(refused.value) and "hybrid" in str(refused.value)


def test_a_toy_solver_with_sensitivity_moves_a_free_target() -> None:
    clip = short()
    result = fit(clip, [hand(free=("x", "y"))], ik=ToyWithFreeTargets(clip.character))
    assert np.abs(result.moves[0, :2]).max() > 0.01  # it went to where it costs less
    assert slide(result) < 0.01


def test_the_papers_own_solver_refuses_a_free_target() -> None:
    from mjmotion.paper.conjugate_gradients import ConjugateGradientIK

    clip = short(count=60)
    with pytest.raises(FitError, match="ConjugateGradientIK has no sensitivity"):
        fit(clip, [hand(free=("x",))], ik=ConjugateGradientIK(clip.character))


def test_the_papers_own_solver_refuses_what_the_paper_lacks() -> None:
    from mjmotion.paper.conjugate_gradients import ConjugateGradientIK

    clip = short(count=60)
    solver = ConjugateGradientIK(clip.character)
    for asked in (
        LookAt("face", HOLD, np.array((5.0, 0.0, 1.0))),
        RelativeConstraint("left_hand", HOLD, "pelvis", np.array((0.0, 0.2, 0.0))),
    ):
        with pytest.raises(FitError, match="no relative constraints and look-ats"):
            fit(clip, [asked], ik=solver)


def test_what_makes_no_problems_is_refused() -> None:
    class Empty:
        def prepare(self, targets: Targets, clearance: Clearance | None = None) -> None:
            return None

    with pytest.raises(FitError, match=r"Empty.prepare\(\) returned a NoneType without solve"):
        fit(short(), [hand()], ik=Empty())  # type: ignore[arg-type]
    with pytest.raises(FitError, match="the class NumericIK"):
        fit(short(), [hand()], ik=NumericIK)  # type: ignore[arg-type]


def test_a_file_stays_on_its_own_body(tmp_path: Path) -> None:
    tall = make_character("humanoid", Proportions(legs=1.25))
    motion = short()
    retarget(motion, tall).motion.save(tmp_path / "tall.npz")
    with pytest.raises(ClipError, match=r"another body than 'humanoid' \(bone of"):
        adapt(tmp_path / "tall.npz", "flat")
    Motion.load(tmp_path / "tall.npz", tall)
    # One without bones, as other programs write it, goes by its joints.
    np.savez(
        tmp_path / "plain.npz", qpos=motion.qpos, fps=30.0, joint_names=np.array(motion.joint_names)
    )
    again = Motion.load(tmp_path / "plain.npz", "humanoid")
    np.testing.assert_array_equal(again.qpos, motion.qpos)


def test_what_is_no_solver_is_refused() -> None:
    with pytest.raises(FitError, match=r"int without prepare\(\)"):
        fit(short(), [hand()], ik=3)  # type: ignore[arg-type]
    other = NumericIK(make_character("humanoid", Proportions(legs=1.2)))
    with pytest.raises(FitError, match="another body"):
        fit(short(), [hand()], ik=other)
    with pytest.raises(FitError, match=r"hybird.*hybrid"):
        fit(short(), [hand()], ik="hybird")


def test_a_solver_of_ones_own_serves_the_applications() -> None:
    clip = short()
    result = adapt(clip, "flat", ik=NumericIK(clip.character, iterations=3))
    assert isinstance(result, Result) and result.validate().metrics["stance_drift_mm"] < DRIFT_MM
