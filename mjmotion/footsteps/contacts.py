"""Who stands where and when: contacts, found in a motion or read from a file.

    contacts = detect_contacts(motion)
    save_contacts("contacts.json", contacts)
    contacts = load_contacts("contacts.json", model, motion.nframe)

A site is in contact from when it is low and slow until it is high or fast. Heights are measured
from the ground that the clip itself shows, and both heights and speeds are in metres and metres a
second, so a clip gives the same contacts at 30 and at 120 frames a second.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterable, Sequence
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmotion.body.kinematics import Kinematics, root_body, site_id
from mjmotion.body.motion import Motion
from mjmotion.boundary.limits import MOST_FRAMES, shown, whole_number
from mjmotion.boundary.structured import read_json
from mjmotion.boundary.whole import write_whole
from mjmotion.exceptions import ContactError, MotionError, wrong_type
from mjmotion.footsteps.raised import not_raised
from mjmotion.footsteps.runs import hysteresis, merged, resting

Array = NDArray[np.float64]

_FLOOR_POINTS = 20  # places of standing sites that tell a floor at least
_FLOOR_STEP = 0.1  # how far apart a foot must have stood at least [m]
_FLOOR_SPREAD = 0.015  # how far they must spread either way [m]
_FLOOR_TILTED = 3.0  # how much nearer to a tilted plane than to a level one they must be
_SUFFIXES = ("_heel", "_toe")
_FLOOR_SHARE = 10.0  # percentile of the heights of what is lowest that is on a clip's floor
RESTS = ("_knee", "_palm", "seat")  # what else can rest on the ground


@dataclasses.dataclass(frozen=True)
class Contact:
    """One site standing on something from frame ``start`` up to, not including, frame ``end``.

    Heels, toes, knees, palms and a seat stand on ground; any other site, such as a hand, holds on
    to what is there.
    """

    site: str
    start: int
    end: int

    @property
    def stands(self) -> bool:
        """Whether it is a heel's, a toe's, a knee's, a palm's or a seat's: they stand on ground."""
        return self.site.endswith(_SUFFIXES + RESTS)

    @property
    def rests(self) -> bool:
        """Whether it is one of those and none of a foot's."""
        return self.site.endswith(RESTS)


@dataclasses.dataclass(frozen=True)
class ContactSettings:
    """When a site counts as standing.

    Attributes:
      low, high: height over the ground below which a contact can begin, above which it ends [m].
      slow, fast: speed below which a contact can begin, and above which it ends [m/s].
      rise: a contact is cut where the site is this much over where it mostly rests [m].
      shortest: contacts shorter than this are dropped [s].
      gap: two contacts of a site closer than this are one [s].
      smoothing: positions are averaged over this time before speeds are taken [s].
      window: the ground is the lowest support within this time on either side [s].
      still: slower than this, all sites of a foot stand as the floor lies [m/s].
      tilt: how much higher than its lowest site a site of a foot may stand on a tilted floor [m].
      rest_low, rest_high: height over the floor below which a knee, a palm or a seat can begin to
        rest, above which it rests no more [m].
      rest_slow, rest_fast: the same of its speed [m/s].
      rest_shortest: what rests for a shorter time is dropped [s].
    """

    low: float = 0.02
    high: float = 0.035
    slow: float = 0.3
    fast: float = 0.5
    rise: float = 0.008
    shortest: float = 0.07
    gap: float = 0.05
    smoothing: float = 1.0 / 30.0
    window: float = 0.6
    still: float = 0.1
    tilt: float = 0.04
    rest_low: float = 0.06
    rest_high: float = 0.09
    rest_slow: float = 0.15
    rest_fast: float = 0.3
    rest_shortest: float = 0.15


def contact_sites(model: mujoco.MjModel) -> list[str]:
    """Return the character's sites that can stand: those named ``*_heel`` and ``*_toe``."""
    mine = model.body_rootid[model.site_bodyid] == root_body(model)
    names = [model.site(int(i)).name for i in np.flatnonzero(mine)]
    return [name for name in names if name.endswith(_SUFFIXES)]


def detect_contacts(
    motion: Motion,
    sites: Sequence[str] | None = None,
    settings: ContactSettings | None = None,
) -> tuple[Contact, ...]:
    """Find contacts from heights and speeds, with hysteresis.

    Args:
      motion: any motion; its ground need not be flat nor at zero.
      sites: sites that can stand; :func:`contact_sites` without, and then knees, palms and a seat
        that rest on the clip's lowest floor too. A foot whose knee rests does not stand.
      settings: thresholds.

    Returns:
      Contacts in order of their start.

    Raises:
      ContactError: the model has no such sites.
      ModelError: an unknown site.
    """
    chosen = contact_sites(motion.model) if sites is None else list(sites)
    if not chosen:
        raise ContactError("the model has no sites named *_heel or *_toe: name the contact sites")
    settings = ContactSettings() if settings is None else settings
    ids = [site_id(motion.model, name) for name in chosen]
    pose = Kinematics(motion.model, motion.nframe).forward(motion.qpos)
    position = _moving_average(pose.site_xpos[:, ids], settings.smoothing * motion.fps)
    speed = _speed(position, motion.fps)
    bodies = motion.model.site_bodyid[ids]
    position = position - [0.0, 0.0, 1.0] * _floor(position, speed, bodies, settings)[..., None]
    grounds = {
        body: _ground(
            position[:, bodies == body, 2], speed[:, bodies == body], settings, motion.fps
        )
        for body in np.unique(bodies)
    }
    found = []
    for column, name in enumerate(chosen):
        foot = bodies == bodies[column]
        ground = grounds[bodies[column]]
        ground = ground + _tilt(
            position[:, column, 2] - ground, speed[:, foot], settings, motion.fps
        )
        height = position[:, column, 2] - ground
        pace = speed[:, column]
        begin = (height < settings.low) & (pace < settings.slow)
        stay = (height < settings.high) & (pace < settings.fast)
        runs = merged(hysteresis(begin, stay), settings.gap * motion.fps)
        for start, end in (resting(height, run, settings.rise) for run in runs):
            whole = start == 0 or end == motion.nframe
            if end - start >= settings.shortest * motion.fps or (whole and end - start > 1):
                found.append(Contact(name, start, end))
    lowest = {body: position[:, bodies == body, 2].min(axis=1) for body in np.unique(bodies)}
    owner = dict(zip(chosen, bodies.tolist(), strict=True))
    spans = [(owner[one.site], one.start, one.end) for one in found]
    stands = not_raised(spans, lowest, motion.fps)
    found = [one for one, stood in zip(found, stands, strict=True) if stood]
    if sites is None:
        found = _with_rests(found, motion, pose.site_xpos, ids, settings)
    return tuple(sorted(found, key=lambda contact: (contact.start, contact.site)))


def _with_rests(
    found: list[Contact],
    motion: Motion,
    place: Array,
    soles: Sequence[int],
    settings: ContactSettings,
) -> list[Contact]:
    """Return contacts with those of knees, palms and a seat, without feet whose knee rests."""
    model, fps = motion.model, motion.fps
    mine = np.flatnonzero(model.body_rootid[model.site_bodyid] == root_body(model))
    ids = [int(site) for site in mine if model.site(int(site)).name.endswith(RESTS)]
    # What is lowest is on the floor in most frames.
    floor = float(np.percentile(place[:, [*ids, *soles], 2].min(axis=1), _FLOOR_SHARE))
    ids = [site for site in ids if place[:, site, 2].min() - floor < settings.rest_low]
    if not ids:
        return found
    position = _moving_average(place[:, ids], settings.smoothing * fps)
    height, pace = position[..., 2] - floor, _speed(position, fps)
    begin = (height < settings.rest_low) & (pace < settings.rest_slow)
    stay = (height < settings.rest_high) & (pace < settings.rest_fast)
    rests = [
        Contact(model.site(site).name, start, end)
        for column, site in enumerate(ids)
        for start, end in merged(hysteresis(begin[:, column], stay[:, column]), settings.gap * fps)
        if end - start >= settings.rest_shortest * fps
    ]
    for side in {one.site.removesuffix("_knee") for one in rests if one.site.endswith("_knee")}:
        kneels = contact_mask(rests, f"{side}_knee", motion.nframe)
        for name in (f"{side}{suffix}" for suffix in _SUFFIXES):
            left = contact_mask(found, name, motion.nframe) & ~kneels
            runs = hysteresis(left, left)
            found = [one for one in found if one.site != name]
            found += [Contact(name, *run) for run in runs if np.ptp(run) >= settings.shortest * fps]
    return found + rests


def _moving_average(values: Array, width: float) -> Array:
    """Average over ``width`` frames, both ends held; an odd number of frames, at least one."""
    half = round(width) // 2
    if half == 0:
        return values
    padded = np.concatenate(
        (np.repeat(values[:1], half, axis=0), values, np.repeat(values[-1:], half, axis=0))
    )
    total = np.cumsum(np.concatenate((np.zeros_like(values[:1]), padded)), axis=0)
    return (total[2 * half + 1 :] - total[: -2 * half - 1]) / (2 * half + 1)


def _speed(position: Array, fps: float) -> Array:
    if len(position) == 1:
        return np.zeros(position.shape[:-1])
    return np.linalg.norm(np.gradient(position, axis=0), axis=-1) * fps


def _ground(height: Array, speed: Array, settings: ContactSettings, fps: float) -> Array:
    """Ground height under one foot at each frame [m]: its lowest slow site within the window.

    A foot that rests is on the ground, and each foot may have its own, as on stairs; where it does
    not rest (a jump, a long swing) the height goes on from one rest to the next.
    """
    from scipy.ndimage import minimum_filter1d, uniform_filter1d

    resting = np.where(speed < settings.fast, height, np.inf).min(axis=1)
    size = 2 * round(settings.window * fps) + 1
    lowest = minimum_filter1d(resting, size, mode="nearest")
    known = np.flatnonzero(np.isfinite(lowest))
    if len(known) == 0:
        return np.full(len(height), height.min())
    filled = np.interp(np.arange(len(height)), known, lowest[known])
    return np.asarray(uniform_filter1d(filled, max(1, size // 2), mode="nearest"))


def _floor(
    position: Array, speed: Array, bodies: NDArray[np.int32], settings: ContactSettings
) -> Array:
    """Return the height of a floor that is one tilted plane, under sites (nframe, k) [m].

    Zero unless the places where whole feet stand still are all but on such a plane, and not on a
    level one.
    """
    still, stepped = np.zeros(speed.shape, dtype=bool), 0.0
    for body in np.unique(bodies):
        mine = bodies == body
        still[:, mine] = (speed[:, mine] < settings.still).all(axis=1, keepdims=True)
        if (rests := still[:, mine][:, 0]).any():
            stepped = max(stepped, float(np.ptp(position[rests][:, mine, :2], axis=0).max()))
    flat = np.zeros(speed.shape)
    points = position[still]
    # Two places alone are always on some plane, also where one foot is only raised.
    if len(points) < _FLOOR_POINTS or stepped < _FLOOR_STEP:
        return flat
    centre = points.mean(axis=0)
    away = points - centre
    if np.linalg.svd(away[:, :2], compute_uv=False)[-1] < _FLOOR_SPREAD * np.sqrt(len(points)):
        return flat
    slope = np.linalg.lstsq(away[:, :2], away[:, 2], rcond=None)[0]
    off = float(np.sqrt(np.mean((away[:, 2] - away[:, :2] @ slope) ** 2)))
    level = float(np.sqrt(np.mean(away[:, 2] ** 2)))
    if off > settings.rise or level < _FLOOR_TILTED * off or level < settings.rise:
        return flat
    return np.asarray((position[..., :2] - centre[:2]) @ slope)


def _tilt(height: Array, speed: Array, settings: ContactSettings, fps: float) -> Array:
    """How much higher a site stands than its foot's lowest does (nframe,) [m], on a tilted floor.

    Told where the whole foot stands still, within the window; elsewhere nothing is.

    Args:
      height: (nframe,) of the site, over its foot's ground [m].
      speed: (nframe, k) of all the foot's sites [m/s].
      settings: thresholds.
      fps: frames a second.
    """
    from scipy.ndimage import minimum_filter1d, uniform_filter1d

    still = (speed < settings.still).all(axis=1) & (height < settings.tilt)
    size = 2 * round(settings.window * fps) + 1
    lowest = minimum_filter1d(np.where(still, height, np.inf), size, mode="nearest")
    known = np.clip(np.where(np.isfinite(lowest), lowest, 0.0), 0.0, settings.tilt)
    return np.asarray(uniform_filter1d(known, max(1, size // 4), mode="nearest"))


def check_contacts(
    contacts: Iterable[Contact], model: mujoco.MjModel, nframe: int
) -> tuple[Contact, ...]:
    """Return the contacts, in order, if the model and the motion have all that they name.

    Raises:
      ContactError: an unknown site, an empty span, a frame the motion does not have, or two
        contacts of a site that overlap.
    """
    wanted = "a list of contacts (load_contacts reads a file)"
    if not isinstance(contacts, Iterable) or isinstance(contacts, str):
        raise ContactError(wrong_type("contacts", contacts, wanted))
    contacts = tuple(contacts)
    for contact in contacts:
        if not isinstance(contact, Contact):
            raise ContactError(wrong_type("a contact", contact, "a Contact"))
    ordered = tuple(sorted(contacts, key=lambda contact: (contact.start, contact.site)))
    last: dict[str, Contact] = {}
    for contact in ordered:
        site_id(model, contact.site)
        if contact.start < 0:
            raise ContactError(
                f"contact of '{contact.site}' starts at frame {contact.start}: frames count from 0"
            )
        if not contact.start < contact.end:
            raise ContactError(
                f"contact of '{contact.site}' starts at frame {contact.start} and ends before frame"
                f" {contact.end}: it holds no frame"
            )
        if contact.end > nframe:
            raise ContactError(
                f"contact of '{contact.site}' ends at frame {contact.end}, but the motion has"
                f" {nframe} frames: shorten it or use the clip it was made for",
                range(nframe, min(contact.end, nframe + MOST_FRAMES)),
            )
        before = last.get(contact.site)
        if before is not None and contact.start < before.end:
            raise ContactError(
                f"two contacts of '{contact.site}' overlap at frame {contact.start}: join them"
            )
        last[contact.site] = contact
    return ordered


def load_contacts(path: str | Path, model: mujoco.MjModel, nframe: int) -> tuple[Contact, ...]:
    """Read a contacts file: a JSON list of ``{"site": …, "start": …, "end": …}``.

    Raises:
      ContactError: the file is missing or malformed, or does not fit the motion.
    """
    path = Path(path)
    entries = read_json(path, "contacts file", ContactError)
    if not isinstance(entries, list):
        raise ContactError(f"contacts file '{path}' must hold a list of contacts")
    contacts = []
    for number, entry in enumerate(entries):
        if not isinstance(entry, dict) or set(entry) != {"site", "start", "end"}:
            raise ContactError(f"'{path}', entry {number}: it must have just site, start and end")
        where = f"'{path}', entry {number}"
        if not isinstance(entry["site"], str):
            raise ContactError(f"{where}: site is {shown(entry['site'])}: it must be a name")
        for key in ("start", "end"):
            if type(entry[key]) is not int:
                said = shown(entry[key])
                raise ContactError(f"{where}: start and end must be whole frames, not {said}")
            whole_number(entry[key], f"{where}: {key}", ContactError)
        contacts.append(Contact(entry["site"], entry["start"], entry["end"]))
    try:
        return check_contacts(contacts, model, nframe)
    except MotionError as error:
        raise ContactError(f"contacts file '{path}': {error}", error.frames) from error


def save_contacts(path: str | Path, contacts: Iterable[Contact]) -> None:
    """Write a contacts file."""
    rows = [json.dumps(dataclasses.asdict(contact)) for contact in contacts]
    write_whole(path, "[\n  " + ",\n  ".join(rows) + "\n]\n" if rows else "[]\n")


def contact_mask(contacts: Iterable[Contact], site: str, nframe: int) -> NDArray[np.bool_]:
    """Return (nframe,) when ``site`` is in contact."""
    mask = np.zeros(nframe, dtype=bool)
    for contact in contacts:
        if contact.site == site:
            mask[contact.start : contact.end] = True
    return mask
