"""Cubic splines through all of some points: as smooth at the second and the last but one as can be.

spline = CubicSpline(x, values)
spline(at), integral(x, values)
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


class CubicSpline:
    """The spline whose third derivative does not jump at the second and the last but one point.

    That of SciPy to the bit; importing ``scipy.interpolate`` takes longer than making a walk.

    Args:
      x: (n,) places, rising; four or more.
      values: (n, ...) values there.
    """

    def __init__(self, x: ArrayLike, values: ArrayLike) -> None:
        from scipy.linalg.lapack import dgtsv

        self.x = np.asarray(x, dtype=np.float64)
        given = np.asarray(values, dtype=np.float64)
        count, self._shape = len(self.x), given.shape[1:]
        if count < 4:
            raise ValueError(f"a cubic spline needs four points, not {count}")
        y = given.reshape(count, -1)
        step = np.diff(self.x)
        width = step[:, None]
        slope = np.diff(y, axis=0) / width
        middle = np.empty(count)
        middle[1:-1] = 2 * (step[:-1] + step[1:])
        upper = np.concatenate(([self.x[2] - self.x[0]], step[:-1]))
        lower = np.concatenate((step[1:], [self.x[-1] - self.x[-3]]))
        right = np.empty_like(y)
        right[1:-1] = 3 * (width[1:] * slope[:-1] + width[:-1] * slope[1:])
        middle[0], middle[-1] = step[1], step[-2]
        first, last = upper[0], lower[-1]
        right[0] = ((step[0] + 2 * first) * step[1] * slope[0] + step[0] ** 2 * slope[1]) / first
        right[-1] = (
            step[-1] ** 2 * slope[-2] + (2 * last + step[-1]) * step[-2] * slope[-1]
        ) / last
        *_, rate, info = dgtsv(lower, middle, upper, right)
        if info != 0:
            raise ValueError("the places of a cubic spline must rise")
        bend = (rate[:-1] + rate[1:] - 2 * slope) / width
        # Of each piece, from its constant on.
        self._parts = (y[:-1], rate[:-1], (slope - rate[:-1]) / width - bend, bend / width)

    def __call__(self, at: ArrayLike) -> Array:
        """Return values (m, ...) at places (m,)."""
        place = np.asarray(at, dtype=np.float64)
        piece = np.clip(np.searchsorted(self.x, place, side="right") - 1, 0, len(self.x) - 2)
        ahead = (place - self.x[piece])[:, None]
        found, power = np.zeros((len(place), 1)), np.ones_like(ahead)
        for part in self._parts:
            found = found + part[piece] * power
            power = power * ahead
        return np.asarray(found.reshape(len(place), *self._shape))

    def integral(self) -> Array:
        """Return the integral from the first place to each (n, ...)."""
        step = np.diff(self.x)[:, None]
        terms, power = [], np.ones_like(step)
        for number, part in enumerate(self._parts, 1):
            power = power * step
            terms.append(part / number * power)
        total = np.zeros((len(self.x), terms[0].shape[1]))
        for row, parts in enumerate(zip(*terms, strict=True)):  # in the order of their size
            one = total[row]
            for part in parts:
                one = one + part
            total[row + 1] = one
        return total.reshape(len(self.x), *self._shape)
