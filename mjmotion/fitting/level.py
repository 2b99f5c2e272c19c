"""One level of Algorithm 1: IK at every constrained frame, a spline through it, the motion moved.

    level = run_level(character, qpos, targets.frames, problem.solve, spline)
    level.qpos, level.error

Every fit runs its levels through here: the fit itself, the way past obstacles, an edit, and what
follows a root that has moved in the exact pass.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.character import Character
from mjmotion.ik.solver import Solution
from mjmotion.numerics.tangent import oplus

Array = NDArray[np.float64]

Spline = Callable[[Solution], Array]
"""From displacements of the constrained frames to a displacement map (nframe, nv)."""


@dataclasses.dataclass(frozen=True, eq=False)
class Level:
    """What one level did.

    Attributes:
      qpos: (nframe, nq) poses after it.
      solution: what IK answered.
    """

    qpos: Array
    solution: Solution

    @property
    def error(self) -> float:
        """The largest position error before the level [m]."""
        return float(self.solution.error.max(initial=0.0))


def run_level(
    character: Character,
    qpos: Array,
    frames: NDArray[np.int64],
    solve: Callable[[Array], Solution],
    spline: Spline,
) -> Level:
    """Run lines 2 to 9 of Algorithm 1.

    Frames that the displacement map leaves alone stay what they are, to the bit.

    Args:
      character: whose poses they are.
      qpos: (nframe, nq) m_{k-1}.
      frames: (n,) constrained frames t_j.
      solve: the IK solver on poses (n, nq) of those: d^{t_j}.
      spline: curve fitting to them: d_k.

    Returns:
      m_k = m_{k-1} ⊕ d_k, coupled joints with their shares (§4.2).
    """
    solution = solve(qpos[frames])
    submap = spline(solution)
    moved = submap.any(axis=1)
    if moved.all():
        after = character.coupling.couple(oplus(character.model, qpos, submap))
    else:
        after = qpos.copy()
        part = oplus(character.model, qpos[moved], submap[moved])
        after[moved] = character.coupling.couple(part)
    return Level(after, solution)
