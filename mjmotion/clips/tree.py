"""The tree of a clip's joints as points: what hangs on what, how far, and where it all is."""

from __future__ import annotations

import dataclasses
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mjmotion.clips.skeleton import Clip

Array = NDArray[np.float64]

_SAMPLES = 40  # frames looked at, spread over the clip
_TOGETHER = 0.005  # of the longest way through the tree: joints nearer than this are one place


@dataclasses.dataclass(frozen=True, eq=False)
class PointTree:
    """Joints, then the ends of last bones, as one tree of points.

    Attributes:
      njoint: number of joints; points from there on are ends.
      parents: (npoint,) parent of each point, -1 for a root.
      places: (nsample, npoint, 3) positions in frames spread over the clip, the file's units.
      along: (npoint,) length of the way from the root to each point.
    """

    njoint: int
    parents: NDArray[np.int64]
    places: Array
    along: Array

    @staticmethod
    def of(clip: Clip) -> PointTree:
        """Return the tree of a clip."""
        frames = np.unique(np.linspace(0, clip.nframe - 1, _SAMPLES).round().astype(int))
        short = dataclasses.replace(
            clip, positions=clip.positions[frames], rotations=clip.rotations[frames]
        )
        ends = [short.end_positions(name) for name in clip.ends]
        places = np.concatenate([short.positions, *(end[:, None] for end in ends)], axis=1)
        hung = [clip.joint_names.index(name) for name in clip.ends]
        parents = np.concatenate([clip.parents, np.array(hung, dtype=np.int64)])
        # From the frames, not the offsets: position channels of any joint stretch a bone.
        bones = np.linalg.norm(places - places[:, np.maximum(parents, 0)], axis=2)
        bone = np.where(parents < 0, 0.0, np.median(bones, axis=0))
        along = np.zeros(len(parents))
        for point, parent in enumerate(parents):
            if parent >= 0:
                along[point] = along[parent] + bone[point]
        return PointTree(len(clip.joint_names), parents, places, along)

    @property
    def npoint(self) -> int:
        """Number of points."""
        return len(self.parents)

    @cached_property
    def children(self) -> tuple[tuple[int, ...], ...]:
        """The points that hang on each point."""
        found: list[list[int]] = [[] for _ in range(self.npoint)]
        for point, parent in enumerate(self.parents):
            if parent >= 0:
                found[parent].append(point)
        return tuple(tuple(points) for points in found)

    @cached_property
    def lines(self) -> tuple[tuple[int, ...], ...]:
        """Of each point the way from the root to it, both included."""
        found: list[tuple[int, ...]] = []
        for point, parent in enumerate(self.parents):
            found.append((*found[parent], point) if parent >= 0 else (point,))
        return tuple(found)

    @cached_property
    def below(self) -> tuple[tuple[int, ...], ...]:
        """Of each point all that hangs on it, itself first."""
        found: list[list[int]] = [[] for _ in range(self.npoint)]
        for point in range(self.npoint):
            for above in self.lines[point]:
                found[above].append(point)
        return tuple(tuple(points) for points in found)

    @cached_property
    def tips(self) -> tuple[tuple[int, ...], ...]:
        """Of each point the last points under it, itself if it is one."""
        return tuple(
            tuple(point for point in points if not self.children[point]) for points in self.below
        )

    @property
    def together(self) -> float:
        """How near to each other two points are one place, in the file's units."""
        return _TOGETHER * float(self.along.max())

    def meeting(self, first: int, second: int) -> int:
        """Return the last point that both hang on, or -1 for points of two trees."""
        shared = -1
        for one, other in zip(self.lines[first], self.lines[second], strict=False):
            if one != other:
                break
            shared = one
        return shared

    def distance(self, first: int, second: int) -> float:
        """Return the median distance of two points."""
        return float(
            np.median(np.linalg.norm(self.places[:, first] - self.places[:, second], axis=1))
        )

    def middle(self, first: int, second: int) -> Array:
        """Return (nsample, 3) what is half way between two points."""
        return np.asarray((self.places[:, first] + self.places[:, second]) / 2)
