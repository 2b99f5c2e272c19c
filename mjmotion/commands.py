"""What the commands of the command line do; every function takes the parsed arguments.

Results go to stdout, progress and warnings to stderr.
"""

from __future__ import annotations

import argparse
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mjmotion.assets import find_asset
from mjmotion.exceptions import MotionError, OutputError, RenderError

if TYPE_CHECKING:
    from mjmotion.contacts import Contact
    from mjmotion.fit import Trace
    from mjmotion.validation import Validation


def say(*lines: str) -> None:
    """Write lines to stdout."""
    for line in lines:
        sys.stdout.write(f"{line}\n")


def warn(line: str) -> None:
    """Write one line to stderr."""
    sys.stderr.write(f"mjmotion: {line}\n")


class _Bar:
    """What is being done, and how far it is, on stderr; nothing where that is no terminal.

    ``stage`` is for steps one after the other; calling the bar counts frames within a step.
    """

    def __init__(self) -> None:
        from tqdm import tqdm

        self._make = partial(tqdm, leave=False, disable=None, file=sys.stderr)
        self._bar: Any = None
        self._text = ""

    def __call__(self, done: int, total: int) -> None:
        """Show how much of the step is done."""
        if self._bar.total != total:
            self._show(self._text, total=total, unit="frame")
        self._bar.update(done - self._bar.n)

    def stage(self, text: str) -> None:
        """Show which step begins."""
        self._text = text
        self._show(f"{text} …", total=1, bar_format="{desc}")

    def _show(self, text: str, **settings: Any) -> None:
        self.__exit__()
        self._bar = self._make(desc=text, **settings)

    def __enter__(self) -> _Bar:
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()


def info(args: argparse.Namespace) -> int:
    """Print what is in a clip, scene, model or result folder."""
    from mjmotion.describe import describe

    say(*describe(args.what))
    return 0


def scene(args: argparse.Namespace) -> int:
    """Make a scene and write it with its assets."""
    from mjmotion.scene import BUILDERS, Doorway, Scene, save_model

    out = args.out
    if out.suffix.lower() != ".xml":
        raise OutputError(f"'{out}' must end in .xml: a scene is an MJCF file")
    if out.exists() and not args.force:
        raise OutputError(f"'{out}' exists already: give another --out, or --force")
    known = {"command", "kind", "out", "force", "source"}
    options = {name: value for name, value in vars(args).items() if name not in known}
    if "doorways" in options:
        options["doorways"] = [Doorway(**door) for door in options["doorways"]]
    source = [args.source] if args.kind == "heights" else []
    with _Bar() as bar:
        bar.stage("making the scene")
        made = Scene.from_spec(BUILDERS[args.kind](*source, **options), out.stem)
        path = save_model(made.spec, out.parent, out.name)
    say(f"scene   {path}")
    return 0


def demo(args: argparse.Namespace) -> int:
    """Run the main job: the built-in walk over rough terrain with doorways."""
    if not args.no_video and (problem := _no_rendering()):
        # The report is worth having without a video.
        warn(f"warning: there will be no video: {problem}")
        args = argparse.Namespace(**{**vars(args), "no_video": True})
    return adapt(args)


def adapt(args: argparse.Namespace) -> int:
    """Adapt a clip to a scene, validate the result and write everything into a folder."""
    from mjmotion.adapt import adapt as run
    from mjmotion.clips import load_clip
    from mjmotion.constraints import load_constraints
    from mjmotion.contacts import load_contacts
    from mjmotion.report import table
    from mjmotion.results import check_output, load_model, result_folder, write_results
    from mjmotion.scene import load_scene
    from mjmotion.validation import read_thresholds, validate
    from mjmotion.wishes import all_missed

    # What can be wrong without any work comes first.
    check_output(args.out, args.force)
    thresholds = read_thresholds(args.threshold)
    if not args.no_video and (problem := _no_rendering()):
        raise RenderError(f"{problem}; or give --no-video")
    with _Bar() as bar, result_folder(args.out, args.force) as folder:
        bar.stage("reading scene and clip")
        scene = load_scene(args.scene)
        model = load_model(find_asset("model", args.character))
        clip = load_clip(args.clip, model, mapping=args.mapping, fps=args.fps)
        contacts = load_contacts(args.contacts, model, clip.nframe) if args.contacts else None
        wishes = load_constraints(args.constraints, model, clip.nframe) if args.constraints else ()
        adaptation = run(
            clip,
            scene,
            character=args.character,
            contacts=contacts,
            constraints=wishes,
            levels=args.levels,
            tolerance=args.tolerance / 1000.0,
            ik=args.ik,
            progress=bar.stage,
        )
        bar.stage("measuring")
        validation = validate(
            adaptation.source, adaptation.motion, adaptation.contacts, thresholds=thresholds
        )
        bar.stage("report and video")
        title = f"{Path(args.clip).stem} on {scene.name}"
        write_results(
            *(folder, adaptation, validation),
            constraints=wishes,
            video=not args.no_video,
            title=title,
            progress=bar,
        )
    say(f"{title}: {clip.nframe} frames at {clip.fps:g} fps", "")
    say(*_level_lines(adaptation.trace), "", table(validation), "")
    missed = all_missed(adaptation.unmet, adaptation.motion, wishes)
    for one in missed:
        # What the scene asked has its own figures and thresholds; it is told, and no more.
        warn(f"your constraint is not met: {one}" if one.own else f"note: not met: {one}")
    broken = _tell_broken(validation)
    say(*_path_lines(args.out))
    return 1 if broken or any(one.own for one in missed) else 0


def validate(args: argparse.Namespace) -> int:
    """Measure a result again, rewrite its report and print the figures."""
    from mjmotion.report import Report
    from mjmotion.results import write_report
    from mjmotion.validation import read_thresholds

    thresholds = read_thresholds(args.threshold)
    with _Bar() as bar:
        bar.stage("measuring")
        report = Report.from_folder(args.folder, thresholds=thresholds)
        bar.stage("report")
        write_report(args.folder, report)
    say(report.table(), "")
    broken = _tell_broken(report.validation)
    say(*_path_lines(args.folder))
    return 1 if broken else 0


def render(args: argparse.Namespace) -> int:
    """Make a video of a result folder, or of a motion file on a model."""
    from mjmotion.motion import Motion
    from mjmotion.results import VIDEO, check_file, load_model, read_results
    from mjmotion.video import render_video

    source: Motion | None = None
    contacts: tuple[Contact, ...] = ()
    if args.path.is_dir():
        out = args.out or args.path / VIDEO
        check_file(out, args.force)
        results = read_results(args.path)
        motion, source, contacts = results.motion, results.source, results.contacts
    elif not args.path.exists():
        raise MotionError(f"'{args.path}' does not exist: give a result folder or a motion file")
    else:
        if args.model is None:
            raise MotionError(f"'{args.path}' is not a result folder: a motion file needs --model")
        out = args.out or args.path.with_suffix(".mp4")
        check_file(out, args.force)
        motion = Motion.load(args.path, load_model(args.model))
    width, height = args.size
    with _Bar() as bar:
        bar.stage("rendering")
        path = render_video(
            out,
            motion,
            source,
            contacts=contacts,
            layout=args.layout,
            width=width,
            height=height,
            progress=bar,
        )
    say(f"video   {path}")
    return 0


def _no_rendering() -> str:
    """Return why there can be no picture on this machine; "" if there can."""
    from mjmotion.video import ensure_gl

    try:
        ensure_gl()
    except RenderError as error:
        return str(error)
    return ""


def _level_lines(trace: Trace) -> list[str]:
    """Return the table of the fit: the paper's error after every level."""
    lines = ["level   frames a knot   time [ms]   greatest error [% of height]"]
    for level in trace.levels:
        lines.append(
            f"{level.level:5d}   {level.frames_per_knot:13g}   {1000 * level.seconds:9.1f}"
            f"   {level.max_error_percent:.4f}"
        )
    took = f"{1000 * trace.fit_seconds:9.1f}"
    return [
        *lines,
        f"exact   {'':13}   {took}   {trace.exact_error_percent:.4f}   (time of the whole fit)",
    ]


def _tell_broken(validation: Validation) -> bool:
    """Warn of broken thresholds, with the worst frame and body; return whether there are any."""
    rows = [row for row in validation.summary() if row.ok is False]
    for row in rows:
        warn(
            f"threshold broken: {row.figure} is {row.value:.4g}, wanted {row.threshold}"
            + (f" ({row.where})" if row.where else "")
        )
    return bool(rows)


def _path_lines(folder: Path) -> list[str]:
    """Return the paths that a person wants to open next."""
    from mjmotion.results import PAGE, VIDEO

    names = [("report", PAGE), ("video", VIDEO)]
    return [f"{what:7} {folder / name}" for what, name in names if (folder / name).is_file()]
