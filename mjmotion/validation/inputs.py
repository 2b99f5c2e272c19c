"""What the validation asks of things that others make: contacts, and bodies that change size.

Anything with these attributes will do. The validation imports none of the classes that have them,
so that nothing of what made a motion can reach the figures.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

_STANDING = ("_heel", "_toe", "_knee", "_palm", "seat")  # endings of the sites that stand on ground


class Contact(Protocol):
    """A site that stands or holds on from frame ``start`` up to, not including, frame ``end``."""

    @property
    def site(self) -> str:
        """Name of the site."""

    @property
    def start(self) -> int:
        """First frame."""

    @property
    def end(self) -> int:
        """The frame after the last."""


class Recorded(Protocol):
    """Joints of a recording, upright and at the character's scale; see ``docs/figures.md``."""

    @property
    def roles(self) -> tuple[str, ...]:
        """(nrole) names such as ``left_knee``."""

    @property
    def bodies(self) -> tuple[str, ...]:
        """(nrole) body of the character whose origin is to be at the role's joint."""

    @property
    def positions(self) -> NDArray[np.float64]:
        """(nframe, nrole, 3) of the recorded joints [m]."""

    @property
    def turns(self) -> NDArray[np.float64]:
        """(nframe, nrole, 4) their orientations in the world, wxyz."""

    @property
    def floor(self) -> NDArray[np.float64]:
        """(nframe, nrole) height of the recorded ground under each [m]."""


class ChangingBody(Protocol):
    """A character whose sizes are others in every frame."""

    @property
    def model(self) -> mujoco.MjModel:
        """The model that the sizes are for."""

    @property
    def nframe(self) -> int:
        """Number of frames."""

    @property
    def fields(self) -> Mapping[str, NDArray[np.float64]]:
        """Field of MjModel to its values in every frame, (nframe, …).

        Among them ``geom_size`` (nframe, ngeom, 3) and ``mesh_vert`` (nframe, nvertex, 3) [m].
        """

    def on(self, model: mujoco.MjModel) -> ChangingBody:
        """Return the same body on another model with the character in it."""

    def write(self, model: mujoco.MjModel, frame: int) -> None:
        """Write one frame's sizes into a model."""


def stands(contact: Contact) -> bool:
    """Whether it is a heel's, toe's, knee's, palm's or seat's, which stand on ground, not hold."""
    return contact.site.endswith(_STANDING)
