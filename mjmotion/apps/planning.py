"""A plan that can be seen before anything is fitted.

walk = plan_walk("walk", "terrain_doors")
write_plan("out/plan", walk.plan, candidates_of(walk.plan, scene))
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mjmotion.apps.adaptation import as_clip
from mjmotion.apps.clearing import barred_route
from mjmotion.body.motion import Motion
from mjmotion.exceptions import FitError, OutputError, unknown_name
from mjmotion.footsteps.contacts import Contact
from mjmotion.footsteps.given import yaw_of
from mjmotion.footsteps.heading import HEADINGS, set_off
from mjmotion.footsteps.plan import Plan, make_plan
from mjmotion.footsteps.plan_file import save_plan
from mjmotion.footsteps.settings import PlanSettings
from mjmotion.footsteps.spots import Spots
from mjmotion.output.plan_drawing import draw_plan, plan_svg
from mjmotion.scene import Scene, SceneLike

Array = NDArray[np.float64]

AROUND, APART = 0.25, 0.05  # how far around a foothold others are shown, and how dense [m]
_FITS = 1.0  # cost of a spot where a foot can stand
_ROOM = 0.5  # around what is looked at [m]


@dataclasses.dataclass(frozen=True, eq=False)
class PlannedWalk:
    """A plan, and what bars it.

    Attributes:
      plan: the plan.
      barred: what bars its way, in a line; empty where nothing does.
    """

    plan: Plan
    barred: str

    def lines(self) -> list[str]:
        """Return what there is to say of it."""
        plan, route = self.plan, self.plan.route
        changed = "" if route is None else route.changed()
        steps = f"{len(plan.footholds)} steps over {plan.source.nframe} frames"
        return [steps, changed or "the walk keeps its own way"]


def plan_walk(
    clip: Motion | str | Path,
    scene: SceneLike,
    contacts: Sequence[Contact] | None = None,
    settings: PlanSettings | None = None,
    *,
    heading: str = "start",
) -> PlannedWalk:
    """Plan a walk as :func:`mjmotion.adapt` would, and fit nothing.

    Args:
      clip: as :func:`mjmotion.adapt` takes it, like all that follows.
      scene: where it is to walk.
      contacts: who stands when.
      settings: what of the walk may change.
      heading: which way it sets off.

    Raises:
      SceneError: no ground under the walk, or, where the settings are strict, no way.
      ClipError, ContactError, ModelError, FitError: bad input.
    """
    if heading not in HEADINGS:
        raise FitError(unknown_name("heading", heading, HEADINGS))
    motion, scene = as_clip(clip), Scene.of(scene).at_rest()
    motion = set_off(motion) if heading == "start" else motion
    plan = make_plan(motion, scene, contacts, settings)
    barred = barred_route(plan.route, scene.model)
    if barred is None:
        return PlannedWalk(plan, "")
    if settings is not None and settings.strict:
        raise barred.error()
    return PlannedWalk(plan, str(barred))


def candidates_of(plan: Plan, scene: Scene) -> Array:
    """Return places (k, 2) around footholds where the same foot could stand as well [m]."""
    feet, spots = plan.source.character.feet, Spots(scene.ground)
    side = np.arange(-AROUND, AROUND + 1e-9, APART)
    grid = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    found = [np.empty((0, 2))]
    for stance, one in zip(plan.stances, plan.footholds, strict=True):
        points = np.round((one.position[:2] + grid) / APART) * APART
        reach = AROUND + _ROOM
        window = spots.window(
            one.position[:2] - reach, one.position[:2] + reach, float(one.position[2])
        )
        fit = window.fits(feet[stance.foot], yaw_of(one.quat), points)
        found.append(points[fit.cost < _FITS])
    return np.unique(np.concatenate(found), axis=0)


def write_plan(
    folder: str | Path, plan: Plan, candidates: Array, *, clip: str = "", scene: str = ""
) -> None:
    """Write ``plan.json``, ``plan.svg`` and ``plan.png`` into a folder, which is made.

    Raises:
      OutputError: a file cannot be written.
    """
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        save_plan(folder / "plan.json", plan, clip, scene)
        (folder / "plan.svg").write_text(plan_svg(plan, candidates), "utf-8")
        draw_plan(folder / "plan.png", plan, candidates)
    except OSError as error:
        raise OutputError(f"cannot write into '{folder}': {error.strerror or error}") from error
