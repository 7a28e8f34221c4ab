"""False alarms of the printed limits: by single points, where nothing has moved."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from scipy.stats import norm

from analysis.checks import check_positive, check_whole_number
from analysis.tunnel.significance import LIMITS, share_beyond


def false_alarms(
    sigmas: Sequence[float] = (0.002, 0.003, 0.005), *, draws: int = 100_000, seed: int = 0
) -> pd.DataFrame:
    """Shares of single points beyond 6 and 12 mm without deformation.

    Each difference is that of two points of standard deviation σ. It has the standard deviation
    √2 σ, and ``P(|δ| > limit) = 2 Φ(−limit/(√2 σ))``.

    Returns
    -------
    DataFrame, a row per σ and limit: ``sigma_mm``, ``limit_mm``, ``simulated`` and ``theory``,
    shares, and ``standard_error`` of the simulated.

    Example
    -------
    >>> table = false_alarms((0.002, 0.003, 0.005), draws=10)
    >>> (100 * table["theory"][table["limit_mm"] == 6]).round(1).tolist()
    [3.4, 15.7, 39.6]
    """
    draws, generator = check_whole_number(draws, "draws"), np.random.default_rng(seed)
    unit = generator.standard_normal((2, draws))
    rows = []
    for sigma in sigmas:
        delta = check_positive(sigma, "sigmas") * (unit[1] - unit[0])
        for limit in LIMITS:
            theory = 2.0 * norm.sf(limit / (np.sqrt(2.0) * sigma))
            rows.append(
                {
                    "sigma_mm": 1e3 * sigma,
                    "limit_mm": 1e3 * limit,
                    "simulated": share_beyond(delta, limit),
                    "theory": theory,
                    "standard_error": np.sqrt(theory * (1.0 - theory) / draws),
                }
            )
    return pd.DataFrame(rows)
