"""Orthogonal-distance adjustment of any geometric model, and the high-breakdown robust fit around
it.

A geometric model gives, for a surface x and points p, the orthogonal distances d, their normals
n = ∂d/∂p and their Jacobian J with respect to t free parameters that move the surface, and a quick
algebraic fit with weights. From these alone
come :func:`geometric`, the Gauss-Helmert adjustment with any point cofactors, and :func:`robust`,
which are the same for every geometry:

1. least trimmed squares from elemental samples finds the half of the points that lie closest to one
   surface, whatever the other half does (Rousseeuw & Van Driessen 2006);
2. from there Gauss-Newton steps with IGG III weights on standardised residuals. The weights do not
   accumulate, and the scale is that of the points in use, made consistent at the normal law, so
   rejected points neither widen it nor hide behind it. Errors of only a few standard deviations on
   one side, in a large share of the points, are not told from noise and do widen it.

A cloud hands over its ``model``, its ``observations()``, a ``start()``, and makes a ``fit`` of the
result. All arrays are stacks (B, …) in the cloud's frame, which is centred and scaled. An iteration
is one pass over the points, a block at a time: beyond the points a large cloud needs a weight and a
distance for each.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..adjustment.iteration import Ending, Stack, iterate
from ..adjustment.linalg import cofactor_from_normal, solve
from ..adjustment.weights import EFFICIENT_THRESHOLDS, IGG3, WeightFunction
from ..checks import check_positive, check_whole_number
from .cloud import ROUNDING, Adjusted, GeometricModel, Observations, Points
from .least_trimmed_squares import SUBSET, least_trimmed_squares

TOLERANCE = 1e-12  # of a step, in the frame's unit
STALLED = 1e-9  # a step below this that no longer shrinks is rounding
SETTLED = 1e-10  # relative change of the scale
# points from which on a part of them is adjusted first: its solution is so near that all need only
# a few passes
LARGE = 16_384
# slope of the scale found against the scale it was found with, beyond which the secant is not
# trusted
STEEPEST = 0.5
NEARLY_FOUND = 0.1  # relative change of the scale, beyond which neither
SMALLEST_REDUNDANCY = 1e-3  # of a point, when its residual is standardised


def geometric(cloud, *, bias_correction: bool = False, max_iterations: int = 100):
    """Weighted orthogonal distance fit ``min Σ eᵀQ⁻¹e`` over the errors e of the points, by
    Gauss-Helmert.

    With equal isotropic cofactors this is ``min Σ d²``. Independent of the origin; a parameter may
    be held. σ0 = √(Σeᵀ Q⁻¹e/(n − t)): in m without cofactors, else relative to them.

    bias_correction : take off the bias of second order that equal isotropic noise leaves in the
        free parameters (for a sphere σ̂0²/r of the radius)

    Source: Pope 1972; Neitzel 2010.
    """
    check_whole_number(max_iterations, "max_iterations")
    adjusted = _adjust(cloud.model, cloud.observations(), cloud.start(), None, None, max_iterations)
    if bias_correction:
        adjusted = replace(adjusted, x=adjusted.x - cloud.bias(adjusted.x, adjusted.sigma))
    return cloud.fit("geometric", adjusted)


def robust(
    cloud,
    *,
    seed: int = 0,
    k0: float = EFFICIENT_THRESHOLDS[0],
    k1: float = EFFICIENT_THRESHOLDS[1],
    max_iterations: int = 1000,
):
    """High-breakdown orthogonal distance fit with honest covariance: the default, and what to use
    on real scans.

    Least trimmed squares start, then IGG III weights on residuals standardised by their redundancy,
    to a fixed point of parameters, weights and scale. Nothing has to be known of the noise or of
    the share of gross errors, up to nearly half. σ0 is the scale of the points in use: in m without
    cofactors, else relative to them; the cofactor holds the M-estimator's factor ``E[ψ²]/E[ψ′]²``.

    seed : of the elemental samples; the result depends on it only if the start ends at another
        surface
    k0, k1 : thresholds of the final weights; 2.5 and 4 are 98 % efficient at the normal law

    Source: Rousseeuw & Van Driessen 2006 (start); Yang, Song & Xu 2002 (IGG III); Huber 1981,
    section 7.6 (covariance).
    """
    function = IGG3(check_positive(k0, "k0"), check_positive(k1, "k1"), 1)
    check_whole_number(max_iterations, "max_iterations")
    model, points = cloud.model, cloud.observations()
    part = points.drawn(LARGE, seed)
    few = part.drawn(SUBSET, seed).all()
    x, spread = (cloud.trimmed_start or least_trimmed_squares)(model, few.D, seed)
    sigma = spread / np.sqrt(np.mean(linearised(model, x, few)[2], axis=-1))
    if points.count > LARGE:
        near = _adjust(model, part, x, sigma, function, max_iterations)
        found = near.convergence.converged
        x, sigma = np.where(found[:, None], near.x, x), np.where(found, near.sigma, sigma)
    return cloud.fit("robust", _adjust(model, points, x, sigma, function, max_iterations))


@dataclass(frozen=True)
class State(Stack):
    """x, the scale to be used and the last step; weights, cofactor and scale found with the last
    scale.
    """

    x: np.ndarray
    sigma: np.ndarray
    length: np.ndarray
    weights: np.ndarray
    cofactor: np.ndarray
    last_sigma: np.ndarray
    found: np.ndarray


def _adjust(
    model, points: Observations, x, sigma, function: WeightFunction | None, max_iterations: int
) -> Adjusted:
    t = model.degrees
    still = Ending.PARAMETERS if function is None else Ending.PARAMETERS_AND_SCALE

    def advance(points: Observations, state: State):
        x, sigma, weights, cofactor = state.x, state.sigma, state.weights, state.cofactor

        def reweigh(part: slice, squares, J, variances) -> None:
            # Leverage and scale lag by one step; at the fixed point they belong to these residuals.
            leverage = weights[:, part] / variances * np.sum((cofactor @ J) * J, axis=-2)
            spread = sigma[:, None] ** 2 * np.maximum(1.0 - leverage, SMALLEST_REDUNDANCY)
            weights[:, part] = function.weight(
                np.sqrt(squares / np.maximum(spread, ROUNDING**2 / variances))
            )

        sums = _Sums(model, x, points, weights, None if function is None else reweigh)
        step = -solve(sums.N, sums.g[..., None])[..., 0]
        length = np.linalg.norm(step, axis=-1)
        found, cofactor = _scale(sums, function, t), cofactor_from_normal(sums.N)
        lost = ~np.isfinite(length if function is None else length + found)
        small = length <= TOLERANCE
        stalled = (length >= state.length) & (length <= STALLED)
        if function is not None:
            # The scale of exact points is rounding and never settles.
            settled = np.abs(found - sigma) <= np.maximum(
                SETTLED * found, ROUNDING / np.sqrt(sums.least_variance)
            )
            small, stalled = small & settled, stalled & settled
        new = np.where(lost[:, None], x, model.moved(x, step))
        new_sigma = np.where(small, found, _secant(sigma, found, state.last_sigma, state.found))
        return State(new, new_sigma, length, weights, cofactor, sigma, found), {
            Ending.SINGULAR: lost,
            still: small,
            Ending.ROUNDING: stalled,
        }

    count = len(points.points)
    start = State(
        x,
        np.zeros(count) if sigma is None else sigma,
        np.full(count, np.inf),
        np.ones((count, 1 if function is None else points.count)),
        np.zeros((count, t, t)),
        np.full(count, np.nan),
        np.full(count, np.nan),
    )
    end, convergence = iterate(points, start, advance, max_iterations)
    # Σω JᵀJ/v estimates E[ω] times the normal matrix of the good points.
    factor = (
        1.0
        if function is None
        else function.mean_weight * function.mean_psi_squared / function.mean_psi_prime**2
    )
    weights = None if function is None else end.weights
    return Adjusted(end.x, factor * end.cofactor, end.found, weights, convergence)


def _secant(sigma, found, last_sigma, last_found) -> np.ndarray:
    """The scale that would find itself: where the secant of found(σ) through the last two
    iterations meets σ.

    An iteration by itself leaves a tenth of an error of the scale, because the weights hang on it.
    The scale found in the first one (NaN), and where the scale still changes by more than a tenth.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = (found - last_found) / (sigma - last_sigma)
    trusted = (np.abs(slope) <= STEEPEST) & (np.abs(found - sigma) <= NEARLY_FOUND * found)
    slope = np.where(trusted, slope, 0.0)
    return sigma + (found - sigma) / (1.0 - slope)


class _Sums:
    """What one pass over the points gives at x: the normal equations ``N = Σ ω JJᵀ/v``,
    ``g = Σ ω J f/v``, and sums for the scale.

    N : (B, t, t); g : (B, t); weights : Σω, (B,); squares : Σω f²/v, (B,); least_variance :
        smallest v, (B,)
    """

    def __init__(
        self, model, x: np.ndarray, points: Observations, weights: np.ndarray, reweigh=None
    ):
        """``weights`` (B, n), or (B, 1) for all points; ``reweigh(part, f²/v, J, v)`` gives those
        of a part anew before they are used.
        """
        count, t = len(x), model.degrees
        self.N, self.g = np.zeros((count, t, t)), np.zeros((count, t))
        self.weights, self.squares, self.least_variance = (
            np.zeros(count),
            np.zeros(count),
            np.full(count, np.inf),
        )
        for part in points.pieces():
            f, J, variances = linearised(model, x, points.piece(part))
            squares = f * f / variances
            if reweigh is not None:
                reweigh(part, squares, J, variances)
            omega = np.broadcast_to(weights if weights.shape[1] == 1 else weights[:, part], f.shape)
            weighed = J * (omega / variances)[:, None, :]
            self.N += weighed @ J.swapaxes(-1, -2)
            self.g += (weighed @ f[..., None])[..., 0]
            self.weights += np.sum(omega, axis=-1)
            self.squares += np.sum(omega * squares, axis=-1)
            np.minimum(self.least_variance, variances.min(axis=-1), out=self.least_variance)


def linearised(
    model: GeometricModel, x: np.ndarray, points: Points
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Misclosures f (B, n), Jacobian (B, t free, n) and the variances of f, (B, n) or (B, 1).

    Isotropic points: the distances themselves. Otherwise everything is taken at the adjusted points
    p̃, the places on the surface that are nearest in the metric of Q⁻¹: ``f = nᵀ(p − p̃)`` (Pope
    1972).
    """
    if points.axes is None:
        return *model.linearised(x, points.D), points.variances
    adjusted = model.adjusted(x, points)
    d, J = model.linearised(x, adjusted)
    normals = model.normals(x, adjusted)
    f = d + np.einsum("bni,bni->bn", normals, points.D - adjusted)
    return f, J, points.along(normals)


def _scale(sums: _Sums, function: WeightFunction | None, t: int) -> np.ndarray:
    """σ̂ (B,): ``σ̂² = Σω f²/v / (κ Σω) · n'/(n' − t)``, n' = Σω/E[ω] points in use; κ =
    E[ωu²]/E[ω] makes it consistent.

    NaN without redundancy, but for a robust fit, which could not go on from there, no correction
    for it.
    """
    total = np.where(sums.weights > 0, sums.weights, np.nan)
    kappa, in_use = (
        (1.0, total)
        if function is None
        else (function.consistency_factor, total / function.mean_weight)
    )
    redundancy = np.where(in_use > t, in_use - t, np.nan if function is None else in_use)
    return np.sqrt(sums.squares / (kappa * total) * in_use / redundancy)
