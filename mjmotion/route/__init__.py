"""Where a walk goes: its way through a scene, and the moves of the clip that take it there."""
