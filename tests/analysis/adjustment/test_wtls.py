"""The solvers on linear errors-in-variables problems: against each other, against dense algebra,
against other libraries.
"""

import dataclasses

import numpy as np
import pytest
from odrpack import odr_fit
from scipy.optimize import least_squares

import analysis
from analysis.adjustment.algorithms import ALGORITHMS
from analysis.adjustment.cofactors import gauss_newton_cofactor
from analysis.adjustment.problem import CommonCofactors, DenseCofactors, EIVProblem, RowCofactors
from analysis.adjustment.steps import derivatives, newton_step, objective, schaffrin_wieser_step
from analysis.adjustment.wtls import triangular_factor
from studies.ou_liu_2017 import clouds

every_algorithm = pytest.mark.parametrize("algorithm", ALGORITHMS)
SPHERE_Q_0 = np.diag([1.0, 1.0, 1.0, 0.0])


def sphere_rows(n=60, seed=1):
    """A (n, 4) and y (n,) of the sphere as Ou & Liu print them, from rounded points."""
    points = clouds.sphere_cloud(np.random.default_rng(seed), n)
    return np.column_stack([2 * points, np.ones(n)]), np.sum(points**2, axis=1)


def eiv_problem(A, y, cofactors):
    return EIVProblem(np.column_stack([A, y]).T, cofactors)


def kronecker(Q_0, Q_X, Q_y):
    """``Q_A = Q_0 ⊗ diag(Q_X)`` and diagonal ``Q_y``."""
    C = np.zeros((len(Q_0) + 1, len(Q_0) + 1))
    C[:-1, :-1] = Q_0
    return CommonCofactors(C, Q_X, Q_y)


def point_weights(kind, n=60):
    return np.ones(n) if kind == "equal" else np.random.default_rng(2).uniform(0.2, 5.0, n)


def some_problem(n=15, m=3, seed=3):
    """A, y with errors of a tenth, and a generator for more."""
    generator = np.random.default_rng(seed)
    true = generator.standard_normal((n, m))
    A = true + 0.1 * generator.standard_normal((n, m))
    y = true @ np.arange(1.0, m + 1) + 0.1 * generator.standard_normal(n)
    return A, y, generator


def covariances(generator, count, size):
    """``count`` positive definite matrices of ``size``, none diagonal."""
    root = generator.standard_normal((count, size, 2 * size))
    return 0.01 * root @ root.swapaxes(-1, -2) / (2 * size)


def dense_blocks(rows):
    """Q_y, Q_A, Q_Ay of independent rows with cofactors ``rows`` (n, m+1, m+1)."""
    n, m = len(rows), rows.shape[-1] - 1
    full = np.einsum("nij,np->injp", rows, np.eye(n))
    return full[m, :, m], full[:m, :, :m].reshape(n * m, n * m), full[:m, :, m].reshape(n * m, n)


def profile_objective(A, y, Q_y, Q_A, Q_Ay):
    """Φ(x) = (y − Ax)ᵀ M⁻¹ (y − Ax), M by propagation with Kronecker products, as the textbooks
    write it.
    """

    def phi(x):
        B = np.kron(x, np.eye(len(y)))
        M = Q_y + B @ Q_A @ B.T - B @ Q_Ay - (B @ Q_Ay).T
        return (y - A @ x) @ np.linalg.solve(M, y - A @ x)

    return phi


def minimum_by_newton(phi, x):
    """Minimum of a smooth function by Newton's method with nothing but its values (complex steps,
    then differences).
    """
    for _ in range(12):
        gradient, hessian = numerical_derivatives(phi, x)
        x = x - np.linalg.solve(hessian, gradient)
    return x


def numerical_derivatives(phi, x, step=1e-5):
    """Gradient by complex steps, Hessian by central differences of that gradient."""

    def gradient(x):
        return np.array([phi(x + 1e-30j * e).imag * 1e30 for e in np.eye(len(x))])

    hessian = np.array(
        [(gradient(x + step * e) - gradient(x - step * e)) / (2 * step) for e in np.eye(len(x))]
    )
    return gradient(x), hessian


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


def test_one_schaffrin_wieser_step_is_the_printed_one():
    """Away from the solution too, where an error in ν or in a weight shows."""
    A, y = sphere_rows()
    P = point_weights("random")
    problem = eiv_problem(A, y, kronecker(SPHERE_Q_0, 1 / P, y / P))
    X = np.array([9.0, 11.0, 0.5, 3.0])
    mu = 1 / (y / P + (X @ SPHERE_Q_0 @ X) / P)
    nu = np.sum((mu * (y - A @ X)) ** 2 / P)
    printed = np.linalg.solve((A.T * mu) @ A - nu * SPHERE_Q_0, (A.T * mu) @ y)
    np.testing.assert_allclose(schaffrin_wieser_step(problem, X), printed, rtol=1e-10)


def test_weight_of_zero_in_a_step_deletes_the_row():
    A, y = sphere_rows()
    weights = np.random.default_rng(5).uniform(0.1, 1.0, 60)
    weights[::7] = 0.0
    X = np.array([9.0, 11.0, 0.5, 3.0])
    used = weights > 0
    whole = eiv_problem(A, y, kronecker(SPHERE_Q_0, np.ones(60), y))
    rest = eiv_problem(
        A[used], y[used], kronecker(SPHERE_Q_0, 1 / weights[used], y[used] / weights[used])
    )
    np.testing.assert_allclose(
        schaffrin_wieser_step(whole, X, weights), schaffrin_wieser_step(rest, X), rtol=1e-11
    )


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


# ------------------------------------------------------------------------------ derivatives


def problems():
    A, y, generator = some_problem()
    full = covariances(generator, 1, 60)[0]
    return {
        "common": eiv_problem(
            A,
            y,
            kronecker(full[:3, :3], generator.uniform(1, 3, 15), generator.uniform(0.01, 0.03, 15)),
        ),
        "rows": eiv_problem(A, y, RowCofactors(covariances(generator, 15, 4))),
        "dense": eiv_problem(
            A, y, DenseCofactors.from_blocks(full[45:, 45:], full[:45, :45], full[:45, 45:])
        ),
    }


@pytest.mark.parametrize("name", ["common", "rows", "dense"])
def test_gradient_and_hessian_are_exact(name):
    """At the solution's neighbour and far off, against Φ's values alone; Gauss-Newton's Hessian is
    another.
    """
    problem = problems()[name]
    for x in (np.array([1.05, 1.9, 3.1]), np.array([4.0, -7.0, 2.0])):
        value, gradient, hessian = derivatives(problem, x)
        numerical_gradient, numerical_hessian = numerical_derivatives(
            lambda x: objective(problem, x), x
        )
        np.testing.assert_allclose(value, objective(problem, x), rtol=1e-13)
        np.testing.assert_allclose(
            gradient, numerical_gradient / 2, rtol=0, atol=1e-12 * np.abs(gradient).max()
        )
        np.testing.assert_allclose(
            hessian, numerical_hessian / 2, rtol=0, atol=1e-8 * np.abs(hessian).max()
        )
        gauss_newton = np.linalg.inv(gauss_newton_cofactor(problem, x))
        assert np.abs(gauss_newton - hessian).max() > 1e-3 * np.abs(hessian).max()


@pytest.mark.parametrize("name", ["common", "rows", "dense"])
def test_newton_step_solves_with_them(name):
    problem, x = problems()[name], np.array([1.05, 1.9, 3.1])
    _, gradient, hessian = derivatives(problem, x)
    np.testing.assert_allclose(
        newton_step(problem, x) - x, -np.linalg.solve(hessian, gradient), rtol=1e-9
    )


def test_newton_step_that_would_climb_is_replaced():
    """Far away the Hessian need not be positive definite; there the way of a Gauss-Newton step is
    taken, which leads downhill.
    """
    problem = problems()["rows"]
    kinds = []
    for x in 30 * np.random.default_rng(7).standard_normal((40, 3)):
        value, gradient, hessian = derivatives(problem, x)
        newton = x - np.linalg.solve(hessian, gradient)
        gauss_newton = -gauss_newton_cofactor(problem, x) @ gradient
        new = newton_step(problem, x)
        assert objective(problem, new) <= value * (1 + 1e-12)
        if np.linalg.eigvalsh(hessian)[0] > 0 and objective(problem, newton) <= value:
            np.testing.assert_allclose(new, newton, rtol=1e-9)
            kinds.append("newton")
        else:
            shortened = (new - x) @ gauss_newton / (gauss_newton @ gauss_newton)
            np.testing.assert_allclose(
                new - x, shortened * gauss_newton, rtol=1e-9, atol=1e-9 * np.linalg.norm(x)
            )
            halvings = -np.log2(shortened)
            assert abs(halvings - round(halvings)) < 1e-9
            kinds.append("gauss-newton" if round(halvings) == 0 else "halved")
    assert set(kinds) == {"newton", "gauss-newton", "halved"}


@pytest.mark.parametrize("name", ["common", "rows"])
def test_cofactor_is_gauss_newton_s_of_the_standardised_misclosures(name):
    """scipy's Jacobian of r/√s at the solution, by complex steps."""
    problem = problems()[name]
    A, y = problem.rows[:-1].T, problem.rows[-1]

    def standardised(x):
        z = np.append(-x, 1.0)
        return (z @ problem.rows) / np.sqrt(problem.cofactors.misclosure(z))

    solution = least_squares(
        standardised,
        np.linalg.lstsq(A, y, rcond=None)[0],
        jac="cs",
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-15,
    )
    given = problem.cofactors
    known = (
        {"row_cofactors": given.Q}
        if name == "rows"
        else {"Q_0": given.C[:-1, :-1], "Q_X": given.g, "Q_y": given.h}
    )
    estimate = analysis.wtls(A, y, **known)
    np.testing.assert_allclose(estimate.x, solution.x, rtol=1e-8)
    np.testing.assert_allclose(
        estimate.cofactor, np.linalg.inv(solution.jac.T @ solution.jac), rtol=1e-6
    )
    np.testing.assert_allclose(estimate.objective, 2 * solution.cost, rtol=1e-12)
    np.testing.assert_allclose(
        estimate.covariance, 2 * solution.cost / 12 * estimate.cofactor, rtol=1e-12
    )


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


# ------------------------------------------------------------------------------ stacks


def stack_of_problems():
    A = np.stack([[some_problem(seed=3 * i + j)[0] for j in range(3)] for i in range(2)])
    y = np.stack([[some_problem(seed=3 * i + j)[1] for j in range(3)] for i in range(2)])
    return A, y


Q_ROWS = covariances(np.random.default_rng(9), 15, 4)
SOLVERS = {
    "ls": analysis.ls,
    "ls weighted": lambda A, y: analysis.ls(A, y, weights=np.arange(1.0, 16.0)),
    "tls": analysis.tls,
    "mixed_ls_tls": lambda A, y: analysis.mixed_ls_tls(A, y, exact_columns=[2]),
    "newton": lambda A, y: analysis.wtls(A, y, row_cofactors=Q_ROWS),
    "schaffrin_wieser": lambda A, y: analysis.wtls(
        A, y, Q_0=np.diag([1.0, 0.5, 0.0]), Q_X=np.arange(1.0, 16.0), algorithm="schaffrin_wieser"
    ),
}


@pytest.mark.parametrize("solver", SOLVERS.values(), ids=SOLVERS.keys())
def test_a_stack_is_its_problems_one_by_one(solver):
    A, y = stack_of_problems()
    together = solver(A, y)
    assert (
        together.x.shape == (2, 3, 3)
        and together.cofactor.shape == (2, 3, 3, 3)
        and together.sigma_0.shape == (2, 3)
    )
    for index in np.ndindex(2, 3):
        apart = solver(A[index], y[index])
        assert apart.x.shape == (3,) and np.ndim(apart.sigma_0) == 0
        for name in ("x", "cofactor", "objective", "sigma_0"):
            np.testing.assert_allclose(
                getattr(together, name)[index], getattr(apart, name), rtol=1e-9, err_msg=name
            )


def test_row_cofactors_of_a_stack():
    A, y = stack_of_problems()
    Q = covariances(np.random.default_rng(10), 6 * 15, 4).reshape(2, 3, 15, 4, 4)
    together = analysis.wtls(A, y, row_cofactors=Q)
    for index in np.ndindex(2, 3):
        np.testing.assert_allclose(
            together.x[index],
            analysis.wtls(A[index], y[index], row_cofactors=Q[index]).x,
            rtol=1e-12,
        )


@every_algorithm
def test_every_algorithm_takes_stacks(algorithm):
    A, y = stack_of_problems()
    together = analysis.wtls(A, y, row_cofactors=Q_ROWS, algorithm=algorithm)
    for index in np.ndindex(2, 3):
        apart = analysis.wtls(A[index], y[index], row_cofactors=Q_ROWS, algorithm=algorithm)
        np.testing.assert_allclose(together.x[index], apart.x, rtol=1e-12)
        assert together.stop_reason[index].startswith("the ") and together.converged[index]


@pytest.mark.parametrize("accuracy", ["gauss_newton", "inverse_hessian", "propagated"])
def test_full_matrices_of_a_stack(accuracy):
    A, y = stack_of_problems()
    Q = covariances(np.random.default_rng(11), 1, 60)[0]
    known = {"Q_A": Q[:45, :45], "Q_Ay": Q[:45, 45:], "Q_y": Q[45:, 45:], "accuracy": accuracy}
    together = analysis.wtls(A, y, **known)
    for index in np.ndindex(2, 3):
        apart = analysis.wtls(A[index], y[index], **known)
        np.testing.assert_allclose(together.x[index], apart.x, rtol=1e-12)
        np.testing.assert_allclose(together.cofactor[index], apart.cofactor, rtol=1e-10)


def test_inputs_stay_as_they_are():
    A, y, _ = some_problem()
    Q = Q_ROWS.copy()
    for array in (A, y, Q):
        array.flags.writeable = False
    analysis.wtls(A, y, row_cofactors=Q)
    analysis.mixed_ls_tls(A, y, exact_columns=[0])
    analysis.ls(A, y, weights=np.broadcast_to(1.0, 15))
    np.testing.assert_array_equal(Q, Q_ROWS)
    with pytest.raises(dataclasses.FrozenInstanceError):
        analysis.ls(A, y).x = 0


# ------------------------------------------------------------------------------ what does not go
# well


@every_algorithm
def test_not_converged(algorithm):
    A, y, _ = some_problem()
    estimate = analysis.wtls(A, y, row_cofactors=Q_ROWS, algorithm=algorithm, max_iterations=1)
    assert not estimate.converged and estimate.iterations == 1
    assert (
        estimate.stop_reason.startswith("not converged: ") and "1 iteration" in estimate.stop_reason
    )
    assert analysis.wtls(A, y, row_cofactors=Q_ROWS, algorithm=algorithm).converged


def test_no_redundancy():
    estimate = analysis.ls(np.eye(3), [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(estimate.x, [1.0, 2.0, 3.0])
    assert np.isnan(estimate.sigma_0)


GOOD_A, GOOD_Y, _ = some_problem()
WITH_NAN = np.where(np.arange(15) == 4, np.nan, GOOD_Y)
DEPENDENT = np.column_stack([GOOD_A[:, :2], GOOD_A[:, 0] - 2 * GOOD_A[:, 1]])
ONES = np.ones(15)


@pytest.mark.parametrize("solve", [analysis.ls, analysis.tls, analysis.mixed_ls_tls, analysis.wtls])
@pytest.mark.parametrize(
    ("A", "y", "message"),
    [
        (GOOD_A[0], GOOD_Y, r"A: expected shape \(…, n, m\) with n ≥ m ≥ 1, got \(3,\)"),
        (GOOD_A[:2], GOOD_Y[:2], r"A: expected shape \(…, n, m\) with n ≥ m ≥ 1, got \(2, 3\)"),
        (np.empty((15, 0)), GOOD_Y, r"A: expected shape .* got \(15, 0\)"),
        (GOOD_A, GOOD_Y[:-1], r"y: expected shape \(15,\) to go with A \(15, 3\), got \(14,\)"),
        (
            GOOD_A,
            GOOD_Y[:, None],
            r"y: expected shape \(15,\) to go with A \(15, 3\), got \(15, 1\)",
        ),
        (GOOD_A, WITH_NAN, "y: expected finite numbers, got 1 NaN or infinite of 15"),
        (
            np.where(GOOD_A > 2, np.inf, GOOD_A),
            GOOD_Y,
            "A: expected finite numbers, got . NaN or infinite of 45",
        ),
        ([["one", "two"]], [1.0], "A: expected an array of real numbers"),
        (GOOD_A + 1j, GOOD_Y, "A: expected an array of real numbers, got dtype complex128"),
        (DEPENDENT, GOOD_Y, "A: expected independent columns, got a smallest singular value of"),
        (np.zeros((15, 3)), GOOD_Y, "A: expected independent columns"),
    ],
)
def test_bad_problems_are_refused(solve, A, y, message):
    with pytest.raises(ValueError, match=message):
        solve(A, y)


@pytest.mark.parametrize(
    ("weights", "message"),
    [
        (np.zeros(15), "weights: expected positive numbers, got a smallest value of 0"),
        (-ONES, "weights: expected positive numbers, got a smallest value of -1"),
        (WITH_NAN, "weights: expected finite numbers"),
        (np.ones(14), r"weights: expected shape \(15,\) .*got \(14,\)"),
    ],
)
def test_bad_weights_are_refused(weights, message):
    with pytest.raises(ValueError, match=message):
        analysis.ls(GOOD_A, GOOD_Y, weights=weights)


@pytest.mark.parametrize("columns", [[3], [-4], [0, 0], [0, -3], ["a"], [0.5]])
def test_bad_exact_columns_are_refused(columns):
    with pytest.raises(ValueError, match="exact_columns: expected"):
        analysis.mixed_ls_tls(GOOD_A, GOOD_Y, exact_columns=columns)


SKEW = np.eye(15) + np.triu(np.full((15, 15), 0.1), 1)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"algorithm": "simplex"},
            "algorithm: expected one of newton, bfgs, dfp, schaffrin_wieser, .*; got 'simplex'",
        ),
        (
            {"accuracy": "sandwich"},
            "accuracy: expected one of gauss_newton, inverse_hessian, propagated; got 'sandwich'",
        ),
        ({"H_0": "zero"}, "H_0: expected one of gauss_newton, identity; got 'zero'"),
        (
            {"H_0": "identity"},
            "H_0: expected 'identity' with bfgs or dfp only, got it with 'newton'",
        ),
        ({"max_iterations": 0}, "max_iterations: expected a positive whole number, got 0"),
        ({"tolerance": 0}, "tolerance: expected a positive finite number, got 0"),
        (
            {"Q_0": np.eye(3), "Q_X": ONES, "Q_A": np.eye(45)},
            "Q_A: expected either Q_A or Q_0 with Q_X, got both",
        ),
        ({"Q_0": np.eye(3)}, "Q_0 and Q_X: expected both or none, got one of them"),
        ({"Q_X": ONES}, "Q_0 and Q_X: expected both or none, got one of them"),
        ({"row_cofactors": Q_ROWS, "Q_y": ONES}, "row_cofactors: expected alone, got it together"),
        (
            {"row_cofactors": Q_ROWS[:, :3, :3]},
            r"row_cofactors: expected shape \(15, 4, 4\).* got \(15, 3, 3\)",
        ),
        (
            {"row_cofactors": Q_ROWS + np.triu(np.ones((4, 4)), 1)},
            "row_cofactors: expected symmetric matrices, got a difference of 1 ",
        ),
        ({"Q_0": np.eye(4), "Q_X": ONES}, r"Q_0: expected shape \(3, 3\), got \(4, 4\)"),
        (
            {"Q_0": SKEW[:3, :3], "Q_X": ONES},
            "Q_0: expected symmetric matrices, got a difference of 0.1 to the transpose",
        ),
        (
            {"Q_0": np.eye(3), "Q_X": np.ones(14)},
            r"Q_X: expected shape \(15,\) or \(15, 15\), got \(14,\)",
        ),
        ({"Q_0": np.eye(3), "Q_X": -ONES}, "Q_X: expected variances of at least 0, got -1"),
        ({"Q_y": -ONES}, "Q_y: expected variances of at least 0, got -1"),
        ({"Q_y": np.ones((15, 14))}, r"Q_y: expected shape \(15, 15\), got \(15, 14\)"),
        ({"Q_y": SKEW}, "Q_y: expected symmetric matrices"),
        ({"Q_y": WITH_NAN}, "Q_y: expected finite numbers"),
        ({"Q_A": np.eye(44)}, r"Q_A: expected shape \(45, 45\), got \(44, 44\)"),
        ({"Q_Ay": np.zeros((45, 14))}, r"Q_Ay: expected shape \(45, 15\), got \(45, 14\)"),
    ],
)
def test_bad_cofactors_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        analysis.wtls(GOOD_A, GOOD_Y, **options)


@pytest.mark.parametrize(
    "cofactors",
    [
        {"Q_0": -np.eye(3), "Q_X": ONES},
        {"Q_y": -np.eye(15)},
        {"Q_A": -np.eye(45)},
        {"row_cofactors": -Q_ROWS},
    ],
    ids=["Q_0", "Q_y", "Q_A", "row_cofactors"],
)
def test_matrices_with_negative_variances_are_refused(cofactors):
    (name,) = {"Q_0", "Q_y", "Q_A", "row_cofactors"} & set(cofactors)
    with pytest.raises(ValueError, match=f"{name}: expected"):
        analysis.wtls(GOOD_A, GOOD_Y, **cofactors)


def test_misclosures_that_are_one_are_refused():
    """Two rows with one and the same error: their difference is exact, and no x need meet it."""
    Q_y = np.eye(15)
    Q_y[0, 1] = Q_y[1, 0] = 1.0
    with pytest.raises(
        ValueError,
        match="cofactors: expected misclosures with a positive definite correlation matrix, got",
    ):
        analysis.wtls(GOOD_A, GOOD_Y, Q_y=Q_y)


@pytest.mark.parametrize(
    "cofactors",
    [{"Q_y": np.zeros(15)}, {"row_cofactors": np.zeros((15, 4, 4))}],
    ids=["Q_y", "row_cofactors"],
)
def test_rows_without_any_error_are_refused(cofactors):
    """No x satisfies 15 exact equations in 3 unknowns."""
    with pytest.raises(ValueError, match="cofactors: expected an error in every row"):
        analysis.wtls(GOOD_A, GOOD_Y, **cofactors)
