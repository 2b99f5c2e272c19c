"""Clips, scenes and characters that a user named, found and hashed before any work."""

from __future__ import annotations

import glob
import json
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from urllib.parse import unquote

from mjmotion.apps.batch.jobs import Batch, Settings, Source, digest, file_digest
from mjmotion.apps.batch.storage import is_address, plain_path, remote
from mjmotion.body.assets import asset_names, find_asset
from mjmotion.boundary.mjcf import mjcf_files
from mjmotion.clips import builtin_clips
from mjmotion.exceptions import BatchError, ModelError, MotionError, SceneError, unknown_name

_GLOB = re.compile(r"[*?\[]")
_ERRORS = {"scene": SceneError, "model": ModelError}


def make_batch(
    clips: Sequence[str | Path],
    scenes: Sequence[str | Path] = (),
    characters: Sequence[str | Path] = ("humanoid",),
    *,
    terrains: int = 0,
    settings: Settings | None = None,
) -> Batch:
    """Return the batch of what is named.

    Args:
      clips: files, globs, fsspec addresses or built-in names.
      scenes: MJCF files, globs, or names of ours.
      characters: MJCF files, globs, or names of ours.
      terrains: how many of the paper's terrains are made besides, with seeds from 1.
      settings: how it is done.

    Raises:
      BatchError: a glob that finds nothing, a file that is not there, two of one name.
    """
    settings = Settings() if settings is None else settings
    return Batch(
        find_clips(clips, settings.asf is None),
        find_models("scene", scenes) + make_terrains(terrains),
        find_models("model", characters),
        settings,
    )


def find_clips(named: Iterable[str | Path], with_skeletons: bool = True) -> tuple[Source, ...]:
    """Return clips by files, globs, fsspec addresses or built-in names, each once.

    Args:
      named: what the user gave.
      with_skeletons: whether the skeletons beside an AMC file are a part of it.

    Raises:
      BatchError: a glob finds nothing, or there is no such file or name.
    """
    ours = builtin_clips()
    found: dict[str, Source] = {}
    for what in map(plain_path, map(str, named)):
        if is_address(what):
            found |= {where: _remote_clip(where) for where in _remote_files(what)}
        elif what in ours and not Path(what).exists():
            found[what] = Source(safe_name(what), what, digest(f"built-in clip {what}"))
        else:
            for path in _local_files(what, "clip", ours):
                where = str(path)
                found[where] = Source(
                    safe_name(path.stem), where, _clip_digest(path, with_skeletons)
                )
    return tuple(found.values())


def find_models(kind: str, named: Iterable[str | Path]) -> tuple[Source, ...]:
    """Return scenes (``"scene"``) or characters (``"model"``) by files, globs or our names.

    Raises:
      BatchError: a glob finds nothing, or there is no such file or name.
    """
    found: dict[str, Source] = {}
    for what in map(str, named):
        if what in asset_names(kind) and not Path(what).exists():
            path = find_asset(kind, what)
            found[what] = Source(safe_name(what), what, _model_digest(path, kind))
            continue
        for path in _local_files(what, kind, asset_names(kind)):
            found[str(path)] = Source(safe_name(path.stem), str(path), _model_digest(path, kind))
    return tuple(found.values())


def make_terrains(count: int) -> tuple[Source, ...]:
    """Return the paper's terrains with seeds 1 to ``count``, to be made where they are used."""
    return tuple(
        Source(f"terrain-{seed}", "", digest(f"terrain of seed {seed}"), seed)
        for seed in range(1, count + 1)
    )


def safe_name(stem: str) -> str:
    """Return a name that any file system takes and that does not hold the mark between parts."""
    name = re.sub(r"[^\w.+-]", "_", stem)
    return f"_{name}" if name.startswith(".") or not name else name


def _local_files(what: str, kind: str, ours: Iterable[str]) -> Sequence[Path]:
    """Return the files that a path or a glob means, as absolute paths, sorted."""
    path = Path(what)
    try:
        if path.is_file():
            return [path.absolute()]
        if path.is_dir():
            raise BatchError(f"{kind} '{what}' is a folder: give its files, such as '{what}/*.bvh'")
    except (OSError, ValueError) as error:
        raise BatchError(f"{kind} '{what}' cannot be read: {error}") from error
    if not _GLOB.search(what):
        if path.suffix or path.parent != Path():
            raise BatchError(f"{kind} '{what}' does not exist: check the path")
        raise BatchError(unknown_name(kind, what, ours))
    files = sorted(Path(name).absolute() for name in glob.glob(what, recursive=True))  # noqa: PTH207
    files = [file for file in files if file.is_file()]
    if not files:
        raise BatchError(f"no file matches '{what}': check the pattern")
    return files


def _clip_digest(path: Path, with_skeletons: bool) -> str:
    """Return the hash of a clip and of the files that are read with it."""
    files = [path]
    suffix = path.suffix.lower()
    if suffix == ".amc" and with_skeletons:
        files += sorted(path.parent.glob("*.asf"))
    if suffix == ".gltf":
        files += [path.parent / name for name in _buffers(path)]
    return digest("\n".join(map(file_digest, files))) if len(files) > 1 else file_digest(path)


def _buffers(path: Path) -> list[str]:
    """Return the names of the files that hold a glTF file's buffers."""
    try:
        buffers = json.loads(path.read_bytes()).get("buffers", ())
        names = [str(buffer.get("uri") or "") for buffer in buffers]
    except (OSError, ValueError, AttributeError, TypeError):
        return []  # the job says what is the matter
    return [unquote(name) for name in names if name and not name.startswith("data:")]


def _model_digest(path: Path, kind: str) -> str:
    """Return the hash of an MJCF file and of all that it includes or names."""
    try:
        files = mjcf_files(path.resolve(), _ERRORS[kind])
    except MotionError:  # what it is refused for is said by its jobs
        files = (path,)
    return digest("\n".join(map(file_digest, files)))


def _remote_files(what: str) -> list[str]:
    """Return the addresses that an fsspec address or glob means, sorted."""
    filesystem, inside = remote(what)
    try:
        if not _GLOB.search(inside):
            if not filesystem.exists(inside):
                raise BatchError(f"clip '{what}' does not exist: check the address")
            return [what]
        names = sorted(filesystem.glob(inside))
    except (OSError, ValueError) as error:
        raise BatchError(f"cannot look for '{what}': {error}") from error
    if not names:
        raise BatchError(f"no file matches '{what}': check the pattern")
    return [filesystem.unstrip_protocol(name) for name in names]


def _remote_clip(where: str) -> Source:
    """Return a clip elsewhere: its hash is of what its file system says tells it from another."""
    filesystem, inside = remote(where)
    try:
        mark = digest(f"{where} {filesystem.ukey(inside)}")
    except (OSError, ValueError) as error:
        mark = digest(f"not read: {error}")
    return Source(safe_name(Path(inside).stem), where, mark)
