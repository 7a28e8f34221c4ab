"""Least trimmed squares: the half of the points closest to one surface, whatever the other does.

Source: Rousseeuw & Van Driessen 2006.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.stats import norm

from ..result import Array
from .contracts import ElementalModel, GeometricModel


def majority(n: int, model: GeometricModel) -> int:
    """h = (n + t + 1)/2, the number of points that one surface must fit."""
    return (n + model.degrees + 1) // 2


def absolute_distances(model: GeometricModel, x: Array, D: Array, dtype=np.float64) -> Array:
    """|d| (B, K, n) of points D (B, n, dim) from x (B, K, s); infinite without surface.

    The distances of first order, in single precision where that is enough to rank surfaces.
    """
    d = model.distances(x, D).astype(dtype, copy=False)
    np.abs(d, out=d)
    d[np.isnan(d)] = np.inf
    return d


def sorted_distances(model: GeometricModel, x: Array, D: Array, dtype=np.float64) -> Array:
    """:func:`absolute_distances` in ascending order."""
    d = absolute_distances(model, x, D, dtype)
    d.sort(axis=-1)
    return d


def trimmed_sum(distances: Array, h: int) -> Array:
    """Sum (B, K) of the h smallest squares of ascending distances (B, K, n)."""
    least = distances[..., :h]
    with np.errstate(over="ignore"):
        return np.einsum("...h,...h->...", least, least)


def trimmed_spread(total, h: int, n: int):
    """Standard deviation of n distances from the sum of their h smallest squares."""
    return np.sqrt(total / h / trimmed_variance(h / n))


@cache
def trimmed_variance(share: float) -> float:
    """Mean of u² over the ``share`` of a standard normal sample that is closest to 0."""
    if share >= 1.0:
        return 1.0
    limit = norm.ppf(0.5 * (1.0 + share))
    return 1.0 - 2.0 * limit * norm.pdf(limit) / share


def concentrate(
    model: ElementalModel, x: Array, D: Array, h: int, steps: int
) -> tuple[Array, Array]:
    """Surfaces x (B, K, s) after fits to their h closest points, again and again.

    A step is taken where it lessens the trimmed sum, which an algebraic fit need not. Returns the
    surfaces and their |d| (B, K, n) in ascending order.
    """
    d = absolute_distances(model, x, D)
    ordered = np.sort(d, axis=-1)
    cost = trimmed_sum(ordered, h)
    for _ in range(steps):
        new = model.refit(x, D, (d <= ordered[..., h - 1 : h]).astype(float))
        theirs = absolute_distances(model, new, D)
        in_order = np.sort(theirs, axis=-1)
        now = trimmed_sum(in_order, h)
        better = now < cost
        if not better.any():
            break
        cost, better = np.where(better, now, cost), better[..., None]
        x, d = np.where(better, new, x), np.where(better, theirs, d)
        ordered = np.where(better, in_order, ordered)
    return x, ordered


def closest(distances: Array, h: Array | int) -> Array:
    """1 for the h smallest distances (…, n), 0 for the others; all 1 where there is no surface."""
    distances = np.abs(distances)
    distances[np.isnan(distances)] = np.inf
    rank = np.broadcast_to(np.asarray(h) - 1, distances.shape[:-1])[..., None]
    limit = np.take_along_axis(np.sort(distances, axis=-1), rank, axis=-1)
    return (distances <= limit).astype(float)
