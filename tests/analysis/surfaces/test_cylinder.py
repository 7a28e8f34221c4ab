"""Elliptic cylinders: exact points, motions, circles, derivatives, covariance, gross errors."""

import numpy as np
import pytest
from scipy.optimize import least_squares

import analysis
from analysis.orthogonal.observations import Points
from analysis.surfaces import cylinder
from analysis.surfaces.cylinder import CylinderModel, section_axes

METHODS = ("geometric", "robust")
every_method = pytest.mark.parametrize("method", METHODS)


def rotation(seed):
    Q, _ = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))
    return Q * np.sign(np.linalg.det(Q))


def surface(n=300, a=2.75, b=2.65, angle=0.4, length=3.0, seed=0, arc=(-np.pi, np.pi), noise=0.0):
    """Points (n, 3) around the y axis.

    The major axis lies ``angle`` from right (x) towards up (z), the noise along the normals.
    """
    generator = np.random.default_rng(seed)
    t, w = generator.uniform(*arc, n), generator.uniform(-0.5, 0.5, n) * length
    normal = np.stack([b * np.cos(t), a * np.sin(t)]) / np.hypot(b * np.cos(t), a * np.sin(t))
    first, second = (
        np.stack([a * np.cos(t), b * np.sin(t)]) + noise * generator.standard_normal(n) * normal
    )
    c, s = np.cos(angle), np.sin(angle)
    return np.column_stack([c * first - s * second, w, s * first + c * second])


def tunnel_with_furniture(n, share, bed, seed, length=3.0, noise=0.003):
    """A tunnel seen over 270°: ``bed`` is a track bed, ``share`` a cabinet 15 cm off the wall."""
    generator = np.random.default_rng(seed)
    m, k = int(share * n), int(bed * n)
    wall = surface(n - m - k, 2.75, 2.70, 0.1, length, seed, (-0.25 * np.pi, 1.25 * np.pi), noise)
    cabinet = surface(m, 2.60, 2.55, 0.1, length, seed + 1, (0.1, 0.4), 0.02)
    u, w = generator.uniform(-1.9, 1.9, k), generator.uniform(-0.5, 0.5, k) * length
    return np.concatenate(
        [wall, cabinet, np.column_stack([u, w, -1.95 + 0.01 * generator.standard_normal(k)])]
    )


# ------------------------------------------------------------------------------ exact data


@every_method
@pytest.mark.parametrize(("a", "b"), [(2.75, 2.70), (2.7, 2.7), (3.0, 1.2)])
@pytest.mark.parametrize("length", [0.3, 3.0, 60.0])
@pytest.mark.parametrize("arc", [(-np.pi, np.pi), (-0.7, 2.5)])
def test_exact_points_give_the_cylinder_in_any_orientation(method, a, b, length, arc):
    seed = round(100 * length)
    R, place = rotation(seed), np.array([400.0, -30.0, 7.0])
    points = place + surface(200, a, b, 0.4, length, seed, arc) @ R.T
    fit = analysis.fit_elliptic_cylinder(points, method)
    assert fit.converged and fit.method == method
    np.testing.assert_allclose(fit.semi_axes, [a, b], rtol=0, atol=1e-9)
    assert abs(fit.direction @ R[:, 1]) == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(np.cross(fit.point - place, fit.direction), 0, atol=1e-9)
    assert (fit.point - points.mean(axis=0)) @ fit.direction == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(fit.distances, 0, atol=1e-9)
    if a > b:
        right, up = section_axes(fit.direction)
        major = np.cos(fit.angle) * right + np.sin(fit.angle) * up
        assert abs(major @ R @ [np.cos(0.4), 0, np.sin(0.4)]) == pytest.approx(1.0, abs=1e-9)


def test_the_section_axes_are_right_and_up():
    t = rotation(3)
    axes = section_axes(t)
    np.testing.assert_allclose(
        axes @ axes.swapaxes(-1, -2), np.broadcast_to(np.eye(2), (3, 2, 2)), atol=1e-15
    )
    np.testing.assert_allclose(np.einsum("kij,kj->ki", axes, t), 0, atol=1e-15)
    np.testing.assert_allclose(axes[:, 0, 2], 0, atol=1e-15)
    assert (axes[:, 1, 2] > 0).all()
    np.testing.assert_array_equal(section_axes(np.array([0.0, 0.0, 1.0])), [[-1, 0, 0], [0, 1, 0]])


@every_method
def test_distances_are_positive_outside(method):
    points = surface(400)
    points[:5] *= [1.1, 1.0, 1.1]
    points[5:10] *= [0.9, 1.0, 0.9]
    fit = analysis.fit_elliptic_cylinder(points, method)
    assert (fit.distances[:5] > 0.1).all() and (fit.distances[5:10] < -0.1).all()


# ------------------------------------------------------------------------------ motions


@every_method
def test_motion_scale_and_order_of_the_points(method):
    points = tunnel_with_furniture(600, 0.15, 0.15, seed=5)
    fit = analysis.fit_elliptic_cylinder(points, method)
    R, place, scale = rotation(8), np.array([5e5, 4e6, 100.0]), 7.0
    order = np.random.default_rng(0).permutation(len(points))
    moved = analysis.fit_elliptic_cylinder(place + scale * points[order] @ R.T, method)
    sign = np.sign(moved.direction @ R @ fit.direction)
    np.testing.assert_allclose(sign * moved.direction, R @ fit.direction, atol=1e-8)
    np.testing.assert_allclose(moved.point, place + scale * R @ fit.point, atol=1e-7)
    np.testing.assert_allclose(moved.semi_axes, scale * fit.semi_axes, atol=1e-7)
    np.testing.assert_allclose(moved.distances, scale * fit.distances[order], atol=1e-7)
    np.testing.assert_allclose(moved.weights, fit.weights[order], atol=1e-5)
    assert moved.sigma_0 == pytest.approx(scale * fit.sigma_0, rel=1e-6)


def test_a_stack_is_its_clouds():
    stack = np.stack([tunnel_with_furniture(300, 0.1, 0.1, seed) for seed in range(3)])
    fit = analysis.fit_elliptic_cylinder(stack)
    assert (
        fit.direction.shape == (3, 3)
        and fit.semi_axes.shape == (3, 2)
        and fit.regular_cofactor.shape == (3, 7, 7)
    )
    for k in range(3):
        alone = analysis.fit_elliptic_cylinder(stack[k])
        # a product sums in an order of its own
        np.testing.assert_allclose(fit.parameters[k], alone.parameters, rtol=1e-10, atol=1e-13)
        np.testing.assert_allclose(fit.covariance[k], alone.covariance, rtol=1e-9, atol=1e-18)


def test_a_given_axis_leads_to_the_same_cylinder():
    points = tunnel_with_furniture(800, 0.15, 0.15, seed=9)
    free = analysis.fit_elliptic_cylinder(points)
    led = analysis.fit_elliptic_cylinder(points, axis=(0.05, -3.0, 0.1))
    np.testing.assert_allclose(led.parameters, free.parameters, atol=1e-8)


# ------------------------------------------------------------------------------ other
# implementations


@every_method
def test_the_normal_equations_are_those_of_an_independent_minimisation(method):
    """scipy's least squares of closest points by brute force, from a cylinder a little off."""
    points = surface(150, 2.75, 2.60, 0.4, 4.0, noise=0.01)
    fit = analysis.fit_elliptic_cylinder(points, method, bias_correction=False)
    weights = np.sqrt(fit.weights)
    turn = np.linspace(-np.pi, np.pi, 721)

    def distances(x):
        kx, kz, slope_x, slope_z, a, b, angle = x
        t = np.array([slope_x, 1.0, slope_z]) / np.sqrt(1 + slope_x**2 + slope_z**2)
        right, up = section_axes(t)
        D = points - [kx, 0.0, kz]
        u, v = D @ right, D @ up
        first, second = np.cos(angle) * u + np.sin(angle) * v, np.cos(angle) * v - np.sin(angle) * u
        nearest = turn[
            np.argmin(
                (first[:, None] - a * np.cos(turn)) ** 2
                + (second[:, None] - b * np.sin(turn)) ** 2,
                axis=1,
            )
        ]
        for _ in range(20):
            c, s = np.cos(nearest), np.sin(nearest)
            slope = (first - a * c) * a * s - (second - b * s) * b * c
            nearest = nearest - slope / (
                (a * s) ** 2 + (b * c) ** 2 + (first - a * c) * a * c + (second - b * s) * b * s
            )
        c, s = np.cos(nearest), np.sin(nearest)
        return ((first - a * c) * b * c + (second - b * s) * a * s) / np.hypot(b * c, a * s)

    at_x = fit.point - fit.point[1] / fit.direction[1] * fit.direction
    slopes = fit.direction[[0, 2]] / fit.direction[1]
    ours = np.array([at_x[0], at_x[2], *slopes, *fit.semi_axes, fit.angle])
    np.testing.assert_allclose(distances(ours), fit.distances, atol=1e-10)
    start = ours + [0.01, -0.01, 0.002, 0.001, 0.01, -0.01, 0.05]
    found = least_squares(
        lambda x: weights * distances(x), start, xtol=1e-15, ftol=1e-15, gtol=1e-15
    )
    np.testing.assert_allclose(found.x, ours, atol=2e-7)


def test_derivatives_are_those_of_the_distances():
    points = surface(40, noise=0.2)
    x = analysis.fit_elliptic_cylinder(surface(40) @ rotation(1).T).regular
    points = points @ rotation(1).T
    _, J = CylinderModel().linearised(x, points)
    for k, step in enumerate(1e-6 * np.eye(7)):
        ahead, behind = (
            CylinderModel().linearised(CylinderModel.update(x, s), points)[0] for s in (step, -step)
        )
        np.testing.assert_allclose(J[k], (ahead - behind) / 2e-6, atol=1e-7)
    normals = CylinderModel.normals(x, points)
    for k, step in enumerate(1e-6 * np.eye(3)):
        ahead, behind = (CylinderModel().linearised(x, points + s)[0] for s in (step, -step))
        np.testing.assert_allclose(normals[:, k], (ahead - behind) / 2e-6, atol=1e-7)


@pytest.mark.parametrize("seed", range(4))
def test_derivatives_of_the_parameters(seed):
    """The nine parameters of a moved cylinder, in a steep and in a level direction."""
    fit = analysis.fit_elliptic_cylinder(surface(60, 3.0, 2.0) @ rotation(seed).T, "geometric")
    model, x, J = fit.surface()
    for k, step in enumerate(1e-6 * np.eye(7)):
        moved = []
        for s in (step, -step):
            y = model.update(x, s[None])
            t = y[:, 9:12]
            axes = section_axes(t)
            S = cylinder._frame(y)[:, :2].swapaxes(-1, -2) @ _matrix(y) @ cylinder._frame(y)[:, :2]
            lengths, vectors = np.linalg.eigh(axes @ S @ axes.swapaxes(-1, -2))
            angle = np.arctan2(vectors[:, 1, 1], vectors[:, 0, 1])
            angle = fit.angle + (angle - fit.angle + np.pi / 2) % np.pi - np.pi / 2
            moved.append(np.concatenate([t[0], y[0, :3], lengths[0, ::-1], angle]))
        np.testing.assert_allclose(J[0, :, k], (moved[0] - moved[1]) / 2e-6, atol=1e-6)


def _matrix(x):
    m, g, h = x[0, 12:]
    return np.array([[m + g, h], [h, m - g]])


def test_adjusted_points_are_nearest_in_the_metric_of_their_cofactors():
    generator = np.random.default_rng(4)
    R = rotation(6)
    x = analysis.fit_elliptic_cylinder(surface(60, 3.0, 2.0) @ R.T).regular[None]
    points = surface(12, 3.0, 2.0, noise=0.3, seed=3) @ R.T
    A = generator.standard_normal((12, 3, 3))
    Q = A @ A.swapaxes(-1, -2) + 0.1 * np.eye(3)
    adjusted = CylinderModel.foot_points(x, Points.of(points[None], Q[None]))[0]
    np.testing.assert_allclose(CylinderModel().linearised(x[0], adjusted)[0], 0, atol=1e-12)
    # Lagrange: Q⁻¹(p − p̃) is along the normal there.
    multiplier = np.linalg.solve(Q, (points - adjusted)[..., None])[..., 0]
    np.testing.assert_allclose(
        np.cross(multiplier, CylinderModel.normals(x[0], adjusted)), 0, atol=1e-10
    )
    isotropic = CylinderModel.foot_points(
        x, Points.of(points[None], np.broadcast_to(0.3 * np.eye(3), (1, 12, 3, 3)))
    )[0]
    d, _ = CylinderModel().linearised(x[0], points)
    np.testing.assert_allclose(
        points - isotropic, d[:, None] * CylinderModel.normals(x[0], points), atol=1e-12
    )


@every_method
def test_isotropic_cofactors_in_three_forms(method):
    points = surface(200, noise=0.01)
    variances = np.random.default_rng(1).uniform(0.5, 2.0, len(points)) * 1e-4
    as_variances = analysis.fit_elliptic_cylinder(points, method, cofactors=variances)
    as_weights = analysis.fit_elliptic_cylinder(points, method, weights=1 / variances)
    in_full = analysis.fit_elliptic_cylinder(
        points, method, cofactors=variances[:, None, None] * np.eye(3)
    )
    np.testing.assert_allclose(as_weights.parameters, as_variances.parameters, atol=1e-12)
    np.testing.assert_allclose(in_full.parameters, as_variances.parameters, atol=1e-8)
    np.testing.assert_allclose(
        in_full.covariance[:8, :8], as_variances.covariance[:8, :8], rtol=1e-5, atol=1e-12
    )


# ------------------------------------------------------------------------------ precision


@every_method
@pytest.mark.parametrize("b", [2.70, 2.75])
def test_covariance_is_that_of_repeated_surveys(method, b):
    """Clouds of a 270° arc; the regular parameters also of a circular cylinder.

    Standard deviations within 3.5 of their own.
    """
    trials, n = (300 if method == "geometric" else 100), 150
    tolerance = 3.5 / np.sqrt(2 * trials)
    arc = (-0.25 * np.pi, 1.25 * np.pi)
    clouds = np.stack([surface(n, 2.75, b, 0.4, 3.0, 1, arc)] * trials)
    x = analysis.fit_elliptic_cylinder(clouds[0], "geometric").regular
    normals = CylinderModel.normals(x, clouds[0])
    clouds += 0.003 * np.random.default_rng(2).standard_normal((trials, n, 1)) * normals
    fit = analysis.fit_elliptic_cylinder(clouds, method, axis=(0, 1, 0))
    assert fit.converged.all()
    # Deviations of the regular parameters: the axis where it meets the plane y = 0 and its slopes,
    # and m, g, h.
    away = fit.point - (fit.point[:, 1:2] / fit.direction[:, 1:2]) * fit.direction
    deviations = np.column_stack(
        [away[:, [0, 2]], fit.direction[:, [0, 2]], fit.regular[:, 12:] - x[12:]]
    )
    sd = np.sqrt(np.diagonal(fit.regular_covariance, axis1=-2, axis2=-1))
    along = -fit.point[:, 1]
    to_zero = np.broadcast_to(np.eye(7), (trials, 7, 7)).copy()
    to_zero[:, 0, 2] = to_zero[:, 1, 3] = along
    stated = to_zero @ fit.regular_covariance @ to_zero.swapaxes(-1, -2)
    stated = np.sqrt(np.mean(np.diagonal(stated, axis1=-2, axis2=-1), axis=0))
    np.testing.assert_allclose(deviations.std(axis=0) / stated, 1.0, atol=tolerance)
    assert np.abs(deviations.mean(axis=0) / (stated / np.sqrt(trials))).max() < 3.6
    covered = np.abs(deviations[:, 4:]) <= 1.96 * sd[:, 4:]
    assert 0.91 <= covered.mean() <= 0.98
    assert np.mean(fit.sigma_0) == pytest.approx(0.003, rel=0.02)
    if b < 2.75:
        angle = (fit.angle - 0.4 + np.pi / 2) % np.pi - np.pi / 2
        assert angle.std() == pytest.approx(np.mean(fit.standard_deviations[:, 8]), rel=tolerance)


def test_the_covariance_has_rank_seven_and_scales_with_absolute_cofactors():
    points = surface(100, noise=0.003)
    plain = {"method": "geometric", "bias_correction": False}
    fit = analysis.fit_elliptic_cylinder(
        points, cofactors=np.full(100, 9e-6), absolute=True, **plain
    )
    relative = analysis.fit_elliptic_cylinder(points, **plain)
    np.testing.assert_allclose(fit.covariance, 9e-6 * relative.cofactor, rtol=1e-8, atol=1e-18)
    values = np.linalg.eigvalsh(fit.covariance)
    assert (values[:2] < 1e-12 * values[2]).all()
    np.testing.assert_allclose(
        fit.covariance[:3] @ np.concatenate([fit.direction, np.zeros(6)]), 0, atol=1e-18
    )


def test_a_circular_cylinder_says_that_its_angle_is_unknown():
    fit = analysis.fit_elliptic_cylinder(surface(300, 2.7, 2.7, noise=0.003))
    assert fit.converged
    assert fit.standard_deviations[8] > 0.2
    assert fit.regular_covariance.shape == (7, 7) and np.linalg.cond(fit.regular_covariance) < 1e3


# ------------------------------------------------------------------------------ gross errors


@pytest.mark.parametrize("length", [3.0, 40.0])
@pytest.mark.parametrize(("share", "bed"), [(0.0, 0.3), (0.15, 0.15), (0.2, 0.2)])
def test_robust_stands_furniture_and_track_bed(length, share, bed):
    R = rotation(11)
    for seed in range(2):
        points = tunnel_with_furniture(3000, share, bed, seed, length)
        fit = analysis.fit_elliptic_cylinder(points @ R.T, seed=seed)
        wall = len(points) - int(share * 3000) - int(bed * 3000)
        # 3.5 of the standard deviations of the fit to the wall alone.
        alone = analysis.fit_elliptic_cylinder(points[:wall] @ R.T, "geometric")
        assert (
            np.abs(fit.semi_axes - [2.75, 2.70]) < 3.5 * alone.standard_deviations[6:8] + 1e-4
        ).all()
        assert fit.weights[:wall].mean() > 0.93
        assert not fit.inliers[wall : wall + int(share * 3000)].any()
        assert fit.inliers[len(points) - int(bed * 3000) :].mean() < 0.03


def test_one_gross_error_pulls_the_orthogonal_fit_and_not_the_robust_one():
    points = surface(100, noise=0.003)
    clean = analysis.fit_elliptic_cylinder(points).semi_axes
    points[0] *= [0.7, 1.0, 0.7]
    assert np.abs(analysis.fit_elliptic_cylinder(points).semi_axes - clean).max() < 5e-4
    assert (
        np.abs(analysis.fit_elliptic_cylinder(points, "geometric").semi_axes - clean).max() > 5e-3
    )


def test_reliability_knows_the_cylinder():
    points = surface(80, noise=0.003)
    fit = analysis.fit_elliptic_cylinder(points, "geometric")
    result = analysis.reliability(fit, points)
    assert result.redundancy.sum() == pytest.approx(80 - 7)


# ------------------------------------------------------------------------------ bad input


def test_bad_input_is_refused():
    points = surface(50)
    with pytest.raises(ValueError, match="at least 7 points"):
        analysis.fit_elliptic_cylinder(points[:6])
    with pytest.raises(ValueError, match="in one plane"):
        analysis.fit_elliptic_cylinder(points * [1, 1, 0])
    with pytest.raises(ValueError, match="cloud 1 of the stack"):
        analysis.fit_elliptic_cylinder(np.stack([points, points * [1, 1, 0]]))
    with pytest.raises(ValueError, match="geometric, robust"):
        analysis.fit_elliptic_cylinder(points, "ls")
    for axis in ((0, 0, 0), (1, 2), (0, np.nan, 1)):
        with pytest.raises(ValueError, match="axis"):
            analysis.fit_elliptic_cylinder(points, axis=axis)
    with pytest.raises(ValueError, match="k0"):
        analysis.fit_elliptic_cylinder(points, k0=-1)
