"""Write a model with everything it needs into one folder, so that plain MuJoCo loads it."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import mujoco
import numpy as np

from mjmotion.boundary.mjcf import MUJOCO_ERRORS
from mjmotion.boundary.whole import write_whole
from mjmotion.exceptions import OutputError, SceneError, mujoco_message

_CUBE_FACES = 6


def save_model(spec: mujoco.MjSpec, folder: str | Path, filename: str = "model.xml") -> Path:
    """Write ``spec`` as MJCF with its heightfields, meshes, skins and textures beside it.

    The files are named after their assets; where a file of that name with other contents is there
    already, a number is added, so several models can share one folder, and equal files are shared.
    Every number is written exactly: what is loaded is the model that was compiled.

    Args:
      spec: the model; it is not changed.
      folder: where to write; it is made if it does not exist.
      filename: name of the MJCF file.

    Returns:
      The path of the MJCF file.

    Raises:
      SceneError: the spec does not compile or one of its files is gone.
      OutputError: the folder cannot be written.
    """
    folder = Path(folder).resolve()
    spec = spec.copy()
    try:
        model = spec.compile()
    except MUJOCO_ERRORS as error:
        raise SceneError(f"the model does not compile: {mujoco_message(error)}") from error
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _write_hfields(spec, model, folder)
        _write_files(spec, spec.meshes, model.paths, model.mesh_pathadr, folder)
        _write_files(spec, spec.skins, model.paths, model.skin_pathadr, folder)
        _write_textures(spec, model, folder)
        spec.compiler.meshdir = ""
        spec.compiler.texturedir = ""
        spec.strippath = False
        # As written, not as compiled: every number exact, and frames and classes kept.
        spec.compiler.savecompiled = False
        path = folder / filename
        write_whole(path, _relative(spec.to_xml(), folder))
    except OSError as error:
        raise OutputError(
            f"cannot write the model into '{folder}': {error.strerror or error}"
        ) from error
    except MUJOCO_ERRORS as error:
        raise SceneError(f"the model cannot be saved as MJCF: {mujoco_message(error)}") from error
    return path


def _relative(xml: str, folder: Path) -> str:
    """Make the paths of files in ``folder`` relative to the MJCF that lies beside them.

    The spec needs absolute ones: what was attached looks for files where its own model was.
    """
    prefix = escape(f"{folder}/", {'"': "&quot;", "'": "&apos;"})
    return xml.replace(f'"{prefix}', '"')


def _write_hfields(spec: mujoco.MjSpec, model: mujoco.MjModel, folder: Path) -> None:
    """Write every heightfield in MuJoCo's binary format, whatever it came from.

    The compiled data is already normalised to [0, 1], so that compiling it again changes nothing.
    """
    for index, hfield in enumerate(spec.hfields):
        nrow, ncol = int(model.hfield_nrow[index]), int(model.hfield_ncol[index])
        start = int(model.hfield_adr[index])
        values = np.asarray(model.hfield_data[start : start + nrow * ncol], dtype="<f4")
        contents = np.array([nrow, ncol], dtype="<i4").tobytes() + values.tobytes()
        hfield.name = model.hfield(index).name
        hfield.file = _place(folder, hfield.name or "heights", ".bin", contents)
        hfield.content_type = ""
        hfield.nrow = hfield.ncol = 0
        hfield.userdata = []


def _write_files(
    spec: mujoco.MjSpec, assets: list[Any], paths: bytes, addresses: Any, folder: Path
) -> None:
    """Copy the files of meshes or skins; those whose data is inline stay inline."""
    for index, asset in enumerate(assets):
        if not asset.file:
            continue
        contents = _read(spec, asset.file, _resolved(paths, int(addresses[index])))
        source = Path(asset.file)
        asset.name = asset.name or source.stem
        asset.file = _place(folder, asset.name, source.suffix.lower(), contents)


def _write_textures(spec: mujoco.MjSpec, model: mujoco.MjModel, folder: Path) -> None:
    """Copy the files of textures and write those held in memory as PNG."""
    for index, texture in enumerate(spec.textures):
        if texture.file:
            contents = _read(
                spec, texture.file, _resolved(model.paths, int(model.tex_pathadr[index]))
            )
            source = Path(texture.file)
            texture.name = texture.name or source.stem
            texture.file = _place(folder, texture.name, source.suffix.lower(), contents)
        base = Path(spec.modelfiledir) / texture.compiler.texturedir
        faces = list(texture.cubefiles)
        for face, file in enumerate(faces):
            if file:
                contents = _read(spec, file, base / file)
                stem = f"{texture.name}_{Path(file).stem}"
                faces[face] = _place(folder, stem, Path(file).suffix.lower(), contents)
        if any(faces):
            texture.cubefiles = faces
        if len(texture.data):
            contents = _png(texture)
            texture.file = _place(folder, texture.name or "texture", ".png", contents)
            texture.data = b""
            if texture.type != mujoco.mjtTexture.mjTEXTURE_2D:
                texture.gridsize = [_CUBE_FACES, 1]  # the faces stand one below the other
                texture.gridlayout = "RLUDFB"


def _png(texture: Any) -> bytes:
    """Return the pixels of a texture held in memory as a PNG file."""
    from PIL import Image

    height, width, nchannel = int(texture.height), int(texture.width), int(texture.nchannel)
    pixels = np.frombuffer(bytes(texture.data), dtype=np.uint8).reshape(height, width, nchannel)
    file = io.BytesIO()
    Image.fromarray(pixels[:, :, 0] if nchannel == 1 else pixels).save(file, format="PNG")
    return file.getvalue()


def _resolved(paths: bytes, address: int) -> Path:
    """Return the path at ``address`` of the compiled model's table of asset paths."""
    if address < 0:
        return Path()
    return Path(bytes(paths)[address:].split(b"\0", 1)[0].decode())


def _read(spec: mujoco.MjSpec, name: str, path: Path) -> bytes:
    """Return an asset's contents: held by the spec in memory, else from its file."""
    for key in (name, str(path), path.name):
        if key in spec.assets:
            contents = spec.assets[key]
            return contents.encode() if isinstance(contents, str) else bytes(contents)
    if not path.is_file():
        raise SceneError(f"asset file '{path}' of the model is gone: put it back")
    return path.read_bytes()


def _place(folder: Path, stem: str, suffix: str, contents: bytes) -> str:
    """Write ``contents`` under a free name, or find it there already; return the file's path."""
    stem = "".join(letter if letter.isalnum() or letter in "-_." else "_" for letter in stem)
    number, name = 1, f"{stem}{suffix}"
    while (folder / name).exists():
        if (folder / name).read_bytes() == contents:
            return str(folder / name)
        number += 1
        name = f"{stem}-{number}{suffix}"
    write_whole(folder / name, contents)
    return str(folder / name)
