"""The arguments for the simulated cloud hold, and would fail for another cloud."""

import numpy as np
import pytest

from studies.ou_liu_2017 import clouds as simulate
from studies.ou_liu_2017 import evidence


@pytest.fixture(scope="module")
def clouds():
    return simulate.sphere_redraws(1)[0], simulate.sphere_redraws(1, gross=True)[0]


def test_true_distances_of_points_at_known_distances():
    directions = np.array([[0.0, 0.6, 0.8], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    distances = np.array([-2.0, 0.0, 0.5])
    points = simulate.SPHERE_CENTER + directions * (simulate.SPHERE_RADIUS + distances)[:, None]
    np.testing.assert_allclose(evidence.true_distances(points), distances, atol=1e-14)


def test_the_histogram_counts_every_point_once(clouds):
    histogram = evidence.distance_histogram(clouds[0])
    assert histogram["count"].sum() == 500
    assert histogram["expected"].sum() == pytest.approx(500, rel=0.01)
    np.testing.assert_allclose(histogram["upper_m"][:-1], histogram["lower_m"][1:], atol=1e-15)


def test_rounding_to_a_centimetre_predicts_what_it_leaves(clouds):
    row = evidence.rounding((0.01,)).loc[0]
    stack = simulate.sphere_redraws(200)
    distances = np.linalg.norm(stack - simulate.SPHERE_CENTER, axis=-1) - simulate.SPHERE_RADIUS
    assert np.sqrt(np.mean(distances**2)) == pytest.approx(0.01 / np.sqrt(12), rel=0.01)
    assert row["sigma_s_m"] == pytest.approx(0.01 / np.sqrt(12) * np.sqrt(496 / 500))
    assert row["sigma_s_ratio"] == pytest.approx(0.00282 / row["sigma_s_m"])
    assert abs(row["sigma_0_ratio"] - 1) < 0.05


def test_the_printed_ls_errors_fit_the_cap_and_not_the_sphere(clouds):
    cap, both = evidence.cap_or_sphere(clouds[0]).to_dict("records")
    assert max(cap["printed_c_over_sd"], cap["printed_r_over_sd"]) < 2.5
    assert min(both["printed_c_over_sd"], both["printed_r_over_sd"]) > 8


def test_the_side_of_gross_errors_shows_in_the_ratio(clouds):
    printed, inside, outside = evidence.inside_or_outside(*clouds)["ratio"]
    assert printed == pytest.approx(0.912, abs=0.001)
    assert inside < 1 < outside
    assert inside == pytest.approx(printed, abs=0.02)
