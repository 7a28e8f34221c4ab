"""The study of the readings measures what it says and judges by its one rule."""

import dataclasses

import numpy as np
import pandas as pd
import pytest

import analysis
from studies.ou_liu_2017 import clouds, readings

CLOUDS = {name: clouds.read_sphere_cloud(gross=name == "gross") for name in ("clean", "gross")}


@pytest.fixture(scope="module")
def changes():
    return readings.study(CLOUDS)


def row(changes, reading, cloud):
    return changes[(changes["reading"] == reading) & (changes["cloud"] == cloud)].iloc[0]


def test_one_row_a_reading_and_cloud(changes):
    assert len(changes) == 2 * len(readings.READINGS)
    assert not changes.duplicated(["reading", "cloud"]).any()
    assert set(changes["matters"]) == {
        readings.SPHERE,
        readings.SIGMA_0,
        readings.NOTHING,
        readings.BREAKDOWN,
    }


def test_the_literal_readings_are_the_methods_as_they_are(changes):
    # A reading changes one keyword of igg3_wtls: the default of every other must be the literal
    # one.
    for cloud, points in CLOUDS.items():
        printed = analysis.fit_sphere(points, "igg3_wtls")
        squared = analysis.fit_sphere(points, "igg3_wtls", power=2)
        found = row(changes, "exponent", cloud)
        assert found["center_mm"] == pytest.approx(
            1e3 * np.linalg.norm(squared.center - printed.center), abs=1e-6
        )
        assert found["radius_mm"] == pytest.approx(
            1e3 * (squared.radius - printed.radius), abs=1e-6
        )
        assert found["rejected_literal"] == np.count_nonzero(printed.weights == 0)


def test_wtls_by_columns_is_the_method_wtls():
    answer, fit = readings._wtls(CLOUDS["gross"]), analysis.fit_sphere(CLOUDS["gross"], "wtls")
    np.testing.assert_allclose([*answer.center, answer.radius], fit.parameters, atol=1e-9)
    assert answer.sigma_0 == pytest.approx(fit.sigma_0)


@pytest.mark.parametrize("cloud", CLOUDS)
def test_the_unit_weight_scales_sigma_0_alone(changes, cloud):
    found = row(changes, "P_X", cloud)
    assert (found["center_mm"], found["radius_mm"], found["matters"]) == (0, 0, readings.SIGMA_0)
    assert found["sigma_0_ratio"] == pytest.approx(0.5)


def test_the_start_is_forgotten_and_the_gross_errors_are_found(changes):
    assert row(changes, "start", "gross")["center_mm"] == 0
    fit = analysis.fit_sphere(CLOUDS["gross"], "igg3_wtls")
    assert (np.flatnonzero(~fit.inliers) + 1).tolist() == list(clouds.GROSS_POINTS)
    assert row(changes, "start", "gross")["rejected_other"] == 5


def test_the_redundancy_of_the_points_in_use(changes):
    assert row(changes, "n in n − t", "gross")["sigma_0_ratio"] == pytest.approx(np.sqrt(496 / 491))


def test_weighted_scales_collapse_with_cumulative_weights(changes):
    assert row(changes, "σ: weighted rms", "clean")["rejected_other"] > 450
    failed = row(changes, "σ: unit-weight σ0", "clean")
    assert failed["matters"] == readings.BREAKDOWN
    assert pd.isna(
        failed[["center_mm", "radius_mm", "sigma_0_ratio", "rejected_other", "iterations_other"]]
    ).all()
    combined = readings.scale_and_cumulation(CLOUDS, np.array(clouds.SPHERE_CENTER))
    calm = combined[combined["weights"] == "not cumulative"]
    assert len(combined) == 12
    assert calm[["clean_mm", "gross_mm"]].max(axis=None) < 2
    assert calm[["clean_lost", "gross_lost"]].max(axis=None) < 25


def test_the_centroid_reading_does_not_depend_on_the_frame():
    here, there = (
        readings._igg3_from_centroid(CLOUDS["gross"]),
        readings._igg3_from_centroid(CLOUDS["gross"] + [300.0, -40.0, 7.0]),
    )
    np.testing.assert_allclose(there.center - here.center, [300.0, -40.0, 7.0], atol=1e-9)


@pytest.mark.parametrize(
    ("change", "verdict"),
    [
        ({}, readings.NOTHING),
        ({"center_mm": 0.0999}, readings.NOTHING),
        ({"center_mm": 0.1001}, readings.SPHERE),
        ({"radius_mm": -0.0501}, readings.SPHERE),
        ({"sigma_0_ratio": 1 + 0.099 / np.sqrt(2 * 496)}, readings.NOTHING),
        ({"sigma_0_ratio": 1 - 0.101 / np.sqrt(2 * 496)}, readings.SIGMA_0),
        ({"rejected_other": 251}, readings.BREAKDOWN),
        ({"center_mm": np.nan}, readings.BREAKDOWN),
    ],
)
def test_the_rule(change, verdict):
    nothing = {"center_mm": 0.0, "radius_mm": 0.0, "sigma_0_ratio": 1.0, "rejected_other": 5}
    assert readings._judged(nothing | change, 500, sd_center=1e-3, sd_radius=0.5e-3) == verdict


def test_the_reference_is_least_squares_without_gross_errors():
    sd = analysis.fit_sphere(CLOUDS["clean"], "ls").standard_deviations
    assert readings.reference(CLOUDS["clean"]) == pytest.approx(
        (np.sqrt(np.sum(sd[:3] ** 2)), sd[3])
    )


def test_redraws_are_counted():
    chosen = tuple(
        reading for reading in readings.READINGS if reading.name in ("column of ones", "P_X")
    )
    counts = readings.how_often(2, chosen)
    assert counts.columns.tolist() == ["equation", "reading", "clean", "gross"]
    assert counts[["clean", "gross"]].to_numpy().tolist() == [[0, 2], [0, 0]]


def test_shown_names_each_place_once(changes):
    table = readings.shown(changes)
    assert (table["reading"] != "").sum() == len(readings.READINGS)
    assert table.loc[5, "rejected"] == "5 → 5"


def test_a_cloud_without_gross_errors_is_needed():
    with pytest.raises(KeyError, match="clean"):
        readings.study({"gross": CLOUDS["gross"]})


def test_the_zero_weight_form_equals_the_deleted_point():
    nu = readings.zero_weight(CLOUDS["gross"][:12], rejected=11)["nu"]
    assert np.isnan(nu[0])
    assert nu[1] == pytest.approx(nu[2], rel=1e-12)


def test_only_the_form_with_a_transpose_is_defined():
    assert [text[:3] for text in readings.start_as_printed(CLOUDS["clean"])["defined"]] == [
        "no:",
        "no:",
        "yes",
    ]


def test_readings_are_frozen():
    with pytest.raises(dataclasses.FrozenInstanceError):
        readings.READINGS[0].name = "other"
