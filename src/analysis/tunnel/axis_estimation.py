"""The axis of a tunnel from points of its lining, through robust section centres.

The middle between the extreme points of thin bins, as printed by Li et al. (2015), is pulled by cut
ends, track bed and cables. Here the axis goes through the centres of the section's circle with its
ovality, found by robust regression about the axis before, until it no longer moves.
"""

from __future__ import annotations

from dataclasses import replace
from math import factorial

import numpy as np
from scipy.interpolate import BSpline
from scipy.ndimage import median_filter

from ..adjustment.linalg import cofactor_from_normal, solve
from ..adjustment.weights import ROUNDED_MAD_TO_SD, Bisquare
from ..blocks import pieces
from ..checks import check_positive
from .axis import Axis, local_frame, tunnel_points
from .medians import group_medians

# A quadratic departs from a circular arc by about L⁴/(1024 R³): 0.5 mm for 60 m of a 300 m radius,
# but 3.6 mm and 1.2 mrad for 100 m.
LONGEST_QUADRATIC = 60.0  # m
LONGEST_SPLINE_PIECE = 30.0  # m
SAMPLE = 2_000_000  # points the robust axis looks at
CELLS = 120  # directions in which a slab is described by one median radius
OPENINGS = (30, 45, 60, 75)  # degrees between the three directions of a trial circle
HARMONICS = 5  # 1, sin α, cos α, sin 2α, cos 2α
SETTLED = 1e-4  # m, largest motion of an axis that has been found
BISQUARE = Bisquare()
RADII = (0.3, 30.0)  # m; a tunnel beyond these is one in other units


def robust_axis(points, *, slab: float = 1.0, seed: int = 0, max_iterations: int = 30) -> Axis:
    """Axis through section centres that track bed, cables and cut ends do not pull.

    From a first axis, repeated until it moves by no more than 0.1 mm: polar coordinates of the
    points about their own foot points; in slabs of ``slab`` m the median radius in each of 120
    directions; in each slab

        ρ(α) = r + u₀ sin α + v₀ cos α + c₂ cos 2α + s₂ sin 2α

    by robust regression (trial circles with the least median residual, then bisquare weights); the
    centre (u₀, v₀) with its standard deviation; the curve through the centres, again robust: one
    quadratic up to 60 m, else a cubic spline in pieces of up to 30 m. The terms in 2α keep the
    ovality of a ring that is not seen all around from moving its centre.

    Parameters
    ----------
    points : (n, 3) in m, any horizontal direction, Z up. Of more than 2 million a random 2 million
        are used.
    slab : length of the slabs, m; at low density of points take longer ones.
    seed : of the random choice.

    Returns
    -------
    Axis from where the points of the first slab with a centre begin to where those of the last one
    end.

    Raises
    ------
    ValueError : no tunnel by its extents or its radius (other units?), or fewer than 3 slabs with a
        centre.

    >>> y, turn = np.arange(20_000) * 1e-3, np.arange(20_000) * 2.4
    >>> z = np.maximum(2.7 * np.sin(turn), -2.0)  # with a floor
    >>> tube = np.stack([2.7 * np.cos(turn), y, z], axis=-1)
    >>> axis = robust_axis(tube)
    >>> bool(np.abs(axis.position(axis.at_chainage([1.0, 9.0]))[:, [0, 2]]).max() < 5e-4)
    True
    """
    points, slab = tunnel_points(points), check_positive(slab, "slab")
    if len(points) > SAMPLE:
        points = points[np.random.default_rng(seed).integers(0, len(points), SAMPLE)]
    axis = _first_axis(points, slab)
    for iteration in range(1, max_iterations + 1):
        y, centers, sd, ends = _slab_centers(points, axis, slab)
        x, z = axis.local_curve(y)[0]
        right, up, _ = axis._local_frame(axis.local_curve(y)[1])
        moved = np.stack([x, y, z], axis=-1) + centers[:, :1] * right + centers[:, 1:] * up
        new = _curve(
            axis.origin, axis.rotation, moved[:, 1], moved[:, [0, 2]], 1.0 / (sd**2 + 1e-6), ends
        )
        shift = np.abs(new.local_curve(y)[0] - axis.local_curve(y)[0]).max()
        axis = new
        if shift <= SETTLED:
            return replace(axis, iterations=iteration, stop_reason="the axis stands still")
    return replace(
        axis,
        iterations=max_iterations,
        converged=False,
        stop_reason=f"not converged: the axis still moved by {shift:.2g} m",
    )


def _first_axis(points: np.ndarray, slab: float) -> Axis:
    """Through the middles of the 2 % and 98 % quantiles of x and z in slabs."""
    origin, rotation = local_frame(points)
    local = (points - origin) @ rotation.T
    of = np.floor(local[:, 1] / slab).astype(np.int64)
    order = np.argsort(of, kind="stable")
    slabs, starts = np.unique(of[order], return_index=True)
    groups = [local[part] for part in np.split(order, starts[1:]) if len(part) >= 20]
    if len(groups) < 3:
        raise ValueError(
            f"points: expected at least 3 slabs of {slab:g} m with 20 points or more, got "
            f"{len(groups)} of {len(slabs)}; are these metres, and the slabs long enough for the "
            "density?"
        )
    quantiles = np.array([np.quantile(group[:, [0, 2]], [0.02, 0.98], axis=0) for group in groups])
    radius = 0.5 * np.median(np.diff(quantiles, axis=1))
    if not RADII[0] < radius < RADII[1]:
        raise ValueError(
            f"points: expected a tunnel with a radius of {RADII[0]:g} to {RADII[1]:g} m, got about "
            f"{radius:.4g}; are these metres?"
        )
    y = np.array([group[:, 1].mean() for group in groups])
    return _curve(origin, rotation, y, quantiles.mean(axis=1), np.ones(len(y)), (y[0], y[-1]))


def _slab_centers(
    points: np.ndarray, axis: Axis, slab: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, tuple[float, float]]:
    """Local y (K,), centres (K, 2) right and up of the axis, and their standard deviations (K,), m.

    Of the slabs that have a centre; and the local y at which the points of the first of these begin
    and those of the last one end.
    """
    y, rho, alpha = axis.polar(points)
    of = np.floor(y / slab).astype(np.int64)
    slabs, of = np.unique(of, return_inverse=True)
    cell = np.minimum(((alpha / (2.0 * np.pi) + 0.5) * CELLS).astype(np.int64), CELLS - 1)
    medians = group_medians(of * CELLS + cell, rho, len(slabs) * CELLS).reshape(-1, CELLS)
    seen = np.count_nonzero(np.isfinite(medians), axis=-1) >= 4 * HARMONICS
    angles = 2.0 * np.pi * ((np.arange(CELLS) + 0.5) / CELLS - 0.5)
    X = np.stack(
        [np.ones(CELLS), np.sin(angles), np.cos(angles), np.sin(2 * angles), np.cos(2 * angles)],
        axis=-1,
    )
    rho = medians[seen]
    start = [_residuals_of_best_circle(X[:, :3], rho[part]) for part in pieces(len(rho), 64)]
    x, cofactor, scale, used = _reweighted(
        X, rho, np.ones_like(rho), np.concatenate([np.empty((0, CELLS)), *start])
    )
    sd = scale * np.sqrt(0.5 * (cofactor[:, 1, 1] + cofactor[:, 2, 2]))
    found = np.isfinite(sd) & (used >= 2 * HARMONICS) & (sd < 0.1 * x[:, 0])
    if np.count_nonzero(found) < 3:
        raise ValueError(
            f"points: expected at least 3 slabs of {slab:g} m in which a ring is seen, got "
            f"{np.count_nonzero(found)}"
        )
    used = np.flatnonzero(seen)[found]
    ends = float(y[of == used[0]].min()), float(y[of == used[-1]].max())
    return (slabs[used] + 0.5) * slab, x[found, 1:3], sd[found], ends


def _residuals_of_best_circle(X: np.ndarray, rho: np.ndarray) -> np.ndarray:
    """Residuals (K, J) of radii (K, J) from the trial circle with the least median |residual|.

    Half of the radii cannot spoil it. Each trial circle goes through three radii; there are trials
    at all places and of several widths.
    """
    first = np.arange(0, CELLS, 2)
    openings = [round(degrees * CELLS / 360) for degrees in OPENINGS]
    trials = np.concatenate([np.stack([first - by, first, first + by], -1) for by in openings])
    trials %= CELLS
    circles = solve(X[trials], np.moveaxis(rho[:, trials], 0, -1))  # (S, 3, K)
    residuals = np.abs(rho - np.einsum("ji,sik->skj", X, circles))
    ordered = np.sort(np.nan_to_num(residuals, nan=np.inf), axis=-1)
    half = np.count_nonzero(np.isfinite(rho), axis=-1) // 2
    best = np.argmin(np.take_along_axis(ordered, half[None, :, None], axis=-1)[..., 0], axis=0)
    # The best may be infinite where no trial meets three radii; then all of them start alike.
    return np.nan_to_num(np.take_along_axis(residuals, best[None, :, None], axis=0)[0], nan=0.0)


def _reweighted(X, Y, prior, residuals) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Robust linear regressions of rows Y (B, n), NaN where missing, on a common X (n, t).

    They begin with residuals (B, n); bisquare weights on residuals over their MAD. Returns x
    (B, t), cofactor (B, t, t), scale (B,) and the number of values in use (B,).
    """
    missing = np.isnan(Y)
    Y, root = np.where(missing, 0.0, Y), np.sqrt(prior)
    x = np.zeros((len(Y), X.shape[-1]))
    for _ in range(50):
        standardised = np.where(missing, np.nan, np.abs(residuals) * root)
        scale = ROUNDED_MAD_TO_SD * np.nanmedian(standardised, axis=-1) + 1e-9
        weights = np.nan_to_num(BISQUARE.weight(standardised / scale[:, None]), nan=0.0) * prior
        weighted = X.T * weights[:, None, :]
        N = weighted @ X
        new = solve(N, weighted @ Y[..., None])[..., 0]
        residuals = np.nan_to_num(Y - new @ X.T)
        if not np.any(np.abs(new - x) > 1e-9 * (1.0 + np.abs(new))):
            break
        x = new
    return new, cofactor_from_normal(N), scale, np.count_nonzero(weights, axis=-1)


def _curve(origin, rotation, y, centers, prior, ends) -> Axis:
    """The robust curve through centres (K, 2) at local y (K,) with weights (K,)."""
    first, last = ends
    length = last - first
    if length <= LONGEST_QUADRATIC or len(y) < 12:
        degree, inner = 2, np.empty(0)
    else:
        degree = 3
        inner = np.linspace(first, last, int(np.ceil(length / LONGEST_SPLINE_PIECE)) + 1)[1:-1]
    knots = np.concatenate([np.full(degree + 1, first), inner, np.full(degree + 1, last)])
    # the middle of a slab may lie beyond its points
    X = BSpline.design_matrix(y, knots, degree, extrapolate=True).toarray()
    # Centres that leap from their neighbours do not start with a say.
    start = centers.T - median_filter(centers.T, size=(1, 11), mode="nearest")
    start = start + 1e-3 * np.sign(start)
    x = _reweighted(X, centers.T, np.broadcast_to(prior, (2, len(y))), start)[0]
    spline, breaks = BSpline(knots, x.T, degree), np.concatenate([[first], inner, [last]])
    coefficients = np.zeros((4, 2, len(breaks) - 1))
    for power in range(degree + 1):
        coefficients[power] = spline(breaks[:-1], nu=power).T / factorial(power)
    return Axis(origin, rotation, breaks, coefficients)
