"""The robust fit of few points: as exact as least squares, and still robust."""

import numpy as np
import pytest
from scipy.stats import norm
from scipy.stats import t as student

import analysis
from analysis.adjustment.weights import WEIGHT_FUNCTIONS
from analysis.orthogonal import few_points
from analysis.orthogonal.robust import FEW

SD = 0.001


def spheres(rng, count, n):
    u = rng.standard_normal((count, n, 3))
    u /= np.linalg.norm(u, axis=-1, keepdims=True)
    u[..., 0] = -np.abs(u[..., 0])
    return [5, 2, 1] + 0.1 * u + SD * rng.standard_normal(u.shape)


def planes(rng, count, n):
    p = rng.uniform(-1, 1, (count, n, 3))
    p[..., 2] = 0.3 * p[..., 0] - 0.2 * p[..., 1] + 5 + SD * rng.standard_normal((count, n))
    return p


def ellipses(rng, count, n):
    turn = (np.arange(n) + rng.uniform(0, 1, (count, n))) * 2 * np.pi / n
    p = np.stack([0.2 * np.cos(turn), 0.12 * np.sin(turn)], axis=-1)
    return [1, 2] + p + SD * rng.standard_normal(p.shape)


CASES = {
    "sphere": (spheres, analysis.fit_sphere, [5, 2, 1, 0.1]),
    "plane": (planes, analysis.fit_plane, [0.3, -0.2, 5]),
    "ellipse": (ellipses, analysis.fit_ellipse, [1, 2, 0.2, 0.12, 0]),
}


@pytest.mark.parametrize("surface", CASES)
@pytest.mark.parametrize("extra", [3, 4, 6, 10, 25])
def test_the_95_percent_intervals_hold_the_truth(surface, extra):
    """And robust is as exact as least squares, with no gross errors in 2 000 clouds."""
    make, fit, truth = CASES[surface]
    t = len(truth)
    points = make(np.random.default_rng(extra), 2000, t + extra)
    robust, least_squares = fit(points), fit(points, "geometric")
    error = robust.parameters - truth
    if surface == "ellipse":
        error[:, 4] = (error[:, 4] + np.pi / 2) % np.pi - np.pi / 2
    redundancy = robust.weights.sum(axis=-1) - t
    limit = student.ppf(0.975, redundancy)[:, None]
    coverage = np.mean(np.abs(error) < limit * robust.standard_deviations)
    assert 0.93 < coverage < 0.965  # MC error 0.005
    spread = [
        np.quantile(np.abs(one.parameters[:, :3] - truth[:3]), 0.9, axis=0)
        for one in (robust, least_squares)
    ]
    assert np.mean(spread[0] / spread[1]) < 1.05


@pytest.mark.parametrize("surface", CASES)
def test_without_redundancy_to_judge_by_it_is_the_orthogonal_fit(surface):
    make, fit, truth = CASES[surface]
    points = make(np.random.default_rng(1), 50, len(truth) + few_points.FEWEST - 1)
    robust, least_squares = fit(points), fit(points, "geometric")
    np.testing.assert_array_equal(robust.weights, 1.0)
    np.testing.assert_allclose(robust.parameters, least_squares.parameters, rtol=1e-12)
    np.testing.assert_allclose(robust.covariance, least_squares.covariance, rtol=1e-9)


@pytest.mark.parametrize("surface", CASES)
def test_one_gross_error_among_ten_points_is_found(surface):
    make, fit, truth = CASES[surface]
    points = make(np.random.default_rng(2), 300, 10)
    off = points[:, 0] - truth[: points.shape[-1]] if surface != "plane" else np.array([0, 0, 1.0])
    points[:, 0] += 0.05 * off / np.linalg.norm(off, axis=-1, keepdims=True)
    found = fit(points)
    assert np.mean(found.weights[:, 0] < 0.5) > 0.97
    assert np.mean((found.weights[:, 1:] > 0).all(axis=-1)) > 0.9
    spread = np.quantile(np.abs(found.parameters - truth)[:, :3], 0.9, axis=0)
    good = np.quantile(np.abs(fit(points[:, 1:]).parameters - truth)[:, :3], 0.9, axis=0)
    assert np.all(spread < 1.3 * good)


def test_both_rules_meet():
    """At the redundancy where the rule for many points begins, the two agree."""
    points = spheres(np.random.default_rng(3), 200, FEW + 4)
    few = analysis.fit_sphere(points)
    more = analysis.fit_sphere(np.concatenate([points, points[:, :1]], axis=1))
    np.testing.assert_allclose(np.mean(few.sigma_0), np.mean(more.sigma_0), rtol=0.02)
    np.testing.assert_allclose(
        np.mean(few.weights < 1), np.mean(more.weights[:, :-1] < 1), atol=0.01
    )


def test_thresholds_are_those_of_student():
    for free in (1.5, 3.0, 7.25, 40.0):
        quantile = student.ppf(norm.cdf(2.5), free)
        np.testing.assert_allclose(1 / few_points._reciprocal(free, 2.5), quantile, rtol=2e-3)
    assert few_points._reciprocal(0.9, 2.5) == 0.0
    assert few_points.strict_level(10) == pytest.approx(2.5)
    assert few_points.strict_level(3) > few_points.strict_level(9) > 2.5


def test_means_tend_to_those_of_the_normal_law():
    for function in WEIGHT_FUNCTIONS.values():
        grid, means, squares = few_points._means(function, 2.5)
        assert grid[0] == 0.0
        np.testing.assert_allclose(means[:2], function.mean_weight, atol=0.01)
        np.testing.assert_allclose(squares[:2], function.mean_psi_prime, atol=0.02)


@pytest.mark.parametrize("name", WEIGHT_FUNCTIONS)
def test_the_slope_is_the_derivative_of_the_weight(name):
    function = WEIGHT_FUNCTIONS[name]
    u = np.linspace(0.05, 9.0, 500)
    u = u[np.min([np.abs(u - kink) for kink in function.kinks], axis=0) > 1e-3]
    h = 1e-6
    slope = u * (function.weight(u + h) - function.weight(u - h)) / (2 * h)
    np.testing.assert_allclose(function.weight_slope(u), slope, atol=1e-7)
