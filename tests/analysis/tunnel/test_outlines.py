"""Polar radii and their change between epochs: gradients, meaning of every part, and whether the
intervals hold the truth.
"""

import numpy as np
import pandas as pd
import pytest

import analysis
from analysis.surfaces.ellipse import EllipseFit, polar
from analysis.tunnel.outlines import (
    ANGLES,
    deformation,
    hidden_deformation,
    quantities,
    residual_profile,
    split,
)

CIRCLE = np.array([0.02, -0.01, 2.70, 0.0, 0.0])
FLATTENED = np.array([0.022, -0.013, 2.701, 0.010, 0.002])  # 20 mm between the axes, sunk by 3 mm
POLE = np.array([0.05, 0.03])
REGISTRATION = np.array([[1.0, 0.3], [0.3, 0.5]]) * 1e-6


def known(x, covariance=None):
    """An ellipse (u0, v0, m, g, h) as a fit with this covariance of it."""
    x = np.asarray(x, dtype=float)
    covariance = np.zeros(x.shape + (5,)) if covariance is None else covariance
    return EllipseFit(
        "known",
        x,
        covariance,
        np.ones(x.shape[:-1])[()],
        None,
        None,
        0,
        True,
        "",
        regular=x,
        regular_cofactor=covariance,
    )


def known_fit():
    return analysis.fit_ellipse(outline_points(CIRCLE, ANGLES), "geometric")


def outline_points(x, angles, pole=POLE):
    """Points (…, n, 2) of ellipses (…, 5) in directions from a pole."""
    return pole + polar(np.asarray(x), angles, pole)[0][..., None] * np.stack(
        [np.sin(angles), np.cos(angles)], axis=-1
    )


def scanned(x, n, trials, rng, sigma=0.003):
    angles = rng.uniform(-0.75 * np.pi, 0.75 * np.pi, n)
    return outline_points(x, angles) + sigma * rng.standard_normal((trials, n, 2))


def test_radii_end_on_the_ellipse_for_any_pole():
    x = np.array([0.3, -0.2, 2.0, 0.5, 0.3])
    for pole in ([0.3, -0.2], [1.0, 0.5], [-0.5, -1.0]):
        radii, *_ = polar(x, ANGLES, np.array(pole))
        places = np.array(pole) + radii[:, None] * np.column_stack([np.sin(ANGLES), np.cos(ANGLES)])
        S = np.array([[2.5, 0.3], [0.3, 1.5]])
        np.testing.assert_allclose(
            np.linalg.norm(np.linalg.solve(S, (places - x[:2]).T), axis=0), 1.0, rtol=1e-13
        )
        assert (radii > 0).all()
    assert np.isnan(polar(x, ANGLES, np.array([5.0, 5.0]))[0]).all()


def test_directions_are_zero_at_the_crown_and_positive_to_the_right():
    radii, *_ = polar(
        np.array([0.5, 0.25, 2.0, 0.0, 0.0]), np.deg2rad([0, 90, -90, 180]), np.zeros(2)
    )
    expected = [
        0.25 + np.sqrt(4 - 0.25),
        0.5 + np.sqrt(4 - 0.0625),
        -0.5 + np.sqrt(4 - 0.0625),
        -0.25 + np.sqrt(4 - 0.25),
    ]
    np.testing.assert_allclose(radii, expected)


@pytest.mark.parametrize(
    "x", [CIRCLE, FLATTENED, [0.3, -0.2, 2.0, 0.5, 0.3]], ids=["circle", "section", "flat"]
)
def test_gradients_of_the_radii(x):
    _, gradient, shift = polar(np.array(x), ANGLES, POLE)
    for i, step in enumerate(1e-6 * np.eye(5)):
        slope = (polar(x + step, ANGLES, POLE)[0] - polar(x - step, ANGLES, POLE)[0]) / 2e-6
        np.testing.assert_allclose(gradient[:, i], slope, atol=1e-8)
    np.testing.assert_array_equal(shift, gradient[:, :2])


def test_the_same_epoch_twice_has_not_moved():
    fit = analysis.fit_ellipse(scanned(CIRCLE, 200, 3, np.random.default_rng(1)))
    change = deformation(fit, fit)
    assert not change.difference.any() and change.difference.shape == (3, len(ANGLES))
    np.testing.assert_array_equal(change.pole, fit.center)


def test_motion_of_the_section_and_its_frame_changes_nothing_but_the_frame():
    """Both epochs and the pole shifted by the same: the same Δρ."""
    shift = np.array([0.4, -0.7])
    before = deformation(known(CIRCLE), known(FLATTENED), pole=POLE)
    moved = np.concatenate([shift, np.zeros(3)])
    after = deformation(known(CIRCLE + moved), known(FLATTENED + moved), pole=POLE + shift)
    np.testing.assert_allclose(after.difference, before.difference, atol=1e-14)


def test_quantities_of_a_known_change():
    """A circle that becomes an ellipse about the same centre, 12 mm wider and 8 mm lower to each
    side.
    """
    first, second = known([0, 0, 2.7, 0, 0]), known([0, 0, 2.702, 0.010, 0])
    table = quantities(first, second, registration=REGISTRATION).set_index("quantity")
    expected = {
        "horizontal convergence": 24.0,
        "crown settlement": 8.0,
        "vertical convergence": -16.0,
        "ovality, first": 0.0,
        "ovality, second": 20.0 / 2.702,
    }
    for name, value in expected.items():
        np.testing.assert_allclose(table["value"][name], value, atol=1e-9)
    assert table["extrapolated"].to_dict() == {
        name: name == "vertical convergence" for name in expected
    }
    # A shift between the frames moves the crown, and takes from one side what it gives to the
    # other.
    np.testing.assert_allclose(
        table["standard_deviation"]["crown settlement"],
        1000 * np.sqrt(REGISTRATION[1, 1]),
        rtol=1e-12,
    )
    assert table["standard_deviation"]["horizontal convergence"] < 1e-9


def test_a_ring_that_moves_as_a_whole_has_no_change_of_shape():
    move = np.array([0.003, -0.008])
    change = deformation(
        known(FLATTENED), known(FLATTENED + np.append(move, [0, 0, 0])), registration=REGISTRATION
    )
    parts = split(change)
    np.testing.assert_allclose(parts.translation, move, atol=5e-5)
    assert abs(parts.mean) < 2e-5 and np.abs(parts.shape).max() < 1e-4
    np.testing.assert_allclose(parts.translation_covariance, REGISTRATION, rtol=0.03)
    np.testing.assert_allclose(
        parts.mean + parts.rigid + parts.shape, change.difference, atol=1e-15
    )


def test_a_change_of_shape_is_not_taken_for_a_motion():
    change = deformation(known(CIRCLE), known(CIRCLE + [0, 0, 0.001, 0.010, 0]), pole=CIRCLE[:2])
    parts = split(change)
    assert np.abs(parts.translation).max() < 1e-5
    np.testing.assert_allclose(parts.mean, 0.001, atol=5e-5)
    np.testing.assert_allclose(parts.shape, -0.010 * np.cos(2 * ANGLES), atol=1e-4)


@pytest.mark.parametrize("method", ["geometric", "robust"])
def test_the_intervals_hold_the_truth(method):
    """Over campaigns with noise and a registration error; pooled over the directions, whose hits
    hang together.
    """
    rng, trials = np.random.default_rng(2), 600 if method == "geometric" else 300
    first = analysis.fit_ellipse(scanned(CIRCLE, 200, trials, rng), method)
    shifts = rng.standard_normal((trials, 1, 2)) @ np.linalg.cholesky(REGISTRATION).T
    second = analysis.fit_ellipse(scanned(FLATTENED, 150, trials, rng) + shifts, method)
    truth = deformation(known(CIRCLE), known(FLATTENED), pole=POLE).difference
    change = deformation(first, second, pole=POLE, registration=REGISTRATION)
    low, high = change.interval(0.95)
    assert 0.93 < np.mean((low <= truth) & (truth <= high)) < 0.97
    np.testing.assert_allclose(
        change.difference.std(axis=0), change.standard_deviations.mean(axis=0), rtol=0.12
    )
    # Without the registration term the intervals are too short, and it shows.
    low, high = deformation(first, second, pole=POLE).interval(0.95)
    assert np.mean((low <= truth) & (truth <= high)) < 0.85
    # So do those of a sum over directions, by its covariance.
    sums = np.array([(np.abs(ANGLES) < 0.5).astype(float)]) / 57.0
    value, covariance = change.combination(sums)
    inside = np.abs(value[:, 0] - truth @ sums[0]) <= 1.96 * np.sqrt(covariance[:, 0, 0])
    assert 0.92 < inside.mean() < 0.98


def test_what_the_ellipse_hides():
    """A dent of 24.3 mm in 20° of the crown beside a cable tray that stands in both epochs."""
    rng, n = np.random.default_rng(5), 5400
    angles = rng.uniform(-0.75 * np.pi, 0.75 * np.pi, (2, n))
    outwards = np.stack([np.sin(angles), np.cos(angles)], axis=-1)
    tray = np.where(np.abs(angles - 1.5) < 0.05, -0.13, 0.0)
    dent = -0.0243 * np.exp(-0.5 * (angles / np.deg2rad(5.0)) ** 2) * np.array([[0.0], [1.0]])
    points = (
        np.stack([outline_points(CIRCLE, epoch) for epoch in angles])
        + (tray + dent)[..., None] * outwards
    )
    points += 0.003 * rng.standard_normal((2, n, 2))
    fits = [analysis.fit_ellipse(epoch) for epoch in points]
    change = deformation(*fits, pole=POLE)
    assert np.abs(change.difference).max() < 0.002  # the ellipses see next to nothing
    hidden = hidden_deformation(
        *(residual_profile(p, fit, POLE) for p, fit in zip(points, fits, strict=True))
    )
    crown = hidden["angle_deg"].abs().idxmin()
    total = hidden["hidden_mm"][crown] + 1000 * change.difference[crown]
    sd = hidden["standard_deviation_mm"]
    assert (
        abs(total - np.median(-24.3 * np.exp(-0.5 * (np.linspace(-2, 2, 101) / 5) ** 2)))
        < 2.5 * sd[crown]
    )
    assert sd[crown] < 1.0
    assert hidden["hidden_mm"][crown] < 0.8 * total
    # At the edges of the tray the middle of a cell is now lining, now tray: the standard deviation
    # says so.
    quiet = hidden[(hidden["angle_deg"].abs() > 25) & (sd < 2)]
    assert len(quiet) > 205
    assert quiet["hidden_mm"].abs().max() < 3.5
    assert (quiet["hidden_mm"].abs() > 1.96 * sd[quiet.index]).mean() < 0.12
    assert hidden["hidden_mm"].notna().all()


def test_profile_has_gaps_where_there_is_nothing():
    angles = np.linspace(-2, 1, 1000)
    points = outline_points(CIRCLE, angles)
    profile = residual_profile(points, analysis.fit_ellipse(points, "geometric"), POLE)
    assert profile["residual_mm"].isna().equals(profile["points"] < 5)
    assert profile["residual_mm"][profile["angle_deg"] > 65].isna().all()
    assert profile["residual_mm"][profile["angle_deg"].abs() < 50].notna().all()


def test_tables():
    stack = known(np.stack([CIRCLE, FLATTENED]), np.broadcast_to(1e-8 * np.eye(5), (2, 5, 5)))
    change = deformation(stack, stack, pole=POLE, angles=np.deg2rad([0.0, 90.0]))
    table = change.table()
    assert table["section"].tolist() == [0, 0, 1, 1] and table["angle_deg"].round(9).tolist() == [
        0,
        90,
        0,
        90,
    ]
    assert (table["standard_deviation_mm"] > 0).all()
    assert quantities(stack, stack)["section"].tolist() == [0] * 5 + [1] * 5
    assert isinstance(quantities(known(CIRCLE), known(FLATTENED)), pd.DataFrame)


@pytest.mark.parametrize(
    "call, message",
    [
        (
            lambda: deformation(known(CIRCLE), known(np.stack([CIRCLE, CIRCLE]))),
            "second: expected outlines of shape",
        ),
        (lambda: deformation(known(CIRCLE), known(CIRCLE), pole=[0, 0, 0]), "pole: expected shape"),
        (
            lambda: deformation(known(CIRCLE), known(CIRCLE), angles=[[0.0]]),
            "angles: expected shape",
        ),
        (
            lambda: deformation(known(CIRCLE), known(CIRCLE), registration=np.eye(3)),
            "registration: expected shape",
        ),
        (
            lambda: deformation(known(CIRCLE), known(CIRCLE)).interval(1.5),
            "level: expected a probability",
        ),
        (
            lambda: split(deformation(known(CIRCLE), known(CIRCLE), angles=[0.0, 1.0])),
            "directions: expected at least 9",
        ),
        (
            lambda: residual_profile(np.zeros((3, 2)), known_fit(), POLE),
            "points: expected those of the fit",
        ),
    ],
)
def test_bad_input(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_nothing_is_changed():
    points = outline_points(CIRCLE, ANGLES)
    before = points.copy()
    residual_profile(points, analysis.fit_ellipse(points), POLE)
    np.testing.assert_array_equal(points, before)
