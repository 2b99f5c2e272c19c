"""``mjmotion plan``: which way a clip would go in a scene and where it would step, from above."""

from __future__ import annotations

import argparse
from pathlib import Path

from mjmotion.cli.adapt import DEFAULTS, add_planning, read_clip, read_planning
from mjmotion.cli.arguments import add_going, add_keyframe, add_reading

HELP = "draw from above which way a clip goes in a scene, and where it steps"
EXAMPLE = "mjmotion plan walk --scene terrain_doors --out out/plan"


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument(
        "clip", metavar="CLIP", help="BVH, AMC, GLB, CSV or NPZ file, or a built-in name"
    )
    parser.add_argument(
        "--scene", required=True, help="MJCF file, or the name of one of our scenes"
    )
    parser.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="folder for the plan's files"
    )
    parser.add_argument("--force", action="store_true", help="replace an earlier plan in --out")
    add_keyframe(parser)
    add_planning(parser)
    add_reading(parser)
    add_going(parser)
    parser.set_defaults(**DEFAULTS)


def run(args: argparse.Namespace) -> int:
    """Plan, draw and write; 1 where there is no way."""
    from mjmotion.apps.planning import candidates_of, plan_walk, write_plan
    from mjmotion.cli.terminal import Bar, say, warn
    from mjmotion.output.folder import check_file
    from mjmotion.scene import load_scene

    names = ("plan.json", "plan.svg", "plan.png")
    if args.out.is_dir():
        for name in names:
            check_file(args.out / name, args.force)
    with Bar() as bar:
        bar("reading scene and clip")
        scene = load_scene(args.scene).at_rest(args.keyframe)
        clip = read_clip(args)
        contacts, settings = read_planning(args, clip)
        bar("contacts and footholds")
        walk = plan_walk(clip, scene, contacts, settings, heading=args.heading)
        seen = candidates_of(walk.plan, scene)
        write_plan(args.out, walk.plan, seen, clip=Path(args.clip).stem, scene=scene.name)
    say(*walk.lines(), *(f"wrote {args.out / name}" for name in names))
    if walk.barred:
        warn(walk.barred)
    return 1 if walk.barred else 0
