"""Every algorithm finds the same solution of every problem from the least-squares start."""

import numpy as np
import pytest

import analysis
from analysis.adjustment.algorithms import ALGORITHMS
from studies.ou_liu_2017 import clouds

DESCENT = ("newton", "bfgs", "dfp")  # Φ falls from iteration to iteration, by a search or a check
STARTED = [(algorithm, "gauss_newton") for algorithm in ALGORITHMS] + [
    ("bfgs", "identity"),
    ("dfp", "identity"),
]


def plane(seed=1, side=0.5, sigma=0.02):
    """100 points of z = x + 3y + 1 on a square of 0.5 m, seen from the origin: variances σ²/cosθ,
    as Wu, Chen & Wang simulate them.
    """
    generator = np.random.default_rng(seed)
    xy = generator.uniform(0.0, side, (100, 2))
    points = np.column_stack([xy, xy @ [1.0, 3.0] + 1.0])
    variances = np.linalg.norm(points, axis=1) * np.sqrt(11.0) / np.abs(points @ [1.0, 3.0, -1.0])
    points += sigma * np.sqrt(variances)[:, None] * generator.standard_normal((100, 3))
    A = np.column_stack([points[:, :2], np.ones(100)])
    return A, points[:, 2], {"Q_0": np.diag([1.0, 1.0, 0.0]), "Q_X": variances, "Q_y": variances}


def sphere():
    """The sphere of Ou & Liu with their cofactors."""
    points = clouds.sphere_cloud(np.random.default_rng(1), 500)
    w = np.sum(points**2, axis=1)
    return (
        np.column_stack([2 * points, np.ones(500)]),
        w,
        {"Q_0": np.diag([1.0, 1.0, 1.0, 0.0]), "Q_X": np.ones(500), "Q_y": w},
    )


def dense(n=40, m=3):
    """Everything correlated with everything, errors of a third of the columns."""
    generator = np.random.default_rng(2)
    size = n * (m + 1)
    root = generator.standard_normal((size, 2 * size))
    Q = 0.1 * root @ root.T / (2 * size)
    true = generator.standard_normal((n, m))
    errors = np.linalg.cholesky(Q) @ generator.standard_normal(size)
    A = true + errors[: n * m].reshape(m, n).T
    y = true @ np.arange(1.0, m + 1) + errors[n * m :]
    return (
        A,
        y,
        {"Q_A": Q[: n * m, : n * m], "Q_Ay": Q[: n * m, n * m :], "Q_y": Q[n * m :, n * m :]},
    )


PROBLEMS = {"plane": plane(), "sphere": sphere(), "dense": dense()}
every_problem = pytest.mark.parametrize("name", PROBLEMS)


def solution(name, algorithm, H_0="gauss_newton", **options):
    A, y, cofactors = PROBLEMS[name]
    return analysis.wtls(A, y, **cofactors, algorithm=algorithm, H_0=H_0, **options)


@every_problem
@pytest.mark.parametrize(("algorithm", "H_0"), STARTED)
def test_all_agree(name, algorithm, H_0):
    estimate, newton = solution(name, algorithm, H_0), solution(name, "newton")
    assert estimate.converged
    assert np.linalg.norm(estimate.x - newton.x) < 1e-11 * np.linalg.norm(newton.x)
    np.testing.assert_allclose(
        estimate.cofactor, newton.cofactor, rtol=1e-9, atol=1e-12 * np.abs(newton.cofactor).max()
    )
    A, y, _ = PROBLEMS[name]
    # not merely where all began
    assert np.linalg.norm(estimate.x - analysis.ls(A, y).x) > 1e-7 * np.linalg.norm(newton.x)


@every_problem
@pytest.mark.parametrize(("algorithm", "H_0"), STARTED)
def test_history_leads_from_least_squares_to_the_solution(name, algorithm, H_0):
    A, y, _ = PROBLEMS[name]
    estimate = solution(name, algorithm, H_0, history=True)
    history = estimate.history
    assert (
        len(history.x) == len(history.objective) == len(history.trials) == estimate.iterations + 1
    )
    np.testing.assert_allclose(history.x[0], analysis.ls(A, y).x, rtol=1e-9)
    np.testing.assert_allclose(history.x[-1], estimate.x, rtol=1e-13)
    np.testing.assert_allclose(history.objective[-1], estimate.objective, rtol=1e-15)
    assert history.objective[0] > estimate.objective
    assert history.trials[0] == 0 and (history.trials[1:] >= 1).all()
    if not ALGORITHMS[algorithm].takes_H_0:
        assert history.trials.sum() == estimate.iterations
    assert solution(name, algorithm, H_0).history is None


@every_problem
@pytest.mark.parametrize(("algorithm", "H_0"), [pair for pair in STARTED if pair[0] in DESCENT])
def test_objective_never_rises(name, algorithm, H_0):
    objective = solution(name, algorithm, H_0, history=True).history.objective
    assert np.diff(objective).max() <= 1e-12 * objective[-1]


def test_iterations_are_those_of_their_kind():
    """Newton's are few; a Hessian that learns does not need more steps than Gauss-Newton's; a good
    one to begin with saves some.
    """
    for name in PROBLEMS:
        steps = {pair: solution(name, *pair, history=True).history.trials.sum() for pair in STARTED}
        of = {algorithm: steps[algorithm, "gauss_newton"] for algorithm in ALGORITHMS}
        assert of["newton"] <= 8
        assert of["newton"] <= of["bfgs"] <= of["shen"] <= 30
        assert of["bfgs"] < steps["bfgs", "identity"]
        assert abs(of["shen"] - of["amiri_simkooei"]) <= 1  # the same but for rounding


def test_bfgs_needs_fewer_iterations_than_dfp():
    """From H_0 = I, on the paper's planes; from a good H_0 both work, and cannot be told apart."""
    ratios = []
    for seed in range(10):
        A, y, cofactors = plane(seed)
        one, other = (
            analysis.wtls(A, y, **cofactors, algorithm=algorithm, H_0="identity").iterations
            for algorithm in ("bfgs", "dfp")
        )
        ratios.append(other / one)
    assert np.median(ratios) > 1.5


def test_a_search_from_a_good_hessian_tries_one_step():
    for name in PROBLEMS:
        for algorithm in ("bfgs", "dfp"):
            assert solution(name, algorithm, history=True).history.trials.max() == 1


def test_newton_converges_quadratically():
    """Each iteration doubles the digits, where a Gauss-Newton step adds the same number of digits
    each time.
    """
    errors = {}
    for algorithm in ("newton", "shen"):
        x = solution("plane", algorithm, history=True).history.x
        errors[algorithm] = np.linalg.norm(x - x[-1], axis=1)[:-2]
    e = errors["newton"]
    assert (e[2:] < 50 * e[1:-1] ** 2)[e[2:] > 1e-13].all()
    rates = errors["shen"][4:9] / errors["shen"][3:8]
    assert rates.max() < 1.1 * rates.min()


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_units_of_the_columns_do_not_matter(algorithm):
    """Solved in orthonormal columns: columns and y in other units give the solution in them, on the
    same way.
    """
    A, y, cofactors = PROBLEMS["plane"]
    units, unit = np.array([1e3, 1e-4, 1e5]), 1e-2
    scaled = {
        "Q_0": units[:, None] * cofactors["Q_0"] * units,
        "Q_X": cofactors["Q_X"],
        "Q_y": unit**2 * cofactors["Q_y"],
    }
    one = analysis.wtls(A, y, **cofactors, algorithm=algorithm)
    other = analysis.wtls(A * units, unit * y, **scaled, algorithm=algorithm)
    np.testing.assert_allclose(other.x * units / unit, one.x, rtol=1e-11)
    np.testing.assert_allclose(
        other.cofactor * np.outer(units, units) / unit**2, one.cofactor, rtol=1e-9
    )
    assert abs(other.iterations - one.iterations) <= 1


@pytest.mark.parametrize("algorithm", ALGORITHMS)
@pytest.mark.parametrize("factor", [1e-12, 1e12])
def test_unit_of_the_cofactors_does_not_matter(algorithm, factor):
    A, y, cofactors = PROBLEMS["plane"]
    scaled = cofactors | {"Q_X": factor * cofactors["Q_X"], "Q_y": factor * cofactors["Q_y"]}
    one, other = (
        analysis.wtls(A, y, **cofactors, algorithm=algorithm),
        analysis.wtls(A, y, **scaled, algorithm=algorithm),
    )
    np.testing.assert_allclose(other.x, one.x, rtol=1e-12)
    np.testing.assert_allclose(other.sigma_0, one.sigma_0 / np.sqrt(factor), rtol=1e-12)
    assert abs(other.iterations - one.iterations) <= 1


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_exact_data_give_the_truth(algorithm):
    generator = np.random.default_rng(4)
    A = np.column_stack([generator.standard_normal((20, 2)), np.ones(20)])
    estimate = analysis.wtls(
        A, A @ [1.0, -2.0, 3.0], Q_0=np.diag([1.0, 1.0, 0.0]), Q_X=np.ones(20), algorithm=algorithm
    )
    assert estimate.converged
    np.testing.assert_allclose(estimate.x, [1.0, -2.0, 3.0], rtol=1e-13)


def test_exact_rows_among_correlated_ones():
    """Singular cofactors in full: a row of A and an element of another row without errors."""
    A, y, cofactors = PROBLEMS["dense"]
    n = len(y)
    Q = np.block([[cofactors["Q_A"], cofactors["Q_Ay"]], [cofactors["Q_Ay"].T, cofactors["Q_y"]]])
    exact = [0, n, 2 * n, 1]  # the whole of row 0 of A, one element of row 1
    Q[exact], Q[:, exact] = 0.0, 0.0
    known = {"Q_A": Q[: 3 * n, : 3 * n], "Q_Ay": Q[: 3 * n, 3 * n :], "Q_y": Q[3 * n :, 3 * n :]}
    assert np.linalg.matrix_rank(known["Q_A"]) == 3 * n - 4
    solutions = np.array(
        [analysis.wtls(A, y, **known, algorithm=algorithm).x for algorithm in ALGORITHMS]
    )
    np.testing.assert_allclose(solutions, solutions[[0]].repeat(len(solutions), axis=0), rtol=1e-11)
    # The limit of small variances.
    nearly = Q.copy()
    nearly[exact, exact] = 1e-9
    limit = analysis.wtls(
        A,
        y,
        Q_A=nearly[: 3 * n, : 3 * n],
        Q_Ay=nearly[: 3 * n, 3 * n :],
        Q_y=nearly[3 * n :, 3 * n :],
    )
    np.testing.assert_allclose(solutions[0], limit.x, rtol=0, atol=1e-7)
    assert np.abs(solutions[0] - solution("dense", "newton").x).max() > 1e-3


def test_history_takes_one_problem():
    A, y, cofactors = PROBLEMS["plane"]
    with pytest.raises(
        ValueError,
        match=r"history: expected one problem \(n, m\), got a stack of shape \(2, 100, 3\)",
    ):
        analysis.wtls(np.stack([A, A]), np.stack([y, y]), **cofactors, history=True)


def test_table_tells_the_algorithms_apart():
    for field in ("label", "source", "colour"):
        assert len({getattr(algorithm, field) for algorithm in ALGORITHMS.values()}) == len(
            ALGORITHMS
        )
