"""One wide picture of several poses of a motion."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.motion import Motion
from mjmotion.exceptions import RenderError
from mjmotion.footsteps.contacts import Contact
from mjmotion.output.video import stage as staging
from mjmotion.output.video.camera import whole_walk
from mjmotion.output.video.field import FieldWindow
from mjmotion.output.video.gl import Canvas, Image
from mjmotion.output.video.markers import ContactMarks
from mjmotion.output.video.render import check_size
from mjmotion.output.video.stage import Stage

if TYPE_CHECKING:
    from mjmotion.body.morph_body import MorphBody

Array = NDArray[np.float64]

_FOVY = 20.0
_MORPH_SPREAD = 0.5  # between poses of a body that changes [m]
_NODES = 170  # along a side of a heightfield, at most: 0.15 m of our terrain, as in videos
_SAME_DEPTH = 1e-5  # of the depth buffer's 0…1: the same surface in two pictures


def render_strip(
    motion: Motion,
    poses: int | Sequence[int] = 9,
    width: int = 1600,
    height: int = 400,
    *,
    contacts: Sequence[Contact] = (),
    body: MorphBody | None = None,
    spread: float | None = None,
) -> Image:
    """Return one wide picture (height, width, 3) with several poses of a motion in its scene.

    Args:
      motion: the motion.
      poses: how many, spread evenly over the way walked, or the frames themselves.
      width: [pixel].
      height: [pixel].
      contacts: contacts whose footholds are marked.
      body: the character's size in every frame, where that changes.
      spread: how much further apart two poses stand than was walked between them [m]; footholds
        are only marked where that is 0. Without, 0, or of a body that changes 0.5: such poses are
        hard to tell apart where they overlap.

    Raises:
      RenderError: no offscreen OpenGL.
    """
    check_size(width, height)
    if spread is None:
        spread = 0.0 if body is None else _MORPH_SPREAD
    frames = _even_steps(motion, poses) if isinstance(poses, int) else np.asarray(poses, np.int64)
    body = None if body is None else body.on(motion.model)
    sizes = None if body is None else body.part(frames)
    qpos = _spread(motion.qpos[frames], spread)
    view = whole_walk(motion.model, qpos, width / height, _FOVY, body=sizes)
    span = float(np.ptp(qpos[:, :2], axis=0).max())
    far = view.distance + span
    model = staging.picture_model(
        motion.model, width, height, fovy=_FOVY, fog=(far + 3.0, far + 20.0)
    )
    model.vis.map.shadowclip = span / 2 + 2.0
    model.vis.quality.shadowsize = 4096  # with less there are specks on the figures
    _show_field(model, span + 20.0, view.lookat[0])
    marks = ContactMarks.of(motion, () if spread else contacts, body=body)
    stage = Stage(
        model, extra=len(frames) * model.ngeom + len(contacts), bearing=float(view.bearing[0])
    )
    rect, camera = mujoco.MjrRect(0, 0, width, height), view.at(0)
    with Canvas(model, width, height) as canvas:
        if sizes is not None:
            return _one_by_one(canvas, stage, qpos, sizes, camera, marks, motion.nframe)
        data = mujoco.MjData(model)
        stage.begin(qpos[0], camera, width / height)
        for pose in qpos[1:]:
            stage.add_figure(model, pose, data)
        marks.draw(stage, motion.nframe)
        canvas.draw(rect, stage.scene)
        return canvas.read()


def _show_field(model: mujoco.MjModel, side: float, point: Array) -> None:
    """Thin the heightfields of a model for pictures, before the driver is given them.

    Args:
      model: changed.
      side: of the square of each field that is shown [m].
      point: (3,) what it is around.
    """
    whole = 2.0 * float(np.max(model.hfield_size[:, :2], initial=0.0))
    FieldWindow(model, min(side, whole), _NODES).move(point)


def _one_by_one(
    canvas: Canvas,
    stage: Stage,
    qpos: Array,
    sizes: MorphBody,
    camera: mujoco.MjvCamera,
    marks: ContactMarks,
    nframe: int,
) -> Image:
    """Draw poses whose meshes differ: the driver holds one set of them, so each pose is a picture.

    Of every pixel the nearest counts; where all are as far, on the ground, the darkest: there lies
    a shadow in one of them.
    """
    whole: Image | None = None
    nearest = np.empty(0, np.float32)
    rect = mujoco.MjrRect(0, 0, canvas.width, canvas.height)
    for row, pose in enumerate(qpos):
        sizes.write(stage.model, row)
        canvas.upload_meshes(stage.model)
        stage.begin(pose, camera, canvas.width / canvas.height)
        marks.draw(stage, nframe)
        canvas.draw(rect, stage.scene)
        image, depth = canvas.read(), canvas.read_depth()
        if whole is None:
            whole, nearest = image, depth.copy()
            continue
        level = np.abs(depth - nearest) < _SAME_DEPTH
        darker = image.sum(axis=2, dtype=np.int32) < whole.sum(axis=2, dtype=np.int32)
        taken = np.where(level, darker, depth < nearest)
        whole[taken], nearest[taken] = image[taken], depth[taken]
    assert whole is not None
    return whole


def _spread(qpos: Array, spread: float) -> Array:
    """Return poses (n, nq) moved apart along the way from the first to the last [m]."""
    way = qpos[-1, :2] - qpos[0, :2]
    length = float(np.linalg.norm(way))
    way = way / length if length > 0.0 else np.array([1.0, 0.0])
    apart = qpos.copy()
    apart[:, :2] += spread * np.arange(len(qpos))[:, None] * way
    return apart


def _even_steps(motion: Motion, poses: int) -> NDArray[np.int64]:
    """Return ``poses`` frames, evenly spaced along the way of the root; in time if it stands."""
    if poses < 1:
        raise RenderError(f"a strip of {poses} poses: ask for one or more")
    way = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(motion.qpos[:, :2], axis=0), axis=1))]
    if way[-1] < 0.5:
        way = np.arange(motion.nframe, dtype=np.float64)
    marks = np.linspace(0.0, way[-1], poses) if poses > 1 else np.array([way[-1] / 2])
    return np.unique(np.searchsorted(way, marks).clip(0, motion.nframe - 1))
