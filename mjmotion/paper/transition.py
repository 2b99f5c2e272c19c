"""Walking to sneaking and back, Figure 5(e): 119 frames, two transitions.

    job = make_job()
    result = job.fit()

The clips are the built-in walk and the built-in sneaking, joined where they are most alike; 119
frames are cut out about the sneaking. A foot is held, position and orientation, while its heel or
its toe stands and free while it swings: 139 frames of feet, 834 scalar constraints.
"""

from __future__ import annotations

import numpy as np

from mjmotion.apps.transition import Overlap, blend_clips, join
from mjmotion.body.character import Character, CharacterLike
from mjmotion.body.motion import Motion
from mjmotion.clips import load_clip
from mjmotion.clips.gait import make_walk
from mjmotion.clips.gait_plan import Segment
from mjmotion.clips.sneak import make_sneak
from mjmotion.constraints import SiteConstraint
from mjmotion.footsteps.contacts import Contact
from mjmotion.footsteps.planning import make_plan
from mjmotion.output.result import Result
from mjmotion.paper.job import Job
from mjmotion.scene import load_scene

FRAMES = 119  # of Table 1
OVERLAPS = (Overlap(74, 10, 21), Overlap(84, 24, 21))  # what is found, kept for the counts' sake
FIRST = 66  # frame of the whole that the job begins with; some to either side make no difference
STRIDES = (3.0, 2.5)  # of each walk and of the sneaking
WALK = ("start", "straight", "turn_left", "turn_right", "stop")  # clips of the paper's 464 frames
DUTY = 0.58  # share of a stride that the ball of a foot stands in the walk


def make_clips(character: CharacterLike = "humanoid") -> tuple[Motion, Motion]:
    """Return the walk and the sneaking that the job is made of, on the humanoid."""
    character = Character.of(character)
    walk = make_walk(character, segments=[Segment("straight", STRIDES[0])], duty=DUTY)
    return walk, make_sneak(character, strides=STRIDES[1])


def make_job() -> Job:
    """Return the job: its motion is the blend, whose feet slide."""
    walk, sneak = make_clips()
    whole = blend_clips([walk, sneak, walk], overlaps=OVERLAPS)
    # Contacts are those of the whole: the ends of a window are no begin of a stance.
    contacts = tuple(
        Contact(one.site, max(one.start - FIRST, 0), min(one.end - FIRST, FRAMES))
        for one in whole.contacts
        if one.end > FIRST and one.start < FIRST + FRAMES
    )
    motion = Motion(walk.character, whole.motion.qpos[FIRST : FIRST + FRAMES], walk.fps)
    plan = make_plan(motion, load_scene("flat"), contacts)
    constraints = []
    for path in plan.paths:
        frames = np.flatnonzero(path.stance)
        constraints.append(
            SiteConstraint(
                path.site,
                frames,
                path.position[frames],
                path.quat[frames],
                contact=True,
                source="scene",
            )
        )
    return Job(
        "transition",
        plan.source,
        tuple(constraints),
        first_guess=plan.root_shift,
        contacts=plan.contacts,
    )


def make_walk_464() -> Result:
    """Return the walk of Figure 5(a), 464 frames: clips joined by transitions, contacts kept."""
    return join([load_clip(name) for name in WALK])
