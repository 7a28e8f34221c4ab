"""Residuals of few points: thresholds, scale and start that know the redundancy.

A residual of one of few points is judged by what the others say. With ``q = JᵀN⁻¹J/v`` and
``h = ωq``, and the scale σ(i) of the others,

    T² = f²/v / ((1 − h)(1 − h + q)) / σ²(i)

is Student's t with ν − ω degrees of freedom, whether the point itself is in use (ω = 1) or not
(ω = 0); ν = n′ − t is the redundancy of the n′ = Σω/E[ω] points in use. It is compared with the
thresholds of a weight function as ``u = T · 2.5/t(ν − ω)``, where t(ν) is the quantile that
Student's t exceeds as often as a normal residual exceeds 2.5. The scale
``σ̂² = Σω f²/v/(ν E[ωτ²])`` is made consistent with the law of Pope's τ.

Below a redundancy n − t = ν₀ of 10 a good point must be thrown out less often: each one costs a
tenth of the redundancy and more. There the probability of 2.5 is multiplied by (ν₀/10)^1.5, which
keeps the coverage of 95 % intervals at 93 to 95 % (by simulation of spheres, planes and ellipses).
Below 3 no gross error can be told.

References
----------
Pope (1976), The statistics of residuals and the detection of outliers, NOAA TR NOS 65 NGS 1.
Pison, Van Aelst & Willems (2002), Small sample corrections for LTS and MCD, Metrika 55, 111-123.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.special import stdtrit
from scipy.stats import norm

from ..adjustment.iteration import Ending, Stack, iterate
from ..adjustment.linalg import cofactor_from_normal, solve
from ..adjustment.weights import EFFICIENT_THRESHOLDS, WeightFunction
from ..result import Adjustment, Array
from .cloud import ROUNDING
from .contracts import GeometricModel, Start
from .gauss_helmert import SMALLEST_REDUNDANCY, linearised, m_endings, sum_up
from .least_trimmed_squares import closest, trimmed_variance
from .observations import Observations, Points

FEWEST = 3  # redundancy from which on a gross error can be told
ENOUGH = 10  # from which on the probability of the threshold is that of the normal law
LEVEL = EFFICIENT_THRESHOLDS[0]  # normal residual at which the two laws are matched
LEAST_SHARE = 0.02  # of the sum of squares that the other points keep
STEPS = 5  # of Gauss-Newton on the points that the start rests on
# ln of the factor on the scale of the best half of n points, in 1/μ, 1/μ², √(t/ν₀), and for even
# ν₀ 1/ν₀, 1/ν₀², with which a good point exceeds 2.5 as often as in the end; fitted to simulations
# of linear models with t = 2, 3, 4, 5, 7 and ν₀ = 3 to 200
FACTOR = (1.325, -3.790, 1.049, 0.817, 10.766)
FAR = 0.05  # step, in the frame's unit, after which weights stay
# Two points may take turns. After so many iterations a weight goes only so much of its way:
DAMPED = ((240, 0.1), (90, 0.25), (15, 0.5), (0, 1.0))


@dataclass(frozen=True)
class _State(Stack):
    """State of an adjustment of B clouds of few points after an iteration.

    x (B, s), step (B,), weights (B, n), cofactor (B, t, t), sigma (B,) as of many points
    redundancy : ν, (B,), infinite as long as the scale is not that of points in use
    square : E[ωτ²] at ν, (B,); count : (B,) number of iterations
    """

    x: Array
    step: Array
    weights: Array
    cofactor: Array
    sigma: Array
    redundancy: Array
    square: Array
    count: np.ndarray


def judge_few_points(
    model: GeometricModel,
    points: Observations,
    start: Start,
    function: WeightFunction,
    max_iterations: int,
) -> Adjustment:
    """M-estimate of few points; the spread of ``start`` is at cofactor 1."""
    n, t = points.count, model.degrees
    z = strict_level(n - t)
    x, cofactor, sigma = _settle_start(model, points.all(), start)
    sigma = np.where(start.half, sigma * start_factor(n, t, z), start.spread)

    def advance(points: Observations, state: _State):
        weights = np.empty_like(state.weights)
        sums = sum_up(model, state.x, points, _reweigh(function, z, state, weights))
        cofactor, step = sums.solved()
        length = np.linalg.norm(step, axis=-1)
        redundancy, square = _redundancy(function, z, sums.weights, n, t)
        in_use = np.where(sums.weights > 0, sums.weights, np.nan)
        found = np.sqrt(sums.squares / (square * np.where(redundancy > 0, redundancy, in_use)))
        endings = m_endings(sums, length, state.step, state.sigma, found, length)
        lost = endings[Ending.SINGULAR]
        new = _State(
            x=np.where(lost[:, None], state.x, model.update(state.x, step)),
            step=length,
            weights=weights,
            cofactor=cofactor,
            sigma=found,
            redundancy=redundancy,
            square=square,
            count=state.count + 1,
        )
        return new, endings

    first = _State(
        x=x,
        step=np.full(len(x), np.inf),
        weights=np.zeros((len(x), n)),
        cofactor=cofactor,
        sigma=sigma,
        redundancy=np.full(len(x), np.inf),
        square=np.ones(len(x)),
        count=np.zeros(len(x), dtype=int),
    )
    end, convergence = iterate(points, first, advance, max_iterations)
    cofactor = function.covariance_factor * end.cofactor
    return Adjustment(end.x, cofactor, end.sigma, end.weights, convergence)


def _reweigh(function: WeightFunction, z: float, state: _State, weights: Array) -> Callable:
    """Gives the weights of a part from its external residuals; ``weights`` collects them."""
    # at first no point is in use, and the scale is that of the start
    first = np.isinf(state.redundancy)[:, None]
    total = (state.sigma**2 * state.square)[:, None] * np.where(
        first, 1.0, state.redundancy[:, None]
    )
    share = np.array([next(part for after, part in DAMPED if k >= after) for k in state.count])[
        :, None
    ]
    # After a long step the residuals say first where the surface is, with the same points.
    far = (state.step > FAR)[:, None] & ~first

    def reweigh(part: slice, squares: Array, J: Array, variances: Array):
        w = state.weights[:, part]
        q = np.maximum(np.einsum("btn,btn->bn", state.cofactor @ J, J), 0.0) / variances
        rest = np.maximum(1.0 - w * q, SMALLEST_REDUNDANCY)
        # the scale of the others
        free = np.where(
            first, np.inf, np.maximum(state.redundancy[:, None] - w, SMALLEST_REDUNDANCY)
        )
        others = np.maximum(total - w * squares / rest, LEAST_SHARE * total)
        scale = others / (state.square[:, None] * np.where(first, 1.0, free))
        scale = np.maximum(scale, ROUNDING**2 / variances)
        u = np.sqrt(squares / (rest * (rest + q)) / scale) * (LEVEL * _reciprocal(free, z))
        step = np.where(first, 1.0, np.where(far, 0.0, share))
        weights[:, part] = w + step * (function.weight(u) - w)
        return weights[:, part], None

    return reweigh


def _settle_start(model: GeometricModel, points: Points, start: Start):
    """Gauss-Newton on the points that the start rests on: x, N⁻¹ and σ̂ of them.

    σ̂² is consistent for the closest ones of n, not yet for their choice. A step is kept where it
    lessens the sum of squares.
    """
    n, t = points.D.shape[1], model.degrees
    x, f, J, variances = start.x, *linearised(model, start.x, points)
    chosen = closest(f, start.number) / np.broadcast_to(variances, f.shape)
    best, least = x, np.full(len(x), np.inf)
    N = np.full((len(x), t, t), np.nan)
    for turn in range(STEPS + 1):
        weighed = J * chosen[:, None]
        normal, now = weighed @ J.swapaxes(-1, -2), np.einsum("bn,bn->b", chosen, f * f)
        better = (now < least) | (turn == 0)
        best, least = np.where(better[:, None], x, best), np.where(better, now, least)
        N = np.where(better[:, None, None], normal, N)
        new = model.update(x, -solve(normal, weighed @ f[..., None])[..., 0])
        x = np.where(np.isfinite(new).all(axis=-1, keepdims=True), new, x)
        f, J, _ = linearised(model, x, points)
    share = np.array([trimmed_variance(count / n) for count in start.number])
    sigma = np.sqrt(least / np.maximum(start.number - t, 1) / share)
    return best, cofactor_from_normal(N), sigma


# ---------------------------------------------------------------------------- laws of few points


def strict_level(redundancy: int) -> float:
    """The normal residual that a good point exceeds as often as it may, 2.5 from ν₀ = 10 on."""
    share = min(1.0, redundancy / ENOUGH) ** 1.5
    return float(norm.isf(norm.sf(LEVEL) * share))


def start_factor(n: int, t: int, z: float) -> float:
    """Factor on the scale of the best half, so that a good point exceeds z as often as later on."""
    free, mu = n - t, (n + t + 1) // 2 - t
    terms = (1 / mu, 1 / mu**2, np.sqrt(t / free), *((1 - free % 2) / free ** np.arange(1, 3)))
    level, matched = stdtrit(mu, norm.cdf([z, LEVEL]))
    return float(np.exp(np.dot(FACTOR, terms)) * LEVEL / z * level / matched)


_FREE = np.concatenate(
    [np.arange(1.0, 4.0, 0.02), np.arange(4.0, 20.0, 0.1), np.geomspace(20.0, 400.0, 60)]
)


@cache
def _quantiles(z: float) -> Array:
    return 1.0 / stdtrit(_FREE, norm.cdf(z))


def _reciprocal(free: Array, z: float) -> Array:
    """1/t(ν): Student's quantile that is exceeded as often as z by the normal law.

    0 below one degree of freedom.
    """
    reciprocal = np.interp(free, _FREE, _quantiles(z), left=0.0)
    return np.where(np.isinf(free), 1.0 / z, reciprocal)


def _redundancy(
    function: WeightFunction, z: float, total: Array, n: int, t: int
) -> tuple[Array, Array]:
    """ν = n′ − t of the points in use and E[ωτ²] there, from Σω (B,)."""
    grid, means, squares = _means(function, z)
    redundancy = np.maximum(total - t, 0.0)
    for _ in range(2):
        mean = np.interp(1.0 / np.maximum(redundancy, 1.0), grid, means)
        redundancy = np.clip(np.minimum(total / mean, n) - t, 0.0, None)
    return redundancy, np.interp(1.0 / np.maximum(redundancy, 1.0), grid, squares)


@cache
def _means(function: WeightFunction, z: float) -> tuple[Array, Array, Array]:
    """1/ν from 0 to 1, and E[ω] and E[ωτ²] of a good point there.

    τ² = νT²/(ν − 1 + T²), T Student's with ν − 1 degrees of freedom (Pope 1976); below a redundancy
    of 2 both are 1, the point being kept. By the normal score of |T|, from 0 to 9.
    """
    nodes, parts = np.polynomial.legendre.leggauss(400)
    score = 4.5 + 4.5 * nodes
    parts = 9.0 * parts * norm.pdf(score)
    inverse = [1 / 400, 0.005, 0.01, 0.02, 0.03, 0.05, 1 / 13, 0.1, 0.125, 1 / 6, 0.2, 0.25]
    inverse += [1 / 3.5, 1 / 3, 0.4, 1 / 2.25, 0.5]
    means = []
    for nu in 1.0 / np.array(inverse):
        T = -stdtrit(nu - 1.0, norm.sf(score))
        weight = function.weight(T * LEVEL / stdtrit(nu - 1.0, norm.cdf(z)))
        means.append((parts @ weight, parts @ (weight * nu * T**2 / (nu - 1.0 + T**2))))
    at_normal = function.mean_weight, function.mean_psi_prime
    grid = np.array([0.0, *inverse, 0.51])
    return grid, *np.array([at_normal, *means, (1.0, 1.0)]).T
