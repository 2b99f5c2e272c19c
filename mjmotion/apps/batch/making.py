"""One job made: read, put together, adapted, measured. What several jobs share is kept.

loaded = Loaded()
made = make(job, settings, loaded)
made.result, made.validation, made.seconds
"""

from __future__ import annotations

import contextlib
import dataclasses
import time
from collections import OrderedDict
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Generic, TypeVar

from mjmotion.apps.adaptation import adapt, as_clip
from mjmotion.apps.batch.jobs import BLOCK, Job, Settings, Source
from mjmotion.apps.batch.storage import is_address, remote
from mjmotion.apps.retarget.copying import same_joints
from mjmotion.apps.retarget.moving import retarget
from mjmotion.apps.retarget.roles import with_soles
from mjmotion.body.character import Character
from mjmotion.body.motion import Motion
from mjmotion.clips import load_clip
from mjmotion.exceptions import ClipError
from mjmotion.output.result import Result
from mjmotion.scene import Scene, compose, load_scene, terrain, without_scene
from mjmotion.validation import Validation

T = TypeVar("T")
Clock = Callable[[], float]
HUMANOID = "humanoid"
_OWN = (".npz", ".csv")  # clips of a character's own joints


class Shelf(Generic[T]):
    """Things kept by what they were made from; the one unused for longest goes.

    Args:
      most: how many are kept.
    """

    def __init__(self, most: int = BLOCK) -> None:
        self._most = most
        self._kept: OrderedDict[tuple[str, ...], T] = OrderedDict()

    def get(self, key: tuple[str, ...], make: Callable[[], T]) -> T:
        """Return what is kept under a key of hashes, or make it."""
        if key in self._kept:
            self._kept.move_to_end(key)
            return self._kept[key]
        made = make()
        self._kept[key] = made
        if len(self._kept) > self._most:
            self._kept.popitem(last=False)
        return made


class Loaded:
    """Clips, scenes and characters that a worker has read, each once while it is in use."""

    def __init__(self) -> None:
        self._clips: Shelf[Motion] = Shelf()
        self._scenes: Shelf[Scene] = Shelf()
        self._characters: Shelf[Character] = Shelf()
        self._composed: Shelf[Character] = Shelf()
        self._alike: Shelf[bool] = Shelf()

    def character(self, source: Source) -> Character:
        """Return a character.

        Raises:
          ModelError: it cannot be read, or has no free root.
        """
        return self._characters.get((source.digest,), lambda: Character.load(source.where))

    def scene(self, source: Source) -> Scene:
        """Return a scene that stands still.

        Raises:
          SceneError: it cannot be read or does not compile.
        """
        return self._scenes.get((source.digest,), lambda: scene_at(source))

    def clip(self, source: Source, onto: Source, settings: Settings) -> Motion:
        """Return a clip on a character alone.

        A character with the humanoid's joints takes it as :func:`mjmotion.load_clip` puts it there.
        On any other, such as a robot, it is retargeted from the humanoid, on level ground.

        Raises:
          MotionError: it cannot be read, or not be put on the character.
        """
        return self._clips.get(
            (source.digest, onto.digest, settings.digest()),
            lambda: self._read(source, onto, settings),
        )

    def composed(self, motion: Motion, source: Source, where: Source) -> Character:
        """Return the character of a clip in a scene, both in one model.

        Args:
          motion: the clip on the character alone, as :meth:`clip` gives it.
          source: what names the character.
          where: what names the scene.

        Raises:
          SceneError: they cannot be put together.
        """
        return self._composed.get(
            (source.digest, where.digest), lambda: compose(motion.character, self.scene(where))
        )

    def _read(self, source: Source, onto: Source, settings: Settings) -> Motion:
        character = self.character(onto)
        with local_clip(source.where) as path:
            own = path.suffix.lower() in _OWN
            if own or self._alike.get((onto.digest,), lambda: _like_humanoid(character)):
                with contextlib.suppress(ClipError) if own else contextlib.nullcontext():
                    return as_clip(_load(path, character, settings))
            motion = _load(path, self._humanoid(), settings)
        return as_clip(retarget(motion, character, levels=settings.levels).motion)

    def _humanoid(self) -> Character:
        return self._characters.get((HUMANOID,), lambda: Character.load(HUMANOID))


@dataclasses.dataclass(frozen=True, eq=False)
class Made:
    """What a job came to.

    Attributes:
      result: the motion and what it came from.
      validation: its figures.
      seconds: of ``load``, ``adapt`` (planning and fit) and ``validate``, by the clock [s].
    """

    result: Result
    validation: Validation
    seconds: dict[str, float]


def make(job: Job, settings: Settings, loaded: Loaded, clock: Clock = time.perf_counter) -> Made:
    """Do a job, but for writing it.

    Raises:
      MotionError: bad input.
    """
    began = clock()
    scene = loaded.scene(job.scene)
    clip = loaded.clip(job.clip, job.character, settings)
    composed = loaded.composed(clip, job.character, job.scene)
    read = clock()
    result = adapt(
        clip,
        scene,
        free_footholds=settings.free_footholds,
        heading=settings.heading,
        levels=settings.levels,
        tolerance=settings.tolerance,
        ik=settings.ik,
        composed=composed,
    )
    adapted = clock()
    validation = result.validate(dict(settings.thresholds))
    seconds = {"load": read - began, "adapt": adapted - read, "validate": clock() - adapted}
    return Made(result, validation, seconds)


def scene_at(source: Source) -> Scene:
    """Return the scene that a source names, standing still; a terrain is made.

    Raises:
      SceneError: it cannot be read or does not compile.
    """
    if source.seed is None:
        return load_scene(source.where).at_rest()
    return Scene.from_spec(terrain(source.seed), source.name)


def composed_at(character: Source, scene: Source) -> Character:
    """Return the character in the scene of a job that was done, as they are now.

    Raises:
      MotionError: they are gone, or cannot be put together.
    """
    body = without_scene(Character.load(character.where))
    body = body if _like_humanoid(body) else with_soles(body)
    return compose(body, scene_at(scene))


@contextlib.contextmanager
def local_clip(where: str) -> Iterator[Path]:
    """Give a clip as a local file: one at an fsspec address is copied for the while.

    Raises:
      ClipError: it cannot be copied.
    """
    if not is_address(where):
        yield Path(where)
        return
    system, inside = remote(where)
    with TemporaryDirectory(prefix="mjmotion-") as folder:
        path = Path(folder) / Path(inside).name
        try:
            system.get_file(inside, str(path))
            if path.suffix.lower() == ".amc":  # its skeleton is beside it
                for skeleton in system.glob(f"{inside.rpartition('/')[0]}/*.asf"):
                    system.get_file(skeleton, str(path.parent / Path(skeleton).name))
        except (OSError, ValueError) as error:
            raise ClipError(f"'{where}' cannot be read: {error}") from error
        yield path


def _like_humanoid(character: Character) -> bool:
    return same_joints(Character.load(HUMANOID), character)


def _load(path: Path, character: Character, settings: Settings) -> Motion:
    return load_clip(
        path if path.suffix else str(path),
        character,
        mapping=settings.mapping,
        fps=settings.fps,
        asf=settings.asf,
        in_place=settings.in_place,
        floor=settings.floor,
        loop=settings.loop,
    )
