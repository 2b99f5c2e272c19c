"""Table 1's second job: the rope climb put on a character with longer legs, shorter body and arms.

The humanoid's climb is taken joint by joint, and hands and feet are to hold the rope where and when
the humanoid's did (Figure 5c).
"""

from __future__ import annotations

import mujoco

from mjmotion.assets import find_asset
from mjmotion.clips.climb import climb_constraints, climb_contacts, make_climb
from mjmotion.examples.job import Job

CHARACTER = "climber"


def make_job() -> Job:
    """Return the job: 275 frames, 37 parameters (13 reduced), 5,898 scalar constraints."""
    humanoid, climber = (
        mujoco.MjModel.from_xml_path(str(find_asset("model", name)))
        for name in ("humanoid", CHARACTER)
    )
    source = make_climb(humanoid)
    return Job(
        "climbing a rope",
        source.on(climber),
        climb_constraints(climber),
        first_guess=True,
        contacts=climb_contacts(),
        source=source,
    )
