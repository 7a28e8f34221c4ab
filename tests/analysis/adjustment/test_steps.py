"""Steps and derivatives of the objective, against printed formulas and values of the objective."""

import numpy as np
import pytest
from scipy.optimize import least_squares

import analysis
from analysis.adjustment.cofactors import gauss_newton_cofactor
from analysis.adjustment.problem import DenseCofactors, RowCofactors
from analysis.adjustment.steps import derivatives, newton_step, objective, schaffrin_wieser_step

from .linear_problems import (
    SPHERE_Q_0,
    covariances,
    eiv_problem,
    kronecker,
    numerical_derivatives,
    point_weights,
    some_problem,
    sphere_rows,
)


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
