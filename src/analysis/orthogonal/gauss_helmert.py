"""Orthogonal-distance adjustment of any geometric model, and the robust fit around it.

A geometric model gives, for a surface x and points p, the orthogonal distances d, their normals
n = ∂d/∂p and their Jacobian J with respect to t free parameters that move the surface. From these
come :func:`geometric`, the Gauss-Helmert adjustment with any point cofactors, and :func:`robust`,
for every geometry alike:

1. least trimmed squares from elemental samples finds the half of the points that lie closest to one
   surface, whatever the other half does (Rousseeuw & Van Driessen 2006);
2. from there Gauss-Newton steps with the weights of an M-estimator on standardised residuals. The
   weights do not accumulate, and the scale is that of the points in use, made consistent at the
   normal law, so rejected points neither widen it nor hide behind it. Errors of only a few standard
   deviations on one side, in a large share of the points, are not told from noise and do widen it.

All arrays are stacks (B, …) in the clouds' frames, which are centred and scaled. An iteration is
one pass over the points, a block at a time: beyond the points a large cloud needs a weight and a
distance for each.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..adjustment.iteration import Ending, Stack, iterate
from ..adjustment.linalg import cofactor_from_normal, solve
from ..adjustment.weights import EFFICIENT_THRESHOLDS, IGG3, WEIGHT_FUNCTIONS, WeightFunction
from ..blocks import point_pieces
from ..checks import check_one_of, check_positive, check_whole_number
from ..result import Adjustment, Array, Fit
from .cloud import ROUNDING
from .contracts import GeometricModel, SurfaceCloud
from .least_trimmed_squares import SUBSET
from .observations import Observations, Points
from .second_order import without_bias

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


def geometric(
    cloud: SurfaceCloud, *, bias_correction: bool = True, max_iterations: int = 100
) -> Fit:
    """Weighted orthogonal distance fit ``min Σ eᵀQ⁻¹e`` over the errors e of the points.

    By Gauss-Helmert. With equal isotropic cofactors this is ``min Σ d²``. Independent of the
    origin; a parameter may be fixed. σ0 = √(Σeᵀ Q⁻¹e/(n − t)): in m without cofactors, else
    relative to them.

    Parameters
    ----------
    bias_correction : take off the bias of second order that noise leaves in the parameters (for a
        sphere with equal cofactors σ̂0²/r of the radius): :mod:`~analysis.orthogonal.second_order`.
        False gives the plain minimum.

    Source: Pope 1972; Neitzel 2010.
    """
    check_whole_number(max_iterations, "max_iterations")
    start, points = cloud.start(), cloud.observations()
    adjusted = _adjust(cloud.model, points, start, np.zeros(len(start)), None, max_iterations)
    if bias_correction:
        adjusted = without_bias(cloud, adjusted)
    return cloud.fit("geometric", adjusted)


def robust(
    cloud: SurfaceCloud,
    *,
    seed: int = 0,
    weight_function: WeightFunction | str | None = None,
    k0: float | None = None,
    k1: float | None = None,
    bias_correction: bool = True,
    max_iterations: int = 1000,
) -> Fit:
    """High-breakdown orthogonal distance fit with honest covariance: what to use on real scans.

    Least trimmed squares start, then weights of residuals standardised by their redundancy, to a
    fixed point of parameters, weights and scale. Nothing has to be known of the noise or of the
    share of gross errors, up to nearly half. σ0 is the scale of the points in use: in m without
    cofactors, else relative to them; the cofactor holds the M-estimator's factor ``E[ψ²]/E[ψ′]²``.

    Parameters
    ----------
    seed : of the elemental samples; the result depends on it only if the start ends at another
        surface
    weight_function : an instance of :class:`~analysis.adjustment.weights.WeightFunction`, or a name
        from ``WEIGHT_FUNCTIONS`` for one with its defaults; None for IGG III with k0 and k1. One
        that rejects no point (Huber) gives up the high breakdown of the start.
    k0, k1 : thresholds of IGG III; the defaults 2.5 and 4 are 98 % efficient at the normal law
    bias_correction : as for :func:`geometric`

    Source: Rousseeuw & Van Driessen 2006 (start); Yang, Song & Xu 2002 (IGG III); Huber 1981,
    section 7.6 (covariance).
    """
    function = _weight_function(weight_function, k0, k1)
    check_whole_number(max_iterations, "max_iterations")
    model, points = cloud.model, cloud.observations()
    # 1. least trimmed squares of some points
    part = points.subsample(LARGE, seed)
    few = part.subsample(SUBSET, seed).all()
    x, spread = cloud.robust_start(few.D, seed)
    sigma = spread / np.sqrt(np.mean(linearised(model, x, few)[2], axis=-1))
    # 2. of a large cloud, a part
    if points.count > LARGE:
        near = _adjust(model, part, x, sigma, function, max_iterations)
        found = near.convergence.converged
        x, sigma = np.where(found[:, None], near.x, x), np.where(found, near.sigma, sigma)
    # 3. all
    adjusted = _adjust(model, points, x, sigma, function, max_iterations)
    if bias_correction:
        adjusted = without_bias(cloud, adjusted)
    return cloud.fit("robust", adjusted)


def _weight_function(
    chosen: WeightFunction | str | None, k0: float | None, k1: float | None
) -> WeightFunction:
    if chosen is None:
        given = zip((k0, k1), EFFICIENT_THRESHOLDS, strict=True)
        k0, k1 = (default if k is None else k for k, default in given)
        return IGG3(check_positive(k0, "k0"), check_positive(k1, "k1"))
    if not (k0 is None and k1 is None):
        raise ValueError(
            "weight_function: expected None beside k0 and k1, the thresholds of IGG III, got both"
        )
    if isinstance(chosen, WeightFunction):
        return chosen
    return WEIGHT_FUNCTIONS[check_one_of(chosen, WEIGHT_FUNCTIONS, "weight_function")]


@dataclass(frozen=True)
class _State(Stack):
    """State of an adjustment of B clouds after an iteration.

    x : (B, s); step : (B,) length of the step that led there
    weights : (B, n) that it was found with, or (B, 1) ones; cofactor : (B, t, t) its inverse normal
        matrix
    sigma : (B,) scale to standardise the next residuals with
    last_sigma, last_found : (B,) the one before, and the scale of the residuals found with it
    """

    x: Array
    step: Array
    weights: Array
    cofactor: Array
    sigma: Array
    last_sigma: Array
    last_found: Array


def _adjust(
    model: GeometricModel,
    points: Observations,
    x: Array,
    sigma: Array,
    function: WeightFunction | None,
    max_iterations: int,
) -> Adjustment:
    """Gauss-Newton steps from x (B, s); with a weight function M-estimation from sigma (B,)."""
    t = model.degrees
    settled_ending = Ending.PARAMETERS if function is None else Ending.PARAMETERS_AND_SCALE

    def advance(points: Observations, state: _State):
        # 1. weights from the residuals, and with them the normal equations and the scale
        if function is None:
            weights, sums = state.weights, _sums(model, state.x, points)
        else:
            weights = np.empty_like(state.weights)
            sums = _sums(model, state.x, points, _reweigh(function, state, weights))
        found, cofactor = _scale(sums, function, t), cofactor_from_normal(sums.N)
        # 2. step
        step = -solve(sums.N, sums.g[..., None])[..., 0]
        length = np.linalg.norm(step, axis=-1)
        lost = ~np.isfinite(length if function is None else length + found)
        small = length <= TOLERANCE
        stalled = (length >= state.step) & (length <= STALLED)
        if function is not None:
            # The scale of exact points is rounding and never settles.
            settled = np.abs(found - state.sigma) <= np.maximum(
                SETTLED * found, ROUNDING / np.sqrt(sums.least_variance)
            )
            small, stalled = small & settled, stalled & settled
        # 3. scale to go on with
        ahead = _secant(state.sigma, found, state.last_sigma, state.last_found)
        new = _State(
            x=np.where(lost[:, None], state.x, model.update(state.x, step)),
            step=length,
            weights=weights,
            cofactor=cofactor,
            sigma=np.where(small, found, ahead),
            last_sigma=state.sigma,
            last_found=found,
        )
        return new, {Ending.SINGULAR: lost, settled_ending: small, Ending.ROUNDING: stalled}

    count = len(x)
    start = _State(
        x=x,
        step=np.full(count, np.inf),
        weights=np.ones((count, 1 if function is None else points.count)),
        cofactor=np.zeros((count, t, t)),
        sigma=sigma,
        last_sigma=np.full(count, np.nan),
        last_found=np.full(count, np.nan),
    )
    end, convergence = iterate(points, start, advance, max_iterations)
    if function is None:
        return Adjustment(end.x, end.cofactor, end.last_found, None, convergence)
    cofactor = function.covariance_factor * end.cofactor
    return Adjustment(end.x, cofactor, end.last_found, end.weights, convergence)


def _reweigh(function: WeightFunction, state: _State, weights: Array) -> Callable:
    """Gives the weights of a part from its residuals; ``weights`` (B, n) collects them.

    Leverage and scale lag by one step; at the fixed point they belong to these residuals.
    """

    def reweigh(part: slice, squares: Array, J: Array, variances: Array) -> Array:
        leverage = state.weights[:, part] / variances * np.sum((state.cofactor @ J) * J, axis=-2)
        spread = state.sigma[:, None] ** 2 * np.maximum(1.0 - leverage, SMALLEST_REDUNDANCY)
        u = np.sqrt(squares / np.maximum(spread, ROUNDING**2 / variances))
        weights[:, part] = function.weight(u)
        return weights[:, part]

    return reweigh


def _secant(sigma: Array, found: Array, last_sigma: Array, last_found: Array) -> Array:
    """The scale that finds itself: where the secant of found(σ) of two iterations meets σ.

    An iteration by itself leaves a tenth of an error of the scale, because the weights depend on
    it. In the first one (NaN), and where the scale still changes by more than a tenth, the scale
    found.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = (found - last_found) / (sigma - last_sigma)
    trusted = (np.abs(slope) <= STEEPEST) & (np.abs(found - sigma) <= NEARLY_FOUND * found)
    slope = np.where(trusted, slope, 0.0)
    return sigma + (found - sigma) / (1.0 - slope)


@dataclass
class _Sums:
    """Sums over the points: normal equations ``N = Σ ω JJᵀ/v``, ``g = Σ ω J f/v``, and the scale's.

    N : (B, t, t); g : (B, t); weights : Σω, (B,); squares : Σω f²/v, (B,); least_variance :
        smallest v, (B,)
    """

    N: Array
    g: Array
    weights: Array
    squares: Array
    least_variance: Array


def _sums(
    model: GeometricModel, x: Array, points: Observations, reweigh: Callable | None = None
) -> _Sums:
    """One pass over the points at x (B, s).

    ``reweigh(part, f²/v, J, v)`` gives the weights ω (B, m) of a part; None for ones.
    """
    count, t = len(x), model.degrees
    sums = _Sums(
        N=np.zeros((count, t, t)),
        g=np.zeros((count, t)),
        weights=np.zeros(count),
        squares=np.zeros(count),
        least_variance=np.full(count, np.inf),
    )
    for part in point_pieces(points.points):
        f, J, variances = linearised(model, x, points.piece(part))
        squares = f * f / variances
        omega = (
            np.broadcast_to(1.0, f.shape)
            if reweigh is None
            else reweigh(part, squares, J, variances)
        )
        weighed = J * (omega / variances)[:, None, :]
        sums.N += weighed @ J.swapaxes(-1, -2)
        sums.g += (weighed @ f[..., None])[..., 0]
        sums.weights += np.sum(omega, axis=-1)
        sums.squares += np.sum(omega * squares, axis=-1)
        np.minimum(sums.least_variance, variances.min(axis=-1), out=sums.least_variance)
    return sums


def linearised(model: GeometricModel, x: Array, points: Points) -> tuple[Array, Array, Array]:
    """Misclosures f (B, n), Jacobian (B, t, n) and the variances of f, (B, n) or (B, 1).

    Isotropic points: the distances themselves. Otherwise everything is taken at the adjusted points
    p̃, the places on the surface that are nearest in the metric of Q⁻¹: ``f = nᵀ(p − p̃)`` (Pope
    1972).
    """
    if points.axes is None:
        return *model.linearised(x, points.D), points.variances
    feet = model.foot_points(x, points)
    d, J = model.linearised(x, feet)
    normals = model.normals(x, feet)
    f = d + np.einsum("bni,bni->bn", normals, points.D - feet)
    return f, J, points.along(normals)


def _scale(sums: _Sums, function: WeightFunction | None, t: int) -> Array:
    """σ̂ (B,): ``σ̂² = Σω f²/v / (κ Σω) · n'/(n' − t)`` with n' = Σω/E[ω] points in use.

    κ = E[ωu²]/E[ω] makes it consistent. Without redundancy NaN; of a robust fit, which could not go
    on from there, what it is without the correction for it.
    """
    total = np.where(sums.weights > 0, sums.weights, np.nan)
    if function is None:
        kappa, in_use, without = 1.0, total, np.full_like(total, np.nan)
    else:
        kappa, in_use = function.consistency_factor, total / function.mean_weight
        without = in_use
    redundancy = np.where(in_use > t, in_use - t, without)
    return np.sqrt(sums.squares / (kappa * total) * in_use / redundancy)
