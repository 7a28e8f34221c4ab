"""Polar radii and their change between epochs: gradients, meaning of every part, and whether the
intervals hold the truth.
"""

import numpy as np
import pandas as pd
import pytest

import analysis
from analysis.surfaces.ellipse import polar
from analysis.tunnel.outlines import ANGLES, deformation, quantities

from .exact_outlines import CIRCLE, FLATTENED, POLE, REGISTRATION, known, outline_points


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
    np.testing.assert_array_equal(change.first, deformation(fit, fit, pole=fit.center).first)


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


def test_a_stack_is_its_sections_one_by_one():
    stack = known(np.stack([CIRCLE, FLATTENED]), np.broadcast_to(1e-8 * np.eye(5), (2, 5, 5)))
    turned = known(np.stack([FLATTENED, CIRCLE]), np.broadcast_to(4e-8 * np.eye(5), (2, 5, 5)))
    table = quantities(stack, turned)
    assert table["section"].tolist() == [0] * 5 + [1] * 5
    for section in range(2):
        one = quantities(
            *(known(fit.regular[section], fit.regular_cofactor[section]) for fit in (stack, turned))
        )
        pd.testing.assert_frame_equal(
            one, table[table["section"] == section].assign(section=0).reset_index(drop=True)
        )


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
    ],
)
def test_bad_input(call, message):
    with pytest.raises(ValueError, match=message):
        call()
