"""The sphere as a linear errors-in-variables problem: the papers' methods, and a consistent one.

    Y_i = w_i = |p_i|²,   A_i = (2x_i, 2y_i, 2z_i, 1),   X = (a, b, c, δ),   δ = r² − |k|²
                                                                    (Ou & Liu 2017, eqs. 1-2)

Here x is (k, δ) in coordinates ``D = (p − origin)/length``, origin the centroid. The rows
``(2D, 1, |D|²)`` are the printed rows times a known matrix (:func:`_frame_change`): the printed
weights, which depend on the printed origin, are carried over exactly, and only the rounding error
of large coordinates is lost. Pure TLS alone must see the printed numbers.

The algebraic residual is ``r_i = w_i − A_i X = |p_i − k|² − r² = d_i (2r + d_i)`` with d the
orthogonal distance.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..adjustment.cofactors import gauss_newton_cofactor
from ..adjustment.iteration import Stack
from ..adjustment.linalg import cofactor_from_factor, propagate, solve, unit_weight_sd
from ..adjustment.problem import CommonCofactors, EIVProblem, IndependentRows
from ..adjustment.steps import (
    derivatives,
    iterate_to_convergence,
    misclosures,
    newton_step,
    objective,
    only_minima,
    schaffrin_wieser_step,
)
from ..adjustment.wtls import smallest_singular_solution, triangular_factor
from ..checks import check_positive, check_whole_number
from ..result import Adjustment, Array
from .linear import PrintedSurface, solution
from .sphere import (
    PARAMETERS,
    SphereCloud,
    SphereFit,
    real_radius,
    rows,
    squared_radius,
    with_radius,
)


def ls(cloud: SphereCloud) -> SphereFit:
    """Algebraic least squares, ``min Σ P r²`` (Kåsa): errors in w alone.

    σ0 = √(ΣPr²/(n − 4)) in m². Source: Ou & Liu 2017, section 1.4 step 1.
    """
    x = cloud.least_squares()
    cofactor = cofactor_from_factor(cloud.factor[..., :4, :4])
    cofactor /= cloud.length[:, None, None] ** 4
    return _fit(cloud, "ls", Adjustment.closed_form(x, cofactor, _algebraic_sd(cloud, x)))


def tls(cloud: SphereCloud) -> SphereFit:
    """Pure total least squares by SVD of ``[2p, 1 | w]``, ``min Σ r²/(1 + |X|²)``: the paper's.

    The constant column is taken as noisy and the result depends on the coordinate origin and on the
    unit of length; large coordinates lose it altogether. σ0 = √(Σr²/(n − 4)) in m², as printed.
    Source: Ou & Liu 2017, tables 1-3.
    """
    back = _frame_change(-cloud.origin / cloud.length[:, None], 1.0 / cloud.length)
    X, _ = smallest_singular_solution(cloud.factor @ back.mT)
    k = (X[..., :3] - cloud.origin) / cloud.length[:, None]
    square = squared_radius(X) / cloud.length**2
    x = np.concatenate([k, (square - np.sum(k * k, axis=-1))[..., None]], axis=-1)
    return _common_fit(cloud, "tls", x, [1, 1, 1, 1, 1])


def mixed_ls_tls(cloud: SphereCloud) -> SphereFit:
    """Mixed LS-TLS, ``min Σ r²/(1 + |k|²)``: equal independent errors in 2p and w, ones exact.

    The minimum is the square of the smallest singular value σ of the centred ``[2p | w]``. It is
    found as 1/σ, the largest singular value of the inverse, and ``k = k_LS + σ² (N − σ²I)⁻¹ k_LS``
    follows, N the normal matrix of the centred 2p: with a far origin the singular vector itself
    would be lost in rounding. σ0 = √(Σr²/(n − 4)) in m². Source: Van Huffel & Vandewalle 1991,
    sections 2.3 and 3.6.
    """
    length = cloud.length[:, None]
    R = triangular_factor([cloud.factor[..., [3, 0, 1, 2, 4]]])  # the exact column first
    noisy = R[:, 1:, 1:] * length[..., None] ** [1, 1, 1, 2]
    A = noisy[:, :3, :3]
    k_ls = solve(A, noisy[:, :3, 3:])[..., 0] + cloud.origin
    # Exact points leave no residual; one at rounding level changes nothing and can be inverted.
    residual = np.maximum(
        np.abs(noisy[:, 3, 3]), np.finfo(float).eps * np.abs(noisy[:, :3, 3]).max(axis=-1)
    )
    inverse = np.zeros_like(noisy)
    inverse[:, :3, :3] = solve(A, np.broadcast_to(np.eye(3), A.shape))
    inverse[:, :3, 3] = -k_ls / residual[:, None]
    inverse[:, 3, 3] = 1.0 / residual
    squared = np.linalg.norm(inverse, ord=2, axis=(-2, -1)) ** -2.0
    shift = solve(A.mT @ A - squared[:, None, None] * np.eye(3), k_ls[..., None])[..., 0]
    k = (k_ls + squared[:, None] * shift - cloud.origin) / length
    delta = (R[:, 0, 4] - np.einsum("bi,bi->b", R[:, 0, 1:4], k)) / R[:, 0, 0]  # Σr = 0
    x = np.concatenate([k, delta[:, None]], axis=-1)
    return _common_fit(cloud, "mixed_ls_tls", x, [1, 1, 1, 0, 1])


def wtls(
    cloud: SphereCloud,
    *,
    unit_weight: float = 1.0,
    tolerance: float = 1e-12,
    max_iterations: int = 200,
) -> SphereFit:
    """Weighted total least squares with the printed cofactors, no robust weights, to convergence.

    ``Q_A = diag(1,1,1,0) ⊗ Q_X``, ``Q_Y = w Q_X``, ``Q_X = 1/P_X``; errors of w and p taken as
    independent, which makes the weights depend on the coordinate origin. σ0 = √(Φ/(n − 4)) in m is
    the standard deviation of 2x at P_X = 1.

    Parameters
    ----------
    unit_weight : P_X of every point (times its a-priori weight); it scales σ0 and nothing else.

    Source: Ou & Liu 2017, eqs. (8)-(12), (16)-(18); Schaffrin & Wieser 2008.
    """
    check_whole_number(max_iterations, "max_iterations")
    problem = printed_problem(cloud, check_positive(unit_weight, "unit_weight")).problem
    tolerance, x = check_positive(tolerance, "tolerance"), cloud.least_squares()
    x, convergence = iterate_to_convergence(
        problem, x, schaffrin_wieser_step, tolerance, max_iterations
    )
    convergence = only_minima(problem, x, convergence)
    return _fit(cloud, "wtls", solution(problem, x, convergence, cloud.count - PARAMETERS))


# a sphere that shrinks onto a point is reported by its ending
@np.errstate(divide="ignore", invalid="ignore", over="ignore")
def eiv(cloud: SphereCloud, *, max_iterations: int = 100) -> SphereFit:
    """Consistent weighted total least squares: w and p have the errors that the points give them.

    ``s_i = 4 (p_i − k)ᵀQ_i(p_i − k)``, ``Φ = Σ r²/s`` (the gradient-weighted, or Sampson,
    distance), minimised by Newton steps with the exact Hessian. Independent of the origin; takes
    any cofactors of the points and a fixed radius. σ0 = √(Φ/(n − t)): in m without cofactors, else
    relative to them. The cofactors act along the normals at the observed points: where they differ
    much with direction that biases the sphere, and ``geometric``, which takes them at the adjusted
    points, is to be preferred.

    Source: Fang 2013; Ou & Liu 2017, eq. (3), with the correlation of w and p that it leaves out.
    """
    check_whole_number(max_iterations, "max_iterations")
    A_w = rows(cloud.points, cloud.origin, cloud.length)
    problem = EIVProblem(A_w, PointCofactors(0.5 * A_w[:, :3], cloud.cofactors_in_frame()))
    x, redundancy = cloud.least_squares(), cloud.count - PARAMETERS
    if cloud.fixed_radius is None:
        x, convergence = iterate_to_convergence(problem, x, newton_step, 1e-14, max_iterations)
        convergence = only_minima(problem, x, convergence)
        return _fit(cloud, "eiv", solution(problem, x, convergence, redundancy))
    x[:, 3] = (cloud.fixed_radius / cloud.length) ** 2 - np.sum(x[:, :3] ** 2, axis=-1)
    x, convergence = iterate_to_convergence(
        problem, x, _newton_step_at_fixed_radius, 1e-14, max_iterations
    )
    adjustment, P = solution(problem, x, convergence, redundancy + 1), _tangent(x)
    cofactor = P @ solve(P.mT @ solve(adjustment.cofactor, P), P.mT)
    return _fit(cloud, "eiv", replace(adjustment, cofactor=cofactor))


# ----------------------------------------------------------------------------------- a fixed radius


def _tangent(x: Array) -> Array:
    """(B, 4, 3) derivative of (k, δ) with respect to k where δ = r² − |k|² with r fixed."""
    P = np.zeros(x.shape[:1] + (4, 3))
    P[:, [0, 1, 2], [0, 1, 2]] = 1.0
    P[:, 3] = -2.0 * x[:, :3]
    return P


def _newton_step_at_fixed_radius(problem: EIVProblem, x: Array) -> Array:
    """Newton step in k alone, through δ = r² − |k|²; halved until the objective does not grow."""
    square = squared_radius(x)
    value, gradient, hessian = derivatives(problem, x)
    P = _tangent(x)
    reduced = P.mT @ hessian @ P - 2.0 * gradient[:, 3, None, None] * np.eye(3)
    step = -solve(reduced, P.mT @ gradient[..., None])[..., 0]
    for _ in range(30):
        k = x[:, :3] + step
        new = np.concatenate([k, (square - np.sum(k * k, axis=-1))[:, None]], axis=-1)
        worse = objective(problem, new) > value * (1 + 1e-12)
        if not worse.any():
            break
        step = np.where(worse[:, None], 0.5 * step, step)
    return new


# ---------------------------------------------------------------------------------------- cofactors


@dataclass(frozen=True)
class PointCofactors(IndependentRows, Stack):
    """Cofactors of the rows (2D, 1, |D|²) from the cofactors Q of the points, to first order.

    D : (B, 3, n); Q : (B, n) or (B, 1) variances, or (B, n, 3, 3)

    With dw = 2D·dp and d(2D) = 2dp the misclosure for z has the cofactor ``4 gᵀQg`` with
    ``g = z_k + z_w D``; at z = (−k, −δ, 1) that is g = D − k.
    """

    D: Array
    Q: Array

    def _times(self, g: Array) -> Array:
        """4Q g for g (B, 3, n)."""
        if self.Q.ndim == 2:
            return 4.0 * self.Q[:, None, :] * g
        return 4.0 * np.einsum("bnij,bjn->bin", self.Q, g)

    def _normals(self, z: Array) -> Array:
        """g, (B, 3, n)."""
        g = z[:, 4, None, None] * self.D
        g += z[:, :3, None]
        return g

    def misclosure(self, z: Array) -> Array:
        g = self._normals(z)
        if self.Q.ndim == 2:
            return 4.0 * self.Q * np.einsum("bin,bin->bn", g, g)
        return np.einsum("bin,bin->bn", g, self._times(g))

    def column_cofactors(self, z: Array) -> Array:
        product = np.zeros(self.D.shape[:1] + (4,) + self.D.shape[2:])
        product[:, :3] = self._times(self._normals(z))
        return product

    def weighted_sum(self, multipliers: Array, t: Array) -> Array:
        weights = multipliers * t
        QD = self._times(self.D)
        total = np.zeros(weights.shape[:1] + (5, 5))
        if self.Q.ndim == 2:
            total[:, [0, 1, 2], [0, 1, 2]] = 4.0 * np.sum(weights * self.Q, axis=-1)[:, None]
        else:
            total[:, :3, :3] = 4.0 * np.einsum("bn,bnij->bij", weights, self.Q)
        total[:, :3, 4] = total[:, 4, :3] = np.einsum("bn,bin->bi", weights, QD)
        total[:, 4, 4] = np.einsum("bn,bin,bin->b", weights, QD, self.D)
        return total


def _frame_change(origin: Array, length: Array) -> Array:
    """(B, 5, 5) matrix L with ``(2D, 1, |D|²) = L (2p, 1, |p|²)`` for D = (p − origin)/length."""
    L = np.zeros((len(origin), 5, 5))
    L[:, [0, 1, 2], [0, 1, 2]] = 1.0 / length[:, None]
    L[:, :3, 3] = -2.0 * origin / length[:, None]
    L[:, 3, 3] = 1.0
    L[:, 4, :3] = -origin / length[:, None] ** 2
    L[:, 4, 3] = np.sum(origin * origin, axis=-1) / length**2
    L[:, 4, 4] = 1.0 / length**2
    return L


def _common_cofactors(cloud: SphereCloud, printed: list[float]) -> Array:
    """Common cofactor ``diag(printed)`` of the printed rows (2p, 1, |p|²), in the cloud's frame."""
    L = _frame_change(cloud.origin, cloud.length)
    return (L * np.array(printed)) @ L.mT


class PrintedSphere(PrintedSurface):
    """The printed problem of spheres."""

    @staticmethod
    def distances(x: Array, r: Array) -> Array:
        """From ``|p − k|² = r + R²``; NaN without a real sphere."""
        distances = r + squared_radius(x)[:, None]
        np.maximum(distances, 0.0, out=distances)
        np.sqrt(distances, out=distances)
        distances -= real_radius(x)[:, None]
        return distances

    def parameters(self, x: Array) -> Array:
        """(a, b, c, r) in m."""
        parameters = self.length[:, None] * with_radius(x)
        parameters[:, :3] += self.origin
        return parameters

    @staticmethod
    def fit(cloud: SphereCloud, method: str, adjustment: Adjustment) -> SphereFit:
        return _fit(cloud, method, adjustment)


def printed_problem(cloud: SphereCloud, unit_weight: float) -> PrintedSphere:
    """The problem of eqs. (8)-(12): Q_X = 1/P_X for the three columns 2p, Q_Y = w Q_X.

    P_X is ``unit_weight`` times the a-priori weights; 2p and w have no errors in common.
    """
    Q_X = np.ones((len(cloud.points), 1)) if cloud.weights is None else 1.0 / cloud.weights
    Q_X = Q_X / unit_weight
    w = np.einsum("bni,bni->bn", cloud.points, cloud.points)
    # A point in the origin of the coordinates has Q_Y = w Q_X = 0 and P_Y without bound, which
    # no solution survives.
    Q_Y = np.maximum(w, 1e-9 * w.max(axis=-1, keepdims=True)) * Q_X / cloud.length[:, None] ** 4
    cofactors = CommonCofactors(_common_cofactors(cloud, [1, 1, 1, 0, 0]), Q_X, Q_Y)
    A_w = rows(cloud.points, cloud.origin, cloud.length)
    jacobian = cloud.length[:, None, None] ** 2 * _frame_change(cloud.origin, cloud.length).mT
    return PrintedSphere(
        EIVProblem(A_w, cofactors), cloud.origin, cloud.length, jacobian[:, :4, :4]
    )


# ------------------------------------------------------------------------------------------ results


def _fit(cloud: SphereCloud, method: str, adjustment: Adjustment) -> SphereFit:
    """The result in m of an adjustment of (k, δ) in the frame."""
    x = with_radius(adjustment.x)
    J = np.zeros(x.shape + (PARAMETERS,))  # ∂(k, r)/∂(k, δ)
    J[:, [0, 1, 2], [0, 1, 2]] = 1.0
    J[:, 3, :3] = x[:, :3] / x[:, 3:]
    J[:, 3, 3] = 0.5 / x[:, 3]
    return cloud.fit(method, replace(adjustment, x=x, cofactor=propagate(adjustment.cofactor, J)))


def _common_fit(cloud: SphereCloud, method: str, x: Array, printed: list[float]) -> SphereFit:
    """A fit whose rows all have the cofactor ``diag(printed)``, σ0 as the algebraic residual."""
    ones = np.ones((len(x), 1))
    # The triangular factor stands for the rows.
    problem = EIVProblem(
        cloud.factor.mT, CommonCofactors(_common_cofactors(cloud, printed), ones, 0.0 * ones)
    )
    s = problem.cofactors.misclosure(misclosures(problem, x)[0])[:, 0]
    cofactor = gauss_newton_cofactor(problem, x) / (s * cloud.length**4)[:, None, None]
    return _fit(cloud, method, Adjustment.closed_form(x, cofactor, _algebraic_sd(cloud, x)))


def _algebraic_sd(cloud: SphereCloud, x: Array) -> Array:
    """``√(Σ P r²/(n − 4))`` in m²."""
    z = np.concatenate([-x, np.ones((len(x), 1))], axis=-1)
    r = (z[:, None, :] @ cloud.factor.mT)[:, 0]
    return cloud.length**2 * unit_weight_sd(np.sum(r * r, axis=-1), cloud.count - PARAMETERS)
