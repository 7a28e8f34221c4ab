"""The bias of second order: its curvatures, its size, and what is left of it."""

import numpy as np
import pytest
from scipy.stats import f as fisher

import analysis
from analysis.orthogonal.contracts import GeometricModel
from analysis.surfaces.cylinder import CylinderModel
from analysis.surfaces.ellipse import EllipseModel
from analysis.surfaces.plane import PlaneModel
from analysis.surfaces.sphere import SphereModel

CENTRE, RADIUS = np.array([0.6, -0.4, 3.0]), 1.0
SECTION = np.array([0.3, -0.2, 1.0, 0.2, 0.1])  # u0, v0, m, g, h


def cap(shape, rng, half_angle=80.0):
    """Unit vectors (…, 3) evenly within ``half_angle`` degrees of the z axis."""
    z, turn = rng.uniform(np.cos(np.radians(half_angle)), 1.0, shape), rng.uniform(size=shape)
    s, turn = np.sqrt(1.0 - z * z), 2.0 * np.pi * turn
    return np.stack([s * np.cos(turn), s * np.sin(turn), z], axis=-1)


def arc(shape, rng):
    """Places (…, 2) on seven tenths of the ellipse SECTION."""
    turn = rng.uniform(-0.2 * np.pi, 1.2 * np.pi, shape)
    m, g, h = SECTION[2:]
    e = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    return SECTION[:2] + e @ np.array([[m + g, h], [h, m - g]])


def covariances(n, rng, dim=3):
    axes = np.linalg.qr(rng.standard_normal((n, dim, dim)))[0]
    return (axes * rng.uniform(0.1, 3.0, (n, 1, dim))) @ axes.swapaxes(-1, -2)


# A surface seen only in part: its places (…, n, dim), its fit, the numbers that are free.
def on_sphere(shape, rng):
    return CENTRE + RADIUS * cap(shape, rng)


def on_cylinder(shape, rng):
    section = arc(shape, rng)
    return np.stack([section[..., 0], rng.uniform(-1, 1, shape), section[..., 1]], axis=-1)


def of_sphere(points, **given):
    return analysis.fit_sphere(points, **given).parameters


def of_ellipse(points, **given):
    return analysis.fit_ellipse(points, **given).regular


def of_cylinder(points, **given):
    """m, g and h alone: offsets depend on where along the axis the point is."""
    return analysis.fit_elliptic_cylinder(points, axis=[0.0, 1.0, 0.0], **given).regular[..., 12:]


TURNED = np.eye(3)[[0, 2, 1]] * [[1], [1], [-1]]
SURFACES = {
    "sphere": (on_sphere, of_sphere, np.append(CENTRE, RADIUS)),
    "ellipse": (arc, of_ellipse, SECTION),
    "cylinder": (on_cylinder, of_cylinder, SECTION[2:]),
}
every_surface = pytest.mark.parametrize("surface", SURFACES)
every_kind = pytest.mark.parametrize("kind", ["none", "variances", "full"])


def noisy(surface, kind, shape, sigma, seed):
    """Points (2, …, n, dim) with errors e and −e, and their cofactors (n,) or (n, dim, dim)."""
    rng = np.random.default_rng(seed)
    places = SURFACES[surface][0](shape, rng)
    n, dim = places.shape[-2:]
    Q = {"none": None, "variances": rng.uniform(0.2, 3.0, n), "full": covariances(n, rng, dim)}[
        kind
    ]
    full = Q if kind == "full" else (np.ones(n) if Q is None else Q)[:, None, None] * np.eye(dim)
    errors = (np.linalg.cholesky(full) @ rng.standard_normal((*places.shape, 1)))[..., 0]
    return places + sigma * np.array([1.0, -1.0]).reshape((2,) + (1,) * places.ndim) * errors, Q


# ------------------------------------------------------------------------------ curvature


MODELS: dict[str, tuple[GeometricModel, np.ndarray]] = {
    "sphere": (SphereModel(), np.append(CENTRE, RADIUS)),
    "plane": (PlaneModel(), np.array([0.6, 0.0, 0.8, 0.3])),
    "ellipse": (EllipseModel(), SECTION),
    "cylinder": (
        CylinderModel(),
        np.concatenate([[*SECTION[:1], 0.0, *SECTION[1:2]], TURNED.ravel(), SECTION[2:]]),
    ),
}


@pytest.mark.parametrize("surface", MODELS)
def test_curvature_is_the_derivative_of_the_normals(surface):
    model, x = MODELS[surface]
    rng = np.random.default_rng(1)
    points = CENTRE[: model.dimension] + rng.standard_normal((40, model.dimension))
    feet = points
    for _ in range(3):  # a plane's or a sphere's distance is exact, and the others' too
        feet = feet - model.linearised(x, feet)[0][:, None] * model.normals(x, feet)
    h = 1e-5
    steps = h * np.eye(model.dimension)
    numeric = np.stack(
        [(model.normals(x, feet + s) - model.normals(x, feet - s)) / (2 * h) for s in steps], -1
    )
    np.testing.assert_allclose(model.curvature(x, feet), numeric, atol=1e-6)
    # that of the foot, from where ever it is asked for
    np.testing.assert_allclose(
        model.curvature(x, feet + 0.1 * model.normals(x, feet)), model.curvature(x, feet), atol=1e-9
    )


# ------------------------------------------------------------------------------ closed forms


@pytest.mark.parametrize("method", ["geometric", "robust"])
def test_of_equally_precise_points_it_is_sigma_squared_over_r(method):
    points = noisy("sphere", "none", (80,), 0.01, 2)[0][0]
    plain = analysis.fit_sphere(points, method, bias_correction=False)
    ours = analysis.fit_sphere(points, method, bias_correction=True)
    bias = plain.sigma_0**2 / plain.radius
    np.testing.assert_allclose(ours.center, plain.center, rtol=0, atol=1e-12)
    np.testing.assert_allclose(ours.radius, plain.radius - bias, rtol=1e-12)
    # σ̂² is known to √(2/ν) of itself, and so is the bias
    further = ours.covariance - plain.covariance
    np.testing.assert_allclose(
        further[3, 3], 2.0 / (plain.weights.sum() - 4.0) * bias**2, rtol=1e-6
    )
    further[3, 3] = 0.0
    np.testing.assert_allclose(further, 0.0, atol=1e-9 * ours.covariance[3, 3])
    distances = np.linalg.norm(points - ours.center, axis=1) - ours.radius
    np.testing.assert_allclose(ours.distances, distances, rtol=0, atol=1e-14)


def test_of_a_circle_it_is_half_of_that():
    rng = np.random.default_rng(3)
    turn = rng.uniform(0, 2 * np.pi, 100)
    points = np.column_stack([np.cos(turn), np.sin(turn)]) + 0.02 * rng.standard_normal((100, 2))
    plain = analysis.fit_ellipse(points, "geometric", bias_correction=False)
    m, ours = plain.regular[2], analysis.fit_ellipse(points).regular[2]
    # The fit is nearly a circle.
    assert m - ours == pytest.approx(plain.sigma_0**2 / (2 * m), rel=0.1)


def test_variances_that_are_known_are_taken_as_they_are():
    points = noisy("sphere", "none", (80,), 0.01, 4)[0][0]
    known = {"cofactors": np.full(80, 0.02**2), "absolute": True}
    plain = analysis.fit_sphere(points, "geometric", bias_correction=False, **known)
    ours = analysis.fit_sphere(points, "geometric", bias_correction=True, **known)
    np.testing.assert_allclose(ours.radius, plain.radius - 0.02**2 / plain.radius, rtol=1e-12)
    np.testing.assert_array_equal(ours.covariance, plain.covariance)


def test_a_plane_has_none():
    rng = np.random.default_rng(5)
    points = rng.uniform(-1, 1, (60, 3)) * [1, 1, 0] + 0.05 * rng.standard_normal((60, 3))
    for given in ({}, {"cofactors": covariances(60, rng)}):
        plain, ours = (
            analysis.fit_plane(points, bias_correction=on, **given) for on in (False, True)
        )
        np.testing.assert_allclose(ours.parameters, plain.parameters, rtol=0, atol=1e-15)
        np.testing.assert_array_equal(ours.cofactor, plain.cofactor)


# ------------------------------------------------------------------------------ in the mean


@every_kind
@every_surface
def test_it_vanishes_with_the_square_of_the_noise(surface, kind):
    _, fit, _ = SURFACES[surface]
    taken = []
    for sigma in (0.001, 0.002):
        points, Q = noisy(surface, kind, (200,), sigma, 6)
        plain, ours = (
            fit(points, method="geometric", cofactors=Q, bias_correction=on) for on in (False, True)
        )
        taken.append(np.mean(plain - ours, axis=0))  # of e and −e: without the terms of third order
    np.testing.assert_allclose(taken[1], 4.0 * taken[0], rtol=0.02, atol=0.01 * np.max(taken[1]))


@every_kind
@every_surface
def test_what_is_taken_off_is_the_mean_error(surface, kind):
    """Of pairs of clouds with errors e and −e: all that is odd in σ cancels.

    With so many points that terms of the order σ²/n are small.
    """
    _, fit, truth = SURFACES[surface]
    points, Q = noisy(surface, kind, (20 if surface == "cylinder" else 60, 400), 0.02, 7)
    given = {"cofactors": None if Q is None else np.broadcast_to(Q, (*points.shape[:2], *Q.shape))}
    of_plain, of_ours = (
        fit(points, method="geometric", bias_correction=on, **given).mean(axis=0) - truth
        for on in (False, True)
    )

    def standardised(errors):
        return errors.mean(axis=0) / (errors.std(axis=0, ddof=1) / np.sqrt(len(errors)))

    assert np.abs(standardised(of_plain)).max() > 5.0
    assert np.abs(standardised(of_ours)).max() < 3.5


def test_of_a_held_radius_the_centre_is_freed_of_it():
    points, Q = noisy("sphere", "full", (300, 60), 0.03, 8)
    given = {"cofactors": np.broadcast_to(Q, (2, 300, *Q.shape)), "radius": RADIUS}
    means, errors = [], []
    for on in (False, True):
        error = (
            analysis.fit_sphere(points, "geometric", bias_correction=on, **given).center - CENTRE
        )
        error = error.mean(axis=0)
        means.append(error.mean(axis=0)[2])
        errors.append(error.std(axis=0)[2] / np.sqrt(300))
    assert abs(means[0]) > 20 * errors[0] and abs(means[1]) < 4 * errors[1]


def test_the_ellipsoid_of_a_sphere_from_many_points_holds_the_truth():
    """The bias of the radius, 0.055 mm, is its standard deviation here.

    Given the centre, the radius is known several times better.
    """
    rng = np.random.default_rng(9)
    points = 0.0725 * cap((150, 10_000), rng) + 0.002 * rng.standard_normal((150, 10_000, 3))
    held = []
    for on in (False, True):
        fit = analysis.fit_sphere(points, "geometric", bias_correction=on)
        error = (fit.parameters - [0, 0, 0, 0.0725])[..., None]
        square = (error.swapaxes(-1, -2) @ np.linalg.solve(fit.covariance, error))[:, 0, 0]
        held.append(np.mean(square <= 4.0 * fisher.ppf(0.95, 4, 9_996)))
    assert held[0] < 0.6 and 0.89 < held[1]


# ------------------------------------------------------------------------------ where it ends


def test_without_redundancy_nothing_is_taken_off():
    points = noisy("sphere", "none", (4,), 0.01, 10)[0][0]
    plain, ours = (
        analysis.fit_sphere(points, "geometric", bias_correction=on) for on in (False, True)
    )
    np.testing.assert_array_equal(ours.parameters, plain.parameters)
    np.testing.assert_array_equal(ours.cofactor, plain.cofactor)
    given = {"cofactors": np.full(4, 1e-4), "absolute": True}
    known = analysis.fit_sphere(points, "geometric", bias_correction=True, **given)
    assert known.radius == pytest.approx(plain.radius - 1e-4 / plain.radius, rel=1e-9)


def test_errors_as_large_as_the_sphere_leave_it_as_it_is():
    """r − σ²/r would be negative."""
    rng = np.random.default_rng(11)
    points = 0.05 * rng.standard_normal((200, 3))
    points[:40] *= 100.0
    points = np.vstack([points, -points])  # so that no sphere to one side is better
    plain, ours = (
        analysis.fit_sphere(points, "geometric", bias_correction=on) for on in (False, True)
    )
    assert plain.sigma_0 > 0.5 * plain.radius
    np.testing.assert_array_equal(ours.parameters, plain.parameters)
