"""Orthogonal-distance adjustment of any geometric model, and the high-breakdown robust fit around it.

A geometric model gives, for a surface x and points p, the orthogonal distances d, their normals
n = ∂d/∂p and their Jacobian J with respect to t free parameters that move the surface, and a quick algebraic
fit with weights. From these alone
come :func:`geometric`, the Gauss-Helmert adjustment with any point cofactors, and :func:`robust`, which
are the same for every geometry:

1. least trimmed squares from elemental samples finds the half of the points that lie closest to one
   surface, whatever the other half does (Rousseeuw & Van Driessen 2006);
2. from there Gauss-Newton steps with IGG III weights on standardised residuals. The weights do not
   accumulate, and the scale is that of the points in use, made consistent at the normal law, so
   rejected points neither widen it nor hide behind it. Errors of only a few standard deviations on one
   side, in a large share of the points, are not told from noise and do widen it.

A cloud hands over its ``model``, its points and cofactors ``in_frame()``, a ``start()``, and makes a ``fit``
of the result. All arrays are stacks (B, …) in the cloud's frame, which is centred and scaled.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Protocol

import numpy as np
from scipy.stats import norm

from .accuracy import cofactor_from_normal, solve
from .cloud import Adjusted
from .validation import BLOCK, pieces, positive, whole_number
from .weights import IGG3, WeightFunction
from .wtls import iterate

SAMPLES = 200  # elemental samples: with half of the points bad, about 12 of 200 four-point samples are clean
CANDIDATES = 8  # samples that are followed by concentration steps
SUBSET = 1000  # points the start looks at: with 45 % bad ones, chance makes hardly ever half of them bad
TOLERANCE = 1e-12  # of a step, in the frame's unit
STALLED = 1e-9  # a step below this that no longer shrinks is rounding
SETTLED = 1e-10  # relative change of the scale
ROUNDING = 1e-14  # distances below this, in the frame's unit, are rounding and no reason to lose weight
SMALLEST_REDUNDANCY = 1e-3  # of a point, when its residual is standardised


class GeometricModel(Protocol):
    """What a geometry must supply; x (…, s) numbers that describe a surface, D (…, n, dim) unless something else is said."""

    dimension: int  # of the points
    degrees: int  # t, the free parameters of a surface
    sample: int  # points that determine one surface
    holds: bool  # whether part of x is given and not estimated

    def distances(self, x, D): ...  # of the points (B, n, dim) from K surfaces each, x (B, K, s); (B, K, n)

    def linearised(self, x, D): ...  # distances (…, n) and their Jacobian with respect to the free parameters, (…, t, n)

    def moved(self, x, step): ...  # x (…, s) after a small step (…, t) in the free parameters

    def normals(self, x, D): ...  # their unit gradients with respect to the points, (…, n, dim)

    def adjusted(self, x, points): ...  # the place on the surface nearest to each of the Points in the metric of its Q⁻¹

    def algebraic(self, D, weights): ...  # x (…, s) of a weighted algebraic fit

    def held(self, x): ...  # x with what is held put in

    def through(self, samples): ...  # x (…, s) through `sample` points (…, sample, dim), NaN where there is none


@dataclass(frozen=True)
class Points:
    """The points of a stack in the caller's frame with the principal axes of their cofactors.

    D : (B, n, dim); variances : (B, n) or (B, 1) of isotropic points, or (B, n, dim) along the ``axes``;
    axes : (B, n, dim, dim), one axis a column, or None for isotropic points
    """

    D: np.ndarray
    variances: np.ndarray
    axes: np.ndarray | None = None

    @classmethod
    def of(cls, D: np.ndarray, cofactors: np.ndarray) -> Points:
        """From cofactors (B, n) or (B, 1), or (B, n, dim, dim)."""
        return cls(D, cofactors) if cofactors.ndim == 2 else cls(D, *np.linalg.eigh(cofactors))

    def along(self, normals: np.ndarray) -> np.ndarray:
        """Variances ``nᵀQn`` along unit normals (B, n, dim); (B, n) or (B, 1)."""
        if self.axes is None:
            return self.variances
        return np.einsum("bni,bni->bn", self.variances, np.einsum("bnij,bni->bnj", self.axes, normals) ** 2)

    def piece(self, part: slice) -> Points:
        """Some of the points of every cloud."""
        variances = self.variances if self.variances.shape[1] == 1 else self.variances[:, part]
        return Points(self.D[:, part], variances, None if self.axes is None else self.axes[:, part])

    def __getitem__(self, keep) -> Points:
        return Points(self.D[keep], self.variances[keep], None if self.axes is None else self.axes[keep])


def geometric(cloud, *, bias_correction: bool = False, max_iterations: int = 100):
    """Weighted orthogonal distance fit ``min Σ eᵀQ⁻¹e`` over the errors e of the points, by Gauss-Helmert.

    With equal isotropic cofactors this is ``min Σ d²``. Independent of the origin; a parameter may be held.
    σ0 = √(Σeᵀ Q⁻¹e/(n − t)): in m without cofactors, else relative to them.

    bias_correction : take off the bias of second order that equal isotropic noise leaves in the free
        parameters (for a sphere σ̂0²/r of the radius)

    Source: Pope 1972; Neitzel 2010.
    """
    whole_number(max_iterations, "max_iterations")
    adjusted = _adjust(cloud.model, Points.of(*cloud.in_frame()), cloud.start(), None, None, max_iterations)
    if bias_correction:
        adjusted = replace(adjusted, x=adjusted.x - cloud.bias(adjusted.x, adjusted.sigma))
    return cloud.fit("geometric", adjusted)


def robust(cloud, *, seed: int = 0, k0: float = 2.5, k1: float = 4.0, max_iterations: int = 1000):
    """High-breakdown orthogonal distance fit with honest covariance: the default, and what to use on real scans.

    Least trimmed squares start, then IGG III weights on residuals standardised by their redundancy, to a
    fixed point of parameters, weights and scale. Nothing has to be known of the noise or of the share of
    gross errors, up to nearly half. σ0 is the scale of the points in use: in m without cofactors, else
    relative to them; the cofactor holds the M-estimator's factor ``E[ψ²]/E[ψ′]²``.

    seed : of the elemental samples; the result depends on it only if the start ends at another surface
    k0, k1 : thresholds of the final weights; 2.5 and 4 are 98 % efficient at the normal law

    Source: Rousseeuw & Van Driessen 2006 (start); Yang, Song & Xu 2002 (IGG III); Huber 1981, section 7.6
    (covariance).
    """
    function = IGG3(positive(k0, "k0"), positive(k1, "k1"), 1)
    whole_number(max_iterations, "max_iterations")
    model, points = cloud.model, Points.of(*cloud.in_frame())
    x, spread = least_trimmed_squares(model, points.D, seed)
    sigma = spread / np.sqrt(np.mean(linearised(model, x, points)[2], axis=-1))
    return cloud.fit("robust", _adjust(model, points, x, sigma, function, max_iterations))


def _adjust(model, points: Points, x, sigma, function: WeightFunction | None, max_iterations: int) -> Adjusted:
    count, n = points.D.shape[:2]
    t = model.degrees

    def advance(points: Points, state):
        x, sigma, last, weights, leverage = state
        f, J, variances = linearised(model, x, points)
        squares = f * f / variances
        if function is not None:
            # Leverage and scale lag by one step; at the fixed point they belong to these residuals.
            spread = sigma[:, None] * np.sqrt(np.maximum(1.0 - leverage, SMALLEST_REDUNDANCY))
            weights = function.weight(np.sqrt(squares) / np.maximum(spread, ROUNDING / np.sqrt(variances)))
            sigma, before = _scale(squares, weights, function, t), sigma
        W = weights / variances
        N = (J * W[:, None, :]) @ J.swapaxes(-1, -2)
        step = -solve(N, J @ (W * f)[..., None])[..., 0]
        length = np.linalg.norm(step, axis=-1)
        lost = ~np.isfinite(length + sigma)
        small = length <= TOLERANCE
        stalled = (length >= last) & (length <= STALLED)
        if function is not None:
            leverage = W * np.einsum("btn,btn->bn", J, solve(N, J))
            # The scale of exact points is rounding and never settles.
            settled = np.abs(sigma - before) <= np.maximum(SETTLED * sigma, ROUNDING / np.sqrt(variances.min(axis=-1)))
            small, stalled = small & settled, stalled & settled
        new = np.where(lost[:, None], x, model.moved(x, step))
        return (new, sigma, length, weights, leverage), np.select([lost, small, stalled], [1, 2, 3], 0)

    ones, zeros = np.ones((count, n)), np.zeros((count, n))
    start = (x, np.zeros(count) if sigma is None else sigma, np.full(count, np.inf), ones, zeros)
    endings = [
        (False, "not converged: the normal equations became singular"),
        (True, "the parameters stand still" if function is None else "parameters and scale stand still"),
        (True, "the step reached rounding level"),
    ]
    ended = iterate(points, start, advance, endings, max_iterations)
    x, _, _, weights, _ = ended.state
    f, J, variances = linearised(model, x, points)
    N = (J * (weights / variances)[:, None, :]) @ J.swapaxes(-1, -2)
    # Σω JᵀJ/v estimates E[ω] times the normal matrix of the good points.
    factor = 1.0 if function is None else function.mean_weight * function.mean_psi_squared / function.mean_psi_prime**2
    return Adjusted(x, factor * cofactor_from_normal(N), _scale(f * f / variances, weights, function, t), weights, ended)


def linearised(model: GeometricModel, x: np.ndarray, points: Points) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Misclosures f (B, n), Jacobian (B, t free, n) and the variances of f, (B, n) or (B, 1).

    Isotropic points: the distances themselves. Otherwise everything is taken at the adjusted points p̃, the
    places on the surface that are nearest in the metric of Q⁻¹: ``f = nᵀ(p − p̃)`` (Pope 1972).
    """
    if points.axes is None:
        return *model.linearised(x, points.D), points.variances
    adjusted = model.adjusted(x, points)
    d, J = model.linearised(x, adjusted)
    normals = model.normals(x, adjusted)
    f = d + np.einsum("bni,bni->bn", normals, points.D - adjusted)
    return f, J, points.along(normals)


def _scale(squares: np.ndarray, weights: np.ndarray, function: WeightFunction | None, t: int) -> np.ndarray:
    """σ̂ (B,): ``σ̂² = Σω f²/v / (κ Σω) · n'/(n' − t)``, n' = Σω/E[ω] points in use; κ = E[ωu²]/E[ω] makes it consistent.

    NaN without redundancy, but for a robust fit, which could not go on from there, no correction for it.
    """
    total = np.sum(weights, axis=-1)
    total = np.where(total > 0, total, np.nan)
    kappa, in_use = (1.0, total) if function is None else (function.consistency_factor, total / function.mean_weight)
    redundancy = np.where(in_use > t, in_use - t, np.nan if function is None else in_use)
    return np.sqrt(np.sum(weights * squares, axis=-1) / (kappa * total) * in_use / redundancy)


# --------------------------------------------------------------------------- the start


def least_trimmed_squares(model: GeometricModel, D: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Surface with the least sum of the h = (n + t + 1)/2 smallest squared distances, and its consistent scale.

    Elemental samples, the best followed by concentration steps (fit, keep the h closest, fit again). The
    samples are drawn from the points in an order of their own, so they do not depend on the order given.
    All points are treated alike: a small cofactor does not make a point a good one.
    Returns x (B, s) and the spread of the distances (B,) as a standard deviation.
    """
    generator = np.random.default_rng(seed)
    D = _in_canonical_order(D)
    n = D.shape[1]
    if n > SUBSET:
        D = D[:, generator.permutation(n)[:SUBSET]]
        n = SUBSET
    h = (n + model.degrees + 1) // 2
    draws = np.argsort(generator.uniform(size=(SAMPLES, n)), axis=-1)[:, : model.sample]
    x = model.through(D[:, draws])  # (B, S, s)
    # A few clouds at a time: the distances from every sample are many, and should not leave the cache.
    parts = pieces(len(D), max(1, 4 * BLOCK // (SAMPLES * n)))
    cost = np.concatenate([_trimmed(model, x[part], D[part], h) for part in parts])
    best = np.argsort(cost, axis=-1)[:, :CANDIDATES]
    x = np.take_along_axis(x, best[..., None], axis=1)
    for _ in range(4):
        x = _concentrated(model, x, D, h)
    best = np.argmin(_trimmed(model, x, D, h), axis=-1)
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
    sigma = np.sqrt(_trimmed(model, x[:, None], D, h)[:, 0] / h / _trimmed_variance(h / n))
    return x, sigma


def _in_canonical_order(D: np.ndarray) -> np.ndarray:
    """The points of each cloud sorted along a fixed oblique direction."""
    direction = np.sqrt([2.0, 3.0, 5.0])[: D.shape[-1]]
    return np.take_along_axis(D, np.argsort(D @ direction, axis=-1)[..., None], axis=-2)


def _trimmed(model, x, D, h: int) -> np.ndarray:
    """Sum of the h smallest squared distances from each of the surfaces x (B, K, s), (B, K); infinite where there is none."""
    squares = model.distances(x, D)
    np.square(squares, out=squares)
    squares[np.isnan(squares)] = np.inf
    squares.partition(h - 1, axis=-1)
    return np.sum(squares[..., :h], axis=-1)


def _concentrated(model, x, D, h: int) -> np.ndarray:
    """One concentration step of each x (B, K, s): the fit to its h closest points, which lessens the fit's own trimmed sum."""
    new = model.algebraic(D[:, None], _closest(model.distances(x, D), h))
    return np.where(np.isfinite(new).all(axis=-1, keepdims=True), new, x)


def _concentrated_with_held(model, x, D, h: int) -> np.ndarray:
    """The same with held parameters: one Gauss-Newton step of the free ones on the h closest points."""
    f, J = model.linearised(x, D)
    weighed = J * _closest(f, h)[:, None, :]
    new = model.moved(x, -solve(weighed @ J.swapaxes(-1, -2), weighed @ f[..., None])[..., 0])
    return np.where(np.isfinite(new).all(axis=-1, keepdims=True), new, x)


def _closest(distances: np.ndarray, h: int) -> np.ndarray:
    """1 for the h smallest distances, 0 for the others; all of them where there is no surface."""
    distances = np.abs(distances)
    distances[np.isnan(distances)] = np.inf
    return (distances <= np.partition(distances, h - 1, axis=-1)[..., h - 1 : h]).astype(float)


@cache
def _trimmed_variance(share: float) -> float:
    """Mean of u² over the ``share`` of a standard normal sample that is closest to 0."""
    if share >= 1.0:
        return 1.0
    limit = norm.ppf(0.5 * (1.0 + share))
    return 1.0 - 2.0 * limit * norm.pdf(limit) / share
