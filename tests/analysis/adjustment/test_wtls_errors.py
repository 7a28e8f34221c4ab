"""Linear problems that cannot be solved, and input that is refused."""

import numpy as np
import pytest

import analysis

from .linear_problems import Q_ROWS, every_algorithm, some_problem


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
