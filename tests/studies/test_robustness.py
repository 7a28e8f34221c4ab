"""The Monte Carlo studies of notebook 06: clouds are as they are said to be, tables count right."""

import numpy as np
import pandas as pd
import pytest

from analysis import fit_sphere
from analysis.scanner import LEICA_C10
from studies.ou_liu_2017.clouds import SPHERE_CENTER, SPHERE_RADIUS, sphere_redraws
from studies.robustness import bias, breakdown, collapse, coverage, efficiency, number_of_points
from studies.robustness.redraws import RADIUS, TARGET, cap_normals, share_interval, stacked

CLEAN = sphere_redraws(20)


# --------------------------------------------------------------------------- what the studies share


@pytest.mark.parametrize("half_angle", [30, 90, 180])
def test_points_are_spread_evenly_over_the_cap_that_faces_the_scanner(half_angle):
    (uniform,) = stacked(lambda generator: (generator.uniform(size=(1000, 2)),), 10, seed=3)
    normals = cap_normals(uniform, half_angle)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=-1), 1, rtol=1e-14)
    towards_scanner = -normals[..., 0]
    limit = np.cos(np.radians(half_angle))
    assert towards_scanner.min() >= limit - 1e-12
    # Of an even spread, each slice across the line of sight has its share by height (Archimedes).
    counts, _ = np.histogram(towards_scanner, bins=5, range=(limit, 1))
    assert np.all(np.abs(counts - 2000) < 4 * np.sqrt(2000))


def test_trials_stay_the_same_when_their_number_grows():
    few, _ = coverage.clouds(3, 20, 7, 80, 0.2, LEICA_C10)
    many, _ = coverage.clouds(5, 20, 7, 80, 0.2, LEICA_C10)
    np.testing.assert_array_equal(many[:3], few)
    np.testing.assert_array_equal(efficiency.clouds(4, seed=2)[:2], efficiency.clouds(2, seed=2))
    moved = breakdown.replaced(CLEAN, "uniform", 50, seed=2)
    np.testing.assert_array_equal(moved[:4], breakdown.replaced(CLEAN[:4], "uniform", 50, seed=2))


def test_share_interval_is_wilsons():
    low, high = share_interval(np.array([0, 50, 100]), 100)
    np.testing.assert_allclose(
        low, [0, 40.38, 96.30], atol=0.01
    )  # Agresti & Coull 1998, table of the score interval
    np.testing.assert_allclose(high, [3.70, 59.62, 100], atol=0.01)


# --------------------------------------------------------------------------------------------- bias


@pytest.fixture(scope="module")
def biases():
    table = bias.study([(80, 0.002), (80, 0.005), (180, 0.002)], draws=200, n=60, seed=1)
    return table.set_index(["half_angle_deg", "sigma_mm", "variant"])


def test_bias_of_the_known_methods(biases):
    for sigma, of_ls in ((2, -0.57), (5, -3.34)):
        here = biases.loc[80, sigma]
        assert here.loc["ls", "along_mm"] == pytest.approx(
            of_ls, abs=4 * here.loc["ls", "along_se_mm"]
        )
        assert (
            abs(here.loc["robust", "along_mm"])
            < 4 * here.loc["robust", "along_se_mm"] + 0.03 * sigma
        )
    whole = biases.loc[180, 2]
    # σ²/r, and of a finite number of points a few percent of it more.
    of_plain = 1e3 * 0.002**2 / RADIUS
    assert whole.loc["geometric", "radius_mm"] == pytest.approx(of_plain, rel=0.1)
    for variant in (bias.CORRECTED, "robust"):
        assert abs(whole.loc[variant, "radius_mm"]) < 0.1 * of_plain


def test_every_variant_in_every_setting_in_order(biases):
    assert [variant for _, _, variant in biases.index] == 3 * list(bias.ORDER)


def test_centroid_variant_is_the_printed_wtls_of_shifted_points():
    table = bias.study([(80, 0.002)], draws=2, n=60, seed=4).set_index("variant")
    uniform, normal = stacked(
        lambda generator: (generator.uniform(size=(60, 2)), generator.standard_normal((60, 3))),
        2,
        4,
    )
    errors = []
    for sign in (1, -1):
        points = TARGET[:3] + RADIUS * cap_normals(uniform, 80) + sign * 0.002 * normal
        centroids = points.mean(axis=1)
        fit = fit_sphere(points - centroids[:, None], "wtls")
        errors.append(fit.center[:, 0] + centroids[:, 0] - TARGET[0])
    assert table.loc[bias.CENTROID, "along_mm"] == pytest.approx(1e3 * np.mean(errors), abs=1e-9)


def test_fits_without_a_sphere_are_counted_and_left_out():
    table = bias.study([(20, 0.005)], draws=30, n=10, seed=1).set_index("variant")
    assert table.loc[bias.CENTROID, "failed"] > 0
    assert table.loc["ls", "failed"] == 0 and np.isfinite(table.loc["ls", "along_mm"])


# --------------------------------------------------------------------------------------- efficiency


def test_efficiency_against_the_theory_of_the_weight_function():
    table = efficiency.study(300, seed=1).set_index("variant")
    assert list(table.index) == list(efficiency.VARIANTS)
    assert (
        table.loc["geometric", "efficiency_percent"] == 100
        and table.loc["geometric", "efficiency_se_percent"] == 0
    )
    assert table.loc["robust, k0 = 1.5, k1 = 2.5", "theory_percent"] == pytest.approx(
        76.6, abs=0.05
    )
    assert np.isnan(table.loc["igg3_wtls", "theory_percent"])  # cumulative: there is no theory
    for variant in (
        "ls",
        "eiv",
        "robust",
        "robust, k0 = 1.5, k1 = 2.5",
        "robust, k0 = 2.5, k1 = 5",
    ):
        row = table.loc[variant]
        assert (
            abs(row["efficiency_percent"] - row["theory_percent"])
            < 4 * row["efficiency_se_percent"] + 0.5
        )
    np.testing.assert_allclose(table["sd_ratio"] ** -2, table["efficiency_percent"] / 100)


def test_noise_of_the_efficiency_study_is_normal_and_as_large_as_rounding():
    distances = (
        np.linalg.norm(efficiency.clouds(40, seed=3) - SPHERE_CENTER, axis=-1) - SPHERE_RADIUS
    )
    assert np.std(distances) == pytest.approx(0.01 / np.sqrt(12), rel=0.02)


# ---------------------------------------------------------------------------------------- breakdown


@pytest.mark.parametrize("pattern", breakdown.PATTERNS)
def test_gross_errors_are_as_many_and_where_they_should_be(pattern):
    count = 200
    moved = breakdown.replaced(CLEAN, pattern, count, seed=1)
    gross = np.any(moved != CLEAN, axis=-1)
    assert np.all(gross.sum(axis=1) == count)
    distances = np.linalg.norm(moved - SPHERE_CENTER, axis=-1)[gross] - SPHERE_RADIUS
    if pattern == "uniform":
        low, high = np.array([0, 0, 1.0]), np.array([20, 20, 1 + SPHERE_RADIUS])
        assert np.all((moved[gross] >= low) & (moved[gross] <= high))
        np.testing.assert_allclose(moved[gross].mean(axis=0), (low + high) / 2, atol=0.5)
    else:
        assert np.all((distances > -3.01) & (distances < -0.99))


def test_clustered_gross_errors_are_neighbours():
    gross = np.any(breakdown.replaced(CLEAN, "clustered", 50, seed=1) != CLEAN, axis=-1)
    for points, bad in zip(CLEAN, gross, strict=True):
        # About one of them all the others of them are nearer than any other point.
        separations = np.linalg.norm(points[bad][:, None] - points[None], axis=-1)
        assert np.any(separations[:, bad].max(axis=1) <= separations[:, ~bad].min(axis=1))


def test_breakdown_shares_are_counted_right():
    table = breakdown.study([0, 0.45], 20, 500, seed=1, patterns=["clustered", "uniform"])
    table = table.set_index(["pattern", "gross_percent", "variant"])
    pd.testing.assert_frame_equal(
        table.loc["clustered", 0], table.loc["uniform", 0]
    )  # clean clouds have no pattern
    assert table.loc[("clustered", 45, "robust"), "within_percent"] == 100
    assert table.loc[("clustered", 45, breakdown.GOOD_POINTS), "within_percent"] == 100
    assert table.loc[("clustered", 45, "ls"), "within_percent"] == 0
    fit = fit_sphere(breakdown.replaced(CLEAN, "uniform", 225, seed=1), "geometric")
    errors = np.linalg.norm(fit.center - SPHERE_CENTER, axis=1)
    assert table.loc[("uniform", 45, "geometric"), "median_error_mm"] == pytest.approx(
        1e3 * np.median(errors)
    )


# ----------------------------------------------------------------------------------------- coverage


@pytest.mark.parametrize("noise", [0.002, LEICA_C10])
def test_noise_of_the_coverage_study_has_the_cofactors_given(noise):
    points, cofactors = coverage.clouds(50, 100, 1, 80, 0, noise)
    exact, _ = coverage.clouds(50, 100, 1, 80, 0, 1e-12)
    errors = points - exact
    Q = 0.002**2 * np.eye(3) if cofactors is None else cofactors
    squares = np.einsum("bni,bni->bn", errors, np.linalg.solve(Q, errors[..., None])[..., 0])
    assert squares.mean() == pytest.approx(
        3, abs=4 * np.sqrt(6 / squares.size)
    )  # χ² with 3 degrees of freedom


def test_gross_errors_of_the_coverage_study_lie_inside():
    points, _ = coverage.clouds(10, 100, 1, 80, 0.2, 1e-9)
    distances = np.linalg.norm(points - TARGET[:3], axis=-1) - RADIUS
    assert np.all((distances[:, :20] < -0.0099) & (distances[:, :20] > -0.0401)) and np.all(
        np.abs(distances[:, 20:]) < 1e-7
    )


def test_coverage_is_counted_right():
    table = coverage.study(
        60, 50, 3, 80, [0, 0.2], {"isotropic": 0.002, "scanner": LEICA_C10}, ["ls", "robust"]
    )
    assert table[["noise", "gross_percent", "method"]].drop_duplicates().shape[0] == 8
    robust = table[table["method"] == "robust"]
    assert (robust["held_percent"] > 85).all() and (table["failed"] == 0).all()
    assert (
        table[(table["method"] == "ls") & (table["gross_percent"] == 20)]["held_percent"] < 5
    ).all()


def test_the_ellipsoid_is_that_of_fisher():
    """With the truth on its rim the ellipsoid just holds it: a known fit, moved by hand."""
    points, _ = coverage.clouds(1, 100, 1, 80, 0, 0.001)
    fit = fit_sphere(points, "geometric")
    limit = 4 * 2.466476  # F 0.95 with 4 and 96 degrees of freedom
    axis = np.linalg.cholesky(fit.covariance[0])[:, 0]
    for factor, held in ((0.999, True), (1.001, False)):
        shift = TARGET + factor * np.sqrt(limit) * axis - fit.parameters[0]
        moved = fit.__class__(**{**fit.__dict__, "parameters": fit.parameters + shift})
        assert coverage._calibration(moved)["held"][0] == held


def test_what_failed_holds_nothing():
    points, _ = coverage.clouds(2, 50, 1, 80, 0, 0.001)
    fit = fit_sphere(points, "geometric")
    failed = fit.__class__(**{**fit.__dict__, "converged": np.array([True, False])})
    result = coverage._calibration(failed)
    assert (
        result["failed"].tolist() == [False, True]
        and not result["held"][1]
        and np.isnan(result["error_mm"][1])
    )


# ----------------------------------------------------------------------------------------- collapse


def test_weighted_cumulative_scale_collapses_and_others_do_not():
    ends = collapse.redraws(20)
    left = ends.groupby("variant", sort=False)["left"]
    assert list(left.groups) == list(collapse.VARIANTS)
    assert left.max()["weighted, cumulative"] < 60
    assert (
        left.min()["rms, cumulative"] > 450
        and left.min()["weighted consistent, not cumulative"] > 480
    )
    summary = collapse.summary(ends).set_index("variant")
    assert (
        summary.loc["weighted, cumulative", "left_median"] == left.median()["weighted, cumulative"]
    )
    assert summary.loc["weighted, cumulative", "sigma_0_mm"] < 0.05
    assert (
        summary.loc["weighted, cumulative", "claims_convergence_percent"] == 100
    )  # it does not notice


def test_history_is_that_of_the_fit():
    options = collapse.VARIANTS["weighted, cumulative"]
    table = collapse.history(CLEAN[0], {"w": options})
    steps = fit_sphere(CLEAN[0], "igg3_wtls", **options, history=True).history
    assert table["iteration"].tolist() == list(range(1, len(steps) + 1))
    assert table["left"].iloc[-1] == np.count_nonzero(steps[-1].weights)
    np.testing.assert_allclose(table["sigma_mm"], [1e3 * step.scale for step in steps])
    assert table["sigma_mm"].iloc[-1] < 1e-2 * table["sigma_mm"].iloc[0]


# ------------------------------------------------------------------------------ number of points


def test_coverage_against_points_of_few_and_of_many():
    """Both methods hold the truth of few points; of many only the one without bias."""
    table = number_of_points.study([4, 7, 4000], 400, 1_000_000, 0.002, 3)
    assert list(table.loc[table["points"] == 4, "surface"].unique()) == ["plane"]
    held = table.set_index(["surface", "points", "method"])["held_percent"]
    few = held[held.index.get_level_values("points") == 7]
    assert few.between(90, 99).all()
    assert held["sphere", 4000, "robust"] > 90
    assert held["sphere", 4000, "geometric"] < 85
