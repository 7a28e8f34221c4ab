"""The ellipse: feet and conics, what each method minimises, breakdown, covariance."""

import tomllib
import warnings
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.stats import f as fisher

import analysis
from analysis.adjustment.linalg import propagate
from analysis.orthogonal.observations import Points
from analysis.result import ConvergenceWarning
from analysis.surfaces import conic
from analysis.surfaces.ellipse import EllipseModel, _eccentric

every_method = pytest.mark.parametrize("method", analysis.ELLIPSE_METHODS)
CONSISTENT = ("geometric", "robust")
# A tunnel section as in Li et al. 2015: R about 2.7 m, 22 mm between the axes, seen from the left
# rail over the crown to the right one.
SECTION = np.array([10.0, -4.0, 2.711, 2.689, 0.4])
FLAT = np.array([10.0, -4.0, 3.0, 1.0, 2.1])
SEEN = 0.75 * np.pi


def ellipse(parameters, angles):
    """Points (…, n, 2) at eccentric angles, counted from the upper v axis to both sides."""
    u0, v0, a, b, phi = np.moveaxis(np.asarray(parameters, dtype=float), -1, 0)
    c, s = np.cos(phi), np.sin(phi)
    ct, st = a * np.sin(angles), b * np.cos(angles)
    return np.stack([u0 + c * ct - s * st, v0 + s * ct + c * st], axis=-1)


def section(n, rng, parameters=SECTION, sigma=0.003, seen=SEEN):
    """Noisy points (*n, 2)."""
    angles = rng.uniform(-seen, seen, n)
    return ellipse(parameters, angles) + sigma * rng.standard_normal((*np.shape(angles), 2))


def regular(parameters):
    u0, v0, a, b, phi = parameters
    return np.array(
        [u0, v0, 0.5 * (a + b), 0.5 * (a - b) * np.cos(2 * phi), 0.5 * (a - b) * np.sin(2 * phi)]
    )


def quietly(*args, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        return analysis.fit_ellipse(*args, **options)


# ------------------------------------------------------------------------------------ geometry


@pytest.mark.parametrize("a, b", [(3.0, 1.0), (2.711, 2.689), (2.0, 2.0), (1.0, 1e-3)])
def test_the_foot_is_the_nearest_place_for_every_point(a, b):
    # with the centre, both axes, and places inside the evolute
    grid = np.linspace(-1.5 * a, 1.5 * a, 13)
    X, Y = (array.ravel() for array in np.meshgrid(grid, grid * b / a))
    cos, sin = _eccentric(X, Y, a, b)
    np.testing.assert_allclose(np.hypot(cos, sin), 1.0, rtol=1e-15)
    found = np.hypot(X - a * cos, Y - b * sin)
    t = np.linspace(0, 2 * np.pi, 20_001)[:, None]
    nearest = np.hypot(X - a * np.cos(t), Y - b * np.sin(t)).min(axis=0)
    assert np.all(found <= nearest + 1e-12)
    # The residual is along the normal: the equation of the foot, of which the nearest place is one
    # of four roots.
    normal = (a * a - b * b) * cos * sin - X * a * sin + Y * b * cos
    assert np.abs(normal).max() < 1e-13 * a * a


@pytest.mark.parametrize(
    "x",
    [regular(SECTION), regular(FLAT), [10.0, -4.0, 2.7, 0.0, 0.0]],
    ids=["section", "flat", "circle"],
)
def test_distances_and_their_derivatives(x):
    x, model = np.array(x), EllipseModel()
    rng = np.random.default_rng(1)
    D = x[:2] + 2.7 * rng.standard_normal((50, 2))
    d, J = model.linearised(x, D)
    normals = model.normals(x, D)
    step = 1e-6
    for i, delta in enumerate(step * np.eye(5)):
        slope = (model.linearised(x + delta, D)[0] - model.linearised(x - delta, D)[0]) / (2 * step)
        np.testing.assert_allclose(slope, J[i], atol=2e-8)
    for i, delta in enumerate(step * np.eye(2)):
        slope = (model.linearised(x, D + delta)[0] - model.linearised(x, D - delta)[0]) / (2 * step)
        np.testing.assert_allclose(slope, normals[:, i], atol=2e-8)
    np.testing.assert_allclose(model.linearised(x, D - d[:, None] * normals)[0], 0, atol=1e-14)
    u, v = D.T
    assert np.array_equal(
        d > 0, conic.conic_of(x) @ np.array([u * u, u * v, v * v, u, v, np.ones_like(u)]) > 0
    )


def test_first_order_distances_are_right_near_the_ellipse_and_everywhere_from_a_circle():
    rng, model = np.random.default_rng(2), EllipseModel()
    x = np.array([0.1, -0.2, 1.0, 0.2, -0.1])
    near = ellipse(conic.axes_of(x)[0], rng.uniform(0, 7, 40)) + 1e-4 * rng.standard_normal((40, 2))
    np.testing.assert_allclose(
        model.distances(x[None, None], near[None])[0, 0], model.linearised(x, near)[0], atol=2e-8
    )
    x[3:] = 0
    far = rng.standard_normal((40, 2))
    np.testing.assert_allclose(
        model.distances(x[None, None], far[None])[0, 0], model.linearised(x, far)[0], atol=1e-13
    )


def test_places_nearest_in_the_metric_of_the_cofactors():
    """Against a search along the ellipse."""
    rng = np.random.default_rng(3)
    axes = np.linalg.qr(rng.standard_normal((1, 30, 2, 2)))[0]
    Q = (axes * rng.uniform(0.1, 10.0, (1, 30, 1, 2))) @ axes.swapaxes(-1, -2)
    D = 2.0 * rng.standard_normal((1, 30, 2))
    x = np.array([[0.2, 0.1, 2.0, 0.5, -0.4]])
    adjusted = EllipseModel.foot_points(x, Points.of(D, Q))
    candidates = ellipse(conic.axes_of(x[0])[0], np.linspace(0, 2 * np.pi, 20_001))

    def cost(places):
        e = D[0] - places
        return np.einsum("...i,...i->...", e, np.linalg.solve(Q[0], e[..., None])[..., 0])

    ours, best = cost(adjusted[0]), cost(candidates[:, None]).min(axis=0)
    np.testing.assert_allclose(EllipseModel().linearised(x, adjusted)[0], 0, atol=1e-13)
    assert np.all(ours <= best + 1e-12) and np.all(ours >= best - 1e-4)


@pytest.mark.parametrize("parameters", [SECTION, FLAT, [0, 0, 1, 1, 0], [1, 2, 1, 0.05, 3.0]])
def test_conics_and_back(parameters):
    x = regular(parameters)
    shifted = x - np.array([10, -4, 0, 0, 0])
    np.testing.assert_allclose(
        conic.ellipse_of(-3.0 * conic.conic_of(shifted)), shifted, atol=1e-13 / parameters[3] ** 2
    )
    np.testing.assert_allclose(conic.axes_of(x)[0][:4], parameters[:4], atol=1e-14)
    u, v = ellipse(conic.axes_of(shifted)[0], np.linspace(0, 6, 9)).T
    values = conic.conic_of(shifted) @ np.array([u * u, u * v, v * v, u, v, np.ones_like(u)])
    np.testing.assert_allclose(values, 0, atol=1e-12 / parameters[3] ** 2)


def test_through_five_points_or_none():
    five = ellipse(FLAT, np.array([0.0, 1.0, 2.5, 4.0, 5.0])) - FLAT[:2]
    hyperbola = np.array([[1, 1], [2, 0.5], [4, 0.25], [0.5, 2], [-1, -1.0]])
    line = np.array([[0, 0], [1, 1], [2, 2], [3, 3], [5, 1.0]])
    found = conic.minimal_fit(np.stack([five, hyperbola, line]))
    np.testing.assert_allclose(conic.axes_of(found[0])[0][2:], FLAT[2:], rtol=1e-13)
    assert np.isnan(found[1]).any() and np.isnan(found[2]).any()


# -------------------------------------------------------------------------------- the methods


@every_method
@pytest.mark.parametrize(
    "parameters", [SECTION, FLAT, [3, 2, 1, 1, 0]], ids=["section", "flat", "circle"]
)
def test_exact_points_give_the_truth(method, parameters):
    points = ellipse(parameters, np.random.default_rng(4).uniform(-SEEN, SEEN, 40))
    fit = analysis.fit_ellipse(points, method)
    np.testing.assert_allclose(fit.regular, regular(parameters), atol=1e-12)
    np.testing.assert_allclose(fit.center, parameters[:2], atol=1e-12)
    np.testing.assert_allclose(fit.semi_axes, parameters[2:4], atol=1e-12)
    if parameters[2] > parameters[3]:
        np.testing.assert_allclose(fit.angle, parameters[4], atol=1e-10)
    assert fit.semi_axes[0] >= fit.semi_axes[1] and 0 <= fit.angle < np.pi
    assert np.isfinite(fit.covariance).all() and fit.converged and fit.sigma_s < 1e-12


MOTIONS = {
    "translation": (1.0, 0.0, np.array([300.0, -70.0])),
    "rotation": (1.0, 2.0, np.zeros(2)),
    "scale": (1000.0, 0.0, np.zeros(2)),
}


@every_method
@pytest.mark.parametrize("motion", MOTIONS)
def test_moved_points_give_the_moved_ellipse(method, motion):
    scale, turn, shift = MOTIONS[motion]
    R = scale * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    points = section((60,), np.random.default_rng(5), FLAT, 0.02)
    points[:6] += 0.5
    before, after = (
        analysis.fit_ellipse(points, method),
        analysis.fit_ellipse(points @ R.T + shift, method),
    )
    np.testing.assert_allclose(after.center, R @ before.center + shift, rtol=1e-9)
    np.testing.assert_allclose(after.semi_axes, scale * before.semi_axes, rtol=1e-9)
    np.testing.assert_allclose(after.angle, np.mod(before.angle + turn, np.pi), rtol=1e-9)
    np.testing.assert_allclose(after.distances, scale * before.distances, atol=1e-9 * scale)
    np.testing.assert_allclose(
        after.standard_deviations[2:4], scale * before.standard_deviations[2:4], rtol=1e-7
    )
    np.testing.assert_allclose(
        after.standard_deviations[4], before.standard_deviations[4], rtol=1e-7
    )


@every_method
def test_the_order_of_the_points_is_nothing(method):
    rng = np.random.default_rng(6)
    points, order = section((60,), rng), rng.permutation(60)
    before, after = (
        analysis.fit_ellipse(points, method),
        analysis.fit_ellipse(points[order], method),
    )
    np.testing.assert_allclose(after.regular, before.regular, atol=1e-10)
    np.testing.assert_allclose(after.weights, before.weights[order], atol=1e-6)


@every_method
def test_a_stack_is_its_members(method):
    points = section((2, 3, 50), np.random.default_rng(7))
    points[1, 2, :4] += 0.1
    stack = analysis.fit_ellipse(points, method)
    assert (
        stack.center.shape == (2, 3, 2)
        and stack.semi_axes.shape == (2, 3, 2)
        and stack.angle.shape == (2, 3)
    )
    assert (
        stack.covariance.shape == (2, 3, 5, 5)
        and stack.conic.shape == (2, 3, 6)
        and stack.distances.shape == (2, 3, 50)
    )
    one = analysis.fit_ellipse(points[1, 2], method)
    np.testing.assert_allclose(stack.regular[1, 2], one.regular, atol=1e-11)
    np.testing.assert_allclose(
        stack.regular_covariance[1, 2], one.regular_covariance, rtol=1e-6, atol=1e-15
    )


def test_geometric_ellipse_of_gander_golub_and_strebel():
    with open(Path(__file__).parents[2] / "reference" / "gander_ellipse.toml", "rb") as file:
        content = tomllib.load(file)
    fit = analysis.fit_ellipse(
        np.column_stack([content["data"]["x"], content["data"]["y"]]),
        "geometric",
        bias_correction=False,
    )
    found = {
        "centre": fit.center,
        "semi_axes": fit.semi_axes,
        "angle": fit.angle,
        "rss": np.sum(fit.distances**2),
    }
    for name, values in found.items():
        texts = np.atleast_1d(content["answer"][name])
        half_unit = [0.5 * 10.0 ** -len(text.partition(".")[2]) for text in texts]
        assert np.all(np.abs(np.atleast_1d(values) - texts.astype(float)) <= half_unit), name


RNG = np.random.default_rng(8)
SPREADS = RNG.uniform(0.3, 3.0, (40, 2))
TURNS = np.linalg.qr(RNG.standard_normal((40, 2, 2)))[0]
COFACTORS = {
    "none": None,
    "variances": SPREADS[:, 0],
    "full": (TURNS * SPREADS[:, None]) @ TURNS.swapaxes(-1, -2),
}


@pytest.mark.parametrize("kind", COFACTORS)
def test_geometric_against_an_adjustment_with_a_free_place_on_the_ellipse_for_every_point(kind):
    """scipy, 5 + n unknowns; also the cofactor, from its Jacobian."""
    cofactors = COFACTORS[kind]
    full = (
        cofactors
        if kind == "full"
        else (np.ones(40) if cofactors is None else cofactors)[:, None, None] * np.eye(2)
    )
    points = section((40,), np.random.default_rng(9), FLAT - [10, -4, 0, 0, 0], 0.03)
    roots = np.linalg.cholesky(np.linalg.inv(full)).swapaxes(-1, -2)

    def residuals(z):
        u0, v0, m, g, h = z[:5]
        S = np.array([[m + g, h], [h, m - g]])
        places = z[:2] + np.column_stack([np.cos(z[5:]), np.sin(z[5:])]) @ S
        return np.einsum("nij,nj->ni", roots, points - places).ravel()

    fit = analysis.fit_ellipse(points, "geometric", cofactors=cofactors, bias_correction=False)
    m, g, h = fit.regular[2:]
    q = np.linalg.solve([[m + g, h], [h, m - g]], (points - fit.center).T)
    start = np.concatenate([fit.regular + 0.01, np.arctan2(q[1], q[0])])
    reference = least_squares(residuals, start, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    np.testing.assert_allclose(fit.regular, reference.x[:5], atol=2e-8)
    np.testing.assert_allclose(fit.sigma_0, np.sqrt(2 * reference.cost / 35), rtol=1e-8)
    np.testing.assert_allclose(
        fit.regular_cofactor,
        np.linalg.inv(reference.jac.T @ reference.jac)[:5, :5],
        rtol=1e-4,
        atol=1e-7,
    )


@pytest.mark.parametrize("method", CONSISTENT)
def test_full_cofactors_that_are_isotropic_are_variances(method):
    points, variances = section((40,), np.random.default_rng(10)), COFACTORS["variances"]
    one = analysis.fit_ellipse(points, method, cofactors=variances)
    full = analysis.fit_ellipse(points, method, cofactors=variances[:, None, None] * np.eye(2))
    np.testing.assert_allclose(full.regular, one.regular, atol=1e-10)
    np.testing.assert_allclose(full.covariance, one.covariance, rtol=1e-6)


@pytest.mark.parametrize("method", ["direct", "geometric"])
def test_a_weight_of_three_is_three_points(method):
    points, weights = section((40,), np.random.default_rng(11), FLAT, 0.02), np.tile([1.0, 3.0], 20)
    plain = {"bias_correction": False} if method == "geometric" else {}
    weighted = analysis.fit_ellipse(points, method, weights=weights, **plain)
    repeated = analysis.fit_ellipse(np.repeat(points, weights.astype(int), axis=0), method, **plain)
    np.testing.assert_allclose(weighted.regular, repeated.regular, atol=1e-11)
    # the direct ellipse weighs points by their place, too, and not by their variance alone
    if method == "geometric":
        np.testing.assert_allclose(weighted.cofactor, repeated.cofactor, rtol=1e-7)


def test_direct_is_the_eigenvector_of_halir_and_flusser():
    points = section((40,), np.random.default_rng(12), FLAT - [10, -4, 0, 0, 0], 0.05)
    u, v = points.T
    D1, D2 = np.column_stack([u * u, u * v, v * v]), np.column_stack([u, v, np.ones(40)])
    S1, S2, S3 = D1.T @ D1, D1.T @ D2, D2.T @ D2
    T = -np.linalg.solve(S3, S2.T)
    _, vectors = np.linalg.eig(np.linalg.solve(conic.DISCRIMINANT, S1 + S2 @ T))
    a1 = vectors[:, 4 * vectors[0] * vectors[2] - vectors[1] ** 2 > 0][:, 0].real
    fit = analysis.fit_ellipse(points, "direct")
    np.testing.assert_allclose(
        fit.regular, conic.ellipse_of(np.concatenate([a1, T @ a1])), atol=1e-11
    )
    np.testing.assert_allclose(
        conic.ellipse_of(conic.direct_from_points(points, np.ones(40))[0]), fit.regular, atol=1e-11
    )


# ------------------------------------------------------------------------------------- gross errors


def tray(rng, n=5400):
    """A section with 5 % of the arc replaced by a cable tray 13 cm inside."""
    angles = rng.uniform(-SEEN, SEEN, n)
    points = ellipse(SECTION, angles) + 0.003 * rng.standard_normal((n, 2))
    hidden = (angles > 1.2) & (angles < 1.2 + 0.05 * 2 * SEEN)
    inwards = (points - SECTION[:2]) / np.linalg.norm(points - SECTION[:2], axis=-1, keepdims=True)
    points[hidden] -= 0.13 * inwards[hidden]
    return points, hidden


def radius_errors(fit, truth=SECTION):
    """Distances of the true ellipse from the fitted one, m, over the part that is seen."""
    return EllipseModel().linearised(fit.regular, ellipse(truth, np.linspace(-SEEN, SEEN, 271)))[0]


def test_a_cable_tray_moves_the_plain_fits_and_not_the_robust_ones():
    points, hidden = tray(np.random.default_rng(13))
    errors = {
        name: np.abs(radius_errors(analysis.fit_ellipse(points, name))).max()
        for name in analysis.ELLIPSE_METHODS
    }
    assert errors["direct"] > 0.025 and errors["geometric"] > 0.025
    assert errors["robust_direct"] < 0.0005 and errors["robust"] < 0.0005
    assert not analysis.fit_ellipse(points, "robust").inliers[hidden].any()


def test_robust_stands_forty_percent_on_one_side():
    """Where the reweighting that starts from all points does not."""
    points = section((300,), np.random.default_rng(14))
    points[:120] += [0.5, 0.3]
    assert np.abs(radius_errors(analysis.fit_ellipse(points))).max() < 0.0015
    assert np.abs(radius_errors(quietly(points, "robust_direct"))).max() > 0.01


# ----------------------------------------------------------------------------------- covariance


@pytest.mark.parametrize(
    "method, n, trials", [("direct", 100, 3000), ("geometric", 100, 3000), ("robust", 100, 1500)]
)
@pytest.mark.parametrize("parameters", [SECTION, [0, 0, 2.7, 2.7, 0]], ids=["section", "circle"])
def test_the_ellipsoid_of_95_percent_holds_the_truth(method, n, trials, parameters):
    """In (u0, v0, m, g, h), for a circle too. The standard error of the share is 0.4 to 0.6 %."""
    fits = analysis.fit_ellipse(section((trials, n), np.random.default_rng(15), parameters), method)
    difference = fits.regular - regular(parameters)
    squares = np.einsum(
        "bi,bi->b",
        difference,
        np.linalg.solve(fits.regular_covariance, difference[..., None])[..., 0],
    )
    assert 0.935 <= np.mean(squares <= 5 * fisher.ppf(0.95, 5, n - 5)) <= 0.965


def test_covariance_of_the_semi_axes_and_the_angle():
    """Of a flat ellipse, whose axes are well told apart.

    That of a sample of 2000, whose standard deviations are good to 1.6 %.
    """
    fits = analysis.fit_ellipse(
        section((2000, 60), np.random.default_rng(16), FLAT, 0.005), "geometric"
    )
    ratio = fits.parameters.std(axis=0) / np.sqrt(np.mean(fits.standard_deviations**2, axis=0))
    np.testing.assert_allclose(ratio, 1.0, atol=0.06)
    one = analysis.fit_ellipse(section((60,), np.random.default_rng(17), FLAT, 0.005), "geometric")
    _, x, J = one.surface()
    np.testing.assert_allclose(propagate(one.regular_cofactor, J[0]), one.cofactor, rtol=1e-12)
    np.testing.assert_allclose(x[0], one.regular)


# ------------------------------------------------------------------------------------ bad input


@pytest.mark.parametrize(
    "points, message",
    [
        (np.zeros((10, 3)), r"expected shape \(…, n, 2\)"),
        (np.arange(8.0).reshape(4, 2), "at least 5 points for an ellipse"),
        (np.ones((10, 2)), "all at one place"),
        (np.column_stack([np.arange(10.0), 2 * np.arange(10.0) + 1e5]), "on one line"),
        (np.tile([[0, 0], [1, 0], [0, 1], [2, 3.0]], (3, 1)), "more than one conic"),
        (
            np.vstack([np.column_stack([np.arange(9.0), np.arange(9.0)]), [[0, 5.0]]]),
            "more than one conic",
        ),
    ],
)
@every_method
def test_points_that_determine_no_ellipse_are_refused(method, points, message):
    with pytest.raises(ValueError, match=message):
        analysis.fit_ellipse(points, method)


def test_which_cloud_of_the_stack_is_bad():
    points = section((3, 10), np.random.default_rng(19))
    points[2, :, 1] = 0
    with pytest.raises(ValueError, match="on one line in cloud 2 of the stack"):
        analysis.fit_ellipse(points)


@every_method
@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_a_branch_of_a_hyperbola_is_told(method, noise):
    t = np.linspace(-1.5, 1.5, 100)
    branch = np.column_stack([np.cosh(t), np.sinh(t)]) + noise * np.random.default_rng(
        20
    ).standard_normal((100, 2))
    with pytest.warns(ConvergenceWarning):
        fit = analysis.fit_ellipse(branch, method)
    assert not fit.converged and "hyperbola" in fit.stop_reason


def test_one_bad_cloud_leaves_the_others_alone():
    t = np.linspace(-1.5, 1.5, 60)
    section_points = section((60,), np.random.default_rng(22))
    stack = quietly(
        np.stack([section_points, np.column_stack([np.cosh(t), np.sinh(t)])]), "geometric"
    )
    assert stack.converged.tolist() == [True, False]
    np.testing.assert_allclose(
        stack.regular[0], analysis.fit_ellipse(section_points, "geometric").regular, atol=1e-11
    )


def test_reliability_of_the_points():
    """Redundancy sums up to n − 5; an error of the minimal size changes the ellipse as stated."""
    points = section((30,), np.random.default_rng(23), FLAT, 0.003)
    plain = {"method": "geometric", "bias_correction": False}
    fit = analysis.fit_ellipse(points, **plain)
    found = analysis.reliability(fit, points)
    np.testing.assert_allclose(found.redundancy.sum(), 25, atol=1e-9)
    normal = EllipseModel.normals(fit.regular, points)[4]
    size = 0.01  # of the smallest error, so that all is linear
    spoiled = points.copy()
    spoiled[4] += size * found.minimal_bias[4] * normal
    change = analysis.fit_ellipse(spoiled, **plain).parameters - fit.parameters
    np.testing.assert_allclose(change, size * found.external[4], rtol=0.03, atol=1e-8)


@pytest.mark.parametrize(
    "option",
    [{"cofactors": np.tile(np.eye(2), (40, 1, 1))}, {"cofactors": np.ones(40), "absolute": True}],
)
def test_full_and_absolute_cofactors_are_for_the_consistent_methods(option):
    points = section((40,), np.random.default_rng(21))
    with pytest.raises(ValueError, match="expected one of geometric, robust"):
        analysis.fit_ellipse(points, "direct", **option)
    assert analysis.fit_ellipse(points, "geometric", **option).converged
