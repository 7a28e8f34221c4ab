"""The sphere ``|p − k|² = r²`` as a linear errors-in-variables problem, and the methods that solve
it.

    Y_i = w_i = |p_i|²,   A_i = (2x_i, 2y_i, 2z_i, 1),   X = (a, b, c, δ),   δ = r² − |k|²
                                                                    (Ou & Liu 2017, eqs. 1-2)

Everything is solved in coordinates ``D = (p − origin)/length``, origin the centroid: the rows
``(2D, 1, |D|²)`` are the printed rows times a known matrix (:func:`_to_cloud_frame`), so the
printed weights, which depend on the printed origin, are carried over exactly and only the
rounding error of large coordinates is lost. Pure TLS alone must see the printed numbers.

The algebraic residual is ``r_i = w_i − A_i X = |p_i − k|² − r² = d_i (2r + d_i)`` with d the
orthogonal distance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..adjustment.cofactors import gauss_newton_cofactor
from ..adjustment.iteration import Convergence, iterate_to_convergence, only_minima
from ..adjustment.linalg import cofactor_from_factor, propagate, solve, unit_weight_sd
from ..adjustment.problem import CommonCofactors, EIVProblem, IndependentRows
from ..adjustment.steps import (
    derivatives,
    misclosures,
    newton_step,
    objective,
    schaffrin_wieser_step,
)
from ..adjustment.wtls import smallest_singular_solution
from ..checks import check_positive, check_whole_number
from ..orthogonal.cloud import Adjusted, Cloud, frame_of
from ..result import Fit

PARAMETERS = 4
# relative distance from the surface from which a step of Newton ends at rounding level
NEARLY = 1e-9


class SphereModel:
    """The sphere as a geometric model, parameters (a, b, c, r) in the cloud's frame."""

    dimension = 3
    sample = 4

    def __init__(self, held_radius: np.ndarray | None = None):
        self.held_radius = held_radius
        self.holds = held_radius is not None
        self.degrees = 3 if self.holds else 4

    def held(self, x: np.ndarray) -> np.ndarray:
        """x (B, 4) with the held radius put in."""
        return np.concatenate([x[:, :3], self.held_radius[:, None]], axis=-1) if self.holds else x

    def moved(self, x: np.ndarray, step: np.ndarray) -> np.ndarray:
        """x (…, 4) after a step in the centre and, unless it is held, the radius."""
        new = x.copy()
        new[..., : self.degrees] += step
        return new

    @staticmethod
    def distances(x: np.ndarray, points: np.ndarray) -> np.ndarray:
        """``|p − k| − r`` from |p|² − 2p·k + |k|², which in a centred frame loses nothing; x (B, K,
        4) → (B, K, n).
        """
        k = x[..., :3]
        squares = -2.0 * k @ points.swapaxes(-1, -2)
        squares += np.einsum("...i,...i->...", k, k)[..., None]
        squares += np.einsum("...ni,...ni->...n", points, points)[..., None, :]
        np.maximum(squares, 0.0, out=squares)
        np.sqrt(squares, out=squares)
        squares -= x[..., 3:]
        return squares

    def linearised(self, x: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distances (…, n) of points (…, n, 3) from x (…, 4), and their Jacobian
        ``(−(p − k)/|p − k|, −1)``, (…, 4 or 3, n).
        """
        J = np.empty(points.shape[:-2] + (self.degrees, points.shape[-2]))
        inwards = J[..., :3, :]
        np.subtract(x[..., :3, None], points.swapaxes(-1, -2), out=inwards)
        rho = np.sqrt(np.einsum("...in,...in->...n", inwards, inwards))
        inwards /= np.maximum(rho, np.finfo(float).tiny)[..., None, :]
        J[..., 3:, :] = -1.0
        return rho - x[..., 3:], J

    @staticmethod
    def normals(x: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Unit normals ``(p − k)/|p − k|`` at points (…, n, 3), outwards."""
        outwards = points - x[..., None, :3]
        rho = np.sqrt(np.einsum("...ni,...ni->...n", outwards, outwards))
        return outwards / np.maximum(rho, np.finfo(float).tiny)[..., None]

    @staticmethod
    def adjusted(x: np.ndarray, points) -> np.ndarray:
        """The places on the sphere nearest to the points in the metric of Q⁻¹, (B, n, 3).

        ``p̃ − k = (I + μQ)⁻¹(p − k)`` with the one root μ > −1/λ_max of ``|p̃ − k| = r``.
        """
        k = x[:, None, :3]
        q = np.einsum("bnij,bni->jbn", points.axes, points.D - k)
        variances = np.broadcast_to(np.moveaxis(points.variances, -1, 0), q.shape)
        radius = np.broadcast_to(x[:, 3:], q.shape[1:])
        mu = _multipliers(q.reshape(3, -1), variances.reshape(3, -1), radius.ravel())
        q /= 1.0 + mu.reshape(q.shape[1:]) * variances
        return k + np.einsum("bnij,jbn->bni", points.axes, q)

    @staticmethod
    def algebraic(points: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Weighted algebraic least squares (Kåsa) from the moments of the points."""
        rows = np.empty(points.shape[:-2] + (5, points.shape[-2]))
        rows[..., :3, :] = 2.0 * points.swapaxes(-1, -2)
        rows[..., 3, :] = 1.0
        rows[..., 4, :] = np.einsum("...ni,...ni->...n", points, points)
        N = (rows[..., :4, :] * weights[..., None, :]) @ rows.swapaxes(-1, -2)
        return _with_radius(solve(N[..., :4], N[..., 4:])[..., 0])

    @staticmethod
    def through(samples: np.ndarray) -> np.ndarray:
        """Spheres through four points (…, 4, 3): three differences of their equations give the
        centre.
        """
        first, others = samples[..., :1, :], samples[..., 1:, :]
        D = others - first
        k = solve(2.0 * D, np.einsum("...ni,...ni->...n", D, D)[..., None])[..., 0]
        radius = np.sqrt(np.einsum("...i,...i->...", k, k))
        return np.concatenate([k + first[..., 0, :], radius[..., None]], axis=-1)


def _multipliers(q: np.ndarray, variances: np.ndarray, r: np.ndarray) -> np.ndarray:
    """The root μ > −1/max(variances) of ``Σ_i (q_i/(1 + μ v_i))² = r²`` of each column of q (3, n),
    with variances (3, n) and r (n,).

    Newton on 1/|y|, which is nearly linear in μ. A column that a last step has brought to rounding
    level is done: a few grazing points need three times as many steps as the rest.
    """
    limit = -1.0 / variances.max(axis=0)
    mu = np.zeros(q.shape[1])
    found, todo = mu.copy(), np.arange(q.shape[1])
    for _ in range(60):
        factors = 1.0 / (1.0 + mu * variances)
        y_squared = q * factors
        y_squared *= y_squared
        # quicker than a sum over so short an axis
        square = y_squared[0] + y_squared[1] + y_squared[2]
        excess = np.sqrt(square) - r
        y_squared *= variances
        y_squared *= factors
        slope = y_squared[0] + y_squared[1] + y_squared[2]
        step = square * excess / (r * np.maximum(slope, np.finfo(float).tiny))
        mu = np.maximum(mu + step, limit + 0.1 * (mu - limit))
        found[todo] = mu
        far = np.abs(excess) > NEARLY * r
        if not far.any():
            break
        if np.count_nonzero(far) < 0.7 * len(far):  # else the copies cost more than they save
            q, variances, r, limit, mu, todo = (
                q[:, far],
                variances[:, far],
                r[far],
                limit[far],
                mu[far],
                todo[far],
            )
    return found


def _with_radius(x: np.ndarray) -> np.ndarray:
    """(k, r) from (k, δ); NaN without a real sphere."""
    return np.concatenate([x[..., :3], real_radius(x)[..., None]], axis=-1)


def squared_radius(x: np.ndarray) -> np.ndarray:
    """``r² = δ + |k|²`` of x = (k, δ), (…)."""
    return x[..., 3] + np.einsum("...i,...i->...", x[..., :3], x[..., :3])


def real_radius(x: np.ndarray) -> np.ndarray:
    """r of x = (k, δ), (…); NaN without a real sphere."""
    square = squared_radius(x)
    return np.sqrt(np.where(square > 0, square, np.nan))


@dataclass(frozen=True, eq=False, repr=False)
class SphereFit(Fit):
    """A fitted sphere; ``parameters`` are (a, b, c, r) in m."""

    NAMES = ("a", "b", "c", "r")

    @property
    def center(self) -> np.ndarray:
        """(…, 3) in m."""
        return self.parameters[..., :3]

    @property
    def radius(self):
        """(…) in m; NaN where the method found no real sphere."""
        return self.parameters[..., 3]

    def surface(self) -> tuple[SphereModel, np.ndarray, np.ndarray]:
        variances = np.diagonal(self.cofactor, axis1=-2, axis2=-1).reshape(-1, PARAMETERS)
        x = self.parameters.reshape(-1, PARAMETERS)
        held = np.all(variances[:, 3] <= 1e-12 * variances.max(axis=-1))
        model = SphereModel(x[:, 3] if held else None)
        return (
            model,
            x,
            np.broadcast_to(
                np.eye(PARAMETERS)[:, : model.degrees], (len(x), PARAMETERS, model.degrees)
            ),
        )


@dataclass(frozen=True, eq=False)
class SphereCloud(Cloud):
    """A stack of clouds with what every method of the sphere needs of them first.

    held_radius : (B,) in m, or None for a free radius
    factor : (B, 5, 5) triangular factor of the weighted rows ``(2D, 1, |D|²)``
    """

    held_radius: np.ndarray | None
    factor: np.ndarray

    @property
    def model(self) -> SphereModel:
        return SphereModel(None if self.held_radius is None else self.held_radius / self.length)

    def start(self) -> np.ndarray:
        """(B, 4) algebraic (a, b, c, r) in the cloud's frame, to go on from."""
        x = self.least_squares()
        # Noise can leave the algebraic fit without a real sphere; any radius of the cloud's size
        # will do then.
        radius = np.nan_to_num(real_radius(x), nan=1.0)
        return self.model.held(np.concatenate([x[:, :3], radius[:, None]], axis=-1))

    def bias(self, x: np.ndarray, sigma_0: np.ndarray) -> np.ndarray:
        """(B, 4) bias of second order of an orthogonal fit with equal isotropic noise: σ²/r of the
        radius.
        """
        if self.cofactors is not None or self.weights is not None or self.held_radius is not None:
            raise ValueError(
                "bias_correction: expected equally precise points and a free radius, got weights, cofactors or a held radius"
            )
        bias = np.zeros_like(x)
        bias[:, 3] = (sigma_0 / self.length) ** 2 / x[:, 3]
        return bias

    def fit(self, method: str, adjusted: Adjusted) -> SphereFit:
        """The result in m of an adjustment of (a, b, c, r) in the cloud's frame."""
        length = self.length[:, None]
        parameters = length * adjusted.x
        parameters[:, :3] += self.origin
        t = adjusted.cofactor.shape[-1]
        cofactor = np.zeros((len(parameters), PARAMETERS, PARAMETERS))
        cofactor[:, :t, :t] = adjusted.cofactor * length[..., None] ** 2
        return self._assembled(
            method, parameters, cofactor, adjusted.sigma, adjusted.convergence, adjusted.weights
        )

    def least_squares(self) -> np.ndarray:
        """(B, 4): minimises ``Σ P r²`` in the cloud's own frame."""
        return solve(self.factor[..., :4, :4], self.factor[..., :4, 4:])[..., 0]

    def rows(self) -> np.ndarray:
        """(B, 5, n) rows ``(2D, 1, |D|²)``, one array a column."""
        return _rows(self.points, self.origin, self.length)

    def printed(self, unit_weight: float) -> PrintedSphere:
        """The printed problem of eqs. (8)-(12): Q_X = 1/P_X for the three columns 2p, Q_Y = w Q_X,
        nothing in common.
        """
        Q_X = np.full((len(self.points), 1), 1.0) if self.weights is None else 1.0 / self.weights
        Q_X = Q_X / unit_weight
        w = np.einsum("bni,bni->bn", self.points, self.points)
        # A point in the origin of the coordinates has Q_Y = w Q_X = 0 and P_Y without bound, which
        # no solution survives.
        Q_Y = np.maximum(w, 1e-9 * w.max(axis=-1, keepdims=True)) * Q_X / self.length[:, None] ** 4
        problem = EIVProblem(
            self.rows(), CommonCofactors(_common_cofactors(self, [1, 1, 1, 0, 0]), Q_X, Q_Y)
        )
        return PrintedSphere(problem, self.origin, self.length)

    def finished(
        self,
        method,
        x,
        cofactor,
        sigma_0,
        convergence: Convergence | None = None,
        weights=None,
        history=(),
    ) -> SphereFit:
        """The result in m from x = (k, δ) and its cofactor in the cloud's frame."""
        parameters, J = geometry(self.origin, self.length, x)
        return self._assembled(
            method,
            parameters,
            propagate(cofactor, J),
            sigma_0,
            convergence or Convergence.closed_form(len(x)),
            weights,
            history,
        )

    def _assembled(
        self,
        method,
        parameters,
        cofactor,
        sigma_0,
        convergence: Convergence,
        weights=None,
        history=(),
    ) -> SphereFit:
        distances = np.empty(self.points.shape[:2])
        for piece in self.pieces():
            D = self.points[:, piece] - parameters[:, None, :3]
            distances[:, piece] = np.sqrt(np.einsum("bni,bni->bn", D, D)) - parameters[:, None, 3]
        imaginary = np.isnan(parameters[:, 3]) & convergence.converged
        return SphereFit(
            method=method,
            parameters=parameters,
            cofactor=cofactor,
            sigma_0=sigma_0,
            distances=distances,
            weights=np.broadcast_to(1.0, distances.shape) if weights is None else weights,
            iterations=convergence.iterations,
            converged=convergence.converged & ~imaginary,
            stop_reason=np.where(
                imaginary,
                "no real sphere: the squared radius δ + |k|² came out negative",
                convergence.stop_reason,
            ),
            history=history,
        )


def reduce(
    points: np.ndarray, weights=None, cofactors=None, first: int | None = None, *, radius=None
) -> SphereCloud:
    """Centre, scale and factorise a stack ``(B, n, 3)``; radius (B,) to be held or None, the others
    as the fields of :class:`Cloud`.

    Raises ``ValueError`` when the points of a cloud lie in a plane (so also on a circle, on a line
    or in one place) as far as their coordinates can tell: no sphere, or no single one, fits best.
    """
    frame = Cloud(points, weights, cofactors, first, *frame_of(points))
    cloud = SphereCloud(**vars(frame), held_radius=radius, factor=frame.factor_of(_rows))
    _require_a_sphere(cloud)
    return cloud


def _rows(points: np.ndarray, origin: np.ndarray, length: np.ndarray) -> np.ndarray:
    rows = np.empty((len(points), 5, points.shape[-2]))
    D = rows[:, :3]
    np.subtract(points.swapaxes(-1, -2), origin[..., None], out=D)
    D /= length[:, None, None]
    np.einsum("bin,bin->bn", D, D, out=rows[:, 4])
    D *= 2.0
    rows[:, 3] = 1.0
    return rows


def _require_a_sphere(cloud: SphereCloud) -> None:
    """The extents of the cloud along its principal axes must all stand out from the rounding of the
    coordinates.
    """
    centred = np.linalg.qr(cloud.factor[..., [3, 0, 1, 2]], mode="r")[..., 1:, 1:]
    extents = np.linalg.svd(centred, compute_uv=False) * (0.5 * cloud.length[:, None])
    if bad := cloud.degenerate(extents, 3):
        shape = ("all at one place", "on one line", "in one plane (or on one circle)")[bad[1]]
        raise ValueError(
            f"points: expected points that determine a sphere, got points {shape}{cloud.name(bad[0])}"
        )


def _to_cloud_frame(cloud: SphereCloud) -> np.ndarray:
    """(B, 5, 5) matrix L with ``(2D, 1, |D|²) = L (2p, 1, |p|²)``."""
    m, length = cloud.origin, cloud.length[:, None]
    L = np.zeros((len(m), 5, 5))
    L[:, [0, 1, 2], [0, 1, 2]] = 1.0 / length
    L[:, :3, 3] = -2.0 * m / length
    L[:, 3, 3] = 1.0
    L[:, 4, :3] = -m / length**2
    L[:, 4, 3] = np.sum(m * m, axis=-1) / cloud.length**2
    L[:, 4, 4] = 1.0 / cloud.length**2
    return L


def _to_printed_frame(cloud: SphereCloud) -> np.ndarray:
    """(B, 5, 5) inverse of :func:`_to_cloud_frame`."""
    m, length = cloud.origin, cloud.length[:, None]
    K = np.zeros((len(m), 5, 5))
    K[:, [0, 1, 2], [0, 1, 2]] = length
    K[:, :3, 3] = 2.0 * m
    K[:, 3, 3] = 1.0
    K[:, 4, :3] = m * length
    K[:, 4, 3] = np.sum(m * m, axis=-1)
    K[:, 4, 4] = cloud.length**2
    return K


def _common_cofactors(cloud: SphereCloud, printed: list[float]) -> np.ndarray:
    """The common cofactor ``diag(printed)`` of the printed rows (2p, 1, |p|²), in the cloud's
    frame.
    """
    L = _to_cloud_frame(cloud)
    return (L * np.array(printed)) @ L.swapaxes(-1, -2)


# --------------------------------------------------------------------------------- the methods


def ls(cloud: SphereCloud) -> SphereFit:
    """Algebraic least squares, ``min Σ P r²`` (Kåsa): errors in w alone.

    σ0 = √(ΣPr²/(n − 4)) in m². Source: Ou & Liu 2017, section 1.4 step 1.
    """
    x = cloud.least_squares()
    cofactor = cofactor_from_factor(cloud.factor[..., :4, :4])
    return cloud.finished(
        "ls", x, cofactor / cloud.length[:, None, None] ** 4, _algebraic_sd(cloud, x)
    )


def tls(cloud: SphereCloud) -> SphereFit:
    """Pure total least squares by SVD of ``[2p, 1 | w]``, ``min Σ r²/(1 + |X|²)``, as the paper
    uses it.

    The constant column is taken as noisy and the result depends on the coordinate origin and on the
    unit of length; large coordinates lose it altogether. σ0 = √(Σr²/(n − 4)) in m², as printed.
    Source: Ou & Liu 2017, tables 1-3.
    """
    X, _ = smallest_singular_solution(cloud.factor @ _to_printed_frame(cloud).swapaxes(-1, -2))
    k = (X[..., :3] - cloud.origin) / cloud.length[:, None]
    square = squared_radius(X) / cloud.length**2
    x = np.concatenate([k, (square - np.sum(k * k, axis=-1))[..., None]], axis=-1)
    return _common_fit(cloud, "tls", x, [1, 1, 1, 1, 1])


def mixed_ls_tls(cloud: SphereCloud) -> SphereFit:
    """Mixed LS-TLS, ``min Σ r²/(1 + |k|²)``: equal independent errors in 2p and w, the column of
    ones exact.

    The minimum is the square of the smallest singular value σ of the centred ``[2p | w]``. It is
    found as 1/σ, the largest singular value of the inverse, and ``k = k_LS + σ² (N − σ²I)⁻¹ k_LS``
    follows, N the normal matrix of the centred 2p: with a far origin the singular vector itself
    would be lost in rounding. σ0 = √(Σr²/(n − 4)) in m². Source: Van Huffel & Vandewalle 1991,
    sections 2.3 and 3.6.
    """
    length = cloud.length[:, None]
    R = np.linalg.qr(cloud.factor[..., [3, 0, 1, 2, 4]], mode="r")  # the exact column first
    noisy = R[:, 1:, 1:] * np.concatenate([length, length, length, length**2], axis=-1)[:, None, :]
    k_ls = solve(noisy[:, :3, :3], noisy[:, :3, 3:])[..., 0] + cloud.origin
    # Exact points leave no residual; one at rounding level changes nothing and can be inverted.
    residual = np.maximum(
        np.abs(noisy[:, 3, 3]), np.finfo(float).eps * np.abs(noisy[:, :3, 3]).max(axis=-1)
    )
    inverse = np.zeros_like(noisy)
    inverse[:, :3, :3] = solve(noisy[:, :3, :3], np.broadcast_to(np.eye(3), noisy[:, :3, :3].shape))
    inverse[:, :3, 3] = -k_ls / residual[:, None]
    inverse[:, 3, 3] = 1.0 / residual
    squared = np.linalg.norm(inverse, ord=2, axis=(-2, -1)) ** -2.0
    N = noisy[:, :3, :3].swapaxes(-1, -2) @ noisy[:, :3, :3]
    k = (
        k_ls
        + squared[:, None] * solve(N - squared[:, None, None] * np.eye(3), k_ls[..., None])[..., 0]
    )
    k = (k - cloud.origin) / length
    delta = (R[:, 0, 4] - np.einsum("bi,bi->b", R[:, 0, 1:4], k)) / R[:, 0, 0]  # Σr = 0
    return _common_fit(
        cloud, "mixed_ls_tls", np.concatenate([k, delta[:, None]], axis=-1), [1, 1, 1, 0, 1]
    )


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

    unit_weight : P_X of every point (times its a-priori weight); it scales σ0 and nothing else.

    Source: Ou & Liu 2017, eqs. (8)-(12), (16)-(18); Schaffrin & Wieser 2008.
    """
    check_whole_number(max_iterations, "max_iterations")
    problem = cloud.printed(check_positive(unit_weight, "unit_weight")).problem
    x, convergence = iterate_to_convergence(
        problem,
        cloud.least_squares(),
        schaffrin_wieser_step,
        check_positive(tolerance, "tolerance"),
        max_iterations,
    )
    convergence = only_minima(problem, x, convergence)
    sigma_0 = unit_weight_sd(objective(problem, x), cloud.count - PARAMETERS)
    return cloud.finished("wtls", x, gauss_newton_cofactor(problem, x), sigma_0, convergence)


# a sphere that shrinks onto a point is reported by its ending
@np.errstate(divide="ignore", invalid="ignore", over="ignore")
def eiv(cloud: SphereCloud, *, max_iterations: int = 100) -> SphereFit:
    """Consistent weighted total least squares: w and p have the errors that the points give them.

    ``s_i = 4 (p_i − k)ᵀQ_i(p_i − k)``, ``Φ = Σ r²/s`` (the gradient-weighted, or Sampson,
    distance), minimised by Newton steps with the exact Hessian. Independent of the origin; takes
    any cofactors of the points and a held radius. σ0 = √(Φ/(n − t)): in m without cofactors, else
    relative to them. The cofactors act along the normals at the observed points: where they differ
    much with direction that biases the sphere, and ``geometric``, which takes them at the adjusted
    points, is to be preferred.

    Source: Fang 2013; Ou & Liu 2017, eq. (3), with the correlation of w and p that it leaves out.
    """
    check_whole_number(max_iterations, "max_iterations")
    rows = cloud.rows()
    problem = EIVProblem(rows, PointCofactors(0.5 * rows[:, :3], cloud.cofactors_in_frame()))
    x = cloud.least_squares()
    free = PARAMETERS
    step = newton_step
    if cloud.held_radius is not None:
        free, radius = PARAMETERS - 1, cloud.held_radius / cloud.length
        x[:, 3] = radius**2 - np.sum(x[:, :3] ** 2, axis=-1)
        step = _newton_step_at_held_radius
    x, convergence = iterate_to_convergence(problem, x, step, 1e-14, max_iterations)
    if cloud.held_radius is None:
        convergence = only_minima(problem, x, convergence)
    sigma_0 = unit_weight_sd(objective(problem, x), cloud.count - free)
    cofactor = gauss_newton_cofactor(problem, x)
    if cloud.held_radius is not None:
        P = _tangent(x)
        cofactor = P @ solve(P.swapaxes(-1, -2) @ solve(cofactor, P), P.swapaxes(-1, -2))
    return cloud.finished("eiv", x, cofactor, sigma_0, convergence)


def _tangent(x: np.ndarray) -> np.ndarray:
    """(B, 4, 3) derivative of (k, δ) with respect to k where δ = r² − |k|² with r held."""
    P = np.zeros(x.shape[:1] + (4, 3))
    P[:, [0, 1, 2], [0, 1, 2]] = 1.0
    P[:, 3] = -2.0 * x[:, :3]
    return P


def _newton_step_at_held_radius(problem: EIVProblem, x: np.ndarray) -> np.ndarray:
    """Newton step in k alone, by the chain rule through δ = r² − |k|²; halved until the objective
    does not grow.
    """
    square = squared_radius(x)
    value, gradient, hessian = derivatives(problem, x)
    P = _tangent(x)
    reduced = P.swapaxes(-1, -2) @ hessian @ P - 2.0 * gradient[:, 3, None, None] * np.eye(3)
    step = -solve(reduced, P.swapaxes(-1, -2) @ gradient[..., None])[..., 0]
    for _ in range(30):
        k = x[:, :3] + step
        new = np.concatenate([k, (square - np.sum(k * k, axis=-1))[:, None]], axis=-1)
        worse = objective(problem, new) > value * (1 + 1e-12)
        if not worse.any():
            break
        step = np.where(worse[:, None], 0.5 * step, step)
    return new


@dataclass(frozen=True)
class PointCofactors(IndependentRows):
    """Cofactors of the rows (2D, 1, |D|²) that the cofactors Q of the points give them, to first
    order.

    D : (B, 3, n); Q : (B, n) or (B, 1) variances, or (B, n, 3, 3). With dw = 2D·dp and d(2D) = 2dp
        the
    misclosure for z has the cofactor ``4 gᵀQg`` with ``g = z_k + z_w D``; at z = (−k, −δ, 1) that
    is g = D − k.
    """

    D: np.ndarray
    Q: np.ndarray

    def _times(self, g: np.ndarray) -> np.ndarray:
        """4Q g for g (B, 3, n)."""
        if self.Q.ndim == 2:
            return 4.0 * self.Q[:, None, :] * g
        return 4.0 * np.einsum("bnij,bjn->bin", self.Q, g)

    def _normals(self, z: np.ndarray) -> np.ndarray:
        """g, (B, 3, n)."""
        g = z[:, 4, None, None] * self.D
        g += z[:, :3, None]
        return g

    def misclosure(self, z: np.ndarray) -> np.ndarray:
        g = self._normals(z)
        if self.Q.ndim == 2:
            return 4.0 * self.Q * np.einsum("bin,bin->bn", g, g)
        return np.einsum("bin,bin->bn", g, self._times(g))

    def column_cofactors(self, z: np.ndarray) -> np.ndarray:
        product = np.zeros(self.D.shape[:1] + (4,) + self.D.shape[2:])
        product[:, :3] = self._times(self._normals(z))
        return product

    def weighted_sum(self, multipliers: np.ndarray, t: np.ndarray) -> np.ndarray:
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

    def __getitem__(self, keep) -> PointCofactors:
        return PointCofactors(self.D[keep], self.Q[keep])


# ------------------------------------------------------------------------- what the methods share


@dataclass(frozen=True)
class PrintedSphere:
    """The printed problem of a stack in the clouds' own frames, and what leads back to the printed
    frame (``igg3.Printed``).
    """

    problem: EIVProblem
    origin: np.ndarray
    length: np.ndarray

    @staticmethod
    def distances(x: np.ndarray, r: np.ndarray) -> np.ndarray:
        """Signed distances in units of the cloud's length, from ``|p − k|² = r + R²``; NaN without
        a real sphere.
        """
        distances = r + squared_radius(x)[:, None]
        np.maximum(distances, 0.0, out=distances)
        np.sqrt(distances, out=distances)
        distances -= real_radius(x)[:, None]
        return distances

    def parameters(self, x: np.ndarray) -> np.ndarray:
        """(a, b, c, r) in m."""
        return geometry(self.origin, self.length, x)[0]

    def step(self, difference: np.ndarray) -> np.ndarray:
        """|ΔX| of X = (a, b, c, δ) in m and m² from a difference of x, (B,)."""
        dk = difference[:, :3] * self.length[:, None]
        ddelta = difference[:, 3] * self.length**2 - 2.0 * np.einsum("bi,bi->b", self.origin, dk)
        return np.sqrt(np.einsum("bi,bi->b", dk, dk) + ddelta**2)

    def __getitem__(self, keep) -> PrintedSphere:
        return PrintedSphere(self.problem[keep], self.origin[keep], self.length[keep])


def _compressed(cloud: SphereCloud, printed: list[float]) -> EIVProblem:
    """The problem in which all rows have the cofactor ``diag(printed)``: its triangular factor
    stands for its rows.
    """
    ones = np.ones((len(cloud.points), 1))
    return EIVProblem(
        cloud.factor.swapaxes(-1, -2),
        CommonCofactors(_common_cofactors(cloud, printed), ones, 0.0 * ones),
    )


def _algebraic_sd(cloud: SphereCloud, x: np.ndarray) -> np.ndarray:
    """``√(Σ P r²/(n − 4))`` in m²."""
    _, r = misclosures(EIVProblem(cloud.factor.swapaxes(-1, -2), None), x)
    return cloud.length**2 * unit_weight_sd(np.sum(r * r, axis=-1), cloud.count - PARAMETERS)


def geometry(
    origin: np.ndarray, length: np.ndarray, x: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Parameters (a, b, c, r) in m and their Jacobian with respect to x = (k, δ) of the cloud's
    frame, (B, 4, 4).
    """
    radius = real_radius(x)
    scale = length[:, None]
    parameters = np.concatenate([origin + scale * x[:, :3], scale * radius[:, None]], axis=-1)
    J = np.zeros(x.shape[:1] + (4, 4))
    J[:, [0, 1, 2], [0, 1, 2]] = scale
    J[:, 3, :3] = scale * x[:, :3] / radius[:, None]
    J[:, 3, 3] = 0.5 * length / radius
    return parameters, J


def _common_fit(cloud: SphereCloud, method: str, x: np.ndarray, printed: list[float]) -> SphereFit:
    """A fit whose rows all have the cofactor ``diag(printed)``, with σ0 as the algebraic residual."""
    problem = _compressed(cloud, printed)
    z, _ = misclosures(problem, x)
    s = problem.cofactors.misclosure(z)[:, 0]
    cofactor = gauss_newton_cofactor(problem, x) / (s * cloud.length**4)[:, None, None]
    return cloud.finished(method, x, cofactor, _algebraic_sd(cloud, x))
