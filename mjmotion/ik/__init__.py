"""Inverse kinematics: the numeric and the hybrid solver of §5 behind one protocol."""

from __future__ import annotations

from mjmotion.ik.count import parameters

__all__ = ["parameters"]
