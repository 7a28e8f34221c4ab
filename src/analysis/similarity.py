"""The similarity transformation ``X = t + μ R x`` between two frames, from pairs of points known in
both.

    umeyama             closed form by SVD: least squares, all errors in the target (also the start
                        of the others)
    thirteen_parameters the model with nine direction cosines and six constraints, as printed
    fit_similarity      adjustment with errors in both frames, with covariance, and robust where
                        asked

A pair has the misclosure ``r = X − t − μ R x``; with cofactors Q_x and Q_X of its two points r has
the cofactor ``S = Q_X + μ² R Q_x Rᵀ``, and the adjustment is ``min Σ rᵀ S⁻¹ r``. Its parameters are
(t, ω, μ), ω a small rotation about the axes of the target frame, ``R ← exp([ω]×) R``, so their
cofactor obeys no constraint. Everything is solved about the centroids of the two sets.

References
----------
Chen, Shen & Liu (2004), Geomatics and Information Science of Wuhan University 29, 1101-1105
(thirteen parameters). Kabsch (1976), Acta Crystallographica A 32, 922-923.
Li, Lu, Zhu, Lu, Wu & Li (2015), tunnel sections from laser scans, eqs. (7)-(8).
Neitzel (2010), Journal of Geodesy 84, 751-762 (errors in both frames by Gauss-Helmert).
Umeyama (1991), IEEE Transactions on Pattern Analysis and Machine Intelligence 13, 376-380.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import combinations
from math import comb

import numpy as np
from scipy.integrate import quad
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, norm
from scipy.stats import f as fisher

from .adjustment.iteration import Ending, Stack, iterate
from .adjustment.linalg import cofactor_from_normal, propagate, solve, unit_weight_sd
from .adjustment.weights import EFFICIENT_THRESHOLDS, IGG3
from .blocks import BLOCK, pieces
from .checks import check_positive, check_whole_number, covariance_array, finite_array, weight_array
from .result import warn_if_not_converged

SMALLEST = 3  # pairs that determine a similarity
TOLERANCE = 1e-13  # of a step, relative to the spread of the points
STALLED = 1e-9  # a step below this that no longer shrinks is rounding
SETTLED = 1e-9  # change of the robust weights
DOUBT = 0.01  # probability of a sum of squares from which variances said to be known are doubted
PATIENCE = 20  # iterations before weights that swing are damped
LINE = 1e-6  # points with a spread across below this part of the one along lie on a line
SUBSETS = 500  # subsets of three pairs that the robust start tries; all of them up to 15 pairs
SMALLEST_REDUNDANCY = 1e-3  # of a direction of a pair, when its misclosure is standardised


# --------------------------------------------------------------------------------- the result


@dataclass(frozen=True, eq=False, repr=False)
class Similarity:
    """``X = translation + scale · rotation @ x`` with its accuracy. A stack of fits gives every
    field its leading axes ``…``.

    scale : (…) μ; rotation : (…, 3, 3) R, det +1
    centre : (…, 3) the point of the source frame about which it was solved; image : (…, 3) where it
        comes to lie
    central_cofactor : (…, 7, 7) cofactor of (image, ω, μ), which hardly depend on one another;
        zeros for a scale held at 1
    sigma_0 : (…) unit-weight standard deviation, in m where no cofactors were given
    residuals : (…, n, 3) misclosures ``r = X − t − μ R x`` in m, in the target frame
    weights : (…, n) weight of each pair relative to its a-priori one; 0 is exactly 0
    redundancy : (…) three for each pair in use, less the parameters
    iterations, converged, stop_reason : (…) how it ended
    absolute : the cofactors were variances in m², so that the covariance is not scaled by σ0
    """

    method: str
    scale: np.ndarray
    rotation: np.ndarray
    centre: np.ndarray
    image: np.ndarray
    central_cofactor: np.ndarray
    sigma_0: np.ndarray
    residuals: np.ndarray
    weights: np.ndarray
    redundancy: np.ndarray
    iterations: np.ndarray
    converged: np.ndarray
    stop_reason: np.ndarray
    absolute: bool = False

    @property
    def translation(self) -> np.ndarray:
        """(…, 3) t in m, the image of the source frame's origin."""
        return self.transform(np.zeros(np.shape(self.scale) + (1, 3)))[..., 0, :]

    @property
    def rotation_vector(self) -> np.ndarray:
        """(…, 3) axis times angle of the rotation in rad, in the target frame."""
        vectors = Rotation.from_matrix(self.rotation.reshape(-1, 3, 3)).as_rotvec()
        return vectors.reshape(np.shape(self.scale) + (3,))

    @property
    def cofactor(self) -> np.ndarray:
        """(…, 7, 7) cofactor of (t, ω, μ): m, rad about the target axes, and 1."""
        J = np.broadcast_to(np.eye(7), self.central_cofactor.shape).copy()
        J[..., :3, :] = self._jacobian(np.zeros(np.shape(self.scale) + (1, 3)))[..., 0, :, :]
        return propagate(self.central_cofactor, J)

    @property
    def covariance(self) -> np.ndarray:
        """(…, 7, 7) of (t, ω, μ): ``sigma_0² · cofactor``, the cofactor itself where it is
        absolute.
        """
        return self._variance_factor * self.cofactor

    @property
    def standard_deviations(self) -> np.ndarray:
        """(…, 7) of (t, ω, μ)."""
        return np.sqrt(np.diagonal(self.covariance, axis1=-2, axis2=-1))

    @property
    def inliers(self) -> np.ndarray:
        """(…, n) bool: the pairs that are in use."""
        return self.weights > 0

    @property
    def scale_test(self) -> np.ndarray:
        """``|μ − 1| / σ_μ``; above 2 the scale is not 1. NaN where it was held at 1."""
        sd = np.sqrt(self._variance_factor[..., 0, 0] * self.central_cofactor[..., 6, 6])
        return np.abs(self.scale - 1.0) / np.where(sd > 0, sd, np.nan)

    @property
    def _variance_factor(self) -> np.ndarray:
        return (
            np.ones(np.shape(self.scale) + (1, 1))
            if self.absolute
            else np.asarray(self.sigma_0)[..., None, None] ** 2
        )

    def transform(self, points) -> np.ndarray:
        """Points (n, 3), (…, n, 3) or one (3,) of the source frame, in the target frame.

        >>> turned = fit_similarity([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[5, 5, 5], [5, 7, 5], [3, 5, 5]])
        >>> turned.transform([1, 1, 1]).round(12)
        array([3., 7., 7.])
        """
        points = _points(points)
        if points.ndim == 1:
            return self.transform(points[None])[..., 0, :]
        return self.image[..., None, :] + self._turned(points)

    def _turned(self, points: np.ndarray) -> np.ndarray:
        """``μ R (x − centre)``, (…, n, 3)."""
        return (points - self.centre[..., None, :]) @ (
            np.asarray(self.scale)[..., None, None] * self.rotation
        ).swapaxes(-1, -2)

    def _jacobian(self, points: np.ndarray) -> np.ndarray:
        """∂X/∂(image, ω, μ) of points of the source frame, (…, n, 3, 7)."""
        turned = self._turned(points)
        return _design(turned, turned / np.asarray(self.scale)[..., None, None])

    def common_errors(self, points) -> np.ndarray:
        """What the error of the transformation does to points (…, n, 3), as seven independent
        sources, (…, n, 3, 7) in m.

        Column k holds the displacements of all points by one standard deviation of source k, so
        with A_i of point i the points i and j have the covariance ``A_i A_jᵀ``: it is common to all
        points and does not average out over them.

        Source: propagation of the parameters' covariance, F Σ Fᵀ, as in Li et al. 2015.
        """
        values, vectors = np.linalg.eigh(self._variance_factor * self.central_cofactor)
        root = vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :]
        return self._jacobian(_points(points)) @ root[..., None, :, :]

    def transformed_covariance(self, points, cofactors=None) -> np.ndarray:
        """Covariance of each transformed point, ``F Σ Fᵀ + μ² R D Rᵀ``, (…, n, 3, 3) in m².

        points : (n, 3) or (…, n, 3) in the source frame
        cofactors : (n,) variances or (n, 3, 3) covariances D of the points themselves in m²,
            absolute; None for points without error
        """
        points = _points(points)
        if points.ndim == 1:
            raise ValueError(f"points: expected shape (n, 3) or (…, n, 3), got {points.shape}")
        common = self.common_errors(points)
        total = common @ common.swapaxes(-1, -2)
        if cofactors is None:
            return total
        R = np.asarray(self.scale)[..., None, None, None] * self.rotation[..., None, :, :]
        return total + propagate(_cofactors(cofactors, points.shape[:-1], "cofactors"), R)

    def inverse(self) -> Similarity:
        """The transformation from the target to the source frame, with the same pairs and accuracy.

        Its covariance is propagated, and its residuals are these turned and scaled:
        ``x − x(X) = −Rᵀ r/μ``.
        """
        scale = np.asarray(self.scale)[..., None, None]
        back = self.rotation.swapaxes(-1, -2)
        J = np.zeros(np.shape(self.scale) + (7, 7))
        J[..., :3, :3] = -back / scale
        J[..., 3:6, 3:6] = -back
        J[..., 6, 6] = -1.0 / np.asarray(self.scale) ** 2
        return _frozen(
            **{
                **vars(self),
                "scale": 1.0 / self.scale,
                "rotation": back,
                "centre": self.image,
                "image": self.centre,
                "central_cofactor": propagate(self.central_cofactor, J),
                "residuals": -(self.residuals @ self.rotation) / scale,
            }
        )

    def __repr__(self) -> str:
        shape = np.shape(self.scale)
        if shape:
            return f"Similarity(method={self.method!r}, stack of shape {shape}, {np.count_nonzero(self.converged)} converged)"
        used = f"{np.count_nonzero(self.inliers)} of {len(self.weights)} pairs in use"
        return f"Similarity(method={self.method!r}, scale={self.scale:.9g}, {used}; {self.stop_reason})"


def _frozen(**fields) -> Similarity:
    for value in fields.values():
        if isinstance(value, np.ndarray):
            value.flags.writeable = False
    return Similarity(**fields)


# -------------------------------------------------------------------------------- closed form


def umeyama(
    source, target, *, scale: bool = True, weights=None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """``min Σ w |X − t − μ R x|²`` in closed form: μ (…), R (…, 3, 3) with det +1, and t (…, 3).

        H = Σ w ΔX Δxᵀ = U S Vᵀ,   R = U D Vᵀ,   D = diag(1, 1, det UVᵀ),   μ = tr(S D)/Σ w |Δx|²,
        t = X̄ − μ R x̄

    Parameters, errors: as :func:`fit_similarity`. Any angle of rotation; points in a plane, too.

    Source: Kabsch 1976; Umeyama 1991, eqs. (40)-(43).

    >>> mu, R, t = umeyama([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[5, 5, 5], [5, 7, 5], [3, 5, 5]])
    >>> round(float(mu), 12), R.round(12) + 0, t.round(12)
    (2.0, array([[ 0., -1.,  0.],
           [ 1.,  0.,  0.],
           [ 0.,  0.,  1.]]), array([5., 5., 5.]))
    """
    x, X = _paired(source, target)
    w = np.ones(x.shape[:-1]) if weights is None else weight_array(weights, x.shape[:-1])
    centre, image = _mean(x, w), _mean(X, w)
    mu, R, T = _umeyama(x - centre[..., None, :], X - image[..., None, :], w, scale)
    return mu[()], R, image + T - mu[..., None] * (R @ centre[..., None])[..., 0]


def _umeyama(
    x: np.ndarray, X: np.ndarray, w: np.ndarray, free_scale: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same for stacks that are near their origins, w ≥ 0."""
    mean_x, mean_X = _mean(x, w), _mean(X, w)
    dx, dX = x - mean_x[..., None, :], X - mean_X[..., None, :]
    U, S, Vt = np.linalg.svd((w[..., None] * dX).swapaxes(-1, -2) @ dx)
    proper = np.sign(np.linalg.det(U @ Vt))
    S[..., 2] *= proper
    R = np.concatenate([U[..., :2], U[..., 2:] * proper[..., None, None]], axis=-1) @ Vt
    mu = (
        np.sum(S, axis=-1) / np.sum(w * np.sum(dx**2, axis=-1), axis=-1)
        if free_scale
        else np.ones(S.shape[:-1])
    )
    return mu, R, mean_X - mu[..., None] * (R @ mean_x[..., None])[..., 0]


# ------------------------------------------------------------------------------------ printed


@dataclass(frozen=True, eq=False)
class ThirteenParameters:
    """Result of :func:`thirteen_parameters`: (T, μ, a, b, c) with a, b, c the rows of R; fields as
    in :class:`Similarity`.

    centre, image : (…, 3) ``X = image + T + μ R (x − centre)``: the means of both sets, to which
        they were reduced
    cofactor : (…, 13, 13) of (T, μ, a, b, c), of rank 7
    """

    scale: np.ndarray
    rotation: np.ndarray
    translation: np.ndarray
    cofactor: np.ndarray
    sigma_0: np.ndarray
    residuals: np.ndarray
    iterations: np.ndarray
    converged: np.ndarray
    stop_reason: np.ndarray


def thirteen_parameters(
    source, target, *, weights=None, start=None, max_iterations: int = 50
) -> ThirteenParameters:
    """The model with thirteen parameters and six constraints, as printed: T, μ and nine direction
    cosines.

        v = dT + R₀x dμ + μ₀ (x·da, x·db, x·dc)ᵀ − l,   l = X − T₀ − μ₀ R₀ x
        (observations) a·a = b·b = c·c = 1,   a·b = a·c = b·c = 0,   linearised C dξ + w = 0
        (constraints)
        [BᵀPB  Cᵀ; C  0] [dξ; k] = [BᵀPl; −w],   σ0² = vᵀPv/(3n − 7)

    All errors are in the target. At its fixed point it is the solution by SVD, if the start was
    near enough: from elsewhere it may converge to a rotation with determinant +1 that is wrong,
    with a negative scale μ.

    Parameters
    ----------
    source, target : (…, n, 3) pairs of points in m, n ≥ 3.
    weights : (n,) or (…, n) positive weights P of the pairs, or None for ones.
    start : (3, 3) or (…, 3, 3) rotation to start from, with μ = 1 and T = 0 between the centroids.
        None for the solution by SVD: the unit matrix is no safe start for rotations of more than
        about 90°.
    max_iterations : of the linearised model.

    Both sets are reduced to their means and their spread; ``cofactor`` (…, 13, 13) is that of (T,
    μ, a, b, c) with T the shift between the means, the upper left block of the inverse. Raises
    ``ValueError`` as :func:`fit_similarity`. Not converged: ``converged`` is False, and
    ``stop_reason`` says why.

    Source: Chen, Shen & Liu 2004; Li et al. 2015, eqs. (7)-(8).

    >>> x = np.array([[0.0, 0, 0], [4, 0, 0], [0, 3, 0], [0, 0, 2]])
    >>> solution = thirteen_parameters(x, [1, 2, 3] + 2 * x[:, [1, 2, 0]])
    >>> round(float(solution.scale), 12), solution.translation.round(12)
    (2.0, array([1., 2., 3.]))
    """
    check_whole_number(max_iterations, "max_iterations")
    x, X = _paired(source, target)
    lead, n = x.shape[:-2], x.shape[-2]
    w = np.ones(lead + (n,)) if weights is None else weight_array(weights, lead + (n,))
    x, X, w = x.reshape(-1, n, 3), X.reshape(-1, n, 3), w.reshape(-1, n)
    count = len(x)
    centre, image = _mean(x, w), _mean(X, w)
    x, X = x - centre[:, None, :], X - image[:, None, :]
    length = _spread(x)
    reduced = np.stack([x, X], axis=1) / length[:, None, None, None]
    if start is None:
        mu, R, _ = _umeyama(x, X, w, True)
    else:
        mu, R = (
            np.ones(count),
            np.broadcast_to(_rotations(start, lead), lead + (3, 3)).reshape(-1, 3, 3),
        )
    parameters = np.concatenate([np.zeros((count, 3)), mu[:, None], R.reshape(-1, 9)], axis=-1)

    def advance(problem: _Rows, state: _Cosines):
        xi = state.xi
        normal, right = _constrained_normals(problem, xi)
        step = solve(normal, right[..., None])[:, :13, 0]
        size = np.abs(step).max(axis=-1)
        lost = ~np.isfinite(size)
        return _Cosines(np.where(lost[:, None], xi, xi + step), size), {
            Ending.SINGULAR: lost,
            Ending.PARAMETERS: size <= TOLERANCE,
            Ending.ROUNDING: (size >= state.size) & (size <= STALLED),
        }

    problem = _Rows(reduced[:, 0], reduced[:, 1], w)
    with np.errstate(invalid="ignore", over="ignore"):  # a lost problem is reported by its ending
        start = _Cosines(parameters, np.full(count, np.inf))
        end, convergence = iterate(problem, start, advance, max_iterations)
    xi = end.xi
    T, mu, R = length[:, None] * xi[:, :3], xi[:, 3], xi[:, 4:].reshape(-1, 3, 3)
    residuals = X - T[:, None, :] - mu[:, None, None] * (x @ R.swapaxes(-1, -2))
    inverse = solve(_constrained_normals(problem, xi)[0], np.eye(19)[None, :, :13])[:, :13]
    units = np.concatenate(
        [np.ones((count, 3)), np.repeat(1.0 / length[:, None], 10, axis=1)], axis=1
    )
    fields = {
        "scale": mu,
        "rotation": R,
        "translation": image + T - mu[:, None] * (R @ centre[..., None])[..., 0],
        "cofactor": units[:, :, None] * inverse * units[:, None, :],
        "sigma_0": unit_weight_sd(np.sum(w[..., None] * residuals**2, axis=(-1, -2)), 3 * n - 7),
        "residuals": residuals,
        **vars(convergence),
    }
    return ThirteenParameters(
        **{name: values.reshape(lead + values.shape[1:])[()] for name, values in fields.items()}
    )


@dataclass(frozen=True)
class _Rows(Stack):
    """Pairs of a stack of problems with weights: x, X (B, n, 3), w (B, n)."""

    x: np.ndarray
    X: np.ndarray
    w: np.ndarray


@dataclass(frozen=True)
class _Cosines(Stack):
    """Parameters ξ = (T, μ, a, b, c), (B, 13), and the largest change (B,) of the last step."""

    xi: np.ndarray
    size: np.ndarray


def _constrained_normals(problem: _Rows, xi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Matrix (B, 19, 19) and right side (B, 19) of the normal equations with the six constraints."""
    x, X, w = problem.x, problem.X, problem.w
    T, mu, R = xi[:, :3], xi[:, 3, None, None], xi[:, 4:].reshape(-1, 3, 3)
    turned = x @ R.swapaxes(-1, -2)
    B = np.zeros(x.shape[:2] + (3, 13))
    B[..., :3] = np.eye(3)
    B[..., 3] = turned
    for row in range(3):
        B[..., row, 4 + 3 * row : 7 + 3 * row] = mu * x
    misclosure = X - T[:, None, :] - mu * turned
    C = np.zeros((len(x), 6, 13))
    for k, (i, j) in enumerate([(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]):
        C[:, k, 4 + 3 * i : 7 + 3 * i] += R[:, j]
        C[:, k, 4 + 3 * j : 7 + 3 * j] += R[:, i]
    products = R @ R.swapaxes(-1, -2) - np.eye(3)
    normal, right = np.zeros((len(x), 19, 19)), np.zeros((len(x), 19))
    normal[:, :13, :13] = np.einsum("bn,bnki,bnkj->bij", w, B, B, optimize=True)
    normal[:, 13:, :13], normal[:, :13, 13:] = C, C.swapaxes(-1, -2)
    right[:, :13] = np.einsum("bn,bnki,bnk->bi", w, B, misclosure, optimize=True)
    right[:, 13:] = -products[:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    return normal, right


# --------------------------------------------------------------------------------- adjustment


def fit_similarity(
    source,
    target,
    *,
    scale: bool = True,
    weights=None,
    source_cofactors=None,
    target_cofactors=None,
    absolute: bool = False,
    robust: bool = False,
    seed: int = 0,
    max_iterations: int = 200,
) -> Similarity:
    """Similarity ``X = t + μ R x`` from pairs of points, any rotation,
    ``min Σ rᵀ(Q_X + μ² R Q_x Rᵀ)⁻¹ r``.

    Gauss-Helmert iterations from the solution by SVD. For isotropic cofactors in a constant
    proportion R does not depend on how the errors are shared between the frames, and μ solves
    ``C σ_x² μ² + (D σ_X² − E σ_x²) μ − C σ_X² = 0`` with C = ΣΔXᵀRΔx, D = Σ|Δx|², E = Σ|ΔX|²; the
    weights of the pairs matter for all parameters.

    Parameters
    ----------
    source, target : (n, 3) or (…, n, 3) coordinates of the same n ≥ 3 points in both frames, m. Not
        changed.
    scale : False holds μ at 1, as is right for two instruments that measure in metres unless
        ``scale_test`` rejects it.
    weights : (n,) or (…, n) positive weights of the pairs, the inverse of variances in the target
        frame; or
    source_cofactors, target_cofactors : cofactors of the points in each frame: one variance, (n,)
        or (…, n) variances, or (n, 3, 3) or (…, n, 3, 3) covariances; None for points without
        errors. Neither: unit variances in the target.
    absolute : the cofactors are variances in m² and not only in proportion; the covariance is then
        not scaled by σ0, and a robust adjustment judges misclosures by them. With few pairs this is
        worth much.
    robust : find wrong pairs and leave them out (at least four pairs): a start from the three pairs
        that agree with more than half of all, then IGG III weights on the test of each pair against
        the others.
    seed : of the subsets of three pairs, where there are too many to try all (more than 15 pairs).

    Returns
    -------
    Similarity, its fields with the leading axes of ``source``.

    Raises ``ValueError`` for unequal numbers of points, fewer than three pairs (robust: four),
    points on a line, NaN or infinity, weights that are not positive and weights beside cofactors.
    Not converged: ``converged`` is False, ``stop_reason`` says why, and a ``ConvergenceWarning`` is
    given.

    Source: Umeyama 1991 (start); Neitzel 2010 (errors in both frames); Yang, Song & Xu 2002 (IGG
    III).

    >>> x = np.array([[0.0, 0, 0], [4, 0, 0], [0, 3, 0], [0, 0, 2], [3, 2, 1]])
    >>> X = [1, 2, 3] + x[:, [1, 2, 0]]
    >>> X[4] += 1.0
    >>> similarity = fit_similarity(x, X, scale=False, robust=True)
    >>> similarity.translation.round(9), similarity.inliers
    (array([1., 2., 3.]), array([ True,  True,  True,  True, False]))
    """
    check_whole_number(max_iterations, "max_iterations")
    x, X = _paired(source, target, SMALLEST + 1 if robust else SMALLEST)
    if absolute and source_cofactors is None and target_cofactors is None:
        raise ValueError("absolute: expected cofactors, which are to be absolute, got none")
    Q_x, Q_X = _both_cofactors(weights, source_cofactors, target_cofactors, x.shape[:-1])
    return _fitted(x, X, Q_x, Q_X, scale, absolute, robust, seed, max_iterations)


def _fitted(
    x, X, Q_x, Q_X, scale: bool, absolute: bool, robust: bool, seed: int, max_iterations: int
) -> Similarity:
    """The fit of checked pairs (…, n, 3) with cofactors (…, n, 3, 3)."""
    lead, n = x.shape[:-2], x.shape[-2]
    x, X = x.reshape(-1, n, 3), X.reshape(-1, n, 3)
    Q_x, Q_X = Q_x.reshape(-1, n, 3, 3), Q_X.reshape(-1, n, 3, 3)
    # For the start each pair has the mean variance of its misclosure.
    mu = np.sqrt(_squares(X) / _squares(x)) if scale else np.ones(len(x))
    w = 3.0 / np.trace(Q_X + mu[:, None, None, None] ** 2 * Q_x, axis1=-2, axis2=-1)
    centre, image = _mean(x, w), _mean(X, w)
    pairs = _Pairs(
        x - centre[:, None, :],
        X - image[:, None, :],
        Q_x,
        Q_X,
        w,
        4 * np.finfo(float).eps * np.abs(X).max(axis=(-1, -2)),
    )
    adjusted = _adjust(pairs, scale, robust, absolute, seed, max_iterations)
    fields = {**adjusted, "centre": centre, "image": image + adjusted["image"]}
    fields = {name: values.reshape(lead + values.shape[1:])[()] for name, values in fields.items()}
    similarity = _frozen(
        method="robust" if robust else "least squares", absolute=absolute, **fields
    )
    warn_if_not_converged(similarity)
    return similarity


@dataclass(frozen=True)
class _Pairs(Stack):
    """Pairs of a stack of problems about their centroids: x, X (B, n, 3) with cofactors (B, n, 3,
    3), start weights w (B, n).

    rounding : (B,) of the given coordinates in m; misclosures below it are no reason to lose weight
    """

    x: np.ndarray
    X: np.ndarray
    Q_x: np.ndarray
    Q_X: np.ndarray
    w: np.ndarray
    rounding: np.ndarray


@dataclass(frozen=True)
class _State(Stack):
    """Parameters μ, R, T about the centroids; weights (B, n); iterations so far and last step (B,)."""

    mu: np.ndarray
    R: np.ndarray
    T: np.ndarray
    weights: np.ndarray
    age: np.ndarray
    length: np.ndarray


def _adjust(
    pairs: _Pairs, free_scale: bool, robust: bool, absolute: bool, seed: int, max_iterations: int
) -> dict[str, np.ndarray]:
    """Fields of :class:`Similarity` for a stack; ``image`` about the centroid."""
    function = IGG3(*EFFICIENT_THRESHOLDS) if robust else None
    t = 7 if free_scale else 6
    count, n = pairs.w.shape
    if robust:
        weights, inflation = (
            _trimmed_start(pairs, free_scale, seed),
            1.0 / _trimmed_variance(_half(n) / n),
        )
    else:
        weights, inflation = np.ones((count, n)), 1.0
    mu, R, T = _umeyama(pairs.x, pairs.X, weights * pairs.w, free_scale)

    def advance(pairs: _Pairs, state: _State):
        r, J, unit = _whitened(pairs, state.mu, state.R, state.T, t)
        weights = before = state.weights
        if function is not None:
            weights = _robust_weights(
                function, r, J, weights, np.where(state.age, 1.0, inflation), pairs, absolute
            )
            # Two pairs may throw each other out by turns: they go half of the way then.
            by_turns = (state.age[:, None] >= PATIENCE) & (np.abs(weights - before) > SETTLED)
            weights = np.where(by_turns, 0.5 * (before + weights), weights)
        N = np.einsum("bn,bnki,bnkj->bij", weights, J, J, optimize=True)
        right = np.einsum("bn,bnki,bnk->bi", weights, J, r, optimize=True)
        step = solve(N, right[..., None])[..., 0]
        lost = ~np.isfinite(step).all(axis=-1)
        step = np.where(lost[:, None], 0.0, step)
        length = np.linalg.norm(step, axis=-1) / unit[:, 3]
        small, stalled = length <= TOLERANCE, (length >= state.length) & (length <= STALLED)
        settled = np.abs(weights - before).max(axis=-1) <= SETTLED
        step /= unit[:, :t]
        turn = Rotation.from_rotvec(step[:, 3:6]).as_matrix()
        mu = state.mu + step[:, 6] if free_scale else state.mu
        R, T = turn @ state.R, state.T + step[:, :3]
        return _State(mu, R, T, weights, state.age + 1, length), {
            Ending.SINGULAR: lost,
            Ending.PARAMETERS_AND_WEIGHTS if robust else Ending.PARAMETERS: small & settled,
            Ending.ROUNDING: stalled & settled,
        }

    start = _State(mu, R, T, weights, np.zeros(count, dtype=int), np.full(count, np.inf))
    end, convergence = iterate(pairs, start, advance, max_iterations)
    return {**_result(pairs, end, function, t), **vars(convergence)}


def _result(pairs: _Pairs, end: _State, function: IGG3 | None, t: int) -> dict[str, np.ndarray]:
    mu, R, T, weights = end.mu, end.R, end.T, end.weights
    r, J, unit = _whitened(pairs, mu, R, T, t)
    N = np.einsum("bn,bnki,bnkj->bij", weights, J, J, optimize=True)
    mean, slope, square = (1.0, 1.0, 1.0) if function is None else _normal_means(function)
    # As for any M-estimator: Σω JᵀJ estimates E[ω] times the normal matrix of the good pairs.
    cofactor = np.zeros((len(mu), 7, 7))
    cofactor[:, :t, :t] = mean * square / slope**2 * cofactor_from_normal(N)
    cofactor /= unit[:, :, None] * unit[:, None, :]
    total = 3.0 * np.sum(weights, axis=-1)
    redundancy = total / mean - t
    return {
        "scale": mu,
        "rotation": R,
        "image": T,
        "central_cofactor": cofactor,
        "sigma_0": np.sqrt(
            np.sum(weights * np.sum(r**2, axis=-1), axis=-1)
            / slope
            / np.where(redundancy > 0, redundancy, np.nan)
        ),
        "residuals": _misclosures(pairs, mu, R, T)[0],
        "weights": weights,
        "redundancy": 3 * np.count_nonzero(weights, axis=-1) - t,
    }


def _units(x: np.ndarray, mu: np.ndarray) -> np.ndarray:
    """What makes the parameters (T, ω, μ) shifts in m of a point at the mean distance from the
    centroid, (B, 7).
    """
    spread = _spread(x)
    ones = np.ones((len(x), 3))
    return np.concatenate([ones, ones * (mu * spread)[:, None], spread[:, None]], axis=-1)


def _misclosures(pairs: _Pairs, mu, R, T) -> tuple[np.ndarray, np.ndarray]:
    """``r = X − T − μ R x`` and ``μ R x``, each (B, n, 3)."""
    turned = pairs.x @ (mu[:, None, None] * R).swapaxes(-1, -2)
    return pairs.X - T[:, None, :] - turned, turned


def _whitened(pairs: _Pairs, mu, R, T, t: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Misclosures (B, n, 3) and design (B, n, 3, t) at the adjusted points, both times S^(−1/2) of
    their pair.

    The design is that of parameters times their :func:`_units` (B, 7), which come third.
    """
    r, turned = _misclosures(pairs, mu, R, T)
    from_source = mu[:, None, None, None] ** 2 * propagate(pairs.Q_x, R[:, None])
    S = from_source + pairs.Q_X
    # Where the source has errors, the design belongs at its adjusted points x − e_x, e_x = −μ Q_x
    # Rᵀ S⁻¹ r.
    turned = turned + (from_source @ np.linalg.solve(S, r[..., None]))[..., 0]
    unit = _units(pairs.x, mu)
    design = _design(turned, turned / mu[:, None, None]) / unit[:, None, None, :]
    both = np.linalg.solve(
        np.linalg.cholesky(S), np.concatenate([r[..., None], design[..., :t]], axis=-1)
    )
    return both[..., 0], both[..., 1:], unit


def _design(turned: np.ndarray, per_scale: np.ndarray) -> np.ndarray:
    """∂(T + exp([ω]×) μ R x)/∂(T, ω, μ) = [I, −[μRx]×, Rx], (…, n, 3, 7)."""
    J = np.zeros(turned.shape + (7,))
    J[..., [0, 1, 2], [0, 1, 2]] = 1.0
    a, b, c = np.moveaxis(turned, -1, 0)
    J[..., 0, 4], J[..., 0, 5] = c, -b
    J[..., 1, 3], J[..., 1, 5] = -c, a
    J[..., 2, 3], J[..., 2, 4] = b, -a
    J[..., 6] = per_scale
    return J


# ------------------------------------------------------------------------------------- robust


def _robust_weights(
    function: IGG3, r, J, weights, inflation, pairs: _Pairs, absolute: bool
) -> np.ndarray:
    """IGG III weights (B, n) from the test of each pair against all others.

    With h_k and r_k the leverages (eigenvalues of J N⁻¹ Jᵀ) and misclosures of a pair along their
    three principal axes,

        T² = Σ r_k² / ((1 − ωh_k)(1 + (1 − ω)h_k)),   Ω' = Ω − Σ ω r_k² / (1 − ωh_k)

    are the square of its misclosure to the adjustment of all others, standardised, and the sum of
    squares that these have with f degrees of freedom: whatever its own weight ω, a pair is judged
    by the others alone. For a good pair T² f/(3Ω') is F(3, f), with known variances T² is χ²(3).
    Its probability, as that of a standard normal |u|, gives the weight, so few pairs are judged
    with the caution they need. Variances said to be known are not believed where the others
    contradict them (Ω' against χ²(f)): too small ones would reject pair after pair.
    """
    t = J.shape[-1]
    N = np.einsum("bn,bnki,bnkj->bij", weights, J, J, optimize=True)
    leverage = J @ solve(N[:, None], J.swapaxes(-1, -2))
    # singular equations end the iteration, not this test
    leverage = np.where(np.isfinite(leverage), leverage, 0.0)
    h, axes = np.linalg.eigh(0.5 * (leverage + leverage.swapaxes(-1, -2)))
    squares = np.einsum("bnki,bnk->bni", axes, r) ** 2
    w = weights[..., None]
    free = np.maximum(1.0 - w * h, SMALLEST_REDUNDANCY)
    T2 = np.sum(squares / (free * (1.0 + (1.0 - w) * h)), axis=-1)
    whole = inflation * np.sum(weights * np.sum(r**2, axis=-1), axis=-1)
    others = whole[:, None] - np.sum(w * squares / free, axis=-1)
    freedom = 3.0 * (np.sum(weights, axis=-1, keepdims=True) - weights) - t
    testable = freedom > 0.5  # the others determine more than a transformation
    freedom = np.where(testable, freedom, 1.0)
    others = np.maximum(others, freedom * pairs.rounding[:, None] ** 2 * pairs.w)
    probability = fisher.sf(T2 / 3.0 * freedom / others, 3, freedom)
    if absolute:
        believed = chi2.sf(others, freedom) > DOUBT
        probability = np.where(believed, chi2.sf(T2, 3), probability)
    return np.where(testable, function.weight(norm.isf(0.5 * probability)), weights)


@cache
def _normal_means(function: IGG3) -> tuple[float, float, float]:
    """E[ω], E[ωd²]/3 and E[ω²d²]/3 for good pairs, d² their χ² with three degrees of freedom."""

    def mean(power: int) -> float:
        def integrand(u):
            return (
                function.weight(u) ** power
                * chi2.isf(2.0 * norm.sf(u), 3)
                / 3.0
                * 2.0
                * norm.pdf(u)
            )

        return sum(
            quad(integrand, *edges)[0] for edges in [(0.0, function.k0), (function.k0, function.k1)]
        )

    return function.mean_weight, mean(1), mean(2)


def _half(n: int) -> int:
    """Pairs that a start must fit: more than half."""
    return n // 2 + 1


@cache
def _trimmed_variance(share: float) -> float:
    """Mean of d²/3 over the ``share`` of the smallest of χ² variables d² with three degrees of
    freedom.
    """
    return float(chi2.cdf(chi2.ppf(share, 3), 5) / share) if share < 1 else 1.0


def _trimmed_start(pairs: _Pairs, free_scale: bool, seed: int) -> np.ndarray:
    """Weights (B, n), 1 for the more than half of the pairs that agree best with three of them,
    else 0.
    """
    n = pairs.w.shape[1]
    subsets = _subsets(n, seed)
    w = np.empty_like(pairs.w)
    for part in pieces(len(w), max(1, 4 * BLOCK // (len(subsets) * n))):
        some = pairs[part]
        found = _umeyama(some.x[:, subsets], some.X[:, subsets], some.w[:, subsets], free_scale)
        squares = _weighted_squares(some, *found)
        best = np.argmin(
            np.sum(np.partition(squares, _half(n) - 1, axis=-1)[..., : _half(n)], axis=-1), axis=-1
        )
        w[part] = _smallest(np.take_along_axis(squares, best[:, None, None], axis=1)[:, 0])
    for _ in range(20):
        mu, R, T = _umeyama(pairs.x, pairs.X, w * pairs.w, free_scale)
        w, before = (
            _smallest(_weighted_squares(pairs, mu[:, None], R[:, None], T[:, None])[:, 0]),
            w,
        )
        if np.array_equal(w, before):
            break
    return w


def _subsets(n: int, seed: int) -> np.ndarray:
    """(K, 3) subsets of three of n pairs: all, or `SUBSETS` drawn ones where there are more."""
    if comb(n, 3) <= SUBSETS:
        return np.array(list(combinations(range(n), 3)))
    draws = np.random.default_rng(seed).uniform(size=(SUBSETS, n))
    return np.argpartition(draws, 3, axis=-1)[:, :3]


def _weighted_squares(pairs: _Pairs, mu, R, T) -> np.ndarray:
    """w|r|² (B, K, n) of all pairs under K transformations each."""
    turned = pairs.x[:, None] @ (mu[..., None, None] * R).swapaxes(-1, -2)
    return pairs.w[:, None] * np.sum((pairs.X[:, None] - T[:, :, None, :] - turned) ** 2, axis=-1)


def _smallest(squares: np.ndarray) -> np.ndarray:
    """1 for the more than half of the (B, n) squares that are smallest, else 0."""
    order = np.argsort(squares, axis=-1, kind="stable")[:, : _half(squares.shape[1])]
    chosen = np.zeros_like(squares)
    np.put_along_axis(chosen, order, 1.0, axis=-1)
    return chosen


# -------------------------------------------------------------------------------- in and out


def _points(points) -> np.ndarray:
    points = finite_array(points, "points")
    if points.ndim == 0 or points.shape[-1] != 3:
        raise ValueError(f"points: expected shape (…, 3), got {points.shape}")
    return points


def _paired(source, target, smallest: int = SMALLEST) -> tuple[np.ndarray, np.ndarray]:
    """Both sets as (…, n, 3), checked: as many here as there, enough, and not on a line."""
    x, X = finite_array(source, "source"), finite_array(target, "target")
    for points, name in [(x, "source"), (X, "target")]:
        if points.ndim < 2 or points.shape[-1] != 3:
            raise ValueError(f"{name}: expected shape (…, n, 3), got {points.shape}")
    if x.shape[-2] != X.shape[-2]:
        raise ValueError(
            f"source, target: expected pairs, as many points in both, got {x.shape[-2]} and {X.shape[-2]} (shapes {x.shape}, {X.shape})"
        )
    try:
        lead = np.broadcast_shapes(x.shape[:-2], X.shape[:-2])
    except ValueError:
        raise ValueError(
            f"source, target: expected stacks of the same shape, got {x.shape} and {X.shape}"
        ) from None
    n = x.shape[-2]
    if n < smallest:
        what = "a similarity" if smallest == SMALLEST else "a robust one"
        raise ValueError(f"source, target: expected at least {smallest} pairs for {what}, got {n}")
    if 0 in lead:
        raise ValueError(
            f"source, target: expected at least one set of pairs, got an empty stack of shape {lead + (n, 3)}"
        )
    for points, name in [(x, "source"), (X, "target")]:
        _require_an_area(points, name)
    return np.broadcast_to(x, lead + (n, 3)), np.broadcast_to(X, lead + (n, 3))


def _require_an_area(points: np.ndarray, name: str) -> None:
    singular = np.linalg.svd(points - points.mean(axis=-2, keepdims=True), compute_uv=False)
    line = singular[..., 1] <= LINE * singular[..., 0]
    if line.any():
        count = "" if line.ndim == 0 else f" in {np.count_nonzero(line)} of {line.size} sets"
        raise ValueError(
            f"{name}: expected points that span an area, got points on a line{count}: the rotation about it is not determined"
        )


def _cofactors(values, shape: tuple[int, ...], name: str) -> np.ndarray:
    """Cofactor matrices ``shape`` + (3, 3) from one variance, variances or matrices."""
    array = finite_array(values, name)
    if array.ndim >= 3 and array.shape[-3:] == (shape[-1], 3, 3):
        return covariance_array(array, shape + (3, 3), name)
    variances = (
        np.full(shape, check_positive(array, name))
        if array.ndim == 0
        else weight_array(array, shape, name)
    )
    return variances[..., None, None] * np.eye(3)


def _both_cofactors(
    weights, of_source, of_target, shape: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray]:
    if weights is not None and not (of_source is None and of_target is None):
        raise ValueError("weights: expected None beside cofactors, which say all, got both")
    none = np.zeros(shape + (3, 3))
    if of_source is None and of_target is None:
        variances = np.ones(shape) if weights is None else 1.0 / weight_array(weights, shape)
        return none, variances[..., None, None] * np.eye(3)
    Q_x = none if of_source is None else _cofactors(of_source, shape, "source_cofactors")
    Q_X = none if of_target is None else _cofactors(of_target, shape, "target_cofactors")
    return Q_x, Q_X


def _rotations(start, lead: tuple[int, ...]) -> np.ndarray:
    R = finite_array(start, "start")
    if R.shape not in ((3, 3), lead + (3, 3)):
        raise ValueError(f"start: expected shape (3, 3) or {lead + (3, 3)}, got {R.shape}")
    proper = (
        np.allclose(R @ R.swapaxes(-1, -2), np.eye(3), rtol=0, atol=1e-6)
        and (np.linalg.det(R) > 0).all()
    )
    if not proper:
        raise ValueError(
            "start: expected rotation matrices, orthogonal with determinant +1, got some that are not"
        )
    return R


def _mean(points: np.ndarray, w: np.ndarray) -> np.ndarray:
    """Weighted mean (…, 3)."""
    return np.einsum("...n,...ni->...i", w, points) / np.sum(w, axis=-1)[..., None]


def _squares(points: np.ndarray) -> np.ndarray:
    """``Σ|x − x̄|²``, (…)."""
    return np.sum((points - points.mean(axis=-2, keepdims=True)) ** 2, axis=(-1, -2))


def _spread(points: np.ndarray) -> np.ndarray:
    """Root mean square distance from the mean, (…)."""
    return np.sqrt(_squares(points) / points.shape[-2])
