"""A cable tray over a part of a section's arc, and the errors of the radii by each method."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from analysis.methods import ELLIPSE_METHODS, fit_ellipse
from analysis.result import ignore_convergence_warnings
from analysis.surfaces.ellipse import polar
from analysis.tunnel.outlines import ANGLES

SECTION = np.array([0.0, 0.0, 2.700, 0.011, 0.0])  # u0, v0, (a + b)/2, (a − b)/2 level, m
POINTS = 5400  # of a section at the density of the scans
NOISE = 0.003  # m per coordinate
AT = np.deg2rad(80.0)  # middle of the tray
SEEN = np.deg2rad(135.0)  # to both sides of the crown


def tray_study(
    shares: Sequence[float] = (0.0, 0.05, 0.1, 0.2),
    *,
    inside: float = 0.13,
    trials: int = 20,
    n: int = POINTS,
    seed: int = 0,
) -> pd.DataFrame:
    """Errors of the radii ρ(α), |α| ≤ 135°, of a section that a tray covers in part.

    Parameters
    ----------
    shares : of the visible arc behind the tray.
    inside : distance of the tray from the lining, m.
    trials, n : sections, and points of each.

    Returns
    -------
    DataFrame, a row per share and method: ``share_percent``, ``method``, ``label``; ``largest_mm``,
    the largest error over the directions, mean of the trials; ``worst_mm``, the largest of all.

    Example
    -------
    >>> study = tray_study([0.05], trials=2, n=1000).set_index("method")["largest_mm"]
    >>> bool(study["robust"] < 0.5), bool(study["geometric"] > 10)
    (True, True)
    """
    truth = polar(SECTION, ANGLES, np.zeros(2))[0]
    rows = []
    for share in shares:
        generator = np.random.default_rng(seed)
        angles = generator.uniform(-SEEN, SEEN, (trials, n))
        noise = NOISE * generator.standard_normal((trials, n, 2))
        covered = np.abs(angles - AT) < share * SEEN
        radii = np.stack([polar(SECTION, row, np.zeros(2))[0] for row in angles]) - inside * covered
        points = radii[..., None] * np.stack([np.sin(angles), np.cos(angles)], axis=-1) + noise
        for method, entry in ELLIPSE_METHODS.items():
            with ignore_convergence_warnings():
                # a fit that has not converged counts with its error
                fit = fit_ellipse(points, method)
            errors = 1e3 * np.abs(fit.polar(ANGLES, np.zeros(2))[0] - truth).max(axis=-1)
            row = {"share_percent": 100.0 * share, "method": method, "label": entry.label}
            rows.append(row | {"largest_mm": errors.mean(), "worst_mm": errors.max()})
    return pd.DataFrame(rows)
