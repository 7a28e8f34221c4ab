"""The start of a robust fit: more than half of clutter, heaps, small targets of known radius."""

import numpy as np
import pytest

import analysis
from analysis.orthogonal.start import _samples, draw_distinct

SD = 0.001


def cap(rng, n, radius=0.1, center=(0.0, 0.0, 0.0)):
    """The half of a sphere that a scanner at −x sees."""
    u = rng.standard_normal((n, 3))
    u /= np.linalg.norm(u, axis=-1, keepdims=True)
    u[:, 0] = -np.abs(u[:, 0])
    return np.array(center) + radius * u + SD * rng.standard_normal((n, 3))


def even(rng, n):
    return rng.uniform(-0.3, 0.3, (n, 3))


def wall(rng, n):
    return np.column_stack([np.full(n, 0.15), rng.uniform(-0.3, 0.3, (n, 2))]) + SD * (
        rng.standard_normal((n, 3))
    )


def is_right(fit, center=(0.0, 0.0, 0.0), radius=0.1):
    error = np.append(fit.center - center, fit.radius - radius)
    return np.abs(error).max() < 20 * SD / np.sqrt(np.count_nonzero(fit.inliers))


@pytest.mark.parametrize("clutter", [even, wall])
@pytest.mark.parametrize("n", [100, 1000])
@pytest.mark.parametrize("share", [0.3, 0.5, 0.6])
def test_a_sphere_of_the_smaller_half_is_found(clutter, n, share):
    rng = np.random.default_rng([n, int(100 * share)])
    bad = round(share * n)
    for _ in range(5):
        fit = analysis.fit_sphere(np.concatenate([cap(rng, n - bad), clutter(rng, bad)]))
        assert fit.converged and is_right(fit)


def test_a_plane_and_an_ellipse_of_the_smaller_half_are_found():
    rng = np.random.default_rng(1)
    floor = np.column_stack([rng.uniform(-1, 1, (400, 2)), SD * rng.standard_normal(400)])
    fit = analysis.fit_plane(np.concatenate([floor, rng.uniform(-1, 1, (600, 3))]))
    np.testing.assert_allclose(fit.normal, [0, 0, 1], atol=1e-3)
    turn = rng.uniform(0, 2 * np.pi, 400)
    ring = np.stack([0.3 * np.cos(turn), 0.2 * np.sin(turn)], axis=-1)
    ring += SD * rng.standard_normal(ring.shape)
    fit = analysis.fit_ellipse(np.concatenate([ring, rng.uniform(-0.5, 0.5, (600, 2))]))
    np.testing.assert_allclose(fit.semi_axes, [0.3, 0.2], atol=2e-3)


@pytest.mark.parametrize("clutter", [even, wall])
def test_a_target_of_known_radius_is_found_among_six_times_as_many_points(clutter):
    rng = np.random.default_rng(2)
    for _ in range(5):
        points = np.concatenate([cap(rng, 150), clutter(rng, 850)])
        assert is_right(analysis.fit_sphere(points, radius=0.1))


def test_of_two_spheres_the_one_with_more_points_is_found():
    rng = np.random.default_rng(3)
    other = (0.05, 0.25, 0.05)
    points = np.concatenate([cap(rng, 400), cap(rng, 600, center=other)])
    assert is_right(analysis.fit_sphere(points), other)


@pytest.mark.parametrize("share", [0.06, 0.3, 0.6])
def test_a_heap_of_equal_points_is_one_point(share):
    """Rows ``0 0 0`` of missing returns, in clouds smaller and larger than what is looked at."""
    rng = np.random.default_rng(4)
    for n in (200, 5000):
        points = np.concatenate([[5.0, 2.0, 1.0] + cap(rng, n), np.zeros((round(share * n), 3))])
        fit = analysis.fit_sphere(points)
        assert is_right(fit, (5.0, 2.0, 1.0))
        assert not fit.inliers[n:].any()


def test_a_heap_in_one_cloud_leaves_the_others_of_its_stack_alone():
    rng = np.random.default_rng(5)
    clouds = np.stack([cap(rng, 300) for _ in range(4)])
    clouds[2, :60] = 0.0
    together = analysis.fit_sphere(clouds)
    for cloud, parameters in zip(clouds, together.parameters, strict=True):
        np.testing.assert_allclose(analysis.fit_sphere(cloud).parameters, parameters, rtol=1e-11)


@pytest.mark.parametrize("method", ["geometric", "robust"])
def test_fewer_places_than_parameters_are_refused(method):
    """Six corners of a cube, not in a plane: too few for the seven of an elliptic cylinder."""
    corners = np.stack(np.meshgrid([0.0, 1.0], [0.0, 1.0], [0.0, 1.0]), axis=-1).reshape(-1, 3)
    heaps = np.stack([corners[np.arange(40) % 8], corners[np.arange(40) % 6]])
    with pytest.raises(ValueError, match="6 different places in cloud 1 of the stack"):
        analysis.fit_elliptic_cylinder(heaps, method)


# ------------------------------------------------------------------------------ parts of it


@pytest.mark.parametrize(("n", "m"), [(6, 4), (12, 5), (50, 3), (1000, 5)])
def test_samples_are_of_different_points_and_reach_all(n, m):
    draws = _samples(n, m, 0, 0)
    assert all(len(set(row)) == m for row in draws.tolist())
    assert draws.min() == 0 and draws.max() < n
    every = np.concatenate([_samples(n, m, 0, turn) for turn in range(30)])
    assert len(np.unique(every)) > 0.9 * n


def test_distinct_numbers_are_uniform():
    drawn = draw_distinct(np.random.default_rng(8), 7, 3, 20_000)
    counts = np.bincount(drawn.ravel(), minlength=7) / drawn.size
    np.testing.assert_allclose(counts, 1 / 7, atol=0.005)
