"""How good the plane methods are: the error of a, b, c in the paper's simulation, and what its σ0
compares.

The three σ0 are of three different quantities. Were all three planes the true one, there would
still be

    LS     vertical residuals                     √(1 + a² + b²) · σ √mean(1/cos θ)
    TLS    elements of [x, y, 1 | z]              √((1 + a² + b²)/(1 + a² + b² + c²)) · σ
           √mean(1/cos θ)
    mixed  orthogonal distances                   σ √mean(1/cos θ)
    WTLS   a coordinate at cos θ = 1              σ

so that σ0(WTLS) is far below the others whatever the quality of the plane.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.surfaces.plane import PlaneFit

from .clouds import PLANE, PLANE_SIGMA, plane_clouds, plane_draws
from .simulation import VARIANTS, consecutive, fitted, not_upright

COMPARED = ("ls", "tls", "mixed_ls_tls", "wtls", "wtls, LS plane", "wtls, projected", "wtls, true")
MEANING = {
    "ls": "vertical residual",
    "tls": "element of [x y 1 | z]",
    "mixed_ls_tls": "orthogonal distance",
    "wtls": "coordinate at cos θ = 1",
}
PARAMETERS = ("a", "b", "c")


def errors(fits: Mapping[str, PlaneFit]) -> pd.DataFrame:
    """Errors of the parameters over a stack of runs: one row per variant.

    Columns: ``variant``; of a, b and c (in m) ``bias_…``, the mean error, ``median_…``, the median
    absolute error, ``low_…`` and ``high_…``, the quartiles of the error; ``angle_deg``, median
    angle between the normal and the true one.
    """
    normal = np.array([-PLANE[0], -PLANE[1], 1.0]) / np.sqrt(1 + PLANE[0] ** 2 + PLANE[1] ** 2)
    rows = []
    for variant, fit in fits.items():
        error = fit.parameters - PLANE
        sine = np.linalg.norm(np.cross(fit.normal, normal), axis=-1)
        low, high = np.quantile(error, [0.25, 0.75], axis=0)
        measures = {
            "bias": error.mean(axis=0),
            "median": np.median(np.abs(error), axis=0),
            "low": low,
            "high": high,
        }
        row = {
            f"{measure}_{name}": values[k]
            for measure, values in measures.items()
            for k, name in enumerate(PARAMETERS)
        }
        rows.append(
            {"variant": variant}
            | row
            | {"angle_deg": np.degrees(np.median(np.arcsin(np.minimum(sine, 1.0))))}
        )
    return pd.DataFrame(rows)


def study(sides: Sequence[float], runs: int, variants: Sequence[str] = COMPARED) -> pd.DataFrame:
    """`errors` on patches of several ``sides`` in m (``side_m``), with the recovered σ;
    ``left_out``: runs of no determined slope.
    """
    draws = plane_draws(runs)
    frames = []
    for side in sides:
        points, cosines = plane_clouds(draws, side)
        fine = not_upright(points)
        fits = {variant: fitted(points[fine], cosines[fine], variant) for variant in variants}
        frames.append(errors(fits).assign(side_m=side, left_out=np.count_nonzero(~fine)))
    frame = pd.concat(frames, ignore_index=True)
    return frame[["side_m", *frame.columns.drop("side_m")]]


def closest(
    fits: Mapping[str, PlaneFit], order: Sequence[str] = ("wtls", "tls", "ls")
) -> pd.DataFrame:
    """In how many ten-run experiments the averaged parameters are as close to the truth as the
    paper orders them.

    One row a parameter and one for all three (√(Δa² + Δb² + Δc²)): ``as_printed_percent`` of the
    experiments have the errors in the printed order, WTLS the smallest; in ``first_of_two_percent``
    WTLS is closer than TLS.
    """
    runs = consecutive(len(fits[order[0]].parameters))
    found = np.stack([np.abs(fits[name].parameters[runs].mean(axis=1) - PLANE) for name in order])
    every = {name: found[..., k] for k, name in enumerate(PARAMETERS)} | {
        "all": np.linalg.norm(found, axis=-1)
    }
    return pd.DataFrame(
        [
            {
                "parameter": name,
                "as_printed_percent": 100.0 * np.mean((one[0] < one[1]) & (one[1] < one[2])),
                "first_of_two_percent": 100.0 * np.mean(one[0] < one[1]),
            }
            for name, one in every.items()
        ]
    )


def perfect_sigma_0(
    cosines: NDArray[np.float64], plane: Sequence[float] = PLANE, sigma: float = PLANE_SIGMA
) -> dict[str, float]:
    """σ0 in m that the true plane would give in the sense of each method, for points with these
    ``cosines``.

    >>> found = perfect_sigma_0(np.full(9, 0.25), (0, 0, 1), sigma=0.01)
    >>> {name: round(100 * value, 2) for name, value in found.items()}
    {'ls': 2.0, 'tls': 1.41, 'mixed_ls_tls': 2.0, 'wtls': 1.0}
    """
    a, b, c = plane
    distance = sigma * np.sqrt(np.mean(1.0 / cosines))
    steepness = 1.0 + a * a + b * b
    found = {
        "ls": np.sqrt(steepness) * distance,
        "tls": np.sqrt(steepness / (steepness + c * c)) * distance,
    }
    return {
        name: float(value)
        for name, value in (found | {"mixed_ls_tls": distance, "wtls": sigma}).items()
    }


def meanings(fits: Mapping[str, PlaneFit], cosines: NDArray[np.float64]) -> pd.DataFrame:
    """Meaning of σ0 in each method: ``true_plane_cm``, what the true plane would give;
    ``found_cm``, the mean over the runs; and how far that of WTLS is below, in percent,
    ``gain_true_plane`` and ``gain_found``; ``sigma_s_cm`` is the same quantity for all."""
    perfect = perfect_sigma_0(cosines)
    found = {name: fits[name].sigma_0.mean() for name in MEANING}
    rows = [
        {
            "method": VARIANTS[name].label,
            "sigma_0_is_of": words,
            "true_plane_cm": 100 * perfect[name],
            "found_cm": 100 * found[name],
            "gain_true_plane_percent": 100 * (1 - perfect["wtls"] / perfect[name]),
            "gain_found_percent": 100 * (1 - found["wtls"] / found[name]),
            "sigma_s_cm": 100 * fits[name].sigma_s.mean(),
        }
        for name, words in MEANING.items()
    ]
    return pd.DataFrame(rows)
