"""Targets that move as a whole: one unknown move shared by many frames (§7).

    free = SharedMove("left_foot", frames, share, pivot, directions=np.eye(3)[:2], axis=(0, 0, 1))
    result = fit(motion, constraints, shared=[free])
    result.moves                       # how far it went, and how far it turned

A foothold that must not slide but may be somewhere else is one unknown for all frames of its
contact. At each level the poses answer to the move through a quadratic: what a frame's least
deviation (Eq. 4) costs when its targets change by δ is ``½ δᵀ H δ + gᵀ δ``, with H and g of that
frame alone (:class:`Sensitivity`). The poses are thereby eliminated frame by frame; what is left is
one small system in the moves, banded because a move meets only those that share frames with it. So
the cost stays linear in frames.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import mujoco
import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray

from mjmotion.body.kinematics import site_id
from mjmotion.constraints import Constraint, SiteConstraint, Targets
from mjmotion.exceptions import ConstraintError
from mjmotion.numerics.rotations import (
    conjugate,
    cross,
    exp,
    multiply,
    normalized,
    rotate,
    to_matrix,
)

Array = NDArray[np.float64]

RIGIDITY = 1e-3  # α of a move on which nothing else depends, so that it stays [1/m²]
STEP_LIMIT = 0.5  # the most that a move changes at one level [m or rad]
SETTLED = 1e-4  # a move that changes less at a level is settled [m or rad]
_FEW = 64  # frames that are asked anyway
_WIDTH = 4  # unknowns of a move: three directions and a turn


@dataclasses.dataclass(frozen=True, eq=False)
class SharedMove:
    """One unknown move of several frames' targets of one site.

    A target x becomes ``pivot + R(axis, share·yaw) (x − pivot) + share · Σ u_i direction_i``; its
    orientation turns alike.

    Attributes:
      site: name of the site whose targets move.
      frames: (n,) frames, each once.
      share: (n,) in [0, 1]: 1 where the move is made in full, as during a contact; it may fade to 0
        through the frames before and after.
      pivot: (3,) point that stays when the targets turn [m].
      directions: (k, 3) directions in which they may move, at most three; made unit length.
      axis: (3,) what they may turn about, or None.
      rigidity: α of the move [1/m²] and of its turn.

    Raises:
      ConstraintError: shapes that do not fit, or nothing that is free.
    """

    site: str
    frames: NDArray[np.int64]
    share: Array
    pivot: Array
    directions: Array
    axis: Array | None = None
    rigidity: float = RIGIDITY

    def __post_init__(self) -> None:
        where = f"shared move of '{self.site}'"
        try:
            frames = np.array(self.frames, dtype=np.int64).reshape(-1)
            share = np.array(np.broadcast_to(np.asarray(self.share, np.float64), frames.shape))
            pivot = np.array(self.pivot, dtype=np.float64).reshape(3)
            directions = np.array(self.directions, dtype=np.float64).reshape(-1, 3)
            axis = None if self.axis is None else np.array(self.axis, dtype=np.float64).reshape(3)
        except (TypeError, ValueError) as error:
            raise ConstraintError(
                f"{where}: give frames (n,), share (n,), pivot (3,), directions (k, 3), axis (3,)"
            ) from error
        if len(frames) == 0 or len(np.unique(frames)) != len(frames):
            raise ConstraintError(f"{where} must have frames, each once")
        lengths = np.linalg.norm(directions if axis is None else [*directions, axis], axis=-1)
        if len(directions) > 3 or (len(directions) == 0 and axis is None):
            raise ConstraintError(f"{where} must have one to three directions, or an axis")
        if not (np.isfinite(pivot).all() and ((lengths > 1e-9) & (lengths < np.inf)).all()):
            raise ConstraintError(f"{where}: pivot not finite, or direction of length 0")
        if not ((share >= 0.0) & (share <= 1.0)).all() or not 0.0 < self.rigidity < np.inf:
            raise ConstraintError(f"{where}: shares must be in [0, 1], the rigidity positive")
        for name, value in (
            ("frames", frames),
            ("share", share),
            ("pivot", pivot),
            ("directions", normalized(directions)),
            ("axis", axis if axis is None else normalized(axis)),
        ):
            object.__setattr__(self, name, value)


def free_moves(constraints: Sequence[Constraint]) -> list[SharedMove]:
    """Return the shared moves of constraints that say what is free of them."""
    moves = []
    for constraint in constraints:
        if isinstance(constraint, SiteConstraint) and constraint.free:
            assert constraint.position is not None
            directions = [np.eye(3)["xyz".index(n)] for n in constraint.free if n != "yaw"]
            moves.append(
                SharedMove(
                    constraint.site,
                    constraint.frames,
                    np.ones(len(constraint.frames)),
                    constraint.position.mean(axis=0),
                    np.array(directions).reshape(-1, 3),
                    np.array((0.0, 0.0, 1.0)) if "yaw" in constraint.free else None,
                )
            )
    return moves


def with_moves(constraints: Sequence[Constraint], values: Array) -> list[Constraint]:
    """Return constraints with the moves of those that are free made, and held there.

    Args:
      constraints: some free, some not.
      values: (m, 4) what the moves of the free ones came to, in order.
    """
    held = list(constraints)
    free = [
        index
        for index, one in enumerate(constraints)
        if isinstance(one, SiteConstraint) and one.free
    ]
    moves = free_moves(constraints)
    for index, move, value in zip(free, moves, values, strict=True):
        constraint = constraints[index]
        assert isinstance(constraint, SiteConstraint) and constraint.position is not None
        turn = exp(value[3] * (np.zeros(3) if move.axis is None else move.axis))
        step = value[: len(move.directions)] @ move.directions
        position = move.pivot + rotate(turn, constraint.position - move.pivot) + step
        quat = None if constraint.quat is None else multiply(turn, constraint.quat)
        held[index] = dataclasses.replace(constraint, position=position, quat=quat, free=())
    return held


@dataclasses.dataclass(frozen=True, eq=False)
class Sensitivity:
    """What each frame's least deviation costs when its targets change, to second order.

    A change of a site's target is six numbers: a move [m], then a turn [rad], in world axes.

    Attributes:
      gradient: (n, s, 6).
      hessian: (n, s, 6, s, 6).
    """

    gradient: Array
    hessian: Array


class SharedMoves:
    """Shared moves laid out over the frames of a fit's targets.

    Args:
      moves: the moves.
      targets: the targets as they are without any move.
      model: the model.

    Raises:
      ConstraintError: a move of targets that do not exist.
    """

    def __init__(
        self, moves: Sequence[SharedMove], targets: Targets, model: mujoco.MjModel
    ) -> None:
        self._moves = tuple(moves)
        self._targets = targets
        # Entries: one for each move, and target of its site in one of its frames.
        row, column, index, share = [], [], [], []
        asked = np.maximum(targets.position_weight, targets.turn_weight)
        place = np.full(int(targets.frames.max(initial=0)) + 1, -1)
        place[targets.frames] = np.arange(len(targets.frames))
        for number, move in enumerate(moves):
            found = np.flatnonzero(targets.sites == site_id(model, move.site))
            inside = (move.frames >= 0) & (move.frames < len(place))
            rows = np.where(inside, place[np.where(inside, move.frames, 0)], -1)
            there = (rows >= 0) & (asked[rows][:, found] > 0.0).any(axis=1)
            if not there.any():
                raise ConstraintError(
                    f"shared move of '{move.site}' at frames {move.frames[0]} to"
                    f" {move.frames[-1]}: no constraint holds that site there"
                )
            row.append(rows[there])
            column.append(np.full(len(row[-1]), found[0]))
            index.append(np.full(len(row[-1]), number))
            share.append(move.share[there])
        self._row, self._column = np.concatenate(row), np.concatenate(column)
        self._index, self._share = np.concatenate(index), np.concatenate(share)
        self._pivot = np.array([move.pivot for move in moves])
        self._directions = np.zeros((len(moves), 3, 3))
        self._axis = np.zeros((len(moves), 3))
        free = np.zeros((len(moves), _WIDTH), dtype=bool)
        for number, move in enumerate(moves):
            self._directions[number, : len(move.directions)] = move.directions
            free[number, : len(move.directions)] = True
            if move.axis is not None:
                self._axis[number], free[number, 3] = move.axis, True
        self._free = free
        self._rigidity = np.array([float(move.rigidity) for move in moves])[:, None]
        self._rounds = self._turns()
        self._pairs, self._blocks = self._meeting()

    @property
    def touched(self) -> NDArray[np.bool_]:
        """Which of the targets' frames (n,) any move has a share in."""
        return np.isin(np.arange(len(self._targets.frames)), self._row[self._share > 0.0])

    def some_rows(self, count: int) -> NDArray[np.int64]:
        """Return evenly spaced places in the targets' frames, some ``count`` of every move.

        All of them, where they are few, or where even spacing would miss most of a move.
        """
        size = np.bincount(self._index)
        step = max(1, min(int(size.min()) // count, len(self._targets.frames) // _FEW))
        rows = np.arange(step // 2, len(self._targets.frames), step)
        got = np.bincount(self._index[np.isin(self._row, rows)], minlength=len(size))
        return rows if (2 * step * got >= size).all() else np.arange(len(self._targets.frames))

    def moved(self, values: Array) -> Targets:
        """Return the targets after moves (nmove, 4): along the directions [m], and turns [rad]."""
        position, quat, _, _ = self._apply(values)
        return dataclasses.replace(
            self._targets, position=position, quat=quat, matrix=to_matrix(quat)
        )

    def _apply(
        self, values: Array, asked: NDArray[np.bool_] | None = None
    ) -> tuple[Array, Array, Array, Array]:
        """Make the moves (nmove, 4), of all entries or of those (nentry,) that are asked.

        Returns:
          positions (n, s, 3) and orientations (n, s, 4) of all targets, and of every entry, when
          its move was made: pivot to target (nentry, 3), turned, and the orientation (nentry, 4).
        """
        position, quat = self._targets.position.copy(), self._targets.quat.copy()
        step = np.einsum("ci,cij->cj", values[:, :3], self._directions)
        turn = values[:, 3:] * self._axis
        arm, own = np.empty((len(self._row), 3)), np.empty((len(self._row), 4))
        for some in self._rounds:
            entries = some if asked is None else some[asked[some]]
            where = (self._row[entries], self._column[entries])
            mine, share = self._index[entries], self._share[entries][:, None]
            turned, pivot = exp(share * turn[mine]), self._pivot[mine]
            arm[entries] = rotate(turned, position[where] - pivot)
            position[where] = pivot + arm[entries] + share * step[mine]
            quat[where] = own[entries] = multiply(turned, quat[where])
        return position, quat, arm, own

    def _effects(self, values: Array, asked: NDArray[np.bool_]) -> Array:
        """Return what each unknown does to a target (nentry, 6, 4): a move and a turn; else 0."""
        _, quat, arm, own = self._apply(values, asked)
        entry = np.flatnonzero(asked)
        index = self._index[entry]
        change = np.zeros((len(entry), _WIDTH, 2, 3))  # unknown; move, turn
        change[:, :3, 0], change[:, 3, 1] = self._directions[index], self._axis[index]
        change[:, 3, 0] = cross(self._axis[index], arm[entry])
        # What one move does is turned along by those that come after it.
        later = multiply(quat[self._row[entry], self._column[entry]], conjugate(own[entry]))
        change = rotate(later[:, None, None], change) * self._share[entry, None, None, None]
        effects = np.zeros((len(asked), 6, _WIDTH))
        effects[entry] = change.reshape(-1, _WIDTH, 6).swapaxes(1, 2)
        return effects

    def step(
        self, values: Array, targets: Targets, rows: NDArray[np.int64], sensitivity: Sensitivity
    ) -> Array:
        """Return better moves (nmove, 4): the least of the quadratic, moves kept from leaping.

        Args:
          values: (nmove, 4) moves so far.
          targets: what :meth:`moved` made of them.
          rows: (m,) which of the targets' frames are asked, rising; a few stand for all.
          sensitivity: of those frames, at those targets.
        """
        place = np.full(len(targets.frames), -1)
        place[rows] = np.arange(len(rows))
        weight = len(targets.frames) / len(rows)
        asked = place[self._row] >= 0
        entry = np.flatnonzero(asked)
        row, column = place[self._row[entry]], self._column[entry]
        effect = self._effects(values, asked)
        pull = np.zeros((len(self._row), _WIDTH))
        slope = sensitivity.gradient[row, column]
        pull[entry] = weight * (np.swapaxes(effect[entry], 1, 2) @ slope[..., None])[..., 0]
        starts = np.searchsorted(self._index, np.arange(len(values)))
        gradient = np.add.reduceat(pull, starts, axis=0) + self._rigidity * values
        one, other = self._pairs
        blocks = np.zeros((len(one), _WIDTH, _WIDTH))
        both = np.flatnonzero(asked[one])
        bend = sensitivity.hessian[
            place[self._row[one[both]]], self._column[one[both]], :, self._column[other[both]]
        ]
        blocks[both] = weight * (np.swapaxes(effect[one[both]], 1, 2) @ bend @ effect[other[both]])
        change = self._solve(np.add.reduceat(blocks, self._blocks, axis=0), gradient)
        return values + np.clip(change, -STEP_LIMIT, STEP_LIMIT)

    def _solve(self, blocks: Array, gradient: Array) -> Array:
        """Solve the system in the moves; it is sparse, and banded in order of time."""
        from scipy.sparse.linalg import spsolve

        one, other = (self._index[side[self._blocks]] for side in self._pairs)
        at, everything = np.arange(_WIDTH), np.arange(gradient.size)
        rows = np.broadcast_to((_WIDTH * one)[:, None, None] + at[:, None], blocks.shape)
        columns = np.broadcast_to((_WIDTH * other)[:, None, None] + at, blocks.shape)
        free = self._free.ravel()
        kept = blocks * (free[rows] & free[columns])
        held = np.where(self._free, self._rigidity, 1.0).ravel()
        values = np.concatenate((kept.ravel(), held))
        row = np.concatenate((rows.ravel(), everything))
        column = np.concatenate((columns.ravel(), everything))
        matrix = sparse.csc_array((values, (row, column)), shape=(gradient.size, gradient.size))
        return np.asarray(-spsolve(matrix, free * gradient.ravel())).reshape(gradient.shape)

    def _turns(self) -> list[NDArray[np.int64]]:
        """Return entries in rounds: a target in several moves is moved by one after the other."""
        key = self._row * len(self._targets.sites) + self._column
        order = np.argsort(key, kind="stable")
        _, first, count = np.unique(key[order], return_index=True, return_counts=True)
        rank = np.arange(len(key)) - np.repeat(first, count)
        return [order[rank == turn] for turn in range(int(count.max()))]

    def _meeting(self) -> tuple[tuple[NDArray[np.int64], NDArray[np.int64]], NDArray[np.int64]]:
        """Return pairs of entries (m,), (m,) about the same frame, each with itself too.

        They are in order of their two moves; the second array says where each such block begins.
        """
        order = np.argsort(self._row, kind="stable")
        _, first, count = np.unique(self._row[order], return_index=True, return_counts=True)
        one, other = [], []
        for size in np.unique(count):
            starts = first[count == size]
            for a in range(size):
                for b in range(size):
                    one.append(order[starts + a])
                    other.append(order[starts + b])
        left, right = np.concatenate(one), np.concatenate(other)
        key = self._index[left] * len(self._moves) + self._index[right]
        sort = np.argsort(key, kind="stable")
        _, begins = np.unique(key[sort], return_index=True)
        return (left[sort], right[sort]), begins
