"""``mjmotion retarget``: a motion on a character of other proportions."""

from __future__ import annotations

import argparse
from pathlib import Path

from mjmotion.cli.arguments import (
    MOTION_HELP,
    add_fitting,
    add_folder,
    add_keyframe,
    add_reading,
    add_thresholds,
)

HELP = "move a motion to a character of other proportions, its contacts kept"
EXAMPLE = "mjmotion retarget walk --to climber --out out/climber"


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("motion", metavar="MOTION", help=MOTION_HELP)
    parser.add_argument(
        "--to", required=True, metavar="MODEL", help="MJCF file or the name of one of our models"
    )
    add_folder(parser)
    parser.add_argument(
        "--stride",
        choices=("keep", "scale"),
        default="keep",
        help="feet stand where they stood, or the path is scaled as the legs are: keep",
    )
    parser.add_argument(
        "--scene",
        help="MJCF file, or the name of one of our scenes: flat, or that of a result folder",
    )
    add_keyframe(parser)
    parser.add_argument(
        "--contacts", type=Path, help="contacts.json: who stands, and what hands hold, and when"
    )
    parser.add_argument(
        "--constraints", type=Path, help="YAML or JSON file of your own constraints"
    )
    add_fitting(parser)
    add_reading(parser)
    add_thresholds(parser)


def run(args: argparse.Namespace) -> int:
    """Retarget a motion, validate the result and write everything into a folder."""
    from mjmotion.apps.retarget import retarget
    from mjmotion.body.character import Character
    from mjmotion.cli.given import read_given
    from mjmotion.cli.run import prepare, tell, write
    from mjmotion.cli.terminal import Bar
    from mjmotion.constraints import load_constraints
    from mjmotion.constraints.unmet import check_free
    from mjmotion.footsteps.contacts import load_contacts
    from mjmotion.output.folder import result_folder
    from mjmotion.scene import load_scene, scene_of

    thresholds = prepare(args)
    with Bar() as bar, result_folder(args.out, args.force) as folder:
        bar("reading motion and models")
        given = read_given(args, args.motion)
        motion = given.motion
        body, own = Character.load(args.to), scene_of(motion.character)
        scene = load_scene(args.scene or "flat") if args.scene or own is None else own
        scene = scene.at_rest(args.keyframe)
        contacts = given.contacts
        if args.contacts:
            contacts = load_contacts(args.contacts, motion.model, motion.nframe)
        constraints = (
            load_constraints(args.constraints, body.model, motion.nframe)
            if args.constraints
            else ()
        )
        result = retarget(
            motion,
            body,
            stride=args.stride,
            contacts=contacts,
            scene=scene,
            constraints=constraints,
            levels=args.levels,
            tolerance=args.tolerance,
            ik=args.ik,
            progress=bar,
        )
        check_free(result.unmet, constraints)
        title = f"{Path(args.motion).stem} on {Path(args.to).stem}"
        validation = write(folder, result, thresholds, args, bar, title=title)
    return tell(args, result, validation, title=title)
