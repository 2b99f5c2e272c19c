"""IK solvers: least displacements that meet the targets of all constrained frames (§5).

solver = make_solver(character, "hybrid")
solution = solver.prepare(targets).solve(qpos)
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from mjmotion.body.bones import Bones
from mjmotion.body.character import Character
from mjmotion.exceptions import FitError, unknown_name
from mjmotion.ik.count import parameters
from mjmotion.ik.hybrid import HybridIK
from mjmotion.ik.numeric import NumericIK
from mjmotion.ik.solver import IKProblem, IKSolver, Solution

__all__ = [
    "SOLVERS",
    "HybridIK",
    "IKProblem",
    "IKSolver",
    "NumericIK",
    "Solution",
    "make_solver",
    "parameters",
]

SOLVERS = ("hybrid", "numeric")


def make_solver(
    character: Character,
    ik: str | IKSolver = "hybrid",
    rigidity: ArrayLike | None = None,
    bones: Bones | None = None,
) -> IKSolver:
    """Return the solver of a name; one that is given is returned as it is, with its own settings.

    Args:
      character: the body.
      ik: ``"hybrid"``, ``"numeric"`` or a solver.
      rigidity: (nv,) α of Eq. 4, for a solver that is made here.
      bones: a body for each frame, where it changes.

    Raises:
      FitError: an unknown name, rigidities that make no sense, something that is no solver, or one
        that was not made for this body or these bones.
    """
    if not isinstance(ik, str):
        if isinstance(ik, type):
            raise FitError(f"ik is the class {ik.__name__}: give a solver that is made of it")
        if not callable(getattr(ik, "prepare", None)):
            raise FitError(
                f"ik is a {type(ik).__name__} without prepare(): give 'hybrid', 'numeric' or a"
                " solver (see mjmotion.ik.solver)"
            )
        made = getattr(ik, "character", None)
        if isinstance(made, Character) and (difference := made.different_from(character)):
            raise FitError(
                f"{type(ik).__name__} was made for another body than '{character.name}'"
                f" ({difference}): make it for the motion's character"
            )
        if bones is not None and getattr(ik, "bones", None) is not bones:
            raise FitError(
                f"{type(ik).__name__} was not made for a body that changes: give it the bones, or"
                " use ik='hybrid' or 'numeric'"
            )
        return ik
    if ik not in SOLVERS:
        raise FitError(unknown_name("IK solver", ik, SOLVERS))
    alpha = None if rigidity is None else np.asarray(rigidity, dtype=np.float64)
    nv = character.model.nv
    if alpha is not None and (alpha.shape != (nv,) or not (alpha > 0).all()):
        raise FitError(f"rigidity must be {nv} positive numbers, one a dof")
    if ik == "hybrid":
        return HybridIK(character, alpha, bones=bones)
    return NumericIK(character, alpha, bones=bones)
