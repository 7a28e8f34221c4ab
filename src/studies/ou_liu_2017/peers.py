"""Sphere fits of other libraries, to be set beside ours on the same points.

They are used as their documentation offers them, with what helps them: coordinates reduced to the
centroid, the analytic Jacobian, and LS as start. A robust loss must be told the scale above which a
residual counts as large (``f_scale``); scipy's own value is 1 m. Two others are tried: one from the
data, as is usual, and one that knows the noise.

Sources: SciPy, ``scipy.optimize.least_squares``; scikit-spatial, ``Sphere.best_fit``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from skspatial.objects import Sphere

from analysis.adjustment.weights import MAD_TO_SD
from analysis.methods import fit_sphere

LOSSES = ("soft_l1", "cauchy")
LIBRARY = "scikit-spatial"


def best_fit(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(a, b, c, r) in m by scikit-spatial's ``Sphere.best_fit``, an algebraic least-squares fit.

    >>> directions = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0], [0, -1, 0.0]])
    >>> best_fit([10, 10, 1] + 2 * directions).round(9).tolist()
    [10.0, 10.0, 1.0, 2.0]
    """
    sphere = Sphere.best_fit(points)
    return np.array([*sphere.point, sphere.radius])


def robust_loss(
    points: NDArray[np.float64], loss: str, scale: float | None = None
) -> NDArray[np.float64]:
    """(a, b, c, r) in m that minimises ``Σ ρ(d²/scale²)`` over the distances d, by
    ``scipy.optimize.least_squares`` from the LS sphere.

    loss : ``"soft_l1"`` or ``"cauchy"``; scale : m, or None for 1.4826 times the median distance
        from the LS sphere.

    >>> directions = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0], [0, -1, 0.0]])
    >>> robust_loss([10, 10, 1] + 2 * directions, "cauchy", 0.001).round(9).tolist()
    [10.0, 10.0, 1.0, 2.0]
    """
    start = fit_sphere(points, "ls")
    if scale is None:
        scale = MAD_TO_SD * float(np.median(np.abs(start.distances)))
    origin = points.mean(axis=0)
    centred = points - origin

    def distances(x):
        return np.linalg.norm(centred - x[:3], axis=1) - x[3]

    def jacobian(x):
        directions = x[:3] - centred
        directions /= np.linalg.norm(directions, axis=1)[:, None]
        return np.column_stack([directions, -np.ones(len(centred))])

    tight = dict.fromkeys(("xtol", "ftol", "gtol"), 1e-12)
    found = least_squares(
        distances, start.parameters - [*origin, 0.0], jacobian, loss=loss, f_scale=scale, **tight
    )
    return found.x + [*origin, 0.0]
