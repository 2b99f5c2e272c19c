"""The last word on a foot path: no point of a foot is under the ground.

What turned a foot back for its ankle, or moved it for its hip, may have put it into the ground
again. Toes give first, then the foot is lifted.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mjmotion.body.feet import Foot
from mjmotion.footsteps.contacts import Contact, contact_mask
from mjmotion.footsteps.paths import FootPath
from mjmotion.footsteps.swings import StepOver
from mjmotion.footsteps.toes import kept_up
from mjmotion.scene.ground import Ground

_SAME = 1e-6  # a path that was moved or turned by less is as it was [m], and of its quaternion


def above_ground(
    feet: Sequence[Foot],
    paths: Sequence[FootPath],
    before: Sequence[FootPath],
    contacts: Sequence[Contact],
    ground: Ground,
    fps: float,
) -> tuple[FootPath, ...]:
    """Return paths whose swings are above the ground where they were moved into it.

    Args:
      feet: the feet, one a path.
      paths: where they go.
      before: where they went when it was last looked.
      contacts: who stands when.
      ground: the scene's surfaces.
      fps: frames a second.
    """
    above = []
    for foot, path, old in zip(feet, paths, before, strict=True):
        moved = np.abs(path.position - old.position).max(axis=1) > _SAME
        moved |= np.abs(path.quat - old.quat).max(axis=1) > _SAME
        above.append(_lifted(foot, path, contacts, ground, fps) if moved.any() else path)
    return tuple(above)


def _lifted(
    foot: Foot, path: FootPath, contacts: Sequence[Contact], ground: Ground, fps: float
) -> FootPath:
    """Return a path whose toes are bent up, and the foot lifted, where they are in the ground."""
    nframe = len(path.position)
    heel, ball = (contact_mask(contacts, f"{foot.side}_{part}", nframe) for part in ("heel", "toe"))
    stance: NDArray[np.bool_] = heel | ball
    toes = kept_up(foot, path.position, path.quat, path.toes, ball, ground, fps)
    bend = toes if foot.toes is None else foot.toes.settled(toes)
    wanted = np.zeros(nframe) if path.clearance is None else path.clearance
    step_over = StepOver(foot.shape_at(bend), path.quat, wanted, stance, ground, fps)
    position, lift = step_over(path.position, ())
    return dataclasses.replace(path, position=position, toes=toes, lift=path.lift + lift)
