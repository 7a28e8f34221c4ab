"""IGG III-WTLS, the robust weighted total least squares of Ou & Liu 2017, in all its readings.

The algorithm takes one Schaffrin-Wieser step, measures the distances from the new surface, turns
them into weight factors and multiplies the weights by them, until the parameters no longer change.
What the paper leaves open (scale of the residuals, exponent, first weights) is a keyword.

The paper has it for the sphere. Any surface with a :class:`Printed` problem can be fitted by it:
one that gives the problem with its printed cofactors, the distances that belong to its misclosures
and the printed parameters.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol, cast

import numpy as np

from ..checks import check_one_of, check_positive, check_whole_number
from ..result import Adjustment, Array, Fit, Iteration, rms
from .cofactors import gauss_newton_cofactor
from .iteration import Ending, Stack, iterate
from .linalg import solve, unit_weight_sd
from .problem import CommonCofactors, EIVProblem
from .steps import misclosures, objective, schaffrin_wieser_step
from .weights import IGG3, MAD_TO_SD, PRINTED_THRESHOLDS

SCALES = ("rms", "rms_in", "rms_w", "rms_wc", "mad", "unit")


class Printed(Protocol):
    """The printed problem of a stack of B clouds in their own frames, and the way back from it."""

    @property
    def problem(self) -> EIVProblem: ...

    @property
    def length(self) -> Array:
        """(B,) m, unit of the distances."""
        ...

    def distances(self, x: Array, r: Array) -> Array:
        """Signed orthogonal distances (B, n) in units of the length, from misclosures r (B, n)."""
        ...

    def parameters(self, x: Array) -> Array:
        """Parameters (B, t) of the surfaces in the printed frame, in m."""
        ...

    def step(self, difference: Array) -> Array:
        """|ΔX| (B,) of the printed parameters X, from a difference of x (B, t)."""
        ...

    def fit(self, cloud: Any, method: str, adjustment: Adjustment) -> Fit:
        """The result in m of an adjustment of x in the frames."""
        ...

    def __getitem__(self, keep) -> Printed:
        """Some of the clouds."""
        ...


@dataclass(frozen=True)
class State(Stack):
    """X(i) with z and its misclosures r, the weights used for it and those to be used next."""

    x: Array
    z: Array
    r: Array
    weights: Array
    next_weights: Array


def igg3_wtls(
    cloud: Any,
    printed_problem: Callable[[Any, float], Printed],
    *,
    scale: str = "rms",
    power: int = 1,
    cumulative: bool = True,
    unit_weight: float = 1.0,
    k0: float = PRINTED_THRESHOLDS[0],
    k1: float = PRINTED_THRESHOLDS[1],
    tolerance: float = 1e-6,
    start: str = "Q_Y",
    max_iterations: int = 1000,
    history: bool = False,
) -> Fit:
    """IGG III-WTLS as printed; each keyword is a place that can be read in more than one way.

    One Schaffrin-Wieser step with the current weights, distances from the new surface, weight
    factors ω(|d|/σ), new weights; until the step in the printed parameters X is below
    ``tolerance``. The defaults are the literal reading.

    Parameters
    ----------
    cloud : stack of clouds of points
    printed_problem : gives the :class:`Printed` problem of the cloud with the first P_X
    scale : σ in V/σ: ``rms`` of all points (the plain meaning of the paper's term),
        ``rms_in`` of the points with weight, ``rms_w`` weighted, ``rms_wc`` weighted and made
        consistent at the normal law, ``mad`` the median absolute distance (times 1.4826 n/(n − 4)),
        ``unit`` the unit-weight standard deviation
    power : 1 as printed in eq. (13), 2 the usual IGG III
    cumulative : True as printed in step 6, P ← P·ω; False the text of section 1.3, P = P_base·ω
    unit_weight : P_X of the first iteration, which the paper does not give
    k0, k1 : thresholds of eq. (13), ``0 < k0 < k1``
    start : weights of the first solution, ``Q_Y`` as printed in eq. (15) or ``P_Y``, its inverse
    history : keep every iteration (one cloud only)

    σ0 = √(λᵀ(Y − AX)/(n − 4)) in m over all n points, rejected ones included, as printed; the
    covariance is that of weighted least squares with the final weights, which is what the paper's
    theory offers and is too optimistic, since the weights come from the same residuals.

    Raises
    ------
    ValueError : thresholds or a tolerance that are not positive or in order, an unknown reading.

    Source: Ou & Liu 2017, eqs. (11)-(18).
    """
    function = IGG3(check_positive(k0, "k0"), check_positive(k1, "k1"), power)
    check_one_of(scale, SCALES, "scale")
    tolerance = check_positive(tolerance, "tolerance")
    base = check_positive(unit_weight, "unit_weight")
    check_one_of(start, ("Q_Y", "P_Y"), "start")
    check_whole_number(max_iterations, "max_iterations")

    printed = printed_problem(cloud, base)
    problem = printed.problem
    # Step 2: X(0) weighted by Q_Y = w/P (sic) or P_Y, then X(1) by μ with ν = 0.
    Q_Y = cast(CommonCofactors, problem.cofactors).h
    x = _weighted_solution(problem, Q_Y if start == "Q_Y" else 1.0 / Q_Y)
    x = _weighted_solution(problem, 1.0 / problem.cofactors.misclosure(misclosures(problem, x)[0]))
    iterations = []

    def advance(printed: Printed, state: State):
        # Step 3: a Schaffrin-Wieser step.
        weights = state.next_weights
        x = schaffrin_wieser_step(printed.problem, state.x, weights, (state.z, state.r))
        new = State(x, *misclosures(printed.problem, x), weights, weights)
        # Steps 4 to 6: distances, their scale, weight factors.
        distances = printed.distances(x, new.r)
        sigma = _scale(scale, printed, new, distances, function)
        factors = function.weight(distances / np.maximum(sigma, np.finfo(float).tiny)[:, None])
        # Step 7: has X changed?
        moved = printed.step(x - state.x)
        in_use = np.count_nonzero(weights, axis=-1)
        lost = ~np.isfinite(moved + sigma) | (in_use < problem.parameters)
        if history:
            kept = printed.parameters(x)[0], sigma[0] * printed.length[0], weights[0]
            iterations.append(Iteration(*kept))
        new = replace(
            new,
            x=np.where(lost[:, None], state.x, x),
            next_weights=weights * factors if cumulative else factors,
        )
        return new, {Ending.TOO_FEW_POINTS: lost, Ending.SMALL_PRINTED_STEP: moved < tolerance}

    ones = np.ones(cloud.points.shape[:2])
    state = State(x, *misclosures(problem, x), ones, ones)
    state, convergence = iterate(printed, state, advance, max_iterations, tolerance)
    x, weights = state.x, state.weights
    sigma_0 = unit_weight_sd(objective(problem, x, weights), cloud.count - problem.parameters)
    cofactor = gauss_newton_cofactor(problem, x, weights)
    adjustment = Adjustment(x, cofactor, sigma_0, weights, convergence, tuple(iterations))
    return printed.fit(cloud, "igg3_wtls", adjustment)


def _weighted_solution(problem: EIVProblem, weights: Array) -> Array:
    """``(AᵀPA)⁻¹AᵀPY``, (B, m)."""
    m = problem.parameters
    N = (problem.rows[:, :m] * weights[:, None, :]) @ problem.rows.swapaxes(-1, -2)
    return solve(N[..., :m], N[..., m:])[..., 0]


def _scale(reading: str, printed: Printed, state: State, d: Array, function: IGG3) -> Array:
    """σ in V/σ as it can be read, (B,) in units of the clouds' length, from distances d (B, n).

    ``state`` holds x that the distances belong to, and the weights that led to it.
    """
    n, t, weights = d.shape[-1], printed.problem.parameters, state.weights
    match reading:
        case "rms":
            return rms(d)
        case "rms_in":
            return rms(d, where=weights > 0)
        case "rms_w":
            return np.sqrt(np.sum(weights * d**2, axis=-1) / np.sum(weights, axis=-1))
        case "rms_wc":
            spread = _scale("rms_w", printed, state, d, function)
            return spread / np.sqrt(function.consistency_factor)
        case "mad":
            return MAD_TO_SD * np.median(np.abs(d), axis=-1) * n / max(n - t, 1)
        case _:  # "unit"
            phi = objective(printed.problem, state.x, weights)
            return unit_weight_sd(phi, n - t) / printed.length
