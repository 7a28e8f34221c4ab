"""The plane: every method against the truth, each other, and solvers that share no code with it."""

import numpy as np
import odrpack
import pytest

import analysis
from analysis.adjustment.algorithms import ALGORITHMS
from analysis.surfaces.plane import tangents
from analysis.surfaces.plane_eiv import incidence_cosines

FREE = ("mixed_ls_tls", "eiv", "geometric", "robust")  # of any orientation
TIED = ("ls", "tls", "wtls", "igg3_wtls")  # to z = a x + b y + c
NORMALS = {
    "slope": (-1.0, -3.0, 1.0),
    "level": (0.0, 0.0, 1.0),
    "wall": (3.0, -4.0, 0.0),
    "wall in x": (1.0, 0.0, 0.0),
    "down": (0.2, 0.1, -0.9),
}


def unit(vector):
    return np.asarray(vector, dtype=float) / np.linalg.norm(vector)


def patch(normal, n=100, center=(1.0, 2.0, -5.0), size=1.0, noise=0.0, seed=1):
    """(n, 3) points of a square patch of a plane, with equal noise of every coordinate."""
    generator = np.random.default_rng(seed)
    plan = size * (generator.uniform(size=(n, 2)) - 0.5)
    return center + plan @ tangents(unit(normal)).T + noise * generator.standard_normal((n, 3))


def spd(n, seed=2):
    """(n, 3, 3) cofactors that differ from point to point, in directions too."""
    roots = np.random.default_rng(seed).standard_normal((n, 3, 3))
    return 1e-6 * (roots @ roots.swapaxes(-1, -2) + 0.3 * np.eye(3))


def facing(normal):
    """The sense that the interface promises: z ≥ 0; where it is 0, y; where both are, x."""
    normal = unit(normal)
    first = next(component for component in normal[::-1] if component != 0)
    return normal if first > 0 else -normal


@pytest.mark.parametrize("name", NORMALS)
@pytest.mark.parametrize("method", analysis.PLANE_METHODS)
def test_exact_points_give_the_plane(method, name):
    normal, points = facing(NORMALS[name]), patch(NORMALS[name])
    if method in TIED and normal[2] == 0:
        with pytest.raises(ValueError, match="expected a plane that is not vertical"):
            analysis.fit_plane(points, method)
        return
    fit = analysis.fit_plane(points, method)
    np.testing.assert_allclose(fit.normal, normal, atol=1e-12)
    assert fit.offset == pytest.approx(normal @ (1.0, 2.0, -5.0), abs=1e-11)
    np.testing.assert_allclose(fit.distances, 0, atol=1e-12)
    assert fit.converged
    if normal[2] == 0:
        assert np.isnan(fit.parameters).all()
    else:
        np.testing.assert_allclose(
            fit.parameters, np.array([-normal[0], -normal[1], fit.offset]) / normal[2], atol=1e-10
        )


@pytest.mark.parametrize("method", TIED)
def test_a_noisy_wall_is_refused_too(method):
    stack = np.stack([patch((1, 2, 3)), patch((1, 2, 0), noise=0.002)])
    with pytest.raises(ValueError, match="not vertical.*in cloud 1 of the stack"):
        analysis.fit_plane(stack, method)


@pytest.mark.parametrize("method", analysis.PLANE_METHODS)
def test_steep_but_not_vertical_is_taken(method):
    points = patch((1.0, 1.0, 0.05), noise=1e-5)
    assert np.linalg.norm(analysis.fit_plane(points, method).normal - unit((1.0, 1.0, 0.05))) < 1e-3


@pytest.mark.parametrize(
    "method, given",
    [
        (method, given)
        for method in FREE
        for given in ("equal", "variances", "full")
        if (method, given) != ("mixed_ls_tls", "full")
    ],
)
def test_rotation_translation_and_scale(method, given):
    points = patch((1, 2, 3), noise=0.003)
    cofactors = {"equal": None, "variances": np.linspace(1, 4, 100), "full": spd(100)}[given]
    R, _ = np.linalg.qr(np.random.default_rng(5).standard_normal((3, 3)))
    R *= np.sign(np.linalg.det(R))
    rotated = R @ cofactors @ R.T if given == "full" else cofactors
    before = analysis.fit_plane(points, method, cofactors=cofactors)
    after = analysis.fit_plane(2.5 * points @ R.T + [100.0, -50.0, 7.0], method, cofactors=rotated)
    normal = facing(R @ before.normal)
    np.testing.assert_allclose(after.normal, normal, atol=1e-10)
    turned = np.sign(normal @ R @ before.normal)
    np.testing.assert_allclose(after.distances, 2.5 * turned * before.distances, atol=1e-10)
    assert after.sigma_0 == pytest.approx(2.5 * before.sigma_0, rel=1e-9)
    rotation = turned * R
    np.testing.assert_allclose(
        after.normal_covariance[:3, :3],
        rotation @ before.normal_covariance[:3, :3] @ rotation.T,
        rtol=1e-6,
        atol=1e-12,
    )


@pytest.mark.parametrize("method", analysis.PLANE_METHODS)
def test_order_and_stack_change_nothing(method):
    stack = np.stack([patch((1, 2, 3), noise=0.01, seed=seed) for seed in range(6)]).reshape(
        2, 3, 100, 3
    )
    fits = analysis.fit_plane(stack, method)
    order = np.random.default_rng(0).permutation(100)
    for index in np.ndindex(2, 3):
        single = analysis.fit_plane(stack[index][order], method)
        np.testing.assert_allclose(fits.parameters[index], single.parameters, rtol=1e-9)
        np.testing.assert_allclose(
            fits.normal_covariance[index], single.normal_covariance, rtol=1e-6, atol=1e-15
        )
        np.testing.assert_allclose(fits.distances[index][order], single.distances, atol=1e-11)


@pytest.mark.parametrize("method", [*FREE, "ls", "wtls"])
def test_site_coordinates(method):
    points, far = patch((1, 2, 3), noise=0.002), np.array([4e5, 6e6, 120.0])
    near = analysis.fit_plane(points, method, station=(0, 0, 0))
    away = analysis.fit_plane(points + far, method, station=far)
    np.testing.assert_allclose(away.normal, near.normal, atol=1e-8)
    np.testing.assert_allclose(away.distances, near.distances, atol=5e-9)


# ------------------------------------------------------------------- agreement with other solvers


def test_orthogonal_plane_through_four_points():
    """(0 0 0), (1 0 0), (0 1 0), (0 0 1): Σd² = 1/4.

    The least of the problem by symmetry (scikit-spatial's tests).
    """
    fit = analysis.fit_plane(np.vstack([np.zeros(3), np.eye(3)]), "geometric")
    np.testing.assert_allclose(fit.normal, np.full(3, 3**-0.5), atol=1e-14)
    assert fit.offset == pytest.approx(0.25 * 3**0.5, abs=1e-14)
    assert np.sum(fit.distances**2) == pytest.approx(0.25, abs=1e-14)


@pytest.mark.parametrize("weights", [None, np.linspace(0.5, 3, 100)])
@pytest.mark.parametrize("method", ["mixed_ls_tls", "eiv", "geometric"])
def test_weighted_principal_components(method, weights):
    points = patch((1, 2, 3), noise=0.02)
    P = np.ones(100) if weights is None else weights
    mean = P @ points / P.sum()
    values, vectors = np.linalg.eigh((points - mean).T @ (P[:, None] * (points - mean)))
    fit = analysis.fit_plane(points, method, weights=weights)
    np.testing.assert_allclose(fit.normal, facing(vectors[:, 0]), atol=1e-12)
    assert fit.offset == pytest.approx(facing(vectors[:, 0]) @ mean, abs=1e-12)
    assert fit.sigma_0 == pytest.approx(np.sqrt(values[0] / 97), rel=1e-9)


@pytest.mark.parametrize("weights", [None, np.linspace(0.5, 3, 100)])
def test_the_linear_solvers_agree(weights):
    points = patch((1, 2, 3), noise=0.02)
    A, y = np.column_stack([points[:, :2], np.ones(100)]), points[:, 2]
    P = np.ones(100) if weights is None else weights
    rows = np.sqrt(P)[:, None] * np.column_stack([A, y])
    for method, estimate in {
        "ls": analysis.ls(A, y, weights),
        "tls": analysis.tls(rows[:, :3], rows[:, 3]),
        "mixed_ls_tls": analysis.wtls(A, y, Q_0=np.diag([1.0, 1.0, 0.0]), Q_X=1 / P, Q_y=1 / P),
    }.items():
        fit = analysis.fit_plane(points, method, weights=weights)
        np.testing.assert_allclose(fit.parameters, estimate.x, rtol=1e-9)
        np.testing.assert_allclose(fit.covariance, estimate.covariance, rtol=1e-6)
        assert fit.sigma_0 == pytest.approx(estimate.sigma_0, rel=1e-9)


@pytest.mark.parametrize("cosine_at", ["raw", "projected"])
def test_wtls_is_the_printed_problem_with_its_own_weights(cosine_at):
    """Weights of the LS plane, then of each new one.

    For given weights the minimum is weighted principal component analysis.
    """
    points = patch((1, 2, 3), noise=0.05)
    A, y = np.column_stack([points[:, :2], np.ones(100)]), points[:, 2]
    x = analysis.ls(A, y).x
    for reweightings in range(4):
        P = incidence_cosines(points, x, at=cosine_at)
        estimate = analysis.wtls(A, y, Q_0=np.diag([1.0, 1.0, 0.0]), Q_X=1 / P, Q_y=1 / P)
        x = estimate.x
        fit = analysis.fit_plane(points, "wtls", cosine_at=cosine_at, reweightings=reweightings)
        np.testing.assert_allclose(fit.parameters, x, rtol=1e-10)
        np.testing.assert_allclose(fit.covariance, estimate.covariance, rtol=1e-7)
        np.testing.assert_allclose(
            fit.normal, analysis.fit_plane(points, "geometric", weights=P).normal, atol=1e-11
        )


def test_every_algorithm_finds_the_same_wtls_plane():
    points = np.stack([patch((1, 2, 3), noise=0.05, seed=seed) for seed in range(5)])
    expected = analysis.fit_plane(points, "wtls").parameters
    for algorithm in ALGORITHMS:
        np.testing.assert_allclose(
            analysis.fit_plane(points, "wtls", algorithm=algorithm).parameters, expected, rtol=1e-11
        )


def row_cofactors(Q):
    """Of rows (x, y, 1 | z) from those of the points."""
    rows = np.zeros((len(Q), 4, 4))
    rows[:, np.array([0, 1, 3])[:, None], [0, 1, 3]] = Q
    return rows


def test_full_cofactors_agree_with_the_general_solver():
    points, Q = patch((1, 2, 3), noise=0.003), spd(100)
    estimate = analysis.wtls(
        np.column_stack([points[:, :2], np.ones(100)]), points[:, 2], row_cofactors=row_cofactors(Q)
    )
    for method in ("eiv", "geometric"):
        fit = analysis.fit_plane(points, method, cofactors=Q)
        np.testing.assert_allclose(fit.parameters, estimate.x, rtol=1e-9)
        np.testing.assert_allclose(fit.covariance, estimate.covariance, rtol=1e-6)
        assert fit.sigma_0 == pytest.approx(estimate.sigma_0, rel=1e-9)


def test_full_cofactors_agree_with_odrpack():
    """Explicit ODR has x and y correlated, and z apart from them."""
    points, Q = patch((1, 2, 3), noise=0.003), spd(100)
    Q[:, :2, 2] = Q[:, 2, :2] = 0.0
    result = odrpack.odr_fit(
        lambda columns, x: x[0] * columns[0] + x[1] * columns[1] + x[2],
        points[:, :2].T,
        points[:, 2],
        np.array([-0.33, -0.66, -3.33]),
        weight_x=np.moveaxis(np.linalg.inv(Q[:, :2, :2]), 0, -1),
        weight_y=1.0 / Q[:, 2, 2],
        jac_beta=lambda columns, x: np.vstack([columns, np.ones(100)])[None],
        jac_x=lambda columns, x: np.outer(x[:2], np.ones(100))[None],
        partol=1e-14,
        sstol=1e-14,
        maxit=500,
    )
    fit = analysis.fit_plane(points, "geometric", cofactors=Q)
    np.testing.assert_allclose(fit.parameters, result.beta, rtol=1e-6)
    np.testing.assert_allclose(fit.standard_deviations, result.sd_beta, rtol=0.01)


@pytest.mark.parametrize("method", ["eiv", "geometric", "robust"])
def test_equal_cofactors_are_no_cofactors(method):
    points = patch((1, 2, 0), noise=0.003)
    without = analysis.fit_plane(points, method)
    given = analysis.fit_plane(
        points, method, cofactors=np.broadcast_to(4e-6 * np.eye(3), (100, 3, 3))
    )
    np.testing.assert_allclose(given.normal, without.normal, atol=1e-9)
    assert given.sigma_0 == pytest.approx(without.sigma_0 / 0.002, rel=1e-6)
    np.testing.assert_allclose(
        given.normal_covariance, without.normal_covariance, rtol=1e-5, atol=1e-14
    )


# --------------------------------------------------------------------------- stochastic properties


@pytest.mark.parametrize("method", ["mixed_ls_tls", "geometric", "robust"])
@pytest.mark.parametrize("normal", [(1, 2, 3), (1, 2, 0)])
def test_the_stated_accuracy_is_the_accuracy(method, normal):
    """95 % regions of the direction and of the height over the centroid, from 2000 redraws."""
    center, n = np.array([1.0, 2.0, -5.0]), facing(normal)
    stack = np.stack([patch(normal, n=40, noise=0.002, seed=seed) for seed in range(2000)])
    fit = analysis.fit_plane(stack, method)
    E = np.zeros((3, 4))
    E[:2, :3] = tangents(n).T
    E[2] = [*-center, 1.0]  # of the distance of the centre from the plane
    error = np.stack(
        [*((fit.normal - n) @ tangents(n)).T, fit.offset - fit.normal @ center], axis=-1
    )
    square = np.einsum(
        "bi,bi->b",
        error,
        np.linalg.solve(E @ fit.normal_covariance @ E.T, error[..., None])[..., 0],
    )
    from scipy.stats import f as fisher

    used = fit.inliers.sum(axis=-1)
    share = np.mean(square <= 3 * fisher.ppf(0.95, 3, used - 3))
    assert share == pytest.approx(0.95, abs=0.015)


def test_covariance_of_slopes_and_of_the_normal_belong_together():
    fit = analysis.fit_plane(patch((1, 2, 3), noise=0.002), "geometric", cofactors=spd(100))
    a, b, c = fit.parameters
    J = np.zeros((3, 4))
    z = fit.normal[2]
    J[0], J[1], J[2] = [-1 / z, 0, -a / z, 0], [0, -1 / z, -b / z, 0], [0, 0, -c / z, 1 / z]
    np.testing.assert_allclose(J @ fit.normal_covariance @ J.T, fit.covariance, rtol=1e-8)
    assert (
        np.linalg.matrix_rank(
            fit.normal_covariance, tol=1e-9 * np.linalg.norm(fit.normal_covariance)
        )
        == 3
    )
    tied = analysis.fit_plane(patch((1, 2, 3), noise=0.002), "ls")
    np.testing.assert_allclose(J.shape, (3, 4))
    z, (a, b, c) = tied.normal[2], tied.parameters
    J[0], J[1], J[2] = [-1 / z, 0, -a / z, 0], [0, -1 / z, -b / z, 0], [0, 0, -c / z, 1 / z]
    np.testing.assert_allclose(J @ tied.normal_covariance @ J.T, tied.covariance, rtol=1e-8)


def gross(share, one_sided, runs=200, n=100, seed=3):
    """(runs, n, 3) level patches of 1 m with σ 2 mm, the first points of each off by 5 to 50 cm."""
    generator = np.random.default_rng(seed)
    points = np.concatenate(
        [generator.uniform(-0.5, 0.5, (runs, n, 2)), np.zeros((runs, n, 1))], axis=-1
    )
    points += 0.002 * generator.standard_normal(points.shape)
    count = round(share * n)
    side = 1.0 if one_sided else np.where(generator.uniform(size=(runs, count)) < 0.5, -1.0, 1.0)
    points[:, :count, 2] += side * generator.uniform(0.05, 0.5, (runs, count))
    return points, count


@pytest.mark.parametrize("share, one_sided, limit", [(0.05, False, 1.1), (0.4, True, 2.0)])
def test_robust_against_gross_errors(share, one_sided, limit):
    points, count = gross(share, one_sided)

    def angles(fit):
        return np.linalg.norm(fit.normal[:, :2], axis=-1)  # of normals near the vertical, rad

    without = np.median(angles(analysis.fit_plane(points[:, count:], "mixed_ls_tls")))
    fit = analysis.fit_plane(points, "robust")
    assert np.median(angles(fit)) <= limit * without
    # 0.6°; the gross errors tilt SVD by several
    assert fit.converged.all() and angles(fit).max() < 0.01
    assert (fit.weights[:, :count] == 0).all()
    assert np.median(angles(analysis.fit_plane(points, "mixed_ls_tls"))) > 20 * without


def test_igg3_wtls_rejects_a_gross_error_and_says_so_with_a_zero():
    points, count = gross(0.01, False, runs=20)
    fit = analysis.fit_plane(points + [0, 0, -3.0], "igg3_wtls")
    assert (fit.weights[:, :count] == 0.0).all()
    assert np.median(np.linalg.norm(fit.normal[:, :2], axis=-1)) < 0.005


@pytest.mark.parametrize("method", ["mixed_ls_tls", "geometric", "robust"])
def test_no_gross_errors_no_difference(method):
    points = patch((1, 2, 3), n=500, noise=0.002)
    reference = analysis.fit_plane(points, "mixed_ls_tls")
    assert np.linalg.norm(
        analysis.fit_plane(points, method).normal - reference.normal
    ) < 0.5 * np.sqrt(np.trace(reference.normal_covariance[:3, :3]))


def test_robust_repeats_itself():
    points, _ = gross(0.4, True, runs=3)
    first, again = (analysis.fit_plane(points, seed=4).parameters for _ in range(2))
    assert np.array_equal(first, again)
    np.testing.assert_allclose(analysis.fit_plane(points, seed=5).parameters, first, atol=1e-9)


# ------------------------------------------------------------------------------- incidence,
# reliability


def test_incidence_cosines():
    generator = np.random.default_rng(0)
    points, plane, station = (
        generator.uniform(1, 2, (50, 3)),
        np.array([0.4, -0.7, 3.0]),
        np.array([0.1, 0.2, 0.3]),
    )
    n = np.array([0.4, -0.7, -1.0]) / np.sqrt(0.4**2 + 0.7**2 + 1)
    beams = (points - station) / np.linalg.norm(points - station, axis=-1, keepdims=True)
    np.testing.assert_allclose(
        incidence_cosines(points, plane, station), np.abs(beams @ n), rtol=1e-12
    )
    on_plane = points - ((points @ n) + 3.0 * np.sqrt(1 / (0.4**2 + 0.7**2 + 1)))[:, None] * n
    np.testing.assert_allclose(on_plane @ [0.4, -0.7, -1.0] + 3.0, 0, atol=1e-12)
    np.testing.assert_allclose(
        incidence_cosines(points, plane, station, at="projected"),
        incidence_cosines(on_plane, plane, station),
        rtol=1e-12,
    )
    with pytest.raises(ValueError, match="expected points away from the station, got 1 in it"):
        incidence_cosines(np.vstack([points, station]), plane, station)
    with pytest.raises(ValueError, match="cosine_at"):
        incidence_cosines(points, plane, at="measured")


@pytest.mark.parametrize("far", [0.0, 5e6])
def test_reliability_of_a_plane(far):
    points = patch((1, 2, 3), noise=0.002) + far
    points[7] += 0.05 * unit((1, 2, 3))
    found = analysis.reliability(analysis.fit_plane(points), points)
    assert found.redundancy.sum() == pytest.approx(100 - 3, abs=1 + 1e-6)  # 7 is not in use
    assert np.flatnonzero(found.suspects()).tolist() == [7]
    fit, kept = analysis.data_snooping(
        points,
        lambda points, **given: analysis.fit_plane(points, "geometric", **given),
        sigma=0.002,
    )
    assert np.flatnonzero(~kept).tolist() == [7]


def test_external_reliability_is_what_the_error_does():
    """An error of the minimal detectable size in one point moves (a, b, c) by what is stated."""
    points = patch((1, 2, 3), n=30, noise=0.0005)
    fit = analysis.fit_plane(points, "geometric")
    found = analysis.reliability(fit, points, sigma=1e-5)
    moved = points.copy()
    moved[4] += found.minimal_bias[4] * fit.normal
    np.testing.assert_allclose(
        analysis.fit_plane(moved, "geometric").parameters - fit.parameters,
        found.external[4],
        rtol=0.02,
        atol=1e-9,
    )


# --------------------------------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    "points, message",
    [
        (np.zeros((2, 3)), "at least 3 points for a plane, got 2"),
        (np.zeros((9, 3)), "all at one place"),
        (np.arange(9.0)[:, None] * [1.0, 2.0, 3.0] + 7, "on one line"),
        (np.full((9, 3), np.nan), "finite"),
        (np.zeros((9, 2)), "shape"),
    ],
)
def test_bad_points(points, message):
    with pytest.raises(ValueError, match=message):
        analysis.fit_plane(points)


@pytest.mark.parametrize(
    "given, message",
    [
        ({"method": "pca"}, "mixed_ls_tls"),
        ({"weights": np.zeros(100)}, "positive"),
        ({"station": (0, 0)}, "station: expected shape"),
        ({"method": "ls", "cofactors": spd(100)}, "eiv, geometric, robust with full cofactors"),
        ({"method": "wtls", "cosine_at": "here"}, "cosine_at"),
        ({"method": "wtls", "reweightings": -1}, "reweightings"),
        ({"method": "wtls", "algorithm": "simplex"}, "bfgs"),
        ({"method": "geometric", "max_iterations": 0}, "max_iterations"),
        ({"k0": 3.0, "k1": 2.0}, "k0"),
    ],
)
def test_bad_options(given, message):
    with pytest.raises(ValueError, match=message):
        analysis.fit_plane(patch((1, 2, 3), noise=0.001), **given)


def test_input_is_not_changed():
    points, Q = patch((1, 2, 3), noise=0.001), spd(100)
    copies = points.copy(), Q.copy()
    for method in analysis.PLANE_METHODS:
        analysis.fit_plane(
            points, method, cofactors=Q if analysis.PLANE_METHODS[method].consistent else None
        )
    assert np.array_equal(points, copies[0]) and np.array_equal(Q, copies[1])
