"""The printed registration: thirteen parameters with six constraints."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from analysis.similarity import fit_similarity, umeyama
from studies.li_2015.thirteen_parameters import start_study, thirteen_parameters

from ...analysis.test_similarity import (
    TARGETS,
    assert_printed,
    generator,
    grafarend,
    moved,
    noisy,
    rotation,
)


@pytest.mark.parametrize("degrees", [0.0, 0.001, 60.0, 90.0, 135.0, 179.999, 180.0])
@pytest.mark.parametrize("count", [3, 6])
def test_exact_pairs_give_the_truth(degrees, count):
    R, t = rotation(degrees), np.array([10.0, -20.0, 5.0])
    solution = thirteen_parameters(TARGETS[:count], moved(TARGETS[:count], 1.7, R, t))
    np.testing.assert_allclose(solution.scale, 1.7, rtol=1e-13)
    np.testing.assert_allclose(solution.rotation, R, rtol=0, atol=1e-13)
    np.testing.assert_allclose(solution.translation, t, rtol=0, atol=1e-12)


def test_seven_stations_of_grafarend_and_awange():
    x, X, printed = grafarend()
    solution = thirteen_parameters(x, X)
    assert_printed(solution.translation, printed["translation"])
    assert_printed(solution.scale, printed["scale"])
    turn = Rotation.from_matrix(solution.rotation).as_rotvec(degrees=True)
    assert_printed(np.abs(turn) * 3600, printed["rotations"])


def test_thirteen_parameters_are_the_solution_by_svd_for_any_rotation():
    B = 300
    draw = generator(1)
    R = Rotation.from_quat(draw.standard_normal((B, 4))).as_matrix()
    x = np.broadcast_to(TARGETS, (B, 6, 3))
    X = noisy(moved(x, 1.2, R), 0.02, 2)
    for weights in (None, draw.uniform(0.2, 5, (B, 6))):
        mu, R_u, t = umeyama(x, X, weights=weights)
        solution = thirteen_parameters(x, X, weights=weights)
        assert solution.converged.all() and solution.iterations.max() <= 3
        np.testing.assert_allclose(solution.rotation, R_u, rtol=0, atol=1e-12)
        np.testing.assert_allclose(solution.scale, mu, rtol=1e-12)
        np.testing.assert_allclose(solution.translation, t, rtol=0, atol=1e-12)


def test_thirteen_parameters_find_it_from_a_rotation_nearby_but_not_from_any():
    """A scanner looks back along the tunnel: from R = I it converges to a mirrored solution."""
    R = rotation(170, (0, 0, 1))
    X = noisy(moved(TARGETS, 1.0, R), 0.002)
    near = thirteen_parameters(TARGETS, X, start=rotation(110, (0, 0, 1)))
    np.testing.assert_allclose(near.rotation, umeyama(TARGETS, X)[1], rtol=0, atol=1e-12)
    assert near.iterations > 4
    far = thirteen_parameters(TARGETS, X, start=np.eye(3))
    assert far.converged and np.linalg.det(far.rotation) > 0.999
    assert np.abs(far.rotation - R).max() > 1 and far.scale < 0 and far.sigma_0 > 100 * near.sigma_0


def test_cofactor_of_thirteen_parameters_is_that_of_seven():
    x, X = TARGETS, noisy(moved(TARGETS, 1.2, rotation(100)), 0.01)
    weights = np.array([1.0, 2, 3, 1, 0.5, 1])
    solution, fit = (
        thirteen_parameters(x, X, weights=weights),
        fit_similarity(x, X, weights=weights),
    )
    np.testing.assert_allclose(solution.sigma_0, fit.sigma_0, rtol=1e-10)
    # The direction cosines as functions of ω, and the shift at the (weighted) centroid.
    R, J = fit.rotation, np.zeros((13, 7))
    J[:3, :3], J[3, 6] = np.eye(3), 1.0
    for k in range(3):
        J[4:, 3 + k] = turned_rows(R, k)
    np.testing.assert_allclose(
        solution.cofactor, J @ fit.central_cofactor @ J.T, rtol=1e-6, atol=1e-11
    )


def turned_rows(R, k):
    """Derivative of the nine direction cosines by a rotation about axis k, numerically."""
    step = 1e-6
    turn = [Rotation.from_rotvec(sign * step * np.eye(3)[k]).as_matrix() @ R for sign in (1, -1)]
    return ((turn[0] - turn[1]) / (2 * step)).ravel()


def test_unit_matrix_is_a_start_up_to_a_right_angle_only():
    table = start_study(200, seed=1)
    assert list(table["from_deg"]) == [0, 30, 60, 90, 120, 150]
    assert (table["found_from_svd_percent"] == 100).all()
    assert (table["found_from_identity_percent"][:3] == 100).all()
    assert (np.diff(table["found_from_identity_percent"][2:]) < 0).all() and table[
        "found_from_identity_percent"
    ][5] < 50
    # The failures look like successes, but for the sign of the scale.
    assert table["wrong_but_converged_percent"][5] > 30
    for column in ("wrong_but_proper_percent", "wrong_with_negative_scale_percent"):
        np.testing.assert_array_equal(table[column], table["wrong_but_converged_percent"])
    total = table[
        ["found_from_identity_percent", "wrong_but_converged_percent", "not_converged_percent"]
    ].sum(axis=1)
    np.testing.assert_allclose(total, 100.0)


def test_bad_start_is_refused():
    for start, message in [
        (2 * np.eye(3), "rotation matrices"),
        (np.diag([1.0, 1, -1]), "rotation matrices"),
        (np.eye(2), "shape"),
    ]:
        with pytest.raises(ValueError, match=message):
            thirteen_parameters(TARGETS, TARGETS, start=start)


def test_stopping_too_early_is_said():
    X = noisy(moved(TARGETS, 1.3, rotation(70)), 0.5, 2)
    with_one = thirteen_parameters(TARGETS, X, start=np.eye(3), max_iterations=1)
    assert not with_one.converged
