"""Least trimmed squares: the half of the points closest to one surface, whatever the other does.

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
from ..result import Array
from .contracts import ElementalModel, GeometricModel

# elemental samples: with half of the points bad, about 12 of 200 four-point samples are clean
SAMPLES = 200
CANDIDATES = 8  # samples that are followed by concentration steps
# points the start looks at: with 45 % bad ones, chance makes hardly ever half of them bad
SUBSET = 1000


def least_trimmed_squares(model: ElementalModel, D: Array, seed: int) -> tuple[Array, Array]:
    """Surface with the least sum of the h = (n + t + 1)/2 smallest squared distances.

    Elemental samples, the best followed by concentration steps (fit, keep the h closest, fit
    again). The points D (B, n, dim) come in an order of their own, so that the samples do not
    depend on the order given. All points are treated alike: a small cofactor does not make a point
    a good one. Returns x (B, s) and the spread of the distances (B,) as a standard deviation.
    """
    generator = np.random.default_rng(seed)
    n = D.shape[1]
    h = majority(n, model)
    # 1. surfaces through samples of points
    draws = np.argsort(generator.uniform(size=(SAMPLES, n)), axis=-1)[:, : model.sample]
    x = model.minimal_fit(D[:, draws])  # (B, S, s)
    # A few clouds at a time: the distances from every sample are many, and should not leave the
    # cache.
    parts = pieces(len(D), max(1, 4 * BLOCK // (SAMPLES * n)))
    cost = np.concatenate([trimmed_sum(model, x[part], D[part], h) for part in parts])
    # 2. a few concentration steps of the best of them
    best = np.argsort(cost, axis=-1)[:, :CANDIDATES]
    x = np.take_along_axis(x, best[..., None], axis=1)
    for _ in range(4):
        x = _concentrate(model, x, D, h)
    # 3. the best one to the end
    best = np.argmin(trimmed_sum(model, x, D, h), axis=-1)
    x = np.take_along_axis(x, best[:, None, None], axis=1)
    for _ in range(20):
        x, before = _concentrate(model, x, D, h), x
        if np.array_equal(x, before):
            break
    x = x[:, 0]
    if model.fixed:
        x = model.with_fixed(x)
        for _ in range(20):
            x = _concentrate_free(model, x, D, h)
    return x, trimmed_spread(trimmed_sum(model, x[:, None], D, h)[:, 0], h, n)


def majority(n: int, model: GeometricModel) -> int:
    """h = (n + t + 1)/2, the number of points that one surface must fit."""
    return (n + model.degrees + 1) // 2


def trimmed_sum(model: GeometricModel, x: Array, D: Array, h: int) -> Array:
    """Sum (B, K) of the h smallest squared distances from x (B, K, s); infinite without surface."""
    squares = model.distances(x, D)
    np.square(squares, out=squares)
    squares[np.isnan(squares)] = np.inf
    squares.partition(h - 1, axis=-1)
    return np.sum(squares[..., :h], axis=-1)


def trimmed_spread(total: Array, h: int, n: int) -> Array:
    """Standard deviation of n distances from the sum of their h smallest squares."""
    return np.sqrt(total / h / _trimmed_variance(h / n))


@cache
def _trimmed_variance(share: float) -> float:
    """Mean of u² over the ``share`` of a standard normal sample that is closest to 0."""
    if share >= 1.0:
        return 1.0
    limit = norm.ppf(0.5 * (1.0 + share))
    return 1.0 - 2.0 * limit * norm.pdf(limit) / share


def _concentrate(model: ElementalModel, x: Array, D: Array, h: int) -> Array:
    """Fit of each x (B, K, s) to its h closest points, which lessens its own trimmed sum."""
    new = model.algebraic(D[:, None], closest(model.distances(x, D), h))
    return np.where(np.isfinite(new).all(axis=-1, keepdims=True), new, x)


def _concentrate_free(model: GeometricModel, x: Array, D: Array, h: int) -> Array:
    """One Gauss-Newton step of the free parameters of x (B, s) on its h closest points."""
    f, J = model.linearised(x, D)
    weighed = J * closest(f, h)[:, None, :]
    new = model.update(x, -solve(weighed @ J.swapaxes(-1, -2), weighed @ f[..., None])[..., 0])
    return np.where(np.isfinite(new).all(axis=-1, keepdims=True), new, x)


def closest(distances: Array, h: int) -> Array:
    """1 for the h smallest distances, 0 for the others; all 1 where there is no surface."""
    distances = np.abs(distances)
    distances[np.isnan(distances)] = np.inf
    return (distances <= np.partition(distances, h - 1, axis=-1)[..., h - 1 : h]).astype(float)
