"""Simulated sections in both epochs, and what is read from one campaign and from many."""

import numpy as np
import pytest

from analysis.tunnel import section_study
from analysis.tunnel.changes import differences
from analysis.tunnel.deformation import ANGLES
from analysis.tunnel.sections import equal_angles
from analysis.tunnel.simulated_sections import compared, simulated_sections, true_split
from analysis.tunnel.simulation import NAMES, default_tunnel

DENSITY = 600_000
AT = (25.0, 65.0, 105.0)  # dent, squat, ring that moves


@pytest.fixture(scope="module")
def sections():
    return simulated_sections(default_tunnel(), AT, DENSITY, workers=1)


@pytest.fixture(scope="module")
def once(sections):
    return [compared(section.lining(), 1, 3, registration_sd=0.0) for section in sections]


def test_points_lie_on_the_outline_in_the_frame_of_the_section(sections):
    for section in sections:
        lining = section.lining()
        for epoch, points in zip((1, 2), lining.drawn(4, 1, registration_sd=0.0), strict=True):
            u, v, w = np.moveaxis(points, -1, 0)
            radii = section.tunnel.true_radius(np.arctan2(u, v), section.chainage, epoch)
            away = np.hypot(u, v) - radii
            assert abs(np.median(away)) < 0.0005 and 0.001 < 1.4826 * np.median(np.abs(away)) < 0.004
            assert np.abs(w).max() < 0.05 and np.median(np.abs(w)) < 0.025


def test_only_lining_is_left(sections):
    for section in sections:
        for scan, kept in zip(section.scans, section.lining().scans, strict=True):
            names = np.array(NAMES)[scan.codes]
            assert len(kept) == np.count_nonzero(names == "lining") < len(scan)
            np.testing.assert_array_equal(kept.points, scan.points[names == "lining"])


def test_draws_do_not_hang_on_their_number_and_differ_between_epochs_and_sections(sections):
    section = sections[1]
    few, many = section.drawn(2, 5, registration_sd=0.001, n_points=60), section.drawn(4, 5, registration_sd=0.001, n_points=60)
    for a, b in zip(few, many, strict=True):
        assert a.shape == (2, 60, 3)
        np.testing.assert_array_equal(a, b[:2])
    assert not np.array_equal(*section.drawn(1, 5, registration_sd=0.0, n_points=60))
    assert not np.array_equal(few[0][0], few[0][1])


def test_a_station_that_is_off_shifts_the_section(sections):
    """Their spread over campaigns is the covariance that is stated."""
    section = sections[0].lining()
    still, shifted = (section.drawn(300, 7, registration_sd=sd) for sd in (0.0, 0.002))
    moves = [np.mean(b - a, axis=1)[:, :2] for a, b in zip(still, shifted, strict=True)]
    total = np.cov((moves[1] - moves[0]).T)
    np.testing.assert_allclose(np.diagonal(total), np.diagonal(section.registration(0.002)), rtol=0.2)
    assert section.registration(0.0).max() == 0.0
    one_station = 0.002**2
    assert np.all(np.diagonal(section.registration(0.002)) <= 2 * one_station)


def test_casting_on_several_workers_changes_nothing():
    alone, shared = (simulated_sections(default_tunnel(), AT[:2], 20_000, workers=workers) for workers in (1, 2))
    for a, b in zip(alone, shared, strict=True):
        for one, other in zip(a.scans, b.scans, strict=True):
            np.testing.assert_array_equal(one.points, other.points)
            np.testing.assert_array_equal(one.codes, other.codes)


def test_section_has_the_form_of_one_cut_from_a_scan(sections):
    points = sections[1].drawn(1, 2, registration_sd=0.0)[0][0]
    section = sections[1].section(points)
    chainage, u, v = sections[1].tunnel.alignment.section_coordinates(section.projected)
    np.testing.assert_allclose([u, v], [section.u, section.v], atol=1e-9)
    np.testing.assert_allclose(chainage, 65.0, atol=1e-9)


def test_the_squat_is_recovered_by_direction(once):
    squat = once[1]
    assert np.abs(squat.errors).max() < 0.002
    table = section_study.directions([squat], 15)
    np.testing.assert_allclose(table["angle_deg"], np.arange(-135, 136, 15), atol=1e-9)
    crown = table[table["angle_deg"].abs() < 1e-9].iloc[0]
    assert abs(crown["65_true_mm"] + 24.3) < 1e-6 and abs(crown["65_mm"] + 24.3) < 3.5 * crown["65_sd_mm"]
    (row,) = section_study.outlines([squat]).itertuples()
    assert abs(row.largest_mm + 24.3) < 1.0 and abs(row.true_mm + 24.3) < 1e-6 and abs(row.at_deg) < 6
    assert row.b_2_m < row.b_1_m < row.a_1_m < row.a_2_m


def test_what_a_tunnel_is_judged_by(once):
    table = section_study.judged(once[1:2], 0.0).set_index("quantity")
    true = table["true"].to_dict()
    assert true["crown settlement"] == pytest.approx(24.3) and true["horizontal convergence"] == pytest.approx(2 * 0.45 * 24.3)
    for name in ("horizontal convergence", "crown settlement", "vertical convergence"):
        assert abs(table["value"][name] - true[name]) < 4 * table["standard_deviation"][name]
    # With registration errors the settlement is less certain, the convergence is not.
    shifted = section_study.judged(once[1:2], 0.001).set_index("quantity")["standard_deviation"]
    assert shifted["crown settlement"] > 1.0
    assert shifted["horizontal convergence"] < 1.1 * table["standard_deviation"]["horizontal convergence"]


def test_a_ring_that_moves_is_told_from_one_that_is_pressed_down(once):
    table = section_study.parts(once).set_index("chainage_m")
    ring = table.loc[105.0]
    assert ring["true_right_mm"] == pytest.approx(6.4, abs=0.01) and ring["true_up_mm"] == pytest.approx(-4.8, abs=0.01)
    assert abs(ring["right_mm"] - 6.4) < 4 * ring["right_sd_mm"] and abs(ring["up_mm"] + 4.8) < 4 * ring["up_sd_mm"]
    assert ring["shape_mm"] < 1.5 and ring["true_shape_mm"] < 0.01
    assert table.loc[65.0, "true_shape_mm"] > 15 and abs(table.loc[65.0, "true_up_mm"]) < 0.1
    shares = section_study.shares(once[2])
    np.testing.assert_allclose(shares["rigid_mm"] + shares["shape_mm"], shares["difference_mm"], atol=1e-9)
    np.testing.assert_allclose(shares["true_rigid_mm"] + shares["true_shape_mm"], shares["true_difference_mm"], atol=1e-9)


def test_a_registration_error_is_in_the_rigid_part_alone(sections):
    one = compared(sections[1].lining(), 20, 4, registration_sd=0.003)
    without = compared(sections[1].lining(), 20, 4, registration_sd=0.0)
    assert one.errors.std() > 3 * without.errors.std()
    assert one.errors_within.std() < 1.3 * without.errors_within.std()


def test_ellipses_hide_a_dent_and_residuals_show_it(once):
    table = section_study.hidden(once[0])
    deepest = table.loc[table["true_mm"].idxmin()]
    assert deepest["angle_deg"] == pytest.approx(40.0) and deepest["true_mm"] == pytest.approx(-14.0)
    assert table["ellipse_mm"].abs().max() < 4.0
    dent = table[(table["true_mm"] < -8) & table["together_mm"].notna()]  # a cable hides the rest
    assert len(dent) > 5
    # Half a millimetre for what the dent changes within the cell of a median.
    assert ((dent["together_mm"] - dent["true_mm"]).abs() < 4 * np.hypot(dent["ellipse_sd_mm"], dent["hidden_sd_mm"]) + 0.5).all()
    np.testing.assert_allclose(table["together_mm"], table["ellipse_mm"] + table["hidden_mm"])


def test_single_points_and_their_classes(sections, once):
    lining = sections[1].lining()
    pair = tuple(points[0] for points in once[1].points)
    table = section_study.single_points(lining, pair)
    delta = differences(*(equal_angles(lining.section(points)) for points in pair))
    np.testing.assert_allclose(table["difference_mm"], 1e3 * delta.ravel())
    assert len(table) == 3 * len(ANGLES)
    (row,) = section_study.class_shares(table).itertuples()
    seen = table[table["class"] != "gap"]
    assert row.seen_percent == pytest.approx(100 * len(seen) / len(table))
    assert row.blue_percent == pytest.approx(100 * np.mean(seen["class"] == "blue"))
    assert row.red_percent == pytest.approx(100 * np.mean(seen["class"] == "red")) and row.red_percent > 20


def test_recovery(sections):
    lining = sections[1].lining()
    table = section_study.recovery({"noise": ([lining], 0.0), "registration": ([lining], 0.002)}, 8, 1)
    noise, registration = table.itertuples()
    assert noise.true_mm == registration.true_mm == pytest.approx(24.3)
    assert noise.rmse_mm < 0.7 < registration.rmse_mm and noise.within_percent == 100
    assert registration.rmse_within_mm < 0.7 and registration.largest_worst_mm >= registration.largest_rms_mm
    one = compared(lining, 8, 1, registration_sd=0.0)
    assert noise.rmse_mm == pytest.approx(1e3 * np.sqrt(np.mean(one.errors**2)))


def test_true_parts_are_those_of_the_truth():
    wave = 0.001 + 0.004 * np.cos(ANGLES) - 0.003 * np.sin(ANGLES) + 0.005 * np.cos(2 * ANGLES)
    parts = true_split(ANGLES, wave)
    np.testing.assert_allclose(parts.translation, [-0.003, 0.004], atol=1e-12)
    np.testing.assert_allclose([parts.mean, parts.shape.max()], [0.001, 0.005], atol=1e-9)
