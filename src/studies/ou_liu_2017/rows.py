"""Can the numbers of a printed row be true together? Arguments that need no redraw of the gross
errors.

The tables print absolute errors, so a row stands for 16 spheres, one for each choice of the four
signs. Each leaves residuals at the good points, which lie on the cap whatever the gross errors
were. If even the smallest of them exceeds the printed σ0, the row contradicts itself.

Source: Ou & Liu (2017), tables 1 and 2, doi:10.7510/jgjs.issn.1001-3806.2017.05.026.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.adjustment.igg3 import SCALES
from analysis.surfaces.sphere import PARAMETERS

from ..montecarlo import sphere_study
from .clouds import GROSS_POINTS, SPHERE, SPHERE_CENTER, SPHERE_POINTS, SPHERE_RADIUS
from .printed_tables import METHODS, values

REDUNDANCY = SPHERE_POINTS - PARAMETERS


def good_points(clouds: NDArray[np.float64]) -> NDArray[np.float64]:
    """(B, 495, 3): the clouds (B, 500, 3) without the points that are gross errors in table 2."""
    return np.delete(clouds, np.array(GROSS_POINTS) - 1, axis=1)


def printed_spheres(
    table: int, method: str, wrong_sign: bool = False, delta_r: float | None = None
) -> NDArray[np.float64]:
    """(16, 4): the spheres (a, b, c, r) in m that a printed row allows, one for each choice of
    signs; NaN if not real.

    `delta_r`: an |Δr| in m to be tried instead of the printed one. With `wrong_sign` the printed Δr
    is that of `radius_with_wrong_sign`, and r the radius that leads to it.

    >>> printed_spheres(1, "ls")[0].round(4).tolist()
    [9.9998, 10.0, 0.9984, 14.1407]
    """
    row = values(table, method)
    errors = np.array([row[f"abs_delta_{name}_m"] for name in "abcr"])
    if delta_r is not None:
        errors[3] = delta_r
    spheres = SPHERE + np.array(list(product((-1, 1), repeat=4))) * errors
    if wrong_sign:
        spheres[:, 3] = radius_with_wrong_sign(spheres)
    return spheres


def radius_with_wrong_sign(spheres: NDArray[np.float64]) -> NDArray[np.float64]:
    """Radius that comes out when the sign of δ = r² − |k|² is mistaken:
    ``√(|k|² − δ) = √(2|k|² − r²)``.

    The slip is its own inverse. Parameters: spheres (…, 4) in m. NaN where the root is not real.

    >>> radius_with_wrong_sign(np.array([10.0, 10.0, 1.0, 200**0.5])) == 202**0.5
    np.True_
    """
    square = 2 * np.sum(spheres[..., :3] ** 2, axis=-1) - spheres[..., 3] ** 2
    return np.sqrt(np.where(square > 0, square, np.nan))


def least_sigma_0(clouds: NDArray[np.float64], table: int) -> pd.DataFrame:
    """The least σ0 that each printed row of a table can have, over all signs and all clouds, beside
    the printed one.

        σ0² ≥ Σ μ r² / (500 − 4),   r = |p − k|² − r²,   sum over the 495 good points

    with μ = 1 for LS and TLS and μ = 1/(|p|² + |k|²), eq. (16) at weights 1, for IGG III-WTLS.

    Parameters: clouds (B, 500, 3), m. Columns:

    - ``of_sphere`` with the printed centre and radius;
    - ``of_centre`` with the printed centre and whatever radius suits it best;
    - ``wrong_sign`` with the printed centre and radius, the latter taken for
      `radius_with_wrong_sign`.
    """
    good = good_points(clouds)
    rows = []
    for printed in METHODS.values():
        sigma_0 = values(table, printed)["sigma_0"]
        spheres = printed_spheres(table, printed)
        weigh = printed == "igg3_wtls"
        rows.append(
            {
                "table": table,
                "method": printed,
                "printed": sigma_0,
                "of_sphere": _least(good, spheres, weigh),
                "of_centre": _least(good, spheres[:, :3], weigh),
                "wrong_sign": _least(good, printed_spheres(table, printed, wrong_sign=True), weigh),
            }
        )
    return pd.DataFrame(rows)


def _least(good: NDArray[np.float64], spheres: NDArray[np.float64], weigh: bool) -> float:
    """Least ``√(Σ μ r²/496)`` over clouds and spheres; where a radius is missing, the best one."""
    least = np.inf
    for sphere in spheres[~np.isnan(spheres).any(axis=1)]:
        squares = np.sum((good - sphere[:3]) ** 2, axis=-1)
        mu = 1 / np.sum(good**2 + sphere[:3] ** 2, axis=-1) if weigh else np.ones_like(squares)
        if len(sphere) == 4:
            r = squares - sphere[3] ** 2
        else:
            r = squares - (np.sum(mu * squares, axis=1) / np.sum(mu, axis=1))[:, None]
        least = min(least, np.sqrt(np.sum(mu * r * r, axis=1) / REDUNDANCY).min())
    return float(least)


def moments(clouds: NDArray[np.float64]) -> NDArray[np.float64]:
    """(B, 5, 5) sums of products of v = (|q|² − R², q, 1) over the points of clouds (B, n, 3), q =
    p − true centre, R the true radius.

    The algebraic residual of any sphere is linear in v, so these sums give Σr and Σr² of every
    sphere: see `sums`.
    """
    q = clouds - SPHERE_CENTER
    v = np.concatenate(
        [np.sum(q * q, axis=-1, keepdims=True) - SPHERE_RADIUS**2, q, np.ones_like(q[..., :1])],
        axis=-1,
    )
    return v.swapaxes(-1, -2) @ v


def sums(
    products: NDArray[np.float64], spheres: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Σr (m²) and Σr² (m⁴), (s, B) each, of spheres (s, 4) at clouds given by their `moments` (B,
    5, 5).

        r = |p − k|² − r² = (|q|² − R²) − 2 Δk·q + |Δk|² − (r² − R²)

    >>> points = np.array([[[10.0, 10.0, 3.0], [10.0, 10.0, 4.0]]])
    >>> total, squares = sums(moments(points), np.array([[10.0, 10.0, 1.0, 2.0]]))
    >>> total.round(9).tolist(), squares.round(9).tolist()
    ([[5.0]], [[25.0]])
    """
    away = spheres[:, :3] - SPHERE_CENTER
    constant = np.sum(away**2, axis=1) - (spheres[:, 3] ** 2 - SPHERE_RADIUS**2)
    v = np.column_stack([np.ones(len(spheres)), -2 * away, constant])
    squares = (v[:, :, None] * v[:, None, :]).reshape(len(v), -1)
    return v @ products[:, 4].T, squares @ products.reshape(len(products), -1).T


def normal_equation(
    clouds: NDArray[np.float64], wrong_sign: bool = False, delta_r: float | None = None
) -> pd.DataFrame:
    """The LS row of table 2 against the equation Σ r = 0, which LS with a column of ones fulfils
    exactly.

    The five gross residuals sum up to minus those of the good points, hence
    ``Σ_gross r² ≥ (Σ_good r)²/5`` (Cauchy-Schwarz), while the printed σ0 leaves them
    ``496 σ0² − Σ_good r²``. The row is possible where the ratio of the two is at most 1. Gross
    errors inside the sphere have r < 0, so they need ``Σ_good r > 0``.

    Parameters: clouds (B, 500, 3), m; wrong_sign and delta_r as in `printed_spheres`. One row a
    choice of signs: ``signs``; ``sum_good_m2``, Σ_good r, and ``ratio``, of the cloud whose ratio
    is the smallest (infinite if σ0 leaves nothing).
    """
    sigma_0 = values(2, "ls")["sigma_0"]
    totals, squares = sums(
        moments(good_points(clouds)), printed_spheres(2, "ls", wrong_sign, delta_r)
    )
    rows = []
    for signs, total, square in zip(product("-+", repeat=4), totals, squares, strict=True):
        left = REDUNDANCY * sigma_0**2 - square
        ratio = np.where(
            left > 0, total**2 / len(GROSS_POINTS) / np.where(left > 0, left, np.nan), np.inf
        )
        best = np.argmin(ratio)
        rows.append({"signs": "".join(signs), "sum_good_m2": total[best], "ratio": ratio[best]})
    return pd.DataFrame(rows)


def radius_errors_with_wrong_sign(
    trials: Mapping[str, pd.DataFrame],
) -> dict[tuple[str, str], NDArray[np.float64]]:
    """(method, "abs_delta_r_m") -> |Δr| in m that trials would show had the sign of δ been
    mistaken.

    Parameters: trials, method -> frame of `montecarlo.sphere_study`.
    """
    found = {}
    for method in METHODS.values():
        errors = trials[method][[f"delta_{name}_m" for name in "abcr"]].to_numpy()
        spheres = errors + SPHERE
        found[method, "abs_delta_r_m"] = np.abs(radius_with_wrong_sign(spheres) - SPHERE_RADIUS)
    return found


def igg3_readings(clean: NDArray[np.float64], gross: NDArray[np.float64]) -> pd.DataFrame:
    """Does any reading of σ in eq. (13) and of step 6 reproduce the IGG III-WTLS rows of tables 1
    and 2?

    Parameters: clean and gross, (B, 500, 3) redraws of the clouds of table 1 and table 2, m.

    One row a reading: ``sigma``, a name of `igg3.SCALES` without ``unit``, which leaves no points;
    ``weights``, cumulative as printed or not; then for each table ``used``, the mean number of
    points in use, ``sigma_0``, its median, and for the errors of the centre in table 2 ``a_ratio``,
    ``b_ratio``, ``c_ratio``, the printed one over the upper limit of the central 95 % of the
    redraws.
    """
    readings = {
        (sigma, weights): {
            "method": "igg3_wtls",
            "scale": sigma,
            "cumulative": weights == "cumulative",
        }
        for sigma in SCALES
        if sigma != "unit"
        for weights in ("cumulative", "not cumulative")
    }
    rows = [dict(zip(("sigma", "weights"), reading, strict=True)) for reading in readings]
    for table, points in ((1, clean), (2, gross)):
        study = sphere_study(points, SPHERE, readings)
        for row, trials in zip(rows, study.values(), strict=True):
            row[f"used_{table}"] = points.shape[1] - trials["rejected"].mean()
            row[f"sigma_0_{table}"] = trials["sigma_0"].median()
    printed = values(2, "igg3_wtls")
    for row, trials in zip(rows, study.values(), strict=True):
        for name in "abc":
            row[f"{name}_ratio"] = printed[f"abs_delta_{name}_m"] / trials[
                f"delta_{name}_m"
            ].abs().quantile(0.975)
    return pd.DataFrame(rows)
