"""All constraints of one fit, laid out as arrays over its constrained frames."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.kinematics import site_id
from mjmotion.constraints.types import Constraint, LookAt, RelativeConstraint, SiteConstraint
from mjmotion.exceptions import ConstraintError, frame_list
from mjmotion.numerics.rotations import to_matrix

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class Link:
    """One site held in the frame of another; absent where the weights are zero.

    Attributes:
      site, to: ids of the two sites.
      position: (n, 3) [m] and quat: (n, 4), in the frame of ``to``.
      position_weight, turn_weight: (n,) in [0, 1].
    """

    site: int
    to: int
    position: Array
    quat: Array
    position_weight: Array
    turn_weight: Array

    def at(self, rows: NDArray[np.int64]) -> Link:
        """Return what is asked at some of the constrained frames."""
        return dataclasses.replace(
            self,
            position=self.position[rows],
            quat=self.quat[rows],
            position_weight=self.position_weight[rows],
            turn_weight=self.turn_weight[rows],
        )


@dataclasses.dataclass(frozen=True, eq=False)
class Gaze:
    """One site that faces a point; absent where the weight is zero.

    Attributes:
      site: id of the site.
      axis: (3,) the direction in its own frame.
      point: (n, 3) [m] and weight: (n,) in [0, 1].
    """

    site: int
    axis: Array
    point: Array
    weight: Array

    def at(self, rows: NDArray[np.int64]) -> Gaze:
        """Return what is asked at some of the constrained frames."""
        return dataclasses.replace(self, point=self.point[rows], weight=self.weight[rows])


@dataclasses.dataclass(frozen=True, eq=False)
class Targets:
    """All constraints of one fit, laid out over its constrained frames.

    Attributes:
      frames: (n,) constrained frames, in order.
      sites: (s,) ids of the constrained sites.
      position: (n, s, 3) [m]; holds where ``position_weight`` is not zero.
      matrix: (n, s, 3, 3) orientations; holds where ``turn_weight`` is not zero.
      quat: (n, s, 4) the same, wxyz.
      position_weight, turn_weight: (n, s) in [0, 1].
      contact: (n, s) whether the position is that of a contact.
      links: sites held to other sites.
      gazes: sites that face a point.
    """

    frames: NDArray[np.int64]
    sites: NDArray[np.int64]
    position: Array
    matrix: Array
    quat: Array
    position_weight: Array
    turn_weight: Array
    contact: NDArray[np.bool_]
    links: tuple[Link, ...] = ()
    gazes: tuple[Gaze, ...] = ()

    def at(self, rows: NDArray[np.int64]) -> Targets:
        """Return the targets of some of the constrained frames."""
        values = {name: getattr(self, name)[rows] for name in ("frames", *_BY_SITE)}
        links = tuple(link.at(rows) for link in self.links)
        gazes = tuple(gaze.at(rows) for gaze in self.gazes)
        return Targets(sites=self.sites, links=links, gazes=gazes, **values)

    def columns(self, sites: NDArray[np.bool_]) -> Targets:
        """Return the targets of some of the sites, without links and gazes."""
        values = {name: getattr(self, name)[:, sites] for name in _BY_SITE}
        return Targets(frames=self.frames, sites=self.sites[sites], **values)

    @property
    def other(self) -> NDArray[np.bool_]:
        """Which frames (n,) hold links or gazes."""
        weights = [np.maximum(link.position_weight, link.turn_weight) for link in self.links]
        weights += [gaze.weight for gaze in self.gazes]
        return np.asarray(sum(weights, np.zeros(len(self.frames))) > 0.0)

    @property
    def turning(self) -> bool:
        """Whether anything is to turn, or to face a point, without a position that says how far."""
        kinds: tuple[Targets | Link, ...] = (self, *self.links)
        return bool(self.gazes) or any(
            ((one.turn_weight > 0.0) & (one.position_weight == 0.0)).any() for one in kinds
        )

    @property
    def held(self) -> NDArray[np.bool_]:
        """Which frames (n,) hold anything."""
        weight = np.maximum(self.position_weight, self.turn_weight)
        return np.asarray((weight > 0).any(axis=1)) | self.other


_BY_SITE = ("position", "matrix", "quat", "position_weight", "turn_weight", "contact")


def lay_out(constraints: Sequence[Constraint], model: mujoco.MjModel, nframe: int) -> Targets:
    """Lay constraints out over frames; where two speak of the same site and frame, the later holds.

    Raises:
      ConstraintError: a frame the motion does not have.
      ModelError: an unknown site.
    """
    sites: list[int] = []
    for constraint in constraints:
        index = site_id(model, constraint.site)
        if isinstance(constraint, SiteConstraint) and index not in sites:
            sites.append(index)
        bad = constraint.frames[(constraint.frames < 0) | (constraint.frames >= nframe)]
        if len(bad):
            raise ConstraintError(
                f"constraint on site '{constraint.site}' names frames {frame_list(bad)}:"
                f" the motion has 0 to {nframe - 1}",
                bad,
            )
    frames = (
        np.unique(np.concatenate([c.frames for c in constraints]))
        if constraints
        else np.empty(0, np.int64)
    )
    shape = (len(frames), len(sites))
    position, contact = np.zeros((*shape, 3)), np.zeros(shape, dtype=bool)
    quat = np.zeros((*shape, 4))
    quat[..., 0] = 1.0
    weights = np.zeros((2, *shape))
    links: dict[tuple[int, int], Link] = {}
    gazes: list[Gaze] = []
    for constraint in constraints:
        rows = np.searchsorted(frames, constraint.frames)
        if isinstance(constraint, RelativeConstraint):
            _add_link(links, constraint, model, rows, len(frames))
            continue
        if isinstance(constraint, LookAt):
            gaze = _gaze(constraint, model, rows, len(frames))
            for before in gazes:
                if before.site == gaze.site and np.allclose(before.axis, gaze.axis):
                    before.weight[rows] = 0.0
            gazes.append(gaze)
            continue
        column = sites.index(site_id(model, constraint.site))
        if constraint.position is not None:
            position[rows, column] = constraint.position
            weights[0, rows, column] = constraint.weight
            contact[rows, column] = constraint.contact
        if constraint.quat is not None:
            quat[rows, column] = constraint.quat
            weights[1, rows, column] = constraint.weight
    return Targets(
        frames,
        np.array(sites, dtype=np.int64),
        position,
        to_matrix(quat),
        quat,
        weights[0],
        weights[1],
        contact,
        tuple(links.values()),
        tuple(gazes),
    )


def _add_link(
    links: dict[tuple[int, int], Link],
    constraint: RelativeConstraint,
    model: mujoco.MjModel,
    rows: NDArray[np.int64],
    count: int,
) -> None:
    key = site_id(model, constraint.site), site_id(model, constraint.to)
    if model.site_bodyid[key[0]] == model.site_bodyid[key[1]]:
        raise ConstraintError(
            f"sites '{constraint.site}' and '{constraint.to}' are on one body: nothing can move one"
            " to the other"
        )
    if key not in links:
        upright = np.tile((1.0, 0.0, 0.0, 0.0), (count, 1))
        links[key] = Link(*key, np.zeros((count, 3)), upright, np.zeros(count), np.zeros(count))
    link = links[key]
    if constraint.position is not None:
        link.position[rows] = constraint.position
        link.position_weight[rows] = constraint.weight
    if constraint.quat is not None:
        link.quat[rows] = constraint.quat
        link.turn_weight[rows] = constraint.weight


def _gaze(constraint: LookAt, model: mujoco.MjModel, rows: NDArray[np.int64], count: int) -> Gaze:
    point, weight = np.zeros((count, 3)), np.zeros(count)
    point[rows], weight[rows] = constraint.point, constraint.weight
    return Gaze(site_id(model, constraint.site), constraint.axis, point, weight)
