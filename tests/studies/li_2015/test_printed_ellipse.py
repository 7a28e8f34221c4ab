"""The ellipsoid of the paper is correct where it exists; the ellipse in the plane always exists."""

import numpy as np
import pytest

import analysis
from analysis.surfaces.conic import direct_from_points
from studies.li_2015.printed_ellipse import (
    SECTION_AXES,
    SEEN,
    ellipsoid,
    failure_study,
    section_points,
    semi_axes_in_plane,
)

PLANE = np.array([0.3, -0.2, 1.5])
CENTER = np.array([1.0, -0.3 * 1.0 + 0.2 * 2.0 - 1.5, 2.0])  # in the plane
SEMI_AXES = np.array([2.7, 3.1, 2.6])


def outline(center, semi_axes, plane):
    """Eq. (13): the conic (6,) in (x, z) of an ellipsoid cut by the plane."""
    a, b, c = center
    i1, i2, i3 = 1.0 / np.asarray(semi_axes, dtype=float) ** 2
    k, kk, m = plane
    n = m + b
    quadratic = [i1 + k * k * i2, 2.0 * k * kk * i2, i3 + kk * kk * i2]
    linear = [-2.0 * a * i1 + 2.0 * k * n * i2, -2.0 * c * i3 + 2.0 * kk * n * i2]
    return np.array([*quadratic, *linear, a * a * i1 + n * n * i2 + c * c * i3 - 1.0])


def test_the_outline_goes_through_the_points_of_the_ellipsoid_in_the_plane():
    k, kk, m = PLANE
    rng = np.random.default_rng(1)
    # From the centre in random directions of the plane to the surface.
    steps = rng.standard_normal((20, 2))
    directions = np.column_stack([steps[:, 0], -k * steps[:, 0] - kk * steps[:, 1], steps[:, 1]])
    points = CENTER + directions / np.linalg.norm(directions / SEMI_AXES, axis=1, keepdims=True)
    np.testing.assert_allclose(points @ [k, 1, kk], -m, atol=1e-14)
    x, _, z = points.T
    values = outline(CENTER, SEMI_AXES, PLANE) @ np.array([x * x, x * z, z * z, x, z, np.ones(20)])
    np.testing.assert_allclose(values, 0, atol=1e-14)


def test_the_system_is_solved_by_what_made_it_whatever_the_factor():
    found = ellipsoid(-7.0 * outline(CENTER, SEMI_AXES, PLANE), PLANE)
    np.testing.assert_allclose(found.center, CENTER, atol=1e-13)
    np.testing.assert_allclose(found.semi_axes, SEMI_AXES, rtol=1e-12)
    assert found.real


def test_another_ellipsoid_has_the_same_section():
    """An ellipsoid moved out of the plane and enlarged has that conic times a factor."""
    conic = outline(CENTER, SEMI_AXES, PLANE)
    k, kk, _ = PLANE
    # conjugate to the plane: the shift along which the sections stay homothetic and concentric
    t = 0.4
    moved = CENTER + t * SEMI_AXES**2 * np.array([k, 1.0, kk])
    grown = SEMI_AXES * np.sqrt(1.0 + t**2 * np.sum((SEMI_AXES * [k, 1.0, kk]) ** 2))
    other = outline(moved, grown, PLANE)
    np.testing.assert_allclose(other / other[0], conic / conic[0], rtol=1e-12)


def test_a_tunnel_along_y_has_no_ellipsoid():
    conic = outline([0, 0, 0], SEMI_AXES, [0, 0, 0])
    assert not ellipsoid(conic, [0, 0, 0]).real
    tilted = conic + [0, 0.001, 0, 0, 0, 0]
    assert not ellipsoid(tilted, [0, 0, 0]).real
    assert np.isnan(ellipsoid(tilted, [0, 0, 0]).center).all()


@pytest.mark.parametrize("noise", [0.0, 0.003])
def test_the_metric_of_the_plane_gives_the_ellipse_in_the_plane(noise):
    """The direct fit is the same in any affine coordinates, so this holds with noise as well."""
    rng = np.random.default_rng(2)
    angles, errors = rng.uniform(-SEEN, SEEN, (3, 200)), noise * rng.standard_normal((3, 200, 2))
    plane = np.array([[0.02, -0.01, 0.0], [0.3, 0.2, 0.0], [0.0, 0.0, 0.0]])
    conic, _ = direct_from_points(section_points(plane, 0.2, angles, errors), np.ones((3, 200)))
    found = semi_axes_in_plane(conic, plane)
    c, s = np.cos(0.2), np.sin(0.2)
    p, q = SECTION_AXES[0] * np.sin(angles), SECTION_AXES[1] * np.cos(angles)
    in_plane = np.stack([c * p - s * q, s * p + c * q], axis=-1) + errors
    np.testing.assert_allclose(
        found, analysis.fit_ellipse(in_plane, "direct").semi_axes, rtol=1e-10
    )
    if noise == 0.0:
        np.testing.assert_allclose(found, np.broadcast_to(SECTION_AXES, (3, 2)), rtol=1e-11)


def test_semi_axes_in_plane_are_nan_without_an_ellipse():
    assert np.isnan(semi_axes_in_plane([1.0, 0, 1, 0, 0, 4], [0.1, 0, 0])).all()
    assert np.isnan(semi_axes_in_plane([1.0, 0, -1, 0, 0, -4], [0.1, 0, 0])).any()


def test_how_often_the_printed_solution_is_imaginary():
    """Upright in its plane: for a third of the planes within 0.02 of Y; tilted by 10°: for half."""
    study = failure_study([0.02], [360], [0.0, 10.0], trials=400).set_index("tilt_deg")
    assert 0.28 < study["imaginary"][0.0] < 0.42
    assert 0.40 < study["imaginary"][10.0] < 0.55
    assert study["lambda2_median_m"][10.0] < 1.0  # of a section with 2.7 m everywhere
    assert (study["minor_rms_mm"] < 0.7).all()
    # The ellipse in the plane is exact without noise.
    exact = failure_study([0.02], [360], [0.0], trials=50, noise=0.0)
    assert exact["minor_rms_mm"][0] < 1e-6
