"""Shifted frames: which methods give the same sphere, and what is said where there is none."""

import warnings

import numpy as np
import pandas as pd
import pytest

import analysis
from studies.ou_liu_2017 import clouds, origin

GROSS = clouds.read_sphere_cloud(gross=True)
CLEAN = clouds.read_sphere_cloud(gross=False)


@pytest.fixture(scope="module")
def answers():
    return origin.study(
        {"clean": CLEAN, "gross": GROSS}, shifts=(0, 100, 10_000, 4_000_000), orders=5
    )


def length(answers, cloud, method, name="center_error_m"):
    rows = answers[(answers["cloud"] == cloud) & (answers["method"] == method)]
    return rows.set_index("shift_m")[name]


def test_every_method_is_in_the_table(answers):
    assert set(answers["method"]) == set(analysis.SPHERE_METHODS) | {origin.RAW}
    assert len(answers) == 2 * 4 * (len(analysis.SPHERE_METHODS) + 1)


@pytest.mark.parametrize("method", ["ls", "eiv", "geometric", "robust"])
@pytest.mark.parametrize("cloud", ["clean", "gross"])
def test_what_ignores_the_origin_does_not_move(answers, cloud, method):
    assert length(answers, cloud, method).nunique() == 1
    assert length(answers, cloud, method, "radius_error_m").nunique() == 1


def test_the_table_holds_the_fits(answers):
    fit = analysis.fit_sphere(GROSS + [100.0, 0.0, 0.0], "wtls")
    error = fit.parameters - clouds.SPHERE - [100.0, 0.0, 0.0, 0.0]
    assert length(answers, "gross", "wtls")[100] == pytest.approx(
        np.linalg.norm(error[:3]), abs=0.6e-5
    )
    assert length(answers, "gross", "wtls", "radius_error_m")[100] == pytest.approx(
        error[3], abs=0.6e-5
    )


def test_pure_tls_collapses_at_the_origin_alone_and_is_lost_in_a_national_grid(answers):
    error = length(answers, "gross", "tls")
    assert error[0] > 1
    assert length(answers, "gross", "tls", "from_ls_m")[100] < 0.01
    assert np.isnan(error[4_000_000])
    assert length(answers, "gross", "tls", "lost").tolist() == [False, False, False, True]


@pytest.mark.parametrize("method", ["mixed_ls_tls", "wtls"])
def test_printed_total_least_squares_becomes_least_squares(answers, method):
    away = length(answers, "gross", method, "from_ls_m")
    assert away[0] > 0.01
    assert away.is_monotonic_decreasing
    assert away[4_000_000] == 0
    assert origin.becomes_ls(answers, "gross", method, within=1e-4) == 10_000


def test_igg3_moves_with_the_origin(answers):
    assert np.ptp(length(answers, "clean", "igg3_wtls")) > 1e-4
    assert length(answers, "gross", "igg3_wtls").max() < 5e-3


def test_raw_normal_equations_break_in_a_national_grid(answers):
    away = length(answers, "clean", origin.RAW, "from_ls_m")
    assert away[0] == away[100] == 0
    assert away[4_000_000] > 1


def test_raw_normal_equations_are_least_squares_near_the_origin():
    np.testing.assert_allclose(
        origin.ls_by_raw_normal_equations(GROSS),
        analysis.fit_sphere(GROSS, "ls").parameters,
        atol=1e-9,
    )


def test_raw_normal_equations_do_not_depend_on_the_order_of_the_points():
    moved = GROSS + [4e6, 0.0, 0.0]
    np.testing.assert_array_equal(
        origin.ls_by_raw_normal_equations(moved), origin.ls_by_raw_normal_equations(moved[::-1])
    )


def test_raw_normal_equations_of_points_in_a_plane_have_no_solution():
    plane = np.random.default_rng(0).integers(0, 9, (20, 3)).astype(float)
    plane[:, 2] = 0.0
    assert np.isnan(origin.ls_by_raw_normal_equations(plane)).all()


def test_fits_without_a_sphere_are_counted_and_not_warned_of():
    # no sphere fits these, and WTLS wanders off
    scattered = np.random.default_rng(0).uniform(-0.1, 0.1, (200, 12, 3))[3]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        frame = origin.study({"scattered": scattered}, shifts=(0,), orders=3).set_index("method")
    assert frame.loc["wtls", "no_sphere"] == 3
    assert frame.loc["wtls", ["center_error_m", "radius_error_m", "from_ls_m"]].isna().all()
    assert frame.loc["ls", "no_sphere"] == 0
    assert frame.loc["ls", ["center_error_m", "radius_error_m", "from_ls_m"]].notna().all()


def test_by_shift_is_the_same_numbers_in_millimetres(answers):
    table = origin.by_shift(answers, "gross", "center_error_m")
    assert table.columns.tolist() == ["shift/m", *origin.LABELS.values()]
    np.testing.assert_allclose(table["WTLS"], 1e3 * length(answers, "gross", "wtls"))


def test_becomes_ls_needs_all_farther_shifts_to_be_near():
    frame = pd.DataFrame(
        {"cloud": "c", "method": "m", "shift_m": [0, 1, 10, 100], "from_ls_m": [0.0, 1.0, 0.0, 0.0]}
    )
    assert origin.becomes_ls(frame, "c", "m", within=0.1) == 10
    with pytest.raises(ValueError, match="within 0.1 m"):
        origin.becomes_ls(frame.assign(from_ls_m=1.0), "c", "m", within=0.1)
