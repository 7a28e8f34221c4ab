"""The robust fit of any geometric model: a start of high breakdown, then M-estimation.

1. :mod:`analysis.orthogonal.start` finds the surface that chance explains worst, whatever else
   there is.
2. From there the weights of an M-estimator on standardised residuals, to a fixed point of
   parameters, weights and scale. The weights do not accumulate, and the scale is that of the points
   in use, made consistent at the normal law, so rejected points neither widen it nor hide behind
   it. Errors of only a few standard deviations on one side, in a large share of the points, are not
   told from noise and do widen it.

Of few points the residuals are judged as :mod:`analysis.orthogonal.few_points` says; here those of
many, whose redundancy is nearly n.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..adjustment.iteration import Ending, Stack, iterate
from ..adjustment.linalg import solve
from ..adjustment.weights import EFFICIENT_THRESHOLDS, IGG3, WEIGHT_FUNCTIONS, WeightFunction
from ..checks import check_one_of, check_positive, check_whole_number
from ..result import Adjustment, Array, Fit
from .cloud import ROUNDING
from .contracts import GeometricModel, Start, SurfaceCloud
from .few_points import FEWEST, judge_few_points
from .gauss_helmert import SMALLEST_REDUNDANCY, Sums, adjust, linearised, m_endings, sum_up
from .observations import Observations, Points
from .second_order import without_bias

SUBSET = 1000  # points the start looks at
FEW = 50  # redundancy up to which thresholds depend on it
# points from which on a part of them is adjusted first: its solution is so near that all need only
# a few passes
LARGE = 16_384
NEARLY_FOUND = 0.1  # relative change of the scale, up to which a step of Newton is tried
# iterations after which steps are plain ones: where weights jump, others may go round
PATIENCE = 20
LONGEST = 2.0  # Gauss-Newton steps, up to which it is trusted
LEAST_RATE = 0.03  # at which steps are taken to shrink, when the next one is foreseen
LIGHT = 1e-3  # leverage up to which it may lag


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
    """High-breakdown orthogonal distance fit: what to use on real scans.

    Nothing has to be known of the noise or of the share of gross errors: up to nearly half, and
    more than half where they are spread out. σ0 is the scale of the points in use: in m without
    cofactors, else relative to them; the cofactor holds the M-estimator's factor ``E[ψ²]/E[ψ′]²``.
    With a redundancy of 1 or 2 no gross error can be told, and it is the orthogonal fit.

    Parameters
    ----------
    seed : of the elemental samples; the result depends on it only if the start ends at another
        surface
    weight_function : an instance of :class:`~analysis.adjustment.weights.WeightFunction`, or a name
        from ``WEIGHT_FUNCTIONS`` for one with its defaults; None for IGG III with k0 and k1. One
        that rejects no point (Huber) gives up the high breakdown of the start.
    k0, k1 : thresholds of IGG III; the defaults 2.5 and 4 are 98 % efficient at the normal law
    bias_correction : take off the bias of second order that noise leaves in the parameters, and
        count what is not known of it: :mod:`~analysis.orthogonal.second_order`

    Source: Rousseeuw & Van Driessen 2006, Stewart 1995 (start); Yang, Song & Xu 2002 (IGG III);
    Huber 1981, section 7.6 (covariance).
    """
    function = _weight_function(weight_function, k0, k1)
    check_whole_number(max_iterations, "max_iterations")
    if cloud.count - cloud.model.degrees < FEWEST:  # σ̂, and with it the bias, is hardly known
        start, points = cloud.start(), cloud.observations()
        return cloud.fit("robust", adjust(cloud.model, points, start, max_iterations))
    adjusted = _robust(cloud, seed, function, max_iterations)
    if bias_correction:
        adjusted = without_bias(cloud, adjusted)
    return cloud.fit("robust", adjusted)


def _robust(
    cloud: SurfaceCloud, seed: int, function: WeightFunction, max_iterations: int
) -> Adjustment:
    model, points = cloud.model, cloud.observations()
    # 1. a surface near most of some points
    part = points.subsample(LARGE, seed)
    few = part.subsample(SUBSET, seed).all()
    start = _start(cloud, part, few, seed)
    x = start.x
    sigma = start.spread / np.sqrt(np.mean(linearised(model, x, few)[2], axis=-1))
    if points.count - model.degrees <= FEW:
        start = start._replace(spread=sigma)
        return _of_few_points(cloud, points, start, function, max_iterations)
    # 2. of a large cloud, a part
    if points.count > LARGE:
        near = m_estimate(model, part, x, sigma, function, max_iterations)
        found = near.convergence.converged
        x, sigma = np.where(found[:, None], near.x, x), np.where(found, near.sigma, sigma)
    # 3. all
    return m_estimate(model, points, x, sigma, function, max_iterations)


def _of_few_points(
    cloud: SurfaceCloud,
    points: Observations,
    start: Start,
    function: WeightFunction,
    max_iterations: int,
) -> Adjustment:
    """Judged from the start, and where half of so few points determine no surface, from all."""
    model = cloud.model
    adjusted = judge_few_points(model, points, start, function, max_iterations)
    lost = ~adjusted.convergence.converged
    if not lost.any():
        return adjusted
    everything = adjust(model[lost], points[lost], cloud.start()[lost], max_iterations)
    count = np.full(len(everything.x), points.count)
    start = Start(everything.x, everything.sigma, count, np.zeros(len(count), dtype=bool))
    again = judge_few_points(model[lost], points[lost], start, function, max_iterations)
    return adjusted.replaced(lost, again)


def _start(cloud: SurfaceCloud, part: Observations, few: Points, seed: int) -> Start:
    """Start from points at different places: equal points are one, and cannot outvote the others.

    ``few`` are some points of ``part``, in their own order.
    """
    if few.different().all():
        return cloud.robust_start(few.D, seed, slice(None))
    starts = []
    for b in range(len(few.D)):
        own = slice(b, b + 1)
        # 1. so many points that there are as many places as points were asked for, or all
        some, count = few[own], SUBSET
        while np.count_nonzero(some.different()) < SUBSET and count < part.count:
            count = min(2 * count, part.count)
            some = part[own].subsample(count, seed).all()
        # 2. as many places as points were asked for
        places = np.flatnonzero(some.different()[0])
        kept = np.random.default_rng(seed).permutation(len(places))[:SUBSET]
        starts.append(cloud.robust_start(some.D[:, places[np.sort(kept)]], seed, own))
    return Start(*map(np.concatenate, zip(*starts, strict=True)))


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
    """State of an M-estimation of B clouds after an iteration.

    x : (B, s); step : (B,) length of the step that led there
    weights : (B, n) that it was found with; cofactor : (B, t, t) its inverse normal matrix
    sigma : (B,) scale to standardise the next residuals with; found : (B,) scale of the last ones
    count : (B,) number of iterations
    """

    x: Array
    step: Array
    weights: Array
    cofactor: Array
    sigma: Array
    found: Array
    count: np.ndarray


def m_estimate(
    model: GeometricModel,
    points: Observations,
    x: Array,
    sigma: Array,
    function: WeightFunction,
    max_iterations: int,
) -> Adjustment:
    """M-estimate of many points from x (B, s) and σ (B,).

    Far from it steps with weights, which lessen Σρ; near it steps of Newton in x and σ together,
    which take half as many.
    """
    t = model.degrees

    def advance(points: Observations, state: _State):
        # 1. weights from the residuals, and with them the normal equations and the scale
        weights = np.empty_like(state.weights)
        sums = sum_up(model, state.x, points, _reweigh(function, state, weights))
        found = _scale(sums, function, t)
        cofactor, step = sums.solved()
        # 2. has it ended?
        length = np.linalg.norm(step, axis=-1)
        foreseen = length * np.clip(length / state.step, LEAST_RATE, 1.0)
        endings = m_endings(sums, length, state.step, state.sigma, found, foreseen)
        lost = endings[Ending.SINGULAR]
        # 3. step
        step, sigma = _newton(sums, function, state, found, step, length)
        new = _State(
            x=np.where(lost[:, None], state.x, model.update(state.x, step)),
            step=length,
            weights=weights,
            cofactor=cofactor,
            sigma=sigma,
            found=found,
            count=state.count + 1,
        )
        return new, endings

    count = len(x)
    start = _State(
        x=x,
        step=np.full(count, np.inf),
        weights=np.ones((count, points.count)),
        cofactor=np.zeros((count, t, t)),
        sigma=sigma,
        found=np.full(count, np.nan),
        count=np.zeros(count, dtype=int),
    )
    end, convergence = iterate(points, start, advance, max_iterations)
    cofactor = function.covariance_factor * end.cofactor
    return Adjustment(end.x, cofactor, end.found, end.weights, convergence)


def _reweigh(function: WeightFunction, state: _State, weights: Array) -> Callable:
    """Gives the weights of a part from its residuals, and uω′; ``weights`` (B, n) collects them.

    The weight is in the leverage ωq too. It lags by one step, and is made anew with the weights so
    found; at the fixed point it belongs to these residuals.
    """
    sigma_squared = state.sigma[:, None] ** 2
    early = state.count[:, None] < PATIENCE

    def reweigh(part: slice, squares: Array, J: Array, variances: Array):
        q = np.einsum("btn,btn->bn", state.cofactor @ J, J)
        q /= variances
        squares = squares / np.maximum(sigma_squared, ROUNDING**2 / variances)
        weight = state.weights[:, part]
        u = np.sqrt(squares / np.maximum(1.0 - weight * q, SMALLEST_REDUNDANCY))
        weight = function.weight(u)
        heavy = early & (q.max(axis=-1, keepdims=True) > LIGHT)
        if heavy.any():
            again = np.sqrt(squares / np.maximum(1.0 - weight * q, SMALLEST_REDUNDANCY))
            u = np.where(heavy, again, u)
            weight = function.weight(u)
        weights[:, part] = weight
        falling = np.nonzero((weight > 0.0) & (weight < 1.0))
        slope = np.zeros_like(weight)
        theirs = function.weight_slope(u[falling])
        slope[falling] = theirs / (1.0 - 0.5 * theirs * q[falling])
        return weight, slope

    return reweigh


def _scale(sums: Sums, function: WeightFunction, t: int) -> Array:
    """σ̂ (B,): ``σ̂² = Σω f²/v / (κ Σω) · n′/(n′ − t)`` with n′ = Σω/E[ω] points in use.

    κ = E[ωu²]/E[ω] makes it consistent. Where so few are left in use that there is no redundancy,
    it is without the correction for it: the iteration could not go on from NaN.
    """
    total = np.where(sums.weights > 0, sums.weights, np.nan)
    free = total - t * function.mean_weight
    return np.sqrt(sums.squares / (function.consistency_factor * np.where(free > 0, free, total)))


def _newton(
    sums: Sums, function: WeightFunction, state: _State, found: Array, step: Array, length: Array
) -> tuple[Array, Array]:
    """The next step (B, t) and scale (B,): Newton's where he is near, else those given.

    The two equations are ``g = Σ ω J f/v = 0`` and ``R = Σ ω f²/v − κσ²(Σω − tE[ω]) = 0``. With
    u = |f|/(σ√v) the weights change by uω′(u) (J dx/f − dσ/σ), which gives their derivatives from
    ``sums.bend``; the curvature of the distances, which does not count near a minimum, is left out.
    """
    t, bend, sigma = step.shape[-1], sums.bend, state.sigma
    near = (np.abs(found - sigma) <= NEARLY_FOUND * found) & (state.count < PATIENCE)
    if not near.any():
        return step, found
    square = function.consistency_factor * sigma * sigma
    free = sums.weights - t * function.mean_weight
    A = np.empty((len(step), t + 1, t + 1))
    # the columns of dx, and of dσ/σ
    A[:, :t, :t] = sums.N + bend[:, :t, :t]
    A[:, :t, t] = -bend[:, :t, t]
    A[:, t, :t] = 2.0 * sums.g + bend[:, t, :t] - square[:, None] * bend[:, t + 1, :t]
    A[:, t, t] = square * (bend[:, t, t + 1] - 2.0 * free) - bend[:, t, t]
    right = np.concatenate([sums.g, (sums.squares - square * free)[:, None]], axis=-1)
    full = -solve(A, right[..., None])[..., 0]
    change = sigma * full[:, t]
    with np.errstate(invalid="ignore"):
        trusted = near & (np.linalg.norm(full[:, :t], axis=-1) <= LONGEST * length)
        trusted &= np.abs(change) <= LONGEST * np.abs(found - sigma)
    step = np.where(trusted[:, None], full[:, :t], step)
    return step, np.where(trusted, sigma + change, found)
