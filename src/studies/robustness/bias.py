"""Bias of centre and radius against the part of the sphere that is seen and against the noise.

The bias is an effect of second order, σ²/R and its multiples, and drowns in the scatter of first
order. Therefore each draw of errors is used twice, as e and as −e: in the mean of the two fits
every effect of odd order cancels, for every method, and what is left scatters by the effects of
even order alone.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..montecarlo import sphere_study
from .redraws import RADIUS, TARGET, cap_normals, failures, stacked

CORRECTED = "geometric, corrected"  # the minimum less its bias of second order
VARIANTS: dict[str, dict] = {
    name: {"method": name} for name in ("ls", "mixed_ls_tls", "wtls", "eiv", "geometric", "robust")
} | {CORRECTED: {"method": "geometric", "bias_correction": True}}
CENTROID = "wtls, centroid"  # the printed WTLS in coordinates reduced to the centroid
ORDER = ("ls", "mixed_ls_tls", "wtls", CENTROID, "eiv", "geometric", CORRECTED, "robust")


def study(settings: Sequence[tuple[float, float]], draws: int, n: int, seed: int) -> pd.DataFrame:
    """Bias of each method in each setting, from `draws` pairs of clouds (e, −e), that is, twice as
    many redraws.

    Parameters
    ----------
    settings : (half angle of the cap in degrees, noise σ in m per coordinate), …
    draws : pairs of clouds; n : points a cloud; seed : of the study.

    Returns
    -------
    One row a setting and variant: ``half_angle_deg``, ``sigma_mm``, ``variant``; ``along_mm``, mean
    error of the centre along the line of sight, positive away from the scanner, and ``radius_mm``,
    that of the radius, with standard errors ``along_se_mm`` and ``radius_se_mm``; ``failed``,
    clouds of 2·draws that gave no sphere. Pairs with such a cloud are left out of the means, which
    are missing with fewer than two pairs.

    >>> table = study([(180, 0.001)], draws=20, n=60, seed=1)
    >>> print(table["radius_mm"][table["variant"] == "geometric"].round(2).tolist())  # σ²/R
    [0.01]
    """
    uniform, normal = stacked(
        lambda generator: (generator.uniform(size=(n, 2)), generator.standard_normal((n, 3))),
        draws,
        seed,
    )
    # (S, 2, B, n, 3)
    clouds = np.array([_mirrored(uniform, normal, *setting) for setting in settings])
    rows = []
    errors = _errors(clouds.reshape(-1, n, 3))
    for variant in ORDER:
        for setting, pairs in zip(
            settings, errors[variant].reshape(len(settings), 2, draws, 2), strict=True
        ):
            rows.append(
                {"half_angle_deg": setting[0], "sigma_mm": 1e3 * setting[1], "variant": variant}
                | _summary(pairs)
            )
    return pd.DataFrame(rows).sort_values(
        ["half_angle_deg", "sigma_mm"], kind="stable", ignore_index=True
    )


def _mirrored(
    uniform: NDArray[np.float64], normal: NDArray[np.float64], half_angle: float, sigma: float
) -> NDArray[np.float64]:
    """(2, B, n, 3): the clouds with errors e and those with −e, m."""
    true = TARGET[:3] + RADIUS * cap_normals(uniform, half_angle)
    return np.array([true + sigma * normal, true - sigma * normal])


def _errors(points: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """variant -> (B, 2) errors of a and r in mm, NaN where the fit failed."""
    centroids = points.mean(axis=1)
    frames = sphere_study(points, TARGET, VARIANTS)
    frames |= sphere_study(points - centroids[:, None], TARGET, {CENTROID: {"method": "wtls"}})
    frames[CENTROID]["delta_a_m"] += centroids[:, 0]
    return {
        variant: np.where(frame[["converged"]], 1e3 * frame[["delta_a_m", "delta_r_m"]], np.nan)
        for variant, frame in frames.items()
    }


def _summary(pairs: NDArray[np.float64]) -> dict:
    """Means over the pairs and their standard errors; pairs (2, B, 2)."""
    means = pairs.mean(axis=0)
    means = means[np.isfinite(means).all(axis=-1)]
    bias = se = np.full(2, np.nan)
    if len(means) > 1:
        bias, se = means.mean(axis=0), means.std(axis=0, ddof=1) / np.sqrt(len(means))
    failed = failures(np.isnan(pairs).any(axis=-1).ravel())
    return {
        "along_mm": bias[0],
        "along_se_mm": se[0],
        "radius_mm": bias[1],
        "radius_se_mm": se[1],
        "failed": failed,
    }
