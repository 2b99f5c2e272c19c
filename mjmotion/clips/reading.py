"""Read any recording that brings its own skeleton, and say of the rest how to get there."""

from __future__ import annotations

from pathlib import Path

from mjmotion.boundary.arrays import names_in_archive
from mjmotion.clips.asf import read_amc
from mjmotion.clips.bvh import read_bvh
from mjmotion.clips.skeleton import Clip
from mjmotion.exceptions import ClipError

GLTF = (".glb", ".gltf", ".vrma")
SUFFIXES = (".bvh", ".amc", *GLTF, ".npz", ".csv")

_EXPORT = "File > Export > Motion Capture (.bvh) or glTF 2.0 (.glb)"
_BLENDER = f"open it in Blender (File > Import), then {_EXPORT}"
_MARKERS = "it holds markers and no skeleton: solve them in your capture program, export a .bvh"
# What people have and what is not read, and how to get from there to what is.
_OTHERS = {
    ".fbx": _BLENDER,
    ".dae": _BLENDER,
    ".blend": f"open it in Blender, then {_EXPORT}",
    ".usd": _BLENDER,
    ".usda": _BLENDER,
    ".usdc": _BLENDER,
    ".usdz": _BLENDER,
    ".vmd": f"load it on its model in Blender with MMD Tools, then {_EXPORT}",
    ".ma": "export it from Maya as FBX; of FBX, " + _BLENDER,
    ".mb": "export it from Maya as FBX; of FBX, " + _BLENDER,
    ".max": "export it from 3ds Max as BVH, or as FBX; of FBX, " + _BLENDER,
    ".bip": "load it on a Biped in 3ds Max and export FBX; of FBX, " + _BLENDER,
    ".c3d": _MARKERS,
    ".trc": _MARKERS,
    ".mvnx": "export it from MVN as .bvh",
    ".asf": "it is a skeleton without motion: give the .amc file, and this one as --asf",
    ".pkl": "pickles can run code: save poses, trans and mocap_framerate with numpy.savez as .npz",
    ".npy": "save poses, trans and mocap_framerate with numpy.savez as .npz",
}


def is_recording(what: str | Path) -> bool:
    """Return whether this names a file of motion on a skeleton of its own.

    By its ending; an .npz file is one if it holds poses as AMASS does.
    """
    path = Path(what)
    suffix = path.suffix.lower()
    return suffix in (".bvh", ".amc", *GLTF) or (suffix == ".npz" and _holds_poses(path))


def read_clip(path: str | Path, *, fps: float | None = None, asf: str | Path | None = None) -> Clip:
    """Read a BVH, AMC, glTF or AMASS (.npz) file as a clip on its own skeleton.

    Args:
      path: the file.
      fps: rate to take in place of the file's, such as for an AMC that is not at 120; glTF, which
        has times in place of frames, is sampled at it.
      asf: of an AMC file, its skeleton; by default the one that belongs to its name.

    Raises:
      ClipError: the file is missing, damaged, or of another kind.
    """
    suffix = Path(path).suffix.lower()
    if asf is not None and suffix != ".amc":
        raise ClipError(f"'{path}' is no AMC file: leave the ASF skeleton")
    if suffix == ".bvh":
        return read_bvh(path, fps=fps)
    if suffix == ".amc":
        return read_amc(path, asf) if fps is None else read_amc(path, asf, fps=fps)
    if suffix in GLTF:
        from mjmotion.clips.gltf import read_gltf

        return read_gltf(path, fps=fps)
    if suffix == ".npz":
        from mjmotion.clips.amass import read_amass

        return read_amass(path, fps=fps)
    raise not_read(path, "it is not a recording on a skeleton: give a .bvh, .amc or .glb file")


def not_read(path: str | Path, otherwise: str) -> ClipError:
    """Return the error for a file of a kind that is not read: how to get to one that is."""
    way = _OTHERS.get(Path(path).suffix.lower())
    if way is not None:
        otherwise = f"files of this kind are not read: {way}"
    return ClipError(f"'{path}': {otherwise}")


def _holds_poses(path: Path) -> bool:
    """Return whether an .npz file has the arrays of AMASS, by the names in its directory."""
    names = names_in_archive(path)
    return bool({"poses", "pose_body"} & names) and "qpos" not in names
