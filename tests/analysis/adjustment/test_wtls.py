"""The solvers on linear errors-in-variables problems: against each other and other libraries."""

import numpy as np
import pytest
from odrpack import odr_fit
from scipy.optimize import least_squares

import analysis
from analysis.adjustment.wtls import triangular_factor

from .linear_problems import (
    SPHERE_Q_0,
    covariances,
    dense_blocks,
    every_algorithm,
    minimum_by_newton,
    point_weights,
    profile_objective,
    some_problem,
    sphere_rows,
)

# ------------------------------------------------------------------------------ the forms agree


@every_algorithm
@pytest.mark.parametrize("kind", ["equal", "random"])
def test_row_form_equals_dense_kronecker_form(algorithm, kind):
    A, y = sphere_rows()
    P = point_weights(kind)
    rows = analysis.wtls(A, y, Q_0=SPHERE_Q_0, Q_X=1 / P, Q_y=y / P, algorithm=algorithm)
    dense = analysis.wtls(
        A, y, Q_A=np.kron(SPHERE_Q_0, np.diag(1 / P)), Q_y=np.diag(y / P), algorithm=algorithm
    )
    np.testing.assert_allclose(rows.x, dense.x, rtol=0, atol=1e-12)
    np.testing.assert_allclose(rows.cofactor, dense.cofactor, rtol=1e-12)
    np.testing.assert_allclose(rows.objective, dense.objective, rtol=1e-12)


@pytest.mark.parametrize("kind", ["equal", "random"])
def test_schaffrin_wieser_is_the_printed_iteration(kind):
    """Eqs. (16)-(17) of Ou & Liu with n×n matrices and the raw rows; there rounding ends it at
    1e-11.
    """
    A, y = sphere_rows()
    P = point_weights(kind)
    Q_X, Q_Y = np.diag(1 / P), np.diag(y / P)
    X = np.linalg.lstsq(A, y, rcond=None)[0]
    for _ in range(30):
        mu = np.linalg.inv(Q_Y + (X @ SPHERE_Q_0 @ X) * Q_X)
        multipliers = mu @ (y - A @ X)
        nu = multipliers @ Q_X @ multipliers
        X = np.linalg.solve(A.T @ mu @ A - nu * SPHERE_Q_0, A.T @ mu @ y)
    estimate = analysis.wtls(
        A, y, Q_0=SPHERE_Q_0, Q_X=1 / P, Q_y=y / P, algorithm="schaffrin_wieser"
    )
    np.testing.assert_allclose(estimate.x, X, rtol=0, atol=3e-11)
    np.testing.assert_allclose(estimate.objective, multipliers @ (y - A @ X), rtol=1e-9)


@every_algorithm
def test_row_cofactors_equal_their_dense_blocks(algorithm):
    A, y, generator = some_problem()
    Q = covariances(generator, 15, 4)
    Q_y, Q_A, Q_Ay = dense_blocks(Q)
    assert np.abs(Q_Ay).max() > 1e-3
    rows = analysis.wtls(A, y, row_cofactors=Q, algorithm=algorithm)
    dense = analysis.wtls(A, y, Q_y=Q_y, Q_A=Q_A, Q_Ay=Q_Ay, algorithm=algorithm)
    assert rows.converged and dense.converged
    np.testing.assert_allclose(rows.x, dense.x, rtol=0, atol=1e-12)
    np.testing.assert_allclose(rows.cofactor, dense.cofactor, rtol=1e-11)
    np.testing.assert_allclose(
        rows.x,
        minimum_by_newton(profile_objective(A, y, Q_y, Q_A, Q_Ay), rows.x + 1e-3),
        rtol=0,
        atol=1e-11,
    )


@every_algorithm
def test_correlated_rows(algorithm):
    """Everything correlated with everything: the minimum of the textbook's Φ, found with its values
    alone.
    """
    n, m = 12, 2
    A, y, generator = some_problem(n, m)
    Q = covariances(generator, 1, n * (m + 1))[0]
    Q_A, Q_Ay, Q_y = Q[: n * m, : n * m], Q[: n * m, n * m :], Q[n * m :, n * m :]
    phi = profile_objective(A, y, Q_y, Q_A, Q_Ay)
    estimate = analysis.wtls(A, y, Q_y=Q_y, Q_A=Q_A, Q_Ay=Q_Ay, algorithm=algorithm)
    assert estimate.converged
    np.testing.assert_allclose(
        estimate.x, minimum_by_newton(phi, estimate.x + 1e-3), rtol=0, atol=1e-11
    )
    np.testing.assert_allclose(estimate.objective, phi(estimate.x), rtol=1e-12)
    # The correlations matter: without them the solution is another.
    without = analysis.wtls(A, y, Q_y=np.diag(Q_y), Q_A=np.diag(np.diag(Q_A)))
    assert np.abs(estimate.x - without.x).max() > 1e-3


def test_full_row_matrix_with_common_columns():
    """``Q_A = Q_0 ⊗ Q_X`` with a full Q_X."""
    A, y, generator = some_problem()
    Q_0, Q_X = covariances(generator, 1, 3)[0], covariances(generator, 1, 15)[0]
    product = analysis.wtls(A, y, Q_0=Q_0, Q_X=Q_X)
    np.testing.assert_allclose(
        product.x, analysis.wtls(A, y, Q_A=np.kron(Q_0, Q_X)).x, rtol=0, atol=1e-13
    )
    assert np.abs(product.x - analysis.wtls(A, y, Q_0=Q_0, Q_X=np.diag(Q_X)).x).max() > 1e-6


# ------------------------------------------------------------------------------ another library


def odrpack_of(A, y, Q_X, Q_y):
    """``y = A x`` by ODRPACK, A with independent errors of variances ``Q_X`` (m, n)."""
    return odr_fit(
        lambda columns, x: x @ columns,
        A.T,
        y,
        np.linalg.lstsq(A, y, rcond=None)[0],
        weight_x=1 / Q_X,
        weight_y=1 / Q_y,
        jac_beta=lambda columns, x: columns[None],
        jac_x=lambda columns, x: np.repeat(x[None, :, None], len(y), axis=2),
        partol=1e-14,
        sstol=1e-14,
        maxit=500,
    )


def test_solution_and_cofactor_of_odrpack():
    """ODRPACK's ``cov_beta`` is the cofactor; times ``res_var`` it is the covariance (its
    ``sd_beta`` squared).
    """
    A, y, generator = some_problem(40, 3)
    Q_X, Q_y = generator.uniform(0.005, 0.02, (3, 40)), generator.uniform(0.005, 0.02, 40)
    rows = np.zeros((40, 4, 4))
    rows[:, range(3), range(3)] = Q_X.T
    rows[:, 3, 3] = Q_y
    estimate = analysis.wtls(A, y, row_cofactors=rows)
    theirs = odrpack_of(A, y, Q_X, Q_y)
    np.testing.assert_allclose(estimate.x, theirs.beta, rtol=1e-8)
    np.testing.assert_allclose(estimate.cofactor, theirs.cov_beta, rtol=1e-5)
    np.testing.assert_allclose(estimate.sigma_0**2, theirs.res_var, rtol=1e-10)
    np.testing.assert_allclose(np.sqrt(np.diag(estimate.covariance)), theirs.sd_beta, rtol=1e-5)
    assert abs(theirs.res_var - 1) > 0.05  # else the factor would not show


def lines(n=15):
    """Points of a line y = 1 − 2x, a covariance matrix (2n, 2n) of x and y, full, and its part
    within the points.
    """
    generator = np.random.default_rng(12)
    full = covariances(generator, 1, 2 * n)[0]
    x, y = generator.uniform(-1, 1, n), np.empty(n)
    y = 1 - 2 * x
    errors = np.linalg.cholesky(full) @ generator.standard_normal(2 * n)
    pairs = np.where(
        np.tile(np.eye(n, dtype=bool), (2, 2)), 3 * full + 0.02 * np.tile(np.eye(n), (2, 2)), 0.0
    )
    return x + errors[:n], y + errors[n:], full, pairs


def line_by_scipy(x, y, covariance):
    """All unknowns at once: the line's two and every true abscissa, from whitened observations."""
    root = np.linalg.cholesky(covariance)

    def whitened(unknowns):
        a, b, true = unknowns[0], unknowns[1], unknowns[2:]
        return np.linalg.solve(root, np.concatenate([x - true, y - a - b * true]))

    start = np.concatenate([[1.0, -2.0], x])
    solution = least_squares(whitened, start, jac="cs", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    return solution.x[:2], 2 * solution.cost, np.linalg.inv(solution.jac.T @ solution.jac)[:2, :2]


@every_algorithm
@pytest.mark.parametrize("kind", ["pairs", "full"])
def test_line_with_correlated_coordinates(algorithm, kind):
    """Correlated pairs (x_i, y_i) as cofactors of the rows, a full covariance matrix of x and y as
    blocks.
    """
    x, y, full, pairs = lines()
    n = len(x)
    covariance = {"pairs": pairs, "full": full}[kind]
    if kind == "pairs":
        rows = np.zeros((n, 3, 3))
        rows[:, 1:, 1:] = np.einsum("ikjk->kij", covariance.reshape(2, n, 2, n))
        assert np.abs(rows[:, 1, 2] / np.sqrt(rows[:, 1, 1] * rows[:, 2, 2])).max() > 0.3
        known = {"row_cofactors": rows}
    else:
        Q_A, Q_Ay = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, n))
        Q_A[n:, n:], Q_Ay[n:] = covariance[:n, :n], covariance[:n, n:]
        known = {"Q_A": Q_A, "Q_Ay": Q_Ay, "Q_y": covariance[n:, n:]}
    estimate = analysis.wtls(np.column_stack([np.ones(n), x]), y, **known, algorithm=algorithm)
    expected, objective, cofactor = line_by_scipy(x, y, covariance)
    assert estimate.converged
    np.testing.assert_allclose(estimate.x, expected, rtol=1e-8)
    np.testing.assert_allclose(estimate.objective, objective, rtol=1e-12)
    np.testing.assert_allclose(estimate.cofactor, cofactor, rtol=1e-6)
    # Correlations matter.
    without, *_ = line_by_scipy(x, y, np.diag(np.diag(covariance)))
    assert np.abs(without - expected).max() > 1e-3


# ------------------------------------------------------------------------------ special cases


def test_ls_is_numpy_s():
    A, y, _ = some_problem()
    estimate = analysis.ls(A, y)
    x, residual, _, _ = np.linalg.lstsq(A, y, rcond=None)
    np.testing.assert_allclose(estimate.x, x, rtol=1e-13)
    np.testing.assert_allclose(estimate.objective, residual[0], rtol=1e-13)
    np.testing.assert_allclose(estimate.cofactor, np.linalg.inv(A.T @ A), rtol=1e-12)
    np.testing.assert_allclose(
        estimate.covariance, residual[0] / 12 * np.linalg.inv(A.T @ A), rtol=1e-12
    )


def test_weights_of_ls_count_rows():
    """A weight of three is a row three times, and the rest of σ0 is redundancy."""
    A, y, generator = some_problem()
    counts = generator.integers(1, 4, 15)
    weighted = analysis.ls(A, y, weights=counts)
    repeated = analysis.ls(np.repeat(A, counts, axis=0), np.repeat(y, counts))
    np.testing.assert_allclose(weighted.x, repeated.x, rtol=1e-13)
    np.testing.assert_allclose(weighted.cofactor, repeated.cofactor, rtol=1e-12)
    np.testing.assert_allclose(weighted.objective, repeated.objective, rtol=1e-12)
    np.testing.assert_allclose(
        weighted.sigma_0**2 * 12, repeated.sigma_0**2 * (counts.sum() - 3), rtol=1e-12
    )


def assert_same(one, other, tolerance=1e-12):
    np.testing.assert_allclose(one.x, other.x, rtol=0, atol=tolerance)
    np.testing.assert_allclose(one.objective, other.objective, rtol=1e-10)
    np.testing.assert_allclose(one.sigma_0, other.sigma_0, rtol=1e-10)
    np.testing.assert_allclose(one.cofactor, other.cofactor, rtol=1e-10, atol=1e-13)


@every_algorithm
def test_exact_design_matrix_is_least_squares(algorithm):
    A, y, _ = some_problem()
    assert_same(analysis.wtls(A, y, algorithm=algorithm), analysis.ls(A, y))
    weights = np.arange(1.0, 16.0)
    assert_same(
        analysis.wtls(A, y, Q_y=1 / weights, algorithm=algorithm),
        analysis.ls(A, y, weights=weights),
    )


@every_algorithm
def test_equal_errors_are_total_least_squares(algorithm):
    A, y, _ = some_problem()
    estimate = analysis.tls(A, y)
    v = np.linalg.svd(np.column_stack([A, y]))[2][-1]
    np.testing.assert_allclose(estimate.x, -v[:3] / v[3], rtol=0, atol=1e-13)
    assert_same(analysis.wtls(A, y, Q_0=np.eye(3), Q_X=np.ones(15), algorithm=algorithm), estimate)


def noisier(seed, errors):
    A, y, generator = some_problem(seed=seed)
    return (
        A + errors * generator.standard_normal(A.shape),
        y + errors * generator.standard_normal(15),
        generator,
    )


def test_slow_convergence_goes_on_to_the_end():
    """With errors half as large as the columns a Schaffrin-Wieser step gains a third of a digit; a
    small one is not yet the last.
    """
    A, y, generator = noisier(3, 0.5)
    Q = covariances(generator, 15, 4)
    slow = analysis.wtls(A, y, row_cofactors=Q, algorithm="schaffrin_wieser")
    assert slow.converged and slow.iterations > 30
    np.testing.assert_allclose(slow.x, analysis.wtls(A, y, row_cofactors=Q).x, rtol=1e-12)


NOISY_A, NOISY_Y = (np.stack([noisier(seed, 1.0)[part] for seed in range(100)]) for part in (0, 1))


@every_algorithm
def test_only_minima_are_solutions(algorithm):
    """With errors as large as the columns an iteration can end at a saddle or run away; TLS has the
    minimum in closed form.
    """
    best = analysis.tls(NOISY_A, NOISY_Y)
    estimate = analysis.wtls(
        NOISY_A, NOISY_Y, Q_0=np.eye(3), Q_X=np.ones(15), algorithm=algorithm, max_iterations=200
    )
    done = estimate.converged
    np.testing.assert_allclose(estimate.objective[done], best.objective[done], rtol=1e-9)
    assert done.any() and all(
        reason.startswith("not converged: ") for reason in estimate.stop_reason[~done]
    )


def test_newton_finds_the_minimum_where_others_do_not():
    best = analysis.tls(NOISY_A, NOISY_Y)
    found = {}
    for algorithm in ("newton", "schaffrin_wieser"):
        estimate = analysis.wtls(
            NOISY_A, NOISY_Y, Q_0=np.eye(3), Q_X=np.ones(15), algorithm=algorithm
        )
        found[algorithm] = np.mean(
            np.abs(estimate.x - best.x).max(axis=-1) < 1e-8 * np.abs(best.x).max(axis=-1)
        )
    assert found["newton"] > 0.95 > 0.6 > found["schaffrin_wieser"]


@every_algorithm
@pytest.mark.parametrize("exact", [(0,), (2,), (0, 2), (1, 2), (0, 1, 2)])
def test_exact_columns_have_variance_zero(algorithm, exact):
    A, y, _ = some_problem()
    Q_0 = np.eye(3)
    Q_0[exact, exact] = 0.0
    mixed = analysis.mixed_ls_tls(A, y, exact_columns=exact)
    assert_same(analysis.wtls(A, y, Q_0=Q_0, Q_X=np.ones(15), algorithm=algorithm), mixed)
    assert np.abs(mixed.x - analysis.tls(A, y).x).max() > 1e-4


def test_mixed_ls_tls_by_centring():
    """With a column of ones exact, mixed LS-TLS is pure TLS of the centred columns."""
    A, y, _ = some_problem()
    centred = analysis.tls(A - A.mean(axis=0), y - y.mean())
    mixed = analysis.mixed_ls_tls(np.column_stack([A, np.ones(15)]), y, exact_columns=[-1])
    np.testing.assert_allclose(
        mixed.x, np.append(centred.x, y.mean() - A.mean(axis=0) @ centred.x), rtol=0, atol=1e-13
    )


def test_extremes_of_mixed_ls_tls():
    A, y, _ = some_problem()
    assert_same(analysis.mixed_ls_tls(A, y, exact_columns=[0, 1, 2]), analysis.ls(A, y))
    assert_same(analysis.mixed_ls_tls(A, y, exact_columns=[]), analysis.tls(A, y))


@every_algorithm
def test_an_exact_element_is_left_as_it_is(algorithm):
    """Singular cofactors: with every error but y's of row 0 exact there, the estimate is as if only
    y had that error.
    """
    A, y, generator = some_problem()
    Q = covariances(generator, 15, 4)
    Q[0] = 0.0
    Q[0, 3, 3] = 1e-7
    estimate = analysis.wtls(A, y, row_cofactors=Q, algorithm=algorithm)
    assert estimate.converged
    assert abs(y[0] - A[0] @ estimate.x) < 1e-4  # nothing else there can move
    Q_y, Q_A, Q_Ay = dense_blocks(Q)
    assert np.linalg.matrix_rank(Q_A) < 45
    np.testing.assert_allclose(
        estimate.x, analysis.wtls(A, y, Q_y=Q_y, Q_A=Q_A, Q_Ay=Q_Ay).x, rtol=0, atol=1e-8
    )


@every_algorithm
def test_cofactors_matter_up_to_a_factor(algorithm):
    A, y, generator = some_problem()
    Q = covariances(generator, 15, 4)
    one, ten = (
        analysis.wtls(A, y, row_cofactors=factor * Q, algorithm=algorithm) for factor in (1.0, 10.0)
    )
    np.testing.assert_allclose(ten.x, one.x, rtol=0, atol=1e-13)
    np.testing.assert_allclose(ten.cofactor, 10 * one.cofactor, rtol=1e-12)
    np.testing.assert_allclose(ten.covariance, one.covariance, rtol=1e-12)


def test_triangular_factor_does_not_square_the_condition():
    generator = np.random.default_rng(8)
    rows = generator.standard_normal((50, 3)) @ np.diag([1.0, 1e-6, 1e-12])
    factor = triangular_factor(rows[start : start + 2] for start in range(0, 50, 2))
    np.testing.assert_allclose(
        np.abs(np.diag(factor)), np.abs(np.diag(np.linalg.qr(rows, mode="r"))), rtol=1e-10
    )
    short = triangular_factor([rows[:2]])
    np.testing.assert_allclose(short.T @ short, rows[:2].T @ rows[:2], atol=1e-15)
