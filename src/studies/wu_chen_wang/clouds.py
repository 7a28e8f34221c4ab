"""The simulated plane of Wu, Chen & Wang, as committed and drawn again.

Section 3 of the paper gives the plane z = x + 3y + 1, 100 points, ten runs, and the noise of each
coordinate, N(0, σ²/cos θ) with the incidence angle θ of a beam from the origin. Not the extent of
the patch and not σ:
those are recovered from what is printed of the results (`recovery`).

Source: Wu, Chen & Wang, section 3.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.special import ndtri

from analysis.export import tables
from analysis.surfaces.plane_eiv import incidence_cosines

from .. import publish
from ..paths import SIMULATED, existing

PLANE = (1.0, 3.0, 1.0)  # a, b, c of z = a x + b y + c, c in m
PLANE_POINTS = 100
PLANE_RUNS = 10  # that the paper averages
PLANE_SIDE = 0.2  # m, recovered
PLANE_SIGMA = float(np.sqrt(0.0005))  # m, recovered: 2.24 cm
PLANE_DECIMALS = 6  # so that a file holds the points as they are
PLANE_SEED = 131  # of the plane study: the committed runs are its trials 0 to 9
PLANE_FILE = SIMULATED / "wu_chen_wang_plane_runs.csv"

# Where x and y may lie: name -> their values for side 1 m from uniform numbers in [0, 1]. All have
# the same standard deviation.
PLANE_LAYOUTS: dict[str, Callable[[NDArray], NDArray]] = {
    "square from the origin": lambda uniform: uniform,
    "square about the origin": lambda uniform: uniform - 0.5,
    "normal about the origin": lambda uniform: ndtri(uniform) / np.sqrt(12.0),
    "normal, same centre as the first": lambda uniform: 0.5 + ndtri(uniform) / np.sqrt(12.0),
}


def plane_draws(
    n_trials: int, seed: int = PLANE_SEED
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The random numbers of the plane simulation: uniform (B, 100, 2) for x and y, standard normal
    (B, 100, 3) for the noise.

    Trial i draws from the i-th child of ``SeedSequence(seed)``, so it stays the same when the
    number of trials grows.

    Example
    -------
    >>> [bool(np.all(many[:2] == few)) for many, few in zip(plane_draws(3), plane_draws(2))]
    [True, True]
    """
    uniform, normal = np.empty((n_trials, PLANE_POINTS, 2)), np.empty((n_trials, PLANE_POINTS, 3))
    for trial, child in enumerate(np.random.SeedSequence(seed).spawn(n_trials)):
        generator = np.random.default_rng(child)
        uniform[trial] = generator.uniform(size=(PLANE_POINTS, 2))
        normal[trial] = generator.standard_normal((PLANE_POINTS, 3))
    return uniform, normal


def plane_clouds(
    draws: tuple[NDArray[np.float64], NDArray[np.float64]],
    side: float = PLANE_SIDE,
    sigma: float = PLANE_SIGMA,
    layout: str = "square from the origin",
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Noisy points on z = x + 3y + 1 m, and the cosines of the incidence angles at the points
    without noise.

        p = p̄ + σ/√cos θ · e,   cos θ = |n·p̄|/|p̄|,   e ~ N(0, I),   rounded to 1 µm

    Parameters
    ----------
    draws : of `plane_draws`.
    side : L of the patch, m; of a normal layout √12 standard deviations.
    sigma : standard deviation of a coordinate at perpendicular incidence, m.
    layout : a name from `PLANE_LAYOUTS`.

    Returns
    -------
    (B, n, 3) points, m, and (B, n) cosines.

    Example
    -------
    >>> points, cosines = plane_clouds(plane_draws(1), sigma=1e-9)
    >>> bool(np.abs(points @ [1, 3, -1] + 1).max() < 1e-5), bool(cosines.max() < 0.302)
    (True, True)
    """
    uniform, normal = draws
    a, b, c = PLANE
    points = np.empty(normal.shape)
    points[..., :2] = side * PLANE_LAYOUTS[layout](uniform)
    points[..., 2] = points[..., :2] @ [a, b] + c
    cosines = incidence_cosines(points, PLANE)
    points += sigma / np.sqrt(cosines)[..., None] * normal
    return np.round(points, PLANE_DECIMALS, out=points), cosines


def write_plane_runs() -> Path:
    """Write the ten runs, trials 0 to 9 of the study at the recovered setting, and return the file.

    Columns: run and number (from 1), x_m, y_m, z_m (six decimals).

    Example
    -------
    >>> import os, tempfile
    >>> from unittest.mock import patch
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with patch.dict(os.environ, {"ANALYSIS_OUTPUT": folder}):
    ...         write_plane_runs().name
    'wu_chen_wang_plane_runs.csv'
    """
    points, _ = plane_clouds(plane_draws(PLANE_RUNS))
    frame = pd.DataFrame(points.reshape(-1, 3), columns=["x_m", "y_m", "z_m"])
    run, number = np.divmod(np.arange(len(frame)), PLANE_POINTS)
    frame.insert(0, "run", run + 1)
    frame.insert(1, "number", number + 1)
    return publish.write(frame, PLANE_FILE, float_format=f"%.{PLANE_DECIMALS}f")


def read_plane_runs() -> NDArray[np.float64]:
    """Read the committed runs: (10, 100, 3) points, m.

    Example
    -------
    >>> read_plane_runs().shape
    (10, 100, 3)
    """
    return (
        tables.read(existing(PLANE_FILE))[["x_m", "y_m", "z_m"]]
        .to_numpy()
        .reshape(PLANE_RUNS, PLANE_POINTS, 3)
    )
