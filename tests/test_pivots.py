"""A foot that turns while it stands: what it stands on alone is not dragged along."""

from __future__ import annotations

import numpy as np

from mjmotion.footsteps.pivots import find_pivot

TURN = 0.5  # of the foot, between two flat stays [rad]


def test_a_heel_that_lands_is_not_dragged_by_a_turn_about_the_ball() -> None:
    """On its heel, flat, on its ball while it turns, flat, on its heel again."""
    heel, toe = np.ones(100, dtype=bool), np.ones(100, dtype=bool)
    toe[:10] = toe[90:] = False
    heel[40:60] = False
    yaw = np.interp(np.arange(100), [0, 10, 40, 60, 90, 99], [0.2, 0.0, 0.0, TURN, TURN, 0.7])
    pivot = find_pivot(yaw, heel, toe)
    assert pivot is not None and pivot.on_toe
    np.testing.assert_allclose(pivot.turn[:41], 0.0, atol=1e-12)
    np.testing.assert_allclose(pivot.turn[60:], TURN, atol=1e-12)
    assert (np.diff(pivot.turn[40:61]) > 0.0).all()


def test_a_foot_that_stays_as_it_stands_is_no_pivot() -> None:
    stands = np.ones(50, dtype=bool)
    assert find_pivot(np.full(50, 0.3), stands, stands) is None
