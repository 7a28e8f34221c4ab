"""Calibration against the number of points: from the fewest that are accepted to 20 000.

    (x̂ − x)ᵀ Σ̂⁻¹ (x̂ − x) ≤ t F₀.₉₅(t, Σω − t)

for the t parameters of a sphere, a plane and an ellipse without gross errors, with the covariance
Σ̂ and the weights ω of each method. Few points ask for thresholds that know the redundancy, many
for a bias of second order that is taken off: it does not become smaller with n.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import f as fisher

from analysis.adjustment.linalg import solve
from analysis.blocks import pieces
from analysis.methods import fit_ellipse, fit_plane, fit_sphere
from analysis.result import ignore_convergence_warnings

from .. import parallel
from .redraws import RADIUS, TARGET, cap_normals, share_interval

METHODS = ("geometric", "robust")
HALF_ANGLE = 80.0  # degrees, of the cap of the sphere
SLOPES = (0.3, -0.2, 5.0)  # of the plane z = a x + b y + c over a square of 2 m
AXES = (0.2, 0.12)  # m, of the ellipse
CHUNK = 200_000  # points per task


def _sphere(rng: np.random.Generator, count: int, n: int, sigma: float) -> NDArray[np.float64]:
    normals = cap_normals(rng.uniform(size=(count, n, 2)), HALF_ANGLE)
    return TARGET[:3] + RADIUS * normals + sigma * rng.standard_normal(normals.shape)


def _plane(rng: np.random.Generator, count: int, n: int, sigma: float) -> NDArray[np.float64]:
    points = rng.uniform(-1.0, 1.0, (count, n, 3))
    a, b, c = SLOPES
    points[..., 2] = a * points[..., 0] + b * points[..., 1] + c
    return points + sigma * rng.standard_normal(points.shape)


def _ellipse(rng: np.random.Generator, count: int, n: int, sigma: float) -> NDArray[np.float64]:
    turn = 2.0 * np.pi * (np.arange(n) + rng.uniform(size=(count, n))) / n
    points = np.stack([AXES[0] * np.cos(turn), AXES[1] * np.sin(turn)], axis=-1)
    return points + sigma * rng.standard_normal(points.shape)


# clouds, fit and the truth: of the ellipse the numbers (u0, v0, m, g, h)
SURFACES: dict[str, tuple[Callable, Callable, tuple[float, ...]]] = {
    "sphere": (_sphere, fit_sphere, tuple(TARGET)),
    "plane": (_plane, fit_plane, SLOPES),
    "ellipse": (_ellipse, fit_ellipse, (0.0, 0.0, sum(AXES) / 2, (AXES[0] - AXES[1]) / 2, 0.0)),
}


def study(
    counts: Sequence[int], redraws: int, points: int, sigma: float, seed: int
) -> pd.DataFrame:
    """Coverage of the 95 % ellipsoid of each surface and method at each number of points.

    Parameters
    ----------
    counts : numbers of points n; those that leave no redundancy are left out
    redraws : of each n, fewer where there would be more than ``points`` points in all
    sigma : noise of a coordinate in m; seed : of the study

    Returns
    -------
    One row per surface, n and method: ``surface``, ``points``, ``method``, ``redraws``;
    ``held_percent`` with its 95 % interval ``low_percent``, ``high_percent``;
    ``error_ratio``, 90 % quantile of the errors over that of ``geometric``, in the mean over the
    parameters.

    >>> study([6], 100, 10_000, 0.001, 1)["held_percent"].between(85, 100).all()
    np.True_
    """
    tasks = []
    for surface, (_, _, truth) in SURFACES.items():
        for n in (n for n in counts if n > len(truth)):
            total = min(redraws, points // n)
            for part in pieces(total, max(1, CHUNK // n)):
                key = [seed, list(SURFACES).index(surface), n, part.start]
                tasks.append((surface, n, part.stop - part.start, sigma, key))
    frame = pd.concat(parallel.run(_trials, tasks))
    rows = []
    for (surface, n), cloud in frame.groupby(["surface", "points"], sort=False):
        errors = [name for name in cloud if isinstance(name, int) and cloud[name].notna().all()]
        spread = cloud.groupby("method", sort=False)[errors].quantile(0.9)
        for method, group in cloud.groupby("method", sort=False):
            low, high = share_interval(group["held"].sum(), len(group))
            rows.append(
                {
                    "surface": surface,
                    "points": n,
                    "method": method,
                    "redraws": len(group),
                    "held_percent": 100 * group["held"].mean(),
                    "low_percent": float(low),
                    "high_percent": float(high),
                    "error_ratio": float((spread.loc[method] / spread.loc["geometric"]).mean()),
                }
            )
    return pd.DataFrame(rows)


def _trials(surface: str, n: int, count: int, sigma: float, key: list[int]) -> pd.DataFrame:
    """One row per method and cloud: whether the ellipsoid holds the truth, and the errors."""
    clouds, fit, truth = SURFACES[surface]
    points = clouds(np.random.default_rng(key), count, n, sigma)
    frames = []
    with ignore_convergence_warnings():  # what has not converged holds nothing
        for method in METHODS:
            found = fit(points, method)
            of_ellipse = surface == "ellipse"
            error = (found.regular if of_ellipse else found.parameters) - truth
            covariance = found.regular_covariance if of_ellipse else found.covariance
            # in units of the standard deviations, which differ by their unit
            sd = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
            scaled = error / sd
            correlation = covariance / (sd[:, :, None] * sd[:, None, :])
            square = np.sum(scaled * solve(correlation, scaled[..., None])[..., 0], axis=-1)
            t, free = len(truth), found.weights.sum(axis=-1) - len(truth)
            limit = t * fisher.ppf(0.95, t, np.where(free > 0, free, np.nan))
            held = found.converged & (square <= limit)
            frame = pd.DataFrame(np.abs(error)).assign(held=held, method=method)
            frames.append(frame.assign(surface=surface, points=n))
    return pd.concat(frames)
