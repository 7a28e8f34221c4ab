"""Linear adjustment when the design matrix has errors too: LS, TLS, mixed LS-TLS, WTLS.

No geometry in here. All take ``A (…, n, m)`` and ``y (…, n)`` and leave them as they are.
The closed forms reduce the rows to one triangular factor, block by block, and go on from
its m + 1 rows: memory stays at a block and no moment matrix squares the condition.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from .accuracy import cofactor_from_factor, cofactor_from_normal, solve, unit_weight_sd
from .eiv import CommonCofactors, DenseCofactors, EIVProblem, RowCofactors
from .validation import finite_array, one_of, pieces, positive, weight_array, whole_number

ROUNDING = 1e-11  # relative step below which a step that no longer shrinks is rounding and not divergence


@dataclass(frozen=True)
class Estimate:
    """Estimated parameters of ``y − e_y = (A − E_A) x`` with their accuracy.

    x : (…, m)
    cofactor : (…, m, m), unscaled; ``covariance = sigma_0² · cofactor``
    objective : (…) weighted sum of squared errors Φ at x
    sigma_0 : (…) ``√(Φ / (n − m))``; exact columns count as parameters
    iterations, converged, stop_reason : how the solution was reached
    """

    x: np.ndarray
    cofactor: np.ndarray
    objective: np.ndarray
    sigma_0: np.ndarray
    iterations: int | np.ndarray = 0
    converged: bool | np.ndarray = True
    stop_reason: str | np.ndarray = "solved in closed form"

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
    factors = [np.linalg.qr(block, mode="r") for block in blocks]
    if len(factors) == 1 and factors[0].shape[-2] >= factors[0].shape[-1]:
        return factors[0]
    stacked = np.concatenate(factors, axis=-2)
    missing = stacked.shape[-1] - stacked.shape[-2]
    if missing > 0:  # fewer rows than columns: rows of zeros change no product
        stacked = np.concatenate([stacked, np.zeros(stacked.shape[:-2] + (missing, stacked.shape[-1]))], axis=-2)
    return np.linalg.qr(stacked, mode="r")


def ls(A, y, weights=None) -> Estimate:
    """Least squares, ``min Σ P r²`` with ``r = y − A x``: all errors are in y.

    Parameters
    ----------
    A : (…, n, m), n ≥ m, of full column rank.
    y : (…, n)
    weights : (n,) or (…, n) positive P, or None for ones.

    Raises ``ValueError`` for wrong shapes, NaN or infinity, non-positive weights and columns
    that depend on one another.

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
    return Estimate(x, cofactor_from_factor(R[..., :m, :m]), objective, unit_weight_sd(objective, rows.shape[-1] - m))


def tls(A, y) -> Estimate:
    """Total least squares by SVD, ``min Σ r² / (1 + |x|²)``: equal independent errors in A and y.

    ``[A | y] = U Σ Vᵀ``, ``x = −V[:m, m] / V[m, m]``. σ0 = σ_min/√(n − m) is the standard
    deviation of one element of ``[A | y]``.

    Parameters, errors: as :func:`ls`, no weights. Source: Golub & Van Loan 1980; Van Huffel &
    Vandewalle 1991, algorithm 3.1.

    >>> A = [[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]
    >>> tls(A, [1.0, 2.0, 3.0]).x.round(12)
    array([1., 2.])
    """
    return mixed_ls_tls(A, y, exact_columns=())


def mixed_ls_tls(A, y, exact_columns=()) -> Estimate:
    """Mixed LS-TLS, ``min Σ r² / (1 + |x₂|²)``: some columns of A are exact, the others have errors.

    QR with the exact columns first, TLS on what is left of the others and y, back substitution.

    Parameters
    ----------
    A : (…, n, m); y : (…, n)
    exact_columns : indices of the columns without errors (a column of ones, say).

    Errors: as :func:`ls`, and for an index that is no column. Source: Van Huffel & Vandewalle
    1991, algorithm 3.2.

    >>> x, y = np.array([0.0, 1.0, 2.0]), np.array([1.0, 3.0, 5.0])
    >>> mixed_ls_tls(np.column_stack([np.ones(3), x]), y, exact_columns=[0]).x.round(12)
    array([1., 2.])
    """
    rows = _rows(A, y)
    m = rows.shape[-2] - 1
    exact = [one_of(column, range(-m, m), "exact_columns") % m for column in exact_columns]
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
    # Adjusted rows Ã = A + t xᵀ with t = r/(1+|x₂|²); with Aᵀr = −Φ x₂ this is ÃᵀÃ = AᵀA − Φ x₂x₂ᵀ/(1+|x₂|²).
    scale = 1.0 + np.sum(x2**2, axis=-1)
    N = np.empty(R.shape[:-2] + (m, m))
    N[..., np.ix_(order, order)[0], np.ix_(order, order)[1]] = R[..., :m, :m].swapaxes(-1, -2) @ R[..., :m, :m]
    masked = np.zeros_like(x)
    masked[..., noisy] = x2
    N -= (objective / scale)[..., None, None] * masked[..., :, None] * masked[..., None, :]
    cofactor = scale[..., None, None] * cofactor_from_normal(N)
    return Estimate(x, cofactor, objective, unit_weight_sd(objective, rows.shape[-1] - m))


def smallest_singular_solution(R: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """``x = −v[:m]/v[m]`` and ``σ²`` for the smallest singular value σ of ``[A | y]`` = (…, k, m+1)."""
    _, singular, Vt = np.linalg.svd(R)
    v = Vt[..., -1, :]
    with np.errstate(divide="ignore", invalid="ignore"):  # v[m] = 0: the nongeneric case, x is not finite
        x = -v[..., :-1] / v[..., -1:]
    return x, singular[..., -1] ** 2


# ---------------------------------------------------------------------------------- iterated


def misclosures(problem: EIVProblem, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """``z = (−x, 1)`` (…, m+1) and the misclosures ``r = y − A x`` (…, n)."""
    z = np.concatenate([-x, np.ones(x.shape[:-1] + (1,))], axis=-1)
    return z, (z[..., None, :] @ problem.rows)[..., 0, :]


def schaffrin_wieser_step(problem: EIVProblem, x: np.ndarray, weights: np.ndarray | float = 1.0, known=None) -> np.ndarray:
    """One step ``x⁺ = (AᵀWA − V)⁻¹ (AᵀWy − v)`` from x; robust ``weights`` ω ≥ 0 act on whole rows.

    ``W = ω/s``, ``t = r/s`` and ``[V v] = Σ ω t² Q_i`` (for the Kronecker form V = ν Q_0). Computed as the
    increment ``(AᵀWA − V)⁻¹ (AᵀWr + Vx − v)``, which is the same and loses less to rounding. Nothing is
    divided by ω, so a weight of zero takes its row out and leaves no NaN behind. ``known`` are the
    :func:`misclosures` at x where a caller has them already.

    Source: Schaffrin & Wieser 2008; Ou & Liu 2017, eqs. (16)-(17), with V and v extended to any
    cofactors of the rows.
    """
    m = problem.parameters
    cofactors = problem.cofactors
    z, r = known or misclosures(problem, x)
    s = cofactors.misclosure(z)
    t = cofactors.weigh(s, r[..., None, :])[..., 0, :]
    columns = problem.rows[..., :m, :]
    weighed = cofactors.weigh(s, columns, weights)
    V = cofactors.weighted_sum(weights * t, t)[..., :m, :]
    right = weighed @ r[..., None] - V @ z[..., None]
    return x + solve(weighed @ columns.swapaxes(-1, -2) - V[..., :m], right)[..., 0]


def derivatives(problem: EIVProblem, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """``Φ = rᵀS⁻¹r`` with half its gradient (…, m) and half its exact Hessian (…, m, m).

    ``½∇Φ = −(A − Ẽ)ᵀλ``, ``½∇²Φ = BᵀS⁻¹B − V`` with ``λ = S⁻¹r``, ``B = A − slope``, ``V = Σ λ² Q``.
    Source: Fang 2013, for independent rows; the slope is that of S in full.
    """
    m = problem.parameters
    cofactors = problem.cofactors
    z, r = misclosures(problem, x)
    s = cofactors.misclosure(z)
    multipliers = cofactors.weigh(s, r[..., None, :])[..., 0, :]
    columns = problem.rows[..., :m, :]
    errors = cofactors.errors(z, multipliers)
    gradient = -((columns - errors) @ multipliers[..., None])[..., 0]
    B = columns - cofactors.slope(z, multipliers, errors)
    hessian = cofactors.weigh(s, B) @ B.swapaxes(-1, -2)
    hessian -= cofactors.weighted_sum(multipliers, multipliers)[..., :m, :m]
    return np.sum(multipliers * r, axis=-1), gradient, hessian


def newton_step(problem: EIVProblem, x: np.ndarray) -> np.ndarray:
    """One Newton step with the exact Hessian; a Schaffrin-Wieser step where Φ would not fall.

    Far from the solution the Hessian need not be positive definite.
    """
    value, gradient, hessian = derivatives(problem, x)
    new = x - solve(hessian, gradient[..., None])[..., 0]
    worse = ~(objective(problem, new) <= value * (1 + 1e-12))
    if np.any(worse):
        new = np.where(worse[..., None], schaffrin_wieser_step(problem, x), new)
    return new


STEPS: dict[str, Callable] = {"newton": newton_step, "schaffrin_wieser": schaffrin_wieser_step}


def objective(problem: EIVProblem, x: np.ndarray, weights: np.ndarray | float = 1.0) -> np.ndarray:
    """``Φ(x) = Σ ω r²/s`` (in dense form ``rᵀS⁻¹r``), the least weighted sum of squared errors that x allows."""
    z, r = misclosures(problem, x)
    multipliers = problem.cofactors.weigh(problem.cofactors.misclosure(z), r[..., None, :], weights)[..., 0, :]
    return np.sum(multipliers * r, axis=-1)


def gauss_newton_cofactor(problem: EIVProblem, x: np.ndarray, weights: np.ndarray | float = 1.0) -> np.ndarray:
    """Cofactor ``(ÃᵀWÃ)⁻¹`` of x with the adjusted rows ``Ã = A − Ẽ``, (…, m, m)."""
    cofactors = problem.cofactors
    z, r = misclosures(problem, x)
    s = cofactors.misclosure(z)
    t = cofactors.weigh(s, r[..., None, :])[..., 0, :]
    adjusted = problem.rows[..., : problem.parameters, :] - cofactors.errors(z, t)
    return cofactor_from_normal(cofactors.weigh(s, adjusted, weights) @ adjusted.swapaxes(-1, -2))


ENDED = ("iterations", "converged", "stop_reason")


@dataclass(frozen=True)
class Ended:
    """How the iterations over a stack of B problems ended: the last state, and (B,) iterations, converged, stop_reason."""

    state: tuple[np.ndarray, ...]
    iterations: np.ndarray
    converged: np.ndarray
    stop_reason: np.ndarray


def iterate(problem, state: tuple[np.ndarray, ...], advance: Callable, endings: list[tuple[bool, str]], max_iterations: int) -> Ended:
    """Repeat ``state, ending = advance(problem, state)`` for every problem of a stack until it has ended.

    problem : anything that a mask over the leading axis selects from
    state : arrays with that leading axis (B, …)
    advance : gives the next state and, for each problem, 0 to go on or the 1-based number of an ending
    endings : (converged, sentence) of each ending

    A problem that has ended is left as it is and costs nothing more, so that it comes out the same in
    a stack of any size.
    """
    count = len(state[0])
    final = tuple(array.copy() for array in state)
    active = np.arange(count)
    iterations = np.full(count, max_iterations)
    ending = np.zeros(count, dtype=int)
    for iteration in range(1, max_iterations + 1):
        state, now = advance(problem, state)
        stopped = (now > 0) | (iteration == max_iterations)
        if stopped.any():
            ended = active[stopped]
            iterations[ended] = iteration
            ending[ended] = now[stopped]
            for whole, part in zip(final, state, strict=True):
                whole[ended] = part[stopped]
            keep = ~stopped
            active = active[keep]
            if not len(active):
                break
            problem, state = problem[keep], tuple(part[keep] for part in state)
    known = [(False, f"not converged: still moving after {max_iterations} iterations"), *endings]
    converged = np.array([one[0] for one in known])[ending]
    return Ended(final, iterations, converged, np.array([one[1] for one in known], dtype=object)[ending])


def solved(problem: EIVProblem, x: np.ndarray, step: Callable, tolerance: float, max_iterations: int) -> tuple[np.ndarray, Ended]:
    """Repeat ``x ← step(problem, x)`` for a stack x (B, m) until ``|Δx| ≤ tolerance·|x|``.

    A step that is down at rounding level and does not shrink any more ends it as converged, too.
    """

    def advance(problem, state):
        x, last = state
        new = step(problem, x)
        length, size = np.linalg.norm(new - x, axis=-1), np.linalg.norm(new, axis=-1)
        lost = ~np.isfinite(length)
        stalled = (length >= last) & (length <= ROUNDING * size)
        ending = np.select([lost, length <= tolerance * size, stalled], [1, 2, 3], 0)
        return (np.where(lost[:, None], x, new), length), ending

    endings = [
        (False, "not converged: the normal equations became singular"),
        (True, f"the relative step fell below {tolerance:g}"),
        (True, "the step reached rounding level"),
    ]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):  # a lost problem is reported by its ending
        ended = iterate(problem, (x, np.full(len(x), np.inf)), advance, endings, max_iterations)
    return ended.state[0], ended


def only_minima(problem: EIVProblem, x: np.ndarray, ended: Ended) -> Ended:
    """Take back the convergence of what is stationary but no minimum of Φ: its Hessian has a negative eigenvalue.

    With errors as large as the columns an iteration can end at a saddle of Φ.
    """
    hessian = derivatives(problem, x)[2]
    fine = np.isfinite(hessian).all(axis=(-1, -2))
    eigenvalues = np.linalg.eigvalsh(np.where(fine[..., None, None], hessian, 0.0))
    saddle = ended.converged & (eigenvalues[..., 0] < -1e-10 * eigenvalues[..., -1])
    reason = np.where(saddle, "not converged: ended where Φ is stationary, but at no minimum", ended.stop_reason)
    return replace(ended, converged=ended.converged & ~saddle, stop_reason=reason)


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
    tolerance: float = 1e-14,
    max_iterations: int = 500,
) -> Estimate:
    """Weighted total least squares, ``min e_yᵀQ_y⁻¹e_y + vec(E_A)ᵀQ_A⁻¹vec(E_A)`` with any cofactors.

    The cofactors may be singular (a zero variance makes an element exact). They are given in
    one of three ways; the first two are O(n) and take stacks:

    * ``row_cofactors`` (…, n, m+1, m+1) of the rows ``(a_i, y_i)``;
    * ``Q_0`` (m, m) with ``Q_X`` (n,): ``Q_A = Q_0 ⊗ Q_X``, and ``Q_y`` (n,) or None for ones;
    * in full: ``Q_y`` (n,) or (n, n), ``Q_A`` (nm, nm) for vec(A) column by column (or ``Q_0`` with
      a full ``Q_X`` (n, n)), ``Q_Ay`` (nm, n) or None for zero. One problem, O(n³): for small ones.

    With none of Q_A, Q_0, row_cofactors the design matrix is exact.

    Parameters
    ----------
    A : (…, n, m); y : (…, n)
    algorithm : ``newton`` (exact Hessian) or ``schaffrin_wieser``; same solution.
    tolerance : relative step at which to stop, in parameters scaled to orthonormal columns of A.

    Returns an :class:`Estimate`; ``cofactor`` is ``(ÃᵀS⁻¹Ã)⁻¹``, the Gauss-Newton convention. Not
    converged: ``converged`` is False and ``stop_reason`` says why. ``ValueError`` for wrong shapes, NaN
    or infinity, dependent columns, an unknown algorithm or cofactors given twice.

    Source: Schaffrin & Wieser 2008; Fang 2013 (exact Hessian); Ou & Liu 2017, eqs. (1)-(5).

    >>> x = np.array([0.0, 1.0, 2.0, 3.0])
    >>> line = wtls(np.column_stack([np.ones(4), x]), 1 + 2 * x, Q_0=np.diag([0.0, 1.0]), Q_X=np.ones(4))
    >>> line.x.round(12), bool(line.converged)
    (array([1., 2.]), True)
    """
    step = STEPS[one_of(algorithm, STEPS, "algorithm")]
    tolerance = positive(tolerance, "tolerance")
    whole_number(max_iterations, "max_iterations")
    rows = _rows(A, y)
    cofactors = _cofactors(rows.shape, Q_y, Q_A, Q_Ay, Q_0, Q_X, row_cofactors)
    if isinstance(cofactors, DenseCofactors) and rows.ndim > 2:
        raise ValueError(f"A: expected one problem (n, m) with full cofactor matrices, got a stack of shape {np.shape(A)}")
    n, m = rows.shape[-1], rows.shape[-2] - 1
    # Orthonormal columns make every later system well conditioned: A x = (A R⁻¹)(R x).
    R = triangular_factor(_weighted_blocks(rows, None))
    _require_full_rank(R[..., :m, :m])
    root = solve(R[..., :m, :m], np.broadcast_to(np.eye(m), R.shape[:-2] + (m, m)))
    L = np.zeros(R.shape[:-2] + (m + 1, m + 1))
    L[..., :m, :m] = root.swapaxes(-1, -2)
    L[..., m, m] = 1.0
    problem = EIVProblem(L @ rows, cofactors.transformed(L))
    start = R[..., :m, m]  # least squares
    _require_errors(problem, start)

    if isinstance(cofactors, DenseCofactors):
        lead = ()
        scaled, ended = solved(problem, start[None], lambda one, x: step(one, x[0])[None], tolerance, max_iterations)
    else:
        lead = rows.shape[:-2]
        scaled, ended = solved(problem.flattened(), start.reshape(-1, m), step, tolerance, max_iterations)
    scaled = scaled.reshape(lead + (m,))
    ended = only_minima(problem, scaled, replace(ended, **{name: getattr(ended, name).reshape(lead) for name in ENDED}))
    phi = objective(problem, scaled)
    return Estimate(
        x=(root @ scaled[..., None])[..., 0],
        cofactor=root @ gauss_newton_cofactor(problem, scaled) @ root.swapaxes(-1, -2),
        objective=phi,
        sigma_0=unit_weight_sd(phi, n - m),
        **{name: getattr(ended, name)[()] for name in ENDED},
    )


# ---------------------------------------------------------------------------------- in and out


def _rows(A, y) -> np.ndarray:
    """``[A | y]`` as ``(…, m+1, n)``, checked; a copy, one array a column."""
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
    roots = None if weights is None else np.sqrt(weight_array(weights, rows.shape[:-2] + rows.shape[-1:]))
    for piece in pieces(rows.shape[-1]):
        block = rows[..., piece] if roots is None else rows[..., piece] * roots[..., None, piece]
        yield block.swapaxes(-1, -2)


def _require_full_rank(R: np.ndarray) -> None:
    """Refuse columns that depend on one another to the last bits, whatever their units."""
    scaled = R / np.maximum(np.linalg.norm(R, axis=-2, keepdims=True), np.finfo(float).tiny)
    smallest = np.linalg.svd(scaled, compute_uv=False)[..., -1]
    if np.any(smallest < 16 * np.finfo(float).eps):
        raise ValueError(f"A: expected independent columns, got a smallest singular value of {smallest.min():.1g} for unit columns")


def _require_errors(problem: EIVProblem, x: np.ndarray) -> None:
    """Every misclosure must have a variance: rows without any error cannot all be met."""
    s = problem.cofactors.misclosure(misclosures(problem, x)[0])
    variances = np.diagonal(s) if isinstance(problem.cofactors, DenseCofactors) else s
    if not (variances > 0).all():
        raise ValueError(f"cofactors: expected an error in every row, got rows whose misclosure has a variance of {variances.min():.3g}")


def _cofactors(shape, Q_y, Q_A, Q_Ay, Q_0, Q_X, row_cofactors) -> CommonCofactors | RowCofactors | DenseCofactors:
    """The structure that the given cofactors have, for rows of ``shape`` (…, m+1, n)."""
    *lead, columns, n = shape
    m = columns - 1
    if row_cofactors is not None:
        if any(other is not None for other in (Q_y, Q_A, Q_Ay, Q_0, Q_X)):
            raise ValueError("row_cofactors: expected alone, got it together with Q_y, Q_A, Q_Ay, Q_0 or Q_X")
        Q = _symmetric(row_cofactors, [(n, m + 1, m + 1), (*lead, n, m + 1, m + 1)], "row_cofactors")
        return RowCofactors(np.broadcast_to(Q, (*lead, n, m + 1, m + 1)))
    if (Q_0 is None) != (Q_X is None):
        raise ValueError("Q_0 and Q_X: expected both or none, got one of them")
    if Q_A is not None and Q_0 is not None:
        raise ValueError("Q_A: expected either Q_A or Q_0 with Q_X, got both")
    Q_0 = np.zeros((m, m)) if Q_0 is None else _symmetric(Q_0, [(m, m)], "Q_0")
    Q_X = np.zeros(n) if Q_X is None else _variances(Q_X, n, "Q_X")
    Q_y = np.ones(n) if Q_y is None else _variances(Q_y, n, "Q_y")
    if Q_A is None and Q_Ay is None and Q_X.ndim == 1 and Q_y.ndim == 1:
        C = np.zeros((*lead, m + 1, m + 1))
        C[..., :m, :m] = Q_0
        return CommonCofactors(C, np.broadcast_to(Q_X, (*lead, n)), np.broadcast_to(Q_y, (*lead, n)))
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
        raise ValueError(f"{name}: expected shape {' or '.join(map(str, shapes))}, got {array.shape}")
    transposed = array.swapaxes(-1, -2)
    if not np.allclose(array, transposed, rtol=1e-9, atol=1e-12 * np.abs(array).max()):
        difference = np.abs(array - transposed).max()
        raise ValueError(f"{name}: expected symmetric matrices, got a difference of {difference:.3g} to the transpose")
    smallest = np.diagonal(array, axis1=-2, axis2=-1).min()
    if smallest < 0:
        raise ValueError(f"{name}: expected variances of at least 0 on the diagonal, got {smallest:g}")
    return array
