"""Adjustment of a similarity with errors in both frames, robust where asked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ..adjustment.iteration import Convergence, Ending, Stack, iterate
from ..adjustment.linalg import cofactor_from_normal, propagate, solve
from ..adjustment.weights import EFFICIENT_THRESHOLDS, IGG3
from ..checks import check_whole_number
from ..result import warn_if_not_converged
from .closed_form import umeyama_centred
from .pairs import SMALLEST, Pairs, cofactors_of_pairs, mean, paired, spread, sum_of_squares
from .robust import normal_matrix, normal_means, robust_weights, trimmed_start
from .transformation import Similarity, design, frozen

TOLERANCE = 1e-13  # of a step, relative to the spread of the points
STALLED = 1e-9  # a step below this that no longer shrinks is rounding
SETTLED = 1e-9  # change of the robust weights
PATIENCE = 20  # iterations before weights that swing are damped


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
    """Similarity ``X = t + μ R x`` from pairs of points in two frames, with any rotation.

    ``min Σ rᵀ S⁻¹ r`` of the misclosures ``r = X − t − μ R x`` with their cofactors
    ``S = Q_X + μ² R Q_x Rᵀ``, by Gauss-Helmert iterations from the solution by SVD. For isotropic
    cofactors in a constant proportion R does not depend on how the errors are shared between the
    frames, and μ solves ``C σ_x² μ² + (D σ_X² − E σ_x²) μ − C σ_X² = 0`` with C = ΣΔXᵀRΔx,
    D = Σ|Δx|², E = Σ|ΔX|²; the weights of the pairs matter for all parameters.

    Parameters
    ----------
    source, target : (n, 3) or (…, n, 3) coordinates of the same n ≥ 3 points in both frames, m. Not
        changed.
    scale : False fixes μ at 1, as is right for two instruments that measure in metres unless
        ``scale_test`` rejects it.
    weights : (n,) or (…, n) positive weights of the pairs, inverse variances in the target; or
    source_cofactors, target_cofactors : of the points in each frame: one variance, (n,) or (…, n)
        variances, (n, 3, 3) or (…, n, 3, 3) covariances; None for points without errors. Neither:
        unit variances in the target.
    absolute : the cofactors are variances in m² and not only in proportion; the covariance is then
        not scaled by σ0, and a robust adjustment judges misclosures by them. With few pairs this is
        worth much.
    robust : find wrong pairs and leave them out (at least four pairs): a start from the three pairs
        that agree with more than half of all, then IGG III weights on the test of each pair against
        the others.
    seed : of the subsets of three pairs, where there are too many to try all (more than 15 pairs).

    Returns
    -------
    Similarity, its fields with the leading axes of ``source``. Not converged: ``converged`` is
    False, ``stop_reason`` says why, and a ``ConvergenceWarning`` is given.

    Raises
    ------
    ValueError : unequal numbers of points, fewer than three pairs (robust: four), points on a line,
        NaN or infinity, weights that are not positive, weights beside cofactors.

    Source: Umeyama 1991 (start); Neitzel 2010, Journal of Geodesy 84, 751-762 (errors in both
    frames); Yang, Song & Xu 2002 (IGG III).

    Example
    -------
    >>> x = np.array([[0.0, 0, 0], [4, 0, 0], [0, 3, 0], [0, 0, 2], [3, 2, 1]])
    >>> X = [1, 2, 3] + x[:, [1, 2, 0]]
    >>> X[4] += 1.0
    >>> similarity = fit_similarity(x, X, scale=False, robust=True)
    >>> similarity.translation.round(9), similarity.inliers
    (array([1., 2., 3.]), array([ True,  True,  True,  True, False]))
    """
    check_whole_number(max_iterations, "max_iterations")
    x, X = paired(source, target, SMALLEST + 1 if robust else SMALLEST)
    if absolute and source_cofactors is None and target_cofactors is None:
        raise ValueError("absolute: expected cofactors, which are to be absolute, got none")
    Q_x, Q_X = cofactors_of_pairs(weights, source_cofactors, target_cofactors, x.shape[:-1])
    function = IGG3(*EFFICIENT_THRESHOLDS) if robust else None
    # 1. a stack of problems, each about its centroids
    lead = x.shape[:-2]
    x, X, Q_x, Q_X = (given.reshape((-1, *given.shape[len(lead) :])) for given in (x, X, Q_x, Q_X))
    # For the start each pair has the mean variance of its misclosure.
    mu = np.sqrt(sum_of_squares(X) / sum_of_squares(x)) if scale else np.ones(len(x))
    w = 3.0 / np.trace(Q_X + mu[:, None, None, None] ** 2 * Q_x, axis1=-2, axis2=-1)
    centre, image = mean(x, w), mean(X, w)
    rounding = 4 * np.finfo(float).eps * np.abs(X).max(axis=(-1, -2))
    pairs = Pairs(x - centre[:, None, :], X - image[:, None, :], Q_x, Q_X, w, rounding)
    # 2. the adjustment
    estimator = _Estimator(scale, function, absolute)
    state, convergence = estimator.iterate(pairs, seed, max_iterations)
    # 3. the result in the given frames
    fields = {
        "scale": state.mu,
        "rotation": state.R,
        "centre": centre,
        "image": image + state.T,
        **estimator.accuracy(pairs, state),
        "weights": state.weights,
        **vars(convergence),
    }
    similarity = frozen(
        method="robust" if robust else "least squares",
        absolute=absolute,
        **{name: values.reshape(lead + values.shape[1:])[()] for name, values in fields.items()},
    )
    warn_if_not_converged(similarity)
    return similarity


@dataclass(frozen=True)
class _State(Stack):
    """μ, R, T about the centroids, weights (B, n), iterations so far, length of the last step."""

    mu: np.ndarray
    R: np.ndarray
    T: np.ndarray
    weights: np.ndarray
    age: np.ndarray
    length: np.ndarray


@dataclass(frozen=True)
class _Estimator:
    """The adjustment of (T, ω) and, unless it is fixed, μ; robust with a weight function.

    absolute : whether the cofactors are variances
    """

    free_scale: bool
    function: IGG3 | None
    absolute: bool

    @property
    def parameters(self) -> int:
        return 7 if self.free_scale else 6

    def iterate(self, pairs: Pairs, seed: int, max_iterations: int) -> tuple[_State, Convergence]:
        """Gauss-Helmert iterations from the closed form, with new weights in each where robust."""
        function, t = self.function, self.parameters
        weights, inflation = np.ones(pairs.w.shape), 1.0
        if function is not None:
            weights, inflation = trimmed_start(pairs, self.free_scale, seed)

        def advance(pairs: Pairs, state: _State):
            # 1. misclosures and design at the adjusted points
            r, J, unit = _whitened(pairs, state, t)
            # 2. weights
            weights = before = state.weights
            if function is not None:
                factor = np.where(state.age, 1.0, inflation)
                weights = robust_weights(function, r, J, weights, factor, pairs, self.absolute)
                # Two pairs may throw each other out alternately: they go half of the way then.
                alternates = (state.age[:, None] >= PATIENCE) & (np.abs(weights - before) > SETTLED)
                weights = np.where(alternates, 0.5 * (before + weights), weights)
            # 3. step
            right = np.einsum("bn,bnki,bnk->bi", weights, J, r, optimize=True)
            step = solve(normal_matrix(weights, J), right[..., None])[..., 0]
            lost = ~np.isfinite(step).all(axis=-1)
            step = np.where(lost[:, None], 0.0, step)
            length = np.linalg.norm(step, axis=-1) / unit[:, 3]
            step /= unit[:, :t]
            R = Rotation.from_rotvec(step[:, 3:6]).as_matrix() @ state.R
            mu = state.mu + step[:, 6] if self.free_scale else state.mu
            # 4. endings
            settled = np.abs(weights - before).max(axis=-1) <= SETTLED
            stalled = (length >= state.length) & (length <= STALLED)
            return _State(mu, R, state.T + step[:, :3], weights, state.age + 1, length), {
                Ending.SINGULAR: lost,
                still: settled & (length <= TOLERANCE),
                Ending.ROUNDING: settled & stalled,
            }

        still = Ending.PARAMETERS if function is None else Ending.PARAMETERS_AND_WEIGHTS
        count = len(pairs)
        found = umeyama_centred(pairs.x, pairs.X, weights * pairs.w, self.free_scale)
        start = _State(*found, weights, np.zeros(count, dtype=int), np.full(count, np.inf))
        return iterate(pairs, start, advance, max_iterations)

    def accuracy(self, pairs: Pairs, state: _State) -> dict[str, np.ndarray]:
        """Cofactor of (image, ω, μ), σ0, residuals and redundancy at the solution."""
        weights, t = state.weights, self.parameters
        r, J, unit = _whitened(pairs, state, t)
        function = self.function
        mean_weight, slope, square = (1.0, 1.0, 1.0) if function is None else normal_means(function)
        # As for any M-estimator: Σω JᵀJ estimates E[ω] times the normal matrix of the good pairs.
        cofactor = np.zeros((len(pairs), 7, 7))
        factor = mean_weight * square / slope**2
        cofactor[:, :t, :t] = factor * cofactor_from_normal(normal_matrix(weights, J))
        cofactor /= unit[:, :, None] * unit[:, None, :]
        redundancy = 3.0 * np.sum(weights, axis=-1) / mean_weight - t
        squares = np.sum(weights * np.sum(r**2, axis=-1), axis=-1)
        return {
            "central_cofactor": cofactor,
            "sigma_0": np.sqrt(squares / slope / np.where(redundancy > 0, redundancy, np.nan)),
            "residuals": _misclosures(pairs, state)[0],
            "redundancy": 3 * np.count_nonzero(weights, axis=-1) - t,
        }


def _misclosures(pairs: Pairs, state: _State) -> tuple[np.ndarray, np.ndarray]:
    """``r = X − T − μ R x`` and ``μ R x``, each (B, n, 3)."""
    turned = pairs.x @ (state.mu[:, None, None] * state.R).mT
    return pairs.X - state.T[:, None, :] - turned, turned


def _whitened(pairs: Pairs, state: _State, t: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Misclosures (B, n, 3) and design (B, n, 3, t) at the adjusted points, times S^(−1/2) each.

    The design is that of parameters times units (B, 7), third, which make (T, ω, μ) shifts in m at
    the mean distance from the centroid.
    """
    mu = state.mu
    r, turned = _misclosures(pairs, state)
    from_source = mu[:, None, None, None] ** 2 * propagate(pairs.Q_x, state.R[:, None])
    S = from_source + pairs.Q_X
    # Where the source has errors, the design belongs at its adjusted points x − e_x,
    # e_x = −μ Q_x Rᵀ S⁻¹ r.
    turned = turned + (from_source @ np.linalg.solve(S, r[..., None]))[..., 0]
    distance, ones = spread(pairs.x)[:, None], np.ones((len(mu), 3))
    unit = np.concatenate([ones, ones * (mu[:, None] * distance), distance], axis=-1)
    J = design(turned, turned / mu[:, None, None]) / unit[:, None, None, :]
    both = np.concatenate([r[..., None], J[..., :t]], axis=-1)
    both = np.linalg.solve(np.linalg.cholesky(S), both)
    return both[..., 0], both[..., 1:], unit
