"""Table 1's second job: the rope climb put on a character with longer legs, shorter body and arms.

The humanoid's climb is taken joint by joint, and hands and feet are to hold the rope where and when
the humanoid's did (Figure 5c).
"""

from __future__ import annotations

from mjmotion.apps.rope.climb import plan_climb
from mjmotion.clips.climb import climb_contacts
from mjmotion.paper.job import Job

CHARACTER = "climber"


def make_job() -> Job:
    """Return the job: 275 frames, 37 parameters (13 reduced), 5,898 scalar constraints."""
    plan = plan_climb(CHARACTER)
    return Job(
        "climbing a rope",
        plan.guess,
        plan.constraints,
        first_guess=plan.shift,
        contacts=climb_contacts(),
        source=plan.original,
    )
