"""Adapt one clip to rough terrain of your own and keep the result.

python scripts/adapt_to_terrain.py walk out/mine --seed 7
"""

from __future__ import annotations

import argparse
from pathlib import Path

from mjmotion import result_folder, write_results
from mjmotion.apps.adaptation import adapt
from mjmotion.clips import load_clip
from mjmotion.output.report import table
from mjmotion.scene import Scene, terrain
from mjmotion.validation import validate


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("clip", help="BVH, AMC, CSV or NPZ file, or a built-in clip such as walk")
    parser.add_argument("out", type=Path, help="folder to write")
    parser.add_argument("--seed", type=int, default=1, help="seed of the terrain")
    parser.add_argument("--height", type=float, default=2.1, help="greatest control height [m]")
    args = parser.parse_args()

    scene = Scene.from_spec(terrain(args.seed, height=args.height), "terrain")
    adaptation = adapt(load_clip(args.clip), scene)
    validation = validate(adaptation.source, adaptation.motion, adaptation.contacts)
    with result_folder(args.out) as folder:
        write_results(folder, adaptation, validation, video=False)
    print(table(validation))


if __name__ == "__main__":
    main()
