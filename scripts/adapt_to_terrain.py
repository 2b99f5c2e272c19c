"""Adapt one clip to rough terrain of your own and keep the result.

python scripts/adapt_to_terrain.py walk out/mine --seed 7
"""

from __future__ import annotations

import argparse
from pathlib import Path

from mjmotion.apps.adaptation import adapt
from mjmotion.scene import Scene, terrain


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("clip", help="BVH, AMC, CSV or NPZ file, or a built-in clip such as walk")
    parser.add_argument("out", type=Path, help="folder to write")
    parser.add_argument("--seed", type=int, default=1, help="seed of the terrain")
    parser.add_argument("--height", type=float, default=2.1, help="greatest control height [m]")
    args = parser.parse_args()

    scene = Scene.from_spec(terrain(args.seed, height=args.height), "terrain")
    result = adapt(args.clip, scene)
    result.save(args.out)
    print(result.validate())


if __name__ == "__main__":
    main()
