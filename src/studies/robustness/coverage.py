"""Calibration: does the 95 % confidence ellipsoid of (a, b, c, r) hold the truth in 95 % of the
redraws?

    (x̂ − x)ᵀ Σ̂⁻¹ (x̂ − x) ≤ 4 F₀.₉₅(4, n′ − 4),   n′ points in use

with the covariance Σ̂ that the method itself states.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import f as fisher

from analysis.adjustment.linalg import solve
from analysis.blocks import pieces
from analysis.methods import SPHERE_METHODS, fit_sphere
from analysis.result import ignore_convergence_warnings
from analysis.scanner import Scanner
from analysis.surfaces.sphere import PARAMETERS, SphereFit

from .. import parallel
from .redraws import RADIUS, TARGET, cap_normals, failures, median_of_all, share_interval, stacked

METHODS = ("ls", "wtls", "igg3_wtls", "eiv", "geometric", "robust")
DEPTH = (0.01, 0.04)  # m towards the centre, of gross errors
CHUNK = 200  # clouds a task


def clouds(
    trials: int, n: int, seed: int, half_angle: float, gross_share: float, noise: float | Scanner
) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
    """(B, n, 3) clouds of the target in m, and their cofactors (B, n, 3, 3) in m².

    noise : σ of each coordinate in m, which has no cofactors (None), or a scanner in the origin,
        whose errors are normal with the cofactors of its model at the true points and incidence
        angles. Of each cloud the first points, in number the share of n, are gross errors, moved
        U(10, 40) mm towards the centre.
    """

    def draw(generator: np.random.Generator) -> tuple:
        return (
            generator.uniform(size=(n, 2)),
            generator.standard_normal((n, 3)),
            generator.uniform(*DEPTH, size=n),
        )

    uniform, normal, depth = stacked(draw, trials, seed)
    normals = cap_normals(uniform, half_angle)
    points = TARGET[:3] + RADIUS * normals
    if isinstance(noise, Scanner):
        cofactors = noise.cofactors(points, normals=normals)
        points += np.einsum("bnij,bnj->bni", np.linalg.cholesky(cofactors), normal)
    else:
        cofactors = None
        points += noise * normal
    count = round(gross_share * n)
    points[:, :count] -= depth[:, :count, None] * normals[:, :count]
    return points, cofactors


def study(
    trials: int,
    n: int,
    seed: int,
    half_angle: float,
    gross_shares: Sequence[float],
    noises: Mapping[str, float | Scanner],
    methods=METHODS,
) -> pd.DataFrame:
    """Coverage for every kind of noise and share of gross errors.

    Parameters
    ----------
    trials : redraws; n : points a cloud; seed : of the study; half_angle : of the cap, degrees;
        gross_shares : 0 to 0.5
    noises : name -> noise as in :func:`clouds`. Cofactors are given to the methods that take them;
        the others treat all points alike.
    methods : names in `SPHERE_METHODS`.

    Returns
    -------
    One row per noise, share and method: ``noise``, ``gross_percent``, ``method``; ``held_percent``
    with its 95 % interval ``low_percent``, ``high_percent``; ``error_mm``, median distance of the
    centre from the truth, and ``claimed_mm``, median of its claimed standard deviation
    (`redraws.median_of_all`); ``failed`` (`redraws.failures`), fits without a sphere or a
    covariance, which hold nothing.

    >>> table = study(50, 60, 1, 80, [0.0], {"isotropic": 0.001}, ["geometric"])
    >>> print(table["held_percent"].tolist(), table["failed"].tolist())
    [96.0] [0]
    """
    tasks = []
    for name, noise in noises.items():
        for share in gross_shares:
            points, cofactors = clouds(trials, n, seed, half_angle, share, noise)
            for part in pieces(trials, CHUNK):
                given = None if cofactors is None else cofactors[part]
                tasks.append((name, 100 * share, points[part], given, methods))
    frame = pd.concat(parallel.run(_trials, tasks))
    keys = ["noise", "gross_percent", "method"]
    return pd.DataFrame(
        [
            dict(zip(keys, key, strict=True)) | _summary(rows)
            for key, rows in frame.groupby(keys, sort=False)
        ]
    )


def _trials(noise: str, gross_percent: float, points, cofactors, methods) -> pd.DataFrame:
    """One row per method and cloud: whether the ellipsoid holds the truth; of the centre in mm the
    error and the claimed standard deviation.
    """
    frames = []
    with ignore_convergence_warnings():  # counted instead
        for method in methods:
            fit = fit_sphere(
                points, method, cofactors=cofactors if SPHERE_METHODS[method].consistent else None
            )
            frames.append(
                pd.DataFrame(_calibration(fit)).assign(
                    noise=noise, gross_percent=gross_percent, method=method
                )
            )
    return pd.concat(frames)


def _calibration(fit: SphereFit) -> dict[str, NDArray]:
    error = fit.parameters - TARGET
    square = np.einsum("bi,bi->b", error, solve(fit.covariance, error[..., None])[..., 0])
    redundancy = np.count_nonzero(fit.inliers, axis=-1) - PARAMETERS
    # A collapsed fit that left no redundancy has no covariance: NaN, which holds nothing.
    limit = PARAMETERS * fisher.ppf(0.95, PARAMETERS, np.where(redundancy > 0, redundancy, np.nan))
    usable = fit.converged & np.isfinite(square + limit)
    claimed = np.sqrt(
        np.trace(
            np.where(usable[:, None, None], fit.covariance[:, :3, :3], np.nan), axis1=-2, axis2=-1
        )
    )
    return {
        "held": usable & (square <= limit),
        "error_mm": np.where(usable, 1e3 * np.linalg.norm(error[:, :3], axis=-1), np.nan),
        "claimed_mm": np.where(usable, 1e3 * claimed, np.nan),
        "failed": ~usable,
    }


def _summary(rows: pd.DataFrame) -> dict:
    failed = rows["failed"].to_numpy()
    low, high = share_interval(rows["held"].sum(), len(rows))
    return {
        "held_percent": 100 * rows["held"].mean(),
        "low_percent": float(low),
        "high_percent": float(high),
        "error_mm": median_of_all(rows["error_mm"].to_numpy(), failed),
        "claimed_mm": median_of_all(rows["claimed_mm"].to_numpy(), failed),
        "failed": failures(failed),
    }
