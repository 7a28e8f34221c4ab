"""Deformation that the ellipses of two epochs hide: it stands in the residuals they leave."""

from __future__ import annotations

import numpy as np
import pandas as pd

from analysis.checks import point_array
from analysis.surfaces.ellipse import EllipseFit
from analysis.tunnel.outlines import ANGLES

TWO_SIDED = 1.96  # standard deviations to either side that hold 95 % at the normal law
HALF_WIDTH = np.deg2rad(2.0)  # of a cell
FEWEST = 5  # points of a cell


def residual_profile(points, fit: EllipseFit, pole, *, angles=ANGLES) -> pd.DataFrame:
    """Residuals of one section from its ellipse: median signed distance by direction.

    points : (n, 2) m, those of the fit; pole : (2,) m; angles : (K,) rad, middles of the cells

    All points count, also those that a robust fit has thrown out: a dent is among them. Columns
    `angle_deg`, `points`, `residual_mm` (positive outside) and `standard_deviation_mm`, from the
    interval of ordered residuals that holds the true median with 95 %: it is large where a cell
    holds two things, such as lining and tray. Cells of ±2° are wider than the step and share
    points; one with fewer than 5 is a gap (NaN).
    """
    points = point_array(points, 2, 1, "a profile")
    if points.ndim != 2 or fit.distances.shape != points.shape[:1]:
        raise ValueError(
            f"points: expected those of the fit, of shape {fit.distances.shape + (2,)}, got "
            f"{points.shape}"
        )
    u, v = (points - pole).T
    alpha = np.arctan2(u, v)
    order = np.argsort(alpha)
    around = np.concatenate([alpha[order] - 2 * np.pi, alpha[order], alpha[order] + 2 * np.pi])
    distances = np.tile(fit.distances[order], 3)
    first = np.searchsorted(around, angles - HALF_WIDTH)
    last = np.searchsorted(around, angles + HALF_WIDTH, side="right")
    medians = [_median(distances[start:stop]) for start, stop in zip(first, last, strict=True)]
    middle, deviation = 1000 * np.transpose(medians)
    return pd.DataFrame(
        {
            "angle_deg": np.rad2deg(angles),
            "points": last - first,
            "residual_mm": middle,
            "standard_deviation_mm": deviation,
        }
    )


def _median(values: np.ndarray) -> tuple[float, float]:
    """Median and its standard deviation; NaN for a gap.

    How many of n values lie below the true one is binomial, with n/2 ± √n/2.
    """
    ordered, count = np.sort(values), len(values)
    if count < FEWEST:
        return np.nan, np.nan
    half = 0.5 * TWO_SIDED * np.sqrt(count)
    low = max(0, int(np.floor(0.5 * (count - 1) - half)))
    high = min(count - 1, int(np.ceil(0.5 * (count - 1) + half)))
    return float(np.median(ordered)), float(ordered[high] - ordered[low]) / (2 * TWO_SIDED)


def hidden_deformation(first: pd.DataFrame, second: pd.DataFrame) -> pd.DataFrame:
    """Change of the residual profiles between the epochs.

    first, second : of :func:`residual_profile` for the same directions. What stands in both epochs,
        such as a cable tray or a joint, drops out.

    Columns `angle_deg`, `hidden_mm`, `standard_deviation_mm`; NaN in a gap of either epoch.
    """
    if not np.array_equal(first["angle_deg"], second["angle_deg"]):
        raise ValueError(
            "second: expected a profile for the directions of the first, got other ones"
        )
    return pd.DataFrame(
        {
            "angle_deg": first["angle_deg"],
            "hidden_mm": second["residual_mm"] - first["residual_mm"],
            "standard_deviation_mm": np.hypot(
                first["standard_deviation_mm"], second["standard_deviation_mm"]
            ),
        }
    )
