"""Reliability: against dense algebra, against errors put in and found, and on a million points."""

import numpy as np
import pytest
from scipy.stats import norm

import analysis
from analysis.orthogonal.reliability import (
    CORRECTIONS,
    Reliability,
    data_snooping,
    noncentrality,
    reliability,
)

TRUTH = np.array([0.3, -0.2, 6.0, 0.5])
SIGMA = 0.001
N = 40


def cloud(*shape, seed=1, sigma=SIGMA):
    """Points (*shape, 3) within 80° of the top of the sphere TRUTH."""
    rng = np.random.default_rng(seed)
    z, angle = rng.uniform(np.cos(np.radians(80.0)), 1.0, shape), rng.uniform(0, 2 * np.pi, shape)
    radial = np.stack(
        [np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z], axis=-1
    )
    return TRUTH[:3] + TRUTH[3] * radial + sigma * rng.standard_normal((*shape, 3))


def outwards(points, row, by):
    """A copy with one point (of each cloud) moved along its normal, m."""
    moved = points.copy()
    D = moved[..., row, :] - TRUTH[:3]
    moved[..., row, :] += np.asarray(by)[..., None] * D / np.linalg.norm(D, axis=-1, keepdims=True)
    return moved


def geometric(points, **given):
    return analysis.fit_sphere(points, "geometric", **given)


RNG = np.random.default_rng(2)
ROOTS = RNG.standard_normal((N, 3, 3))
GIVEN = {
    "nothing": {},
    "weights": {"weights": RNG.uniform(0.5, 2.0, N)},
    "variances": {"cofactors": RNG.uniform(0.5, 2.0, N)},
    "covariances": {"cofactors": ROOTS @ ROOTS.swapaxes(-1, -2) + 0.5 * np.eye(3)},
}


@pytest.mark.parametrize("method", ["eiv", "geometric", "robust"])
@pytest.mark.parametrize("radius", [None, 0.5])
@pytest.mark.parametrize("given", GIVEN)
def test_redundancy_sums_to_n_less_t(method, radius, given):
    points = outwards(cloud(N), 3, 0.02)
    found = reliability(
        analysis.fit_sphere(points, method, radius=radius, **GIVEN[given]), points, **GIVEN[given]
    )
    assert found.redundancy.sum() == pytest.approx(N - (4 if radius is None else 3), abs=1e-9)
    assert np.all((found.redundancy > 0) & (found.redundancy <= 1))
    if radius is not None:
        np.testing.assert_array_equal(found.external[:, 3], 0.0)


@pytest.mark.parametrize("method", ["geometric", "robust"])
def test_dense_algebra(method):
    """Residuals ``(I − J N⁻¹ Jᵀ W) d`` of errors with covariance σ² diag(v), as matrices."""
    points, variances = outwards(cloud(N), 3, 0.02), GIVEN["variances"]["cofactors"]
    fit = analysis.fit_sphere(
        points,
        method,
        cofactors=variances,
        **({"k0": 1.0, "k1": 4.0} if method == "robust" else {}),
    )
    found = reliability(fit, points, cofactors=variances)
    D = points - fit.center
    J = np.column_stack([-D / np.linalg.norm(D, axis=1)[:, None], -np.ones(N)])
    W = np.diag(fit.weights / variances)
    estimator = np.linalg.solve(J.T @ W @ J, J.T @ W)
    R = np.eye(N) - J @ estimator
    residual_variance = fit.sigma_0**2 * np.diagonal(R @ np.diag(variances) @ R.T)
    np.testing.assert_allclose(found.redundancy, np.diagonal(R), rtol=1e-9)
    np.testing.assert_allclose(
        found.standardised, R @ fit.distances / np.sqrt(residual_variance), rtol=1e-8, atol=1e-9
    )
    np.testing.assert_allclose(
        found.minimal_bias, noncentrality() * np.sqrt(residual_variance) / np.diagonal(R), rtol=1e-8
    )
    np.testing.assert_allclose(
        found.external, -(estimator * found.minimal_bias).T, rtol=1e-7, atol=1e-12
    )
    if method == "geometric":  # Baarda's formulas
        np.testing.assert_allclose(
            found.minimal_bias,
            4.132 * fit.sigma_0 * np.sqrt(variances / found.redundancy),
            rtol=1e-4,
        )


@pytest.mark.parametrize("row", [0, 7, 23])
def test_a_minimal_bias_does_what_is_said_of_it(row):
    """Put into exact points.

    The standardised residual becomes δ0, and the parameters move by the external reliability.
    """
    points = cloud(N, sigma=0.0)
    said = reliability(geometric(points), points, sigma=SIGMA)
    spoilt = outwards(points, row, said.minimal_bias[row])
    fit = geometric(spoilt)
    found = reliability(fit, spoilt, sigma=SIGMA)
    assert found.standardised[row] == pytest.approx(noncentrality(), rel=0.01)
    assert np.argmax(np.abs(found.standardised)) == row
    np.testing.assert_allclose(
        fit.parameters - TRUTH,
        said.external[row],
        rtol=0,
        atol=0.02 * np.abs(said.external[row]).max(),
    )


@pytest.mark.parametrize("power", [0.5, 0.8, 0.95])
def test_a_minimal_bias_is_found_with_the_stated_power(power):
    """One error of that size in each of 3000 clouds, tested at 0.1 %."""
    points, row = cloud(3000, N, seed=3), 5
    minimal = reliability(geometric(points), points, sigma=SIGMA, power=power).minimal_bias[:, row]
    spoilt = outwards(points, row, minimal)
    tested = reliability(geometric(spoilt), spoilt, sigma=SIGMA)
    assert np.mean(tested.p_values[:, row] <= 0.001) == pytest.approx(
        power, abs=3 * np.sqrt(power * (1 - power) / 3000)
    )


@pytest.mark.parametrize("sigma", [None, SIGMA])
@pytest.mark.parametrize("n", [6, 10, N])
def test_good_points_fail_as_often_as_the_level_says(sigma, n):
    """Also where few points leave σ0 uncertain: Pope's τ knows."""
    points = cloud(4000, n, seed=4)
    p = reliability(geometric(points), points, sigma=sigma).p_values
    for level in (0.5, 0.05, 0.01):
        # Residuals of one cloud are correlated, so count clouds, not points, for the error of the
        # mean.
        shares = np.mean(p <= level, axis=1)
        assert shares.mean() == pytest.approx(level, abs=4 * shares.std() / np.sqrt(4000))


def test_absolute_cofactors_know_sigma():
    points, variances = cloud(N), np.full(N, SIGMA**2)
    plain = {"method": "geometric", "bias_correction": False}
    fit = analysis.fit_sphere(points, cofactors=variances, absolute=True, **plain)
    found, expected = (
        reliability(fit, points, cofactors=variances),
        reliability(analysis.fit_sphere(points, **plain), points, sigma=SIGMA),
    )
    for name in ("standardised", "p_values", "minimal_bias", "external"):
        np.testing.assert_allclose(
            getattr(found, name), getattr(expected, name), rtol=1e-7, atol=1e-12
        )


def test_a_rejected_point_is_tested_as_a_prediction():
    """It has no part in the fit.

    Redundancy 1, no external effect, and a residual with the variance σ²(1 + g).
    """
    points = outwards(cloud(N), 3, 0.05)
    fit = analysis.fit_sphere(points)
    assert not fit.inliers[3]
    found = reliability(fit, points)
    assert found.redundancy[3] == 1
    np.testing.assert_array_equal(found.external[3], 0.0)
    assert 0.9 < found.standardised[3] / (fit.distances[3] / fit.sigma_0) < 1
    assert np.flatnonzero(found.suspects()).tolist() == [3]


def test_corrections_for_the_number_of_tests():
    """Without one, alpha·n good points fail; Bonferroni lets any fail in alpha of the clouds.

    With FDR alpha of the failed are good.
    """
    points = cloud(500, 100, seed=5)
    p = reliability(geometric(points), points, sigma=SIGMA)
    assert p.suspects(0.05, "none").sum(axis=1).mean() == pytest.approx(5.0, abs=0.3)
    three_sigma = 3 * np.sqrt(0.05 * 0.95 / 500)
    assert np.mean(p.suspects(0.05, "bonferroni").any(axis=1)) == pytest.approx(
        0.05, abs=three_sigma
    )
    spoilt = points.copy()
    for row in range(10):
        spoilt = outwards(spoilt, row, np.full(500, 0.010))
    fit = analysis.fit_sphere(spoilt)
    failed = reliability(fit, spoilt, sigma=SIGMA).suspects(0.05, "fdr")
    assert failed[:, :10].mean() > 0.95
    assert np.mean(failed[:, 10:].sum(axis=1) / np.maximum(failed.sum(axis=1), 1)) < 0.06


def test_false_discovery_rate_step_by_step():
    p = np.array([[0.04, 0.001, 0.03, 0.5], [0.06, 0.2, 0.3, 0.9]])
    empty = np.zeros_like(p)
    found = Reliability(empty, empty, p, empty, empty).suspects(0.05, "fdr")
    # Ordered .001 ≤ .0125, .03 > .025, .04 > .0375: the first alone. Nothing in the second row.
    np.testing.assert_array_equal(found, [[False, True, False, False], [False] * 4])


def test_a_stack_is_its_fits_one_by_one():
    points = cloud(2, 3, N, seed=6)
    fit = analysis.fit_sphere(points, weights=GIVEN["weights"]["weights"])
    together = reliability(fit, points, **GIVEN["weights"])
    assert together.external.shape == (2, 3, N, 4) and together.redundancy.shape == (2, 3, N)
    for index in np.ndindex(2, 3):
        apart = analysis.fit_sphere(points[index], **GIVEN["weights"])
        apart = reliability(apart, points[index], **GIVEN["weights"])
        for name in ("redundancy", "standardised", "p_values", "minimal_bias", "external"):
            np.testing.assert_allclose(
                getattr(together, name)[index], getattr(apart, name), rtol=1e-6, atol=1e-9
            )


def test_the_place_does_not_matter():
    points, shift = np.round(cloud(N), 6), np.array([5e5, 4e6, 100.0])
    near, far = (
        reliability(geometric(points), points),
        reliability(geometric(points + shift), points + shift),
    )
    np.testing.assert_allclose(far.standardised, near.standardised, rtol=0, atol=1e-4)
    np.testing.assert_allclose(far.minimal_bias, near.minimal_bias, rtol=1e-4)


def test_a_million_points():
    """A thousand errors of 10 σ among them are found, all tests together.

    In blocks, so that little memory is needed.
    """
    points = cloud(1_000_000, seed=7)
    for_all = np.zeros(1_000_000)
    for_all[:1000] = 10 * SIGMA
    D = points - TRUTH[:3]
    points += for_all[:, None] * D / np.linalg.norm(D, axis=1)[:, None]
    found = reliability(geometric(points), points)
    assert found.redundancy.sum() == pytest.approx(1_000_000 - 4, abs=1e-4)
    bonferroni, fdr = (found.suspects(0.05, correction) for correction in ("bonferroni", "fdr"))
    assert bonferroni[:1000].mean() > 0.99 and np.count_nonzero(bonferroni[1000:]) <= 3
    assert fdr[:1000].mean() > 0.999 and np.count_nonzero(fdr[1000:]) < 0.1 * 1000


# ------------------------------------------------------------------------------ one at a time


@pytest.mark.parametrize("sigma", [None, SIGMA])
@pytest.mark.parametrize("given", ["nothing", "variances", "covariances"])
def test_data_snooping_takes_the_errors_out_one_at_a_time(sigma, given):
    points = cloud(N)
    for row, by in ((3, 0.03), (11, -0.02), (30, 0.015)):
        points = outwards(points, row, by)
    fit, kept = data_snooping(points, geometric, sigma=sigma, **GIVEN[given])
    assert np.flatnonzero(~kept).tolist() == [3, 11, 30]
    np.testing.assert_allclose(fit.parameters, TRUTH, rtol=0, atol=0.005)


def test_data_snooping_leaves_good_points_alone():
    kept = [data_snooping(points, geometric, sigma=SIGMA)[1] for points in cloud(50, N, seed=8)]
    assert np.count_nonzero(~np.array(kept)) <= 8  # of 2000, at 0.1 %


def test_data_snooping_stops_in_time():
    fit, kept = data_snooping(cloud(6, sigma=0.1), geometric, sigma=1e-6)
    assert kept.sum() == 5 and np.isfinite(fit.parameters).all()


# ------------------------------------------------------------------------------ what is refused


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"alpha0": 0.0}, "alpha0: expected"),
        ({"alpha0": 1.0}, "alpha0: expected a probability between 0 and 1, got 1.0"),
        ({"power": 1.5}, "power: expected a probability between 0 and 1, got 1.5"),
        ({"sigma": -1.0}, "sigma: expected a positive finite number, got -1.0"),
        ({"weights": np.ones(3)}, r"weights: expected shape \(40,\)"),
        ({"cofactors": np.zeros(N)}, "cofactors: expected positive numbers"),
        ({"cofactors": np.zeros((N, 3, 3))}, "cofactors: expected positive definite matrices"),
    ],
)
def test_bad_options_are_refused(options, message):
    points = cloud(N)
    with pytest.raises(ValueError, match=message):
        reliability(geometric(points), points, **options)


def test_points_of_another_fit_are_refused():
    with pytest.raises(
        ValueError, match=r"points: expected at least 40 points for this fit, got 30"
    ):
        reliability(geometric(cloud(N)), cloud(30))
    with pytest.raises(
        ValueError, match=r"points: expected those of the fit, of shape \(40, 3\), got \(50, 3\)"
    ):
        reliability(geometric(cloud(N)), cloud(50))


@pytest.mark.parametrize("method", ["ls", "wtls", "igg3_wtls"])
def test_a_method_with_other_residuals_is_refused(method):
    points = cloud(N)
    with pytest.raises(
        ValueError,
        match=f"method of the fit: expected one of eiv, geometric, robust; got '{method}'",
    ):
        reliability(analysis.fit_sphere(points, method), points)


@pytest.mark.parametrize(
    ("alpha", "correction", "message"),
    [(2.0, "fdr", "alpha: expected a probability"), (0.05, "holm", ", ".join(CORRECTIONS))],
)
def test_bad_corrections_are_refused(alpha, correction, message):
    points = cloud(N)
    with pytest.raises(ValueError, match=message):
        reliability(geometric(points), points).suspects(alpha, correction)


def test_noncentrality_is_computed():
    assert noncentrality() == pytest.approx(4.13, abs=0.005)
    assert noncentrality(0.05, 0.5) == pytest.approx(norm.isf(0.025))
