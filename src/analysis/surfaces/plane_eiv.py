"""The plane as a linear errors-in-variables problem: the paper's methods, and consistent ones.

    y_i = z_i,   A_i = (x_i, y_i, 1),   x = (a, b, c)           (Wu, Chen & Wang, eqs. 7-8)

Everything is solved in coordinates ``D = (p − origin)/length``, origin the centroid. Methods that
look for a, b and c cannot describe a vertical plane; the others look for the normal and do not mind
how the plane stands.

A plane is special: the misclosure ``n · p − ϱ`` is linear in the point, so its cofactor ``nᵀQn`` is
exact, the errors-in-variables fit is the orthogonal one, and with one weight per point it has a
closed form.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..adjustment.algorithms import ALGORITHMS
from ..adjustment.iteration import Stack
from ..adjustment.linalg import propagate, unit_weight_sd
from ..adjustment.problem import CommonCofactors, EIVProblem, IndependentRows
from ..adjustment.steps import iterate_to_convergence, newton_step, only_minima
from ..adjustment.wtls import Estimate
from ..adjustment.wtls import ls as least_squares
from ..adjustment.wtls import tls as total_least_squares
from ..blocks import point_pieces
from ..checks import check_one_of, check_whole_number
from ..orthogonal.cloud import DegenerateCloud
from ..result import Adjustment, Array
from .linear import PrintedSurface, solution
from .plane import PARAMETERS, PlaneCloud, PlaneFit, rows, tangents

# a beam in the plane has cos θ = 0; beyond this angle the weights stay what they are there
GRAZING = np.cos(np.deg2rad(89.9))
# n_z below which a plane is taken as vertical if noise could have tilted it so far (87°)
STEEP = 0.05
SLOPES = [1, 2, 0, 3]  # columns (D_x, D_y, 1, D_z) of (1, D)


def ls(cloud: PlaneCloud) -> PlaneFit:
    """Least squares, ``min Σ P (z − a x − b y − c)²``: errors in z alone.

    σ0 = √(ΣPv²/(n − 3)), of the vertical residuals. Source: Wu, Chen & Wang, method 1.
    """
    estimate = _least_squares(cloud)
    # σ0 in m; the rows of the triangular factor are fewer than the points.
    sigma = cloud.length * unit_weight_sd(estimate.objective, cloud.count - PARAMETERS)
    cofactor = estimate.cofactor / cloud.length[:, None, None] ** 2
    return _fit(cloud, "ls", Adjustment.closed_form(estimate.x, cofactor, sigma))


def tls(cloud: PlaneCloud) -> PlaneFit:
    """Pure total least squares by SVD of ``[x, y, 1 | z]``, ``min Σ P v²/(1 + a² + b² + c²)``.

    As the paper uses it: the constant column is taken as noisy, and the result depends on the
    coordinate origin and on the unit of length. σ0 = σ_min/√(n − 3).

    Source: Wu, Chen & Wang, method 2 (Q_A a unit matrix).
    """
    _require_not_vertical(cloud)
    K = np.zeros((len(cloud.points), 4, 4))  # printed rows (x, y, 1, z) from (D_x, D_y, 1, D_z)
    K[:, [0, 1, 3], [0, 1, 3]] = cloud.length[:, None]
    K[:, [0, 1, 3], 2] = cloud.origin
    K[:, 2, 2] = 1.0
    rows = cloud.factor[..., SLOPES] @ K.mT
    estimate = total_least_squares(rows[..., :3], rows[..., 3])
    a_b, c = estimate.x[:, :2], estimate.x[:, 2]
    height = c + np.sum(cloud.origin[:, :2] * a_b, axis=-1) - cloud.origin[:, 2]
    sigma_0 = unit_weight_sd(estimate.objective, cloud.count - PARAMETERS)
    adjustment = Adjustment.closed_form(estimate.x, estimate.cofactor, sigma_0)
    return _fit_slopes(cloud, "tls", adjustment, height)


def mixed_ls_tls(cloud: PlaneCloud) -> PlaneFit:
    """Mixed LS-TLS, ``min Σ P v²/(1 + a² + b²)``: equal independent errors in x, y, z, ones exact.

    This is ``min Σ P d²`` over the orthogonal distances, solved by weighted principal component
    analysis, for any orientation. σ0 = √(ΣPd²/(n − 3)). Source: Van Huffel & Vandewalle 1991,
    section 3.6; Pearson 1901.
    """
    return cloud.fit("mixed_ls_tls", _principal_components(cloud))


def wtls(
    cloud: PlaneCloud,
    *,
    algorithm: str = "bfgs",
    cosine_at: str = "raw",
    reweightings: int = 3,
    max_iterations: int = 200,
) -> PlaneFit:
    """Weighted total least squares, weights from the incidence angle, ``Q = 1/cos θ`` of x, y, z.

    The column of ones is exact. ``Φ = Σ P cos θ v²/(1 + a² + b²)`` is minimised for given weights.
    These are found from the LS plane, and then again from the plane they gave. σ0 = √(Φ/(n − 3)) is
    the standard deviation of a coordinate at cos θ = 1.

    Parameters
    ----------
    algorithm : a name from ``ALGORITHMS``; the paper's is a quasi-Newton one, and it does not say
        which
    cosine_at : where the beam meets the plane: ``raw`` at the measured point, as printed, or
        ``projected``: at the point projected on the plane, which keeps the errors of the points out
        of their weights
    reweightings : how often the weights are found again, 0 to keep those of the LS plane; the paper
        does not say

    Source: Wu, Chen & Wang, method 3.
    """
    minimise = ALGORITHMS[check_one_of(algorithm, ALGORITHMS, "algorithm")].function
    check_whole_number(max_iterations, "max_iterations")
    if reweightings != 0:
        check_whole_number(reweightings, "reweightings")
    x = _least_squares(cloud).x
    iterations = np.zeros(len(x), dtype=int)
    for _ in range(1 + reweightings):
        problem = printed_problem(cloud, 1.0, x, cosine_at).problem
        x, convergence = minimise(problem, x, tolerance=1e-14, max_iterations=max_iterations)
        iterations += convergence.iterations
    convergence = only_minima(problem, x, replace(convergence, iterations=iterations))
    return _fit(cloud, "wtls", solution(problem, x, convergence, cloud.count - PARAMETERS))


def eiv(cloud: PlaneCloud, *, max_iterations: int = 100) -> PlaneFit:
    """Consistent weighted total least squares with any cofactors, ``Φ = Σ (n·p − ϱ)²/(nᵀQn)``.

    For a plane this is the orthogonal fit in the metric of Q⁻¹, ``min Σ eᵀQ⁻¹e``, without
    approximation. Any orientation; independent of the origin. σ0 = √(Φ/(n − 3)): in m without
    cofactors, else relative to them. With one weight per point it is solved in closed form,
    otherwise by Newton steps with the exact Hessian.

    Source: Fang 2013.
    """
    return cloud.fit("eiv", _orthogonal(cloud, max_iterations))


def geometric(cloud: PlaneCloud, *, max_iterations: int = 100) -> PlaneFit:
    """Weighted orthogonal distance fit ``min Σ eᵀQ⁻¹e``; for a plane the same as ``eiv``.

    Source: Pearson 1901; Pope 1972; Neitzel 2010.
    """
    return cloud.fit("geometric", _orthogonal(cloud, max_iterations))


# ---------------------------------------------------------------------------------- vertical planes


def _least_squares(cloud: PlaneCloud) -> Estimate:
    """The plane with the least ``Σ P (z − a x − b y − c)²``, in the cloud's frame."""
    _require_not_vertical(cloud)
    factor = cloud.factor[..., SLOPES]
    return least_squares(factor[..., :3], factor[..., 3])


def _require_not_vertical(cloud: PlaneCloud) -> None:
    """Raise for a vertical plane, or one so steep that noise could have made a vertical one so."""
    extents, axes = cloud.principal_axes
    n = axes[..., 2]
    redundancy = max(cloud.count - PARAMETERS, 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        leverage = np.sum((axes[:, 2, :2] / extents[:, :2]) ** 2, axis=-1)
    sd = extents[:, 2] * np.sqrt(leverage / redundancy)
    steep = np.abs(n[:, 2]) <= np.maximum(np.minimum(3.0 * sd, STEEP), 1e-12)
    if steep.any():
        raise DegenerateCloud(
            "points: expected a plane that is not vertical (z = a x + b y + c; "
            "else use mixed_ls_tls, eiv, geometric, robust), got one",
            int(np.argmax(steep)),
        )


# --------------------------------------------------------------------------------------- orthogonal


def _principal_components(cloud: PlaneCloud) -> Adjustment:
    """Closed form of ``min Σ P d²``; along the principal axes the normal matrix is diagonal."""
    x = cloud.start()
    extents, axes = cloud.principal_axes
    T, mean, total = tangents(x[:, :3]), cloud.mean(), cloud.factor[:, 0, 0] ** 2
    # Rotation about the weighted mean does not correlate with h there; h at the origin takes the
    # rotation along.
    along = axes[..., :2].mT @ T
    cofactor = np.zeros((len(x), 3, 3))
    cofactor[:, :2, :2] = np.einsum("bki,bk,bkj->bij", along, extents[:, :2] ** -2.0, along)
    cofactor[:, 2, 2] = 1.0 / total
    J = np.broadcast_to(np.eye(3), cofactor.shape).copy()
    J[:, 2, :2] = (mean[:, None, :] @ T)[:, 0]
    cofactor = propagate(cofactor, J) / cloud.length[:, None, None] ** 2
    sigma = cloud.length * unit_weight_sd(extents[:, 2] ** 2, cloud.count - PARAMETERS)
    return Adjustment.closed_form(x, cofactor, sigma)


def _orthogonal(cloud: PlaneCloud, max_iterations: int) -> Adjustment:
    """``min Σ eᵀQ⁻¹e``: ``w = α u + β v + γ`` over the principal axes, which is never steep."""
    check_whole_number(max_iterations, "max_iterations")
    if cloud.cofactors is None:
        return _principal_components(cloud)
    _, axes = cloud.principal_axes
    A_w = np.empty((len(axes), 4, cloud.count))
    for piece in point_pieces(cloud.points):
        D = (cloud.points[:, piece] - cloud.origin[:, None, :]) / cloud.length[:, None, None]
        A_w[:, [0, 1, 3], piece] = (D @ axes).mT
    A_w[:, 2] = 1.0
    # heights from a length below the plane: |x| is about 1 then, and a relative step means
    # something
    A_w[:, 3] += 1.0
    problem = EIVProblem(A_w, RotatedCofactors(cloud.cofactors, axes))
    x = np.tile([0.0, 0.0, 1.0], (len(axes), 1))
    x, convergence = iterate_to_convergence(problem, x, newton_step, 1e-14, max_iterations)
    convergence = only_minima(problem, x, convergence)
    found = solution(problem, x, convergence, cloud.count - PARAMETERS)
    # From (α, β, γ) to the normal and h, and to its rotations.
    w = np.concatenate([-x[:, :2], np.ones((len(x), 1))], axis=-1)
    scale = 1.0 / np.linalg.norm(w, axis=-1, keepdims=True)
    n = (axes @ (w * scale)[..., None])[..., 0]
    h = (x[:, 2:] - 1.0) * scale
    J = np.zeros((len(x), 3, 3))
    J[:, :2, :2] = -scale[..., None] * tangents(n).mT @ axes[..., :2]
    J[:, 2, :2] = -(h * scale**2) * x[:, :2]
    J[:, 2, 2] = scale[:, 0]
    # The cofactors are in m² and the rows in units of the length.
    cofactor = propagate(found.cofactor, J) / cloud.length[:, None, None] ** 2
    x = np.concatenate([n, h], axis=-1)
    return replace(found, x=x, cofactor=cofactor, sigma=cloud.length * found.sigma)


@dataclass(frozen=True)
class RotatedCofactors(IndependentRows, Stack):
    """Cofactors of the rows (u, v, 1, w) from those Q (B, n, 3, 3) of the points.

    axes : (B, 3, 3), u, v and w as columns. For z the misclosure has the cofactor ``gᵀQg`` with one
        g for all points of a cloud.
    """

    Q: Array
    axes: Array

    def _direction(self, z: Array) -> Array:
        return (self.axes @ z[..., [0, 1, 3], None])[..., 0]

    def misclosure(self, z: Array) -> Array:
        g = self._direction(z)
        return np.matmul(
            self.Q.reshape(self.Q.shape[:2] + (9,)),
            (g[:, :, None] * g[:, None, :]).reshape(-1, 9, 1),
        )[..., 0]

    def column_cofactors(self, z: Array) -> Array:
        g = self._direction(z)
        # (Q g) · u as one product of Q with u gᵀ, and so for v.
        products = np.einsum("bik,bj->bijk", self.axes[..., :2], g).reshape(-1, 9, 2)
        columns = np.zeros(self.Q.shape[:1] + (3,) + self.Q.shape[1:2])
        columns[:, :2] = (self.Q.reshape(self.Q.shape[:2] + (9,)) @ products).mT
        return columns

    def weighted_sum(self, multipliers: Array, t: Array) -> Array:
        Q = self.Q.reshape(self.Q.shape[:2] + (9,))
        total = ((multipliers * t)[:, None, :] @ Q).reshape(-1, 3, 3)
        rotated = self.axes.mT @ total @ self.axes
        result = np.zeros((len(rotated), 4, 4))
        result[:, np.array([0, 1, 3])[:, None], [0, 1, 3]] = rotated
        return result


# ------------------------------------------------------------------------------ the printed problem


class PrintedPlane(PrintedSurface):
    """The printed problem of planes."""

    @staticmethod
    def distances(x: Array, r: Array) -> Array:
        """``r/√(1 + a² + b²)``."""
        return r / np.sqrt(1.0 + np.sum(x[:, :2] ** 2, axis=-1))[:, None]

    def parameters(self, x: Array) -> Array:
        """(a, b, c), c in m."""
        return _in_metres(self, x)[0]

    @staticmethod
    def fit(cloud: PlaneCloud, method: str, adjustment: Adjustment) -> PlaneFit:
        return _fit(cloud, method, adjustment)


def printed_problem(
    cloud: PlaneCloud, unit_weight: float, plane: Array | None = None, cosine_at: str = "raw"
) -> PrintedPlane:
    """The problem with ``Q_A = diag(1, 1, 0) ⊗ Q_X`` and ``Q_y = Q_X = 1/(P_X P cos θ)``.

    θ is the incidence angle on the ``plane`` (B, 3) of slopes in the cloud's frame, or on the
    LS plane. Source: Wu, Chen & Wang, section 2.
    """
    plane = _least_squares(cloud).x if plane is None else plane
    slopes, jacobian = _in_metres(cloud, plane)
    cosines = incidence_cosines(cloud.points, slopes, cloud.station, at=cosine_at)
    P = unit_weight * np.maximum(cosines, GRAZING)
    if cloud.weights is not None:
        P *= cloud.weights
    Q = 1.0 / (P * cloud.length[:, None] ** 2)
    C = np.broadcast_to(np.diag([1.0, 1.0, 0.0, 0.0]), (len(Q), 4, 4))
    A_z = rows(cloud.points, cloud.origin, cloud.length)[:, SLOPES]
    problem = EIVProblem(A_z, CommonCofactors(C, Q, Q))
    return PrintedPlane(problem, cloud.origin, cloud.length, jacobian)


def incidence_cosines(points, plane, station=(0.0, 0.0, 0.0), *, at: str = "raw") -> np.ndarray:
    """``cos θ`` (…, n) of the incidence angles of beams from the station on the plane.

        raw:        cos θ = |a x + b y − z| / (√(a² + b² + 1) |p|)
        projected:  cos θ̃ = |c| / (√(a² + b² + 1) |p̃|)

    with p counted from the station, and p̃ the point projected on the plane along its normal. The
    error of a point moves the raw cosine, which then favours errors towards one side; the projected
    one is nearly free of that.

    Parameters
    ----------
    points : (…, n, 3) in m; plane : (…, 3) slopes a, b and c in m; station : (3,) in m
    at : ``raw`` or ``projected``

    Raises
    ------
    ValueError for a point in the station.

    Example
    -------
    >>> incidence_cosines([[0.0, 0.0, -2.0], [2.0, 0.0, -2.0]], [0.0, 0.0, -2.0]).round(6)
    array([1.      , 0.707107])

    Source: Wu, Chen & Wang, eq. 9 (raw).
    """
    check_one_of(at, ("raw", "projected"), "cosine_at")
    plane, station = np.asarray(plane, dtype=float), np.asarray(station, dtype=float)
    vectors = np.asarray(points, dtype=float) - station
    n = np.concatenate([plane[..., :2], -np.ones(plane.shape[:-1] + (1,))], axis=-1)
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    if at == "projected":
        # of the plane over the station
        height = plane[..., 2] + plane[..., :2] @ station[:2] - station[2]
        vectors = vectors - n[..., None, :] * (
            (vectors @ n[..., None]) - (height * n[..., 2])[..., None, None]
        )
    ranges = np.linalg.norm(vectors, axis=-1)
    if not ranges.all():
        there = np.count_nonzero(ranges == 0)
        raise ValueError(f"points: expected points away from the station, got {there} in it")
    return np.abs((vectors @ n[..., None])[..., 0]) / ranges


# ------------------------------------------------------------------------------------------ results


def _in_metres(cloud: PlaneCloud | PrintedPlane, x: Array) -> tuple[Array, Array]:
    """(a, b, c) in the caller's frame from x (B, 3) in the cloud's; their Jacobian (B, 3, 3)."""
    J = np.zeros((len(x), 3, 3))
    J[:, [0, 1], [0, 1]] = 1.0
    J[:, 2, :2] = -cloud.origin[:, :2]
    J[:, 2, 2] = cloud.length
    parameters = (J @ x[..., None])[..., 0]
    parameters[:, 2] += cloud.origin[:, 2]
    return parameters, J


def _fit(cloud: PlaneCloud, method: str, adjustment: Adjustment) -> PlaneFit:
    """The result in m of an adjustment of (a, b, c) in the frame."""
    height = cloud.length * adjustment.x[:, 2]
    parameters, J = _in_metres(cloud, adjustment.x)
    adjustment = replace(adjustment, x=parameters, cofactor=propagate(adjustment.cofactor, J))
    return _fit_slopes(cloud, method, adjustment, height)


def _fit_slopes(cloud: PlaneCloud, method: str, adjustment: Adjustment, height: Array) -> PlaneFit:
    """The result of (a, b, c) in m; height (B,) of the plane over the centroid, in m."""
    a, b, c = adjustment.x.T
    scale = 1.0 / np.sqrt(1.0 + a * a + b * b)
    n = np.stack([-a, -b, np.ones_like(a)], axis=-1) * scale[:, None]
    # Along a, b, c the vector (−a, −b, 1, c) changes by S; what is along n is taken out of it
    # by the normalisation.
    S = np.zeros((len(a), 4, 3))
    S[:, [0, 1, 3], [0, 1, 2]] = [-1.0, -1.0, 1.0]
    homogeneous = np.concatenate([n, (c * scale)[:, None]], axis=-1)
    J = scale[:, None, None] * (S - homogeneous[:, :, None] * (n[:, None, :] @ S[:, :3]))
    normal_cofactor = propagate(adjustment.cofactor, J)
    return cloud.described(method, adjustment, n, c * scale, normal_cofactor, height * scale)
