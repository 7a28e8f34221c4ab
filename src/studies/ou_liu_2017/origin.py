"""How the answer of each method moves when the same points are given in another frame.

A sphere does not know where the origin of the coordinates is. A method that does gives another
sphere for the same points; and a method that keeps the large numbers of a national grid in its
normal equations loses the digits that hold the sphere.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from fractions import Fraction
from functools import partial

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.methods import SPHERE_METHODS, fit_sphere
from analysis.result import ignore_convergence_warnings

from .clouds import SPHERE

# Along x, in m; 500 000 and 4 000 000 are the easting and the northing of a national grid.
SHIFTS = (
    0,
    1,
    3,
    10,
    30,
    100,
    300,
    1_000,
    10_000,
    30_000,
    500_000,
    1_000_000,
    4_000_000,
    10_000_000,
)
DECIMALS = 5  # of the answers in m
LOST = 2e-5  # m: two units of the last decimal
RAW = "ls_raw"
LABELS = {name: method.label for name, method in SPHERE_METHODS.items()} | {
    RAW: "LS, raw normal equations"
}


def ls_by_raw_normal_equations(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """LS from the normal equations ``AᵀA X = AᵀY`` of the coordinates as they are: (a, b, c, r), m.

    To be independent of processors, and to show the least that is lost, only the products are
    rounded to double precision: their sums are the nearest doubles (math.fsum) and the four
    equations are solved exactly. What comes out wrong is wrong because AᵀA and AᵀY cannot hold it.

    Parameters: points, (n, 3), m. The radius is NaN without a real sphere, all four where AᵀA is
    singular.

    >>> directions = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0], [0, -1, 0.0]])
    >>> ls_by_raw_normal_equations([10, 10, 1] + 2 * directions)
    array([10., 10.,  1.,  2.])
    """
    x, y, z = points.T
    rows = [2 * x, 2 * y, 2 * z, np.ones(len(points)), x * x + y * y + z * z]
    system = [[Fraction(math.fsum(row * column)) for column in rows] for row in rows[:4]]
    try:
        X = _solved(system)
    except ZeroDivisionError:
        return np.full(4, np.nan)
    squared_radius = float(X[3] + sum(k * k for k in X[:3]))
    return np.array(
        [*map(float, X[:3]), math.sqrt(squared_radius) if squared_radius > 0 else math.nan]
    )


def _solved(system: list[list[Fraction]]) -> list[Fraction]:
    """The solution of the equations ``[N | h]`` by Gauss-Jordan elimination; ZeroDivisionError if N
    is singular.
    """
    size = len(system)
    for i in range(size):
        pivot = max(range(i, size), key=lambda row: abs(system[row][i]))
        system[i], system[pivot] = system[pivot], system[i]
        system[i] = [element / system[i][i] for element in system[i]]
        for row in range(size):
            if row != i:
                system[row] = [
                    a - system[row][i] * b for a, b in zip(system[row], system[i], strict=True)
                ]
    return [row[size] for row in system]


def _fitted(clouds: NDArray[np.float64], method: str) -> tuple[NDArray[np.float64], int]:
    """Parameters (B, 4) of a stack of clouds, NaN where the method did not converge to a sphere,
    and how often that was.
    """
    with ignore_convergence_warnings():  # counted instead
        fit = fit_sphere(clouds, method)
    return np.where(fit.converged[:, None], fit.parameters, np.nan), int(
        np.count_nonzero(~fit.converged)
    )


def _raw(clouds: NDArray[np.float64]) -> tuple[NDArray[np.float64], int]:
    """As above for the raw normal equations, whose exact sums do not depend on the order of the
    points.
    """
    parameters = ls_by_raw_normal_equations(clouds[0])[None]
    return parameters, len(clouds) * int(np.isnan(parameters).any())


METHODS: dict[str, Callable] = {name: partial(_fitted, method=name) for name in SPHERE_METHODS} | {
    RAW: _raw
}


def study(
    clouds: Mapping[str, NDArray[np.float64]], shifts=SHIFTS, orders: int = 15, seed: int = 1
) -> pd.DataFrame:
    """Fit the same points in frames shifted along x by every method.

    Each cloud is fitted with its points listed in several orders. That changes nothing but the
    rounding errors: the middle answer is taken, and where the orders differ by more than ``LOST``
    the answer is lost in rounding.

    Parameters
    ----------
    clouds : name -> (n, 3) points in m about the sphere of eq. (19) of Ou & Liu (2017).
    shifts : added to x, m.
    orders : number of orders, the given one among them.
    seed : of the orders.

    Returns
    -------
    One row a cloud, method and shift. ``center_error_m`` is the distance of the centre from the
    true one, shifted alike; ``radius_error_m`` the radius less the true one; ``from_ls_m`` the
    distance of the centre from that of LS, all rounded to 0.01 mm. They are NaN where there is no
    answer: ``lost`` says that it drowned in rounding errors, ``no_sphere`` in how many of the
    orders the method did not converge to a real sphere.

    >>> from studies.ou_liu_2017.clouds import read_sphere_cloud
    >>> frame = study({"gross": read_sphere_cloud(gross=True)}, shifts=(0, 100))
    >>> frame.loc[frame.method == "tls", "center_error_m"].tolist()
    [11.82068, 0.08581]
    """
    generator = np.random.default_rng(seed)
    rows = []
    for cloud, points in clouds.items():
        listed = np.array([points, *(generator.permutation(points) for _ in range(orders - 1))])
        for shift in shifts:
            moved = listed + [shift, 0.0, 0.0]
            answers = {method: run(moved) for method, run in METHODS.items()}
            of_ls = np.median(answers["ls"][0], axis=0)
            for method, (parameters, no_sphere) in answers.items():
                middle = np.median(parameters, axis=0)
                lost = bool(np.ptp(parameters, axis=0).max() > LOST)
                error = middle - SPHERE - [shift, 0, 0, 0]
                lengths = np.linalg.norm(error[:3]), error[3], np.linalg.norm((middle - of_ls)[:3])
                lengths = np.full(3, np.nan) if lost or no_sphere else np.round(lengths, DECIMALS)
                rows.append([cloud, method, shift, *lengths, lost, no_sphere])
    columns = [
        "cloud",
        "method",
        "shift_m",
        "center_error_m",
        "radius_error_m",
        "from_ls_m",
        "lost",
        "no_sphere",
    ]
    return pd.DataFrame(rows, columns=columns)


def by_shift(answers: pd.DataFrame, cloud: str, length: str) -> pd.DataFrame:
    """A length of :func:`study` for one cloud, mm: one row per shift, one column per method."""
    rows = answers[answers["cloud"] == cloud]
    wide = 1e3 * rows.pivot(index="shift_m", columns="method", values=length)[list(METHODS)]
    return wide.rename(columns=LABELS).reset_index(names="shift/m").rename_axis(columns=None)


def becomes_ls(answers: pd.DataFrame, cloud: str, method: str, within: float) -> int:
    """The smallest shift in m from which on all answers of a method that are not lost lie within so
    many m of LS.

    Raises ValueError if there is none.

    >>> distances = {"shift_m": [0, 10, 100], "from_ls_m": [0.1, 0.002, 0.0005]}
    >>> frame = pd.DataFrame({"cloud": "gross", "method": "wtls"} | distances)
    >>> becomes_ls(frame, "gross", "wtls", within=0.001)
    100
    """
    rows = (
        answers[(answers["cloud"] == cloud) & (answers["method"] == method)]
        .dropna(subset="from_ls_m")
        .sort_values("shift_m")
    )
    near = rows["shift_m"][(rows["from_ls_m"] <= within)[::-1].cummin()[::-1]]
    if near.empty:
        raise ValueError(
            f"expected a shift from which {method} is within {within:g} m of LS, found none"
        )
    return int(near.min())
