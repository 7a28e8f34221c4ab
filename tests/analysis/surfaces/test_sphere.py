"""Sphere fits: exact data, each method against its printed equations in dense form, bad input."""

import dataclasses
import warnings

import numpy as np
import pytest

import analysis
from analysis.adjustment.weights import IGG3
from analysis.result import Adjustment, ConvergenceWarning
from analysis.surfaces import sphere, sphere_eiv
from studies.ou_liu_2017 import clouds

METHODS = tuple(analysis.SPHERE_METHODS)
every_method = pytest.mark.parametrize("method", METHODS)

TRUTH = np.array([*clouds.SPHERE_CENTER, clouds.SPHERE_RADIUS])
CLEAN, GROSS = clouds.read_sphere_cloud(gross=False), clouds.read_sphere_cloud(gross=True)
GROSS_ROWS = np.array(clouds.GROSS_POINTS) - 1
TETRAHEDRON = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3)


def directions(n, seed=0, above=-1.0):
    """n unit vectors with z > ``above``: 0.5 is a cap of 60°."""
    generator = np.random.default_rng(seed)
    z = generator.uniform(above, 1.0, n)
    angle = generator.uniform(0, 2 * np.pi, n)
    return np.column_stack(
        [np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z]
    )


def noisy(n=40, seed=1, gross=0):
    """n points around the paper's sphere with 5 cm of noise, the first ``gross`` 2 m inside it."""
    points = (
        TRUTH[:3]
        + TRUTH[3] * directions(n, seed, above=0.0)
        + 0.05 * np.random.default_rng(seed).standard_normal((n, 3))
    )
    points[:gross] = TRUTH[:3] + (points[:gross] - TRUTH[:3]) * 0.86
    return points


def fit_quietly(*arguments, **options):
    """A fit that may end without having converged."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        return analysis.fit_sphere(*arguments, **options)


# ------------------------------------------------------------------------------ exact data

UNIT_SPHERES = {
    "cap": directions(60, above=0.5),
    "whole": directions(60),
    "four": TETRAHEDRON,
    "five": np.vstack([TETRAHEDRON, [0, 0, 1]]),
}
PLACES = {
    "paper": TRUTH,
    "origin": (0.0, 0.0, 0.0, 1.0),
    "target": (0.3, -0.2, 6.0, 0.05),
    "1 km": (500.0, -300.0, 100.0, 1000.0),
    "national grid": (5e5, 4e6, 100.0, 10.0),
}


# Pure TLS sees |p|² of the printed frame, whose last bit is 2 mm² on a national grid.
METHODS_AND_PLACES = [
    (method, place)
    for method in METHODS
    for place in PLACES
    if (method, place) != ("tls", "national grid")
]


@pytest.mark.parametrize(("method", "place"), METHODS_AND_PLACES)
@pytest.mark.parametrize("points", UNIT_SPHERES)
def test_exact_points_give_the_sphere(method, place, points):
    truth = np.array(PLACES[place])
    fit = analysis.fit_sphere(truth[:3] + truth[3] * UNIT_SPHERES[points], method)
    # of the fit, and of the points themselves
    rounding = np.finfo(float).eps * (1000 * truth[3] + 10 * np.abs(truth).max())
    if method == "tls":
        rounding += (
            30 * np.finfo(float).eps * (np.linalg.norm(truth[:3]) + truth[3]) ** 2 / truth[3]
        )
    np.testing.assert_allclose(fit.parameters, truth, rtol=0, atol=rounding)
    np.testing.assert_allclose(fit.distances, 0, atol=rounding)
    np.testing.assert_array_equal(fit.center, fit.parameters[:3])
    assert fit.radius == fit.parameters[3] and fit.converged and fit.method == method
    assert fit.inliers.sum() >= 4


@pytest.mark.parametrize("method", sorted(set(METHODS) - {"tls"}))
def test_small_sphere_at_geocentric_coordinates(method):
    """50 mm at 6·10⁶ m: 1 µm, where the coordinates themselves are rounded to 1 nm."""
    truth = np.array([3.6e6, 3.3e6, 4.1e6, 0.05])
    assert np.linalg.norm(truth[:3]) > 6e6
    fit = analysis.fit_sphere(truth[:3] + truth[3] * directions(200, above=0.0), method)
    np.testing.assert_allclose(fit.parameters, truth, rtol=0, atol=1e-6)
    assert fit.sigma_s < 2e-9


def test_noise_at_geocentric_coordinates_is_the_noise_at_the_origin():
    """LS of the same noisy points moved by whole metres.

    The answer moves with them to the rounding of the coordinates.
    """
    local = np.round(
        0.05 * directions(200, above=0.0)
        + 0.002 * np.random.default_rng(2).standard_normal((200, 3)),
        4,
    )
    shift = np.array([3.6e6, 3.3e6, 4.1e6])
    for method in ("ls", "wtls"):
        far = analysis.fit_sphere(local + shift, method)
        np.testing.assert_allclose(
            far.center - shift, analysis.fit_sphere(local, "ls").center, rtol=0, atol=1e-8
        )


def test_pure_tls_loses_large_coordinates():
    truth = np.array(PLACES["national grid"])
    fit = fit_quietly(truth[:3] + truth[3] * UNIT_SPHERES["cap"], "tls")
    assert not np.linalg.norm(fit.parameters - truth) < 0.1
    assert fit.converged == np.isfinite(fit.radius)


# ------------------------------------------------------------------------------ the printed
# equations, dense, in the raw frame


def printed_rows(points):
    """A (n, 4) and Y (n,) of eq. (2)."""
    return np.column_stack([2 * points, np.ones(len(points))]), np.sum(points**2, axis=1)


def sphere_of(X):
    return np.array([*X[:3], np.sqrt(X[3] + X[:3] @ X[:3])])


def radius_jacobian(X):
    """∂(a, b, c, r)/∂X."""
    r = sphere_of(X)[3]
    J = np.eye(4)
    J[3] = np.array([*X[:3], 0.5]) / r
    return J


def dense_wtls(points, P, iterations=60):
    """Eqs. (16)-(17) for fixed weights P_X (n,) with n×n matrices, without points of weight 0."""
    A, Y = printed_rows(points)
    X = np.linalg.lstsq(A, Y, rcond=None)[0]
    for _ in range(iterations):
        X = dense_step(A, Y, P, X)
    return X


def dense_step(A, Y, P, X):
    use = P > 0
    A, Y = A[use], Y[use]
    Q_X = np.diag(1 / P[use])
    Q_0 = np.diag([1.0, 1.0, 1.0, 0.0])
    mu = np.linalg.inv(Q_X * Y + X @ Q_0 @ X * Q_X)
    multipliers = mu @ (Y - A @ X)
    return np.linalg.solve(A.T @ mu @ A - multipliers @ Q_X @ multipliers * Q_0, A.T @ mu @ Y)


def dense_sigma_0(points, P, X):
    """√(λᵀ(Y − AX)/(n − 4)), n all points."""
    A, Y = printed_rows(points)
    return np.sqrt(np.sum(P * (Y - A @ X) ** 2 / (Y + X[:3] @ X[:3])) / (len(points) - 4))


def dense_cofactor(points, P, X):
    """(ÃᵀμÃ)⁻¹ with the adjusted rows Ã = A − Ẽ, Ẽ = −Q_X λ Xᵀ Q_0, propagated to (a, b, c, r)."""
    A, Y = printed_rows(points)
    mu = P / (Y + X[:3] @ X[:3])
    multipliers = (Y - A @ X) / (Y + X[:3] @ X[:3])  # P λ: free of the division by P
    adjusted = A + np.outer(multipliers, [*X[:3], 0.0])
    J = radius_jacobian(X)
    return J @ np.linalg.inv((adjusted.T * mu) @ adjusted) @ J.T


def assert_fit(fit, X, sigma_0, cofactor):
    np.testing.assert_allclose(fit.parameters, sphere_of(X), rtol=1e-9)
    np.testing.assert_allclose(fit.sigma_0, sigma_0, rtol=1e-8)
    np.testing.assert_allclose(
        fit.cofactor, cofactor, rtol=1e-7, atol=1e-9 * np.abs(cofactor).max()
    )
    np.testing.assert_allclose(
        fit.covariance,
        sigma_0**2 * cofactor,
        rtol=1e-6,
        atol=1e-9 * sigma_0**2 * np.abs(cofactor).max(),
    )


CLOUDS = {"noisy": noisy(), "gross": noisy(gross=3), "clean": CLEAN[:60]}
every_cloud = pytest.mark.parametrize("points", CLOUDS.values(), ids=CLOUDS.keys())


def algebraic_sd(points, X):
    A, Y = printed_rows(points)
    return np.sqrt(np.sum((Y - A @ X) ** 2) / (len(points) - 4))


@every_cloud
def test_ls_is_numpy_lstsq_of_the_printed_rows(points):
    A, Y = printed_rows(points)
    X = np.linalg.lstsq(A, Y, rcond=None)[0]
    J = radius_jacobian(X)
    assert_fit(
        analysis.fit_sphere(points, "ls"),
        X,
        algebraic_sd(points, X),
        J @ np.linalg.inv(A.T @ A) @ J.T,
    )


@every_cloud
def test_tls_is_the_svd_of_the_printed_rows(points):
    A, Y = printed_rows(points)
    v = np.linalg.svd(np.column_stack([A, Y]))[2][-1]
    X = -v[:4] / v[4]
    adjusted = A + np.outer((Y - A @ X) / (1 + X @ X), X)
    J = radius_jacobian(X)
    assert_fit(
        analysis.fit_sphere(points, "tls"),
        X,
        algebraic_sd(points, X),
        J @ np.linalg.inv(adjusted.T @ adjusted) @ J.T,
    )


@every_cloud
def test_mixed_ls_tls_is_the_svd_of_the_centred_rows(points):
    A, Y = printed_rows(points)
    rows = np.column_stack([A[:, :3], Y])
    v = np.linalg.svd(rows - rows.mean(axis=0))[2][-1]
    k = -v[:3] / v[3]
    X = np.array([*k, Y.mean() - 2 * points.mean(axis=0) @ k])
    adjusted = A + np.outer((Y - A @ X) / (1 + k @ k), [*k, 0.0])
    J = radius_jacobian(X)
    assert_fit(
        analysis.fit_sphere(points, "mixed_ls_tls"),
        X,
        algebraic_sd(points, X),
        J @ np.linalg.inv(adjusted.T @ adjusted) @ J.T,
    )


def test_mixed_ls_tls_is_the_smallest_singular_vector_however_noisy():
    """Twelve points with 10 % of noise.

    There an iteration may end at another singular vector, which is no minimum.
    """
    generator = np.random.default_rng(47)
    radial = generator.standard_normal((12, 3))
    radial /= np.linalg.norm(radial, axis=1)[:, None]
    radial[:, 2] = abs(radial[:, 2])
    points = generator.uniform(-5, 5, 3) + 3 * radial * (
        1 + 0.1 * generator.standard_normal((12, 1))
    )
    rows = np.column_stack([2 * points, np.sum(points**2, axis=1)])
    v = np.linalg.svd(rows - rows.mean(axis=0))[2][-1]
    np.testing.assert_allclose(
        analysis.fit_sphere(points, "mixed_ls_tls").center, -v[:3] / v[3], rtol=1e-9
    )


@every_cloud
@pytest.mark.parametrize("unit_weight", [1.0, 0.25])
@pytest.mark.parametrize("weighted", [False, True])
def test_wtls_is_the_printed_iteration(points, unit_weight, weighted):
    base = (
        np.random.default_rng(3).uniform(0.3, 3.0, len(points))
        if weighted
        else np.ones(len(points))
    )
    P = unit_weight * base
    X = dense_wtls(points, P)
    fit = analysis.fit_sphere(
        points, "wtls", unit_weight=unit_weight, weights=base if weighted else None
    )
    assert_fit(fit, X, dense_sigma_0(points, P, X), dense_cofactor(points, P, X))
    assert fit.converged


def dense_scale(scale, d, P, base, X, points, function):
    """σ of V/σ, each from its definition; ``P/base`` are the robust factors in force."""
    n, weights = len(d), P / base
    return {
        "rms": np.sqrt(np.mean(d**2)),
        "rms_in": np.sqrt(np.mean(d[weights > 0] ** 2)),
        "rms_w": np.sqrt(np.sum(weights * d**2) / np.sum(weights)),
        "rms_wc": np.sqrt(np.sum(weights * d**2) / (np.sum(weights) * function.consistency_factor)),
        "mad": 1.4826022185056018 * np.median(np.abs(d)) * n / (n - 4),
        "unit": dense_sigma_0(points, P, X),
    }[scale]


def dense_igg3_wtls(points, base, iterations, scale, power, cumulative, start):
    """Section 1.4 of the paper: (X, σ, P) after each iteration, P the weights that it used."""
    A, Y = printed_rows(points)
    function = IGG3(1.5, 2.5, power)
    first = Y / base if start == "Q_Y" else base / Y
    X = np.linalg.solve((A.T * first) @ A, (A.T * first) @ Y)
    mu = base / (Y + X[:3] @ X[:3])
    X = np.linalg.solve((A.T * mu) @ A, (A.T * mu) @ Y)
    P, kept = base.copy(), []
    for _ in range(iterations):
        X = dense_step(A, Y, P, X)
        d = np.linalg.norm(points - X[:3], axis=1) - sphere_of(X)[3]
        sigma = dense_scale(scale, d, P, base, X, points, function)
        kept.append((X, sigma, P))
        u = np.abs(d) / sigma
        middle = 1.5 / np.maximum(u, 1.5) * ((2.5 - np.minimum(u, 2.5)) / 1.0) ** power
        omega = np.where(u < 1.5, 1.0, np.where(u < 2.5, middle, 0.0))
        P = P * omega if cumulative else base * omega
    return kept


@pytest.mark.parametrize("scale", ["rms", "rms_in", "rms_w", "rms_wc", "mad", "unit"])
@pytest.mark.parametrize("power", [1, 2])
@pytest.mark.parametrize("cumulative", [True, False])
@pytest.mark.parametrize("start", ["Q_Y", "P_Y"])
@pytest.mark.parametrize("unit_weight", [1.0, 1000.0])
def test_igg3_wtls_is_the_printed_iteration(scale, power, cumulative, start, unit_weight):
    """The first twelve iterations, with a-priori weights, gross errors and zero weights."""
    points = noisy(gross=3)
    weights = np.random.default_rng(4).uniform(0.5, 2.0, len(points))
    options = dict(scale=scale, power=power, cumulative=cumulative, start=start)
    fit = fit_quietly(
        points,
        "igg3_wtls",
        weights=weights,
        unit_weight=unit_weight,
        max_iterations=12,
        tolerance=1e-30,
        history=True,
        **options,
    )
    base = unit_weight * weights
    expected = dense_igg3_wtls(points, base, len(fit.history), **options)
    assert len(fit.history) == fit.iterations > 2
    for ours, (X, sigma, P) in zip(fit.history, expected, strict=True):
        if np.count_nonzero(P) < 8:
            break  # collapsed: too few points for a comparison of digits
        np.testing.assert_allclose(ours.parameters, sphere_of(X), rtol=1e-9)
        np.testing.assert_allclose(ours.scale, sigma, rtol=1e-8)
        np.testing.assert_allclose(ours.weights, P / base, rtol=0, atol=1e-8)
        np.testing.assert_array_equal(ours.weights == 0, P == 0)
    else:
        assert_fit(fit, X, dense_sigma_0(points, P, X), dense_cofactor(points, P, X))


@pytest.mark.parametrize("cumulative", [True, False])
def test_gross_errors_have_weight_zero_and_delete_themselves(cumulative):
    """Once their weight is 0 the answer is that of WTLS of the other points."""
    fit = analysis.fit_sphere(GROSS, "igg3_wtls", cumulative=cumulative, tolerance=1e-9)
    assert np.flatnonzero(fit.weights == 0).tolist() == GROSS_ROWS.tolist()
    assert np.all(fit.weights[fit.inliers] == 1)
    rest = analysis.fit_sphere(np.delete(GROSS, GROSS_ROWS, axis=0), "wtls")
    np.testing.assert_allclose(fit.parameters, rest.parameters, rtol=0, atol=1e-9)
    np.testing.assert_allclose(fit.cofactor, rest.cofactor, rtol=1e-6)
    np.testing.assert_allclose(fit.sigma_0**2 * 496, rest.sigma_0**2 * 491, rtol=1e-8)


def test_without_rejection_igg3_wtls_is_wtls():
    wtls = analysis.fit_sphere(CLEAN, "wtls")
    fit = analysis.fit_sphere(CLEAN, "igg3_wtls", k0=100, k1=200, tolerance=1e-9)
    np.testing.assert_allclose(fit.parameters, wtls.parameters, rtol=0, atol=1e-9)
    np.testing.assert_allclose(fit.cofactor, wtls.cofactor, rtol=1e-8)
    np.testing.assert_allclose(fit.sigma_0, wtls.sigma_0, rtol=1e-9)
    assert fit.inliers.all()


def test_history_is_the_way_to_the_result():
    fit = analysis.fit_sphere(CLEAN, "igg3_wtls", history=True)
    assert len(fit.history) == fit.iterations > 10
    np.testing.assert_array_equal(fit.history[-1].weights, fit.weights)
    np.testing.assert_array_equal(fit.history[-1].parameters, fit.parameters)
    np.testing.assert_array_equal(fit.history[0].weights, 1)
    for before, after in zip(fit.history, fit.history[1:], strict=False):
        distances = np.linalg.norm(CLEAN - before.parameters[:3], axis=1) - before.parameters[3]
        np.testing.assert_allclose(before.scale, np.sqrt(np.mean(distances**2)), rtol=1e-9)
        np.testing.assert_allclose(
            after.weights,
            before.weights * IGG3().weight(distances / before.scale),
            rtol=0,
            atol=1e-9,
        )
    assert analysis.fit_sphere(CLEAN, "igg3_wtls").history == ()


@pytest.mark.parametrize("tolerance", [1e-6, 1e-8])
def test_igg3_wtls_ends_at_the_first_small_step_in_printed_x(tolerance):
    """|ΔX| of X = (a, b, c, δ) in the printed frame, m and m² together, as step 7 has it."""
    fit = analysis.fit_sphere(CLEAN, "igg3_wtls", tolerance=tolerance, history=True)
    X = [
        np.append(p[:3], p[3] ** 2 - p[:3] @ p[:3]) for p in (one.parameters for one in fit.history)
    ]
    steps = np.linalg.norm(np.diff(X, axis=0), axis=1)
    assert steps[-1] < tolerance < steps[:-1].min()
    # The part in m², δ, is most of it: the centre alone would have stopped earlier.
    assert np.linalg.norm(np.diff(X, axis=0)[:, :3], axis=1)[-2] < tolerance


def test_points_of_tiny_weight_count_as_used():
    """Cumulative weights fall to 1e-90 and are not 0: what has a weight is in use."""
    fit = analysis.fit_sphere(CLEAN, "igg3_wtls")
    assert np.any(fit.inliers & (fit.weights < 1e-20)) and np.any(~fit.inliers)
    np.testing.assert_array_equal(fit.inliers, fit.weights > 0)


@every_cloud
def test_no_method_finds_an_imaginary_sphere(points):
    """LS and mixed LS-TLS make Σr = 0, so r² is the mean of |p − k|².

    Pure TLS has no smaller r² than the spread of the points.
    """
    spread = np.mean(np.sum((points - points.mean(axis=0)) ** 2, axis=1))
    for method in ("ls", "mixed_ls_tls"):
        fit = analysis.fit_sphere(points, method)
        np.testing.assert_allclose(
            fit.radius**2, np.mean(np.sum((points - fit.center) ** 2, axis=1)), rtol=1e-11
        )
    assert analysis.fit_sphere(points, "tls").radius ** 2 >= spread


# ------------------------------------------------------------------------------ accuracy


@every_method
def test_fit_reports_the_orthogonal_distances(method):
    fit = analysis.fit_sphere(GROSS, method)
    distances = np.linalg.norm(GROSS - fit.center, axis=1) - fit.radius
    np.testing.assert_allclose(fit.distances, distances, rtol=0, atol=1e-12)
    np.testing.assert_allclose(fit.sigma_s, np.sqrt(np.mean(distances**2)), rtol=1e-12)
    np.testing.assert_allclose(
        fit.sigma_s_inliers, np.sqrt(np.mean(distances[fit.weights > 0] ** 2)), rtol=1e-12
    )
    np.testing.assert_allclose(fit.covariance, fit.sigma_0**2 * fit.cofactor, rtol=1e-12)
    np.testing.assert_allclose(fit.standard_deviations**2, np.diag(fit.covariance), rtol=1e-12)
    np.testing.assert_allclose(fit.covariance, fit.covariance.T, rtol=1e-12)
    assert np.all(np.linalg.eigvalsh(fit.covariance) > 0)


@pytest.mark.parametrize("depth", [-0.3, 0.3])
def test_distances_are_positive_outside(depth):
    points = np.vstack([directions(60), (1 + depth) * directions(1, seed=5)])
    fit = analysis.fit_sphere(points, "igg3_wtls")
    np.testing.assert_allclose(fit.distances[-1], depth, rtol=0, atol=1e-6)
    assert fit.inliers.sum() == 60


def test_ls_covariance_is_the_scatter_of_redraws():
    """On the whole sphere isotropic noise makes equal algebraic residuals, as LS assumes."""
    truth, sigma, count, n = np.array([1.0, 2.0, 3.0, 1.0]), 1e-3, 2000, 50
    exact = truth[:3] + directions(n, above=-1.0)
    fit = analysis.fit_sphere(
        exact + sigma * np.random.default_rng(6).standard_normal((count, n, 3)), "ls"
    )
    errors = fit.parameters - truth
    monte_carlo = 4 / np.sqrt(2 * count)  # four standard errors of a standard deviation, relative
    np.testing.assert_allclose(
        errors.std(axis=0), fit.standard_deviations.mean(axis=0), rtol=monte_carlo
    )
    # All of the covariance at once: errorsᵀ C⁻¹ errors / 4 follows F(4, 46).
    quadratic = np.einsum("bi,bij,bj->b", errors, np.linalg.inv(fit.covariance), errors)
    assert abs(quadratic.mean() - 4 * 46 / 44) < 4 * quadratic.std() / np.sqrt(count)
    # σ0 of LS is in m²: 2rσ, and 2rσs beyond the redundancy.
    np.testing.assert_allclose(fit.sigma_0.mean(), 2 * sigma, rtol=0.01)
    np.testing.assert_allclose(
        fit.sigma_0, 2 * fit.radius * fit.sigma_s * np.sqrt(n / (n - 4)), rtol=0.01
    )


@every_method
def test_covariance_does_not_depend_on_the_unit_of_weights(method):
    """Ten times the weights: a tenth of the cofactor, the same covariance and the same sphere."""
    one, ten = (
        analysis.fit_sphere(CLOUDS["gross"], method, weights=np.full(40, weight))
        for weight in (1.0, 10.0)
    )
    np.testing.assert_allclose(ten.parameters, one.parameters, rtol=1e-9)
    np.testing.assert_allclose(10 * ten.cofactor, one.cofactor, rtol=1e-6)
    np.testing.assert_allclose(ten.covariance, one.covariance, rtol=1e-6)


@pytest.mark.parametrize("method", ["wtls", "igg3_wtls"])
def test_unit_weight_scales_sigma_0_alone(method):
    one, hundred = (
        analysis.fit_sphere(CLOUDS["gross"], method, unit_weight=unit) for unit in (1.0, 100.0)
    )
    np.testing.assert_allclose(hundred.parameters, one.parameters, rtol=1e-10)
    np.testing.assert_allclose(hundred.weights, one.weights, rtol=0, atol=1e-8)
    np.testing.assert_allclose(hundred.sigma_0, 10 * one.sigma_0, rtol=1e-8)
    np.testing.assert_allclose(hundred.covariance, one.covariance, rtol=1e-6)


# ------------------------------------------------------------------------------ weights and
# cofactors


@every_method
def test_no_weights_are_equal_weights(method):
    points = CLOUDS["noisy"]
    plain = analysis.fit_sphere(points, method)
    for options in ({"weights": np.ones(40)}, {"cofactors": np.ones(40)}):
        fit = analysis.fit_sphere(points, method, **options)
        np.testing.assert_allclose(fit.parameters, plain.parameters, rtol=1e-10)
        np.testing.assert_allclose(fit.sigma_0, plain.sigma_0, rtol=1e-9)


@every_method
def test_cofactors_are_the_inverse_of_weights(method):
    points, weights = CLOUDS["noisy"], np.random.default_rng(7).uniform(0.2, 5.0, 40)
    by_weights = analysis.fit_sphere(points, method, weights=weights)
    by_cofactors = analysis.fit_sphere(points, method, cofactors=1 / weights)
    by_both = analysis.fit_sphere(points, method, weights=weights**2, cofactors=weights)
    for fit in (by_cofactors, by_both):
        np.testing.assert_allclose(fit.parameters, by_weights.parameters, rtol=1e-9)
        np.testing.assert_allclose(fit.covariance, by_weights.covariance, rtol=1e-6)
    assert (
        np.abs(by_weights.parameters - analysis.fit_sphere(points, method).parameters).max() > 1e-4
    )


@pytest.mark.parametrize("method", ["ls", "tls", "mixed_ls_tls", "wtls"])
def test_integer_weights_are_repeated_points(method):
    points, counts = CLOUDS["noisy"], np.random.default_rng(8).integers(1, 5, 40)
    weighted = analysis.fit_sphere(points, method, weights=counts)
    repeated = analysis.fit_sphere(np.repeat(points, counts, axis=0), method)
    np.testing.assert_allclose(weighted.parameters, repeated.parameters, rtol=1e-10)
    np.testing.assert_allclose(weighted.cofactor, repeated.cofactor, rtol=1e-7)
    np.testing.assert_allclose(
        weighted.sigma_0**2 * 36, repeated.sigma_0**2 * (counts.sum() - 4), rtol=1e-8
    )


# ------------------------------------------------------------------------------ the paper's clouds


def test_table_1_clean():
    ls, tls = (analysis.fit_sphere(CLEAN, method) for method in ("ls", "tls"))
    assert abs(ls.sigma_s - 0.00287) <= 0.00015
    assert abs(ls.sigma_0 - 0.0816) <= 0.0042
    np.testing.assert_allclose(tls.parameters, ls.parameters, rtol=0, atol=1e-4)
    assert np.all(np.abs(ls.parameters - TRUTH) < 4 * ls.standard_deviations)


def test_table_1_scatter_of_ls():
    """Standard deviations in mm, stated to their last digit, over 2000 redraws.

    1.6 % of Monte-Carlo error each.
    """
    fit = analysis.fit_sphere(clouds.sphere_redraws(2000), "ls")
    scatter = 1e3 * (fit.parameters - TRUTH).std(axis=0)
    stated, last_digit = np.array([0.31, 0.32, 0.9, 0.73]), np.array([0.005, 0.005, 0.05, 0.005])
    assert np.all(np.abs(scatter - stated) < 3 * 0.016 * stated + last_digit)
    np.testing.assert_allclose(
        scatter, 1e3 * fit.standard_deviations.mean(axis=0), rtol=4 / np.sqrt(4000)
    )


def test_table_2_gross_errors():
    """Pure TLS collapses, mixed LS-TLS on the same points does not, IGG III finds all five."""
    fits = {method: analysis.fit_sphere(GROSS, method) for method in METHODS}
    off = {method: np.linalg.norm(fit.center - TRUTH[:3]) for method, fit in fits.items()}
    assert off["tls"] > 1
    assert off["mixed_ls_tls"] < 0.2 and off["ls"] < 0.2
    assert off["igg3_wtls"] < 0.005 and abs(fits["igg3_wtls"].radius - TRUTH[3]) < 0.005
    assert np.all(fits["igg3_wtls"].weights[GROSS_ROWS] == 0)
    assert fits["igg3_wtls"].sigma_s > 0.1 > 0.004 > fits["igg3_wtls"].sigma_s_inliers


def test_literal_scale_finds_the_gross_errors_in_every_redraw():
    fit = analysis.fit_sphere(clouds.sphere_redraws(200, gross=True), "igg3_wtls")
    assert np.all(fit.weights[:, GROSS_ROWS] == 0)
    assert np.all(np.linalg.norm(fit.center - TRUTH[:3], axis=-1) < 0.005)


# ------------------------------------------------------------------------------ stacks

STACK_OPTIONS = {
    **{method: {} for method in METHODS},
    "igg3_wtls that partly does not converge": {"max_iterations": 9},
    "igg3_wtls by mad": {"scale": "mad", "cumulative": False},
    "igg3_wtls that collapses": {"scale": "unit", "unit_weight": 0.01},
    "wtls that partly does not converge": {"max_iterations": 5},
}
PER_STACK = (
    "parameters",
    "cofactor",
    "sigma_0",
    "distances",
    "weights",
    "iterations",
    "converged",
    "stop_reason",
    "center",
    "radius",
    "covariance",
    "sigma_s",
    "sigma_s_inliers",
)


@pytest.mark.parametrize("name", STACK_OPTIONS)
@pytest.mark.parametrize("weighted", [False, True])
def test_a_stack_is_its_clouds_one_by_one(name, weighted):
    points = np.array([[noisy(40, seed=10 * i + j, gross=j) for j in range(3)] for i in range(2)])
    weights = np.random.default_rng(11).uniform(0.5, 2.0, (2, 3, 40)) if weighted else None
    method, options = name.split()[0], STACK_OPTIONS[name]
    together = fit_quietly(points, method, weights=weights, **options)
    shapes = {
        "parameters": (2, 3, 4),
        "center": (2, 3, 3),
        "radius": (2, 3),
        "cofactor": (2, 3, 4, 4),
        "distances": (2, 3, 40),
    }
    assert {name: getattr(together, name).shape for name in shapes} == shapes
    for index in np.ndindex(2, 3):
        apart = fit_quietly(
            points[index], method, weights=None if weights is None else weights[index], **options
        )
        assert (
            apart.center.shape == (3,)
            and np.ndim(apart.radius) == 0
            and isinstance(apart.stop_reason, str)
        )
        for field in PER_STACK:
            ours, theirs = (
                np.asarray(getattr(together, field))[index],
                np.asarray(getattr(apart, field)),
            )
            if theirs.dtype.kind == "f":
                size = np.abs(theirs[np.isfinite(theirs)]).max(initial=0.0)
                np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9 * size, err_msg=field)
            else:
                assert np.all(ours == theirs), field
    if "partly" in name:
        assert 0 < np.count_nonzero(together.converged) < 6
    if "collapses" in name:
        assert not together.converged.any()


@every_method
def test_a_stack_longer_than_a_block(method):
    """Solved in several parts, joined without a seam."""
    points = clouds.sphere_redraws(150)
    together = fit_quietly(points, method)
    for index in (0, 31, 32, 131, 132, 149):
        np.testing.assert_allclose(
            together.parameters[index], fit_quietly(points[index], method).parameters, rtol=1e-9
        )


@every_method
def test_a_cloud_longer_than_a_block(method):
    """The points of one cloud are walked through in parts too."""
    points = 1 + directions(40_000) + 0.01 * np.random.default_rng(12).standard_normal((40_000, 3))
    weights = np.random.default_rng(13).uniform(0.5, 2, 40_000)
    fit = analysis.fit_sphere(points, method, weights=weights)
    np.testing.assert_allclose(fit.parameters, [1, 1, 1, 1], rtol=0, atol=1e-3)
    if method == "ls":
        A, Y = printed_rows(points)
        X = np.linalg.lstsq(np.sqrt(weights)[:, None] * A, np.sqrt(weights) * Y, rcond=None)[0]
        np.testing.assert_allclose(fit.parameters, sphere_of(X), rtol=1e-11)


# ------------------------------------------------------------------------------ what goes in and
# comes out


@every_method
def test_form_of_the_input_does_not_matter(method):
    expected = analysis.fit_sphere(GROSS, method).parameters
    read_only = GROSS.copy()
    read_only.flags.writeable = False
    doubled = np.repeat(GROSS, 2, axis=0)[::2]
    wider = np.column_stack([GROSS, GROSS[:, :1]])[:, :3]
    for points in (
        read_only,
        GROSS.tolist(),
        doubled,
        wider,
        np.asfortranarray(GROSS),
        GROSS.astype(object),
    ):
        np.testing.assert_allclose(
            analysis.fit_sphere(points, method).parameters, expected, rtol=1e-10
        )
    single = GROSS.astype(np.float32)
    np.testing.assert_array_equal(
        analysis.fit_sphere(single, method).parameters,
        analysis.fit_sphere(single.astype(float), method).parameters,
    )
    whole = np.round(10 * GROSS).astype(np.int32)
    np.testing.assert_array_equal(
        analysis.fit_sphere(whole, method).parameters,
        analysis.fit_sphere(whole.astype(float), method).parameters,
    )


@every_method
def test_inputs_stay_and_results_are_frozen(method):
    points, weights = GROSS.copy(), np.linspace(1, 2, 500)
    kept = weights.copy()
    fit = analysis.fit_sphere(points, method, weights=weights, cofactors=weights)
    np.testing.assert_array_equal(points, GROSS)
    np.testing.assert_array_equal(weights, kept)
    with pytest.raises(dataclasses.FrozenInstanceError):
        fit.sigma_0 = 0.0
    for name in ("parameters", "cofactor", "distances", "weights"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(fit, name)[0] = 0.0
    points[:] = 0.0
    assert fit.distances.std() > 0  # nothing of the result is a view of the input


def test_repr_says_what_was_found():
    found = (
        "SphereFit(method='igg3_wtls', a=9.99995, b=9.99995, c=1.00103, r=14.1414, "
        "495 of 500 points in use; "
    )
    assert repr(analysis.fit_sphere(GROSS, "igg3_wtls")).startswith(found)
    assert (
        repr(analysis.fit_sphere(np.stack([CLEAN, GROSS]), "ls"))
        == "SphereFit(method='ls', stack of shape (2,), 2 converged)"
    )


# ------------------------------------------------------------------------------ what does not
# converge


@pytest.mark.parametrize("method", ["wtls", "igg3_wtls"])
def test_running_out_of_iterations(method):
    with pytest.warns(ConvergenceWarning, match=f"^{method}: not converged: .*2 iterations"):
        fit = analysis.fit_sphere(GROSS, method, max_iterations=2)
    assert fit.converged is np.False_ or fit.converged is False
    assert fit.iterations == 2 and fit.stop_reason.startswith("not converged: ")
    assert np.all(np.isfinite(fit.parameters))


def test_warning_of_a_stack_counts():
    with pytest.warns(ConvergenceWarning, match="igg3_wtls: 1 of 2 fits: not converged: "):
        fit = analysis.fit_sphere(np.stack([CLEAN, GROSS]), "igg3_wtls", max_iterations=10)
    assert fit.converged.tolist() == [False, True]


def test_warning_points_at_the_caller():
    with pytest.warns(ConvergenceWarning) as caught:
        analysis.fit_sphere(GROSS, "wtls", max_iterations=1)
    assert caught[0].filename == __file__


@pytest.mark.parametrize("power", [1, 2])
def test_weights_that_collapse_are_no_result(power):
    """Cumulative weights with σ0 as the scale, a length of another kind.

    At most one point keeps a weight.
    """
    fit = fit_quietly(GROSS, "igg3_wtls", scale="unit", power=power)
    assert fit.inliers.sum() < 4
    assert not fit.converged
    assert "too few points" in fit.stop_reason


def test_cumulative_weights_with_their_own_rms_collapse():
    """Of five hundred points a handful is left, and it calls itself converged.

    That is what the rule does.
    """
    fit = fit_quietly(GROSS, "igg3_wtls", scale="rms_w")
    assert 4 <= fit.inliers.sum() < 20


def test_sphere_with_negative_squared_radius():
    """δ + |k|² < 0 happens by rounding alone (far away pure TLS meets it).

    So the common ending is asked for it.
    """
    cloud = sphere.SphereCloud.reduce(directions(20)[None])
    x = np.array([[0.0, 0.0, 0.0, -1.0]])
    fit = sphere_eiv._fit(cloud, "tls", Adjustment.closed_form(x, np.eye(4)[None], np.ones(1)))
    assert np.isnan(fit.radius[0]) and not fit.converged[0]
    assert fit.stop_reason[0] == "no real sphere: the squared radius δ + |k|² came out negative"


def test_point_in_the_origin():
    """Its printed Q_Y is zero. A scanner writes (0, 0, 0) where nothing came back."""
    points = np.vstack([noisy(), np.zeros(3)])
    for method in METHODS:
        assert np.isfinite(analysis.fit_sphere(points, method).parameters).all()
    fit = analysis.fit_sphere(points, "igg3_wtls", start="P_Y")
    assert np.isfinite(fit.parameters).all()


# ------------------------------------------------------------------------------ bad input

FLAT = np.column_stack([directions(30)[:, :2], np.zeros(30)])
ROTATION = np.linalg.qr(np.random.default_rng(14).standard_normal((3, 3)))[0]
ANGLE = np.linspace(0, 6, 30)
CIRCLE = np.column_stack([np.cos(ANGLE), np.sin(ANGLE), np.full(30, 2.0)])
LINE = np.outer(ANGLE, [1.0, 2.0, 3.0])


def with_value(value):
    points = GROSS.copy()
    points[7, 1] = value
    return points


@every_method
@pytest.mark.parametrize(
    ("points", "message"),
    [
        (with_value(np.nan), "points: expected finite numbers, got 1 NaN or infinite of 1500"),
        (with_value(np.inf), "points: expected finite numbers, got 1 NaN or infinite of 1500"),
        (with_value(-np.inf), "points: expected finite numbers, got 1 NaN or infinite of 1500"),
        (GROSS[0], r"points: expected shape \(…, n, 3\), got \(3,\)"),
        (GROSS[:, :2], r"points: expected shape \(…, n, 3\), got \(500, 2\)"),
        (GROSS.T, r"points: expected shape \(…, n, 3\), got \(3, 500\)"),
        (5.0, r"points: expected shape \(…, n, 3\), got \(\)"),
        ([], r"points: expected shape \(…, n, 3\), got \(0,\)"),
        (GROSS[:3], r"points: expected at least 4 points for a sphere, got 3 \(shape \(3, 3\)\)"),
        (np.empty((0, 3)), "points: expected at least 4 points for a sphere, got 0"),
        (
            np.empty((0, 9, 3)),
            r"points: expected at least one cloud, got an empty stack of shape \(0, 9, 3\)",
        ),
        ("points.xyz", "points: expected an array of real numbers, got dtype"),
        ([["1", "2", "3"]] * 5, "points: expected an array of real numbers, got dtype"),
        (GROSS + 1j, "points: expected an array of real numbers, got dtype complex128"),
        (GROSS > 1, "points: expected an array of real numbers, got dtype bool"),
        ([[1.0, 2.0, 3.0], [1.0, 2.0]] * 3, "points: expected an array of real numbers, got list"),
        (None, r"points: expected .*got"),
    ],
)
def test_bad_points_are_refused(method, points, message):
    with pytest.raises(ValueError, match=message):
        analysis.fit_sphere(points, method)


@every_method
@pytest.mark.parametrize("shift", [0.0, 10.0, 5e5, 6e6])
@pytest.mark.parametrize(
    ("points", "place"),
    [
        (FLAT, "in one plane"),
        (FLAT[:, [2, 0, 1]], "in one plane"),
        (FLAT @ ROTATION, "in one plane"),
        (0.05 * FLAT @ ROTATION, "in one plane"),
        (0.005 * FLAT @ ROTATION, "in one plane"),
        (CIRCLE, "in one plane"),
        (0.05 * CIRCLE @ ROTATION, "in one plane"),
        (FLAT[:4] @ ROTATION, "in one plane"),
        (LINE, "on one line"),
        (LINE @ ROTATION, "on one line"),
        (np.full((30, 3), 1.7), "all at one place"),
        (np.zeros((30, 3)), "all at one place"),
    ],
    ids=[
        "flat z",
        "flat x",
        "tilted",
        "small tilted",
        "tiny tilted",
        "circle",
        "small tilted circle",
        "four",
        "line",
        "tilted line",
        "equal",
        "zero",
    ],
)
def test_points_that_determine_no_sphere_are_refused(method, points, place, shift):
    with pytest.raises(
        ValueError, match=f"points: expected points that determine a sphere, got points .*{place}"
    ):
        analysis.fit_sphere(points + shift * np.array([1.0, 0.7, -0.3]), method)


@pytest.mark.parametrize("weight", [1e-12, 1e12])
def test_flat_points_are_refused_whatever_their_weight(weight):
    with pytest.raises(ValueError, match="in one plane"):
        analysis.fit_sphere(FLAT @ ROTATION + 5e5, "ls", weights=np.full(30, weight))


@every_method
def test_flat_cloud_of_a_stack_is_named(method):
    with pytest.raises(ValueError, match=r"in one plane .* in cloud 1 of the stack"):
        analysis.fit_sphere(np.stack([directions(30), FLAT]), method)


def test_flat_cloud_of_a_long_stack_is_named():
    """Also where the stack is solved in parts: the number counts from the start of the stack."""
    stack = clouds.sphere_redraws(100)
    stack[77, :, 2] = 1.0
    with pytest.raises(ValueError, match="in cloud 77 of the stack"):
        analysis.fit_sphere(stack, "ls")


@pytest.mark.parametrize(
    ("angle", "shift", "tolerance"),
    [(0.05, 0.0, 1e-6), (2.0, 0.0, 1e-9), (2.0, 1e3, 1e-3), (10.0, 1e3, 1e-6)],
)
def test_small_caps_are_not_refused(angle, shift, tolerance):
    """A cap of 2° of a 72.5 mm sphere is 0.04 mm high, one of 0.05° 28 nm.

    Little, and still a sphere to the points' own digits.
    """
    points = 0.0725 * directions(100, above=np.cos(np.radians(angle))) + shift
    np.testing.assert_allclose(analysis.fit_sphere(points, "ls").radius, 0.0725, rtol=tolerance)


@every_method
@pytest.mark.parametrize("name", ["weights", "cofactors"])
@pytest.mark.parametrize(
    ("values", "message"),
    [
        (np.zeros(500), "expected positive numbers, got a smallest value of 0"),
        (-np.ones(500), "expected positive numbers, got a smallest value of -1"),
        (np.r_[np.ones(499), -3.0], "expected positive numbers, got a smallest value of -3"),
        (np.r_[np.ones(499), np.nan], "expected finite numbers, got 1 NaN or infinite of 500"),
        (np.r_[np.ones(499), np.inf], "expected finite numbers, got 1 NaN or infinite of 500"),
        (np.ones(499), r"expected shape \(500,\) .*got \(499,\)"),
        (np.ones((500, 1)), r"expected shape \(500,\) .*got \(500, 1\)"),
        (np.ones((2, 500)), r"expected shape \(500,\) .*got \(2, 500\)"),
        (2.0, r"expected shape \(500,\) .*got \(\)"),
        (["a"] * 500, "expected an array of real numbers"),
    ],
)
def test_bad_weights_are_refused(method, name, values, message):
    with pytest.raises(ValueError, match=f"^{name}: {message}"):
        analysis.fit_sphere(GROSS, method, **{name: values})


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"k0": 0.0}, "k0: expected a positive finite number, got 0"),
        ({"k0": -1.5}, "k0: expected a positive finite number, got -1.5"),
        ({"k1": 0}, "k1: expected a positive finite number, got 0"),
        ({"k1": np.inf}, "k1: expected a positive finite number, got inf"),
        ({"k0": np.nan}, "k0: expected a positive finite number, got nan"),
        ({"k0": "a"}, "k0: expected a positive finite number, got 'a'"),
        ({"k0": 2.5}, "expected 0 < k0 < k1 .*k0=2.5, k1=2.5"),
        ({"k0": 3.0, "k1": 2.0}, "expected 0 < k0 < k1 .*k0=3.0, k1=2.0"),
        ({"power": 3}, "power 1 or 2, got .*power=3"),
        ({"power": 1.5}, "power 1 or 2, got .*power=1.5"),
        ({"tolerance": 0}, "tolerance: expected a positive finite number, got 0"),
        ({"tolerance": -1e-6}, "tolerance: expected a positive finite number, got -1e-06"),
        ({"unit_weight": 0}, "unit_weight: expected a positive finite number, got 0"),
        ({"scale": "sd"}, "scale: expected one of rms, rms_in, rms_w, rms_wc, mad, unit; got 'sd'"),
        ({"start": "ls"}, "start: expected one of Q_Y, P_Y; got 'ls'"),
        ({"max_iterations": 0}, "max_iterations: expected .*got 0"),
        ({"max_iterations": -1}, "max_iterations: expected .*got -1"),
        ({"max_iterations": 2.5}, "max_iterations: expected .*got 2.5"),
    ],
)
def test_bad_options_of_igg3_wtls_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        analysis.fit_sphere(GROSS, "igg3_wtls", **options)


@pytest.mark.parametrize("options", [{"tolerance": 0}, {"unit_weight": -1}, {"max_iterations": 0}])
def test_bad_options_of_wtls_are_refused(options):
    (name,) = options
    with pytest.raises(ValueError, match=f"^{name}: expected"):
        analysis.fit_sphere(GROSS, "wtls", **options)


@pytest.mark.parametrize("method", ["lsq", "", None, 3])
def test_unknown_method_is_refused_with_the_known_ones(method):
    with pytest.raises(ValueError, match=f"^method: expected one of {', '.join(METHODS)}; got "):
        analysis.fit_sphere(GROSS, method)


@pytest.mark.parametrize("n", [20, 70_000])
def test_history_is_for_a_single_cloud(n):
    """However the stack is cut into parts."""
    points = np.random.default_rng(15).uniform(-1, 1, (2, n, 3))
    with pytest.raises(ValueError, match="history: expected a single cloud, got a stack"):
        analysis.fit_sphere(points, "igg3_wtls", history=True, max_iterations=2)
