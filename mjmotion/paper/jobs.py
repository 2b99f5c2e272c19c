"""Table 1 of the paper as it is printed: Lee and Shin, *A Hierarchical Approach to Interactive
Motion Editing for Human-like Figures*, SIGGRAPH 1999, page 46. Times are CPU seconds of 1999.
"""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass(frozen=True)
class Column:
    """One column of Table 1.

    Attributes:
      name: of the job.
      ndof: parameters: degrees of freedom that serve.
      nreduced: reduced parameters, those of hybrid IK.
      nframe: frames.
      nscalar: scalar constraints, joint limits not counted.
      preprocessing_seconds: time of the first guess [s]; None where the paper gives none.
      frames_per_knot: of each level.
      seconds: time of each level [s].
      max_error_percent: largest error after each level [% of the character's height].
    """

    name: str
    ndof: int
    nreduced: int
    nframe: int
    nscalar: int
    preprocessing_seconds: float | None
    frames_per_knot: tuple[float, ...]
    seconds: tuple[float, ...]
    max_error_percent: tuple[float, ...]


_FRAMES_PER_KNOT = (16.0, 8.0, 4.0, 2.0)

PAPER: dict[str, Column] = {
    "terrain": Column(
        name="walking on rough terrain",
        ndof=20,
        nreduced=8,
        nframe=464,
        nscalar=5568,
        preprocessing_seconds=0.17,
        frames_per_knot=_FRAMES_PER_KNOT,
        seconds=(2.50, 1.67, 1.31, 1.10),
        max_error_percent=(14.31, 9.24, 3.48, 1.06),
    ),
    "rope": Column(
        name="climbing a rope",
        ndof=37,
        nreduced=13,
        nframe=275,
        nscalar=5898,
        preprocessing_seconds=0.21,
        frames_per_knot=_FRAMES_PER_KNOT,
        seconds=(6.50, 3.51, 1.32, 0.70),
        max_error_percent=(11.09, 7.51, 3.57, 1.11),
    ),
    "morph": Column(
        name="character morphing",
        ndof=20,
        nreduced=8,
        nframe=62,
        nscalar=420,
        preprocessing_seconds=0.02,
        frames_per_knot=_FRAMES_PER_KNOT,
        seconds=(0.18, 0.13, 0.09, 0.06),
        max_error_percent=(6.98, 5.35, 3.08, 1.10),
    ),
    "transition": Column(
        name="transition",
        ndof=20,
        nreduced=8,
        nframe=119,
        nscalar=834,
        preprocessing_seconds=None,
        frames_per_knot=_FRAMES_PER_KNOT,
        seconds=(0.18, 0.15, 0.15, 0.14),
        max_error_percent=(7.17, 4.71, 2.14, 0.74),
    ),
}
"""The columns by the modules of this package that make the jobs."""
