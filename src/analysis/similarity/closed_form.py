"""The similarity of pairs in closed form, by singular value decomposition."""

from __future__ import annotations

import numpy as np

from ..checks import weight_array
from .pairs import mean, paired


def umeyama(
    source, target, *, scale: bool = True, weights=None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """``min Σ w |X − t − μ R x|²`` in closed form: μ (…), R (…, 3, 3) with det +1, t (…, 3).

        H = Σ w ΔX Δxᵀ = U S Vᵀ,   R = U D Vᵀ,   D = diag(1, 1, det UVᵀ),   μ = tr(S D)/Σ w |Δx|²,
        t = X̄ − μ R x̄

    Parameters, errors: as of :func:`~analysis.fit_similarity`. Any rotation, points in a plane too.

    Source: Kabsch 1976, Acta Crystallographica A 32, 922-923; Umeyama 1991, IEEE Transactions on
    Pattern Analysis and Machine Intelligence 13, 376-380, eqs. (40)-(43).

    Example
    -------
    >>> mu, R, t = umeyama([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[5, 5, 5], [5, 7, 5], [3, 5, 5]])
    >>> round(float(mu), 12), R.round(12) + 0, t.round(12)
    (2.0, array([[ 0., -1.,  0.],
           [ 1.,  0.,  0.],
           [ 0.,  0.,  1.]]), array([5., 5., 5.]))
    """
    x, X = paired(source, target)
    w = np.ones(x.shape[:-1]) if weights is None else weight_array(weights, x.shape[:-1])
    centre, image = mean(x, w), mean(X, w)
    mu, R, T = umeyama_centred(x - centre[..., None, :], X - image[..., None, :], w, scale)
    return mu[()], R, image + T - mu[..., None] * (R @ centre[..., None])[..., 0]


def umeyama_centred(
    x: np.ndarray, X: np.ndarray, w: np.ndarray, free_scale: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Closed form for stacks that are already centred, with weights w ≥ 0."""
    mean_x, mean_X = mean(x, w), mean(X, w)
    dx, dX = x - mean_x[..., None, :], X - mean_X[..., None, :]
    U, S, Vt = np.linalg.svd((w[..., None] * dX).mT @ dx)
    proper = np.sign(np.linalg.det(U @ Vt))
    S[..., 2] *= proper
    R = np.concatenate([U[..., :2], U[..., 2:] * proper[..., None, None]], axis=-1) @ Vt
    mu = np.ones(S.shape[:-1])
    if free_scale:
        mu = np.sum(S, axis=-1) / np.sum(w * np.sum(dx**2, axis=-1), axis=-1)
    return mu, R, mean_X - mu[..., None] * (R @ mean_x[..., None])[..., 0]
