"""Write the shipped scenes again, bit for bit: ``python scripts/make_scenes.py [FOLDER]``."""

from __future__ import annotations

import sys
from pathlib import Path

from mjmotion.scene import blocks, doors, flat, rope, save_model, slope, stairs, terrain

SCENES = {
    "flat": flat,
    "terrain": terrain,
    "terrain_doors": doors,
    "stairs": stairs,
    "slope": slope,
    "blocks": blocks,
    "rope": rope,
}


def write_scenes(folder: Path) -> list[Path]:
    """Write every shipped scene into ``folder``; both terrain scenes share one heightfield."""
    (folder / "terrain.bin").unlink(missing_ok=True)  # else a changed one gets another name
    return [save_model(build(), folder, f"{name}.xml") for name, build in SCENES.items()]


if __name__ == "__main__":
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parents[1] / "scenes"
    for path in write_scenes(target):
        print(path)
