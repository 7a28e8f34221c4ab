"""Checks of the coordinates: points at one place, and grids coarser than the noise."""

from __future__ import annotations

import numpy as np

from .check import Check, at_most
from .examined import Examined

DUPLICATES = 0.01  # of the points
ON_GRID = 1e-2  # of a step, by which differences may miss a multiple of it
GRID_POINTS = 300


def coordinate_checks(e: Examined) -> list[Check]:
    """Those of the coordinates."""
    return [duplicates(e), grid(e)]


def duplicates(e: Examined) -> Check:
    """Share of points that lie where another one does."""
    rows = e.points[np.lexsort(e.points.T)]
    again = np.flatnonzero(np.all(rows[1:] == rows[:-1], axis=1))
    share = len(again) / len(rows)
    where = " ".join(f"{value:.4f}" for value in rows[again[len(again) // 2]]) if len(again) else ""
    return at_most(
        "duplicates",
        share,
        DUPLICATES,
        "The points lie at different places.",
        f"{100 * share:.0f} % of the points lie where another one does, some at {where}: the "
        "standard deviations are too small; leave out rows that stand for missing returns or "
        "come twice.",
    )


def grid(e: Examined) -> Check:
    """Smallest step of the coordinates over σ, where all their differences are multiples of it."""
    step = 0.0
    if e.sigma:
        for coordinates in e.points[:GRID_POINTS].T:
            differences = np.diff(np.unique(coordinates))
            if len(differences) >= 3:
                smallest = differences.min()
                multiples = differences / smallest
                if np.abs(multiples - np.round(multiples)).max() <= ON_GRID:
                    step = max(step, smallest)
    sigma = e.sigma * e.length[0]
    return at_most(
        "grid",
        step / sigma if e.sigma else 0.0,
        1.0,
        "No grid of the coordinates is coarser than the noise.",
        f"The coordinates lie on a grid of {1e3 * step:.3g} mm, coarser than the noise of "
        f"{1e3 * sigma:.3g} mm: export them with more digits, or reduced to a near origin.",
    )
