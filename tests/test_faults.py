"""Inputs that once failed: each is refused in one line that names what and where, or is read.

They are in ``shared/faults``, made from the built-in walk; without it the tests are skipped.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import measured
import pytest

FAULTS = Path(__file__).parents[2] / "shared" / "faults"
pytestmark = pytest.mark.skipif(not FAULTS.is_dir(), reason=f"no {FAULTS}")

ADAPT = "adapt rel_ok.npz --scene flat"

# Words of the command, without --out; words that the one line says.
REFUSED: dict[str, tuple[str, ...]] = {
    "adapt rel_npz_zlib_error.npz --scene flat": ("rel_npz_zlib_error.npz", "damaged"),
    "adapt rel_struct_qpos.npz --scene flat": ("rel_struct_qpos.npz", "records"),
    "adapt rel_bool_qpos.npz --scene flat": ("rel_bool_qpos.npz", "qpos", "booleans"),
    "adapt rel_fps_1e300.npz --scene flat": ("rel_fps_1e300.npz", "1e+300", "1000"),
    "adapt rel_fps_1e-9.npz --scene flat": ("rel_fps_1e-9.npz", "1e-09"),
    "adapt rel_frame_time_1e-9.bvh --scene flat": ("rel_frame_time_1e-9.bvh", "1e+09", "1000"),
    f"{ADAPT} --fps 1e300": ("--fps", "1e300", "1000"),
    f"{ADAPT} --levels 1e-9": ("--levels", "1e-9", "frames a knot"),
    "adapt rel_bvh_1e30.bvh --scene flat": ("rel_bvh_1e30.bvh", "frames"),
    "adapt rel_far_1e15.npz --scene flat": ("rel_far_1e15.npz", "frames"),
    "adapt rel_dof_rq.amc --scene flat": ("rel_dof_rq.asf", "rq"),
    "adapt rel_frames_said_10_of_20.bvh --scene flat": ("Frames: 10", "20"),
    "adapt rel_csv_dup_column.csv --scene flat": ("rel_csv_dup_column.csv", "twice"),
    "adapt rel_csv_one_gap.csv --scene flat": ("rel_csv_one_gap.csv", "not even"),
    f"{ADAPT} --contacts rel_contacts_end_1e9.json": ("entry 0", "end", "1000000000"),
    f"{ADAPT} --contacts rel_contacts_deep.json": ("rel_contacts_deep.json", "deep"),
    f"{ADAPT} --contacts rel_contacts_bigdigits.json": ("rel_contacts_bigdigits.json", "digits"),
    f"{ADAPT} --contacts rel_contacts_dupkey.json": ("start", "twice"),
    f"{ADAPT} --constraints rel_constraints_bomb_site.yaml": ("bomb_site.yaml", "aliases"),
    f"{ADAPT} --constraints rel_constraints_deep.yaml": ("rel_constraints_deep.yaml", "deep"),
    f"{ADAPT} --constraints rel_constraints_bigint.json": ("rel_constraints_bigint.json",),
    f"{ADAPT} --constraints rel_constraints_weight_null.json": ("entry 0", "weight", "nothing"),
    "adapt plain_walk.bvh --scene flat --mapping rel_mapping_ignore_list.yaml": ("ignore", "list"),
    "adapt plain_walk.bvh --scene flat --mapping rel_mapping_dupkeys.yaml": ("up", "twice"),
    "adapt rel_ok.npz --scene rel_scene_geom_inf.xml": ("line 1", "pos", "geom", "finite"),
    "adapt rel_ok.npz --scene rel_scene_hfield_100000.xml": ("hfield", "100000"),
    "adapt rel_ok.npz --scene rel_scene_hfield_nan.xml": ("rel_hfield_nan.bin", "finite", "row"),
    "adapt rel_ok.npz --scene rel_scene_start_nan.xml": ("pos of site", "finite"),
    "adapt rel_ok.npz --scene rel_scene_nan_size.xml": ("size of geom", "finite"),
    "adapt rel_ok.npz --scene rel_scene_plane_1000km_below.xml": ("geom", "10,000"),
    "adapt rel_ok.npz --scene rel_scene_replicate_1e8.xml": ("replicate", "copies"),
    "scene heights rel_png_20000x20000.png": ("rel_png_20000x20000.png", "pixels"),
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with links to the inputs, so that what is left in it is seen."""
    for path in FAULTS.iterdir():
        (tmp_path / path.name).symlink_to(path)
    return tmp_path


def words_of(line: str) -> list[str]:
    if line.startswith("scene"):
        return [*line.split(), "--out", "O.xml"]
    return [*line.split(), "--out", "O", "--no-video"]


def check_refused(done: measured.Done, said: tuple[str, ...]) -> None:
    assert done.code == 2, (done.code, done.stderr)
    lines = done.stderr.splitlines()
    assert len(lines) == 1, done.stderr
    assert lines[0].startswith("mjmotion: error: ")
    assert len(lines[0]) < 1000
    for word in said:
        assert word in lines[0], lines[0]
    assert done.seconds < measured.SECONDS
    assert done.bytes < measured.BYTES


@pytest.mark.parametrize("line", REFUSED)
def test_what_is_wrong_is_refused_at_once(line: str, folder: Path) -> None:
    before = {path.name for path in folder.iterdir()}
    check_refused(measured.run(folder, *words_of(line)), REFUSED[line])
    assert {path.name for path in folder.iterdir()} == before


@pytest.mark.parametrize(
    "line",
    [
        f"{ADAPT} --contacts rel_contacts_bom.json",
        "retarget rel_ok.npz --to rel_model_joint_dollar.xml",
    ],
)
def test_what_is_only_unusual_is_read(line: str, folder: Path) -> None:
    done = measured.run(folder, *words_of(line))
    assert done.code in (0, 1), done.stderr
    assert "Traceback" not in done.stderr
    assert (folder / "O" / "report.html").is_file()


@pytest.mark.parametrize("name", ["rel_report_unmet_script.json", "rel_report_metrics_null.json"])
def test_a_report_that_lies(name: str, folder: Path) -> None:
    made = measured.run(folder, *words_of(ADAPT))
    assert made.code in (0, 1), made.stderr
    shutil.copyfile(FAULTS / name, folder / "O" / "report.json")
    done = measured.run(folder, "validate", "O")
    assert "Traceback" not in done.stderr
    if "script" in name:
        check_refused(done, ("report.json", "frame of unmet"))
    else:
        assert done.code in (0, 1), done.stderr  # figures are measured, not read
    assert "<script" not in (folder / "O" / "report.html").read_text("utf-8")
