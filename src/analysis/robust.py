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

from dataclasses import replace

import numpy as np

from .accuracy import cofactor_from_normal, solve
from .cloud import ROUNDING, Adjusted, GeometricModel, Points
from .trimmed import least_trimmed_squares
from .validation import positive, whole_number
from .weights import IGG3, WeightFunction
from .wtls import iterate

TOLERANCE = 1e-12  # of a step, in the frame's unit
STALLED = 1e-9  # a step below this that no longer shrinks is rounding
SETTLED = 1e-10  # relative change of the scale
SMALLEST_REDUNDANCY = 1e-3  # of a point, when its residual is standardised


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
    x, spread = (cloud.trimmed_start or least_trimmed_squares)(model, points.D, seed)
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
