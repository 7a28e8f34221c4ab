"""The printed registration: a similarity with nine direction cosines and six constraints.

References
----------
Chen, Shen & Liu (2004), Geomatics and Information Science of Wuhan University 29, 1101-1105.
Li, Lu, Zhu, Lu, Wu & Li (2015), tunnel sections from laser scans, eqs. (7)-(8).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from analysis.adjustment.iteration import Ending, Stack, iterate
from analysis.adjustment.linalg import solve, unit_weight_sd
from analysis.checks import check_whole_number, finite_array, weight_array
from analysis.similarity import umeyama
from analysis.similarity.closed_form import umeyama_centred
from analysis.similarity.pairs import mean, paired, spread

TOLERANCE = 1e-13  # of a step, relative to the spread of the points
STALLED = 1e-9  # a step below this that no longer shrinks is rounding


@dataclass(frozen=True, eq=False)
class ThirteenParameters:
    """(T, μ, a, b, c) with a, b, c the rows of R, from :func:`thirteen_parameters`.

    The fields are those of :class:`~analysis.Similarity`, but
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
    """Similarity by T, μ and nine direction cosines with six constraints, as printed.

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
    ``ValueError`` as :func:`~analysis.fit_similarity`. Not converged: ``converged`` is False, and
    ``stop_reason`` says why.

    Source: Chen, Shen & Liu 2004; Li et al. 2015, eqs. (7)-(8).

    >>> x = np.array([[0.0, 0, 0], [4, 0, 0], [0, 3, 0], [0, 0, 2]])
    >>> solution = thirteen_parameters(x, [1, 2, 3] + 2 * x[:, [1, 2, 0]])
    >>> round(float(solution.scale), 12), solution.translation.round(12)
    (2.0, array([1., 2., 3.]))
    """
    check_whole_number(max_iterations, "max_iterations")
    x, X = paired(source, target)
    lead, n = x.shape[:-2], x.shape[-2]
    w = np.ones(lead + (n,)) if weights is None else weight_array(weights, lead + (n,))
    x, X, w = x.reshape(-1, n, 3), X.reshape(-1, n, 3), w.reshape(-1, n)
    count = len(x)
    centre, image = mean(x, w), mean(X, w)
    x, X = x - centre[:, None, :], X - image[:, None, :]
    length = spread(x)
    reduced = np.stack([x, X], axis=1) / length[:, None, None, None]
    if start is None:
        mu, R, _ = umeyama_centred(x, X, w, True)
    else:
        mu = np.ones(count)
        R = np.broadcast_to(_rotations(start, lead), lead + (3, 3)).reshape(-1, 3, 3)
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
    units = np.ones((count, 13))
    units[:, 3:] /= length[:, None]
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
    """Matrix (B, 19, 19), right side (B, 19) of the normal equations with six constraints."""
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
            "start: expected rotation matrices, orthogonal with determinant +1, "
            "got some that are not"
        )
    return R


def start_study(
    trials: int, seed: int, *, step: float = 30.0, targets: int = 5, sd: float = 0.002
) -> pd.DataFrame:
    """Share of rotations that the model finds from R = I, and from the solution by SVD.

    In each class of rotation angles, ``step`` degrees wide, random axes and angles turn ``targets``
    places in a box of 6 × 20 × 4 m; their errors have the standard deviation ``sd`` m. "Found" is a
    rotation within 1e-9 of that by SVD.

    Columns: ``from_deg``, ``to_deg``; ``found_from_identity_percent``;
    ``wrong_but_converged_percent``, ended at another place with every sign of success; of these
    ``wrong_but_proper_percent``, with a determinant of +1, and
    ``wrong_with_negative_scale_percent``, where μ < 0 gives it away; ``not_converged_percent``;
    ``found_from_svd_percent``.
    """
    generator = np.random.default_rng(seed)
    rows = []
    for low in np.arange(0.0, 180.0, step):
        axes = generator.standard_normal((trials, 3))
        angles = np.radians(low + step * generator.uniform(size=(trials, 1)))
        R = Rotation.from_rotvec(
            angles * axes / np.linalg.norm(axes, axis=-1, keepdims=True)
        ).as_matrix()
        x = (6.0, 20.0, 4.0) * generator.uniform(-0.5, 0.5, size=(trials, targets, 3))
        X = x @ R.swapaxes(-1, -2) + sd * generator.standard_normal(x.shape)
        right = umeyama(x, X)[1]
        from_identity = thirteen_parameters(x, X, start=np.eye(3))
        from_svd = thirteen_parameters(x, X)
        found, also = (
            np.abs(one.rotation - right).max(axis=(-1, -2)) < 1e-9
            for one in (from_identity, from_svd)
        )
        wrong = ~found & from_identity.converged
        shares = {
            "found_from_identity": found,
            "wrong_but_converged": wrong,
            "wrong_but_proper": wrong & (np.linalg.det(from_identity.rotation) > 0),
            "wrong_with_negative_scale": wrong & (from_identity.scale < 0),
            "not_converged": ~from_identity.converged & ~found,
            "found_from_svd": also,
        }
        rows.append(
            {
                "from_deg": low,
                "to_deg": low + step,
                **{f"{name}_percent": 100 * values.mean() for name, values in shares.items()},
            }
        )
    return pd.DataFrame(rows)
