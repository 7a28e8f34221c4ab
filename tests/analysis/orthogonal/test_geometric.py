"""The methods `eiv` and `geometric`: minima against other solvers, effect of cofactors."""

import warnings

import numpy as np
import pytest
from odrpack import odr_fit
from scipy.optimize import least_squares

import analysis
from analysis.result import ConvergenceWarning

CONSISTENT = ("eiv", "geometric", "robust")
# the plain minimum, as other solvers have it
PLAIN: dict[str, dict] = {
    "eiv": {},
    "geometric": {"bias_correction": False},
    "robust": {"bias_correction": False},
}
every_consistent = pytest.mark.parametrize("method", CONSISTENT)

TRUTH = np.array([0.6, -0.4, 3.0, 1.0])
N = 80
SIGMA = 0.01


def directions(count, rng, cap):
    """Unit vectors (…, 3) within ``cap`` degrees of the z axis."""
    z, angle = rng.uniform(np.cos(np.radians(cap)), 1.0, count), rng.uniform(0, 2 * np.pi, count)
    return np.stack(
        [np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z], axis=-1
    )


def some_covariances(count, rng):
    """Covariances whose axes lie anywhere and differ up to a factor of about ten in variance."""
    axes = np.linalg.qr(rng.standard_normal((count, 3, 3)))[0]
    return (axes * rng.uniform(0.3, 3.0, (count, 1, 3))) @ axes.swapaxes(-1, -2)


RNG = np.random.default_rng(1)
COFACTORS = {"none": None, "variances": RNG.uniform(0.3, 3.0, N), "full": some_covariances(N, RNG)}
every_cofactor = pytest.mark.parametrize("kind", COFACTORS)


def in_full(kind):
    """(n, 3, 3), whatever form the cofactors have."""
    cofactors = np.ones(N) if COFACTORS[kind] is None else COFACTORS[kind]
    return cofactors if cofactors.ndim == 3 else cofactors[:, None, None] * np.eye(3)


def cloud(kind="none", sigma=SIGMA, seed=2):
    """Points within 80° of the top of the sphere TRUTH, with errors of covariance ``sigma² Q``."""
    rng = np.random.default_rng(seed)
    errors = np.linalg.cholesky(in_full(kind)) @ rng.standard_normal((N, 3, 1))
    return TRUTH[:3] + TRUTH[3] * directions(N, rng, 80.0) + sigma * errors[..., 0]


def fit(method="geometric", kind="none", points=None, **options):
    return analysis.fit_sphere(
        cloud(kind) if points is None else points, method, cofactors=COFACTORS[kind], **options
    )


# ------------------------------------------------------------------------------ against other
# solvers


def odrpack_of(points, start, Q, held):
    """``|p − k| − r = 0`` by ODRPACK in implicit mode.

    Its ``cov_beta`` times ``res_var`` is the covariance, ``sd_beta`` squared.
    """

    def normals(columns, x):
        D = columns - x[:3, None]
        return D / np.linalg.norm(D, axis=0)

    return odr_fit(
        lambda columns, x: np.linalg.norm(columns - x[:3, None], axis=0) - x[3],
        points.T,
        np.zeros(N),
        start,
        task="implicit-ODR",
        weight_x=np.moveaxis(np.linalg.inv(Q), 0, -1),
        fix_beta=np.array([False, False, False, held]),
        jac_beta=lambda columns, x: np.vstack([-normals(columns, x), -np.ones(N)])[None],
        jac_x=lambda columns, x: normals(columns, x)[None],
        partol=1e-14,
        sstol=1e-14,
        maxit=500,
    )


@every_cofactor
@pytest.mark.parametrize("radius", [None, 1.0])
def test_geometric_is_odrpack(kind, radius):
    ours = fit(kind=kind, radius=radius, bias_correction=False)
    theirs = odrpack_of(
        cloud(kind), TRUTH + [0.01, 0.02, -0.01, 0.0], in_full(kind), radius is not None
    )
    np.testing.assert_allclose(ours.parameters, theirs.beta, rtol=1e-6)
    np.testing.assert_allclose(ours.standard_deviations, theirs.sd_beta, rtol=0.01)
    np.testing.assert_allclose(ours.sigma_0**2, theirs.res_var, rtol=0.01)


def least_squares_of(residuals, held):
    """Parameters (a, b, c, r) and their covariance by scipy, the radius free or left at TRUTH's."""
    count = 3 if held else 4
    solution = least_squares(
        lambda x: residuals(np.append(x, TRUTH[count:])),
        TRUTH[:count],
        jac="3-point",
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-15,
    )
    covariance = np.zeros((4, 4))
    covariance[:count, :count] = (
        2 * solution.cost / (N - count) * np.linalg.inv(solution.jac.T @ solution.jac)
    )
    return np.append(solution.x, TRUTH[count:]), covariance


@pytest.mark.parametrize("held", [False, True])
@pytest.mark.parametrize("kind", ["none", "variances"])
def test_geometric_minimises_the_distances(kind, held):
    points, sd = cloud(kind), np.sqrt(in_full(kind)[:, 0, 0])
    expected, covariance = least_squares_of(
        lambda x: (np.linalg.norm(points - x[:3], axis=1) - x[3]) / sd, held
    )
    ours = fit(kind=kind, radius=TRUTH[3] if held else None, bias_correction=False)
    np.testing.assert_allclose(ours.parameters, expected, rtol=1e-8)
    np.testing.assert_allclose(ours.covariance, covariance, rtol=1e-6, atol=1e-6 * covariance.max())


@pytest.mark.parametrize("held", [False, True])
@every_cofactor
def test_eiv_minimises_the_standardised_misclosures(kind, held):
    """``r = |p − k|² − R²`` over the square root of its variance ``4 (p − k)ᵀQ(p − k)``."""
    points, Q = cloud(kind), in_full(kind)

    def residuals(x):
        D = points - x[:3]
        return (np.sum(D * D, axis=1) - x[3] ** 2) / np.sqrt(4 * np.einsum("ni,nij,nj->n", D, Q, D))

    expected, covariance = least_squares_of(residuals, held)
    ours = fit("eiv", kind, radius=TRUTH[3] if held else None)
    np.testing.assert_allclose(ours.parameters, expected, rtol=1e-8)
    np.testing.assert_allclose(ours.covariance, covariance, rtol=1e-5, atol=1e-5 * covariance.max())
    np.testing.assert_allclose(
        ours.sigma_0,
        np.sqrt(np.sum(residuals(ours.parameters) ** 2) / (N - (3 if held else 4))),
        rtol=1e-10,
    )


def test_eiv_with_equal_cofactors_shrinks_each_distance():
    """``Φ = Σ d² (1 − d/(2ρ))²``, ρ = |p − k|: the least of it is at the fit."""
    points, ours = cloud(), fit("eiv")

    def objective(x):
        rho = np.linalg.norm(points - x[:3], axis=1)
        d = rho - x[3]
        return np.sum((d - d**2 / (2 * rho)) ** 2)

    least = objective(ours.parameters)
    np.testing.assert_allclose(least, ours.sigma_0**2 * (N - 4), rtol=1e-12)
    for step in 1e-4 * np.vstack([np.eye(4), -np.eye(4)]):
        assert objective(ours.parameters + step) > least


def test_eiv_and_geometric_differ_with_the_square_of_the_noise():
    """Four times when σ doubles.

    Both see the same errors, taken with either sign, so that odd powers of σ cancel.
    """
    rng = np.random.default_rng(3)
    points = 0.0725 * directions((300, 60), rng, 80.0)
    errors = rng.standard_normal(points.shape)
    sigmas = np.array([0.00025, 0.0005, 0.001])
    differences = []
    for sigma in sigmas:
        both_signs = np.stack([points + sigma * errors, points - sigma * errors])
        eiv, geometric = (
            analysis.fit_sphere(both_signs, method, **PLAIN[method]).parameters
            for method in ("eiv", "geometric")
        )
        # along the axis of the cap, and the radius
        differences.append((eiv - geometric).mean(axis=(0, 1))[2:])
    ratios = np.array(differences[1:]) / differences[:-1]
    np.testing.assert_allclose(ratios, 4.0, rtol=0.02)
    # Their size in σ²/R: of order one.
    assert np.all(np.abs(differences[-1]) < 5 * sigmas[-1] ** 2 / 0.0725)


def mahalanobis_foot_step(points, Q, x):
    """Gauss-Newton step of ``min Σ eᵀQ⁻¹e`` from x.

    The point of the sphere nearest to each p is found by Newton in the multiplier.
    """
    weight = np.linalg.inv(Q)
    values, vectors = np.linalg.eigh(weight)
    b = np.einsum("nji,nj->ni", vectors, np.einsum("nij,nj->ni", weight, points - x[:3]))
    low, high = -values[:, 0], np.linalg.norm(b, axis=1) / x[3]
    for _ in range(200):  # Σ (b/(w + μ))² falls from ∞ to below r² in this interval
        middle = 0.5 * (low + high)
        beyond = np.sum((b / (values + middle[:, None])) ** 2, axis=1) > x[3] ** 2
        low, high = np.where(beyond, middle, low), np.where(beyond, high, middle)
    foot = np.einsum("nij,nj->ni", vectors, b / (values + middle[:, None]))
    normals = foot / np.linalg.norm(foot, axis=1)[:, None]
    f = np.einsum("ni,ni->n", normals, points - x[:3] - foot)
    variances = np.einsum("ni,nij,nj->n", normals, Q, normals)
    J = np.column_stack([-normals, -np.ones(len(f))])
    return -np.linalg.solve((J / variances[:, None]).T @ J, (J / variances[:, None]).T @ f)


@pytest.mark.parametrize("sigma", [0.001, 0.01, 0.03])
def test_geometric_with_full_cofactors_is_at_the_minimum(sigma):
    """Each point's error runs to the nearest point of the sphere in the metric of its covariance.

    That is found here in another way.
    """
    points = cloud("full", sigma)
    ours = fit(kind="full", points=points, bias_correction=False)
    np.testing.assert_allclose(
        mahalanobis_foot_step(points, in_full("full"), ours.parameters), 0.0, rtol=0, atol=1e-9
    )


def test_geometric_at_the_limb_of_a_scanned_sphere():
    """Where the beam grazes the sphere its range error runs along the surface.

    20 times the error across it.
    """
    rng = np.random.default_rng(4)
    center, radius, sigma_range, sigma_across = np.array([0.0, 0.0, -6.0]), 0.0725, 0.002, 0.0001
    points = center + radius * directions(500, rng, 86.0)
    beams = points / np.linalg.norm(points, axis=1)[:, None]
    along = beams[:, :, None] * beams[:, None, :]
    Q = sigma_range**2 * along + sigma_across**2 * (np.eye(3) - along)
    points += (np.linalg.cholesky(Q) @ rng.standard_normal((500, 3, 1)))[..., 0]
    ours = analysis.fit_sphere(points, "geometric", cofactors=Q, bias_correction=False)
    step = mahalanobis_foot_step(points, Q, ours.parameters)
    assert ours.converged
    assert np.all(np.abs(step) < 1e-3 * ours.standard_deviations)


# ------------------------------------------------------------------------------ what the cofactors
# do


@every_consistent
def test_full_cofactors_variances_and_weights_say_the_same(method):
    variances = COFACTORS["variances"]
    points = cloud("variances")
    expected = analysis.fit_sphere(points, method, cofactors=variances)
    for given in ({"weights": 1 / variances}, {"cofactors": variances[:, None, None] * np.eye(3)}):
        other = analysis.fit_sphere(points, method, **given)
        np.testing.assert_allclose(other.parameters, expected.parameters, rtol=1e-9)
        np.testing.assert_allclose(
            other.covariance, expected.covariance, rtol=1e-6, atol=1e-9 * expected.covariance.max()
        )
        np.testing.assert_allclose(other.weights, expected.weights, atol=1e-6)


@every_consistent
@pytest.mark.parametrize("kind", ["variances", "full"])
@pytest.mark.parametrize("factor", [1e-6, 7.0])
def test_scale_of_the_cofactors_is_in_sigma_0_alone(method, kind, factor):
    points = cloud(kind)
    before = analysis.fit_sphere(points, method, cofactors=COFACTORS[kind])
    after = analysis.fit_sphere(points, method, cofactors=factor * COFACTORS[kind])
    size = np.abs(before.covariance).max()
    np.testing.assert_allclose(after.parameters, before.parameters, rtol=1e-9)
    np.testing.assert_allclose(after.covariance, before.covariance, rtol=1e-6, atol=1e-7 * size)
    np.testing.assert_allclose(after.weights, before.weights, atol=1e-6)
    np.testing.assert_allclose(after.sigma_0, before.sigma_0 / np.sqrt(factor), rtol=1e-7)


@every_consistent
def test_sigma_0_is_1_for_the_covariances_the_points_have(method):
    clouds = np.stack([cloud("full", seed=seed) for seed in range(40)])
    sigma_0 = analysis.fit_sphere(clouds, method, cofactors=SIGMA**2 * COFACTORS["full"]).sigma_0
    np.testing.assert_allclose(np.mean(sigma_0), 1.0, atol=3 / np.sqrt(2 * 40 * (N - 4)))


@every_consistent
@pytest.mark.parametrize("kind", ["variances", "full"])
def test_absolute_cofactors_leave_the_covariance_unscaled(method, kind):
    Q = SIGMA**2 * COFACTORS[kind]
    relative, absolute = (
        analysis.fit_sphere(cloud(kind), method, cofactors=Q, absolute=on, **PLAIN[method])
        for on in (False, True)
    )
    np.testing.assert_array_equal(absolute.parameters, relative.parameters)
    np.testing.assert_array_equal(absolute.covariance, relative.cofactor)
    np.testing.assert_allclose(
        relative.covariance, relative.sigma_0**2 * absolute.covariance, rtol=1e-12
    )


def test_absolute_needs_cofactors():
    with pytest.raises(ValueError, match="absolute: expected cofactors"):
        analysis.fit_sphere(cloud(), absolute=True)


@every_consistent
@every_cofactor
def test_a_held_radius_is_held_and_has_no_variance(method, kind):
    ours = fit(method, kind, radius=1.01)
    assert ours.radius == pytest.approx(1.01, rel=1e-15)
    size = ours.covariance.max()
    np.testing.assert_allclose(ours.covariance[3], 0.0, atol=1e-12 * size)
    np.testing.assert_allclose(ours.covariance[:, 3], 0.0, atol=1e-12 * size)
    assert np.all(np.linalg.eigvalsh(ours.covariance[:3, :3]) > 0)
    # What is known need not be found: the centre is better known than with a free radius, along the
    # axis of the cap above all.
    assert ours.cofactor[2, 2] < 0.2 * fit(method, kind).cofactor[2, 2]


@pytest.mark.parametrize(
    ("method", "part_of_sigma"), [("eiv", 1e-6), ("geometric", 1e-6), ("robust", 0.01)]
)
@every_cofactor
def test_the_radius_found_and_then_held_gives_the_same_centre(method, part_of_sigma, kind):
    """But for the redundancies, larger by one, which decide about the weights of `robust`."""
    free = fit(method, kind, **PLAIN[method])
    held = fit(method, kind, radius=float(free.radius), **PLAIN[method])
    np.testing.assert_allclose(held.center, free.center, rtol=0, atol=part_of_sigma * SIGMA)


def test_a_held_radius_on_a_small_cap():
    """Where the radius can hardly be found, holding it matters most.

    The points are good, so all methods agree to their noise.
    """
    rng = np.random.default_rng(10)
    points = 0.05 * directions((20, 200), rng, 20.0) + 0.0005 * rng.standard_normal((20, 200, 3))
    expected = analysis.fit_sphere(points, "geometric", radius=0.05)
    for method in ("eiv", "robust"):
        ours = analysis.fit_sphere(points, method, radius=0.05)
        assert ours.converged.all()
        np.testing.assert_allclose(ours.center, expected.center, rtol=0, atol=0.0003)


@pytest.mark.parametrize("method", ["eiv", "geometric"])
def test_a_held_radius_leaves_three_points_of_four_to_three_parameters(method):
    """n = t + 1: one redundant point, and σ0 says so."""
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3)
    ours = analysis.fit_sphere(5.0 + 1.001 * corners, method, radius=1.0)
    np.testing.assert_allclose(ours.center, 5.0, atol=1e-12)
    # Four distances of 1 mm; eiv takes (|p|² − R²)/(2|p|) for them.
    np.testing.assert_allclose(ours.distances, 0.001, rtol=1e-9)
    np.testing.assert_allclose(ours.sigma_0, np.sqrt(4 * 0.001**2 / 1), rtol=1e-3)


# ------------------------------------------------------------------------------ bias


def test_bias_along_the_line_of_sight():
    """R = 72.5 mm, 60 points within 80° of the scanner.

    LS comes out towards it, the consistent methods do not.

    Errors of either sign: what is linear in them cancels, so that a few hundred clouds show the
    bias.
    """
    rng = np.random.default_rng(6)
    points = 0.0725 * directions((200, 60), rng, 80.0)
    errors = rng.standard_normal(points.shape)
    for sigma, limit in ((0.002, 0.05), (0.005, 0.4)):
        noisy = np.concatenate([points + sigma * errors, points - sigma * errors])
        for method in CONSISTENT:
            towards = 1e3 * analysis.fit_sphere(noisy, method).center[:, 2]
            assert abs(towards.mean()) < limit, (method, sigma)
        if sigma == 0.002:
            assert 1e3 * analysis.fit_sphere(noisy, "ls").center[:, 2].mean() == pytest.approx(
                0.57, abs=0.02
            )


# ------------------------------------------------------------------------------ the frame does not
# matter

ROTATION = np.linalg.qr(np.random.default_rng(7).standard_normal((3, 3)))[0]
SHIFT = np.array([30.0, -20.0, 10.0])
FACTOR = 3.7
ORDER = np.random.default_rng(8).permutation(N)

# What each motion does to the points (n, 3), and its matrix on (a, b, c, r) and on a point; then
# what it adds.
MOTIONS = {
    "translation": (np.eye(3), 1.0, SHIFT),
    "rotation": (ROTATION, 1.0, np.zeros(3)),
    "scale": (np.eye(3), FACTOR, np.zeros(3)),
    "all": (ROTATION, FACTOR, SHIFT),
}


@every_consistent
@every_cofactor
@pytest.mark.parametrize("motion", MOTIONS)
def test_moved_points_and_cofactors_give_the_moved_sphere_and_covariance(method, kind, motion):
    R, scale, shift = MOTIONS[motion]
    before = fit(method, kind)
    Q = COFACTORS[kind]
    moved_Q = R @ Q @ R.T if kind == "full" else Q
    after = analysis.fit_sphere(scale * cloud(kind) @ R.T + shift, method, cofactors=moved_Q)
    T = scale * np.block([[R, np.zeros((3, 1))], [np.zeros((1, 3)), np.ones((1, 1))]])
    expected = T @ before.parameters + np.append(shift, 0.0)
    covariance = T @ before.covariance @ T.T
    np.testing.assert_allclose(
        after.parameters, expected, rtol=0, atol=1e-9 * np.abs(expected).max()
    )
    np.testing.assert_allclose(after.covariance, covariance, rtol=0, atol=1e-6 * covariance.max())
    np.testing.assert_allclose(after.weights, before.weights, atol=1e-6)


@every_consistent
@every_cofactor
def test_order_of_the_points_does_not_matter(method, kind):
    before = fit(method, kind)
    Q = COFACTORS[kind]
    after = analysis.fit_sphere(
        cloud(kind)[ORDER], method, cofactors=None if Q is None else Q[ORDER]
    )
    np.testing.assert_allclose(after.parameters, before.parameters, rtol=1e-9)
    np.testing.assert_allclose(after.weights, before.weights[ORDER], atol=1e-6)


@every_consistent
@pytest.mark.parametrize("radius", [None, 0.05])
def test_a_small_sphere_at_large_coordinates(method, radius):
    """50 mm on a national grid.

    The points rounded to their last digits there, the answer moved by whole metres to 1 µm.
    """
    rng = np.random.default_rng(9)
    shift = np.array([5e5, 4e6, 100.0])
    near = 0.05 * directions(300, rng, 80.0) + 0.0005 * rng.standard_normal((300, 3))
    far = analysis.fit_sphere(near + shift, method, radius=radius)
    expected = analysis.fit_sphere(near, method, radius=radius)
    np.testing.assert_allclose(
        far.parameters - np.append(shift, 0.0), expected.parameters, rtol=0, atol=1e-6
    )
    np.testing.assert_allclose(
        far.covariance, expected.covariance, rtol=1e-4, atol=1e-4 * expected.covariance.max()
    )


# ------------------------------------------------------------------------------ stacks, and what
# does not converge


@every_consistent
@every_cofactor
@pytest.mark.parametrize("radius", [None, 1.0])
def test_a_stack_with_cofactors_is_its_clouds_one_by_one(method, kind, radius):
    points = np.stack([cloud(kind, seed=seed) for seed in range(4)]).reshape(2, 2, N, 3)
    scales = np.array([[1.0, 2.0], [0.5, 4.0]])
    Q = None if kind == "none" else np.multiply.outer(scales, COFACTORS[kind])
    for given in (COFACTORS[kind], Q):
        together = analysis.fit_sphere(points, method, cofactors=given, radius=radius)
        for index in np.ndindex(2, 2):
            its_own = given[index] if given is not None and given is Q else given
            apart = analysis.fit_sphere(points[index], method, cofactors=its_own, radius=radius)
            np.testing.assert_allclose(together.parameters[index], apart.parameters, rtol=1e-9)
            np.testing.assert_allclose(
                together.covariance[index],
                apart.covariance,
                rtol=1e-9,
                atol=1e-9 * apart.covariance.max(),
            )
            np.testing.assert_allclose(together.weights[index], apart.weights, rtol=0, atol=1e-9)


@every_consistent
@pytest.mark.parametrize("radius", [None, 1.0])
def test_running_out_of_iterations(method, radius):
    with pytest.warns(
        ConvergenceWarning, match=f"^{method}: not converged: still moving after 1 iterations"
    ):
        ours = fit(method, radius=radius, max_iterations=1)
    assert not ours.converged and ours.iterations == 1
    assert np.all(np.isfinite(ours.parameters)) and np.all(np.isfinite(ours.covariance))


@every_consistent
@pytest.mark.parametrize("kind", ["variances", "full"])
@pytest.mark.parametrize("n", [4, 5])
def test_exact_points_give_the_sphere(method, kind, n):
    points = (
        TRUTH[:3]
        + np.vstack(
            [np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3), [0, 0, 1]]
        )[:n]
    )
    ours = analysis.fit_sphere(points, method, cofactors=COFACTORS[kind][:n])
    np.testing.assert_allclose(ours.parameters, TRUTH, rtol=0, atol=1e-12)
    assert ours.converged
    if n == 4 and method != "robust":
        assert np.isnan(ours.sigma_0)  # no redundancy, no scale


# ------------------------------------------------------------------------------ what is refused


def with_block(block):
    Q = in_full("full").copy()
    Q[5] = block
    return Q


@every_consistent
@pytest.mark.parametrize(
    ("cofactors", "message"),
    [
        (
            in_full("full")[1:],
            r"cofactors: expected shape \(80, 3, 3\) or"
            r"|cofactors: expected shape \(80,\) or \(80,\), got \(79, 3, 3\)",
        ),
        (np.ones((N, 3)), r"cofactors: expected shape \(80,\) .*got \(80, 3\)"),
        (np.ones((N, 2, 2)), r"cofactors: expected shape .*got \(80, 2, 2\)"),
        (
            np.stack([in_full("full")] * 2),
            r"cofactors: expected shape \(80, 3, 3\) .*got \(2, 80, 3, 3\)",
        ),
        (with_block(np.triu(np.ones((3, 3)))), "cofactors: expected symmetric matrices"),
        (
            with_block(np.diag([1.0, 1.0, 0.0])),
            "cofactors: expected positive definite matrices, got a smallest eigenvalue of",
        ),
        (
            with_block(np.diag([1.0, 1.0, -2.0])),
            "cofactors: expected positive definite matrices, got a smallest eigenvalue of -2",
        ),
        (with_block(np.nan), "cofactors: expected finite numbers, got 9 NaN or infinite"),
    ],
    ids=["n", "n x 3", "n x 2 x 2", "stack", "asymmetric", "singular", "indefinite", "nan"],
)
def test_bad_cofactors_are_refused(method, cofactors, message):
    with pytest.raises(ValueError, match=message):
        analysis.fit_sphere(cloud(), method, cofactors=cofactors)


@every_consistent
def test_weights_beside_full_cofactors_are_refused(method):
    with pytest.raises(ValueError, match="weights: expected None beside full cofactors"):
        analysis.fit_sphere(cloud(), method, cofactors=in_full("full"), weights=np.ones(N))


@pytest.mark.parametrize("method", sorted(set(analysis.SPHERE_METHODS) - set(CONSISTENT)))
@pytest.mark.parametrize(
    ("given", "what"),
    [({"radius": 1.0}, "a held radius"), ({"cofactors": in_full("full")}, "full cofactors")],
)
def test_a_printed_method_names_those_that_can(method, given, what):
    with pytest.raises(
        ValueError,
        match=f"method: expected one of eiv, geometric, robust with {what}, got '{method}'",
    ):
        analysis.fit_sphere(cloud(), method, **given)


@every_consistent
@pytest.mark.parametrize("radius", [0.0, -0.05, np.nan, np.inf, "0.05 m"])
def test_a_radius_that_is_none_is_refused(method, radius):
    with pytest.raises(ValueError, match="radius: expected a positive finite number, got"):
        analysis.fit_sphere(cloud(), method, radius=radius)


@every_consistent
@pytest.mark.parametrize("value", [0, -1, 2.5, True])
def test_a_bad_number_of_iterations_is_refused(method, value):
    with pytest.raises(ValueError, match="max_iterations: expected a positive whole number"):
        fit(method, max_iterations=value)


@every_consistent
def test_inputs_stay_as_they_are(method):
    points, Q = cloud("full"), in_full("full").copy()
    kept = points.copy(), Q.copy()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        analysis.fit_sphere(points, method, cofactors=Q, radius=1.0)
    np.testing.assert_array_equal(points, kept[0])
    np.testing.assert_array_equal(Q, kept[1])
