"""The three conventions of the accuracy of x, each against its own definition."""

import numpy as np
import pytest

import analysis
from analysis.adjustment.cofactors import CONVENTIONS

N, M = 12, 2
GENERATOR = np.random.default_rng(1)
A = np.column_stack([GENERATOR.standard_normal(N), np.ones(N)])
Y = A @ [2.0, -1.0] + 0.3 * GENERATOR.standard_normal(N)
ROOT = GENERATOR.standard_normal((N * (M + 1), 2 * N * (M + 1)))
FULL = 0.1 * ROOT @ ROOT.T / (2 * N * (M + 1))
# the blocks of each row with itself
ROWS = np.einsum("kikj->kij", FULL.reshape(M + 1, N, M + 1, N).transpose(1, 0, 3, 2))


def known(form):
    """Cofactors for `wtls`, and the same as one matrix of (vec A, y)."""
    if form == "dense":
        return {
            "Q_A": FULL[: N * M, : N * M],
            "Q_Ay": FULL[: N * M, N * M :],
            "Q_y": FULL[N * M :, N * M :],
        }, FULL
    if form == "rows":
        whole = np.einsum("kij,kp->ikjp", ROWS, np.eye(N)).reshape(N * (M + 1), -1)
        return {"row_cofactors": ROWS}, whole
    Q_X, Q_y = np.diagonal(ROWS, axis1=1, axis2=2).T[[0, -1]]
    whole = np.zeros((N * (M + 1), N * (M + 1)))
    whole[:N, :N], whole[-N:, -N:] = np.diag(Q_X), np.diag(Q_y)
    return {"Q_0": np.diag([1.0, 0.0]), "Q_X": Q_X, "Q_y": Q_y}, whole


every_form = pytest.mark.parametrize("form", ["common", "rows", "dense"])


def profile(whole, data, x):
    """Φ(x) of the data (vec A, y), by Kronecker products."""
    B = np.hstack([-np.kron(x, np.eye(N)), np.eye(N)])
    return (B @ data) @ np.linalg.solve(B @ whole @ B.T, B @ data)


def cofactor(form, accuracy):
    return analysis.wtls(A, Y, **known(form)[0], accuracy=accuracy).cofactor


@every_form
def test_gauss_newton_is_that_of_all_unknowns_together(form):
    """Adjustment of the errors and x at once, linearised at the solution: the block of x of the
    inverse normal matrix.
    """
    cofactors, whole = known(form)
    estimate = analysis.wtls(A, Y, **cofactors)
    B = np.hstack([-np.kron(estimate.x, np.eye(N)), np.eye(N)])
    multipliers = np.linalg.solve(B @ whole @ B.T, Y - A @ estimate.x)
    errors = (whole @ B.T @ multipliers)[: N * M].reshape(M, N).T
    adjusted = A - errors
    expected = np.linalg.inv(adjusted.T @ np.linalg.solve(B @ whole @ B.T, adjusted))
    np.testing.assert_allclose(cofactor(form, "gauss_newton"), expected, rtol=1e-9)


@every_form
def test_inverse_hessian_is_that_of_the_objective(form):
    cofactors, whole = known(form)
    x, data, step = analysis.wtls(A, Y, **cofactors).x, np.concatenate([A.T.ravel(), Y]), 1e-5

    def gradient(x):
        return np.array([profile(whole, data, x + 1e-30j * e).imag * 1e30 for e in np.eye(M)])

    hessian = np.array(
        [(gradient(x + step * e) - gradient(x - step * e)) / (2 * step) for e in np.eye(M)]
    )
    np.testing.assert_allclose(
        cofactor(form, "inverse_hessian"), 2 * np.linalg.inv(hessian), rtol=1e-7
    )


@every_form
def test_propagated_is_that_of_the_solver(form):
    """The solution's derivative with respect to every element of A and y, by solving again with
    each moved.
    """
    cofactors, whole = known(form)
    data, step = np.concatenate([A.T.ravel(), Y]), 1e-5
    moved = data + step * np.concatenate([np.eye(len(data)), -np.eye(len(data))])
    matrices, ys = moved[:, : N * M].reshape(-1, M, N).swapaxes(-1, -2), moved[:, N * M :]
    x = analysis.wtls(matrices, ys, **cofactors).x
    jacobian = ((x[: len(data)] - x[len(data) :]) / (2 * step)).T
    np.testing.assert_allclose(
        cofactor(form, "propagated"), jacobian @ whole @ jacobian.T, rtol=1e-7
    )


@every_form
def test_conventions_differ_and_meet_where_errors_vanish(form):
    """To first order in the errors they are one."""
    cofactors, _ = known(form)
    differences = []
    for factor in (1.0, 0.01):
        small = {name: Q if name == "Q_0" else factor**2 * Q for name, Q in cofactors.items()}
        truth = A @ [2.0, -1.0]
        found = [
            analysis.wtls(A, truth + factor * (Y - truth), **small, accuracy=accuracy).cofactor
            for accuracy in CONVENTIONS
        ]
        scale = np.abs(found[0]).max()
        differences.append(
            [
                np.abs(one - other).max() / scale
                for one, other in ((found[0], found[1]), (found[0], found[2]))
            ]
        )
    large, small = np.array(differences)
    assert (large > 1e-3).all() and (small < 0.05 * large).all()


def test_exact_design_matrix_knows_one_convention_only():
    """Least squares: its normal matrix is exact, whatever the convention."""
    expected = analysis.ls(A, Y).cofactor
    for accuracy in CONVENTIONS:
        np.testing.assert_allclose(
            analysis.wtls(A, Y, accuracy=accuracy).cofactor, expected, rtol=1e-12
        )


@pytest.mark.parametrize("accuracy", CONVENTIONS)
def test_every_convention_has_about_the_scatter_of_many_solutions(accuracy):
    """Lines with errors of a tenth of their length: the mean of the stated cofactors is the
    covariance found, to its sampling error.
    """
    generator = np.random.default_rng(2)
    true = np.linspace(-1.0, 1.0, 20)
    count, sigma = 4000, 0.1
    x = true + sigma * generator.standard_normal((count, 20))
    y = 2.0 * true - 1.0 + sigma * generator.standard_normal((count, 20))
    lines = np.stack([x, np.ones_like(x)], axis=-1)
    estimate = analysis.wtls(
        lines,
        y,
        Q_0=np.diag([sigma**2, 0.0]),
        Q_X=np.ones(20),
        Q_y=np.full(20, sigma**2),
        accuracy=accuracy,
    )
    scatter = np.cov(estimate.x.T)
    stated = estimate.cofactor.mean(axis=0)
    # sampling: 2.2 % at one sd
    np.testing.assert_allclose(np.diag(stated), np.diag(scatter), rtol=0.08)
