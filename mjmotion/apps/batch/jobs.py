"""What is to be done: jobs, what they are made from, and the hash that tells one from another."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Iterator, Mapping
from pathlib import Path

import mujoco

import mjmotion
from mjmotion.exceptions import BatchError
from mjmotion.fitting import TOLERANCE

BLOCK = 8
"""Pairs of scene and character that a worker keeps compiled, and clips that it keeps read.

A terrain of the paper takes 17 MB, and as much again with a character in it.
"""
SEED = "seed="
MOST_NAME = 200
"""Letters of a job's name, which is the name of a folder."""


@dataclasses.dataclass(frozen=True)
class Source:
    """A clip, a scene or a character, by what names it.

    Attributes:
      name: short name, a part of the names of jobs.
      where: absolute path, fsspec address or built-in name; empty of a terrain that is made.
      digest: hash of its content.
      seed: of a terrain that is made.
    """

    name: str
    where: str
    digest: str
    seed: int | None = None

    @property
    def origin(self) -> str:
        """What names it in the table: ``where``, or ``seed=N`` of a terrain that is made."""
        return self.where if self.seed is None else f"{SEED}{self.seed}"

    @classmethod
    def at(cls, name: str, origin: str) -> Source:
        """Return what a table names; its content is not hashed."""
        if not origin.startswith(SEED):
            return cls(name, origin, "")
        return cls(name, "", "", int(origin.removeprefix(SEED)))


@dataclasses.dataclass(frozen=True)
class Settings:
    """How all jobs of a batch are done: as :func:`mjmotion.load_clip` and :func:`mjmotion.adapt`.

    Attributes:
      levels, tolerance, ik, heading, free_footholds: of the fit.
      fps, mapping, asf, in_place, loop, floor: of reading clips.
      thresholds: changes to the default thresholds, by name, as pairs.
      report: write everything of a result with its report, or motion and figures only.
    """

    levels: tuple[float, ...] | None = None
    tolerance: float = TOLERANCE
    ik: str = "hybrid"
    heading: str = "start"
    free_footholds: bool = False
    fps: float | None = None
    mapping: str | None = None
    asf: str | None = None
    in_place: str | float | None = None
    floor: str = "auto"
    loop: int = 1
    thresholds: tuple[tuple[str, object], ...] = ()
    report: bool = True

    def digest(self) -> str:
        """Return a hash of the settings, of the files that they name, and of the versions."""
        said = dataclasses.asdict(self)
        for name in ("mapping", "asf"):
            said[name] = file_digest(said[name]) if said[name] else None
        said["versions"] = [mjmotion.__version__, mujoco.__version__]
        return digest(json.dumps(said, sort_keys=True, default=str))


@dataclasses.dataclass(frozen=True)
class Job:
    """One clip on one scene with one character.

    Attributes:
      name: ``CLIP@SCENE@CHARACTER``; the name of its folder.
      key: hash of its inputs, the settings and the versions: of what it is made from.
    """

    name: str
    clip: Source
    scene: Source
    character: Source
    key: str


@dataclasses.dataclass(frozen=True)
class Batch:
    """All clips × all scenes × all characters.

    Raises:
      BatchError: nothing of a kind, or two jobs would have the same name.
    """

    clips: tuple[Source, ...]
    scenes: tuple[Source, ...]
    characters: tuple[Source, ...]
    settings: Settings = Settings()  # frozen

    def __post_init__(self) -> None:
        for kind in ("clips", "scenes", "characters"):
            sources: tuple[Source, ...] = getattr(self, kind)
            if not sources:
                raise BatchError(f"a batch without {kind}: give some")
            by_name: dict[str, Source] = {}
            for source in sources:
                other = by_name.setdefault(source.name, source)
                if other is not source:
                    raise BatchError(
                        f"two jobs of one name: {kind} '{other.where}' and '{source.where}' are"
                        f" both called '{source.name}': rename one, or run them into another --out"
                    )
        longest = sum(
            max(len(source.name.encode()) for source in sources)
            for sources in (self.clips, self.scenes, self.characters)
        )
        if longest > MOST_NAME:
            raise BatchError(f"names of {longest} letters together: at most {MOST_NAME} can be")

    def __len__(self) -> int:
        return len(self.clips) * len(self.scenes) * len(self.characters)

    def jobs(self) -> Iterator[Job]:
        """Yield every job, in an order in which a worker reads and compiles little.

        Pairs of scene and character come in blocks that a worker can keep; within a block each clip
        is read once.
        """
        how = self.settings.digest()
        pairs = [(scene, character) for character in self.characters for scene in self.scenes]
        for first in range(0, len(pairs), BLOCK):
            for clip in self.clips:
                for scene, character in pairs[first : first + BLOCK]:
                    parts = (clip, scene, character)
                    yield Job(
                        "@".join(part.name for part in parts),
                        clip,
                        scene,
                        character,
                        digest("\n".join((*(part.digest for part in parts), how))),
                    )


def digest(content: str | bytes) -> str:
    """Return the hash of a content, 32 hexadecimal digits."""
    data = content if isinstance(content, bytes) else content.encode("utf-8", "surrogatepass")
    return hashlib.sha256(data).hexdigest()[:32]


def file_digest(path: str | Path) -> str:
    """Return the hash of a file's content; of one that cannot be read, that of the reason.

    Its job is to fail with a line of its own, and to be done once the file can be read.
    """
    try:
        with Path(path).open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()[:32]
    except (OSError, ValueError) as error:
        return digest(f"not read: {error}")


def as_thresholds(changes: Mapping[str, object]) -> tuple[tuple[str, object], ...]:
    """Return changes of thresholds as :class:`Settings` holds them."""
    return tuple(sorted(changes.items()))
