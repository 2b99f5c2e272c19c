"""Marks where the feet stand: bright while a contact lasts, pale afterwards."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.kinematics import Kinematics, RayCaster, site_id
from mjmotion.body.motion import Motion
from mjmotion.footsteps.contacts import Contact
from mjmotion.output.video.stage import Stage, without_character

if TYPE_CHECKING:
    from mjmotion.body.morph_body import MorphBody

Array = NDArray[np.float64]

HEEL = (0.96, 0.45, 0.10)
TOE = (0.05, 0.60, 0.60)
OTHER = (0.55, 0.30, 0.75)


@dataclasses.dataclass(frozen=True, eq=False)
class ContactMarks:
    """Footholds of a motion, ready to be drawn.

    Attributes:
      start, end: (n,) frames of each contact, ``end`` not included.
      position: (n, 3) mean position of its site [m].
      matrix: (n, 3, 3) orientation; the z-axis is the ground's normal.
      colour: (n, 3) RGB in 0…1.
    """

    start: NDArray[np.int64]
    end: NDArray[np.int64]
    position: Array
    matrix: Array
    colour: Array

    @classmethod
    def of(
        cls,
        motion: Motion,
        contacts: Sequence[Contact],
        *,
        flat: bool = False,
        body: MorphBody | None = None,
    ) -> ContactMarks:
        """Return the marks of ``contacts`` in ``motion``; ``flat`` where the ground is level.

        ``body`` is the character's size in every frame, where that changes.
        """
        kept = [
            (contact, max(contact.start, 0), min(contact.end, motion.nframe))
            for contact in contacts
            if max(contact.start, 0) < min(contact.end, motion.nframe)
        ]
        if not kept:
            none = np.empty(0, np.int64)
            return cls(none, none, np.empty((0, 3)), np.empty((0, 3, 3)), np.empty((0, 3)))
        if body is None:
            sites = Kinematics(motion.model, motion.nframe).forward(motion.qpos).site_xpos
        else:
            from mjmotion.validation.morph_poses import body_poses

            sites = body_poses(body, motion.qpos).site
        position = np.array(
            [sites[a:b, site_id(motion.model, c.site)].mean(axis=0) for c, a, b in kept]
        )
        normal = np.tile([0.0, 0.0, 1.0], (len(kept), 1))
        if not flat:
            above = position + (0.0, 0.0, 0.2)
            distance, _, found = RayCaster(without_character(motion.model)).cast(
                above, np.array([0.0, 0.0, -1.0])
            )
            near = (distance >= 0) & (distance < 0.4) & (found[:, 2] > 0.1)
            normal[near] = found[near]
        return cls(
            np.array([a for _, a, _ in kept]),
            np.array([b for _, _, b in kept]),
            position,
            _upright(normal),
            np.array([site_colour(c.site) for c, _, _ in kept]),
        )

    def draw(self, stage: Stage, frame: int) -> None:
        """Add the marks of one frame to a stage."""
        for i in np.flatnonzero(self.start <= frame):
            if frame < self.end[i]:
                stage.add(
                    mujoco.mjtGeom.mjGEOM_ELLIPSOID,
                    (0.042, 0.042, 0.030),
                    self.position[i],
                    (*self.colour[i], 1.0),
                    self.matrix[i],
                    emission=0.45,
                )
            else:
                stage.add(
                    mujoco.mjtGeom.mjGEOM_ELLIPSOID,
                    (0.030, 0.030, 0.006),
                    self.position[i],
                    (*(0.10 + 0.85 * self.colour[i]), 1.0),
                    self.matrix[i],
                    emission=0.1,
                )


def site_colour(site: str) -> tuple[float, float, float]:
    """Return the colour of a contact site: heels orange, toes teal, others violet."""
    if "heel" in site:
        return HEEL
    return TOE if "toe" in site else OTHER


def _upright(normal: Array) -> Array:
    """Return frames (n, 3, 3) whose z-axes are ``normal`` (n, 3)."""
    x = np.cross(np.array([0.0, 1.0, 0.0]), normal)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return np.stack((x, np.cross(normal, x), normal), axis=-1)
