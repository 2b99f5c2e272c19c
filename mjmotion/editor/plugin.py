"""Between MuJoCo Studio and the editor: its frames, its mouse and its keys become intents."""

from __future__ import annotations

import dataclasses
import logging
import time
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
from mujoco.studio import messages, plugin, ux
from mujoco.studio.dear_imgui import dear_imgui as imgui
from numpy.typing import NDArray

from mjmotion.apps.session.scene_parts import part_of
from mjmotion.body.kinematics import root_body
from mjmotion.editor import keys, overlay
from mjmotion.editor.files import Files
from mjmotion.editor.intents import Intents
from mjmotion.editor.mouse import Point, View, nearest, pull, turned
from mjmotion.editor.panels import Panels
from mjmotion.editor.stage import GHOST_GROUP, Stage
from mjmotion.editor.timeline import Timeline

Array = NDArray[np.float64]

DISTANCE, AZIMUTH, ELEVATION = 4.2, 125.0, -14.0  # of the camera at first [m, °, °]
_CAMERA_FRAME = 2  # one set before this frame of the page races with the page's own
GHOST_BEHIND = 0.02  # seen from the camera [m]
_UP = np.array((0.0, 0.0, 1.0))

logger = logging.getLogger(__name__)


@dataclasses.dataclass(frozen=True, eq=False)
class Grip:
    """How the mouse holds what is in the hand.

    Attributes:
      pixel: where the mouse took it.
      place: (3,) where it was then [m].
      point: (3,) what the mouse was on [m].
      handle: which handle; "" for none: in a plane.
    """

    pixel: Point
    place: Array
    point: Array
    handle: str = ""


class EditorPlugin(plugin.ViewerPlugin):
    """The editor's page.

    Args:
      do: what the person can do.
      files: what the page writes and reads.
      observe: called with the plugin after every frame, by tests and measurements.
    """

    def __init__(
        self, do: Intents, files: Files, observe: Callable[[EditorPlugin], None] | None = None
    ) -> None:
        self.do, self.files = do, files
        self.updates = 0
        self.view: View | None = None
        self.hovered: str | None = None
        self._observe = observe
        self._stage = Stage(do.shown)
        self._timeline, self._panels = Timeline(), Panels(files)
        self._last: float | None = None
        self._grip: Grip | None = None
        self._following = False
        self._wrong = ""

    @property
    def model(self) -> mujoco.MjModel:
        """The model that the page shows."""
        return self._stage.model

    # From Studio

    @messages.handler
    def _on_init(self, _: plugin.ViewerInitEvent) -> None:
        ux.setup_theme(ux.GuiTheme.DARK)

    @messages.handler
    def _on_update(self, _: messages.UpdateEvent) -> None:
        self._safely(self._update)
        self.updates += 1
        if self._observe is not None:
            self._observe(self)

    @messages.handler
    def _on_gui(self, _: messages.BuildGuiEvent) -> None:
        self._safely(self._gui)

    def _safely(self, call: Callable[[], Any]) -> None:
        """Call; an error of the program's own is said on the page, and nothing is lost by it."""
        try:
            call()
        except Exception as error:
            ux.unwind_imgui_frame()
            said = f"{type(error).__name__}: {error}"
            if said != self._wrong:  # it may come again with every frame
                logger.exception("the page goes on after an error")
                self._wrong = said
            self.do.say(said, bad=True)

    # Every frame

    def _update(self) -> None:
        now = time.perf_counter()
        passed = 0.0 if self._last is None else now - self._last
        self._last = now
        self.do.tick(passed)
        self.files.tick()
        if self.do.shown.model is not self._stage.of:
            self._stage = Stage(self.do.shown)
            self.viewer.dispatch(messages.ModelEvent(model=self._stage.model, path="editor"))
        viewer, do = self.viewer, self.do
        behind = (0.0, 0.0, 0.0) if self.view is None else GHOST_BEHIND * self.view.forward
        self._stage.pose(viewer.data, do.shown, do.frame, behind)
        viewer.vis_options.geomgroup[GHOST_GROUP] = int(do.ghost and self._stage.has_ghost)
        self._camera()
        size = imgui.GetIO().DisplaySize
        self.view = View.of(viewer.model, viewer.data, viewer.camera, (size.x, size.y))
        if self.updates > 0:
            self._keys()
            self._mouse()
        viewer.extra_geoms[:] = overlay.geoms(do, viewer.model, viewer.data)

    def _gui(self) -> None:
        size = imgui.GetIO().DisplaySize
        if self.view is not None:
            overlay.draw(self.do, self.view, self.hovered)
        self._panels.draw(self.do, size.x, size.y - self._timeline.height)
        self._timeline.draw(self.do, size.x, size.y)

    def _camera(self) -> None:
        camera, do = self.viewer.camera, self.do
        root = root_body(self._stage.model)
        if self.updates == _CAMERA_FRAME:
            camera.distance, camera.azimuth, camera.elevation = DISTANCE, AZIMUTH, ELEVATION
            camera.lookat[:] = self.viewer.data.xpos[root]
        if do.follow != self._following:
            self._following = do.follow
            kinds = mujoco.mjtCamera
            camera.type = int(kinds.mjCAMERA_TRACKING if do.follow else kinds.mjCAMERA_FREE)
            camera.trackbodyid = root if do.follow else -1
            camera.lookat[:] = self.viewer.data.xpos[root]

    def _keys(self) -> None:
        io = imgui.GetIO()
        if imgui.IsAnyItemActive():  # such as a field that is being typed into
            return
        for name in keys.KEYS:
            if imgui.IsKeyPressed(getattr(imgui.Key, name), name in keys.REPEATED):
                keys.press(self.do, self.files, name, bool(io.KeyCtrl), bool(io.KeyShift))

    # The mouse

    def _mouse(self) -> None:
        io, do, view = imgui.GetIO(), self.do, self.view
        assert view is not None
        at = (float(io.MousePos.x), float(io.MousePos.y))
        left = imgui.MouseButton.Left
        if do.dragged is not None and self._grip is not None:
            imgui.SetNextFrameWantCaptureMouse(True)
            if imgui.IsMouseDown(left):
                self._drag(view, at)
            else:
                self._grip = None
                do.release()
            return
        self._grip = None
        inside = 0.0 <= at[0] <= view.size[0] and 0.0 <= at[1] <= view.size[1]
        over_gui = imgui.IsWindowHovered(int(imgui.HoveredFlags.AnyWindow))
        if not inside or over_gui or imgui.IsAnyItemActive() or not do.editable:
            self.hovered = None
            return
        place = overlay.handle_place(do)
        self.hovered = None
        if place is not None:
            self.hovered = view.handle_at(at, place, overlay.may_turn(do))
        if self.hovered is not None:
            imgui.SetNextFrameWantCaptureMouse(True)  # else the page turns its camera
        if not imgui.IsMouseClicked(left):
            return
        if self.hovered is not None and place is not None:
            taken = do.grab_chosen() if do.chosen >= 0 else do.grab(do.selected)
            if taken:
                self._grip = Grip(at, place, place, self.hovered)
        elif io.KeyCtrl:
            self._pick(view, at)

    def _pick(self, view: View, at: Point) -> None:
        """Take in hand what is under the mouse."""
        viewer, stage, do = self.viewer, self._stage, self.do
        x, y = at[0] / view.size[0], at[1] / view.size[1]
        option = stage.without_ghost(viewer.vis_options)
        aspect = view.size[0] / view.size[1]
        hit = ux.Pick(viewer.model, viewer.data, viewer.camera, x, y, aspect, option)
        if hit.geom < 0:
            do.cancel()
            return
        point = np.array(hit.point, dtype=np.float64)
        if stage.character_bodies()[hit.body]:
            if do.grab(self.site_of(hit.body, point)) and do.dragged is not None:
                self._grip = Grip(at, do.dragged.place, point)
            return
        name = viewer.model.geom(hit.geom).name
        scene = None if do.session is None else do.session.scene
        part = None if scene is None or not name else part_of(scene, name)
        if part is not None and do.grab_part(part):
            self._grip = Grip(at, np.zeros(3), point)

    def site_of(self, body: int, point: Array) -> str:
        """Return the site that moves for a body: of those on or near it that nearest to a point."""
        shown = self.do.settled
        names = shown.sites_near(self._stage.model.body(body).name)
        places = shown.places(names, slice(self.do.frame, self.do.frame + 1))[0]
        return nearest(point, places, names)

    def _drag(self, view: View, at: Point) -> None:
        """Move what is in the hand to where the mouse is."""
        do, grip = self.do, self._grip
        assert do.dragged is not None
        assert grip is not None
        if grip.handle == "turn":
            angle = turned(view, at, grip.pixel, grip.place)
            if angle is not None:
                do.drag(grip.place, angle)
            return
        if grip.handle:
            by = pull(view, at, grip.pixel, grip.place, grip.handle)
        else:
            normal = _UP if do.dragged.level else view.forward
            spot = view.on_plane(at, grip.point, normal)
            by = None if spot is None else spot - grip.point
        if by is not None:
            do.drag(grip.place + by, do.dragged.turn)
