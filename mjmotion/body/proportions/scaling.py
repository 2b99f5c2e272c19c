"""A spec stretched: bones, shapes, sites, anchors, masses and inertias follow the bodies' maps.

Every body is stretched by a linear map ``A`` about its joint: along and across the bone for limbs
and trunk, alike in every direction for head, hands and feet. What is in the body moves by ``A``; a
mass grows by ``det A`` (length times width squared), and an inertia follows from the second moments
``C' = det(A) A C Aᵀ``. Uniform ``s`` gives lengths × s, masses × s³ and inertias × s⁵. Joints keep
their axes and ranges, so custom limits, tuples, sensors and excludes stay valid; stiffness, damping
and armature are not touched.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.proportions.frames import QUAT, BodyFrame, quat_of
from mjmotion.body.proportions.meshes import StretchedMeshes
from mjmotion.body.proportions.proportions import Proportions
from mjmotion.body.proportions.shaping import (
    girth,
    inertia_of,
    moments,
    nearest_axes,
    stretched_shape,
)
from mjmotion.exceptions import ModelError
from mjmotion.numerics.rotations import from_matrix, to_matrix

Array = NDArray[np.float64]


class Scaling:
    """Stretches one spec in place.

    Args:
      spec: the spec to change.
      proportions: the factors.

    Raises:
      ModelError: the spec has what cannot be stretched, or lacks a part that is to be.
    """

    def __init__(self, spec: mujoco.MjSpec, proportions: Proportions) -> None:
        if spec.skins or spec.flexes:
            raise ModelError("the model has a skin or a flex, which cannot be scaled: remove it")
        self._spec = spec
        bare = spec.copy()
        bare.compiler.fusestatic = False  # bodies of the model are then those of the spec
        self._model = model = bare.compile()
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        self._turn = turn = data.xmat.reshape(-1, 3, 3).copy()
        world, geoms = proportions.maps(model)
        of = model.geom_bodyid
        self._maps = np.einsum("bji,bjk,bkl->bil", turn, world, turn)
        self._geom_maps = np.einsum("gji,gjk,gkl->gil", turn[of], geoms, turn[of])
        self._offsets = self._head_offsets(data)
        self._meshes = StretchedMeshes(spec, model)
        # Elements of the spec in the order of its lists, with their places in the model.
        self._ids = {
            kind: [element.id for element in getattr(bare, kind)]
            for kind in ("bodies", "geoms", "sites", "joints", "cameras", "lights")
        }

    def __call__(self) -> None:
        """Stretch everything."""
        model = self._model
        for body, index in self._each("bodies"):
            if index > 0:
                self._place(body, index)
                self._inertial(body, self._maps[index])
        for joint, index in self._each("joints"):
            self._joint(joint, self._maps[model.jnt_bodyid[index]])
        for site, index in self._each("sites"):
            self._shape(site, self._maps[model.site_bodyid[index]])
        for geom, index in self._each("geoms"):
            self._geom(geom, index)
        for kind, of in (("cameras", model.cam_bodyid), ("lights", model.light_bodyid)):
            for element, index in self._each(kind):
                frame = BodyFrame(element)
                element.pos = frame.from_body(self._maps[of[index]] @ frame.to_body(element.pos))
        self._equalities()

    def _each(self, kind: str) -> list[tuple[Any, int]]:
        return list(zip(getattr(self._spec, kind), self._ids[kind], strict=True))

    def _head_offsets(self, data: mujoco.MjData) -> dict[int, Array]:
        """How far geoms move (3,) [m] that are a head within the trunk, in their body's frame.

        The head is stretched about the middle of its foot, which moves with the trunk.
        """
        model = self._model
        offsets: dict[int, Array] = {}
        body_maps = self._maps[model.geom_bodyid]
        apart = np.abs(self._geom_maps - body_maps).max(axis=(1, 2)) > 1e-12
        for body in np.unique(model.geom_bodyid[apart]):
            heads = np.flatnonzero(apart & (model.geom_bodyid == body))
            middle = model.geom_aabb[heads, :3]
            half = model.geom_aabb[heads, 3:]
            turn = data.geom_xmat[heads].reshape(-1, 3, 3)
            centre = data.geom_xpos[heads] + np.einsum("gij,gj->gi", turn, middle)
            reach = np.einsum("gij,gj->gi", np.abs(turn), half)
            low, high = (centre - reach).min(axis=0), (centre + reach).max(axis=0)
            foot = np.array((*((low + high) / 2)[:2], low[2]))
            local = self._turn[body].T @ (foot - data.xpos[body])
            for geom in heads:
                offsets[int(geom)] = (self._maps[body] - self._geom_maps[geom]) @ local
        return offsets

    def _place(self, body: Any, index: int) -> None:
        """Move a body with its parent's map, so that joints stay joined."""
        model = self._model
        parent = int(model.body_parentid[index])
        if parent == 0:
            return  # the root's height follows from its soles
        anchor = np.zeros(3)
        if model.body_jntnum[index]:
            anchor = model.jnt_pos[model.body_jntadr[index]]
        turn = to_matrix(model.body_quat[index])
        pos = self._maps[parent] @ (model.body_pos[index] + turn @ anchor)
        body.pos = BodyFrame(body).from_body(pos - turn @ self._maps[index] @ anchor)

    def _inertial(self, body: Any, stretch: Array) -> None:
        if not body.explicitinertial or np.array_equal(stretch, np.eye(3)):
            return
        full = np.array(body.fullinertia)
        if np.isfinite(full[0]):
            xx, yy, zz, xy, xz, yz = full
            turn = np.eye(3)
            inertia = np.array(((xx, xy, xz), (xy, yy, yz), (xz, yz, zz)))
        else:
            turn = to_matrix(quat_of(body, "ialt", "iquat"))
            inertia = turn @ np.diag(body.inertia) @ turn.T
        volume = float(np.linalg.det(stretch))
        inertia = inertia_of(volume * stretch @ moments(inertia) @ stretch.T)
        turn = nearest_axes(inertia, turn)
        body.mass = body.mass * volume
        body.ipos = stretch @ np.array(body.ipos)
        body.fullinertia = np.full(6, np.nan)
        body.inertia = np.diag(turn.T @ inertia @ turn)
        body.iquat, body.ialt.type = from_matrix(turn), QUAT

    def _joint(self, joint: Any, stretch: Array) -> None:
        frame = BodyFrame(joint)
        joint.pos = frame.from_body(stretch @ frame.to_body(joint.pos))
        if joint.type == mujoco.mjtJoint.mjJNT_SLIDE:
            axis = frame.turn @ np.array(joint.axis)
            factor = float(np.linalg.norm(stretch @ axis) / np.linalg.norm(axis))
            joint.range, joint.ref = np.array(joint.range) * factor, joint.ref * factor

    def _geom(self, geom: Any, index: int) -> None:
        stretch = self._geom_maps[index]
        if np.array_equal(stretch, np.eye(3)) and index not in self._offsets:
            return
        if geom.type == mujoco.mjtGeom.mjGEOM_SDF:
            raise ModelError(f"geom '{geom.name}' is an SDF, which cannot be scaled: remove it")
        self._shape(geom, stretch, self._offsets.get(index))
        volume = float(np.linalg.det(stretch))
        if np.isfinite(geom.mass):
            geom.mass = geom.mass * volume
        elif geom.typeinertia == mujoco.mjtGeomInertia.mjINERTIA_SHELL:
            geom.density = geom.density * float(np.cbrt(volume))  # its mass grows as its surface

    def _shape(self, element: Any, stretch: Array, offset: Array | None = None) -> None:
        """Stretch place and shape of a geom or site, and move it by ``offset`` (3,) [m]."""
        if np.array_equal(stretch, np.eye(3)) and offset is None:
            return
        frame = BodyFrame(element)
        extra = np.zeros(3) if offset is None else offset
        local = frame.turn.T @ stretch @ frame.turn

        def moved(point: Array) -> Array:
            return frame.from_body(stretch @ frame.to_body(point) + extra)

        ends = np.array(element.fromto)
        if np.isfinite(ends[0]):
            element.fromto = np.concatenate((moved(ends[:3]), moved(ends[3:])))
            element.size = np.array(element.size) * girth(local, ends[3:] - ends[:3])
            return
        element.pos = moved(element.pos)
        turn = to_matrix(quat_of(element))
        own = turn.T @ local @ turn
        if element.meshname:
            element.meshname = self._meshes.named(element.meshname, own)
            return
        element.size, turned = stretched_shape(element.type, np.array(element.size), own)
        if isinstance(element, mujoco.MjsGeom):  # a site keeps its axes
            element.quat, element.alt.type = from_matrix(turn @ turned), QUAT

    def _equalities(self) -> None:
        places = {body.name: index for body, index in self._each("bodies")}
        for equality in self._spec.equalities:
            if equality.objtype != mujoco.mjtObj.mjOBJ_BODY:
                continue
            first, second = (places.get(n, 0) for n in (equality.name1, equality.name2))
            values = np.array(equality.data)
            if equality.type == mujoco.mjtEq.mjEQ_CONNECT:
                values[:3] = self._maps[first] @ values[:3]
            elif equality.type == mujoco.mjtEq.mjEQ_WELD:
                values[:3] = self._maps[second] @ values[:3]
                values[3:6] = self._maps[first] @ values[3:6]
            equality.data = values
