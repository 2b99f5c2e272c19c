"""The paper's pictures made anew: Figures 2 and 5(a) to 5(e) as videos, and a page of stills.

python scripts/gallery.py --out out/gallery
python scripts/gallery.py --out out/gallery --only rope --stills docs/images
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from mjmotion.cli.main import main as mjmotion

WIDTH, GAP = 1500, 4  # of a row of stills [pixels]
STYLE = """
:root { color-scheme: light dark; }
body { margin: 0 auto; max-width: 66rem; padding: 2.5rem 1.25rem 4rem;
  font: 16px/1.5 system-ui, "DejaVu Sans", sans-serif; }
h1 { font-size: 1.7rem; } h2 { font-size: 1.15rem; margin: 2.75rem 0 .25rem; }
p { margin: .25rem 0 .75rem; max-width: 48rem; } .soft { opacity: .7; font-size: .92rem; }
img, video { width: 100%; display: block; border-radius: 6px; margin: .5rem 0; }
"""


@dataclass(frozen=True)
class Piece:
    """One figure of the paper: what it shows, and the command that makes it.

    Attributes:
      name: of its folder and still.
      figure: its number in the paper.
      caption: what is to be seen.
      command: arguments of ``mjmotion``, without ``--out``; none for the job of Table 1 itself.
        ``{out}`` stands for the gallery's folder: a piece may go on from one before it.
      stills: when the stills are taken, as shares of the video.
      layout: of a video of its own, where the command's is not the one wanted.
    """

    name: str
    figure: str
    caption: str
    command: tuple[str, ...]
    stills: tuple[float, ...]
    layout: str | None = None


PIECES = (
    Piece(
        "original",
        "5(a)",
        "The original walk on the flat ground: start, straight, left, right, stop.",
        ("adapt", "walk", "--scene", "flat"),
        (0.05, 0.3, 0.55, 0.8),
        layout="single",
    ),
    Piece(
        "edit",
        "2",
        "A walk changed at one frame: the pelvis sinks and the body bends forward; the frames that"
        " seven knots cover follow.",
        (
            *("edit-frame", "{out}/original", "--frame", "232", "--spacing", "12", "--levels", "4"),
            *("--site", "pelvis", "--by", "0", "0", "-0.15"),
            *("--site", "head_top", "--by", "0.25", "0", "-0.35"),
        ),
        (0.35, 0.5, 0.65),
    ),
    Piece(
        "terrain",
        "5(b)",
        "The walk adapted to rough terrain with doorways.",
        ("adapt", "walk", "--scene", "terrain_doors"),
        (0.15, 0.33, 0.55, 0.8),
        layout="single",
    ),
    Piece(
        "rope",
        "5(c)",
        "Climbing a rope: the humanoid, and a climber of longer legs, shorter body and arms.",
        ("rope",),
        (0.05, 0.35, 0.65, 0.95),
    ),
    Piece(
        "morph",
        "5(d)",
        "A character that grows long legs and a short body, then short legs and a long body, while"
        " its stride stays uniform.",
        ("morph",),
        (0.02, 0.35, 0.65, 0.98),
    ),
    Piece(
        "transition",
        "5(e)",
        "From walking to sneaking and back, 119 frames.",
        (),
        (0.02, 0.3, 0.6, 0.98),
    ),
)


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("out/gallery"), help="folder to write")
    parser.add_argument("--only", nargs="+", choices=[piece.name for piece in PIECES])
    parser.add_argument("--stills", type=Path, help="folder for a copy of the stills")
    args = parser.parse_args(argv)
    args.out.mkdir(parents=True, exist_ok=True)
    worst = 0
    for piece in PIECES:
        if args.only is None or piece.name in args.only:
            worst = max(worst, make(piece, args.out, args.stills))
    page = args.out / "index.html"
    page.write_text(html([piece for piece in PIECES if done(piece, args.out)], args.out), "utf-8")
    print(f"gallery {page}")
    return worst


def done(piece: Piece, out: Path) -> bool:
    """Whether a piece has been made."""
    return (out / f"{piece.name}.jpg").is_file() and video(piece, out).is_file()


def video(piece: Piece, out: Path) -> Path:
    """Where the video of a piece is."""
    return out / piece.name / "video.mp4" if piece.layout is None else out / f"{piece.name}.mp4"


def make(piece: Piece, out: Path, stills: Path | None) -> int:
    """Run a piece's command, render its video where that is another, and take its stills."""
    folder = out / piece.name
    print(f"\n--- Figure {piece.figure}: {piece.name}", flush=True)
    more = [] if piece.layout is None else ["--no-video"]
    if piece.command:
        command = [part.format(out=out) for part in piece.command]
        code = mjmotion([*command, "--out", str(folder), "--force", *more])
    else:
        code = paper_transition(folder)
    if code > 1:
        return code
    if piece.layout is not None:
        path = str(video(piece, out))
        mjmotion(["render", str(folder), "--layout", piece.layout, "--out", path, "--force"])
    picture = row(video(piece, out), piece.stills)
    for place in (out, stills):
        if place is not None:
            save(picture, place / f"{piece.name}.jpg")
    return code


def paper_transition(out: Path) -> int:
    """Fit and write the transitions of Table 1: a part of what ``join walk sneak walk`` gives."""
    from mjmotion import result_folder, write_results
    from mjmotion.output.result import Result
    from mjmotion.paper.transition import make_job
    from mjmotion.scene import compose
    from mjmotion.validation import validate

    job = make_job()
    result = job.fit()
    composed = compose("humanoid", "flat")
    source, motion = job.motion.on(composed), result.motion.on(composed)
    whole = Result(source, motion, job.contacts, result.trace, ())
    measured = validate(whole.source, whole.motion, whole.contacts)
    with result_folder(out, force=True) as folder:
        write_results(folder, whole, measured, title="Walking, sneaking, walking")
    return 1 if measured.broken() else 0


def row(path: Path, shares: Sequence[float]) -> np.ndarray:
    """Return stills of a video side by side (height, width, 3)."""
    import imageio.v3 as iio
    from PIL import Image

    frames = list(iio.imiter(path))
    chosen = [frames[round(share * (len(frames) - 1))] for share in shares]
    width = (WIDTH - GAP * (len(chosen) - 1)) // len(chosen)
    height = round(width * chosen[0].shape[0] / chosen[0].shape[1])
    parts: list[np.ndarray] = []
    for still in chosen:
        small = Image.fromarray(still).resize((width, height), Image.Resampling.LANCZOS)
        parts += [np.asarray(small), np.full((height, GAP, 3), 255, np.uint8)]
    return np.concatenate(parts[:-1], axis=1)


def save(picture: np.ndarray, path: Path) -> None:
    """Write a still."""
    import imageio.v3 as iio

    iio.imwrite(path, picture, quality=85)
    print(path)


def reached(folder: Path) -> str:
    """Return the figures that a piece reached, as text."""
    report: dict[str, Any] = json.loads((folder / "report.json").read_text("utf-8"))
    metrics = report.get("metrics", {})
    parts = []
    if report.get("levels"):
        errors = ", ".join(f"{level['max_error_percent']:.2f}" for level in report["levels"][:4])
        parts.append(f"largest error after each level {errors} % of height")
    if report.get("fit_seconds"):
        parts.append(f"fitted in {1000 * report['fit_seconds']:.0f} ms")
    for name, text in (
        ("stance_drift_mm", "contacts drift {:.2f} mm at most"),
        ("drift_mm", "hands and feet drift {:.2f} mm at most while they hold"),
        ("held_mm", "held points stay within {:.1f} mm of the rope"),
        ("free_mm", "all else keeps {:.1f} mm from it"),
        ("jerk_ratio_rms", "joint jerk {:.2f} of the source's"),
    ):
        if isinstance(metrics.get(name), int | float):
            parts.append(text.format(metrics[name]))
    return "; ".join(parts)


def plots(folder: Path) -> list[Path]:
    """Return the plots that a command left beside its video."""
    return sorted(folder.glob("*.png"))


def html(pieces: Sequence[Piece], out: Path) -> str:
    """Return the page."""
    parts = [f"<!doctype html><meta charset=utf-8><title>Gallery</title><style>{STYLE}</style>"]
    parts.append("<h1>The paper's figures</h1>")
    for piece in sorted(pieces, key=lambda piece: piece.figure):
        film = video(piece, out).relative_to(out)
        command = " ".join(("mjmotion", *piece.command, "--out", f"out/{piece.name}"))
        command = command.format(out="out")
        if not piece.command:
            command = "mjmotion.paper.transition.make_job().fit()"
        parts += [
            f"<h2>Figure {escape(piece.figure)}</h2><p>{escape(piece.caption)}</p>",
            f'<img src="{piece.name}.jpg" alt="{escape(piece.caption)}">',
            f'<video src="{film}" controls muted loop preload="metadata"></video>',
            *(f'<img src="{plot.relative_to(out)}" alt="">' for plot in plots(out / piece.name)),
            f'<p class="soft">{escape(reached(out / piece.name))}<br>',
            f"<code>{escape(command)}</code></p>",
        ]
    return "\n".join(parts) + "\n"


if __name__ == "__main__":
    sys.exit(main())
