"""Rotations of all frames at once: quaternions ``wxyz``, matrices and rotation vectors.

Arrays have any leading shape; the last axis (or two, for matrices) is the rotation's own.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_TINY = 1e-12
_CONJUGATE = np.array((1.0, -1.0, -1.0, -1.0))
# Axis orders that put the first axis last; numpy.moveaxis takes longer than the sums around it.
_LAST = {ndim: (*range(1, ndim), 0) for ndim in range(1, 7)}
_FIRST = {ndim: (ndim - 1, *range(ndim - 1)) for ndim in range(1, 7)}
FEW = 256  # up to so many numbers a component, calls of NumPy take longer than the sums in them
# Of a quaternion product: which component of b meets x, y and z of a, and with which sign.
_MEETS = np.array(((1, 0, 3, 2), (2, 3, 0, 1), (3, 2, 1, 0)))
_SIGNS = np.array(((-1.0, 1.0, -1.0, 1.0), (-1.0, 1.0, 1.0, -1.0), (-1.0, -1.0, 1.0, 1.0)))


def _join(*parts: Array) -> Array:
    """Put components together, one after the other in memory, as the last axis.

    Whole components in a row make every later step on one of them run over unbroken memory, which
    halves the time of long chains of rotations.
    """
    joined = np.empty((len(parts), *np.shape(parts[0])))
    for index, part in enumerate(parts):
        joined[index] = part
    return joined.transpose(_LAST[joined.ndim])


def _parts(count: int, shape: tuple[int, ...]) -> tuple[Array, list[Array]]:
    """Return room for so many components, one after the other in memory, and views of each.

    Sums are made in place there: fresh memory for every one costs more than adding up.
    """
    joined = np.empty((count, *shape))
    return joined.transpose(_LAST[joined.ndim]), [joined[index, ...] for index in range(count)]


def _leading(vector: Array, ndim: int) -> Array:
    """Return a view with components first, of so many dimensions."""
    if vector.ndim < ndim:
        vector = vector.reshape((1,) * (ndim - vector.ndim) + vector.shape)
    return vector.transpose(_FIRST[ndim])


def _multiply_few(a: Array, b: Array) -> Array:
    """Return the product of few quaternions, to the bit that of :func:`multiply`, sooner."""
    ndim = max(a.ndim, b.ndim)
    a, b = _leading(a, ndim), _leading(b, ndim)
    meets = b[_MEETS]
    meets *= _SIGNS.reshape(3, 4, *(1,) * (ndim - 1))
    product = a[0] * b
    terms = a[1:, None] * meets
    for term in terms:
        product += term
    return product.transpose(_LAST[ndim])


def _rotate_few(quat: Array, vector: Array) -> Array:
    """Return few vectors turned, to the bit those of :func:`rotate`, sooner.

    With its first two components again after the last, a cross product is of slices.
    """
    ndim = max(quat.ndim, vector.ndim)
    quat, vector = _leading(quat, ndim), _leading(vector, ndim)
    axis, given = np.empty((5, *quat.shape[1:])), np.empty((5, *vector.shape[1:]))
    axis[:3], axis[3:] = quat[1:], quat[1:3]
    given[:3], given[3:] = vector, vector[:2]
    twice = axis[1:4] * given[2:5]
    twice -= axis[2:5] * given[1:4]
    twice *= 2.0
    again = np.empty((5, *twice.shape[1:]))
    again[:3], again[3:] = twice, twice[:2]
    turned = quat[0] * twice
    turned += given[:3]
    more = axis[1:4] * again[2:5]
    more -= axis[2:5] * again[1:4]
    turned += more
    return turned.transpose(_LAST[ndim])


def cross(a: Array, b: Array) -> Array:
    """Return a × b; a third of the time of ``numpy.cross`` on the small arrays used here."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    first = ay * bz
    product, (x, y, z) = _parts(3, first.shape)
    np.subtract(first, az * by, out=x)
    np.multiply(az, bx, out=y)
    y -= ax * bz
    np.multiply(ax, by, out=z)
    z -= ay * bx
    return product


def dot(a: Array, b: Array) -> Array:
    """Return the inner product over the last axis."""
    return np.asarray(np.einsum("...i,...i->...", a, b))


def norm(vector: Array) -> Array:
    """Return lengths over the last axis."""
    return np.sqrt(dot(vector, vector))


def conjugate(quat: Array) -> Array:
    """Return the inverse of unit quaternions."""
    return quat * _CONJUGATE


def multiply(a: Array, b: Array) -> Array:
    """Return the quaternion product a b: first b, then a."""
    if a.size <= 4 * FEW and b.size <= 4 * FEW:
        return _multiply_few(a, b)
    aw, ax, ay, az = a[..., 0], a[..., 1], a[..., 2], a[..., 3]
    bw, bx, by, bz = b[..., 0], b[..., 1], b[..., 2], b[..., 3]
    first = aw * bw
    product, (w, x, y, z) = _parts(4, first.shape)
    np.subtract(first, ax * bx, out=w)
    w -= ay * by
    w -= az * bz
    np.multiply(aw, bx, out=x)
    x += ax * bw
    x += ay * bz
    x -= az * by
    np.multiply(aw, by, out=y)
    y -= ax * bz
    y += ay * bw
    y += az * bx
    np.multiply(aw, bz, out=z)
    z += ax * by
    z -= ay * bx
    z += az * bw
    return product


def rotate(quat: Array, vector: Array) -> Array:
    """Return vectors turned by unit quaternions."""
    if quat.size <= 4 * FEW and vector.size <= 3 * FEW:
        return _rotate_few(quat, vector)
    w, x, y, z = quat[..., 0], quat[..., 1], quat[..., 2], quat[..., 3]
    a, b, c = vector[..., 0], vector[..., 1], vector[..., 2]
    i = y * c
    i -= z * b
    i *= 2.0
    j = z * a
    j -= x * c
    j *= 2.0
    k = x * b
    k -= y * a
    k *= 2.0
    turned, (first, second, third) = _parts(3, i.shape)
    np.multiply(w, i, out=first)
    first += a
    more = y * k
    more -= z * j
    first += more
    np.multiply(w, j, out=second)
    second += b
    more = z * i
    more -= x * k
    second += more
    np.multiply(w, k, out=third)
    third += c
    more = x * j
    more -= y * i
    third += more
    return turned


def exp(vector: Array) -> Array:
    """Return the quaternions that turn by ``|vector|`` [rad] about ``vector``."""
    angle = norm(vector)
    half = 0.5 * angle
    scale = np.where(angle > 1e-8, np.sin(half) / np.maximum(angle, _TINY), 0.5)
    return _join(np.cos(half), *(vector[..., axis] * scale for axis in range(3)))


def log(quat: Array) -> Array:
    """Return rotation vectors [rad], no longer than π, of unit quaternions."""
    sine = np.sqrt(dot(quat[..., 1:], quat[..., 1:]))
    sign = np.where(quat[..., 0] < 0.0, -1.0, 1.0)
    angle = 2.0 * np.arctan2(sine, np.abs(quat[..., 0]))
    scale = sign * np.where(sine > 1e-10, angle / np.maximum(sine, _TINY), 2.0)
    return quat[..., 1:] * scale[..., None]


def between(a: Array, b: Array) -> Array:
    """Return the least quaternions that turn unit vectors ``a`` onto unit vectors ``b``.

    Opposite vectors are turned about an axis square to ``a``.
    """
    real = 1.0 + dot(a, b)
    axis = cross(a, b)
    opposite = real < 1e-9
    if np.any(opposite):
        pick = np.where(np.abs(a[..., :1]) < 0.9, (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
        axis = np.where(opposite[..., None], cross(a, pick), axis)
        real = np.where(opposite, 0.0, real)
    return normalized(_join(real, axis[..., 0], axis[..., 1], axis[..., 2]))


def normalized(vector: Array) -> Array:
    """Return vectors (or quaternions) scaled to length 1; zero stays zero."""
    norm = np.sqrt(dot(vector, vector))
    return vector / np.maximum(norm, _TINY)[..., None]


def to_matrix(quat: Array) -> Array:
    """Return rotation matrices (..., 3, 3)."""
    w, x, y, z = quat[..., 0], quat[..., 1], quat[..., 2], quat[..., 3]
    xx, yy, zz = x * x, y * y, z * z
    xy, xz, yz, wx, wy, wz = x * y, x * z, y * z, w * x, w * y, w * z
    rows = (
        (1 - 2 * (yy + zz), 2 * (xy - wz), 2 * (xz + wy)),
        (2 * (xy + wz), 1 - 2 * (xx + zz), 2 * (yz - wx)),
        (2 * (xz - wy), 2 * (yz + wx), 1 - 2 * (xx + yy)),
    )
    matrix = np.empty((*w.shape, 3, 3))
    for i, row in enumerate(rows):
        for j, entry in enumerate(row):
            matrix[..., i, j] = entry
    return matrix


def from_matrix(matrix: Array) -> Array:
    """Return unit quaternions of rotation matrices (..., 3, 3), with w ≥ 0."""
    m = matrix
    trace = m[..., 0, 0] + m[..., 1, 1] + m[..., 2, 2]
    # Four ways to write the same quaternion; the one with the largest leading term is exact.
    squares = np.stack(
        (
            1 + trace,
            1 + 2 * m[..., 0, 0] - trace,
            1 + 2 * m[..., 1, 1] - trace,
            1 + 2 * m[..., 2, 2] - trace,
        ),
        axis=-1,
    )
    a = m[..., 2, 1] - m[..., 1, 2]
    b = m[..., 0, 2] - m[..., 2, 0]
    c = m[..., 1, 0] - m[..., 0, 1]
    d = m[..., 0, 1] + m[..., 1, 0]
    e = m[..., 0, 2] + m[..., 2, 0]
    f = m[..., 1, 2] + m[..., 2, 1]
    candidates = np.stack(
        (
            np.stack((squares[..., 0], a, b, c), axis=-1),
            np.stack((a, squares[..., 1], d, e), axis=-1),
            np.stack((b, d, squares[..., 2], f), axis=-1),
            np.stack((c, e, f, squares[..., 3]), axis=-1),
        ),
        axis=-2,
    )
    best = np.argmax(squares, axis=-1)
    quat = np.take_along_axis(candidates, best[..., None, None], axis=-2)[..., 0, :]
    quat = normalized(quat)
    return np.where(quat[..., :1] < 0.0, -quat, quat)


def yaw_quat(yaw: Array) -> Array:
    """Return quaternions that turn by ``yaw`` [rad] about the vertical."""
    half = 0.5 * np.asarray(yaw, dtype=np.float64)
    zero = np.zeros_like(half)
    return np.stack((np.cos(half), zero, zero, np.sin(half)), axis=-1)


def continuous(quat: Array) -> Array:
    """Return the same rotations (nframe, ..., 4) with signs chosen so that no frame flips."""
    sign = np.ones(quat.shape[:-1])
    sign[1:] = np.cumprod(np.where(dot(quat[1:], quat[:-1]) < 0.0, -1.0, 1.0), axis=0)
    return quat * sign[..., None]
