"""The collapse of the weighted scale: σ and the weights shrink each other until a handful of points
is left.

A scale from the weighted residuals, ``σ² = Σωd²/Σω``, is smaller than that of the noise, because
the weights are small where the residuals are large. The next weights, taken against it, are smaller
still. Where weights accumulate nothing stops this: what is lost cannot come back.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.methods import fit_sphere

from ..montecarlo import sphere_study
from ..ou_liu_2017.clouds import SPHERE, sphere_redraws

# What σ in V/σ is and whether the weights accumulate; the first is the literal reading of the
# paper.
VARIANTS: dict[str, dict] = {
    "rms, cumulative": {"scale": "rms", "cumulative": True},
    "weighted, cumulative": {"scale": "rms_w", "cumulative": True},
    "weighted, not cumulative": {"scale": "rms_w", "cumulative": False},
    "weighted consistent, cumulative": {"scale": "rms_wc", "cumulative": True},
    "weighted consistent, not cumulative": {"scale": "rms_wc", "cumulative": False},
}
QUANTILES = {"q025": 0.025, "median": 0.5, "q975": 0.975}


def history(
    points: NDArray[np.float64], variants: Mapping[str, Mapping] = VARIANTS
) -> pd.DataFrame:
    """Iterations of `igg3_wtls` on one cloud (n, 3): ``variant``, ``iteration``, ``left`` (points
    with weight above 0), ``sigma_mm``.

    >>> from studies.ou_liu_2017.clouds import read_sphere_cloud
    >>> table = history(read_sphere_cloud(gross=False), {"w": VARIANTS["weighted, cumulative"]})
    >>> table["left"].iloc[[0, 30]].tolist(), bool(table["left"].iloc[-1] < 20)
    ([500, 237], True)
    """
    frames = []
    for variant, options in variants.items():
        steps = fit_sphere(points, "igg3_wtls", **options, history=True).history
        left = [np.count_nonzero(step.weights) for step in steps]
        sigma = [1e3 * float(step.scale) for step in steps]
        frames.append(
            pd.DataFrame(
                {
                    "variant": variant,
                    "iteration": np.arange(1, len(steps) + 1),
                    "left": left,
                    "sigma_mm": sigma,
                }
            )
        )
    return pd.concat(frames, ignore_index=True)


def redraws(trials: int, variants: Mapping[str, Mapping] = VARIANTS) -> pd.DataFrame:
    """State at the end, on `trials` redraws of the clean cloud of table 1: one row per variant
    and cloud.

    Columns: ``variant``; ``left``, points with weight above 0; ``sigma_0_mm``, the σ0 that the
    method states, with P_X = 1; ``error_mm`` of the centre; ``converged``.
    """
    options = {variant: {"method": "igg3_wtls"} | option for variant, option in variants.items()}
    points = sphere_redraws(trials)
    frames = []
    for variant, frame in sphere_study(points, SPHERE, options).items():
        error = 1e3 * np.linalg.norm(frame[["delta_a_m", "delta_b_m", "delta_c_m"]], axis=-1)
        left = points.shape[1] - frame["rejected"]
        row = {
            "variant": variant,
            "left": left,
            "sigma_0_mm": 1e3 * frame["sigma_0"],
            "error_mm": error,
            "converged": frame["converged"],
        }
        frames.append(pd.DataFrame(row))
    return pd.concat(frames, ignore_index=True)


def summary(trials: pd.DataFrame) -> pd.DataFrame:
    """Median and central 95 % over the redraws of :func:`redraws`, one row per variant.

    Columns: ``variant``; ``left_q025``, ``left_median``, ``left_q975``; ``median_se``, the Monte
    Carlo error of that median; ``sigma_0_mm`` and ``error_mm``, medians;
    ``claims_convergence_percent``.
    """
    rows = []
    for variant, frame in trials.groupby("variant", sort=False):
        row = {"variant": variant} | {
            f"left_{name}": frame["left"].quantile(q) for name, q in QUANTILES.items()
        }
        row |= {"median_se": _median_se(frame["left"].to_numpy())}
        row |= {name: frame[name].median() for name in ("sigma_0_mm", "error_mm")}
        rows.append(row | {"claims_convergence_percent": 100 * frame["converged"].mean()})
    return pd.DataFrame(rows)


def _median_se(values: NDArray) -> float:
    """Standard error of a median from the ranks between which it lies with 95 % probability."""
    half = 0.98 / np.sqrt(len(values))
    low, high = np.quantile(values, [0.5 - half, 0.5 + half])
    return (high - low) / (2 * 1.96)
