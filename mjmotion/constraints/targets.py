"""All constraints of one fit, laid out as arrays over its constrained frames."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.kinematics import Pose, site_id
from mjmotion.constraints.types import (
    Constraint,
    LookAt,
    RelativeConstraint,
    SiteConstraint,
    check_constraints,
)
from mjmotion.exceptions import ConstraintError, frame_list
from mjmotion.numerics.rotations import to_matrix

Array = NDArray[np.float64]
Index = NDArray[np.int64]

NONE = -1  # index of a target that no constraint asks for


@dataclasses.dataclass(frozen=True, eq=False)
class RelativeTarget:
    """One site held in the frame of another; absent where the weights are zero.

    Attributes:
      site, to: ids of the two sites.
      position: (n, 3) [m] and quat: (n, 4), in the frame of ``to``.
      position_weight, turn_weight: (n,) in [0, 1].
      position_index, turn_index: (n,) which constraint asks for it, -1 for none.
    """

    site: int
    to: int
    position: Array
    quat: Array
    position_weight: Array
    turn_weight: Array
    position_index: Index
    turn_index: Index

    def world_position(self, pose: Pose) -> Array:
        """Return where (n, 3) the held site is to be, in the world [m]."""
        turned = pose.site_xmat[:, self.to] @ self.position[..., None]
        return np.asarray(pose.site_xpos[:, self.to] + turned[..., 0])


@dataclasses.dataclass(frozen=True, eq=False)
class LookAtTarget:
    """One site that faces a point; absent where the weight is zero.

    Attributes:
      site: id of the site.
      axis: (3,) the direction in its own frame.
      point: (n, 3) [m] and weight: (n,) in [0, 1].
      index: (n,) which constraint asks for it, -1 for none.
    """

    site: int
    axis: Array
    point: Array
    weight: Array
    index: Index


_RELATIVE = ("position", "quat", "position_weight", "turn_weight", "position_index", "turn_index")
_LOOK_AT = ("point", "weight", "index")
_BY_SITE = (
    "position",
    "matrix",
    "quat",
    "position_weight",
    "turn_weight",
    "contact",
    "position_index",
    "turn_index",
)


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
      position_index, turn_index: (n, s) which constraint asks for it, -1 for none.
      relative: sites held to other sites.
      look_at: sites that face a point.
    """

    frames: Index
    sites: Index
    position: Array
    matrix: Array
    quat: Array
    position_weight: Array
    turn_weight: Array
    contact: NDArray[np.bool_]
    position_index: Index
    turn_index: Index
    relative: tuple[RelativeTarget, ...] = ()
    look_at: tuple[LookAtTarget, ...] = ()

    def at(self, rows: Index) -> Targets:
        """Return the targets of some of the constrained frames."""
        values = {name: getattr(self, name)[rows] for name in ("frames", *_BY_SITE)}
        return Targets(
            sites=self.sites,
            relative=tuple(_take(one, _RELATIVE, rows) for one in self.relative),
            look_at=tuple(_take(one, _LOOK_AT, rows) for one in self.look_at),
            **values,
        )

    def columns(self, sites: NDArray[np.bool_]) -> Targets:
        """Return the targets of some of the sites, without relative ones and look-ats."""
        values = {name: getattr(self, name)[:, sites] for name in _BY_SITE}
        return Targets(frames=self.frames, sites=self.sites[sites], **values)

    def over_all_frames(self, nframe: int) -> Targets:
        """Return targets for every frame, nothing held where they say nothing."""
        if len(self.frames) == nframe:
            return self
        fields: dict[str, Any] = {
            name: _spread_field(name, getattr(self, name), self.frames, nframe) for name in _BY_SITE
        }
        return Targets(
            frames=np.arange(nframe),
            sites=self.sites,
            relative=tuple(_spread(one, _RELATIVE, self.frames, nframe) for one in self.relative),
            look_at=tuple(_spread(one, _LOOK_AT, self.frames, nframe) for one in self.look_at),
            **fields,
        )

    @property
    def relational(self) -> NDArray[np.bool_]:
        """Which frames (n,) hold sites to other sites, or turn them to a point."""
        weights = [np.maximum(one.position_weight, one.turn_weight) for one in self.relative]
        weights += [one.weight for one in self.look_at]
        return np.asarray(sum(weights, np.zeros(len(self.frames))) > 0.0)

    @property
    def turning(self) -> bool:
        """Whether anything is to turn, or to face a point, without a position that says how far."""
        kinds: tuple[Targets | RelativeTarget, ...] = (self, *self.relative)
        return bool(self.look_at) or any(
            ((one.turn_weight > 0.0) & (one.position_weight == 0.0)).any() for one in kinds
        )

    @property
    def held(self) -> NDArray[np.bool_]:
        """Which frames (n,) hold anything."""
        weight = np.maximum(self.position_weight, self.turn_weight)
        return np.asarray((weight > 0).any(axis=1)) | self.relational


def _take(one: Any, names: Sequence[str], rows: Index) -> Any:
    """Return a relative target or look-at at some of the constrained frames."""
    return dataclasses.replace(one, **{name: getattr(one, name)[rows] for name in names})


def _spread(one: Any, names: Sequence[str], frames: Index, nframe: int) -> Any:
    """Return a relative target or look-at over all frames."""
    fields = {name: _spread_field(name, getattr(one, name), frames, nframe) for name in names}
    return dataclasses.replace(one, **fields)


def _spread_field(name: str, values: Array, frames: Index, nframe: int) -> Array:
    """Return a field for every frame: zero, upright or no constraint's where it said nothing."""
    whole = np.zeros((nframe, *values.shape[1:]), dtype=values.dtype)
    if name == "quat":
        whole[..., 0] = 1.0
    elif name == "matrix":
        whole[...] = np.eye(3)
    elif name.endswith("index"):
        whole[...] = NONE
    whole[frames] = values
    return whole


def lay_out(constraints: Sequence[Constraint], model: mujoco.MjModel, nframe: int) -> Targets:
    """Lay constraints out over frames; where two speak of the same site and frame, the later holds.

    Raises:
      ConstraintError: a frame the motion does not have.
      ModelError: an unknown site.
    """
    sites = _check(constraints, model, nframe)
    frames = (
        np.unique(np.concatenate([c.frames for c in constraints]))
        if constraints
        else np.empty(0, np.int64)
    )
    shape = (len(frames), len(sites))
    position, contact = np.zeros((*shape, 3)), np.zeros(shape, dtype=bool)
    quat = np.zeros((*shape, 4))
    quat[..., 0] = 1.0
    weights, indices = np.zeros((2, *shape)), np.full((2, *shape), NONE)
    relative: dict[tuple[int, int], RelativeTarget] = {}
    look_at: list[LookAtTarget] = []
    for index, constraint in enumerate(constraints):
        rows = np.searchsorted(frames, constraint.frames)
        if isinstance(constraint, RelativeConstraint):
            _add_relative(relative, constraint, model, rows, len(frames), index)
            continue
        if isinstance(constraint, LookAt):
            _add_look_at(look_at, constraint, model, rows, len(frames), index)
            continue
        column = sites.index(site_id(model, constraint.site))
        if constraint.position is not None:
            position[rows, column] = constraint.position
            weights[0, rows, column] = constraint.weight
            indices[0, rows, column] = index
            contact[rows, column] = constraint.contact
        if constraint.quat is not None:
            quat[rows, column] = constraint.quat
            weights[1, rows, column] = constraint.weight
            indices[1, rows, column] = index
    return Targets(
        frames,
        np.array(sites, dtype=np.int64),
        position,
        to_matrix(quat),
        quat,
        weights[0],
        weights[1],
        contact,
        indices[0],
        indices[1],
        tuple(relative.values()),
        tuple(look_at),
    )


def _check(constraints: Sequence[Constraint], model: mujoco.MjModel, nframe: int) -> list[int]:
    """Return the sites that are held in the world; refuse what the model or motion lacks."""
    sites: list[int] = []
    check_constraints(constraints)
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
    return sites


def _add_relative(
    relative: dict[tuple[int, int], RelativeTarget],
    constraint: RelativeConstraint,
    model: mujoco.MjModel,
    rows: Index,
    count: int,
    index: int,
) -> None:
    key = site_id(model, constraint.site), site_id(model, constraint.to)
    if model.site_bodyid[key[0]] == model.site_bodyid[key[1]]:
        raise ConstraintError(
            f"sites '{constraint.site}' and '{constraint.to}' are on one body: nothing can move one"
            " to the other"
        )
    if key not in relative:
        relative[key] = RelativeTarget(
            *key,
            position=np.zeros((count, 3)),
            quat=np.tile((1.0, 0.0, 0.0, 0.0), (count, 1)),
            position_weight=np.zeros(count),
            turn_weight=np.zeros(count),
            position_index=np.full(count, NONE),
            turn_index=np.full(count, NONE),
        )
    one = relative[key]
    if constraint.position is not None:
        one.position[rows] = constraint.position
        one.position_weight[rows] = constraint.weight
        one.position_index[rows] = index
    if constraint.quat is not None:
        one.quat[rows] = constraint.quat
        one.turn_weight[rows] = constraint.weight
        one.turn_index[rows] = index


def _add_look_at(
    look_at: list[LookAtTarget],
    constraint: LookAt,
    model: mujoco.MjModel,
    rows: Index,
    count: int,
    index: int,
) -> None:
    site = site_id(model, constraint.site)
    for before in look_at:  # the later holds
        if before.site == site and np.allclose(before.axis, constraint.axis):
            before.weight[rows] = 0.0
            before.index[rows] = NONE
    point, weight = np.zeros((count, 3)), np.zeros(count)
    point[rows], weight[rows] = constraint.point, constraint.weight
    whose = np.full(count, NONE)
    whose[rows] = index
    look_at.append(LookAtTarget(site, constraint.axis, point, weight, whose))
