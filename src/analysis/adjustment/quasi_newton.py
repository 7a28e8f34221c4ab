"""Quasi-Newton minimisation of ``Φ(x) = rᵀS⁻¹r`` from gradients, which build up the Hessian.

    x⁺ = x + α d,    d = −H ∇Φ(x),    H ≈ (∇²Φ)⁻¹                  (Wu, Chen & Wang)

H is improved from iteration to iteration by the :func:`bfgs` or the :func:`dfp` formula, α found by
a :func:`line_search`, for each problem of a stack its own. What is minimised is ``f = Φ/2``, whose
gradient and Hessian the other solvers use.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .cofactors import gauss_newton_cofactor
from .iteration import ROUNDING, Convergence, Ending, Stack, iterate
from .problem import EIVProblem
from .steps import value_and_gradient

# c1 and c2 of the Wolfe conditions, Nocedal & Wright 2006, section 3.1
ARMIJO, CURVATURE = 1e-4, 0.9
APPROXIMATE = 0.1  # δ of the approximate Wolfe conditions, Hager & Zhang 2005
ROUNDED = 1e-12  # relative rise of Φ that is put down to rounding
TRIALS = 60  # steps tried along a direction before it is given up


def bfgs(H: np.ndarray, s: np.ndarray, v: np.ndarray) -> np.ndarray:
    """``(I − ρ s vᵀ) H (I − ρ v sᵀ) + ρ s sᵀ``, ``ρ = 1/(vᵀs)``: step s, change v of the gradient.

    Source: Broyden, Fletcher, Goldfarb and Shanno 1970; Nocedal & Wright 2006, eq. (6.17).

    >>> H = bfgs(np.eye(2), np.array([1.0, 1.0]), np.array([2.0, 4.0]))
    >>> (H @ np.array([2.0, 4.0])).round(12)  # the secant condition H v = s
    array([1., 1.])
    """
    rho = 1.0 / _dot(v, s)[..., None, None]
    left = np.eye(s.shape[-1]) - rho * _outer(s, v)
    return left @ H @ left.mT + rho * _outer(s, s)


def dfp(H: np.ndarray, s: np.ndarray, v: np.ndarray) -> np.ndarray:
    """``H + s sᵀ/(sᵀv) − H v vᵀH/(vᵀHv)`` for the step s and the change v of the gradient.

    Source: Davidon 1959; Fletcher & Powell 1963; Nocedal & Wright 2006, eq. (6.15).
    """
    Hv = _times(H, v)
    vs, vHv = _dot(s, v)[..., None, None], _dot(v, Hv)[..., None, None]
    return H + _outer(s, s) / vs - _outer(Hv, Hv) / vHv


@dataclass(frozen=True)
class _State(Stack):
    """x (B, m) with value and gradient of f there, H, H to begin anew with, length of the step."""

    x: np.ndarray
    H: np.ndarray
    gauss_newton: np.ndarray
    value: np.ndarray
    gradient: np.ndarray
    length: np.ndarray


def minimise(
    problem: EIVProblem,
    x: np.ndarray,
    update: Callable,
    tolerance: float,
    max_iterations: int,
    watch: Callable | None = None,
    H_0: np.ndarray | None = None,
) -> tuple[np.ndarray, Convergence]:
    """Minimise Φ from x (B, m) for a stack of problems.

    update : :func:`bfgs` or :func:`dfp`; left out where ``vᵀs ≤ 1e-12 |v||s|``, so that H stays
        positive definite
    tolerance : relative length below which both the last step and the Gauss-Newton step that would
        be next have to fall (with an H that is still far too small the last step says nothing)
    watch : called with every x and the number of steps tried along its direction
    H_0 : (B, m, m) inverse Hessian of f to begin with, or None for Gauss-Newton's ``(ÃᵀWÃ)⁻¹`` at
        the start, which also replaces an H that no longer leads downhill
    """

    def advance(problem: EIVProblem, state: _State):
        x, H, gauss_newton, gradient = state.x, state.H, state.gauss_newton, state.gradient
        # 1. direction
        d = -_times(H, gradient)
        uphill = ~(_dot(gradient, d) < 0)
        if uphill.any():
            H = np.where(uphill[:, None, None], gauss_newton, H)
            d = -_times(H, gradient)
        # 2. step
        alpha, new_value, new_gradient, tried = line_search(problem, x, d, state.value, gradient)
        s, v = alpha[:, None] * d, new_gradient - gradient
        new = x + s
        if watch is not None:
            watch(new, tried)
        # 3. inverse Hessian
        learns = _dot(v, s) > 1e-12 * _length(v) * _length(s)
        H = np.where(learns[:, None, None], update(H, s, v), H)
        # 4. endings
        length = np.maximum(_length(s), _length(_times(gauss_newton, new_gradient)))
        size = _length(new)
        lost, stuck = ~np.isfinite(length), alpha == 0
        stalled = (length <= ROUNDING * size) & ((length >= state.length) | stuck)
        new = np.where(lost[:, None], x, new)
        return _State(new, H, gauss_newton, new_value, new_gradient, length), {
            Ending.NOT_FINITE: lost,
            Ending.SMALL_STEP: length <= tolerance * size,
            Ending.ROUNDING: stalled,
            Ending.NO_DESCENT: stuck,
        }

    # a lost problem is reported by its ending
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        value, gradient = value_and_gradient(problem, x)
        gauss_newton = gauss_newton_cofactor(problem, x)
        H = gauss_newton if H_0 is None else H_0
        start = _State(x, H, gauss_newton, 0.5 * value, gradient, np.full(len(x), np.inf))
        state, convergence = iterate(problem, start, advance, max_iterations, tolerance)
    return state.x, convergence


def line_search(problem: EIVProblem, x, d, value, gradient):
    """Step lengths α (B,) along d that meet the strong Wolfe conditions.

    With ``φ(α) = f(x + α d)`` they are ``φ(α) ≤ φ(0) + c1 α φ'(0)`` and ``|φ'(α)| ≤ c2 |φ'(0)|``.
    Where rounding hides the fall of φ near the minimum, ``φ'(α) ≤ (2δ − 1) φ'(0)`` and a φ(α) that
    is φ(0) to rounding may stand for the first; without that x would be good to half of its digits
    only. A bracket, α = 1 first, is widened by the secant of φ' until it holds such a step, and
    then narrowed.

    problem : stack of B problems; x, d : (B, m); value, gradient : (B,), (B, m) of f at x

    Returns α, 0 where none is found, the value and the gradient of f at x + α d, and the number of
    steps tried, (B,).

    Source: Nocedal & Wright 2006, section 3.5; Hager & Zhang 2005, eqs. (1.6)-(1.8).
    """
    count = len(x)
    slope = _dot(gradient, d)
    accepted, tried = np.zeros(count), np.zeros(count, dtype=int)
    new_value, new_gradient = value.copy(), gradient.copy()
    alpha = np.ones(count)
    # α, φ, φ' at the ends of the bracket
    low, high = np.stack([np.zeros(count), value, slope]), np.full((3, count), np.inf)
    searched = np.arange(count)
    for _ in range(TRIALS):
        here = problem if len(searched) == count else problem[searched]
        a, phi, first = alpha[searched], value[searched], slope[searched]
        f, g = value_and_gradient(here, x[searched] + a[:, None] * d[searched])
        f, now = 0.5 * f, _dot(g, d[searched])
        tried[searched] += 1
        falls = f <= phi + ARMIJO * a * first
        falls |= (f <= phi * (1 + ROUNDED)) & (now <= (2 * APPROXIMATE - 1) * first)
        found = falls & (np.abs(now) <= CURVATURE * np.abs(first))
        ended = searched[found]
        accepted[ended], new_value[ended], new_gradient[ended] = a[found], f[found], g[found]
        ahead = falls & (now < 0)  # the minimum lies ahead, else behind
        low[:, searched[ahead]] = np.stack([a, f, now])[:, ahead]
        high[:, searched[~ahead]] = np.stack([a, f, now])[:, ~ahead]
        searched = searched[~found]
        if not len(searched):
            break
        alpha[searched] = _next_trial(low[:, searched], high[:, searched], slope[searched])
    return accepted, new_value, new_gradient, tried


@np.errstate(divide="ignore", invalid="ignore")  # a bracket without an upper end is infinite
def _next_trial(low: np.ndarray, high: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Step length at which φ' should vanish: by a parabola where φ has risen, else by its secant.

    Within the bracket, at least 0.1 of its width from its ends; with no upper end yet, 2 to 10
    times the lower.
    """
    (a, phi, steep), (b, end_phi, end_steep) = low, high
    width = b - a
    secant = a + width * steep / (steep - end_steep)
    parabola = a - 0.5 * steep * width**2 / (end_phi - phi - steep * width)
    inside = np.where(end_phi > phi * (1 + ROUNDED), parabola, secant)
    clipped = np.clip(inside, a + 0.1 * width, b - 0.1 * width)
    inside = np.where(np.isfinite(inside), clipped, a + 0.5 * width)
    ahead = a * slope / (slope - steep)
    ahead = np.where(ahead > 0, np.clip(ahead, 2 * a, 10 * a), 10 * a)
    return np.where(np.isfinite(b), inside, ahead)


def _dot(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    return np.sum(u * v, axis=-1)


def _length(u: np.ndarray) -> np.ndarray:
    return np.linalg.norm(u, axis=-1)


def _outer(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    return u[..., :, None] * v[..., None, :]


def _times(H: np.ndarray, v: np.ndarray) -> np.ndarray:
    return (H @ v[..., None])[..., 0]
