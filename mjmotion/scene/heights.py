"""Ground from heights: an array, an ``.npy`` file, an image, or a mesh of any format."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjmotion.boundary.arrays import read_array
from mjmotion.boundary.files import check_plain
from mjmotion.boundary.limits import (
    MOST_LENGTH,
    MOST_MESH,
    MOST_SAMPLES,
    at_most,
    real_array,
)
from mjmotion.boundary.words import first_line
from mjmotion.exceptions import SceneError, mujoco_message
from mjmotion.scene.stage import (
    GROUND,
    add_mesh_material,
    add_start,
    check_positive,
    ground_heights,
    new_scene,
)

_BASE = 1.0  # [m], how far the solid under a heightfield reaches below its lowest point
_IMAGES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm", ".webp")
_MESHES = (".obj", ".stl", ".ply", ".off", ".glb", ".gltf", ".dae")


def from_heights(
    source: str | Path | ArrayLike,
    *,
    cell: float = 0.05,
    height: float = 1.0,
    scale: float = 1.0,
    start: tuple[float, float] | None = None,
    up: str = "z",
) -> mujoco.MjSpec:
    """Return a scene whose ground comes from heights; the walk starts at the origin along +x.

    Args:
      source: one of
        - an array or ``.npy`` file (nrow, ncol) of heights [m], rows along +y, columns along +x;
        - an image: black is 0, white is ``height``; its top is the far side (+y);
        - a mesh file (.obj, .stl, .ply, .off, .glb, .gltf, .dae). A convex mesh is placed as it
          is. Any other is sampled to a heightfield from above, since MuJoCo collides with a mesh's
          convex hull; where there is no mesh under a sample the ground is at the mesh's lowest
          point.
      cell: distance between samples [m]; not used for a convex mesh.
      height: height of white in an image [m].
      scale: factor on the heights of an array, or on all lengths of a mesh (0.01 for centimetres).
      start: where the walk starts, from the low-x low-y corner of the ground [m]; by default 1 m
        in from that edge (or a tenth of the length if that is less), in the middle across.
      up: ``"z"`` or ``"y"``, the axis of a mesh that points up.

    Raises:
      SceneError: the file is missing or unreadable, heights are not finite or not a grid, a size
        is not positive, or the start is beside the ground.
    """
    check_positive("heights", cell=cell, height=height, scale=scale)
    if up not in ("y", "z"):
        raise SceneError(f"heights: up is '{up}', it must be 'y' or 'z'")
    if not isinstance(source, (str, Path)):
        return _field_scene(
            "heights", real_array(source, "heights", SceneError) * scale, cell, start
        )
    path = Path(source)
    check_plain(path, "heights file", SceneError)
    suffix = path.suffix.lower()
    if suffix == ".npy":
        return _field_scene(str(path), _read_npy(path) * scale, cell, start)
    if suffix in _IMAGES:
        return _field_scene(str(path), _read_image(path) * height, cell, start)
    if suffix not in _MESHES:
        raise SceneError(
            f"'{path}' is no heights file by its name: give .npy, {', '.join((*_IMAGES, *_MESHES))}"
        )
    return _mesh_scene(path, cell, scale, start, up)


def add_heightfield(
    spec: mujoco.MjSpec,
    name: str,
    heights: ArrayLike,
    x_range: tuple[float, float],
    y_range: tuple[float, float],
) -> None:
    """Add a heightfield geom with its corners at the ends of the ranges.

    Args:
      spec: the scene; the geom and its asset are added to it.
      name: name of both the geom and the asset.
      heights: (nrow, ncol) [m], rows along +y, columns along +x, first and last on the edges.
      x_range: extent along x [m].
      y_range: extent along y [m].
    """
    heights = np.asarray(heights, dtype=np.float64)
    low = float(heights.min())
    relief = float(np.ptp(heights))
    spec.add_hfield(
        name=name,
        # A level field has no relief, but MuJoCo wants a positive elevation.
        size=(np.ptp(x_range) / 2, np.ptp(y_range) / 2, relief if relief > 0 else 1e-6, _BASE),
        nrow=heights.shape[0],
        ncol=heights.shape[1],
        userdata=(heights - low).ravel().tolist(),
    )
    spec.worldbody.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_HFIELD,
        hfieldname=name,
        pos=(sum(x_range) / 2, sum(y_range) / 2, low),
        material=GROUND,
        castshadow=False,  # shadows of the ground on itself only give speckles
    )


def _field_scene(
    what: str, heights: NDArray[np.float64], cell: float, start: tuple[float, float] | None
) -> mujoco.MjSpec:
    """Return a scene with one heightfield, moved so that the start is the origin."""
    if heights.ndim != 2 or min(heights.shape) < 2:
        raise SceneError(
            f"heights '{what}' have shape {heights.shape}: they must be a grid of at least 2 x 2"
        )
    at_most(heights.size, MOST_SAMPLES, f"heights '{what}'", SceneError)
    if not np.isfinite(heights).all():
        row, column = np.argwhere(~np.isfinite(heights))[0]
        raise SceneError(
            f"heights '{what}' are not finite at row {row}, column {column}: fill the gaps"
        )
    size = np.array([heights.shape[1] - 1, heights.shape[0] - 1]) * cell
    _check_lengths(what, heights, size)
    corner = -_start_in(what, size, start)
    x_range = (float(corner[0]), float(corner[0] + size[0]))
    y_range = (float(corner[1]), float(corner[1] + size[1]))
    center = (sum(x_range) / 2, sum(y_range) / 2)
    spec = new_scene("heights", center, radius=max(float(size.max()) * 0.6, 2.0))
    add_heightfield(spec, "heights", heights, x_range, y_range)
    add_start(spec)
    return spec


def _check_lengths(what: str, heights: NDArray[np.float64], size: NDArray[np.float64]) -> None:
    at_most(float(np.abs(heights).max()), MOST_LENGTH, f"heights '{what}' [m]", SceneError)
    at_most(float(size.max()), MOST_LENGTH, f"size of '{what}' [m]", SceneError)


def _start_in(
    what: str, size: NDArray[np.float64], start: tuple[float, float] | None
) -> NDArray[np.float64]:
    """Return the start (2,) [m] from the low corner of a ground of ``size`` (2,) [m]."""
    if start is None:
        return np.array([min(1.0, size[0] / 10), size[1] / 2])
    point = np.asarray(start, dtype=np.float64)
    if point.shape != (2,) or not (np.isfinite(point).all() and (point >= 0).all()):
        raise SceneError(f"heights: start is {start}, it must be x and y in metres, not negative")
    if (point > size).any():
        raise SceneError(
            f"start {tuple(start)} m is beside the ground of '{what}',"
            f" which measures {size[0]:g} x {size[1]:g} m: move the start"
        )
    return point


def _read_npy(path: Path) -> NDArray[np.float64]:
    try:
        heights = read_array(path)
    except ValueError as error:
        raise SceneError(f"'{path}' is not an array file ({error}): save it with numpy") from error
    return real_array(heights, f"'{path}'", SceneError)


def _read_image(path: Path) -> NDArray[np.float64]:
    """Return the grey levels (nrow, ncol) of an image from 0 to 1, its bottom row first."""
    from PIL import Image

    try:
        with warnings.catch_warnings(), Image.open(path) as image:
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            width, height = image.size
            at_most(width * height, MOST_SAMPLES, f"pixels of '{path}'", SceneError)
            # Those modes hold more than 8 bits of grey.
            keep = image.mode in ("I;16", "I", "F")
            grey = np.asarray(image if keep else image.convert("L"))
    except SceneError:
        raise
    except Image.DecompressionBombError:
        most = f"{MOST_SAMPLES:,}"
        raise SceneError(f"'{path}' has more pixels than can be read: at most {most}") from None
    except Exception as error:  # Pillow's many readers raise whatever they raise
        why = first_line(error)
        raise SceneError(f"'{path}' is not an image that can be read ({why})") from error
    # Grey is float, 8 bits, or 16 bits (which Pillow's mode I keeps in signed integers).
    levels = {np.dtype(np.float32): 1.0, np.dtype(np.uint8): 255.0}
    white = levels.get(grey.dtype, 65535.0)
    return np.flipud(grey.astype(np.float64) / white)


def _mesh_scene(
    path: Path, cell: float, scale: float, start: tuple[float, float] | None, up: str
) -> mujoco.MjSpec:
    vertices, faces, convex = _read_mesh(path)
    if up == "y":
        vertices = vertices[:, [0, 2, 1]] * [1.0, -1.0, 1.0]
    vertices = vertices * scale
    at_most(float(np.abs(vertices).max()), MOST_LENGTH, f"vertices of '{path}' [m]", SceneError)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    size = (high - low)[:2]
    if size.min() <= 0:
        raise SceneError(f"mesh '{path}' has no area seen from above: check its up axis")
    corner = low[:2] + _start_in(str(path), size, start)
    vertices = vertices - [corner[0], corner[1], 0.0]
    if not convex:
        return _field_scene(str(path), _sample(path, vertices, faces, cell), cell, start)
    middle = vertices[:, :2].mean(axis=0)
    spec = new_scene("heights", (middle[0], middle[1]), radius=max(float(size.max()) * 0.6, 2.0))
    _add_mesh(spec, vertices, faces)
    spec.geom("heights").material = add_mesh_material(spec)
    try:
        add_start(spec)
    except ValueError as error:
        raise SceneError(f"mesh '{path}' does not compile: {mujoco_message(error)}") from error
    return spec


def _read_mesh(path: Path) -> tuple[NDArray[np.float64], NDArray[np.int32], bool]:
    """Return vertices (n, 3), faces (m, 3), and whether the mesh is convex and closed."""
    import trimesh

    at_most(path.stat().st_size, MOST_MESH, f"bytes of '{path}'", SceneError)
    try:
        mesh: Any = trimesh.load_mesh(str(path), skip_materials=True)
        if isinstance(mesh, trimesh.Scene):
            mesh = mesh.to_mesh()
        vertices = np.asarray(mesh.vertices, dtype=np.float64)
        faces = np.asarray(mesh.faces, dtype=np.int32)
    except Exception as error:  # trimesh raises what its many readers raise
        raise SceneError(
            f"'{path}' is not a mesh that trimesh can read ({type(error).__name__}: "
            f"{mujoco_message(error)}): use .obj, .stl, .ply or .glb"
        ) from error
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise SceneError(f"mesh '{path}' has vertices that are not of three numbers")
    if len(faces) == 0 or not np.isfinite(vertices).all():
        raise SceneError(f"mesh '{path}' has no triangles or vertices that are not finite")
    return vertices, faces, bool(mesh.is_watertight and mesh.is_convex)


def _add_mesh(spec: mujoco.MjSpec, vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> None:
    spec.add_mesh(
        name="heights",
        uservert=vertices.ravel().tolist(),
        userface=faces.ravel().tolist(),
        usertexcoord=(vertices[:, :2] * [1.0, -1.0]).ravel().tolist(),
        userfacetexcoord=faces.ravel().tolist(),
        # An open sheet has no volume to weigh.
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
    )
    spec.worldbody.add_geom(
        name="heights",
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname="heights",
        castshadow=False,
    )


def _sample(
    path: Path, vertices: NDArray[np.float64], faces: NDArray[np.int32], cell: float
) -> NDArray[np.float64]:
    """Return heights (nrow, ncol) [m] of a mesh seen from above, on a grid of ``cell`` [m].

    MuJoCo's own rays are used: they meet the triangles themselves, by a bounding volume tree.
    """
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    count = np.floor((high - low)[:2] / cell + 1e-9).astype(int) + 1
    if count.min() < 2:
        raise SceneError(f"mesh '{path}' is smaller than a cell of {cell} m: check its scale")
    if float(count[0]) * float(count[1]) > MOST_SAMPLES:
        raise SceneError(
            f"mesh '{path}' needs {count[0]} x {count[1]} samples of {cell} m: check its scale or"
            " use larger cells"
        )
    spec = mujoco.MjSpec()
    _add_mesh(spec, vertices, faces)
    # Without collision MuJoCo needs no convex hull, which a level sheet does not have.
    spec.geom("heights").contype = spec.geom("heights").conaffinity = 0
    # A floor at the lowest point catches the rays that miss the mesh.
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_PLANE, size=(0, 0, 1), pos=(0, 0, float(low[2]))
    )
    # Rays through the very edge of a mesh may miss it; half a millimetre in is certain.
    inset = np.minimum(5e-4, 0.01 * (high - low)[:2])
    x, y = (
        np.clip(low[i] + np.arange(count[i]) * cell, low[i] + inset[i], high[i] - inset[i])
        for i in range(2)
    )
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    try:
        return ground_heights(spec, grid).reshape(count[1], count[0])
    except ValueError as error:
        raise SceneError(f"mesh '{path}' does not compile: {mujoco_message(error)}") from error
