"""Who stands where and when: contacts, found in a motion or read from a file."""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass(frozen=True)
class Contact:
    """One site standing on something from frame ``start`` up to, not including, frame ``end``."""

    site: str
    start: int
    end: int
