"""Render a result of ``mjmotion adapt`` your way: the source as a ghost, larger, a few stills.

python scripts/render_video.py out/walk ghost.mp4 --stills 5
"""

from __future__ import annotations

import argparse
from pathlib import Path

import imageio.v3 as iio
import numpy as np

from mjmotion import read_results
from mjmotion.output.video import render_frames, render_video


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("folder", type=Path, help="folder that mjmotion adapt wrote")
    parser.add_argument("video", type=Path, help=".mp4 file to write")
    parser.add_argument("--stills", type=int, default=0, help="pictures to write beside the video")
    parser.add_argument("--width", type=int, default=1280, help="[pixel]")
    parser.add_argument("--height", type=int, default=720, help="[pixel]")
    args = parser.parse_args()

    results = read_results(args.folder)
    path = render_video(
        args.video,
        results.motion,
        results.source,
        contacts=results.contacts,
        layout="ghost",
        width=args.width,
        height=args.height,
    )
    print(path)
    if args.stills:
        frames = np.linspace(0, results.motion.nframe - 1, args.stills).astype(int).tolist()
        pictures = render_frames(results.motion, frames, args.width, args.height)
        for frame, picture in zip(frames, pictures, strict=True):
            still = args.video.with_name(f"{args.video.stem}_{frame:04d}.png")
            iio.imwrite(still, picture)
            print(still)


if __name__ == "__main__":
    main()
