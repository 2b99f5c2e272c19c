"""What is drawn over the scene: paths, contacts, constraints, handles, what is in the hand."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from mujoco.studio.dear_imgui import dear_imgui as imgui
from numpy.typing import ArrayLike, NDArray

from mjmotion.apps.session.edits import Drag, Footprint
from mjmotion.apps.session.scene_parts import parts
from mjmotion.editor import colours
from mjmotion.editor.colours import Colour
from mjmotion.editor.intents import Intents
from mjmotion.editor.mouse import View
from mjmotion.editor.shown import Shown

Array = NDArray[np.float64]

MOST_GEOMS = 180  # each travels to every page 60 times a second
_SECONDS = 1.5  # so much of a path is drawn to either side of the present [s]
_CONTACTS = 1.2  # contacts that far from the present are marked [s]
_MARK = (0.035, 0.035, 0.004)  # half sizes of the mark of a contact [m]
_SIMPLE = (
    mujoco.mjtGeom.mjGEOM_BOX,
    mujoco.mjtGeom.mjGEOM_SPHERE,
    mujoco.mjtGeom.mjGEOM_CAPSULE,
    mujoco.mjtGeom.mjGEOM_CYLINDER,
    mujoco.mjtGeom.mjGEOM_ELLIPSOID,
)


def colour(value: Colour) -> int:
    """Return a colour as ImGui's draw lists take it."""
    return int(imgui.ColorConvertFloat4ToU32(imgui.Vec4(*value)))


def geom(kind: int, size: ArrayLike, place: ArrayLike, rgba: Colour, mat: ArrayLike | None = None):  # type: ignore[no-untyped-def]
    """Return a geom that is drawn and is in no model."""
    made = mujoco.MjvGeom()
    turn = np.eye(3).ravel() if mat is None else np.asarray(mat, np.float64).ravel()
    mujoco.mjv_initGeom(
        made,
        kind,
        np.asarray(size, np.float64),
        np.asarray(place, np.float64),
        turn,
        np.asarray(rgba, np.float32),
    )
    return made


def geoms(do: Intents, model: mujoco.MjModel, data: mujoco.MjData) -> list[mujoco.MjvGeom]:
    """Return what is drawn in 3-D: contacts, constraints, and the part of the scene in the hand."""
    found = []
    if do.marks:
        found += _contacts(do.shown, do.frame)
    found += _constraints(do)
    drag = do.dragged
    if drag is not None and drag.kind == "part" and do.session is not None:
        found += _part(do, model, data)
    elif drag is not None:
        found.append(geom(mujoco.mjtGeom.mjGEOM_SPHERE, [0.022] * 3, drag.place, colours.SELECTED))
    return found[:MOST_GEOMS]


def _contacts(shown: Shown, frame: int) -> list[mujoco.MjvGeom]:
    """Return a mark where each contact stands that is not far in time; bright while it stands."""
    found = []
    near = _CONTACTS * shown.motion.fps
    for one in shown.contacts:
        if one.site not in shown.sites or one.start - near > frame or frame > one.end + near:
            continue
        now = one.start <= frame < one.end
        place = shown.place(one.site, frame if now else (one.start + one.end) // 2)
        rgba = colours.faded(colours.of_site(one.site), 0.95 if now else 0.35)
        found.append(geom(mujoco.mjtGeom.mjGEOM_ELLIPSOID, _MARK, place, rgba))
    return found


def _constraints(do: Intents) -> list[mujoco.MjvGeom]:
    """Return a ball at the place of each edit, by how far its site is from it."""
    found = []
    shown = do.shown
    for index, (edit, off) in enumerate(zip(shown.edits, shown.residuals, strict=True)):
        if isinstance(edit, Footprint) or edit.position is None:
            continue
        near = edit.frames[0] <= do.frame < edit.frames[1]
        radius = 0.03 if index == do.chosen else 0.02
        rgba = colours.faded(colours.of_residual(off, edit.enabled), 0.95 if near else 0.5)
        found.append(geom(mujoco.mjtGeom.mjGEOM_SPHERE, [radius] * 3, edit.position, rgba))
    return found


def _part(do: Intents, model: mujoco.MjModel, data: mujoco.MjData) -> list[mujoco.MjvGeom]:
    """Return the geoms of the part in the hand where it is to be; boxes for what is no solid."""
    drag, session = do.dragged, do.session
    assert drag is not None
    assert session is not None
    assert session.scene is not None
    names = parts(session.scene).get(drag.name, ())
    found = []
    for i in range(model.ngeom):
        body = model.body(int(model.geom_bodyid[i])).name
        if model.geom(i).name not in names and (body == "world" or body not in names):
            continue
        mat = data.geom_xmat[i].reshape(3, 3)
        kind, size, middle = int(model.geom_type[i]), model.geom_size[i], np.zeros(3)
        if kind not in _SIMPLE:
            kind = int(mujoco.mjtGeom.mjGEOM_BOX)
            middle, size = model.geom_aabb[i, :3], model.geom_aabb[i, 3:]
        place = data.geom_xpos[i] + mat @ middle + np.asarray(drag.move)
        found.append(geom(kind, size, place, colours.faded(colours.CURSOR, 0.6), mat))
    return found


# In the picture


def draw(do: Intents, view: View, hovered: str | None) -> None:
    """Draw paths, handles and the line to what is in the hand over the picture."""
    page = imgui.GetBackgroundDrawList()
    if do.paths:
        _paths(page, do, view)
    place = handle_place(do)
    if place is not None and do.editable:
        _handles(page, do, view, place, hovered)
    drag = do.dragged
    if drag is not None and drag.kind == "site":
        at = do.shown.place(drag.name, drag.frame)
        _line(page, view, [at, drag.place], colours.FAR, 2.0)
    for index, (edit, off) in enumerate(zip(do.shown.edits, do.shown.residuals, strict=True)):
        if isinstance(edit, Drag) and edit.frame == do.frame and edit.enabled:
            label = f"{index + 1}  {1000 * off:.1f} mm"
            _text(page, view, edit.position, label, colours.TEXT, below=True)


def handle_place(do: Intents) -> Array | None:
    """Return where the handles are (3,) [m]; None where there are none."""
    shown = do.shown
    if do.dragged is not None:
        return do.dragged.place if do.dragged.kind != "part" else None
    if 0 <= do.chosen < len(shown.edits):
        edit = shown.edits[do.chosen]
        place = None if isinstance(edit, Footprint) else edit.position
        return None if place is None else np.asarray(place)
    return shown.place(do.selected, do.frame) if do.selected in shown.sites else None


def may_turn(do: Intents) -> bool:
    """Whether the handles have a ring: of a footprint, which turns about the vertical."""
    if do.dragged is not None:
        return do.dragged.kind == "footprint"
    return do.chosen < 0 and do.stands(do.selected)


def _paths(page: imgui.DrawList, do: Intents, view: View) -> None:
    shown = do.shown
    around = round(_SECONDS * shown.motion.fps)
    first, end = max(0, do.frame - around), min(shown.nframe, do.frame + around + 1)
    places = shown.places(shown.traced, slice(first, end))
    for column, name in enumerate(shown.traced):
        _line(page, view, places[:, column], colours.faded(colours.of_site(name), 0.75), 1.6)


def _handles(
    page: imgui.DrawList, do: Intents, view: View, place: Array, hovered: str | None
) -> None:
    for name, line in view.handle_lines(place, may_turn(do)).items():
        on = name == hovered
        _line(page, view, line, colours.SELECTED if on else colours.AXES[name], 4.0 if on else 2.5)
        if name != "turn":
            tip, depth = view.project(line[1:])
            if depth[0] > 0.0:
                page.AddCircleFilled(imgui.Vec2(*tip[0]), 4.5, colour(colours.AXES[name]))
    label = do.dragged.name if do.dragged is not None else do.selected
    if label and do.chosen < 0:
        _text(page, view, place, label, colours.TEXT)


def _line(
    page: imgui.DrawList, view: View, points: Sequence[Array] | Array, rgba: Colour, width: float
) -> None:
    seen, depth = view.project(points)
    # What goes behind the eye is cut off there.
    for run in np.split(np.arange(len(depth)), np.flatnonzero(np.diff(depth > 0.0)) + 1):
        if len(run) > 1 and depth[run[0]] > 0.0:
            page.AddPolyline([imgui.Vec2(*at) for at in seen[run].tolist()], colour(rgba), width)


def _text(
    page: imgui.DrawList,
    view: View,
    place: ArrayLike,
    text: str,
    rgba: Colour,
    below: bool = False,
) -> None:
    (at,), depth = view.project(place)
    if depth[0] > 0.0:
        corner = imgui.Vec2(at[0] + 10.0, at[1] + (8.0 if below else -22.0))
        page.AddText(corner, colour(rgba), text)
