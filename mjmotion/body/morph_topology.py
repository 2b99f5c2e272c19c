"""Whether two models are the same character in two sizes, and where one is found in another."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.exceptions import ModelError

Index = NDArray[np.int64]
Correspondence = Mapping[str, tuple[Index, Index]]
"""Kind of thing to its rows in the one model and in the other."""

_SAME_TURN = 1e-6  # by which orientations may differ between sizes

_PARTS = {
    "bodies": ("body_parentid", "body_jntnum", "body_geomnum"),
    "joints": ("jnt_type", "jnt_bodyid"),
    "sites": ("site_bodyid",),
    "shapes": ("geom_type", "geom_bodyid", "geom_dataid"),
    # Not their faces: those of a hull are cut anew for every size, of the same vertices.
    "meshes": ("mesh_vertnum", "mesh_normalnum"),
}
_TURNS = {
    "bodies": "body_quat",
    "sites": "site_quat",
    "joints": "jnt_axis",
}


def check_same_topology(model: mujoco.MjModel, key: mujoco.MjModel, where: str) -> None:
    """Raise ModelError unless two models are one character in two sizes.

    Args:
      model: the motion's.
      key: the other.
      where: what the other is called in the message.
    """
    for part, fields in _PARTS.items():
        same = all(np.array_equal(getattr(model, name), getattr(key, name)) for name in fields)
        if not same or _names(model, part) != _names(key, part):
            raise ModelError(
                f"{where}: its model has other {part} than the motion's: give models of one"
                " character in several sizes, such as mjmotion character makes"
            )
    for part, name in _TURNS.items():
        if not np.allclose(getattr(model, name), getattr(key, name), rtol=0.0, atol=_SAME_TURN):
            raise ModelError(
                f"{where}: its model turns its {part} otherwise than the motion's: only sizes may"
                " change in a morph"
            )


def correspondence(model: mujoco.MjModel, other: mujoco.MjModel) -> Correspondence:
    """Return where the character of ``model`` is in ``other``, which holds more than it.

    Bodies are found by name; what is on them comes in the same order in both.

    Raises:
      ModelError: a body is missing, or has other joints, sites, geoms or meshes.
    """
    pairs = []
    for body in range(1, model.nbody):
        name = model.body(body).name
        there = mujoco.mj_name2id(other, mujoco.mjtObj.mjOBJ_BODY, name) if name else -1
        if there < 0:
            raise ModelError(f"the model has no body '{name}': use one with the character in it")
        pairs.append((body, there))
    found = {"body": np.array(pairs).reshape(-1, 2)}
    for kind, owner in (("joint", "jnt_bodyid"), ("site", "site_bodyid"), ("geom", "geom_bodyid")):
        rows = [
            (np.flatnonzero(getattr(model, owner) == a), np.flatnonzero(getattr(other, owner) == b))
            for a, b in pairs
        ]
        uneven = [pairs[i][0] for i, (a, b) in enumerate(rows) if len(a) != len(b)]
        if uneven:
            name = model.body(uneven[0]).name
            raise ModelError(f"body '{name}' has other {kind}s in the two models")
        found[kind] = np.concatenate([np.stack(pair, axis=1) for pair in rows])
    meshes = {
        int(model.geom_dataid[a]): int(other.geom_dataid[b])
        for a, b in found["geom"]
        if model.geom_type[a] == mujoco.mjtGeom.mjGEOM_MESH
    }
    for kind, what in (("vertex", "vert"), ("normal", "normal")):
        spans = []
        for a, b in meshes.items():
            own, there = _span(model, a, what), _span(other, b, what)
            if len(own) != len(there):
                raise ModelError(f"mesh '{model.mesh(a).name}' is another in the two models")
            spans.append(np.stack((own, there), axis=1))
        found[kind] = np.concatenate(spans) if spans else np.empty((0, 2), np.int64)
    return {kind: (rows[:, 0], rows[:, 1]) for kind, rows in found.items()}


def _span(model: mujoco.MjModel, mesh: int, what: str) -> Index:
    start = int(getattr(model, f"mesh_{what}adr")[mesh])
    return start + np.arange(int(getattr(model, f"mesh_{what}num")[mesh]))


def _names(model: mujoco.MjModel, part: str) -> list[str]:
    kinds = {
        "bodies": (model.nbody, model.body),
        "joints": (model.njnt, model.joint),
        "sites": (model.nsite, model.site),
        "shapes": (model.ngeom, model.geom),
        "meshes": (model.nmesh, model.mesh),
    }
    count, accessor = kinds[part]
    return [accessor(i).name for i in range(count)]
