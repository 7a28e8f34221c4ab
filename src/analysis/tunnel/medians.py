"""Medians of many groups at once, and the scale of residuals by their median."""

from __future__ import annotations

import numpy as np

from ..adjustment.weights import ROUNDED_MAD_TO_SD


def group_medians(group: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """Median of the values (n,), ≥ 0, of each of ``count`` groups; NaN for empty groups."""
    # One number sorts faster than two.
    order = np.argsort(group + 0.5 * values / max(values.max(), np.finfo(float).tiny))
    values = values[order]
    present, starts, sizes = np.unique(group[order], return_index=True, return_counts=True)
    medians = np.full(count, np.nan)
    medians[present] = 0.5 * (values[starts + (sizes - 1) // 2] + values[starts + sizes // 2])
    return medians


def median_scale(residuals: np.ndarray, smallest: float) -> float:
    """``1.4826 med|e|``, not below ``smallest``; that for no residuals."""
    if not residuals.size:
        return smallest
    return max(ROUNDED_MAD_TO_SD * float(np.median(np.abs(residuals))), smallest)
