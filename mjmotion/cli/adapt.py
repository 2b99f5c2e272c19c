"""``mjmotion adapt``: a clip on a scene."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mjmotion.cli.arguments import (
    add_fitting,
    add_folder,
    add_free_footholds,
    add_heading,
    add_keyframe,
    add_reading,
    add_thresholds,
)
from mjmotion.cli.given import READING, read_noted, telling

if TYPE_CHECKING:
    from mjmotion.body.motion import Motion
    from mjmotion.footsteps.contacts import Contact
    from mjmotion.footsteps.settings import PlanSettings

HELP = "adapt a clip to a scene, validate it and make a video"
EXAMPLE = "mjmotion adapt walk --scene terrain --out out/walk"

DEFAULTS: dict[str, Any] = {
    "keyframe": None,
    "contacts": None,
    "constraints": None,
    "levels": None,
    "tolerance": 1e-4,
    "ik": "hybrid",
    "character": "humanoid",
    **READING,
    "free_footholds": False,
    "heading": "start",
    "path": "bend",
    "climb": False,
    "strict": False,
    "avoid": [],
    "plan": None,
    "threshold": [],
}


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument(
        "clip", metavar="CLIP", help="BVH, AMC, GLB, CSV or NPZ file, or a built-in name"
    )
    parser.add_argument(
        "--scene", required=True, help="MJCF file, or the name of one of our scenes"
    )
    add_keyframe(parser)
    add_folder(parser)
    parser.add_argument(
        "--contacts", type=Path, help="contacts.json to use instead of finding them"
    )
    parser.add_argument(
        "--constraints", type=Path, help="YAML or JSON file of your own constraints"
    )
    add_fitting(parser)
    add_planning(parser)
    add_free_footholds(parser)
    add_reading(parser)
    add_thresholds(parser)
    parser.set_defaults(**DEFAULTS)


def add_planning(parser: argparse.ArgumentParser) -> None:
    """Add what of a walk may change where a scene asks for it."""
    add_heading(parser)
    parser.add_argument(
        "--path",
        metavar="bend|keep|FILE",
        help="go round what is in the way, keep the clip's own, or take that of a CSV, JSON or"
        " YAML file of x and y: bend",
    )
    parser.add_argument("--plan", type=Path, help="plan.json to take back, edited or not")
    parser.add_argument(
        "--avoid", action="append", metavar="GEOM", help="geom not to stand on; may repeat"
    )
    parser.add_argument(
        "--climb", action="store_true", help="step on what is higher than 0.45 m, not round it"
    )
    parser.add_argument(
        "--strict", action="store_true", help="an error where there is no way: nothing is written"
    )


def read_planning(
    args: argparse.Namespace, clip: Motion
) -> tuple[tuple[Contact, ...] | None, PlanSettings]:
    """Return the contacts of ``--plan`` or ``--contacts``, and what of the walk may change."""
    from mjmotion.exceptions import ContactError
    from mjmotion.footsteps.contacts import load_contacts
    from mjmotion.footsteps.plan_file import load_plan
    from mjmotion.footsteps.settings import PATHS, PlanSettings
    from mjmotion.route.given import read_way

    path = args.path if args.path in PATHS else read_way(args.path)
    settings = PlanSettings(
        path=path, avoid=tuple(args.avoid), climb=args.climb, strict=args.strict
    )
    if args.plan is not None:
        if args.contacts is not None or args.path != "bend":
            raise ContactError(
                "--plan has contacts and a path of its own: leave --contacts, --path"
            )
        return load_plan(args.plan, clip, settings)
    contacts = load_contacts(args.contacts, clip.model, clip.nframe) if args.contacts else None
    return contacts, settings


def run(args: argparse.Namespace) -> int:
    """Adapt a clip to a scene, validate the result and write everything into a folder."""
    from mjmotion.apps.adaptation import adapt
    from mjmotion.cli.run import prepare, tell, write
    from mjmotion.cli.terminal import Bar
    from mjmotion.constraints import load_constraints
    from mjmotion.constraints.unmet import check_free
    from mjmotion.output.folder import result_folder
    from mjmotion.scene import load_scene

    thresholds = prepare(args)
    with Bar() as bar, result_folder(args.out, args.force) as folder:
        bar("reading scene and clip")
        scene = load_scene(args.scene).at_rest(args.keyframe)
        (clip, _), odd = read_noted(args, args.clip, folders=False)
        contacts, planning = read_planning(args, clip)
        own = (
            load_constraints(args.constraints, clip.model, clip.nframe) if args.constraints else ()
        )
        with telling(odd):
            result = adapt(
                clip,
                scene,
                contacts=contacts,
                constraints=own,
                free_footholds=args.free_footholds,
                heading=args.heading,
                planning=planning,
                levels=args.levels,
                tolerance=args.tolerance,
                ik=args.ik,
                progress=bar,
            )
        check_free(result.unmet, own)
        title = f"{Path(args.clip).stem} on {scene.name}"
        validation = write(folder, result, thresholds, args, bar, title=title)
    return tell(args, result, validation, title=title)
