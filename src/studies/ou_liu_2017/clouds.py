"""The simulated point clouds of the papers, as committed and redrawn.

The sphere of Ou & Liu (2017). Section 2.1 of the paper gives the sphere (eq. 19), the range x, y ∈
[0, 20] m and 500 points, and blames the deviations in table 1 on the number of digits kept: the
noise is the rounding of the coordinates, and nothing else. A step of 0.01 m explains the printed
σs: rounding leaves 0.01 m / √12 = 2.89 mm in every direction, hence √(496/500) of it, 2.87 mm,
after a fit of four parameters, beside the printed 2.82 mm. The errors printed for LS, 1.6 mm in c
and 1.4 mm in r, are those of points on the upper cap; points on the whole sphere would leave a
tenth of them.

Sources: Ou & Liu (2017), section 2.1, doi:10.7510/jgjs.issn.1001-3806.2017.05.026; Wu, Chen & Wang,
section 3.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.export import tables

from .. import publish
from ..paths import SIMULATED, existing

SPHERE_CENTER = (10.0, 10.0, 1.0)  # m, eq. (19)
SPHERE_RADIUS = float(np.sqrt(200.0))  # m, eq. (19)
SPHERE = np.array([*SPHERE_CENTER, SPHERE_RADIUS])  # a, b, c, r
SPHERE_SIDE = 20.0  # m, x and y lie in [0, 20]
SPHERE_POINTS = 500
SPHERE_DECIMALS = 2
GROSS_POINTS = (12, 15, 53, 67, 465)  # counted from 1, as in the paper
GROSS_DEPTH = (1.5, 2.6)  # m towards the centre
SEED = 2017  # of the sphere study: the committed clouds are its trial 0

SPHERE_FILES = {
    False: SIMULATED / "ou_liu_2017_sphere_clean.csv",
    True: SIMULATED / "ou_liu_2017_sphere_gross.csv",
}


def sphere_cloud(
    generator: np.random.Generator, n: int = SPHERE_POINTS, decimals: int = SPHERE_DECIMALS
) -> NDArray[np.float64]:
    """Draw a cloud on the upper cap of the sphere of eq. (19).

        x, y ~ U(0, 20) m,   z = 1 + √(200 - (x - 10)² - (y - 10)²) m,   rounded to `decimals`

    The corners of the square touch the equator, so z is real everywhere.

    Parameters
    ----------
    generator : source of the 2n uniform numbers; the first points stay the same when n grows.
    n : number of points.
    decimals : decimals kept of the coordinates in metres.

    Returns
    -------
    (n, 3) points, m.

    Example
    -------
    >>> points = sphere_cloud(np.random.default_rng(0), n=2)
    >>> points
    array([[12.74,  5.4 , 14.09],
           [ 0.82,  0.33,  5.71]])
    """
    return _on_cap(_draw_plan(generator, n), decimals)


def sphere_redraws(n_trials: int, seed: int = SEED, gross: bool = False) -> NDArray[np.float64]:
    """Repeat the simulation: a stack of independent clouds, 12 kB each.

    Trial i draws from the i-th child of ``SeedSequence(seed)``, so it stays the same when the
    number of trials grows. The depths are drawn after the cloud, so trial i with gross errors is
    trial i without them except for the five replaced points.

    Parameters
    ----------
    n_trials : number of clouds, B.
    seed : seed of the study.
    gross : whether the points `GROSS_POINTS` are gross errors: moved towards the centre by
        U(1.5, 2.6) m and rounded again. The paper gives the numbers of the points, not the errors;
        what it implies is their side and size. The algebraic residual of a distance d is
        d (2R + d): if all gross distances had the same size, σ0/(2Rσs) would be 1 + d/(2R), and the
        printed 5.2191/(2R · 0.20223) = 0.912 is below 1, so d < 0: inside. And 500 σs² ≈ 20 m²
        shared by five points makes them 2 m each.

    Returns
    -------
    (B, 500, 3) points, m.

    Example
    -------
    >>> bool(np.all(sphere_redraws(3)[:2] == sphere_redraws(2)))
    True
    """
    plans = np.empty((n_trials, SPHERE_POINTS, 2))
    depths = np.empty((n_trials, len(GROSS_POINTS)))
    for trial, child in enumerate(np.random.SeedSequence(seed).spawn(n_trials)):
        generator = np.random.default_rng(child)
        plans[trial] = _draw_plan(generator, SPHERE_POINTS)
        depths[trial] = _draw_depths(generator, len(GROSS_POINTS))
    points = _on_cap(plans, SPHERE_DECIMALS)
    return _moved_inside(points, depths) if gross else points


def write_sphere_clouds() -> list[Path]:
    """Write the clean and the gross cloud, trial 0 of the study, and return the two files.

    Columns: number (from 1), x_m, y_m, z_m (two decimals), gross (1 for a replaced point, else 0).

    Example
    -------
    >>> import os, tempfile
    >>> from unittest.mock import patch
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with patch.dict(os.environ, {"ANALYSIS_OUTPUT": folder}):
    ...         [path.name for path in write_sphere_clouds()]
    ['ou_liu_2017_sphere_clean.csv', 'ou_liu_2017_sphere_gross.csv']
    """
    written = []
    for gross, path in SPHERE_FILES.items():
        frame = pd.DataFrame(sphere_redraws(1, gross=gross)[0], columns=["x_m", "y_m", "z_m"])
        frame.insert(0, "number", np.arange(1, len(frame) + 1))
        frame["gross"] = (frame["number"].isin(GROSS_POINTS) & gross).astype(int)
        written.append(publish.write(frame, path, float_format=f"%.{SPHERE_DECIMALS}f"))
    return written


def read_sphere_cloud(gross: bool) -> NDArray[np.float64]:
    """Read the committed cloud, without or with gross errors: (500, 3) points, m.

    Example
    -------
    >>> read_sphere_cloud(gross=True).shape
    (500, 3)
    """
    return tables.read(existing(SPHERE_FILES[gross]))[["x_m", "y_m", "z_m"]].to_numpy()


def _draw_plan(generator: np.random.Generator, n: int) -> NDArray[np.float64]:
    """Draw (n, 2) plan coordinates x, y, m."""
    return generator.uniform(0.0, SPHERE_SIDE, size=(n, 2))


def _draw_depths(generator: np.random.Generator, n: int) -> NDArray[np.float64]:
    """Draw (n,) distances of gross errors below the sphere, m."""
    return generator.uniform(*GROSS_DEPTH, size=n)


def _on_cap(plan: NDArray[np.float64], decimals: int) -> NDArray[np.float64]:
    """Return the rounded points (…, n, 3) of the upper cap above plan coordinates (…, n, 2)."""
    a, b, c = SPHERE_CENTER
    x, y = plan[..., 0], plan[..., 1]
    points = np.empty((*plan.shape[:-1], 3))
    points[..., :2] = plan
    points[..., 2] = c + np.sqrt(SPHERE_RADIUS**2 - (x - a) ** 2 - (y - b) ** 2)
    return np.round(points, decimals, out=points)


def _moved_inside(points: NDArray[np.float64], depths: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a copy of (…, 500, 3) points, the gross ones moved inwards by depths (…, 5), m."""
    moved = points.copy()
    rows = np.asarray(GROSS_POINTS) - 1
    radial = points[..., rows, :] - SPHERE_CENTER
    radial /= np.linalg.norm(radial, axis=-1, keepdims=True)
    inside = points[..., rows, :] - depths[..., None] * radial
    moved[..., rows, :] = np.round(inside, SPHERE_DECIMALS)
    return moved
