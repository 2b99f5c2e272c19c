"""What must hold at which frames: targets for sites, from the scene or from the user.

    hand = SiteConstraint("left_hand", frames=range(60, 80), position=points)
    more = load_constraints("constraints.yaml", model, nframe)

A constraints file (YAML or JSON) is a list; each entry names a site, its frames and what it wants:

    - site: left_hand
      frames: [60, 80]            # from 60 up to, not including, 80
      position: [1.2, 0.4, 1.1]   # one point [m], or one a frame
      quat: [1, 0, 0, 0]          # orientation wxyz, optional
      weight: 1.0                 # 0 to 1, optional: 1 is exact, less is a wish
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjmotion.exceptions import ConstraintError, MotionError, frame_list
from mjmotion.kinematics import site_id
from mjmotion.rotations import normalized, to_matrix

Array = NDArray[np.float64]

_KEYS = {"site", "frames", "position", "quat", "weight"}


@dataclasses.dataclass(frozen=True, eq=False)
class SiteConstraint:
    """Where one site must be, and how turned, at some frames.

    Attributes:
      site: name of the site.
      frames: (n,) frames, each once.
      position: (n, 3) world positions [m], or None; one (3,) point serves every frame.
      quat: (n, 4) world orientations wxyz of the site's frame, or None; one (4,) serves all.
      weight: in (0, 1]: 1 holds exactly, less gives way to other wishes.
      contact: the site stands on something: it takes part in the first guess (§4.5).

    Raises:
      ConstraintError: shapes that do not fit, values that are not finite, repeated frames.
    """

    site: str
    frames: NDArray[np.int64]
    position: Array | None = None
    quat: Array | None = None
    weight: float = 1.0
    contact: bool = False

    def __post_init__(self) -> None:
        frames = np.array(self.frames, dtype=np.int64).reshape(-1)
        where = f"constraint on site '{self.site}'"
        if len(frames) == 0:
            raise ConstraintError(f"{where} has no frames")
        if len(np.unique(frames)) != len(frames):
            raise ConstraintError(f"{where} names a frame twice")
        if self.position is None and self.quat is None:
            raise ConstraintError(f"{where} wants nothing: give a position or a quat")
        if not 0.0 < self.weight <= 1.0:
            raise ConstraintError(f"{where} has weight {self.weight}: it must be in (0, 1]")
        object.__setattr__(self, "frames", frames)
        for name, width in (("position", 3), ("quat", 4)):
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, _per_frame(value, len(frames), width, where, name))

    @property
    def nscalar(self) -> int:
        """Scalar constraints this stands for: 3 a position, 3 an orientation, at each frame."""
        return len(self.frames) * 3 * ((self.position is not None) + (self.quat is not None))


def _per_frame(value: ArrayLike, count: int, width: int, where: str, name: str) -> Array:
    try:
        array = np.asarray(value, dtype=np.float64)
        array = np.array(np.broadcast_to(array, (count, width)))
    except (TypeError, ValueError) as error:
        raise ConstraintError(
            f"{where}: {name} must be {width} numbers, or {count} rows of {width}"
        ) from error
    if not np.isfinite(array).all():
        raise ConstraintError(f"{where}: {name} is not finite")
    if name == "quat":
        if (np.linalg.norm(array, axis=1) < 1e-6).any():
            raise ConstraintError(f"{where}: a quat is zero")
        array = normalized(array)
    array.flags.writeable = False
    return array


def load_constraints(
    path: str | Path, model: mujoco.MjModel, nframe: int
) -> tuple[SiteConstraint, ...]:
    """Read a constraints file (see the module's example).

    Raises:
      ConstraintError: the file is missing or malformed, or names a site or frame that is not there.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise ConstraintError(f"cannot read constraints file '{path}': it does not exist") from None
    except (OSError, UnicodeDecodeError) as error:
        raise ConstraintError(f"cannot read constraints file '{path}': {error}") from error
    if path.suffix.lower() == ".json":
        try:
            entries = json.loads(text)
        except json.JSONDecodeError as error:
            raise ConstraintError(f"'{path}' is not JSON: {error}") from error
    else:
        import yaml

        try:
            entries = yaml.safe_load(text)
        except yaml.YAMLError as error:
            line = str(error).splitlines()[0]
            raise ConstraintError(f"'{path}' is not YAML: {line}") from error
    if not isinstance(entries, list):
        raise ConstraintError(f"'{path}' must hold a list of constraints")
    constraints = []
    for number, entry in enumerate(entries):
        try:
            constraints.append(_from_entry(entry, nframe))
            site_id(model, constraints[-1].site)
        except (MotionError, TypeError, ValueError) as error:
            raise ConstraintError(f"'{path}', entry {number}: {error}") from error
    return tuple(constraints)


def _from_entry(entry: Any, nframe: int) -> SiteConstraint:
    if not isinstance(entry, dict) or "site" not in entry or "frames" not in entry:
        raise ConstraintError("it must be a mapping with at least 'site' and 'frames'")
    unknown = set(entry) - _KEYS
    if unknown:
        raise ConstraintError(f"unknown key '{min(unknown)}': valid are {', '.join(sorted(_KEYS))}")
    span = entry["frames"]
    if type(span) is int:
        span = [span, span + 1]
    if not (isinstance(span, list) and len(span) == 2 and all(type(x) is int for x in span)):
        raise ConstraintError("'frames' must be one frame or [start, end]")
    if not 0 <= span[0] < span[1] <= nframe:
        raise ConstraintError(f"frames {span} are not within the motion's 0 to {nframe}")
    return SiteConstraint(
        str(entry["site"]),
        np.arange(*span),
        entry.get("position"),
        entry.get("quat"),
        float(entry.get("weight", 1.0)),
    )


@dataclasses.dataclass(frozen=True, eq=False)
class Targets:
    """All constraints of one fit, laid out over its constrained frames.

    Attributes:
      frames: (n,) constrained frames, in order.
      sites: (s,) ids of the constrained sites.
      position: (n, s, 3) [m]; holds where ``position_weight`` is not zero.
      matrix: (n, s, 3, 3) orientations; holds where ``turn_weight`` is not zero.
      quat: (n, s, 4) the same, wxyz.
      position_weight, turn_weight: (n, s) in [0, 1].
      contact: (n, s) whether the position is that of a contact.
    """

    frames: NDArray[np.int64]
    sites: NDArray[np.int64]
    position: Array
    matrix: Array
    quat: Array
    position_weight: Array
    turn_weight: Array
    contact: NDArray[np.bool_]

    def at(self, rows: NDArray[np.int64]) -> Targets:
        """Return the targets of some of the constrained frames."""
        values = {
            field.name: getattr(self, field.name)[rows]
            for field in dataclasses.fields(self)
            if field.name != "sites"
        }
        return Targets(sites=self.sites, **values)

    def columns(self, sites: NDArray[np.bool_]) -> Targets:
        """Return the targets of some of the sites."""
        values = {
            field.name: getattr(self, field.name)[:, sites]
            for field in dataclasses.fields(self)
            if field.name not in ("sites", "frames")
        }
        return Targets(frames=self.frames, sites=self.sites[sites], **values)


def lay_out(constraints: Sequence[SiteConstraint], model: mujoco.MjModel, nframe: int) -> Targets:
    """Lay constraints out over frames; where two speak of the same site and frame, the later holds.

    Raises:
      ConstraintError: a frame the motion does not have.
      ModelError: an unknown site.
    """
    sites: list[int] = []
    for constraint in constraints:
        if (index := site_id(model, constraint.site)) not in sites:
            sites.append(index)
        bad = constraint.frames[(constraint.frames < 0) | (constraint.frames >= nframe)]
        if len(bad):
            raise ConstraintError(
                f"constraint on site '{constraint.site}' names frames {frame_list(bad)}:"
                f" the motion has 0 to {nframe - 1}",
                bad,
            )
    frames = (
        np.unique(np.concatenate([c.frames for c in constraints]))
        if constraints
        else np.empty(0, np.int64)
    )
    shape = (len(frames), len(sites))
    position, contact = np.zeros((*shape, 3)), np.zeros(shape, dtype=bool)
    quat = np.zeros((*shape, 4))
    quat[..., 0] = 1.0
    weights = np.zeros((2, *shape))
    for constraint in constraints:
        rows = np.searchsorted(frames, constraint.frames)
        column = sites.index(site_id(model, constraint.site))
        if constraint.position is not None:
            position[rows, column] = constraint.position
            weights[0, rows, column] = constraint.weight
            contact[rows, column] = constraint.contact
        if constraint.quat is not None:
            quat[rows, column] = constraint.quat
            weights[1, rows, column] = constraint.weight
    return Targets(
        frames,
        np.array(sites, dtype=np.int64),
        position,
        to_matrix(quat),
        quat,
        weights[0],
        weights[1],
        contact,
    )
