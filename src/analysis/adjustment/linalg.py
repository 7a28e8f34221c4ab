"""Precision of parameters: unit-weight standard deviation and cofactors; systems of equations.

Nothing here knows a geometry. A *cofactor* is an unscaled covariance; the covariance is the
cofactor times the square of the unit-weight standard deviation that belongs to it.
"""

from __future__ import annotations

import numpy as np


def unit_weight_sd(objective, redundancy: int):
    """Unit-weight standard deviation ``σ0 = √(Φ / (n − t))``.

    objective : (…) weighted sum of squared residuals Φ, in the unit of its residuals squared
    redundancy : n − t, observations less parameters; with none σ0 is not defined and NaN

    Source: Ou & Liu 2017, eq. (18), left.

    >>> float(unit_weight_sd(18.0, 2))
    3.0
    """
    objective = np.asarray(objective, dtype=float)
    if redundancy <= 0:
        return np.full(objective.shape, np.nan)[()]
    return np.sqrt(objective / redundancy)


def cofactor_from_factor(R: np.ndarray) -> np.ndarray:
    """Cofactor ``(RᵀR)⁻¹ = R⁻¹R⁻ᵀ`` of parameters from a triangular factor ``(…, m, m)``."""
    root = solve(R, np.broadcast_to(np.eye(R.shape[-1]), R.shape))
    return root @ root.mT


def cofactor_from_normal(N: np.ndarray) -> np.ndarray:
    """Cofactor ``N⁻¹`` of parameters from a normal matrix ``(…, m, m)``, exactly symmetric."""
    cofactor = solve(N, np.broadcast_to(np.eye(N.shape[-1]), N.shape))
    return 0.5 * (cofactor + cofactor.mT)


def propagate(cofactor: np.ndarray, jacobian: np.ndarray) -> np.ndarray:
    """Cofactor propagation ``J Q Jᵀ``.

    >>> propagate(np.eye(2), np.array([[1.0, 1.0]]))
    array([[2.]])
    """
    return jacobian @ cofactor @ jacobian.mT


def solve(N: np.ndarray, right: np.ndarray) -> np.ndarray:
    """``N x = right`` for a stack; a singular system gives NaN and leaves the others alone.

    ``right`` is a stack of matrices ``(…, m, k)``. (numpy alone gives up the whole stack.)

    >>> solve(np.array([[[2.0]], [[0.0]]]), np.array([[[1.0]], [[1.0]]])).ravel()
    array([0.5, nan])
    """
    try:
        return np.linalg.solve(N, right)
    except np.linalg.LinAlgError:
        lead = np.broadcast_shapes(N.shape[:-2], right.shape[:-2])
        N, right = (np.broadcast_to(one, lead + one.shape[-2:]) for one in (N, right))
        solution = np.full(right.shape, np.nan)
        for index in np.ndindex(lead):
            try:
                solution[index] = np.linalg.solve(N[index], right[index])
            except np.linalg.LinAlgError:
                continue
        return solution
