"""Updates of the Hessian and the line search, against their definitions and a closed form."""

import numpy as np
import pytest
from scipy.optimize import minimize

import analysis
from analysis.adjustment.problem import CommonCofactors, EIVProblem
from analysis.adjustment.quasi_newton import ARMIJO, CURVATURE, bfgs, dfp, line_search, minimise
from analysis.adjustment.steps import objective, value_and_gradient
from studies.ou_liu_2017 import clouds

both_updates = pytest.mark.parametrize("update", [bfgs, dfp])


def steps_and_changes(count=50, m=4):
    """Steps s and changes v of the gradient of quadratic functions, and positive definite H."""
    generator = np.random.default_rng(1)
    root, other = generator.standard_normal((2, count, m, 2 * m))
    s = generator.standard_normal((count, m))
    v = ((root @ root.swapaxes(-1, -2)) @ s[..., None])[..., 0]
    return other @ other.swapaxes(-1, -2), s, v


@both_updates
def test_update_meets_the_secant_condition_and_stays_positive_definite(update):
    H, s, v = steps_and_changes()
    new = update(H, s, v)
    np.testing.assert_allclose((new @ v[..., None])[..., 0], s, rtol=0, atol=1e-10)
    np.testing.assert_allclose(new, new.swapaxes(-1, -2), rtol=0, atol=1e-10)
    assert np.linalg.eigvalsh(new).min() > 0


def test_updates_are_dual():
    """BFGS of the inverse Hessian is DFP of the Hessian with s and v exchanged."""
    H, s, v = steps_and_changes()
    np.testing.assert_allclose(
        np.linalg.inv(bfgs(H, s, v)), dfp(np.linalg.inv(H), v, s), rtol=1e-7, atol=1e-7
    )


# ------------------------------------------------------------------------------ planes


def planes(count=40, n=30):
    """Planes with one weight per point for all coordinates; starts; directions downhill."""
    generator = np.random.default_rng(2)
    A = np.concatenate([generator.uniform(-1, 1, (count, n, 2)), np.ones((count, n, 1))], axis=-1)
    y = A @ [0.3, -2.0, 1.0] + 0.3 * generator.standard_normal((count, n))
    P = generator.uniform(0.2, 5.0, n)
    C = np.broadcast_to(np.diag([1.0, 1.0, 0.0, 0.0]), (count, 4, 4))
    rows = np.concatenate([A, y[..., None]], axis=-1).swapaxes(-1, -2)
    problem = EIVProblem(
        rows,
        CommonCofactors(C, np.broadcast_to(1 / P, (count, n)), np.broadcast_to(1 / P, (count, n))),
    )
    x = np.array([0.3, -2.0, 1.0]) + generator.standard_normal((count, 3))
    value, gradient = value_and_gradient(problem, x)
    H = np.diag([0.02, 0.02, 0.005]) * generator.uniform(0.05, 20.0, (count, 1, 1))
    d = -(H @ gradient[..., None])[..., 0]
    return A, y, P, problem, x, 0.5 * value, gradient, d


def best_step_for_a_plane(A, y, P, x, d):
    """The α that minimises Φ(x + α d) = Σ P (r − α q)² / |(x_a + α d_a, x_b + α d_b, −1)|²: a root
    of a quadratic equation.
    """
    r, q = y - A @ x, A @ d
    n0, n1, n2 = P @ r**2, P @ (r * q), P @ q**2
    s0, s1, s2 = 1 + x[0] ** 2 + x[1] ** 2, x[0] * d[0] + x[1] * d[1], d[0] ** 2 + d[1] ** 2
    roots = np.roots([n1 * s2 + n2 * s1, n2 * s0 - n0 * s2, -(n1 * s0 + n0 * s1)])
    phi = [(n0 - 2 * a * n1 + a * a * n2) / (s0 + 2 * a * s1 + a * a * s2) for a in roots]
    return roots[np.argmin(phi)]


def test_exact_line_search_is_the_closed_form_for_planes(monkeypatch):
    """With c2 → 0 the search goes on to the minimum along the line."""
    A, y, P, problem, x, value, gradient, d = planes()
    monkeypatch.setattr("analysis.adjustment.quasi_newton.CURVATURE", 1e-9)
    alpha, *_ = line_search(problem, x, d, value, gradient)
    expected = np.array(
        [
            best_step_for_a_plane(*one)
            for one in zip(A, y, np.broadcast_to(P, y.shape), x, d, strict=True)
        ]
    )
    np.testing.assert_allclose(alpha, expected, rtol=1e-7)
    # reached by interpolation, and by extrapolation
    assert expected.min() < 0.5 and expected.max() > 50


def test_line_search_meets_the_wolfe_conditions():
    *_, problem, x, value, gradient, d = planes()
    alpha, new_value, new_gradient, trials = line_search(problem, x, d, value, gradient)
    slope = np.sum(gradient * d, axis=-1)
    assert (alpha > 0).all() and trials.max() > 2 > trials.min() > 0
    assert (new_value <= value + ARMIJO * alpha * slope).all()
    assert (np.abs(np.sum(new_gradient * d, axis=-1)) <= CURVATURE * np.abs(slope)).all()
    again, gradient_there = value_and_gradient(problem, x + alpha[:, None] * d)
    np.testing.assert_allclose(new_value, 0.5 * again, rtol=1e-12)
    np.testing.assert_allclose(new_gradient, gradient_there, rtol=1e-9, atol=1e-12)


def test_line_search_of_a_stack_is_that_of_each():
    *_, problem, x, value, gradient, d = planes()
    alpha, *_, trials = line_search(problem, x, d, value, gradient)
    for i in range(0, 40, 7):
        one = slice(i, i + 1)
        apart = line_search(problem[one], x[one], d[one], value[one], gradient[one])
        np.testing.assert_allclose(apart[0], alpha[one], rtol=1e-12)
        np.testing.assert_array_equal(apart[-1], trials[one])


def test_line_search_that_finds_nothing_stays():
    """Told that uphill is downhill, it ends where it began."""
    *_, problem, x, value, gradient, d = planes()
    alpha, new_value, _, _ = line_search(problem, x, -1e-3 * d, value, -gradient)
    np.testing.assert_array_equal(alpha, 0.0)
    np.testing.assert_array_equal(new_value, value)


@both_updates
def test_rounding_does_not_stop_it_early(update):
    """Where Φ itself changes no more in its last digits (x good to 1e-8), the gradient still leads
    on.
    """
    A, y, P, problem, *_ = planes()
    start = np.linalg.lstsq(A[0], y[0], rcond=None)[0] + 0.1
    starts = np.tile(start, (40, 1))
    x, convergence = minimise(
        problem, starts, update, 1e-14, 500, H_0=np.broadcast_to(2.0 * np.eye(3), (40, 3, 3))
    )
    assert convergence.converged.all()
    for i in range(40):
        newton = analysis.wtls(A[i], y[i], Q_0=np.diag([1.0, 1.0, 0.0]), Q_X=1 / P, Q_y=1 / P)
        np.testing.assert_allclose(x[i], newton.x, rtol=1e-11)
    # A library's BFGS without the test on the gradient, for comparison.
    other = minimize(
        lambda x: objective(problem[:1], x[None])[0], start, method="BFGS", options={"gtol": 1e-15}
    )
    assert np.abs(other.x - x[0]).max() > 1e-10


@both_updates
def test_hessian_gone_wrong_is_begun_anew(update):
    """A start with H that leads uphill: Gauss-Newton's is taken instead."""
    A, y, _, problem, *_ = planes()
    starts = np.array([np.linalg.lstsq(A[i], y[i], rcond=None)[0] for i in range(40)])
    bad = np.broadcast_to(-np.eye(3), (40, 3, 3))
    x, convergence = minimise(problem, starts, update, 1e-14, 200, H_0=bad)
    good, _ = minimise(problem, starts, update, 1e-14, 200)
    assert convergence.converged.all()
    np.testing.assert_allclose(x, good, rtol=1e-12)


@both_updates
def test_small_steps_alone_are_no_convergence(update):
    """The paper's sphere in orthonormal columns, with H_0 far too small: there steps of 1e-11 are a
    hundredth of what is left.
    """
    points = clouds.sphere_cloud(np.random.default_rng(1), 500)
    columns, R = np.linalg.qr(np.column_stack([2 * points, np.ones(500)]))
    w = np.sum(points**2, axis=1)
    C = np.zeros((1, 5, 5))
    C[0, :4, :4] = np.linalg.inv(R).T @ np.diag([1.0, 1.0, 1.0, 0.0]) @ np.linalg.inv(R)
    problem = EIVProblem(
        np.vstack([columns.T, w])[None], CommonCofactors(C, np.ones((1, 500)), w[None])
    )
    start = (columns.T @ w)[None]
    x, convergence = minimise(problem, start, update, 1e-14, 1000, H_0=2.0 * np.eye(4)[None])
    good, _ = minimise(problem, start, update, 1e-14, 1000)
    assert convergence.converged.all() and convergence.iterations[0] > 15
    np.testing.assert_allclose(x, good, rtol=1e-11)


def test_identity_is_that_of_the_objective_in_the_given_columns():
    """A problem whose Hessian is nearly I: the first step from H_0 = I is −∇Φ itself."""
    generator = np.random.default_rng(3)
    A, _ = np.linalg.qr(generator.standard_normal((30, 3)))
    y = A @ [1.0, 2.0, 3.0] + 0.3 * generator.standard_normal(30)
    C = np.diag([0.02, 0.01, 0.03, 0.0])
    known = {"Q_0": C[:3, :3], "Q_X": np.ones(30), "Q_y": np.full(30, 2.0)}
    history = analysis.wtls(A, y, **known, algorithm="bfgs", H_0="identity", history=True).history
    half = value_and_gradient(
        EIVProblem(np.vstack([A.T, y]), CommonCofactors(C, np.ones(30), np.full(30, 2.0))),
        history.x[0],
    )[1]
    assert history.trials[1] == 1
    np.testing.assert_allclose(history.x[1] - history.x[0], -2.0 * half, rtol=1e-9)
