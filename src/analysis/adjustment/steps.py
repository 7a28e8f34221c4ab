"""Steps of the iterations for weighted total least squares, ``min Φ(x) = rᵀS(x)⁻¹r``.

With the multipliers ``λ = S⁻¹r``, the predicted errors Ẽ of A and the adjusted rows ``Ã = A − Ẽ``
the gradient is ``½∇Φ = −Ãᵀλ``, and every iteration known for the problem moves by

    x⁺ = x + N⁻¹ Ãᵀλ

with another matrix N for half the Hessian, hence another speed and the same solution (W = S⁻¹, B =
A less the slope of S, V = Σ λ² Q):

====================  ==============  =================================================
step                  N               source
====================  ==============  =================================================
newton                BᵀWB − V        Fang 2013 (the exact Hessian: quadratic convergence)
schaffrin_wieser      AᵀWA − V        Schaffrin & Wieser 2008
shen                  ÃᵀWÃ            Shen, Li & Chen 2011 (Gauss-Newton; Neitzel 2010)
amiri_simkooei        ÃᵀWÃ            Amiri-Simkooei & Jazaeri 2012
fang                  AᵀWA            Fang 2013, algorithm 1
mahboub               ÃᵀWA            Mahboub 2012
====================  ==============  =================================================

The sources print most of them as ``x⁺ = N⁻¹(…)``; the increment loses less to rounding. A step
takes a problem or a stack of them and x (…, m), and returns x⁺; where N is singular, NaN.

A line with errors in the second column of A and in y:

>>> from analysis.adjustment.problem import CommonCofactors
>>> rows = np.array([[1.0, 1.0, 1.0, 1.0], [0.1, 0.9, 2.1, 2.9], [1.0, 3.1, 4.9, 7.1]])
>>> problem = EIVProblem(rows, CommonCofactors(np.diag([0.0, 1.0, 0.0]), np.ones(4), np.ones(4)))
>>> x = np.array([1.0, 2.0])
>>> for _ in range(6):
...     x = newton_step(problem, x)
>>> others = (schaffrin_wieser_step, shen_step, fang_step, mahboub_step)
>>> bool(max(np.abs(step(problem, x) - x).max() for step in others) < 1e-14)
True
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np

from .iteration import ROUNDING, Convergence, Ending, Stack, iterate
from .linalg import solve
from .problem import EIVProblem

# relative Newton step above which Φ is not at its minimum, however small the steps have become
FLAT = 0.01
HALVINGS = 20  # of a Gauss-Newton step that climbs; it leads downhill, so that a few are enough

Misclosures: TypeAlias = tuple[np.ndarray, np.ndarray]


class Evaluation:
    """Evaluation of a problem at x (…, m): z, misclosures r, s or S, and what follows from them.

    known : :func:`misclosures` at x where a caller has them already
    """

    def __init__(self, problem: EIVProblem, x: np.ndarray, known: Misclosures | None = None):
        self.x, self.rows, self.cofactors = x, problem.rows, problem.cofactors
        self.columns = problem.rows[..., :-1, :]
        self.z, self.r = known or misclosures(problem, x)
        self.s = self.cofactors.misclosure(self.z)

    def weigh(self, columns: np.ndarray, weights: np.ndarray | float = 1.0) -> np.ndarray:
        """``ω S⁻¹`` times each of the ``columns`` (…, k, n)."""
        return self.cofactors.weigh(self.s, columns, weights)

    def value(self, weights: np.ndarray | float = 1.0) -> np.ndarray:
        """``Φ = Σ ω r²/s``, or ``rᵀS⁻¹r``, (…)."""
        return np.sum(self.weigh(self.r[..., None, :], weights)[..., 0, :] * self.r, axis=-1)

    @cached_property
    def multipliers(self) -> np.ndarray:
        """``λ = S⁻¹r``, (…, n)."""
        return self.weigh(self.r[..., None, :])[..., 0, :]

    @cached_property
    def errors(self) -> np.ndarray:
        """Predicted errors Ẽ of A, (…, m, n)."""
        return self.cofactors.errors(self.z, self.multipliers)

    @cached_property
    def adjusted(self) -> np.ndarray:
        """``Ã = A − Ẽ``, (…, m, n)."""
        return self.columns - self.errors

    @property
    def slope(self) -> np.ndarray:
        """``−(∂S/∂x_j) λ``, (…, m, n)."""
        return self.cofactors.slope(self.z, self.multipliers, self.errors)

    @property
    def descent(self) -> np.ndarray:
        """``−½∇Φ = Ãᵀλ``, (…, m)."""
        return _times(self.adjusted, self.multipliers)

    @property
    def curvature(self) -> np.ndarray:
        """``V = Σ λ² Q`` of the columns of A, (…, m, m)."""
        return self.cofactors.weighted_sum(self.multipliers, self.multipliers)[..., :-1, :-1]

    def step(self, N: np.ndarray) -> np.ndarray:
        """``x⁺ = x + N⁻¹ Ãᵀλ`` for a matrix N (…, m, m)."""
        return self.x + solve(N, self.descent[..., None])[..., 0]


def misclosures(problem: EIVProblem, x: np.ndarray) -> Misclosures:
    """``z = (−x, 1)`` (…, m+1) and the misclosures ``r = y − A x`` (…, n)."""
    z = np.concatenate([-x, np.ones(x.shape[:-1] + (1,))], axis=-1)
    return z, (z[..., None, :] @ problem.rows)[..., 0, :]


def objective(problem: EIVProblem, x: np.ndarray, weights: np.ndarray | float = 1.0) -> np.ndarray:
    """``Φ(x) = Σ ω r²/s``, or ``rᵀS⁻¹r``: the least weighted sum of squared errors for x."""
    return Evaluation(problem, x).value(weights)


def value_and_gradient(problem: EIVProblem, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """``Φ`` (…) and half its gradient ``½∇Φ = −Ãᵀλ`` (…, m)."""
    at = Evaluation(problem, x)
    return np.sum(at.multipliers * at.r, axis=-1), -at.descent


def derivatives(problem: EIVProblem, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """``Φ = rᵀS⁻¹r`` with half its gradient (…, m) and half its exact Hessian (…, m, m).

    ``½∇Φ = −Ãᵀλ``, ``½∇²Φ = BᵀS⁻¹B − V`` with ``B = A − slope``.

    Source: Fang 2013, for independent rows; here the slope is that of S in full.
    """
    at = Evaluation(problem, x)
    B = at.columns - at.slope
    return at.value(), -at.descent, at.weigh(B) @ B.mT - at.curvature


def newton_step(problem: EIVProblem, x: np.ndarray) -> np.ndarray:
    """One Newton step with the exact Hessian, or a Gauss-Newton step where Φ would not fall.

    That is halved until Φ falls. Far from the solution the Hessian need not be positive definite,
    and a Newton step can lead to a saddle. A Gauss-Newton step always starts downhill.
    """
    value, gradient, hessian = derivatives(problem, x)
    step = -solve(hessian, gradient[..., None])[..., 0]
    highest = value * (1 + 1e-12)
    good = (_eigenvalues(hessian)[..., 0] > 0) & (objective(problem, x + step) <= highest)
    if np.all(good):
        return x + step
    other = shen_step(problem, x) - x
    for _ in range(HALVINGS):
        climbs = ~(objective(problem, x + other) <= highest) & ~good
        if not np.any(climbs):
            break
        other = np.where(climbs[..., None], 0.5 * other, other)
    return x + np.where(good[..., None], step, other)


def schaffrin_wieser_step(
    problem: EIVProblem, x: np.ndarray, weights: np.ndarray | float = 1.0, known=None
) -> np.ndarray:
    """One step ``x⁺ = (AᵀWA − V)⁻¹ (AᵀWy − v)`` from x; robust ``weights`` ω ≥ 0 act on whole rows.

    ``W = ω/s``, ``t = r/s`` and ``[V v] = Σ ω t² Q_i`` (for the Kronecker form V = ν Q_0). Computed
    as the increment ``(AᵀWA − V)⁻¹ (AᵀWr + Vx − v)``. Nothing is divided by ω, so a weight of zero
    takes its row out and leaves no NaN behind. ``known`` as for :class:`Evaluation`.

    Source: Schaffrin & Wieser 2008; Ou & Liu 2017, eqs. (16)-(17), with V and v extended to any
    cofactors of the rows.
    """
    at = Evaluation(problem, x, known)
    weighed = at.weigh(at.columns, weights)
    V = at.cofactors.weighted_sum(weights * at.multipliers, at.multipliers)[..., :-1, :]
    right = weighed @ at.r[..., None] - V @ at.z[..., None]
    return x + solve(weighed @ at.columns.mT - V[..., :-1], right)[..., 0]


def shen_step(problem: EIVProblem, x: np.ndarray) -> np.ndarray:
    """One Gauss-Newton step, ``N = ÃᵀWÃ``; that of Gauss-Helmert adjustment."""
    at = Evaluation(problem, x)
    return at.step(at.weigh(at.adjusted) @ at.adjusted.mT)


def amiri_simkooei_step(problem: EIVProblem, x: np.ndarray) -> np.ndarray:
    """One step ``x⁺ = (ÃᵀWÃ)⁻¹ ÃᵀWỹ`` with ``ỹ = y − Ẽx``: least squares of the adjusted rows.

    As ``ỹ − Ãx = r`` it is :func:`shen_step` but for rounding; here as its authors print it.
    """
    at = Evaluation(problem, x)
    y = at.rows[..., -1, :] - (x[..., None, :] @ at.errors)[..., 0, :]
    weighed = at.weigh(at.adjusted)
    return solve(weighed @ at.adjusted.mT, _times(weighed, y)[..., None])[..., 0]


def fang_step(problem: EIVProblem, x: np.ndarray) -> np.ndarray:
    """One step with ``N = AᵀWA``, printed as ``x⁺ = (AᵀWA)⁻¹ (AᵀWy − Ẽᵀλ)``."""
    at = Evaluation(problem, x)
    return at.step(at.weigh(at.columns) @ at.columns.mT)


def mahboub_step(problem: EIVProblem, x: np.ndarray) -> np.ndarray:
    """One step with ``N = ÃᵀWA``, printed as ``x⁺ = (ÃᵀWA)⁻¹ ÃᵀWy``."""
    at = Evaluation(problem, x)
    return at.step(at.adjusted @ at.weigh(at.columns).mT)


@dataclass(frozen=True)
class _Step(Stack):
    """x (B, m) and the length (B,) of the step that led there."""

    x: np.ndarray
    length: np.ndarray


def iterate_to_convergence(
    problem: EIVProblem,
    x: np.ndarray,
    step: Callable[[EIVProblem, np.ndarray], np.ndarray],
    tolerance: float,
    max_iterations: int,
    watch: Callable[[np.ndarray], None] | None = None,
) -> tuple[np.ndarray, Convergence]:
    """Repeat ``x ← step(problem, x)`` for a stack x (B, m) until ``|Δx| ≤ tolerance·|x|``.

    A step that is down at rounding level and no longer shrinks ends it as converged, too.
    ``watch`` is called with every x.
    """

    def advance(problem: EIVProblem, state: _Step):
        new = step(problem, state.x)
        if watch is not None:
            watch(new)
        length, size = np.linalg.norm(new - state.x, axis=-1), np.linalg.norm(new, axis=-1)
        lost = ~np.isfinite(length)
        return _Step(np.where(lost[:, None], state.x, new), length), {
            Ending.SINGULAR: lost,
            Ending.SMALL_STEP: length <= tolerance * size,
            Ending.ROUNDING: (length >= state.length) & (length <= ROUNDING * size),
        }

    start = _Step(x, np.full(len(x), np.inf))
    # a lost problem is reported by its ending
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        state, convergence = iterate(problem, start, advance, max_iterations, tolerance)
    return state.x, convergence


@np.errstate(divide="ignore", invalid="ignore", over="ignore")  # what was lost has been reported
def only_minima(problem: EIVProblem, x: np.ndarray, convergence: Convergence) -> Convergence:
    """Mark as not converged every solution that is not a minimum of Φ.

    With errors as large as the columns an iteration can end at a saddle, where the Hessian has a
    negative eigenvalue, or run off to where Φ is flat: there its steps are small, but Newton's is
    not.
    """
    _, gradient, hessian = derivatives(problem, x)
    eigenvalues = _eigenvalues(hessian)
    saddle = eigenvalues[..., 0] < -1e-10 * eigenvalues[..., -1]
    left = np.linalg.norm(solve(hessian, gradient[..., None])[..., 0], axis=-1)
    flat = left > FLAT * np.linalg.norm(x, axis=-1)
    at_saddle = convergence.failed_where(convergence.converged & saddle, Ending.SADDLE.sentence)
    return at_saddle.failed_where(at_saddle.converged & flat, Ending.FLAT.sentence)


def _eigenvalues(hessian: np.ndarray) -> np.ndarray:
    """Eigenvalues (…, m), ascending; 0 for what is not finite."""
    fine = np.isfinite(hessian).all(axis=(-1, -2), keepdims=True)
    return np.linalg.eigvalsh(np.where(fine, hessian, 0.0))


def _times(columns: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """``Aᵀv`` for columns (…, m, n) of A and v (…, n)."""
    return (columns @ vector[..., None])[..., 0]
