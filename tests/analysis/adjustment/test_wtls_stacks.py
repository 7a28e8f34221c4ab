"""Stacks of linear problems are their problems one by one."""

import dataclasses

import numpy as np
import pytest

import analysis

from .linear_problems import Q_ROWS, covariances, every_algorithm, some_problem


def stack_of_problems():
    A = np.stack([[some_problem(seed=3 * i + j)[0] for j in range(3)] for i in range(2)])
    y = np.stack([[some_problem(seed=3 * i + j)[1] for j in range(3)] for i in range(2)])
    return A, y


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
