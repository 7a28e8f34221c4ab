"""Efficiency on clean normal data: what robustness costs where it is not needed.

The variance of an M-estimator over that of least squares is ``E[ψ²]/E[ψ′]²``; its inverse is the
efficiency of the weight function (Huber 1981). It holds for weights that do not accumulate.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.adjustment.weights import EFFICIENT_THRESHOLDS, IGG3, PRINTED_THRESHOLDS

from ..montecarlo import EVERY_METHOD, sphere_study
from ..ou_liu_2017.clouds import SPHERE, SPHERE_POINTS, sphere_cloud
from .redraws import failures, stacked

SIGMA = 0.01 / np.sqrt(12.0)  # m; the noise that rounding to 0.01 m leaves, here normal
DEFAULTS = {"igg3_wtls": PRINTED_THRESHOLDS, "robust": EFFICIENT_THRESHOLDS}
EXACT = 12  # decimals that stand for points without rounding


def _igg3(options: Mapping) -> IGG3:
    """The weight function of keyword arguments of `fit_sphere`, the method's own thresholds where
    none are given.
    """
    k0, k1 = DEFAULTS[options["method"]]
    return IGG3(options.get("k0", k0), options.get("k1", k1))


VARIANTS: dict[str, dict] = EVERY_METHOD | {
    "igg3_wtls, not cumulative": {"method": "igg3_wtls", "cumulative": False},
    "robust, k0 = 1.5, k1 = 2.5": {"method": "robust", "k0": 1.5, "k1": 2.5},
    "robust, k0 = 2.5, k1 = 5": {"method": "robust", "k0": 2.5, "k1": 5.0},
}
REFERENCE = "geometric"


def clouds(trials: int, seed: int) -> NDArray[np.float64]:
    """(B, 500, 3) clouds on the cap of table 1 of Ou & Liu (2017) with normal errors instead of
    rounding, m.
    """
    true, normal = stacked(
        lambda generator: (
            sphere_cloud(generator, decimals=EXACT),
            generator.standard_normal((SPHERE_POINTS, 3)),
        ),
        trials,
        seed,
    )
    return true + SIGMA * normal


def study(trials: int, seed: int) -> pd.DataFrame:
    """Standard deviation of the centre by each method relative to the orthogonal distance fit, on
    the same clouds.

    Columns: ``variant``, ``method``; ``sd_mm``, root of the sum of the variances of a, b, c;
    ``sd_ratio`` to that of `REFERENCE` and ``efficiency_percent``, its inverse square, with
    standard errors ``sd_ratio_se`` and ``efficiency_se_percent``; ``theory_percent``,
    (E[ψ′])²/E[ψ²] of the weight function, 100 without one, missing where weights are cumulative;
    ``failed``.
    """
    frames = sphere_study(clouds(trials, seed), SPHERE, VARIANTS)
    squares = {variant: _squared_deviations(frame) for variant, frame in frames.items()}
    rows = []
    for variant, frame in frames.items():
        both = np.isfinite(squares[variant] + squares[REFERENCE])
        own, reference = squares[variant][both], squares[REFERENCE][both]
        efficiency = reference.mean() / own.mean()
        # Delta method for a ratio of means of paired values.
        se = np.std(reference - efficiency * own, ddof=1) / np.sqrt(len(own)) / own.mean()
        rows.append(
            {
                "variant": variant,
                "method": VARIANTS[variant]["method"],
                "sd_mm": 1e3 * np.sqrt(own.mean()),
                "sd_ratio": efficiency**-0.5,
                "sd_ratio_se": 0.5 * efficiency**-1.5 * se,
                "efficiency_percent": 100 * efficiency,
                "efficiency_se_percent": 100 * se,
                "theory_percent": _theory(variant),
                "failed": failures(~frame["converged"].to_numpy()),
            }
        )
    return pd.DataFrame(rows)


def _squared_deviations(frame: pd.DataFrame) -> NDArray[np.float64]:
    """(B,) squared distance of each centre from their mean, m²; NaN where the fit failed."""
    centers = frame[["delta_a_m", "delta_b_m", "delta_c_m"]].where(frame["converged"]).to_numpy()
    return np.sum((centers - np.nanmean(centers, axis=0)) ** 2, axis=-1)


def _theory(variant: str) -> float:
    options = VARIANTS[variant]
    if options["method"] not in ("igg3_wtls", "robust"):
        return 100.0
    return np.nan if variant == "igg3_wtls" else 100 * _igg3(options).efficiency
