"""Dimensions of the humanoid that a recording is put on."""

from __future__ import annotations

import numpy as np

from mjmotion.body.character import Character
from mjmotion.clips.rig import SIDES
from mjmotion.exceptions import ModelError, unknown_name
from mjmotion.numerics.rotations import Array


class HumanoidDimensions:
    """Dimensions of the humanoid that mapping needs, read from its model."""

    def __init__(self, character: Character) -> None:
        self.model = model = character.model
        names = [model.body(i).name for i in range(model.nbody)]
        for name in ("pelvis", "torso", "left_thigh", "left_shank", "left_foot", "left_forearm"):
            if name not in names:
                raise ModelError(f"clips go onto the humanoid: {unknown_name('body', name, names)}")
        self.thigh = float(np.linalg.norm(model.body("left_shank").pos))
        self.shank = float(np.linalg.norm(model.body("left_foot").pos))
        self.hips = {side: np.array(model.body(f"{side}_thigh").pos) for side in SIDES}
        self.feet = tuple(
            next(foot for foot in character.feet if foot.side == side) for side in SIDES
        )
        boxes = character.limits.boxes
        ankles = {side: boxes.get(model.joint(f"{side}_ankle").id) for side in SIDES}
        # The foot's toes-up turn is negative about y.
        self.most_dorsiflexion = {
            side: -np.pi if box is None else float(box[1, 0]) for side, box in ankles.items()
        }

    @property
    def leg(self) -> float:
        """Length of a leg, hip to ankle [m]."""
        return self.thigh + self.shank

    def site(self, name: str) -> Array:
        """Return a site's position in its body."""
        return np.array(self.model.site(name).pos)
