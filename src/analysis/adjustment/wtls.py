"""Linear adjustment when the design matrix has errors too: LS, TLS, mixed LS-TLS, WTLS.

No geometry in here. All take ``A (…, n, m)`` and ``y (…, n)`` and leave them as they are.
The closed forms reduce the rows to one triangular factor, block by block, and go on from
its m + 1 rows: memory stays at a block and no moment matrix squares the condition.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..blocks import pieces
from ..checks import check_one_of, check_positive, check_whole_number, finite_array, weight_array
from .algorithms import ALGORITHMS
from .cofactors import CONVENTIONS
from .linalg import cofactor_from_factor, cofactor_from_normal, propagate, solve, unit_weight_sd
from .problem import CommonCofactors, DenseCofactors, EIVProblem, RowCofactors
from .steps import misclosures, objective, only_minima

Structure = CommonCofactors | RowCofactors | DenseCofactors


@dataclass(frozen=True, eq=False)
class History:
    """Course of an iteration, with its start as number 0.

    x : (k+1, m) parameters; objective : (k+1,) Φ there
    trials : (k+1,) steps tried along the direction of search; 1 for an algorithm that does not
        search
    """

    x: np.ndarray
    objective: np.ndarray
    trials: np.ndarray


@dataclass(frozen=True)
class Estimate:
    """Estimated parameters of ``y − e_y = (A − E_A) x`` with their accuracy.

    x : (…, m)
    cofactor : (…, m, m), unscaled; ``covariance = sigma_0² · cofactor``
    objective : (…) weighted sum of squared errors Φ at x
    sigma_0 : (…) ``√(Φ / (n − m))``; exact columns count as parameters
    iterations, converged, stop_reason : how the solution was reached
    history : every iteration, where it was asked for
    """

    x: np.ndarray
    cofactor: np.ndarray
    objective: np.ndarray
    sigma_0: np.ndarray
    iterations: int | np.ndarray = 0
    converged: bool | np.ndarray = True
    stop_reason: str | np.ndarray = "solved in closed form"
    history: History | None = None

    @property
    def covariance(self) -> np.ndarray:
        return np.asarray(self.sigma_0)[..., None, None] ** 2 * self.cofactor


# ------------------------------------------------------------------------------ closed forms


def triangular_factor(blocks: Iterable[np.ndarray]) -> np.ndarray:
    """Upper triangular R with ``RᵀR = Σ (block)ᵀ(block)`` over blocks of rows ``(…, k, m)``.

    QR of each block, then of the stacked factors: the condition is that of the rows, not its
    square, and no more than one block is in memory.

    >>> A = np.array([[3.0, 1.0], [4.0, 2.0], [0.0, 5.0]])
    >>> R = triangular_factor([A[:2], A[2:]])
    >>> bool(np.allclose(R.T @ R, A.T @ A))
    True
    """
    factors = [_triangle(block) for block in blocks]
    if len(factors) == 1 and factors[0].shape[-2] >= factors[0].shape[-1]:
        return factors[0]
    stacked = np.concatenate(factors, axis=-2)
    missing = stacked.shape[-1] - stacked.shape[-2]
    if missing > 0:  # fewer rows than columns: rows of zeros change no product
        zeros = np.zeros(stacked.shape[:-2] + (missing, stacked.shape[-1]))
        stacked = np.concatenate([stacked, zeros], axis=-2)
    return _triangle(stacked)


def _triangle(rows: np.ndarray) -> np.ndarray:
    return np.asarray(np.linalg.qr(rows, mode="r"))


def ls(A, y, weights=None) -> Estimate:
    """Least squares, ``min Σ P r²`` with ``r = y − A x``: all errors are in y.

    Parameters
    ----------
    A : (…, n, m), n ≥ m, of full column rank.
    y : (…, n)
    weights : (n,) or (…, n) positive P, or None for ones.

    Raises
    ------
    ValueError : wrong shapes, NaN or infinity, weights that are not positive, columns that depend
        on one another.

    Example
    -------
    >>> estimate = ls([[1.0, 0.0], [1.0, 1.0], [1.0, 2.0]], [1.0, 3.0, 5.0])
    >>> estimate.x.round(12)
    array([1., 2.])
    """
    rows = _rows(A, y)
    R = triangular_factor(_weighted_blocks(rows, weights))
    m = R.shape[-1] - 1
    _require_full_rank(R[..., :m, :m])
    x = solve(R[..., :m, :m], R[..., :m, m:])[..., 0]
    objective = R[..., m, m] ** 2
    return Estimate(
        x,
        cofactor_from_factor(R[..., :m, :m]),
        objective,
        unit_weight_sd(objective, rows.shape[-1] - m),
    )


def tls(A, y) -> Estimate:
    """Total least squares by SVD, ``min Σ r² / (1 + |x|²)``: equal independent errors in A and y.

    ``[A | y] = U Σ Vᵀ``, ``x = −V[:m, m] / V[m, m]``. σ0 = σ_min/√(n − m) is the standard
    deviation of one element of ``[A | y]``.

    Parameters and errors as of :func:`ls`, without weights.

    Source: Golub & Van Loan 1980; Van Huffel & Vandewalle 1991, algorithm 3.1.

    Example
    -------
    >>> A = [[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]
    >>> tls(A, [1.0, 2.0, 3.0]).x.round(12)
    array([1., 2.])
    """
    return mixed_ls_tls(A, y, exact_columns=())


def mixed_ls_tls(A, y, exact_columns=()) -> Estimate:
    """Mixed LS-TLS, ``min Σ r² / (1 + |x₂|²)``: some columns of A are exact, the others are not.

    QR with the exact columns first, TLS on what is left of the others and y, back substitution.

    Parameters
    ----------
    A : (…, n, m); y : (…, n)
    exact_columns : indices of the columns without errors (a column of ones, say).

    Raises
    ------
    ValueError : as :func:`ls`, and an index that is no column or occurs twice.

    Source: Van Huffel & Vandewalle 1991, algorithm 3.2.

    Example
    -------
    >>> x, y = np.array([0.0, 1.0, 2.0]), np.array([1.0, 3.0, 5.0])
    >>> mixed_ls_tls(np.column_stack([np.ones(3), x]), y, exact_columns=[0]).x.round(12)
    array([1., 2.])
    """
    rows = _rows(A, y)
    m = rows.shape[-2] - 1
    exact = [check_one_of(column, range(-m, m), "exact_columns") % m for column in exact_columns]
    if len(set(exact)) != len(exact):
        raise ValueError(f"exact_columns: expected distinct columns, got {list(exact_columns)}")
    noisy = [column for column in range(m) if column not in exact]
    order = exact + noisy
    R = triangular_factor(_weighted_blocks(rows[..., order + [m], :], None))
    _require_full_rank(R[..., :m, :m])
    e = len(exact)
    x2, objective = smallest_singular_solution(R[..., e:, e:])
    x1 = solve(R[..., :e, :e], R[..., :e, m:] - R[..., :e, e:m] @ x2[..., None])[..., 0]
    x = np.empty(R.shape[:-2] + (m,))
    x[..., order] = np.concatenate([x1, x2], axis=-1)
    # Adjusted rows Ã = A + t xᵀ with t = r/(1+|x₂|²); with Aᵀr = −Φ x₂ this is
    # ÃᵀÃ = AᵀA − Φ x₂x₂ᵀ/(1+|x₂|²).
    scale = 1.0 + np.sum(x2**2, axis=-1)
    N = np.empty(R.shape[:-2] + (m, m))
    N[..., np.array(order)[:, None], order] = R[..., :m, :m].swapaxes(-1, -2) @ R[..., :m, :m]
    masked = np.zeros_like(x)
    masked[..., noisy] = x2
    N -= (objective / scale)[..., None, None] * masked[..., :, None] * masked[..., None, :]
    cofactor = scale[..., None, None] * cofactor_from_normal(N)
    return Estimate(x, cofactor, objective, unit_weight_sd(objective, rows.shape[-1] - m))


def smallest_singular_solution(R: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """``x = −v[:m]/v[m]`` and ``σ²`` for the smallest singular value of ``[A | y]`` (…, k, m+1)."""
    _, singular, Vt = np.linalg.svd(R)
    v = Vt[..., -1, :]
    # v[m] = 0: the nongeneric case, x is not finite
    with np.errstate(divide="ignore", invalid="ignore"):
        x = -v[..., :-1] / v[..., -1:]
    return x, singular[..., -1] ** 2


# ---------------------------------------------------------------------------------- iterated


def wtls(
    A,
    y,
    *,
    Q_y=None,
    Q_A=None,
    Q_Ay=None,
    Q_0=None,
    Q_X=None,
    row_cofactors=None,
    algorithm: str = "newton",
    H_0: str = "gauss_newton",
    accuracy: str = "gauss_newton",
    history: bool = False,
    tolerance: float = 1e-14,
    max_iterations: int = 500,
) -> Estimate:
    """Weighted total least squares, ``min e_yᵀQ_y⁻¹e_y + vec(E_A)ᵀQ_A⁻¹vec(E_A)``.

    The cofactors may be singular (a zero variance makes an element exact). They are given in
    one of three ways; the first two are O(n):

    * ``row_cofactors`` (…, n, m+1, m+1) of the rows ``(a_i, y_i)``;
    * ``Q_0`` (m, m) with ``Q_X`` (n,): ``Q_A = Q_0 ⊗ Q_X``, and ``Q_y`` (n,) or None for ones;
    * in full: ``Q_y`` (n,) or (n, n), ``Q_A`` (nm, nm) for vec(A) column by column (or ``Q_0`` with
      a full ``Q_X`` (n, n)), ``Q_Ay`` (nm, n) or None for zero. O(n³): for small problems.

    With none of Q_A, Q_0, row_cofactors the design matrix is exact.

    Parameters
    ----------
    A : (…, n, m); y : (…, n)
    Q_y, Q_A, Q_Ay, Q_0, Q_X, row_cofactors : cofactors, as above.
    algorithm : one of :data:`~analysis.adjustment.algorithms.ALGORITHMS`, all with the same
        solution. ``newton`` is the quickest and the one to be trusted with errors as large as the
        columns.
    H_0 : inverse Hessian that ``bfgs`` and ``dfp`` begin with: ``gauss_newton``, the inverse of
        Gauss-Newton's at the start, or ``identity``, in the units of A and y, as Wu, Chen & Wang
        have it.
    accuracy : convention of the cofactor, one of
        :data:`~analysis.adjustment.cofactors.CONVENTIONS`: ``gauss_newton``, ``(ÃᵀS⁻¹Ã)⁻¹``;
        ``inverse_hessian``, ``2(∇²Φ)⁻¹``; ``propagated`` from the data through ``∇Φ = 0``.
    history : whether to keep every iteration; of one problem, not of a stack.
    tolerance : relative step at which to stop, in parameters scaled to orthonormal columns of A.
    max_iterations : steps after which it stops without convergence.

    Returns
    -------
    Estimate. Not converged: ``converged`` is False and ``stop_reason`` says why.

    Raises
    ------
    ValueError : wrong shapes, NaN or infinity, columns that depend on one another, rows without
        errors, an unknown algorithm or convention, cofactors given twice.

    Source: Schaffrin & Wieser 2008; Fang 2013 (exact Hessian); Wu, Chen & Wang (quasi-Newton); Ou &
    Liu 2017, eqs. (1)-(5).

    Example
    -------
    >>> x = np.array([0.0, 1.0, 2.0, 3.0])
    >>> A = np.column_stack([np.ones(4), x])
    >>> line = wtls(A, 1 + 2 * x, Q_0=np.diag([0.0, 1.0]), Q_X=np.ones(4))
    >>> line.x.round(12), bool(line.converged)
    (array([1., 2.]), True)
    """
    chosen = ALGORITHMS[check_one_of(algorithm, ALGORITHMS, "algorithm")]
    check_one_of(H_0, ("gauss_newton", "identity"), "H_0")
    if H_0 == "identity" and not chosen.takes_H_0:
        raise ValueError(
            f"H_0: expected 'identity' with bfgs or dfp only, got it with {algorithm!r}"
        )
    cofactor_of = CONVENTIONS[check_one_of(accuracy, CONVENTIONS, "accuracy")]
    tolerance = check_positive(tolerance, "tolerance")
    check_whole_number(max_iterations, "max_iterations")
    rows = _rows(A, y)
    lead = rows.shape[:-2]
    if history and lead:
        raise ValueError(
            f"history: expected one problem (n, m), got a stack of shape {np.shape(A)}"
        )
    cofactors = _cofactors(rows.shape, Q_y, Q_A, Q_Ay, Q_0, Q_X, row_cofactors)
    n, m = rows.shape[-1], rows.shape[-2] - 1
    rows, cofactors, root, start = _orthonormal(rows, cofactors)
    problem = EIVProblem(rows, cofactors)
    _require_errors(problem, start)

    trace = _Trace(start) if history else None
    options: dict[str, Any] = {"tolerance": tolerance, "max_iterations": max_iterations}
    if trace:
        options["watch"] = trace
    if H_0 == "identity":  # of Φ and x, hence 2 R Rᵀ of Φ/2 and R x
        options["H_0"] = 2.0 * cofactor_from_factor(root).reshape(-1, m, m)
    stack = EIVProblem(rows.reshape(-1, m + 1, n), cofactors.flattened(lead))
    scaled, convergence = chosen.function(stack, start.reshape(-1, m), **options)
    scaled = scaled.reshape(lead + (m,))
    convergence = only_minima(problem, scaled, convergence.reshape(lead))
    # a lost problem is reported by its ending
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        phi = objective(problem, scaled)
        return Estimate(
            x=(root @ scaled[..., None])[..., 0],
            cofactor=propagate(cofactor_of(problem, scaled), root),
            objective=phi,
            sigma_0=unit_weight_sd(phi, n - m),
            history=trace.history(problem, root) if trace else None,
            **{name: values[()] for name, values in vars(convergence).items()},
        )


def _orthonormal(
    rows: np.ndarray, cofactors: Structure
) -> tuple[np.ndarray, Structure, np.ndarray, np.ndarray]:
    """Rows and cofactors with orthonormal columns of A, ``A x = (A R⁻¹)(R x)``.

    They make every later system well conditioned. Also ``R⁻¹``, which leads back to x, and the
    least-squares solution R x to start from.
    """
    m = rows.shape[-2] - 1
    R = triangular_factor(_weighted_blocks(rows, None))
    _require_full_rank(R[..., :m, :m])
    root = solve(R[..., :m, :m], np.broadcast_to(np.eye(m), R.shape[:-2] + (m, m)))
    L = np.zeros(R.shape[:-2] + (m + 1, m + 1))
    L[..., :m, :m] = root.swapaxes(-1, -2)
    L[..., m, m] = 1.0
    return L @ rows, cofactors.transformed(L), root, R[..., :m, m]


class _Trace:
    """Keeps the states of one problem that a minimisation passes through."""

    def __init__(self, start: np.ndarray):
        self.x, self.trials = [start], [0]

    def __call__(self, x: np.ndarray, trials=(1,)) -> None:
        self.x.append(x[0])
        self.trials.append(int(trials[0]))

    def history(self, problem: EIVProblem, root: np.ndarray) -> History:
        """As it was, in the parameters that ``root`` leads back to."""
        x = np.array(self.x)
        return History(
            x @ root.T, np.array([objective(problem, one) for one in x]), np.array(self.trials)
        )


# ---------------------------------------------------------------------------------- in and out


def _rows(A, y) -> np.ndarray:
    """``[A | y]`` as ``(…, m+1, n)``, checked; a copy, one array per column."""
    A, y = finite_array(A, "A"), finite_array(y, "y")
    if A.ndim < 2 or A.shape[-2] < A.shape[-1] or 0 in A.shape:
        raise ValueError(f"A: expected shape (…, n, m) with n ≥ m ≥ 1, got {A.shape}")
    if y.shape != A.shape[:-1]:
        raise ValueError(f"y: expected shape {A.shape[:-1]} to go with A {A.shape}, got {y.shape}")
    rows = np.empty(A.shape[:-2] + (A.shape[-1] + 1, A.shape[-2]))
    rows[..., :-1, :] = A.swapaxes(-1, -2)
    rows[..., -1, :] = y
    return rows


def _weighted_blocks(rows: np.ndarray, weights) -> Iterable[np.ndarray]:
    """Blocks ``(…, k, m+1)`` of rows times ``√P``."""
    roots = (
        None
        if weights is None
        else np.sqrt(weight_array(weights, rows.shape[:-2] + rows.shape[-1:]))
    )
    for piece in pieces(rows.shape[-1]):
        block = rows[..., piece] if roots is None else rows[..., piece] * roots[..., None, piece]
        yield block.swapaxes(-1, -2)


def _require_full_rank(R: np.ndarray) -> None:
    """Refuse columns that depend on one another to the last bits, whatever their units."""
    scaled = R / np.maximum(np.linalg.norm(R, axis=-2, keepdims=True), np.finfo(float).tiny)
    smallest = np.linalg.svd(scaled, compute_uv=False)[..., -1]
    if np.any(smallest < 16 * np.finfo(float).eps):
        raise ValueError(
            "A: expected independent columns, "
            f"got a smallest singular value of {smallest.min():.1g} for unit columns"
        )


def _require_errors(problem: EIVProblem, x: np.ndarray) -> None:
    """Refuse misclosures without a variance of their own: they cannot all be zero."""
    s = problem.cofactors.misclosure(misclosures(problem, x)[0])
    dense = isinstance(problem.cofactors, DenseCofactors)
    variances = np.diagonal(s, axis1=-2, axis2=-1) if dense else s
    if not (variances > 0).all():
        raise ValueError(
            "cofactors: expected an error in every row, "
            f"got rows whose misclosure has a variance of {variances.min():.3g}"
        )
    if dense:
        roots = np.sqrt(variances)
        smallest = np.linalg.eigvalsh(s / (roots[..., :, None] * roots[..., None, :]))[..., 0].min()
        if smallest < 16 * np.finfo(float).eps:
            raise ValueError(
                "cofactors: expected misclosures with a positive definite correlation matrix, "
                f"got a smallest eigenvalue of {smallest:.3g}"
            )


def _cofactors(shape, Q_y, Q_A, Q_Ay, Q_0, Q_X, row_cofactors) -> Structure:
    """The structure that the given cofactors have, for rows of ``shape`` (…, m+1, n)."""
    *lead, columns, n = shape
    m = columns - 1
    # 1. one matrix per row, and nothing else
    if row_cofactors is not None:
        if any(other is not None for other in (Q_y, Q_A, Q_Ay, Q_0, Q_X)):
            raise ValueError(
                "row_cofactors: expected alone, got it together with Q_y, Q_A, Q_Ay, Q_0 or Q_X"
            )
        allowed = [(n, m + 1, m + 1), (*lead, n, m + 1, m + 1)]
        Q = _symmetric(row_cofactors, allowed, "row_cofactors")
        return RowCofactors(np.broadcast_to(Q, (*lead, n, m + 1, m + 1)))
    if (Q_0 is None) != (Q_X is None):
        raise ValueError("Q_0 and Q_X: expected both or none, got one of them")
    if Q_A is not None and Q_0 is not None:
        raise ValueError("Q_A: expected either Q_A or Q_0 with Q_X, got both")
    # 2. Q_0 ⊗ Q_X with diagonal Q_X and Q_y; without Q_0 the design matrix is exact
    Q_0 = np.zeros((m, m)) if Q_0 is None else _symmetric(Q_0, [(m, m)], "Q_0")
    Q_X = np.zeros(n) if Q_X is None else _variances(Q_X, n, "Q_X")
    Q_y = np.ones(n) if Q_y is None else _variances(Q_y, n, "Q_y")
    if Q_A is None and Q_Ay is None and Q_X.ndim == 1 and Q_y.ndim == 1:
        C = np.zeros((*lead, m + 1, m + 1))
        C[..., :m, :m] = Q_0
        g, h = (np.broadcast_to(Q, (*lead, n)) for Q in (Q_X, Q_y))
        return CommonCofactors(C, g, h)
    # 3. in full: Q_A given or Q_0 ⊗ Q_X, with Q_Ay or without
    full = [np.diag(Q) if Q.ndim == 1 else Q for Q in (Q_X, Q_y)]
    Q_A = np.kron(Q_0, full[0]) if Q_A is None else _symmetric(Q_A, [(n * m, n * m)], "Q_A")
    Q_Ay = np.zeros((n * m, n)) if Q_Ay is None else finite_array(Q_Ay, "Q_Ay")
    if Q_Ay.shape != (n * m, n):
        raise ValueError(f"Q_Ay: expected shape {(n * m, n)}, got {Q_Ay.shape}")
    return DenseCofactors.from_blocks(full[1], Q_A, Q_Ay)


def _variances(values, n: int, name: str) -> np.ndarray:
    """Non-negative variances (n,) or a symmetric matrix (n, n)."""
    array = finite_array(values, name)
    if array.ndim == 2:
        return _symmetric(array, [(n, n)], name)
    if array.shape != (n,):
        raise ValueError(f"{name}: expected shape ({n},) or ({n}, {n}), got {array.shape}")
    if (array < 0).any():
        raise ValueError(f"{name}: expected variances of at least 0, got {array.min():g}")
    return array


def _symmetric(values, shapes: list[tuple[int, ...]], name: str) -> np.ndarray:
    array = finite_array(values, name)
    if array.shape not in shapes:
        raise ValueError(
            f"{name}: expected shape {' or '.join(map(str, shapes))}, got {array.shape}"
        )
    transposed = array.swapaxes(-1, -2)
    if not np.allclose(array, transposed, rtol=1e-9, atol=1e-12 * np.abs(array).max()):
        difference = np.abs(array - transposed).max()
        raise ValueError(
            f"{name}: expected symmetric matrices, "
            f"got a difference of {difference:.3g} to the transpose"
        )
    smallest = np.diagonal(array, axis1=-2, axis2=-1).min()
    if smallest < 0:
        raise ValueError(
            f"{name}: expected variances of at least 0 on the diagonal, got {smallest:g}"
        )
    return array
