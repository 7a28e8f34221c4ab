"""Simulated sections in both epochs, and the results of one campaign and of many."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from analysis.tunnel.block_adjustment import singly
from analysis.tunnel.outlines import ANGLES
from analysis.tunnel.radii import equal_angles
from analysis.tunnel.significance import differences
from studies.li_2015 import section_accuracy
from studies.li_2015.register_campaign import register
from studies.li_2015.simulated_sections import compare_epochs, simulated_sections, true_split
from studies.simulation.tunnel import NAMES, default_tunnel, survey

DENSITY = 600_000
AT = (25.0, 65.0, 105.0)  # dent, squat, ring that moves


@pytest.fixture(scope="module")
def sections():
    return simulated_sections(default_tunnel(), AT, DENSITY, workers=1)


@pytest.fixture(scope="module")
def once(sections):
    return [compare_epochs(section.lining(), 1, 3) for section in sections]


def off(section, sd):
    """The section with independent errors of its stations of sd (m) in each direction."""
    return replace(section, shifts=sd**2 * np.eye(len(section.shifts)))


def test_points_lie_on_the_outline_in_the_frame_of_the_section(sections):
    for section in sections:
        lining = section.lining()
        for epoch, points in zip((1, 2), lining.draw(4, 1), strict=True):
            u, v, w = np.moveaxis(points, -1, 0)
            radii = section.tunnel.true_radius(np.arctan2(u, v), section.chainage, epoch)
            away = np.hypot(u, v) - radii
            assert (
                abs(np.median(away)) < 0.0005 and 0.001 < 1.4826 * np.median(np.abs(away)) < 0.004
            )
            assert np.abs(w).max() < 0.05 and np.median(np.abs(w)) < 0.025


def test_only_lining_is_left(sections):
    for section in sections:
        for scan, kept in zip(section.scans, section.lining().scans, strict=True):
            names = np.array(NAMES)[scan.codes]
            assert len(kept) == np.count_nonzero(names == "lining") < len(scan)
            np.testing.assert_array_equal(kept.points, scan.points[names == "lining"])


def test_draws_do_not_depend_on_their_number_and_differ_between_epochs_and_sections(sections):
    section = off(sections[1], 0.001)
    few, many = section.draw(2, 5, n_points=60), section.draw(4, 5, n_points=60)
    for a, b in zip(few, many, strict=True):
        assert a.shape == (2, 60, 3)
        np.testing.assert_array_equal(a, b[:2])
    assert not np.array_equal(*section.draw(1, 5, n_points=60))
    assert not np.array_equal(few[0][0], few[0][1])


def test_stations_that_are_off_shift_the_section(sections):
    """The shift between the epochs has the stated covariance over the campaigns."""
    section = off(sections[0].lining(), 0.002)
    still, shifted = (one.draw(1000, 7) for one in (sections[0].lining(), section))
    moves = [np.mean(b - a, axis=1) for a, b in zip(still, shifted, strict=True)]
    assert np.abs(moves[0][:, 2]).max() < 1e-12  # along the tunnel nothing is compared
    np.testing.assert_allclose(
        np.diagonal(np.cov((moves[1] - moves[0])[:, :2].T)),
        np.diagonal(section.registration),
        rtol=0.15,
    )
    assert sections[0].registration.max() == 0.0
    assert np.all(np.diagonal(section.registration) <= 2 * 0.002**2)


def test_an_error_that_all_stations_share_is_in_no_difference(sections):
    section = sections[0].lining()
    common = replace(section, shifts=0.005**2 * np.kron(np.ones((10, 10)), np.eye(2)))
    np.testing.assert_allclose(common.registration, 0.0, atol=1e-15)
    (still, again), (first, second) = (one.draw(3, 7) for one in (section, common))
    move = np.mean(first - still, axis=1)
    assert np.abs(move).max() > 0.002
    np.testing.assert_allclose(
        second - again, np.broadcast_to(move[:, None], again.shape), atol=1e-9
    )


def test_registered_sections_have_the_covariance_of_their_stations(sections):
    stations = {
        name: station
        for epoch in survey(sections[0].tunnel)
        for name, station in register(epoch).items()
    }
    section = sections[1].with_registration(singly(stations))
    axis, fit = section.tunnel.alignment, stations["2.2"].similarity
    point, directions = axis.position(65.0), axis.frame(65.0)[[0, 2]]
    expected = (
        directions
        @ fit.transformed_covariance(fit.inverse().transform(point[None]))[0]
        @ directions.T
    )
    np.testing.assert_allclose(section.shifts[14:16, 14:16], expected, rtol=1e-6, atol=1e-12)
    assert np.abs(section.shifts[14:16, :14]).max() == 0.0
    np.testing.assert_allclose(section.lining().shifts, section.shifts)
    with pytest.raises(
        ValueError, match="block: expected 10 stations, those of both epochs, got 1"
    ):
        section.with_registration(singly({"2.2": stations["2.2"]}))


def test_registrations(sections):
    table = section_accuracy.registrations(
        {"none": sections[:1], "some": [off(one, 0.001) for one in sections]}
    )
    assert table["case"].tolist() == ["none"] + ["some"] * 3 and table["chainage_m"].tolist() == [
        25.0,
        *AT,
    ]
    assert table["right_sd_mm"][0] == 0 and table["up_sd_mm"][2] == pytest.approx(
        1e3 * off(sections[1], 0.001).registration[1, 1] ** 0.5
    )


def test_casting_on_several_workers_changes_nothing():
    alone, shared = (
        simulated_sections(default_tunnel(), AT[:2], 20_000, workers=workers) for workers in (1, 2)
    )
    for a, b in zip(alone, shared, strict=True):
        for one, other in zip(a.scans, b.scans, strict=True):
            np.testing.assert_array_equal(one.points, other.points)
            np.testing.assert_array_equal(one.codes, other.codes)


def test_section_has_the_form_of_one_cut_from_a_scan(sections):
    points = sections[1].draw(1, 2)[0][0]
    section = sections[1].section(points)
    projected = (
        section.position + np.outer(section.u, section.right) + np.outer(section.v, section.up)
    )
    chainage, u, v = sections[1].tunnel.alignment.section_coordinates(projected)
    np.testing.assert_allclose([u, v], [section.u, section.v], atol=1e-9)
    np.testing.assert_allclose(chainage, 65.0, atol=1e-9)


def test_the_squat_is_recovered_by_direction(once):
    squat = once[1]
    assert np.abs(squat.errors).max() < 0.002
    table = section_accuracy.directions([squat], 15)
    np.testing.assert_allclose(table["angle_deg"], np.arange(-135, 136, 15), atol=1e-9)
    crown = table[table["angle_deg"].abs() < 1e-9].iloc[0]
    assert (
        abs(crown["65_true_mm"] + 24.3) < 1e-6
        and abs(crown["65_mm"] + 24.3) < 3.5 * crown["65_sd_mm"]
    )
    (row,) = section_accuracy.outlines([squat]).itertuples()
    assert (
        abs(row.largest_mm + 24.3) < 1.0 and abs(row.true_mm + 24.3) < 1e-6 and abs(row.at_deg) < 6
    )
    assert row.b_2_m < row.b_1_m < row.a_1_m < row.a_2_m


def test_what_a_tunnel_is_judged_by(once):
    table = section_accuracy.section_quantities(once[1:2]).set_index("quantity")
    true = table["true"].to_dict()
    assert true["crown settlement"] == pytest.approx(24.3) and true[
        "horizontal convergence"
    ] == pytest.approx(2 * 0.45 * 24.3)
    for name in ("horizontal convergence", "crown settlement", "vertical convergence"):
        assert abs(table["value"][name] - true[name]) < 4 * table["standard_deviation"][name]
    # With registration errors the settlement is less certain, the convergence is not.
    shifted = section_accuracy.section_quantities(
        [replace(once[1], section=off(once[1].section, 0.001))]
    ).set_index("quantity")["standard_deviation"]
    assert shifted["crown settlement"] > 1.0
    assert (
        shifted["horizontal convergence"]
        < 1.1 * table["standard_deviation"]["horizontal convergence"]
    )


def test_a_ring_that_moves_is_told_from_one_that_is_pressed_down(once):
    table = section_accuracy.parts(once).set_index("chainage_m")
    ring = table.loc[105.0]
    assert ring["true_right_mm"] == pytest.approx(6.4, abs=0.01) and ring[
        "true_up_mm"
    ] == pytest.approx(-4.8, abs=0.01)
    assert (
        abs(ring["right_mm"] - 6.4) < 4 * ring["right_sd_mm"]
        and abs(ring["up_mm"] + 4.8) < 4 * ring["up_sd_mm"]
    )
    assert ring["shape_mm"] < 1.5 and ring["true_shape_mm"] < 0.01
    assert table.loc[65.0, "true_shape_mm"] > 15 and abs(table.loc[65.0, "true_up_mm"]) < 0.1
    shares = section_accuracy.shares(once[2])
    np.testing.assert_allclose(
        shares["rigid_mm"] + shares["shape_mm"], shares["difference_mm"], atol=1e-9
    )
    np.testing.assert_allclose(
        shares["true_rigid_mm"] + shares["true_shape_mm"], shares["true_difference_mm"], atol=1e-9
    )


def test_a_registration_error_of_an_epoch_is_in_the_rigid_part_alone(sections):
    together = np.zeros((10, 10))
    together[:6, :6] = together[6:, 6:] = 0.003**2
    one = compare_epochs(replace(sections[1].lining(), shifts=np.kron(together, np.eye(2))), 20, 4)
    without = compare_epochs(sections[1].lining(), 20, 4)
    assert one.errors.std() > 3 * without.errors.std()
    assert one.errors_within.std() < 1.05 * without.errors_within.std()


def test_ellipses_hide_a_dent_and_residuals_show_it(once):
    table = section_accuracy.hidden(once[0])
    deepest = table.loc[table["true_mm"].idxmin()]
    assert deepest["angle_deg"] == pytest.approx(40.0) and deepest["true_mm"] == pytest.approx(
        -14.0
    )
    assert table["ellipse_mm"].abs().max() < 4.0
    dent = table[(table["true_mm"] < -8) & table["together_mm"].notna()]  # a cable hides the rest
    assert len(dent) > 5
    # Half a millimetre for what the dent changes within the cell of a median.
    assert (
        (dent["together_mm"] - dent["true_mm"]).abs()
        < 4 * np.hypot(dent["ellipse_sd_mm"], dent["hidden_sd_mm"]) + 0.5
    ).all()
    np.testing.assert_allclose(table["together_mm"], table["ellipse_mm"] + table["hidden_mm"])


def test_single_points_and_their_classes(sections, once):
    lining = sections[1].lining()
    pair = tuple(points[0] for points in once[1].points)
    table = section_accuracy.single_points(lining, pair)
    delta = differences(*(equal_angles(lining.section(points)) for points in pair))
    np.testing.assert_allclose(table["difference_mm"], 1e3 * delta.ravel())
    assert len(table) == 3 * len(ANGLES)
    (row,) = section_accuracy.class_shares(table).itertuples()
    seen = table[table["class"] != "gap"]
    assert row.seen_percent == pytest.approx(100 * len(seen) / len(table))
    assert row.blue_percent == pytest.approx(100 * np.mean(seen["class"] == "blue"))
    assert (
        row.red_percent == pytest.approx(100 * np.mean(seen["class"] == "red"))
        and row.red_percent > 20
    )


def test_recovery(sections):
    lining = sections[1].lining()
    table = section_accuracy.recovery(
        {"noise": [lining], "registration": [off(lining, 0.002)]}, 8, 1
    )
    assert table["section"].tolist() == ["65 m", "all"] * 2
    # all of one section
    pd.testing.assert_series_equal(table.iloc[2, 4:], table.iloc[3, 4:], check_names=False)
    noise, _, registration, _ = table.itertuples()
    assert noise.true_mm == registration.true_mm == pytest.approx(24.3)
    assert (
        noise.rmse_mm < 0.7 < registration.rmse_mm
        and noise.within_percent == 100
        and noise.within_se_percent == 0
    )
    share = registration.within_percent / 100
    assert registration.within_se_percent == pytest.approx(100 * np.sqrt(share * (1 - share) / 8))
    assert (
        registration.rmse_within_mm < 0.7
        and registration.largest_worst_mm >= registration.largest_rms_mm
    )
    one = compare_epochs(lining, 8, 1)
    assert noise.rmse_mm == pytest.approx(1e3 * np.sqrt(np.mean(one.errors**2)))


def test_true_parts_are_those_of_the_truth():
    wave = 0.001 + 0.004 * np.cos(ANGLES) - 0.003 * np.sin(ANGLES) + 0.005 * np.cos(2 * ANGLES)
    parts = true_split(ANGLES, wave)
    np.testing.assert_allclose(parts.translation, [-0.003, 0.004], atol=1e-12)
    np.testing.assert_allclose([parts.mean, parts.shape.max()], [0.001, 0.005], atol=1e-9)
