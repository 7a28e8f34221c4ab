"""The studies of the plane paper: its simulation recovered, its σ0 explained, its scan placed, its
algorithms compared.
"""

from dataclasses import replace

import numpy as np
import pytest

from analysis import fit_plane
from analysis.scanner import LEICA_C10
from analysis.surfaces.plane_eiv import incidence_cosines
from studies import convergence
from studies.simulation.scenes import redraw
from studies.wu_chen_wang import clouds, errors, ground_scan, recovery, simulation
from studies.wu_chen_wang.clouds import PLANE, PLANE_SIDE, PLANE_SIGMA

SCANNER = replace(LEICA_C10, max_incidence=np.deg2rad(89.0))
SCENE = {"height": 1.17, "near": 16.0, "far": 27.0, "width": 0.04, "step": 0.002}


@pytest.fixture(scope="module")
def trials():
    """600 runs at the recovered setting: points (600, 100, 3) and cosines (600, 100)."""
    return clouds.plane_clouds(clouds.plane_draws(600))


@pytest.fixture(scope="module")
def fits(trials):
    return {variant: simulation.fitted(*trials, variant) for variant in simulation.VARIANTS}


@pytest.fixture(scope="module")
def history():
    return convergence.study()


# ------------------------------------------------------------------------------------- the five
# numbers


def test_the_five_numbers_are_those_of_the_definitions(trials, fits):
    points, _ = trials
    runs = simulation.consecutive(len(points))
    found = simulation.five(fits, runs)
    assert found.shape == (60, 5)
    x, y, z = np.moveaxis(points[:10], -1, 0)
    a, b, c = fits["ls"].parameters[:10].T
    v = z - (a[:, None] * x + b[:, None] * y + c[:, None])
    sigma_s = np.sqrt(np.mean(v**2, axis=1) / (1 + a * a + b * b))
    assert found[0, 0] == pytest.approx(100 * sigma_s.mean(), rel=1e-9)
    sigma_0 = np.sqrt(np.sum(v**2, axis=1) / 97).mean()
    assert found[0, 3] == pytest.approx(
        100 * (1 - fits["wtls"].sigma_0[:10].mean() / sigma_0), rel=1e-9
    )


def test_wtls_is_weighted_principal_components_of_its_own_weights(trials, fits):
    points, cosines = trials
    x = fits["wtls, LS plane"].parameters[:50]
    weights = incidence_cosines(points[:50], fits["ls"].parameters[:50])
    for p, w, found in zip(points[:50], weights, x, strict=True):
        mean = w @ p / w.sum()
        n = np.linalg.eigh((p - mean).T @ ((p - mean) * w[:, None]))[1][:, 0]
        np.testing.assert_allclose(found, [-n[0] / n[2], -n[1] / n[2], n @ mean / n[2]], rtol=1e-8)


def test_the_quasi_newton_method_finds_the_plane_of_newtons(fits):
    own = clouds.read_plane_runs()
    found = fit_plane(own, "wtls", algorithm="bfgs").parameters
    np.testing.assert_allclose(found, fits["wtls"].parameters[:10], atol=1e-9)


def test_the_recovered_setting_prints_all_five(fits):
    comparison = simulation.against_print(
        simulation.five(fits, simulation.consecutive(600)), np.zeros(5)
    )
    assert comparison["inside"].all()
    assert comparison["percentile"].between(5, 95).all()
    assert comparison["median"].to_numpy() == pytest.approx([5.9, 4.75, 4.8, 83, 53.1], rel=0.02)


def test_a_number_is_inside_as_far_as_its_digits_tell():
    experiments = np.tile(np.linspace(0, 1, 401)[:, None], (1, 5)) * 0.1 + [
        5.94,
        4.86,
        4.5,
        83.4,
        60.0,
    ]
    inside = simulation.against_print(experiments, np.zeros(5))["inside"]
    assert inside.tolist() == [True, False, False, True, False]


# --------------------------------------------------------------------------------------------
# recovery


@pytest.fixture(scope="module")
def nodes():
    sides, sigmas = np.geomspace(0.14, 0.36, 4), np.geomspace(0.017, 0.029, 4)
    return recovery.search(
        sides, sigmas, 60, recovery.RECOVERED, [recovery.LITERAL, "pure TLS; cosines raw, LS plane"]
    )


def test_the_search_finds_the_setting(nodes):
    found = recovery.summary(nodes[recovery.LITERAL].compared(12))
    assert found["most_inside"] == 5
    assert found["least_chi_square"] < recovery.LIMIT
    assert found["side_from_m"] < PLANE_SIDE < found["side_to_m"]
    assert found["sigma_from_cm"] < 100 * PLANE_SIGMA < found["sigma_to_cm"]
    assert found["side_to_m"] < 0.3 and found["sigma_to_cm"] < 2.5


def test_weights_of_the_ls_plane_do_not_print_the_numbers(nodes):
    found = recovery.summary(nodes["pure TLS; cosines raw, LS plane"].compared(4))
    assert found["most_inside"] < 5 and np.isnan(found["side_from_m"])
    assert found["least_chi_square"] > 10 * recovery.LIMIT


def test_points_about_the_origin_do_not_print_the_numbers():
    nodes = recovery.search(
        np.geomspace(0.14, 0.36, 4), np.geomspace(0.017, 0.029, 4), 40, "square about the origin"
    )
    assert recovery.summary(nodes[recovery.LITERAL].compared(4))["most_inside"] < 5


def test_nodes_are_met_and_smooth_statistics_interpolated():
    sides, sigmas = np.geomspace(0.1, 0.4, 5), np.geomspace(0.01, 0.04, 5)
    generator = np.random.default_rng(0)
    scatter = generator.standard_normal((200, 5))
    scale = (sides[:, None] ** -1 * sigmas)[..., None, None]
    compared = recovery.Nodes.of(sides, sigmas, scale * (1 + 0.1 * scatter)).compared(2)
    truth = compared["sigma_m"] / compared["side_m"]
    lower = np.quantile(1 + 0.1 * scatter[:, 0], 0.025)
    np.testing.assert_allclose(compared["sigma_s_ls_cm_lower"], truth * lower, rtol=5e-3)
    on_nodes = np.isclose(compared["side_m"], sides[2]) & np.isclose(compared["sigma_m"], sigmas[1])
    np.testing.assert_allclose(
        compared["sigma_s_ls_cm_lower"][on_nodes], sigmas[1] / sides[2] * lower, rtol=1e-9
    )


# ----------------------------------------------------------------------------------------------
# errors


def test_attenuation_and_biases(fits):
    table = errors.errors(fits).set_index("variant")
    assert table.loc["ls", ["bias_a", "bias_b", "bias_c"]].tolist() == pytest.approx(
        [-0.42, -1.23, 0.16], abs=0.03
    )
    assert table.loc["wtls", "bias_b"] > 0.05 > abs(table.loc["wtls, projected", "bias_b"])
    # Projected cosines are as good as the true ones.
    medians = table[["median_a", "median_b", "median_c"]]
    np.testing.assert_allclose(medians.loc["wtls, projected"], medians.loc["wtls, true"], rtol=0.05)
    inside = (table["low_b"] < table["bias_b"]) & (table["bias_b"] < table["high_b"])
    assert inside.all()


def test_exact_points_have_no_errors():
    points, cosines = clouds.plane_clouds(clouds.plane_draws(3), sigma=1e-12)
    table = errors.errors(
        {
            name: simulation.fitted(points, cosines, name)
            for name in ("ls", "mixed_ls_tls", "wtls, true")
        }
    )
    # the points are rounded to 1 µm
    assert table.drop(columns="variant").abs().to_numpy().max() < 1e-4


def test_perfect_sigma_0_is_what_residuals_of_the_true_plane_give(trials):
    points, cosines = trials
    v = points[..., 2] - points[..., :2] @ PLANE[:2] - PLANE[2]
    a, b, c = PLANE
    perfect = errors.perfect_sigma_0(cosines)
    assert np.sqrt(np.mean(v**2)) == pytest.approx(perfect["ls"], rel=0.01)
    assert np.sqrt(np.mean(v**2) / (1 + a * a + b * b + c * c)) == pytest.approx(
        perfect["tls"], rel=0.01
    )
    assert np.sqrt(np.mean(v**2) / (1 + a * a + b * b)) == pytest.approx(
        perfect["mixed_ls_tls"], rel=0.01
    )
    assert np.sqrt(np.mean(cosines * v**2) / (1 + a * a + b * b)) == pytest.approx(
        perfect["wtls"], rel=0.01
    )


def test_the_percentages_are_a_change_of_unit(trials, fits):
    meanings = errors.meanings(fits, trials[1]).set_index("method")
    difference = meanings["gain_true_plane_percent"] - meanings["gain_found_percent"]
    assert difference.abs().max() < 4
    assert meanings["gain_found_percent"]["LS"] > 80
    assert meanings["sigma_s_cm"]["mixed LS-TLS"] == meanings["sigma_s_cm"].min()


def test_order_of_closeness(fits):
    table = errors.closest(fits).set_index("parameter")
    assert (table["as_printed_percent"] <= table["first_of_two_percent"]).all()
    assert table.loc["all", "as_printed_percent"] > 50
    reverse = errors.closest(fits, ("tls", "wtls", "ls")).set_index("parameter")
    np.testing.assert_allclose(table["first_of_two_percent"] + reverse["first_of_two_percent"], 100)


def test_upright_clouds_are_seen():
    points, _ = clouds.plane_clouds(clouds.plane_draws(2))
    upright = points[:1].copy()
    upright[..., 0] = 1e-3 * upright[..., 0]  # on x = 0
    assert simulation.not_upright(np.concatenate([points, upright])).tolist() == [True, True, False]


# ------------------------------------------------------------------------------------------ ground
# scan


def test_printed_gains_follow_from_the_implied_place():
    implied = ground_scan.implied().set_index(["reading", "quantity"])
    level = implied.loc["level ground, TLS by pure SVD"]
    height, angle = (
        level.loc["height of the scanner", "value"],
        np.radians(level.loc["incidence angle", "value"]),
    )
    assert 1 - np.sqrt(np.cos(angle)) == pytest.approx(0.76)
    assert 1 - np.sqrt(np.cos(angle)) * np.sqrt(1 + height**2) == pytest.approx(0.63)
    assert level.loc["range", "value"] == pytest.approx(height / np.cos(angle))
    slope, angle = np.radians(implied.loc["mixed LS-TLS", "value"])
    assert 1 - np.sqrt(np.cos(angle)) == pytest.approx(0.63)
    assert 1 - np.sqrt(np.cos(angle)) * np.cos(slope) == pytest.approx(0.76)
    assert (implied["lower"] < implied["value"]).all() and (
        implied["value"] < implied["upper"]
    ).all()


def test_the_clean_scan_is_the_ground_and_prints_the_gains():
    scan = ground_scan.ground_scan(np.random.default_rng(1), SCANNER, **SCENE, clutter=False)
    assert scan.on("ground").all()
    a, b, c = ground_scan.truth(SCENE["height"])
    x, y, z = scan.true_points.T
    np.testing.assert_allclose(z, a * x + b * y + c, atol=1e-9)
    assert y.min() == pytest.approx(SCENE["near"], rel=0.02) and y.max() == pytest.approx(
        SCENE["far"], rel=0.1
    )
    fits = ground_scan.fitted(redraw(scan, 40, 1), SCANNER, ("ls", "tls", "wtls"))
    comparison = ground_scan.against_print(fits)
    np.testing.assert_allclose(comparison["median"][:2], comparison["printed"][:2], atol=1.5)


def test_all_methods_find_a_clean_ground_and_only_robust_a_cluttered_one():
    found = {}
    for clutter in (False, True):
        scan = ground_scan.ground_scan(np.random.default_rng(1), SCANNER, **SCENE, clutter=clutter)
        fits = ground_scan.fitted(redraw(scan, 60, 2), SCANNER)
        found[clutter] = ground_scan.accuracy(
            fits, ground_scan.truth(SCENE["height"]), np.array([0.0, 20.0])
        ).set_index("method")
    clean, cluttered = found[False], found[True]
    assert clean["height_mm"].max() < 1.1 * clean["height_mm"].min()
    np.testing.assert_allclose(clean["claimed_mm"], clean["height_mm"], rtol=0.35)
    assert clean["held_percent"].min() > 80
    robust = cluttered.index.str.startswith("robust")
    assert cluttered["height_mm"][~robust].min() > 20 * cluttered["height_mm"][robust].iloc[0]
    assert (
        cluttered["held_percent"][~robust].max() == 0
        and cluttered["held_percent"][robust].iloc[0] > 80
    )


# ------------------------------------------------------------------------------------------
# convergence


def test_all_algorithms_but_one_reach_the_minimum(history):
    last = history.groupby(["problem", "run"])["excess"].last()
    assert (last.drop(("plane", "schaffrin_wieser")) < 1e-11).all()
    assert last["plane", "schaffrin_wieser"] > 0.1
    saddle = convergence.solved(convergence.problems()["plane"], "schaffrin_wieser")
    assert not saddle.converged and "no minimum" in saddle.stop_reason


def test_all_start_from_least_squares(history):
    start = history[history["iteration"] == 0].groupby("problem")["excess"]
    assert (start.max() - start.min()).max() < 1e-12


def test_quasi_newton_never_climbs(history):
    rows = history[history["run"].str.startswith(("bfgs", "dfp"))]
    assert (rows.groupby(["problem", "run"])["excess"].diff().dropna() < 1e-11).all()


def test_counts_are_read_off_the_history(history):
    counts = convergence.counts(history).set_index("run")
    steps = history[(history["problem"] == "plane") & (history["run"] == "bfgs")].set_index(
        "iteration"
    )
    n = counts.loc["BFGS", "plane"]
    assert steps["excess"][n] < convergence.REACHED <= steps["excess"][n - 1]
    assert counts.loc["Newton", "plane"] < counts["plane"].drop("Newton").min()
    assert counts["plane"].isna().sum() == 1
    assert (counts["sphere_evaluations"] >= counts["sphere"]).all()


def test_arrivals_add_up_and_small_noise_leads_all_to_the_minimum():
    points, _ = clouds.plane_clouds(clouds.plane_draws(40), 2.0)
    table = convergence.arrivals(points)
    assert table["minimum_percent"].tolist() == [100.0] * len(convergence.RUNS)
    points, _ = clouds.plane_clouds(clouds.plane_draws(40))
    table = convergence.arrivals(points).set_index("run")
    np.testing.assert_allclose(table.sum(axis=1), 100)
    assert table.loc["Schaffrin-Wieser", "failed_percent"] > 0
    assert (table.drop("Schaffrin-Wieser")["minimum_percent"] == 100).all()
