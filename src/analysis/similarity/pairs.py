"""Pairs of points known in two frames: what they must be, and a stack of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..adjustment.iteration import Stack
from ..checks import check_positive, covariance_array, finite_array, weight_array

SMALLEST = 3  # pairs that determine a similarity
LINE = 1e-6  # points with a spread across below this part of the one along lie on a line


@dataclass(frozen=True)
class Pairs(Stack):
    """Pairs of a stack of problems about their centroids.

    x, X : (B, n, 3) m; Q_x, Q_X : (B, n, 3, 3) their cofactors; w : (B, n) weights for the start
    rounding : (B,) of the given coordinates in m; misclosures below it are no reason to lose weight
    """

    x: np.ndarray
    X: np.ndarray
    Q_x: np.ndarray
    Q_X: np.ndarray
    w: np.ndarray
    rounding: np.ndarray


def paired(source, target, smallest: int = SMALLEST) -> tuple[np.ndarray, np.ndarray]:
    """Both sets as (…, n, 3), checked: as many here as there, enough, and not on a line."""
    x, X = finite_array(source, "source"), finite_array(target, "target")
    for points, name in [(x, "source"), (X, "target")]:
        if points.ndim < 2 or points.shape[-1] != 3:
            raise ValueError(f"{name}: expected shape (…, n, 3), got {points.shape}")
    if x.shape[-2] != X.shape[-2]:
        raise ValueError(
            "source, target: expected pairs, as many points in both, "
            f"got {x.shape[-2]} and {X.shape[-2]} (shapes {x.shape}, {X.shape})"
        )
    try:
        lead = np.broadcast_shapes(x.shape[:-2], X.shape[:-2])
    except ValueError:
        raise ValueError(
            f"source, target: expected stacks of the same shape, got {x.shape} and {X.shape}"
        ) from None
    n = x.shape[-2]
    if n < smallest:
        what = "a similarity" if smallest == SMALLEST else "a robust one"
        raise ValueError(f"source, target: expected at least {smallest} pairs for {what}, got {n}")
    if 0 in lead:
        raise ValueError(
            "source, target: expected at least one set of pairs, "
            f"got an empty stack of shape {lead + (n, 3)}"
        )
    for points, name in [(x, "source"), (X, "target")]:
        _require_an_area(points, name)
    return np.broadcast_to(x, lead + (n, 3)), np.broadcast_to(X, lead + (n, 3))


def _require_an_area(points: np.ndarray, name: str) -> None:
    singular = np.linalg.svd(points - points.mean(axis=-2, keepdims=True), compute_uv=False)
    line = singular[..., 1] <= LINE * singular[..., 0]
    if line.any():
        count = "" if line.ndim == 0 else f" in {np.count_nonzero(line)} of {line.size} sets"
        raise ValueError(
            f"{name}: expected points that span an area, got points on a line{count}: "
            "the rotation about it is not determined"
        )


def cofactor_matrices(values, shape: tuple[int, ...], name: str) -> np.ndarray:
    """Cofactor matrices ``shape`` + (3, 3) from one variance, variances or matrices."""
    array = finite_array(values, name)
    if array.ndim >= 3 and array.shape[-3:] == (shape[-1], 3, 3):
        return covariance_array(array, shape + (3, 3), name)
    if array.ndim == 0:
        array = np.full(shape, check_positive(array, name))
    return weight_array(array, shape, name)[..., None, None] * np.eye(3)


def cofactors_of_pairs(
    weights, of_source, of_target, shape: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Cofactors ``shape`` + (3, 3) of the points of both frames from what was given of them."""
    if of_source is None and of_target is None:
        variances = np.ones(shape) if weights is None else 1.0 / weight_array(weights, shape)
        return np.zeros(shape + (3, 3)), variances[..., None, None] * np.eye(3)
    if weights is not None:
        raise ValueError("weights: expected None beside cofactors, which say all, got both")
    Q_x, Q_X = (
        np.zeros(shape + (3, 3)) if given is None else cofactor_matrices(given, shape, name)
        for given, name in ((of_source, "source_cofactors"), (of_target, "target_cofactors"))
    )
    return Q_x, Q_X


def mean(points: np.ndarray, w: np.ndarray) -> np.ndarray:
    """Weighted mean (…, 3)."""
    return np.einsum("...n,...ni->...i", w, points) / np.sum(w, axis=-1)[..., None]


def sum_of_squares(points: np.ndarray) -> np.ndarray:
    """``Σ|x − x̄|²``, (…)."""
    return np.sum((points - points.mean(axis=-2, keepdims=True)) ** 2, axis=(-1, -2))


def spread(points: np.ndarray) -> np.ndarray:
    """Root mean square distance from the mean, (…)."""
    return np.sqrt(sum_of_squares(points) / points.shape[-2])
