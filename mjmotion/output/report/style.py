"""How all plots of the project look: thin axes on two sides, a faint grid, one ink."""

from __future__ import annotations

from typing import Any


def axes_style(ink: str) -> dict[str, Any]:
    """Return matplotlib settings of axes and text drawn in ``ink``."""
    return {
        "font.size": 10.5,
        "axes.edgecolor": ink,
        "axes.labelcolor": ink,
        "axes.linewidth": 0.6,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "axes.axisbelow": True,
        "grid.color": "#8a8f98",
        "grid.alpha": 0.25,
        "grid.linewidth": 0.6,
        "xtick.color": ink,
        "ytick.color": ink,
        "text.color": ink,
        "legend.frameon": False,
        "text.parse_math": False,  # a name such as "a$b$" is a name
    }
