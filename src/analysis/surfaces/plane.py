"""The plane ``n · p = ϱ``, and as ``z = a x + b y + c`` a linear errors-in-variables problem; the
methods that solve it.

    y_i = z_i,   A_i = (x_i, y_i, 1),   x = (a, b, c)                       (Wu, Chen & Wang, eqs.
    7-8)

Everything is solved in coordinates ``D = (p − origin)/length``, origin the centroid. Methods that
look for a, b and c cannot describe a vertical plane; the others look for the normal and do not mind
how the plane stands.

A plane is special: the misclosure ``n · p − ϱ`` is linear in the point, so its cofactor ``nᵀQn`` is
exact, the errors-in-variables fit is the orthogonal one, and with one weight a point it has a
closed form.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..adjustment.algorithms import ALGORITHMS
from ..adjustment.cofactors import gauss_newton_cofactor
from ..adjustment.iteration import Convergence, iterate_to_convergence, only_minima
from ..adjustment.linalg import propagate, unit_weight_sd
from ..adjustment.problem import CommonCofactors, EIVProblem, IndependentRows
from ..adjustment.steps import newton_step, objective
from ..adjustment.wtls import Estimate
from ..adjustment.wtls import ls as least_squares
from ..adjustment.wtls import tls as total_least_squares
from ..checks import check_one_of, check_whole_number
from ..orthogonal.cloud import Adjusted, Cloud, frame_of
from ..result import Fit

PARAMETERS = 3
# a beam in the plane has cos θ = 0; beyond this angle the weights stay what they are there
GRAZING = np.cos(np.deg2rad(89.9))
# n_z below which a plane is taken as vertical if noise could have tilted it so far (87°)
STEEP = 0.05


class PlaneModel:
    """The plane as a geometric model: x = (n, h), ``n · (p − pivot) = h`` with |n| = 1.

    Its free parameters are small rotations of n towards two tangents, and h. The pivot (B, 3) lies
    near the points; None is the origin.
    """

    dimension = 3
    degrees = 3
    sample = 3
    holds = False

    def __init__(self, pivot: np.ndarray | None = None):
        self.pivot = pivot

    def _reduced(self, points: np.ndarray) -> np.ndarray:
        return points if self.pivot is None else points - self.pivot[:, None, :]

    def distances(self, x: np.ndarray, points: np.ndarray) -> np.ndarray:
        """``n · (p − pivot) − h`` of points (B, n, 3) from planes x (B, K, 4), (B, K, n)."""
        distances = x[..., :3] @ self._reduced(points).swapaxes(-1, -2)
        distances -= x[..., 3:]
        return distances

    def linearised(self, x: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distances (…, n) of points (…, n, 3) from x (…, 4), and their Jacobian
        ``(t₁·D, t₂·D, −1)``, (…, 3, n).
        """
        D = self._reduced(points).swapaxes(-1, -2)
        J = np.empty(D.shape[:-2] + (3, D.shape[-1]))
        np.matmul(tangents(x[..., :3]).swapaxes(-1, -2), D, out=J[..., :2, :])
        J[..., 2, :] = -1.0
        return (x[..., None, :3] @ D)[..., 0, :] - x[..., 3:], J

    @staticmethod
    def moved(x: np.ndarray, step: np.ndarray) -> np.ndarray:
        n = x[..., :3] + (tangents(x[..., :3]) @ step[..., :2, None])[..., 0]
        h = x[..., 3:] + step[..., 2:]
        return np.concatenate([n, h], axis=-1) / np.linalg.norm(n, axis=-1, keepdims=True)

    @staticmethod
    def normals(x: np.ndarray, points: np.ndarray) -> np.ndarray:
        return np.broadcast_to(x[..., None, :3], points.shape)

    def adjusted(self, x: np.ndarray, points) -> np.ndarray:
        """The places on the plane nearest to the points in the metric of Q⁻¹:
        ``p̃ = p − Qn (n · p − h)/(nᵀQn)``.
        """
        along = np.einsum("bnij,bi->bnj", points.axes, x[:, :3])
        Qn = np.einsum("bnij,bnj->bni", points.axes, points.variances * along)
        d = self.distances(x[:, None], points.D)[:, 0]
        return points.D - Qn * (d / np.einsum("bni,bi->bn", Qn, x[:, :3]))[..., None]

    @staticmethod
    def held(x: np.ndarray) -> np.ndarray:
        return x

    @staticmethod
    def algebraic(points: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Weighted principal component analysis, from the moments of the points."""
        total = weights.sum(axis=-1)
        mean = (weights[..., None, :] @ points)[..., 0, :] / total[..., None]
        S = (points.swapaxes(-1, -2) * weights[..., None, :]) @ points
        S -= (total[..., None] * mean)[..., :, None] * mean[..., None, :]
        n = np.linalg.eigh(S)[1][..., 0]
        return np.concatenate([n, np.sum(n * mean, axis=-1, keepdims=True)], axis=-1)

    @staticmethod
    def through(samples: np.ndarray) -> np.ndarray:
        """Planes through three points (…, 3, 3); NaN where they lie on a line."""
        first = samples[..., 0, :]
        n = np.cross(samples[..., 1, :] - first, samples[..., 2, :] - first)
        length = np.linalg.norm(n, axis=-1, keepdims=True)
        n = n / np.where(length > 0, length, np.nan)
        return np.concatenate([n, np.sum(n * first, axis=-1, keepdims=True)], axis=-1)


def tangents(n: np.ndarray) -> np.ndarray:
    """Two unit vectors (…, 3, 2) across unit normals n (…, 3) and across each other.

    They are the images of e_x and e_y in the reflection that takes n to ∓e_z, which is never near
    to singular.

    >>> T = tangents(np.array([0.0, 0.6, -0.8]))
    >>> np.abs(np.round(T.T @ T, 12)).tolist(), np.abs(np.round(T.T @ [0.0, 0.6, -0.8], 12)).tolist()
    ([[1.0, 0.0], [0.0, 1.0]], [0.0, 0.0])
    """
    v = n.copy()
    v[..., 2] += np.where(n[..., 2] < 0, -1.0, 1.0)
    T = -v[..., :, None] * (v[..., :2] / (1.0 + np.abs(n[..., 2]))[..., None])[..., None, :]
    T[..., 0, 0] += 1.0
    T[..., 1, 1] += 1.0
    return T


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class PlaneFit(Fit):
    """A fitted plane; ``parameters`` are (a, b, c) of ``z = a x + b y + c``, c in m; NaN where the
    plane is vertical.

    normal : (…, 3) unit vector with z ≥ 0 (y, then x, decide where it is 0)
    offset : (…) in m, ``normal · p = offset``; ``distances`` are positive on the side of the normal
    normal_cofactor : (…, 4, 4) of (normal, offset), of rank 3
    centroid : (…, 3) of the points, in m
    """

    normal: np.ndarray
    offset: np.ndarray
    normal_cofactor: np.ndarray
    centroid: np.ndarray

    NAMES = ("a", "b", "c")
    PER_STACK = (*Fit.PER_STACK, "normal", "offset", "normal_cofactor", "centroid")

    @property
    def normal_covariance(self) -> np.ndarray:
        """(…, 4, 4) covariance of (normal, offset), scaled as ``covariance`` is."""
        return (
            self.normal_cofactor
            if self.absolute
            else np.asarray(self.sigma_0)[..., None, None] ** 2 * self.normal_cofactor
        )

    def surface(self) -> tuple[PlaneModel, np.ndarray, np.ndarray]:
        pivot, n, offset = (
            self.centroid.reshape(-1, 3),
            self.normal.reshape(-1, 3),
            np.reshape(self.offset, -1),
        )
        h = offset - np.sum(n * pivot, axis=-1)
        derivative = _slope_jacobian(n, offset) @ _normal_jacobian(n, pivot, 1.0)
        return PlaneModel(pivot), np.concatenate([n, h[:, None]], axis=-1), derivative


@dataclass(frozen=True, eq=False)
class PlaneCloud(Cloud):
    """A stack of clouds with what every method of the plane needs of them first.

    station : (3,) in m, where the scanner stood
    factor : (B, 4, 4) triangular factor of the weighted rows ``(1, D)``
    extents : (B, 3) singular values of the centred and weighted D; axes : (B, 3, 3) its principal
        axes, one a column
    """

    station: np.ndarray
    factor: np.ndarray
    extents: np.ndarray
    axes: np.ndarray

    model = PlaneModel()

    def principal(self) -> np.ndarray:
        """(B, 4) n and h of the plane with the least ``Σ P d²``, in the cloud's frame (weighted
        principal component analysis).
        """
        n = self.axes[..., 2]
        return np.concatenate([n, np.einsum("bi,bi->b", n, self.mean())[:, None]], axis=-1)

    def mean(self) -> np.ndarray:
        """(B, 3) weighted mean of D."""
        return self.factor[:, 0, 1:] / self.factor[:, 0, :1]

    def slope_rows(self) -> np.ndarray:
        """(B, 4, n) rows ``(D_x, D_y, 1, D_z)``, one array a column."""
        return _rows(self.points, self.origin, self.length)[:, [1, 2, 0, 3]]

    def slope_factor(self) -> np.ndarray:
        """(B, 4, 4) that stand for the weighted rows ``(D_x, D_y, 1, D_z)``, in a closed form."""
        return self.factor[..., [1, 2, 0, 3]]

    def least_squares(self) -> Estimate:
        """The plane with the least ``Σ P (z − a x − b y − c)²``, in the cloud's frame."""
        _require_not_vertical(self)
        rows = self.slope_factor()
        return least_squares(rows[..., :3], rows[..., 3])

    def in_metres(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(a, b, c) in the caller's frame from those in the cloud's frame, and their Jacobian (B,
        3, 3).
        """
        J = np.zeros((len(x), 3, 3))
        J[:, [0, 1], [0, 1]] = 1.0
        J[:, 2, :2] = -self.origin[:, :2]
        J[:, 2, 2] = self.length
        parameters = (J @ x[..., None])[..., 0]
        parameters[:, 2] += self.origin[:, 2]
        return parameters, J

    def printed(
        self, unit_weight: float, plane: np.ndarray | None = None, cosine_at: str = "raw"
    ) -> PrintedPlane:
        """The printed problem: ``Q_A = diag(1, 1, 0) ⊗ Q_X`` and ``Q_y = Q_X = 1/(P_X P cos θ)``.

        θ is the incidence angle on the ``plane`` (B, 3) of slopes in the cloud's frame, or on the
        LS plane.
        Source: Wu, Chen & Wang, section 2.
        """
        plane = self.least_squares().x if plane is None else plane
        P = unit_weight * np.maximum(self._cosines(plane, cosine_at), GRAZING)
        if self.weights is not None:
            P *= self.weights
        Q = 1.0 / (P * self.length[:, None] ** 2)
        C = np.broadcast_to(np.diag([1.0, 1.0, 0.0, 0.0]), (len(Q), 4, 4))
        return PrintedPlane(
            EIVProblem(self.slope_rows(), CommonCofactors(C, Q, Q)), self.origin, self.length
        )

    def _cosines(self, plane: np.ndarray, cosine_at: str) -> np.ndarray:
        return incidence_cosines(self.points, self.in_metres(plane)[0], self.station, at=cosine_at)

    def fit(self, method: str, adjusted: Adjusted) -> PlaneFit:
        """The result in m of an adjustment of (n, h) in the cloud's frame ."""
        n = adjusted.x[:, :3]
        normal_cofactor = propagate(
            adjusted.cofactor, _normal_jacobian(n, self.origin, self.length)
        )
        sign = _sign(n)
        n, h = n * sign[:, None], adjusted.x[:, 3] * sign * self.length
        # rounding shall not decide which way a vertical plane faces
        n = np.where(np.abs(n) < 8 * np.finfo(float).eps, 0.0, n)
        offset = h + np.sum(n * self.origin, axis=-1)
        parameters = np.stack([-n[:, 0], -n[:, 1], offset], axis=-1) / _or_nan(n[:, 2:])
        cofactor = propagate(normal_cofactor, _slope_jacobian(n, offset))
        return self._assembled(
            method,
            adjusted.sigma,
            adjusted.convergence,
            adjusted.weights,
            (parameters, cofactor),
            (n, offset, normal_cofactor),
            h,
        )

    def finished(
        self,
        method,
        x,
        cofactor,
        sigma_0,
        convergence: Convergence | None = None,
        weights=None,
        history=(),
    ) -> PlaneFit:
        """The result in m from slopes x = (a, b, c) and their cofactor in the cloud's frame."""
        parameters, J = self.in_metres(x)
        return self.described(
            method,
            parameters,
            propagate(cofactor, J),
            self.length * x[:, 2],
            sigma_0,
            convergence,
            weights,
            history,
        )

    def described(
        self,
        method,
        parameters,
        cofactor,
        height,
        sigma_0,
        convergence=None,
        weights=None,
        history=(),
    ) -> PlaneFit:
        """The result from (a, b, c) with its cofactor, and the height (B,) of the plane over the
        centroid, all in m.
        """
        a, b, c = parameters.T
        scale = 1.0 / np.sqrt(1.0 + a * a + b * b)
        n = np.stack([-a, -b, np.ones_like(a)], axis=-1) * scale[:, None]
        # Along a, b, c the vector (−a, −b, 1, c) changes by S; what is along n is taken out of it
        # by the normalisation.
        S = np.zeros((len(a), 4, 3))
        S[:, [0, 1, 3], [0, 1, 2]] = [-1.0, -1.0, 1.0]
        homogeneous = np.concatenate([n, (c * scale)[:, None]], axis=-1)
        J = scale[:, None, None] * (S - homogeneous[:, :, None] * (n[:, None, :] @ S[:, :3]))
        geometry = n, c * scale, propagate(cofactor, J)
        return self._assembled(
            method,
            sigma_0,
            convergence or Convergence.closed_form(len(parameters)),
            weights,
            (parameters, cofactor),
            geometry,
            height * scale,
            history,
        )

    def _assembled(
        self, method, sigma_0, convergence: Convergence, weights, slopes, geometry, h, history=()
    ) -> PlaneFit:
        parameters, cofactor = slopes
        normal, offset, normal_cofactor = geometry
        distances = np.empty(self.points.shape[:2])
        for piece in self.pieces():
            D = self.points[:, piece] - self.origin[:, None, :]
            distances[:, piece] = (D @ normal[..., None])[..., 0] - h[:, None]
        lost = ~np.isfinite(normal).all(axis=-1) & convergence.converged
        return PlaneFit(
            method=method,
            parameters=parameters,
            cofactor=cofactor,
            sigma_0=sigma_0,
            distances=distances,
            weights=np.broadcast_to(1.0, distances.shape) if weights is None else weights,
            iterations=convergence.iterations,
            converged=convergence.converged & ~lost,
            stop_reason=np.where(
                lost,
                "no plane: total least squares has no solution for these points",
                convergence.stop_reason,
            ),
            history=history,
            normal=normal,
            offset=offset,
            normal_cofactor=normal_cofactor,
            centroid=self.origin,
        )


def reduce(
    points: np.ndarray,
    weights=None,
    cofactors=None,
    first: int | None = None,
    *,
    station=(0.0, 0.0, 0.0),
) -> PlaneCloud:
    """Centre, scale and factorise a stack ``(B, n, 3)``; the arguments as the fields of
    :class:`PlaneCloud`.

    Raises ``ValueError`` when the points of a cloud lie on a line as far as their coordinates can
    tell.
    """
    frame = Cloud(points, weights, cofactors, first, *frame_of(points))
    factor = frame.factor_of(_rows)
    _, extents, Vt = np.linalg.svd(factor[..., 1:, 1:])
    if bad := frame.degenerate(extents * frame.length[:, None], 2):
        shape = ("all at one place", "on one line")[bad[1]]
        raise ValueError(
            f"points: expected points that determine a plane, got points {shape}{frame.name(bad[0])}"
        )
    return PlaneCloud(
        **vars(frame), station=station, factor=factor, extents=extents, axes=Vt.swapaxes(-1, -2)
    )


def incidence_cosines(points, plane, station=(0.0, 0.0, 0.0), *, at: str = "raw") -> np.ndarray:
    """``cos θ`` (…, n) of the incidence angles of beams from the station on the plane.

        raw:        cos θ = |a x + b y − z| / (√(a² + b² + 1) |p|)          projected:  cos θ̃ = |c|
                    / (√(a² + b² + 1) |p̃|)

    with p counted from the station, and p̃ the point projected on the plane along its normal. The
    error of a point moves the raw cosine, which then favours errors towards one side; the projected
    one is nearly free of that.

    Parameters
    ----------
    points : (…, n, 3) in m; plane : (…, 3) slopes a, b and c in m; station : (3,) in m; at :
        ``raw`` or ``projected``

    Raises ``ValueError`` for a point in the station.

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
        raise ValueError(
            f"points: expected points away from the station, got {np.count_nonzero(ranges == 0)} in it"
        )
    return np.abs((vectors @ n[..., None])[..., 0]) / ranges


# --------------------------------------------------------------------------------- the methods


def ls(cloud: PlaneCloud) -> PlaneFit:
    """Least squares, ``min Σ P (z − a x − b y − c)²``: errors in z alone.

    σ0 = √(ΣPv²/(n − 3)), of the vertical residuals. Source: Wu, Chen & Wang, method 1.
    """
    estimate = cloud.least_squares()
    return cloud.finished(
        "ls",
        estimate.x,
        estimate.cofactor / cloud.length[:, None, None] ** 2,
        _in_metres(cloud, estimate),
    )


def tls(cloud: PlaneCloud) -> PlaneFit:
    """Pure total least squares by SVD of ``[x, y, 1 | z]``, ``min Σ P v²/(1 + a² + b² + c²)``, as
    the paper uses it.

    The constant column is taken as noisy and the result depends on the coordinate origin and on the
    unit of length. σ0 = σ_min/√(n − 3). Source: Wu, Chen & Wang, method 2 (Q_A a unit matrix).
    """
    _require_not_vertical(cloud)
    K = np.zeros((len(cloud.points), 4, 4))  # printed rows (x, y, 1, z) from (D_x, D_y, 1, D_z)
    K[:, [0, 1, 3], [0, 1, 3]] = cloud.length[:, None]
    K[:, [0, 1, 3], 2] = cloud.origin
    K[:, 2, 2] = 1.0
    rows = cloud.slope_factor() @ K.swapaxes(-1, -2)
    estimate = total_least_squares(rows[..., :3], rows[..., 3])
    height = (
        estimate.x[:, 2]
        + np.sum(cloud.origin[:, :2] * estimate.x[:, :2], axis=-1)
        - cloud.origin[:, 2]
    )
    sigma_0 = unit_weight_sd(estimate.objective, cloud.count - PARAMETERS)
    return cloud.described("tls", estimate.x, estimate.cofactor, height, sigma_0)


def mixed_ls_tls(cloud: PlaneCloud) -> PlaneFit:
    """Mixed LS-TLS, ``min Σ P v²/(1 + a² + b²)``: equal independent errors in x, y and z, the
    column of ones exact.

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
    """Weighted total least squares with weights from the incidence angle, ``Q = 1/cos θ`` of x, y
    and z, column of ones exact.

    ``Φ = Σ P cos θ v²/(1 + a² + b²)`` is minimised for given weights. These are found from the LS
    plane, and then again from the plane they gave. σ0 = √(Φ/(n − 3)) is the standard deviation of a
    coordinate at cos θ = 1.

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
    x = cloud.least_squares().x
    iterations = np.zeros(len(x), dtype=int)
    for _ in range(1 + reweightings):
        problem = cloud.printed(1.0, x, cosine_at).problem
        x, convergence = minimise(problem, x, tolerance=1e-14, max_iterations=max_iterations)
        iterations += convergence.iterations
    convergence = only_minima(problem, x, convergence)
    sigma_0 = unit_weight_sd(objective(problem, x), cloud.count - PARAMETERS)
    return cloud.finished(
        "wtls",
        x,
        gauss_newton_cofactor(problem, x),
        sigma_0,
        Convergence(iterations, convergence.converged, convergence.stop_reason),
    )


def eiv(cloud: PlaneCloud, *, max_iterations: int = 100) -> PlaneFit:
    """Consistent weighted total least squares with any cofactors of the points,
    ``Φ = Σ (n·p − ϱ)²/(nᵀQn)``.

    For a plane this is the orthogonal fit in the metric of Q⁻¹, ``min Σ eᵀQ⁻¹e``, without
    approximation. Any orientation; independent of the origin. σ0 = √(Φ/(n − 3)): in m without
    cofactors, else relative to them. With one weight a point it is solved in closed form, otherwise
    by Newton steps with the exact Hessian.

    Source: Fang 2013.
    """
    return cloud.fit("eiv", _orthogonal(cloud, max_iterations))


def geometric(cloud: PlaneCloud, *, max_iterations: int = 100) -> PlaneFit:
    """Weighted orthogonal distance fit ``min Σ eᵀQ⁻¹e`` over the errors e of the points; for a
    plane the same as ``eiv``.

    Source: Pearson 1901; Pope 1972; Neitzel 2010.
    """
    return cloud.fit("geometric", _orthogonal(cloud, max_iterations))


# ------------------------------------------------------------------------- what the methods share


def _principal_components(cloud: PlaneCloud) -> Adjusted:
    """Closed form of ``min Σ P d²``; along the principal axes the normal matrix is diagonal."""
    x = cloud.principal()
    T, mean, total = tangents(x[:, :3]), cloud.mean(), cloud.factor[:, 0, 0] ** 2
    # Rotation about the weighted mean does not correlate with h there; h at the origin takes the
    # rotation along.
    along = cloud.axes[..., :2].swapaxes(-1, -2) @ T
    rotation = np.einsum("bki,bk,bkj->bij", along, cloud.extents[:, :2] ** -2.0, along)
    cofactor = np.zeros((len(x), 3, 3))
    cofactor[:, :2, :2] = rotation
    cofactor[:, 2, 2] = 1.0 / total
    J = np.broadcast_to(np.eye(3), cofactor.shape).copy()
    J[:, 2, :2] = (mean[:, None, :] @ T)[:, 0]
    cofactor = propagate(cofactor, J) / cloud.length[:, None, None] ** 2
    sigma = cloud.length * unit_weight_sd(cloud.extents[:, 2] ** 2, cloud.count - PARAMETERS)
    return Adjusted(x, cofactor, sigma, None, Convergence.closed_form(len(x)))


def _orthogonal(cloud: PlaneCloud, max_iterations: int) -> Adjusted:
    """``min Σ eᵀQ⁻¹e``: the plane as ``w = α u + β v + γ`` over its principal axes, which is never
    steep.
    """
    check_whole_number(max_iterations, "max_iterations")
    if cloud.cofactors is None:
        return _principal_components(cloud)
    axes = cloud.axes
    rows = np.empty((len(axes), 4, cloud.count))
    for piece in cloud.pieces():
        D = (cloud.points[:, piece] - cloud.origin[:, None, :]) / cloud.length[:, None, None]
        rows[:, [0, 1, 3], piece] = (D @ axes).swapaxes(-1, -2)
    rows[:, 2] = 1.0
    # heights from a length below the plane: |x| is about 1 then, and a relative step means
    # something
    rows[:, 3] += 1.0
    problem = EIVProblem(rows, RotatedCofactors(cloud.cofactors, axes))
    x, convergence = iterate_to_convergence(
        problem, np.tile([0.0, 0.0, 1.0], (len(axes), 1)), newton_step, 1e-14, max_iterations
    )
    convergence = only_minima(problem, x, convergence)
    # From (α, β, γ) to the normal and h, and to its rotations.
    w = np.concatenate([-x[:, :2], np.ones((len(x), 1))], axis=-1)
    scale = 1.0 / np.linalg.norm(w, axis=-1, keepdims=True)
    n = (axes @ (w * scale)[..., None])[..., 0]
    h = (x[:, 2:] - 1.0) * scale
    J = np.zeros((len(x), 3, 3))
    J[:, :2, :2] = -scale[..., None] * tangents(n).swapaxes(-1, -2) @ axes[..., :2]
    J[:, 2, :2] = -(h * scale**2) * x[:, :2]
    J[:, 2, 2] = scale[:, 0]
    cofactor = propagate(gauss_newton_cofactor(problem, x), J) / cloud.length[:, None, None] ** 2
    # The cofactors are in m² and the rows in units of the length.
    sigma = cloud.length * unit_weight_sd(objective(problem, x), cloud.count - PARAMETERS)
    return Adjusted(np.concatenate([n, h], axis=-1), cofactor, sigma, None, convergence)


@dataclass(frozen=True)
class RotatedCofactors(IndependentRows):
    """Cofactors of the rows (u, v, 1, w) that the cofactors Q (B, n, 3, 3) of the points give them,
    one rotation a cloud.

    axes : (B, 3, 3), u, v and w as columns. For z the misclosure has the cofactor ``gᵀQg`` with one
        g for all points of a cloud.
    """

    Q: np.ndarray
    axes: np.ndarray

    def _direction(self, z: np.ndarray) -> np.ndarray:
        return (self.axes @ z[..., [0, 1, 3], None])[..., 0]

    def misclosure(self, z: np.ndarray) -> np.ndarray:
        g = self._direction(z)
        return np.matmul(
            self.Q.reshape(self.Q.shape[:2] + (9,)),
            (g[:, :, None] * g[:, None, :]).reshape(-1, 9, 1),
        )[..., 0]

    def column_cofactors(self, z: np.ndarray) -> np.ndarray:
        g = self._direction(z)
        # (Q g) · u as one product of Q with u gᵀ, and so for v.
        products = np.einsum("bik,bj->bijk", self.axes[..., :2], g).reshape(-1, 9, 2)
        columns = np.zeros(self.Q.shape[:1] + (3,) + self.Q.shape[1:2])
        columns[:, :2] = (self.Q.reshape(self.Q.shape[:2] + (9,)) @ products).swapaxes(-1, -2)
        return columns

    def weighted_sum(self, multipliers: np.ndarray, t: np.ndarray) -> np.ndarray:
        Q = self.Q.reshape(self.Q.shape[:2] + (9,))
        total = ((multipliers * t)[:, None, :] @ Q).reshape(-1, 3, 3)
        rotated = self.axes.swapaxes(-1, -2) @ total @ self.axes
        result = np.zeros((len(rotated), 4, 4))
        result[:, np.array([0, 1, 3])[:, None], [0, 1, 3]] = rotated
        return result

    def __getitem__(self, keep) -> RotatedCofactors:
        return RotatedCofactors(self.Q[keep], self.axes[keep])


@dataclass(frozen=True)
class PrintedPlane:
    """The printed problem of a stack in the clouds' own frames, and what leads back to the printed
    frame (``igg3.Printed``).
    """

    problem: EIVProblem
    origin: np.ndarray
    length: np.ndarray

    @staticmethod
    def distances(x: np.ndarray, r: np.ndarray) -> np.ndarray:
        """Signed distances ``r/√(1 + a² + b²)`` in units of the cloud's length."""
        return r / np.sqrt(1.0 + np.sum(x[:, :2] ** 2, axis=-1))[:, None]

    def parameters(self, x: np.ndarray) -> np.ndarray:
        """(a, b, c), c in m."""
        parameters = np.concatenate([x[:, :2], self.length[:, None] * x[:, 2:]], axis=-1)
        parameters[:, 2] += self.origin[:, 2] - np.sum(self.origin[:, :2] * x[:, :2], axis=-1)
        return parameters

    def step(self, difference: np.ndarray) -> np.ndarray:
        """|ΔX| of X = (a, b, c) from a difference of x, (B,)."""
        dc = self.length * difference[:, 2] - np.sum(
            self.origin[:, :2] * difference[:, :2], axis=-1
        )
        return np.sqrt(np.sum(difference[:, :2] ** 2, axis=-1) + dc**2)

    def __getitem__(self, keep) -> PrintedPlane:
        return PrintedPlane(self.problem[keep], self.origin[keep], self.length[keep])


def _rows(points: np.ndarray, origin: np.ndarray, length: np.ndarray) -> np.ndarray:
    """(B, 4, n) rows ``(1, D)``."""
    rows = np.empty((len(points), 4, points.shape[-2]))
    rows[:, 0] = 1.0
    np.subtract(points.swapaxes(-1, -2), origin[..., None], out=rows[:, 1:])
    rows[:, 1:] /= length[:, None, None]
    return rows


def _require_not_vertical(cloud: PlaneCloud) -> None:
    """z = a x + b y + c must be a plane: not vertical, nor so steep that the noise of the points
    could have made it.
    """
    n = cloud.axes[..., 2]
    redundancy = max(cloud.count - PARAMETERS, 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        leverage = np.sum((cloud.axes[:, 2, :2] / cloud.extents[:, :2]) ** 2, axis=-1)
    sd = cloud.extents[:, 2] * np.sqrt(leverage / redundancy)
    steep = np.abs(n[:, 2]) <= np.maximum(np.minimum(3.0 * sd, STEEP), 1e-12)
    if steep.any():
        bad = int(np.flatnonzero(steep)[0])
        able = "mixed_ls_tls, eiv, geometric, robust"
        raise ValueError(
            f"points: expected a plane that is not vertical (z = a x + b y + c; else use {able}), got one{cloud.name(bad)}"
        )


def _in_metres(cloud: PlaneCloud, estimate: Estimate) -> np.ndarray:
    """σ0 in m of an estimate from the triangular factor, whose rows are fewer than the points."""
    return cloud.length * unit_weight_sd(estimate.objective, cloud.count - PARAMETERS)


def _sign(n: np.ndarray) -> np.ndarray:
    """−1 for normals (B, 3) that point the wrong way: z ≥ 0; where it is 0, y; where both are, x."""
    x, y, z = np.where(np.abs(n) < 8 * np.finfo(float).eps, 0.0, n).T
    return np.where((z < 0) | ((z == 0) & ((y < 0) | ((y == 0) & (x < 0)))), -1.0, 1.0)


def _or_nan(values: np.ndarray) -> np.ndarray:
    return np.where(values == 0, np.nan, values)


def _normal_jacobian(n: np.ndarray, pivot: np.ndarray, length) -> np.ndarray:
    """(B, 4, 3): of (n, offset) with respect to the rotations of n and h,
    ``offset = length · h + n · pivot``.
    """
    J = np.zeros((len(n), 4, 3))
    J[:, :3, :2] = T = tangents(n)
    J[:, 3, :2] = (pivot[:, None, :] @ T)[:, 0]
    J[:, 3, 2] = length
    return J


def _slope_jacobian(n: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """(B, 3, 4): of (a, b, c) = (−n_x, −n_y, offset)/n_z with respect to (n, offset); NaN for a
    vertical plane.
    """
    z = _or_nan(n[:, 2])
    J = np.zeros((len(n), 3, 4))
    J[:, [0, 1, 2], [0, 1, 3]] = np.stack([-1.0 / z, -1.0 / z, 1.0 / z], axis=-1)
    J[:, :, 2] = -np.stack([-n[:, 0], -n[:, 1], offset], axis=-1) / (z * z)[:, None]
    return J
