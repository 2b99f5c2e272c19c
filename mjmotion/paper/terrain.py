"""Walking on rough terrain (Figures 5a and 5b): 464 frames, both feet posed at every frame.

5,568 scalar constraints, 20 degrees of freedom, 8 of them left to optimise.
"""

from __future__ import annotations

from mjmotion.clips import load_clip
from mjmotion.footsteps.plan import Plan
from mjmotion.footsteps.planning import make_plan
from mjmotion.paper.job import Job
from mjmotion.scene import load_scene


def make_job(clip: str = "walk", scene: str = "terrain") -> Job:
    """Return the job of a clip on a scene.

    Raises:
      ClipError, SceneError: there is no such clip or scene, or no ground under the walk.
    """
    return job_of_plan(make_plan(load_clip(clip), load_scene(scene)))


def job_of_plan(walk: Plan) -> Job:
    """Return the job of what a scene asks of a walk."""
    return Job(
        "walking on rough terrain",
        walk.source,
        tuple(walk.constraints()),
        first_guess=walk.root_shift,
        contacts=walk.contacts,
    )
