"""Linear adjustment when the design matrix has errors too: LS, TLS, mixed LS-TLS, WTLS.

All take ``A (…, n, m)`` and ``y (…, n)`` and leave them as they are. The rows are reduced to one
triangular factor, block by block: the closed forms go on from its m + 1 rows.
"""

from __future__ import annotations

import math
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


@dataclass(frozen=True, eq=False)
class History:
    """Course of an iteration, the start as number 0: x (k+1, m) and the objective Φ (k+1,).

    trials : (k+1,) steps tried along the direction of search; 1 where there is no search
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


def triangular_factor(blocks: Iterable[np.ndarray]) -> np.ndarray:
    """Upper triangular R with ``RᵀR = Σ (block)ᵀ(block)`` over blocks of rows ``(…, k, m)``.

    QR of each block, then of the stacked factors, so that no moment matrix squares the condition.

    >>> A = np.array([[3.0, 1.0], [4.0, 2.0], [0.0, 5.0]])
    >>> R = triangular_factor([A[:2], A[2:]])
    >>> bool(np.allclose(R.T @ R, A.T @ A))
    True
    """
    factors = [np.linalg.qr(block, mode="r") for block in blocks]
    stacked = np.concatenate(factors, axis=-2)
    rows, columns = stacked.shape[-2:]
    if rows < columns:  # rows of zeros change no product
        zeros = np.zeros(stacked.shape[:-2] + (columns - rows, columns))
        stacked = np.concatenate([stacked, zeros], axis=-2)
    elif len(factors) == 1:
        return stacked
    return np.asarray(np.linalg.qr(stacked, mode="r"))


def ls(A, y, weights=None) -> Estimate:
    """Least squares, ``min Σ P r²`` with ``r = y − A x``: all errors are in y.

    Parameters
    ----------
    A : (…, n, m), n ≥ m, of full column rank; y : (…, n)
    weights : (n,) or (…, n) positive P, or None for ones.

    Raises
    ------
    ValueError : wrong shapes, NaN or infinity, weights that are not positive, dependent columns.

    Example
    -------
    >>> estimate = ls([[1.0, 0.0], [1.0, 1.0], [1.0, 2.0]], [1.0, 3.0, 5.0])
    >>> estimate.x.round(12)
    array([1., 2.])
    """
    rows = _rows(A, y)
    if weights is not None:
        rows *= np.sqrt(weight_array(weights, np.shape(y)))[..., None, :]
    whole = _factor(rows)
    R, right, objective = whole[..., :-1, :-1], whole[..., :-1, -1:], whole[..., -1, -1] ** 2
    sigma_0 = unit_weight_sd(objective, rows.shape[-1] - R.shape[-1])
    return Estimate(solve(R, right)[..., 0], cofactor_from_factor(R), objective, sigma_0)


def tls(A, y) -> Estimate:
    """Total least squares by SVD, ``min Σ r² / (1 + |x|²)``: equal independent errors in A and y.

    ``[A | y] = U Σ Vᵀ``, ``x = −V[:m, m] / V[m, m]``. σ0 = σ_min/√(n − m) is the standard
    deviation of one element of ``[A | y]``. Parameters, errors: as of :func:`ls`, without weights.

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

    Errors as of :func:`ls`; ValueError for an index that is no column or occurs twice.

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
    R = _factor(rows[..., order + [m], :])
    e = len(exact)
    x2, objective = smallest_singular_solution(R[..., e:, e:])
    x1 = solve(R[..., :e, :e], R[..., :e, m:] - R[..., :e, e:m] @ x2[..., None])[..., 0]
    x = np.empty(R.shape[:-2] + (m,))
    x[..., order] = np.concatenate([x1, x2], axis=-1)
    # Adjusted rows Ã = A + t xᵀ with t = r/(1+|x₂|²); with Aᵀr = −Φ x₂ this is
    # ÃᵀÃ = AᵀA − Φ x₂x₂ᵀ/(1+|x₂|²).
    scale = 1.0 + np.sum(x2**2, axis=-1)
    N = np.empty(R.shape[:-2] + (m, m))
    N[..., np.array(order)[:, None], order] = R[..., :m, :m].mT @ R[..., :m, :m]
    masked = np.where(np.isin(range(m), noisy), x, 0.0)
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
        solution; ``newton`` is the quickest, and to be trusted with errors as large as the columns.
    H_0 : inverse Hessian that ``bfgs`` and ``dfp`` begin with: ``gauss_newton``, that of
        Gauss-Newton at the start, or ``identity``, in the units of A and y, as Wu, Chen & Wang.
    accuracy : convention of the cofactor: ``gauss_newton``, ``(ÃᵀS⁻¹Ã)⁻¹``; ``inverse_hessian``,
        ``2(∇²Φ)⁻¹``; ``propagated`` from the data through ``∇Φ = 0``.
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
    structure = _cofactors(rows.shape, Q_y, Q_A, Q_Ay, Q_0, Q_X, row_cofactors)
    n, m = rows.shape[-1], rows.shape[-2] - 1
    rows = rows.reshape(-1, m + 1, n)
    # Orthonormal columns of A, A x = (A R⁻¹)(R x), make every later system well conditioned.
    factor = _factor(rows)
    R, start = factor[:, :m, :m], factor[:, :m, m]
    root = solve(R, np.broadcast_to(np.eye(m), R.shape))
    L = np.zeros(factor.shape)
    L[:, :m, :m], L[:, m, m] = root.mT, 1.0
    problem = EIVProblem(L @ rows, structure.transformed(L))
    _require_errors(problem, start)

    states = [(start[0], 0)]

    def watch(x: np.ndarray, trials=(1,)) -> None:
        states.append((x[0], int(trials[0])))

    options: dict[str, Any] = {"tolerance": tolerance, "max_iterations": max_iterations}
    if history:
        options["watch"] = watch
    if H_0 == "identity":  # of Φ and x, hence 2 R Rᵀ of Φ/2 and R x
        options["H_0"] = 2.0 * cofactor_from_factor(root)
    x, convergence = chosen.function(problem, start, **options)
    # a lost problem is reported by its ending
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        phi = objective(problem, x)
        solution = {
            "x": (root @ x[..., None])[..., 0],
            "cofactor": propagate(cofactor_of(problem, x), root),
            "objective": phi,
            "sigma_0": unit_weight_sd(phi, n - m),
            **vars(only_minima(problem, x, convergence)),
        }
    course = None
    if history:
        passed, trials = (np.array(values) for values in zip(*states, strict=True))
        values = np.concatenate([objective(problem, x[None]) for x in passed])
        course = History(passed @ root[0].T, values, trials)
    shaped = {
        name: values.reshape(lead + values.shape[1:])[()] for name, values in solution.items()
    }
    return Estimate(**shaped, history=course)


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


def _factor(rows: np.ndarray) -> np.ndarray:
    """Triangular factor (…, m+1, m+1) of the rows.

    Refuses columns of A that depend on one another to the last bits, whatever their units.
    """
    factor = triangular_factor(rows[..., piece].mT for piece in pieces(rows.shape[-1]))
    R = factor[..., :-1, :-1]
    scaled = R / np.maximum(np.linalg.norm(R, axis=-2, keepdims=True), np.finfo(float).tiny)
    smallest = np.linalg.svd(scaled, compute_uv=False)[..., -1]
    if np.any(smallest < 16 * np.finfo(float).eps):
        raise ValueError(
            "A: expected independent columns, "
            f"got a smallest singular value of {smallest.min():.1g} for unit columns"
        )
    return factor


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
        smallest = np.linalg.eigvalsh(s / (roots[..., :, None] * roots[..., None, :])).min()
        if smallest < 16 * np.finfo(float).eps:
            raise ValueError(
                "cofactors: expected misclosures with a positive definite correlation matrix, "
                f"got a smallest eigenvalue of {smallest:.3g}"
            )


def _cofactors(
    shape, Q_y, Q_A, Q_Ay, Q_0, Q_X, row_cofactors
) -> CommonCofactors | RowCofactors | DenseCofactors:
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
        return RowCofactors(np.broadcast_to(Q, allowed[1]).reshape(-1, n, m + 1, m + 1))
    if (Q_0 is None) != (Q_X is None):
        raise ValueError("Q_0 and Q_X: expected both or none, got one of them")
    if Q_A is not None and Q_0 is not None:
        raise ValueError("Q_A: expected either Q_A or Q_0 with Q_X, got both")
    # 2. Q_0 ⊗ Q_X with diagonal Q_X and Q_y; without Q_0 the design matrix is exact
    Q_0 = np.zeros((m, m)) if Q_0 is None else _symmetric(Q_0, [(m, m)], "Q_0")
    Q_X = np.zeros(n) if Q_X is None else _variances(Q_X, n, "Q_X")
    Q_y = np.ones(n) if Q_y is None else _variances(Q_y, n, "Q_y")
    if Q_A is None and Q_Ay is None and Q_X.ndim == 1 and Q_y.ndim == 1:
        C = np.zeros((math.prod(lead), m + 1, m + 1))
        C[:, :m, :m] = Q_0
        return CommonCofactors(C, *(np.broadcast_to(Q, (len(C), n)) for Q in (Q_X, Q_y)))
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
    if not np.allclose(array, array.mT, rtol=1e-9, atol=1e-12 * np.abs(array).max()):
        raise ValueError(
            f"{name}: expected symmetric matrices, "
            f"got a difference of {np.abs(array - array.mT).max():.3g} to the transpose"
        )
    smallest = np.diagonal(array, axis1=-2, axis2=-1).min()
    if smallest < 0:
        raise ValueError(
            f"{name}: expected variances of at least 0 on the diagonal, got {smallest:g}"
        )
    return array
