"""Where the simulation of the plane paper took place: patch L and σ recovered from the five numbers
printed of its results.

For every layout of the points, and every L and σ on a grid, the paper's experiment (ten runs
averaged) is repeated many times. A setting can have produced the paper if all five printed numbers,
as far as their digits tell, lie inside the central 95 % of its experiments. Each of the five by
itself; that they occur together is asked by

    χ² = dᵀ (C + R)⁻¹ d,   d = printed − mean,   C of the experiments, R = diag(half unit²/3) of the
    rounding,

which exceeds 11.07 in 5 % of the experiments of the true setting (χ² of 5 degrees of freedom).

The random numbers are the same at every node, so the results are smooth in L and σ and are
interpolated between few nodes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline
from scipy.stats import chi2

from .clouds import PLANE_RUNS, PLANE_SEED, plane_clouds, plane_draws
from .simulation import FIVE, fitted, five, not_upright, printed

EXPERIMENTS = 1000  # made of a node's runs by drawing ten at a time
LIMIT = float(chi2.ppf(0.95, len(FIVE)))
RECOVERED = "square from the origin"

# What the paper leaves open about its methods: reading -> (variant that stands for TLS, for WTLS).
READINGS = {
    "pure TLS; cosines raw, iterated": ("tls", "wtls"),
    "pure TLS; cosines raw, LS plane": ("tls", "wtls, LS plane"),
    "pure TLS; cosines projected": ("tls", "wtls, projected"),
    "pure TLS; cosines true": ("tls", "wtls, true"),
    "mixed LS-TLS; cosines raw, iterated": ("mixed_ls_tls", "wtls"),
    "mixed LS-TLS; cosines raw, LS plane": ("mixed_ls_tls", "wtls, LS plane"),
    "mixed LS-TLS; cosines projected": ("mixed_ls_tls", "wtls, projected"),
    "mixed LS-TLS; cosines true": ("mixed_ls_tls", "wtls, true"),
}
LITERAL = next(iter(READINGS))


def search(
    sides: Sequence[float],
    sigmas: Sequence[float],
    runs: int,
    layout: str,
    readings: Sequence[str] = (LITERAL,),
    seed: int = PLANE_SEED,
) -> dict[str, Nodes]:
    """The five numbers at every node of a grid of L and σ.

    Parameters
    ----------
    sides, sigmas : L and σ in m, increasing; runs : clouds a node; layout : a name from
        `PLANE_LAYOUTS`; readings : names in `READINGS`.

    Returns reading -> `Nodes`. Runs whose slope is not determined, or for which a method did not
    converge, are left out.
    """
    draws = plane_draws(runs, seed)
    variants = {"ls"}.union(*(READINGS[reading] for reading in readings))
    tens = np.random.default_rng(seed).uniform(size=(EXPERIMENTS, PLANE_RUNS))
    found = {
        reading: np.empty((len(sides), len(sigmas), EXPERIMENTS, len(FIVE))) for reading in readings
    }
    for i, side in enumerate(sides):
        for j, sigma in enumerate(sigmas):
            points, cosines = plane_clouds(draws, side, sigma, layout)
            fine = not_upright(points)
            fits = {variant: fitted(points[fine], cosines[fine], variant) for variant in variants}
            # A plane that runs off to the vertical has no minimum, and where it is stopped
            # depends on rounding.
            usable = np.flatnonzero(np.logical_and.reduce([fit.converged for fit in fits.values()]))
            drawn = usable[(tens * len(usable)).astype(int)]
            for reading in readings:
                found[reading][i, j] = five(fits, drawn, *READINGS[reading])
    return {reading: Nodes.of(sides, sigmas, experiments) for reading, experiments in found.items()}


class Nodes:
    """Means, limits of the central 95 % and covariances of the five numbers, known at nodes (L, σ)
    and interpolated between them.

    By cubic splines in log L and log σ, which need four nodes or more of either.
    """

    def __init__(self, sides, sigmas, statistics: NDArray[np.float64]):
        self.sides, self.sigmas, self.statistics = np.asarray(sides), np.asarray(sigmas), statistics

    @classmethod
    def of(cls, sides, sigmas, experiments: NDArray[np.float64]) -> Nodes:
        """From experiments (nL, nσ, E, 5)."""
        d = experiments - experiments.mean(axis=2, keepdims=True)
        covariance = d.swapaxes(-1, -2) @ d / (experiments.shape[2] - 1)
        limits = np.quantile(experiments, [0.025, 0.975], axis=2)
        flat = covariance.reshape(*covariance.shape[:2], -1)
        return cls(
            sides, sigmas, np.concatenate([experiments.mean(axis=2), *limits, flat], axis=-1)
        )

    def compared(self, fineness: int) -> pd.DataFrame:
        """The printed numbers against every setting of a finer grid, ``fineness`` steps from node
        to node.

        Columns: ``side_m``, ``sigma_m``; of each number the limits ``<number>_lower`` and
        ``<number>_upper``; ``inside``, how many of the five are; ``chi_square``.
        """
        sides, sigmas = _refined(self.sides, fineness), _refined(self.sigmas, fineness)
        along = make_interp_spline(np.log(self.sides), self.statistics, axis=0)(np.log(sides))
        statistics = make_interp_spline(np.log(self.sigmas), along, axis=1)(np.log(sigmas)).reshape(
            -1, self.statistics.shape[-1]
        )
        grid = np.stack(np.meshgrid(sides, sigmas, indexing="ij"), axis=-1).reshape(-1, 2)
        t = len(FIVE)
        mean, lower, upper = (
            statistics[:, :t],
            statistics[:, t : 2 * t],
            statistics[:, 2 * t : 3 * t],
        )
        value, half = printed()[["printed", "half_unit"]].to_numpy().T
        d = mean - value
        C = statistics[:, 3 * t :].reshape(-1, t, t) + np.diag(half**2 / 3.0)
        inside = (value + half > lower) & (value - half < upper)
        frame = pd.DataFrame({"side_m": grid[:, 0], "sigma_m": grid[:, 1]})
        for k, name in enumerate(FIVE):
            frame[f"{name}_lower"], frame[f"{name}_upper"] = lower[:, k], upper[:, k]
        chi_square = np.sum(d * np.linalg.solve(C, d[..., None])[..., 0], axis=-1)
        return frame.assign(inside=inside.sum(axis=-1), chi_square=chi_square)


def summary(compared: pd.DataFrame) -> dict[str, float]:
    """How well the five numbers determine the setting.

    ``most_inside`` of them at once, ``least_chi_square`` and where (``side_m``, ``sigma_cm``), and
    the extent of all settings with all five inside; NaN where there is none.
    """
    best = compared.loc[compared["chi_square"].idxmin()]
    all_five = compared[compared["inside"] == len(FIVE)]
    return {
        "most_inside": int(compared["inside"].max()),
        "least_chi_square": float(best["chi_square"]),
        "side_m": float(best["side_m"]),
        "sigma_cm": 100.0 * float(best["sigma_m"]),
        "side_from_m": float(all_five["side_m"].min()),
        "side_to_m": float(all_five["side_m"].max()),
        "sigma_from_cm": 100.0 * float(all_five["sigma_m"].min()),
        "sigma_to_cm": 100.0 * float(all_five["sigma_m"].max()),
    }


def _refined(nodes: NDArray[np.float64], fineness: int) -> NDArray[np.float64]:
    """Nodes with further values between them, evenly spaced in the logarithm."""
    places = np.linspace(0, len(nodes) - 1, fineness * (len(nodes) - 1) + 1)
    return np.exp(np.interp(places, np.arange(len(nodes)), np.log(nodes)))
