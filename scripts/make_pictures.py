"""Make the pictures of the README anew from the result of make demo.

python scripts/make_pictures.py out/demo
"""

from __future__ import annotations

import argparse
from pathlib import Path

import imageio.v3 as iio

from mjmotion import read_results
from mjmotion.output.video import render_frames, render_strip

FOLDER = Path(__file__).resolve().parents[1] / "docs" / "images"
DOORS = (40, 66, 80, 97, 112, 128, 144, 160, 176, 196)  # on the way through the three doorways
DUCKING = 156  # under the last of them


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("folder", type=Path, help="folder that mjmotion demo wrote")
    results = read_results(parser.parse_args().folder)
    FOLDER.mkdir(exist_ok=True)
    strip = render_strip(results.motion, DOORS, 1600, 560)
    pair = render_frames(
        results.motion,
        [DUCKING],
        1280,
        720,
        source=results.source,
        contacts=results.contacts,
        layout="side-by-side",
    )[0]
    for name, picture in (("doors.jpg", strip), ("side_by_side.jpg", pair)):
        iio.imwrite(FOLDER / name, picture, quality=85)
        print(FOLDER / name)


if __name__ == "__main__":
    main()
