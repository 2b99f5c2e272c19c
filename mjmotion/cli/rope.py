"""``mjmotion rope``: the rope climb on another character, with a simulated rope."""

from __future__ import annotations

import argparse

from mjmotion.cli.arguments import add_fitting, add_folder, positive

HELP = "put the rope climb on another character and simulate the rope against both"
EXAMPLE = "mjmotion rope --to climber --out out/rope"


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument(
        "--to", default="climber", metavar="MODEL", help="MJCF file or name of a model: climber"
    )
    add_folder(parser)
    parser.add_argument("--beam", type=positive, help="height that the rope hangs from [m]: 4.3")
    parser.add_argument("--length", type=positive, help="of the rope [m]; to 0.3 m over the floor")
    parser.add_argument("--edge", type=positive, help="between two points of the rope [m]: 0.05")
    add_fitting(parser)


def run(args: argparse.Namespace) -> int:
    """Fit the climb, simulate both ropes, measure, and write everything into a folder."""
    from mjmotion.apps.rope.climb import climb_rope
    from mjmotion.apps.rope.result import ORIGINAL, write_climb
    from mjmotion.cli.terminal import Bar, level_lines, no_rendering, path_lines, say, warn
    from mjmotion.exceptions import RenderError
    from mjmotion.output.folder import check_output, result_folder
    from mjmotion.scene.rope_scene import BEAM, EDGE

    check_output(args.out, args.force)
    if not args.no_video and (problem := no_rendering()):
        raise RenderError(f"{problem}; or give --no-video")
    with Bar() as bar, result_folder(args.out, args.force) as folder:
        climb = climb_rope(
            args.to,
            beam=BEAM if args.beam is None else args.beam,
            length=args.length,
            edge=EDGE if args.edge is None else args.edge,
            levels=args.levels,
            tolerance=args.tolerance,
            ik=args.ik,
            progress=bar,
        )
        bar("report")
        write_climb(folder, climb, video=not args.no_video, progress=bar)
    motion = climb.motion
    say(f"rope climb of the {climb.character}: {motion.nframe} frames at {motion.fps:g} fps", "")
    say(*level_lines(climb.trace), "")
    say(f"{'figure':40} {ORIGINAL:>12} {climb.character:>12}")
    for name, text in _ROWS.items():
        one, other = (getattr(of, name) for of in (climb.original_figures, climb.figures))
        say(f"{text:40} {one:12.3g} {other:12.3g}")
    say(f"{'joint jerk over the original, RMS':40} {'':12} {climb.jerk_ratio:12.3g}", "")
    for unmet in climb.unmet:
        frames = f"frames {min(unmet.frames)} to {max(unmet.frames)}"
        warn(f"not met: {unmet.constraint} at {frames}, by {unmet.residual_mm:.1f} mm")
    broken = climb.broken()
    for line in broken:
        warn(f"figure missed: {line}")
    say(*path_lines(args.out))
    return 1 if broken or climb.unmet else 0


_ROWS = {
    "held_mm": "held points from the rope, most [mm]",
    "free_mm": "other parts from the rope, least [mm]",
    "drift_mm": "drift of hands and feet that hold [mm]",
    "limit_rad": "joint limit excess [rad]",
    "swing_mm": "swing of the rope's end [mm]",
    "bend_deg": "sharpest bend between two edges [degree]",
}
