"""Gross errors of other sizes than those of the committed cloud: the paper prints their numbers and
calls them random, no more.

All laws leave, in the mean, the sum of squares that the printed σs of LS in table 2 asks for, 500
σs² ≈ 20 m² for five errors.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from .clouds import (
    GROSS_DEPTH,
    GROSS_POINTS,
    SPHERE_CENTER,
    SPHERE_DECIMALS,
    SPHERE_POINTS,
    sphere_redraws,
)
from .printed_tables import values

_SIGMA_S = values(2, "ls")["sigma_s_m"]
ROOT_MEAN_SQUARE = math.sqrt(SPHERE_POINTS * _SIGMA_S**2 / len(GROSS_POINTS))  # m, of a gross error
WIDEST = math.sqrt(3) * ROOT_MEAN_SQUARE  # m, of a uniform law from 0 with that root mean square

# law -> (standard uniform u, standard normal z) -> depth towards the centre, m
SIZES = {
    "1.5 to 2.6 m inside": lambda u, z: GROSS_DEPTH[0] + u * (GROSS_DEPTH[1] - GROSS_DEPTH[0]),
    "0 to 3.5 m inside": lambda u, z: WIDEST * u,
    "up to 3.5 m, both sides": lambda u, z: WIDEST * (2 * u - 1),
    "normal, 2 m, both sides": lambda u, z: ROOT_MEAN_SQUARE * z,
}
COMMITTED, ANY_SIZE = "1.5 to 2.6 m inside", "0 to 3.5 m inside"


def redraws_of_size(law: str, trials: int, seed: int) -> NDArray[np.float64]:
    """(B, 500, 3) clouds of table 2 with gross errors of one of the `SIZES`; trial i has the good
    points of `sphere_redraws`.

    >>> clouds = redraws_of_size("1.5 to 2.6 m inside", 2, 1)
    >>> bool(np.all(clouds[:, 0] == sphere_redraws(2, 1)[:, 0]))
    True
    """
    points = sphere_redraws(trials, seed)
    rows = np.array(GROSS_POINTS) - 1
    depths = np.empty((trials, len(rows)))
    for trial, child in enumerate(np.random.SeedSequence([seed, len(rows)]).spawn(trials)):
        generator = np.random.default_rng(child)
        depths[trial] = SIZES[law](
            generator.uniform(size=len(rows)), generator.standard_normal(len(rows))
        )
    radial = points[:, rows] - SPHERE_CENTER
    radial /= np.linalg.norm(radial, axis=-1, keepdims=True)
    points[:, rows] = np.round(points[:, rows] - depths[..., None] * radial, SPHERE_DECIMALS)
    return points


def redraws_of_any_size(trials: int, seed: int) -> NDArray[np.float64]:
    """The clouds with gross errors of 0 to 3.5 m, some of which hide below k0 σ."""
    return redraws_of_size(ANY_SIZE, trials, seed)
