"""Write the project's own editing sessions anew: their files know the clips by their hash.

python scripts/make_sessions.py
"""

from __future__ import annotations

import numpy as np

from mjmotion.apps.session import Drag, EditSession, Settings, save_session
from mjmotion.body.assets import asset_folder
from mjmotion.body.kinematics import site_id, site_positions

FRAME = 60  # of the walk, at which Figure 2's pose is changed


def main() -> None:
    session = EditSession("walk")
    for site, by in (("pelvis", (0.0, 0.0, -0.12)), ("head_top", (0.25, 0.0, -0.12))):
        motion = session.motion
        index = np.array([site_id(motion.model, site)])
        here = site_positions(motion.model, motion.qpos[FRAME : FRAME + 1], index)[0, 0]
        x, y, z = (float(value) for value in here + by)
        session.do(Drag(site, FRAME, (x, y, z), Settings(frames_per_knot=12)))
    print(save_session(asset_folder("session") / "bend.mjsession", session))


if __name__ == "__main__":
    main()
