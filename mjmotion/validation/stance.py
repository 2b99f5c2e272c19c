"""How contacts stand: the drift of each, its gap to the ground, and how fast it slides."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.validation.figures import contact_frames
from mjmotion.validation.ground import Ground
from mjmotion.validation.inputs import Contact, stands
from mjmotion.validation.result import Worst

Array = NDArray[np.float64]
_MM = 1000.0
_FIELD_SHARE = 95.0  # the percentile of gaps on heightfields that counts


@dataclasses.dataclass(frozen=True, eq=False)
class Gap:
    """A figure of gaps [mm], and where it is worst."""

    name: str
    value: float
    worst: Worst


class Stance:
    """Sites that feet stand with, over the ground under each, in all frames.

    Args:
      ground: the scene.
      sites: ids of the sites.
      position: (nframe, nsite, 3) where they are [m].
      contacts: who stands when; their sites are among those.
      fps: frames a second.
    """

    def __init__(
        self,
        ground: Ground,
        sites: Sequence[int],
        position: Array,
        contacts: Sequence[Contact],
        fps: float,
    ) -> None:
        self._ground, self._contacts, self._fps = ground, tuple(contacts), fps
        self._position = position
        self._names = [ground.model.site(site).name for site in sites]
        height, under = ground.heights(position.reshape(-1, 3))
        self._height = height.reshape(position.shape[:2])
        self._under = under.reshape(position.shape[:2])
        self._gap = np.abs(position[:, :, 2] - self._height)
        self._gap[self._under < 0] = np.inf  # stands on nothing
        kind = ground.model.geom_type[np.maximum(self._under, 0)]
        self._on_field = (self._under >= 0) & (kind == mujoco.mjtGeom.mjGEOM_HFIELD)
        self._column = [self._names.index(contact.site) for contact in contacts]

    def per_frame(self) -> dict[str, NDArray[Any]]:
        """Return heights, ground and gaps of every site: see ``Validation.per_frame``."""
        held = np.zeros(self._gap.shape, dtype=bool)
        for contact, column in zip(self._contacts, self._column, strict=True):
            held[contact.start : contact.end, column] = True
        arrays: dict[str, NDArray[Any]] = {}
        for i, name in enumerate(self._names):
            arrays[f"height_m/{name}"] = self._position[:, i, 2].copy()
            arrays[f"ground_m/{name}"] = self._height[:, i].copy()
            arrays[f"gap_mm/{name}"] = np.where(held[:, i], self._gap[:, i] * _MM, np.nan)
            arrays[f"contact/{name}"] = held[:, i].copy()
        return arrays

    def per_contact(self) -> list[dict[str, Any]]:
        """Return what is measured of each contact: see ``Validation.per_contact``."""
        return [
            self._measure(contact, column)
            for contact, column in zip(self._contacts, self._column, strict=True)
        ]

    def mean_speed(self) -> float:
        """Return the mean horizontal speed [mm/s] of sites in contact; NaN if all last a frame."""
        speed = [
            self._speed(contact, column)
            for contact, column in zip(self._contacts, self._column, strict=True)
        ]
        every = np.concatenate(speed) if speed else np.empty(0)
        return float(every.mean() * _MM) if len(every) else float("nan")

    def gaps(self) -> list[Gap]:
        """Return the largest gap on solid ground and the 95th percentile on heightfields.

        Only heels and toes stand on ground. A figure that no contact has a part in is left out.
        """
        which, frame = contact_frames(self._contacts)
        column = np.array(self._column, dtype=np.int64)[which]
        gap, on_field = self._gap[frame, column] * _MM, self._on_field[frame, column]
        standing = np.array([stands(contact) for contact in self._contacts], dtype=bool)[which]
        found = []
        for name, group in (
            ("stance_gap_max_mm", standing & ~on_field),
            ("stance_gap_hfield_p95_mm", standing & on_field),
        ):
            if not group.any():
                continue
            k = np.flatnonzero(group)[gap[group].argmax()]
            below = self._ground.name(int(self._under[frame[k], column[k]]))
            where, value = f"{self._contacts[which[k]].site} over {below}", gap[k]
            if name == "stance_gap_hfield_p95_mm":
                where += f": {gap[k]:.2f} mm"
                value = np.percentile(gap[group], _FIELD_SHARE)
            found.append(Gap(name, float(value), Worst(int(frame[k]), where)))
        return found

    def _measure(self, contact: Contact, column: int) -> dict[str, Any]:
        span = slice(contact.start, contact.end)
        place, gap = self._position[span, column], self._gap[span, column]
        drift = np.linalg.norm(place - place.mean(axis=0), axis=1)
        speed = self._speed(contact, column)
        drifted, gapped = int(drift.argmax()), int(gap.argmax())
        widest = contact.start + gapped
        return {
            "site": contact.site,
            "start": contact.start,
            "end": contact.end,
            "drift_mm": float(drift[drifted] * _MM),
            "drift_frame": contact.start + drifted,
            "gap_mm": float(gap[gapped] * _MM),
            "gap_frame": widest,
            "skate_mm_s": float(speed.mean() * _MM) if len(speed) else 0.0,
            "ground": self._ground.name(int(self._under[widest, column])),
            "ground_kind": "hfield" if self._on_field[widest, column] else "solid",
        }

    def _speed(self, contact: Contact, column: int) -> Array:
        """Return the horizontal speed (n - 1,) of a contact of n frames [m/s]."""
        step = np.diff(self._position[contact.start : contact.end, column, :2], axis=0)
        return np.asarray(np.linalg.norm(step, axis=1) * self._fps)
