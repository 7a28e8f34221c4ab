"""Table 3 by simulation, and the relations between its printed numbers."""

import numpy as np
import pytest

from analysis import fit_sphere
from studies.ou_liu_2017 import table3, table3_relations, table3_settings
from studies.ou_liu_2017.printed_tables import LABELS, values
from studies.ou_liu_2017.table3 import CLEANED, HELD, RAW, WITH_COFACTORS
from studies.ou_liu_2017.table3_relations import RADIUS, SAMPLES
from studies.simulation.scenes import redraw

ASSUMED = {"step": 0.003}
SEED, TRIALS = 1, 40


@pytest.fixture(scope="module")
def targets():
    return table3.scans(SEED, **ASSUMED)


@pytest.fixture(scope="module")
def study(targets):
    return table3.study(targets, TRIALS, SEED)


# ----------------------------------------------------------------- relations: each bound tried on
# points, not on print


def cloud(generator, n=40, noise=0.01):
    """Points near a sphere seen from one side, and some beside it."""
    directions = generator.standard_normal((n, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    directions[:, 1] = -np.abs(directions[:, 1])
    points = [0.0, 6.0, -1.6] + (RADIUS + noise * generator.standard_normal(n))[
        :, None
    ] * directions
    points[: n // 5, 1] += generator.uniform(0.0, 0.3, n // 5)
    return points


@pytest.mark.parametrize("seed", range(20))
def test_the_bounds_hold_for_any_points(seed):
    points = cloud(np.random.default_rng(seed))
    ls, igg = fit_sphere(points, "ls"), fit_sphere(points, "igg3_wtls")
    assert ls.sigma_0 > ls.radius * ls.sigma_s
    for other in (igg, fit_sphere(points, "robust")):
        apart = np.linalg.norm(ls.center - other.center)
        assert apart <= ls.radius + other.radius + ls.sigma_s + other.sigma_s
        farthest = max(other.distances.max(), 0.0)
        assert farthest >= ls.radius * ls.sigma_s / other.sigma_s - 2 * other.radius


def test_which_relations_hold():
    failed = [
        (r.relation.split(":")[0], r.sphere, r.methods)
        for r in table3_relations.every_relation()
        if not r.holds
    ]
    assert failed == [
        ("centres of LS and TLS", "I", "LS, TLS"),
        ("σ0 of the algebraic residual above rσs", "I", "LS"),
        ("σ0 of the algebraic residual above rσs", "I", "TLS"),
        ("σs over all points", "I", "LS, IGG III-WTLS"),
        ("σs over all points", "II", "LS, IGG III-WTLS"),
    ]


def test_the_exponents_of_sphere_I_are_off_by_one():
    for method in LABELS:
        first, second = (
            table3_relations.sigma_0_over_expected(sample, method) for sample in SAMPLES
        )
        assert 10 * first == pytest.approx(second, rel=0.1)


def test_sigma_0_over_expected_is_near_one_without_weights():
    fit = fit_sphere(cloud(np.random.default_rng(0), n=2000, noise=1e-4)[400:], "wtls")
    expected = 2 * fit.radius * fit.sigma_s / (np.sqrt(2) * np.linalg.norm(fit.center))
    assert fit.sigma_0 / expected == pytest.approx(1, rel=0.02)


def test_the_table_names_every_relation():
    table = table3_relations.table()
    assert len(table) == len(table3_relations.every_relation())
    assert set(table["holds"]) == {"yes", "no"}


# ----------------------------------------------------------------- simulation


def test_the_scans_are_the_printed_spheres(targets):
    for sample, target in targets.items():
        on = target.on("sphere")
        distances = (
            np.linalg.norm(target.true_points[on] - table3.truths()[sample][:3], axis=1) - RADIUS
        )
        assert np.abs(distances).max() < 1e-9
    contents = table3.contents(targets)
    assert (contents[["sphere", "mount", "wall", "mixed"]].sum(axis=1) == contents["points"]).all()


def test_a_study_has_every_method_in_both_states(study):
    assert set(study) == {(sample, state) for sample in SAMPLES for state in (RAW, CLEANED)}
    assert set(study["I", CLEANED]) - set(study["I", RAW]) == {WITH_COFACTORS}
    assert (study["I", CLEANED][HELD]["delta_r_m"] == 0).all()


def test_a_study_fits_the_redraws(targets, study):
    target = targets["II"]
    points = redraw(target, TRIALS, SEED)[3]
    parameters = fit_sphere(points[target.on("sphere")], "ls").parameters
    values = table3.values(study, "II", CLEANED, "ls")
    assert [values[f"{name}_m"][3] for name in "abcr"] == pytest.approx(parameters, abs=1e-12)
    assert values["abs_delta_r_m"][3] == pytest.approx(abs(parameters[3] - RADIUS), abs=1e-12)


def test_what_did_not_converge_has_no_values(study):
    frames = {key: dict(variants) for key, variants in study.items()}
    frames["I", CLEANED]["igg3_wtls"] = frames["I", CLEANED]["igg3_wtls"].assign(
        converged=[False] + [True] * (TRIALS - 1)
    )
    values = table3.values(frames, "I", CLEANED, "igg3_wtls")
    assert all(np.isnan(column[0]) and not np.isnan(column[1:]).any() for column in values.values())
    comparison = table3.comparison(frames, CLEANED).set_index(["sample", "method", "quantity"])
    assert comparison.loc[("I", "igg3_wtls", "a_m"), "redraws"] == TRIALS - 1


def test_every_printed_number_is_compared(study):
    comparison = table3.comparison(study, CLEANED)
    assert len(comparison) == 6 * 7 + 2  # σs of IGG III-WTLS twice
    line = comparison.set_index(["sample", "method", "quantity"]).loc[("I", "ls", "b_m")]
    assert (line["printed"], line["verdict"]) == ("5.3443", "outside")
    assert set(table3.outside(comparison)["sphere"]) <= set(SAMPLES)
    text = table3.side_by_side(comparison, table3.comparison(study, RAW))
    assert text["printed"].tolist() == comparison["printed"].tolist()


def test_noise_alone_makes_ls_too_small_and_a_held_radius_unbiased(study):
    table = table3.every_method(study).set_index(["sphere", "state", "variant"])
    for sample in SAMPLES:
        assert table.loc[(sample, CLEANED, "ls"), "radius_mm"] < -0.5
        assert abs(table.loc[(sample, CLEANED, HELD), "along_mm"]) < 0.3
        assert table.loc[(sample, RAW, "ls"), "radius_mm"] > 10
        assert table.loc[(sample, RAW, HELD), "centre_95_mm"] < 2


def test_measured_relations(study):
    table = table3.measured(study).set_index(["relation", "sphere", "state"])
    for sample in SAMPLES:
        every = table.loc[("σs of LS over σs of IGG III-WTLS, all points", sample, CLEANED)]
        assert every["upper"] < 1.05 < every["printed"]
        assert table.loc[("LS and TLS, largest difference (mm)", sample, CLEANED), "upper"] < 0.1
    assert table.loc[
        ("LS and TLS, largest difference (mm)", "II", RAW), "printed"
    ] == pytest.approx(0.1)


def test_displacements_keep_their_length(study):
    table = table3.displacements(study)
    for sample in SAMPLES:
        line = table[(table["sphere"] == sample) & (table["source"] == "printed")].iloc[0]
        printed = [
            values(3, "tls", sample)[f"{name}_m"] - values(3, "igg3_wtls", sample)[f"{name}_m"]
            for name in "abc"
        ]
        assert np.linalg.norm(line[["along", "aside", "up"]].to_numpy(float)) == pytest.approx(
            1e3 * np.linalg.norm(printed)
        )
        assert line["up"] < 0 and line["aside"] < 0


def test_printed_errors_leave_out_the_centre_that_is_the_truth():
    table = table3.printed_errors().set_index(["sphere", "method"])
    assert np.isnan(table.loc[("I", "igg3_wtls"), "along_mm"])
    assert table.loc[("II", "tls"), "radius_mm"] == pytest.approx(1.1)


def test_cleaning_leaves_fewer_points_and_other_readings_reject_more(targets):
    table = table3_settings.cleanings([0.002], [0, 0.01, 0.04], 10, SEED, **ASSUMED)
    for _, rows in table.groupby("sphere"):
        assert (
            rows["points"].is_monotonic_increasing
            and rows["points"].iloc[0] == rows["points"].min()
        )
        assert rows["ls_radius_mm"].is_monotonic_increasing
    readings = table3_settings.readings(targets, [0], ["rms", "rms_w"], 10, SEED).set_index(
        ["sphere", "scale", "cumulative"]
    )
    assert readings.loc[("II", "rms_w", True), "used"] < readings.loc[("II", "rms", True), "used"]
    assert (readings["ratio"] > 0.9).all()
