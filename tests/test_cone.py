"""What cones cannot give, beside SciPy's non-negative least squares and by hand."""

from __future__ import annotations

import numpy as np
from scipy.optimize import nnls

from mjmotion.validation.cone import beyond_cone


def test_what_is_left_is_that_of_nnls() -> None:
    rng = np.random.default_rng(0)
    edges, wanted = rng.normal(size=(60, 40, 6)), rng.normal(size=(60, 6))
    edges[..., 2] = np.abs(edges[..., 2]) + 1.0  # cones that leave half of the space out
    held = rng.random((60, 40)) < 0.3
    left = beyond_cone(edges, wanted, held)
    for row in range(60):
        columns = edges[row][held[row]].T
        share, _ = nnls(columns, wanted[row])
        np.testing.assert_allclose(left[row], wanted[row] - columns @ share, atol=1e-9)
    assert (np.linalg.norm(left, axis=1) > 0.1).any()


def test_edges_that_coincide_and_frames_that_hold_nothing() -> None:
    edges = np.tile(np.array((0.0, 0.0, 1.0)), (3, 4, 1))
    wanted = np.array(((1.0, 0.0, 2.0), (1.0, 0.0, -2.0), (1.0, 0.0, 2.0)))
    held = np.array(((True,) * 4, (True,) * 4, (False,) * 4))
    left = beyond_cone(edges, wanted, held)
    np.testing.assert_allclose(
        left, ((1.0, 0.0, 0.0), (1.0, 0.0, -2.0), (1.0, 0.0, 2.0)), atol=1e-9
    )


def test_an_edge_that_would_have_to_pull_is_dropped() -> None:
    # The first edge is the nearest; with the other two beside it, it is of no use.
    edges = np.array(((1.0, 1.0, 0.9), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)))[None]
    wanted = np.array(((1.0, 1.0, -0.2),))
    left = beyond_cone(edges, wanted, np.ones((1, 3), dtype=bool))
    np.testing.assert_allclose(left, ((0.0, 0.0, -0.2),), atol=1e-9)
