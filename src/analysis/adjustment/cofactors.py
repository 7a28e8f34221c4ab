"""Three conventions of the cofactor of x, equal to first order in the errors.

With the multipliers ``λ = S⁻¹r``, the predicted errors Ẽ of A, ``B = A + (∂S/∂x)λ``, ``V = Σ λ² Q``
and ``W = S⁻¹``:

* ``gauss_newton``: ``(ÃᵀWÃ)⁻¹`` with ``Ã = A − Ẽ``. What ODRPACK and ISO/TS 28037 give.
* ``inverse_hessian``: ``2(∇²Φ)⁻¹ = (BᵀWB − V)⁻¹``. That of maximum likelihood with the observed
  information.
* ``propagated``: ``H⁻¹ J Q Jᵀ H⁻¹`` with ``H = ½∇²Φ``, ``J = ½∂²Φ/∂x∂ℓ``: the errors of the data ℓ
  = (A, y) followed through the implicit function ``∇Φ(x, ℓ) = 0``. That of the guides to
  uncertainty.

All are unscaled. They differ by terms of the relative size of the errors.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .linalg import cofactor_from_normal, propagate
from .problem import EIVProblem
from .steps import Evaluation, derivatives


def gauss_newton_cofactor(
    problem: EIVProblem, x: np.ndarray, weights: np.ndarray | float = 1.0
) -> np.ndarray:
    """Cofactor ``(ÃᵀWÃ)⁻¹`` of x, (…, m, m); ``weights`` ω act on whole rows."""
    at = Evaluation(problem, x)
    return cofactor_from_normal(at.weigh(at.adjusted, weights) @ at.adjusted.mT)


def inverse_hessian_cofactor(problem: EIVProblem, x: np.ndarray) -> np.ndarray:
    """Cofactor ``2(∇²Φ)⁻¹`` of x, (…, m, m). Source: Fang 2013 (Hessian)."""
    return cofactor_from_normal(derivatives(problem, x)[2])


def propagated_cofactor(problem: EIVProblem, x: np.ndarray) -> np.ndarray:
    """Cofactor ``H⁻¹ M H⁻¹`` of x, (…, m, m), by propagation through ``∇Φ(x, ℓ) = 0``.

    A change of the data gives ``d(½∇Φ) = −BᵀW dr − dAᵀλ``. With the cofactors S of dr and V of
    dAᵀλ, and T between the two, that has the cofactor ``M = BᵀWB + BᵀWT + TᵀWB + V``.

    Source: Malengo & Pennecchi 2013, there for a straight line.
    """
    at = Evaluation(problem, x)
    slope, V = at.slope, at.curvature
    # the slope is cov(A_j, r)λ = Ẽ_j and its transpose's part, T_j
    B, T = at.columns - slope, slope - at.errors
    weighed = at.weigh(B)
    BWB, BWT = weighed @ B.mT, weighed @ T.mT
    return propagate(BWB + BWT + BWT.mT + V, cofactor_from_normal(BWB - V))


CONVENTIONS: dict[str, Callable] = {
    "gauss_newton": gauss_newton_cofactor,
    "inverse_hessian": inverse_hessian_cofactor,
    "propagated": propagated_cofactor,
}
