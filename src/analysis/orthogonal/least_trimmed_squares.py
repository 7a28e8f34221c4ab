"""Least trimmed squares: the half of the points that lie closest to one surface, whatever the other
half does.

Elemental samples give trial surfaces; the best go through concentration steps, and the one with the
least sum of the h smallest squared distances is where a robust adjustment starts from.

Source: Rousseeuw & Van Driessen 2006.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.stats import norm

from ..adjustment.linalg import solve
from ..blocks import BLOCK, pieces
from .cloud import GeometricModel

# elemental samples: with half of the points bad, about 12 of 200 four-point samples are clean
SAMPLES = 200
CANDIDATES = 8  # samples that are followed by concentration steps
# points the start looks at: with 45 % bad ones, chance makes hardly ever half of them bad
SUBSET = 1000


def least_trimmed_squares(
    model: GeometricModel, D: np.ndarray, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """Surface with the least sum of the h = (n + t + 1)/2 smallest squared distances, and its
    consistent scale.

    Elemental samples, the best followed by concentration steps (fit, keep the h closest, fit
    again). The points D (B, n, dim) come in an order of their own, so that the samples do not
    depend on the order given. All points are treated alike: a small cofactor does not make a point
    a good one. Returns x (B, s) and the spread of the distances (B,) as a standard deviation.
    """
    generator = np.random.default_rng(seed)
    n = D.shape[1]
    h = (n + model.degrees + 1) // 2
    draws = np.argsort(generator.uniform(size=(SAMPLES, n)), axis=-1)[:, : model.sample]
    x = model.through(D[:, draws])  # (B, S, s)
    # A few clouds at a time: the distances from every sample are many, and should not leave the
    # cache.
    parts = pieces(len(D), max(1, 4 * BLOCK // (SAMPLES * n)))
    cost = np.concatenate([trimmed_sum(model, x[part], D[part], h) for part in parts])
    best = np.argsort(cost, axis=-1)[:, :CANDIDATES]
    x = np.take_along_axis(x, best[..., None], axis=1)
    for _ in range(4):
        x = _concentrated(model, x, D, h)
    best = np.argmin(trimmed_sum(model, x, D, h), axis=-1)
    x = np.take_along_axis(x, best[:, None, None], axis=1)
    for _ in range(20):
        x, before = _concentrated(model, x, D, h), x
        if np.array_equal(x, before):
            break
    x = x[:, 0]
    if model.holds:
        x = model.held(x)
        for _ in range(20):
            x = _concentrated_with_held(model, x, D, h)
    sigma = np.sqrt(trimmed_sum(model, x[:, None], D, h)[:, 0] / h / trimmed_variance(h / n))
    return x, sigma


def trimmed_sum(model, x, D, h: int) -> np.ndarray:
    """Sum of the h smallest squared distances from each of the surfaces x (B, K, s), (B, K);
    infinite where there is none.
    """
    squares = model.distances(x, D)
    np.square(squares, out=squares)
    squares[np.isnan(squares)] = np.inf
    squares.partition(h - 1, axis=-1)
    return np.sum(squares[..., :h], axis=-1)


def _concentrated(model, x, D, h: int) -> np.ndarray:
    """One concentration step of each x (B, K, s): the fit to its h closest points, which lessens
    the fit's own trimmed sum.
    """
    new = model.algebraic(D[:, None], closest(model.distances(x, D), h))
    return np.where(np.isfinite(new).all(axis=-1, keepdims=True), new, x)


def _concentrated_with_held(model, x, D, h: int) -> np.ndarray:
    """The same with held parameters: one Gauss-Newton step of the free ones on the h closest
    points.
    """
    f, J = model.linearised(x, D)
    weighed = J * closest(f, h)[:, None, :]
    new = model.moved(x, -solve(weighed @ J.swapaxes(-1, -2), weighed @ f[..., None])[..., 0])
    return np.where(np.isfinite(new).all(axis=-1, keepdims=True), new, x)


def closest(distances: np.ndarray, h: int) -> np.ndarray:
    """1 for the h smallest distances, 0 for the others; all of them where there is no surface."""
    distances = np.abs(distances)
    distances[np.isnan(distances)] = np.inf
    return (distances <= np.partition(distances, h - 1, axis=-1)[..., h - 1 : h]).astype(float)


@cache
def trimmed_variance(share: float) -> float:
    """Mean of u² over the ``share`` of a standard normal sample that is closest to 0."""
    if share >= 1.0:
        return 1.0
    limit = norm.ppf(0.5 * (1.0 + share))
    return 1.0 - 2.0 * limit * norm.pdf(limit) / share
