"""The similarity: closed form, errors in both frames, covariance, wrong pairs."""

import dataclasses
import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import analysis
from analysis.similarity import fit_similarity, umeyama

GEOCENTRIC = np.array([4.15e6, 6.7e5, 4.77e6])  # m
# m, in a tunnel
TARGETS = np.array(
    [[2.0, -9, 0.5], [-2, -5, 1.5], [1.8, 0, -1], [-2, 4, 2], [1.5, 8, 0], [0, 11, 2.4]]
)


def generator(seed=0):
    return np.random.default_rng(seed)


def rotation(degrees, axis=(1.0, -2.0, 0.5)):
    return Rotation.from_rotvec(
        np.radians(degrees) * np.array(axis) / np.linalg.norm(axis)
    ).as_matrix()


def moved(x, scale=1.0, R=None, t=(0.0, 0.0, 0.0)):
    return np.asarray(t) + scale * x @ (np.eye(3) if R is None else R).swapaxes(-1, -2)


def noisy(points, sd, seed=0):
    return points + sd * generator(seed).standard_normal(points.shape)


def covariances(n, seed):
    """(n, 3, 3): as different in direction and size as cofactors of scanned targets are, m²."""
    root = generator(seed).standard_normal((n, 3, 3)) * [1e-3, 2e-3, 4e-3]
    return root @ root.swapaxes(-1, -2) + 1e-7 * np.eye(3)


def parameters(similarity):
    """(…, 13): everything that says where points go."""
    R = similarity.rotation.reshape(*similarity.rotation.shape[:-2], 9)
    return np.concatenate(
        [similarity.translation, R, np.asarray(similarity.scale)[..., None]], axis=-1
    )


# ------------------------------------------------------------------ exact data, published answer


@pytest.mark.parametrize("degrees", [0.0, 0.001, 60.0, 90.0, 135.0, 179.999, 180.0])
@pytest.mark.parametrize("count", [3, 6])
def test_exact_pairs_give_the_truth(degrees, count):
    R, t = rotation(degrees), np.array([10.0, -20.0, 5.0])
    x, X = TARGETS[:count], moved(TARGETS[:count], 1.7, R, t)
    mu, R_u, t_u = umeyama(x, X)
    fit = fit_similarity(x, X)
    for scale, turn, shift in [(mu, R_u, t_u), (fit.scale, fit.rotation, fit.translation)]:
        np.testing.assert_allclose(scale, 1.7, rtol=1e-13)
        np.testing.assert_allclose(turn, R, rtol=0, atol=1e-13)
        np.testing.assert_allclose(shift, t, rtol=0, atol=1e-12)


def test_exact_pairs_far_from_the_origin():
    x = TARGETS + GEOCENTRIC
    X = GEOCENTRIC + moved(TARGETS, 1.0, rotation(150))
    fit = fit_similarity(x, X)
    np.testing.assert_allclose(fit.rotation, rotation(150), rtol=0, atol=1e-9)
    np.testing.assert_allclose(fit.transform(x), X, rtol=0, atol=3e-9)
    np.testing.assert_allclose(
        fit.translation + fit.scale * x @ fit.rotation.T, X, rtol=0, atol=1e-8
    )


def grafarend():
    content = tomllib.loads(
        (Path(__file__).parents[1] / "reference" / "similarity_grafarend.toml").read_text(
            encoding="utf-8"
        )
    )
    return (
        np.array(content["data"]["source"]),
        np.array(content["data"]["target"]),
        content["answer"],
    )


def assert_printed(ours, printed):
    texts = np.atleast_1d(printed)
    half_unit = [0.5 * 10.0 ** -len(text.partition(".")[2]) for text in texts]
    assert np.all(np.abs(np.atleast_1d(ours) - texts.astype(float)) <= half_unit), (
        f"expected {printed}, got {ours}"
    )


def test_seven_stations_of_grafarend_and_awange():
    x, X, printed = grafarend()
    solution = fit_similarity(x, X)
    assert_printed(solution.translation, printed["translation"])
    assert_printed(solution.scale, printed["scale"])
    turn = Rotation.from_matrix(solution.rotation).as_rotvec(degrees=True)
    assert_printed(np.abs(turn) * 3600, printed["rotations"])


def test_a_mirrored_plane_is_still_a_rotation():
    flat = TARGETS * [1, 1, 0]
    for fit in (
        fit_similarity(flat, flat * [-1, 1, 1]),
        fit_similarity(TARGETS, TARGETS * [-1, 1, 1]),
    ):
        np.testing.assert_allclose(np.linalg.det(fit.rotation), 1.0, rtol=1e-12)
    np.testing.assert_allclose(fit_similarity(flat, flat * [-1, 1, 1]).residuals, 0.0, atol=1e-12)


def test_scale_of_mirrored_points_belongs_to_their_best_rotation():
    X = noisy(TARGETS * [-1, 1, 1], 0.1)
    mu, R, _ = umeyama(TARGETS, X)
    dx, dX = TARGETS - TARGETS.mean(axis=0), X - X.mean(axis=0)
    np.testing.assert_allclose(mu, np.sum(dX * (dx @ R.T)) / np.sum(dx**2), rtol=1e-12)


# ------------------------------------------------------------------ errors in both frames


def test_default_is_least_squares_in_the_target_frame():
    X = noisy(moved(TARGETS, 1.2, rotation(100)), 0.05)
    weights = generator(3).uniform(0.2, 5, 6)
    for scale in (True, False):
        mu, R, t = umeyama(TARGETS, X, scale=scale, weights=weights)
        fit = fit_similarity(TARGETS, X, scale=scale, weights=weights)
        np.testing.assert_allclose(
            parameters(fit), np.concatenate([t, R.ravel(), [mu]]), rtol=0, atol=1e-12
        )
        np.testing.assert_allclose(fit.residuals, X - moved(TARGETS, mu, R, t), rtol=0, atol=1e-12)
        redundancy = 18 - 6 - scale
        assert fit.redundancy == redundancy
        np.testing.assert_allclose(
            fit.sigma_0,
            np.sqrt(np.sum(weights[:, None] * fit.residuals**2) / redundancy),
            rtol=1e-10,
        )


@pytest.mark.parametrize(
    ("of_source", "of_target"), [(4.0, 1.0), (1.0, 1.0), (0.25, 4.0), (1.0, 1e-6)]
)
def test_scale_with_isotropic_errors_in_both_frames_solves_its_quadratic(of_source, of_target):
    x, X = noisy(TARGETS, 0.05, 1), noisy(moved(TARGETS, 1.3, rotation(70)), 0.05, 2)
    fit = fit_similarity(x, X, source_cofactors=of_source, target_cofactors=of_target)
    np.testing.assert_allclose(fit.rotation, umeyama(x, X)[1], rtol=0, atol=1e-12)
    dx, dX = x - x.mean(axis=0), X - X.mean(axis=0)
    C, D, E = np.sum(dX * (dx @ fit.rotation.T)), np.sum(dx**2), np.sum(dX**2)
    roots = np.roots([C * of_source, D * of_target - E * of_source, -C * of_target])
    np.testing.assert_allclose(fit.scale, roots.max(), rtol=1e-12)
    assert abs(fit.scale - C / D) > 1e-6  # with all errors in the target it is another


def test_full_cofactors_agree_with_an_independent_minimisation():
    """All observations adjusted at once, by scipy: the points of the source frame are unknowns,
    too.
    """
    Q_x, Q_X = covariances(6, 1), covariances(6, 2)
    x = (
        TARGETS
        + np.einsum("nij,nj->ni", np.linalg.cholesky(Q_x), generator(3).standard_normal((6, 3))) * 5
    )
    X = (
        moved(TARGETS, 1.1, rotation(140))
        + np.einsum("nij,nj->ni", np.linalg.cholesky(Q_X), generator(4).standard_normal((6, 3))) * 5
    )
    fit = fit_similarity(x, X, source_cofactors=Q_x, target_cofactors=Q_X)
    whiten_x, whiten_X = (
        np.linalg.inv(np.linalg.cholesky(Q_x)),
        np.linalg.inv(np.linalg.cholesky(Q_X)),
    )

    def errors(unknowns):
        t, turn, mu, true = unknowns[:3], unknowns[3:6], unknowns[6], unknowns[7:].reshape(6, 3)
        image = moved(true, mu, Rotation.from_rotvec(turn).as_matrix() @ rotation(140), t)
        parts = [
            np.einsum("nij,nj->ni", W, e) for W, e in [(whiten_x, x - true), (whiten_X, X - image)]
        ]
        return np.concatenate(parts).ravel()

    start = np.concatenate([np.zeros(6), [1.0], x.ravel()])
    best = least_squares(errors, start, xtol=1e-15, ftol=1e-15, gtol=1e-15, x_scale="jac")
    turn = Rotation.from_rotvec(best.x[3:6]).as_matrix() @ rotation(140)
    np.testing.assert_allclose(fit.translation, best.x[:3], rtol=0, atol=1e-8)
    np.testing.assert_allclose(fit.rotation, turn, rtol=0, atol=1e-8)
    np.testing.assert_allclose(fit.scale, best.x[6], rtol=0, atol=1e-9)
    np.testing.assert_allclose(fit.sigma_0, np.sqrt(2 * best.cost / 11), rtol=1e-9)
    cofactor = np.linalg.inv(best.jac.T @ best.jac)[:7, :7]
    np.testing.assert_allclose(
        np.sqrt(np.diag(fit.cofactor)), np.sqrt(np.diag(cofactor)), rtol=2e-3
    )


def test_exact_source_is_the_limit_of_a_precise_one():
    X, Q = noisy(moved(TARGETS, 1.1, rotation(30)), 0.01), covariances(6, 1)
    exact = fit_similarity(TARGETS, X, target_cofactors=Q)
    precise = fit_similarity(TARGETS, X, source_cofactors=1e-16, target_cofactors=Q)
    np.testing.assert_allclose(parameters(precise), parameters(exact), rtol=0, atol=1e-10)
    # the weights matter
    assert np.abs(parameters(exact) - parameters(fit_similarity(TARGETS, X))).max() > 1e-4


def test_weights_variances_and_matrices_say_the_same():
    X, w = noisy(TARGETS, 0.01), generator(1).uniform(0.5, 2, 6)
    one = fit_similarity(TARGETS, X, weights=w)
    for cofactors in (1 / w, np.eye(3) / w[:, None, None]):
        other = fit_similarity(TARGETS, X, target_cofactors=cofactors)
        np.testing.assert_allclose(parameters(other), parameters(one), rtol=0, atol=1e-13)
        np.testing.assert_allclose(other.covariance, one.covariance, rtol=1e-9, atol=1e-18)


# ------------------------------------------------------------------ accuracy


@pytest.fixture(scope="module")
def campaign():
    """12 000 redraws of six targets with errors in both frames, adjusted with their true
    covariances.
    """
    B = 12_000
    Q_x, Q_X = covariances(6, 5), covariances(6, 6)
    draw = generator(7)
    x = TARGETS + np.einsum(
        "nij,bnj->bni", np.linalg.cholesky(Q_x), draw.standard_normal((B, 6, 3))
    )
    X = moved(TARGETS, 1.1, rotation(120), (50, 60, 7))
    X = X + np.einsum("nij,bnj->bni", np.linalg.cholesky(Q_X), draw.standard_normal((B, 6, 3)))
    fits = fit_similarity(x, X, source_cofactors=Q_x, target_cofactors=Q_X, absolute=True)
    return fits, rotation(120), Q_x


def deviations(fits, R, t, mu):
    """(B, 7) of (t, ω, μ) from the truth."""
    turns = Rotation.from_matrix(fits.rotation @ R.T).as_rotvec()
    return np.concatenate([fits.translation - t, turns, fits.scale[:, None] - mu], axis=-1)


def test_standard_deviations_are_those_of_a_monte_carlo(campaign):
    fits, R, _ = campaign
    errors = deviations(fits, R, (50, 60, 7), 1.1)
    stated = np.sqrt(np.mean(np.diagonal(fits.covariance, axis1=-2, axis2=-1), axis=0))
    np.testing.assert_allclose(np.sqrt(np.mean(errors**2, axis=0)), stated, rtol=0.03)
    normalised = np.einsum("bi,bij,bj->b", errors, np.linalg.inv(fits.covariance), errors)
    assert abs(normalised.mean() - 7) < 0.1  # the covariances between them, too
    assert np.abs(errors.mean(axis=0) / stated).max() < 0.03  # no bias
    assert abs(np.mean(fits.sigma_0**2) - 1) < 0.01


def test_covariance_of_transformed_points_is_that_of_a_monte_carlo_and_common(campaign):
    fits, R, Q_x = campaign
    points = np.array([[2.7, 3.0, 0.0], [-2.7, 3.0, 0.0], [0.0, 30.0, 2.7]])
    noise = np.einsum(
        "nij,bnj->bni",
        np.linalg.cholesky(Q_x[:3]),
        generator(8).standard_normal((len(fits.scale), 3, 3)),
    )
    errors = fits.transform(points + noise) - moved(points, 1.1, R, (50, 60, 7))
    stated = fits.transformed_covariance(np.broadcast_to(points, noise.shape), Q_x[:3]).mean(axis=0)
    found = np.einsum("bni,bnj->nij", errors, errors) / len(errors)
    np.testing.assert_allclose(
        found, stated, rtol=0, atol=0.03 * np.max(np.diagonal(stated, axis1=1, axis2=2))
    )
    np.testing.assert_allclose(
        np.sqrt(np.trace(found, axis1=1, axis2=2)),
        np.sqrt(np.trace(stated, axis1=1, axis2=2)),
        rtol=0.02,
    )
    # Between two points without errors of their own: the error they share.
    shifts = fits.transform(points) - moved(points, 1.1, R, (50, 60, 7))
    A = fits.common_errors(np.broadcast_to(points, noise.shape))
    between = np.einsum("bik,bjk->ij", A[:, 0], A[:, 1]) / len(A)
    found = np.einsum("bi,bj->ij", shifts[:, 0], shifts[:, 1]) / len(A)
    np.testing.assert_allclose(found, between, rtol=0, atol=0.03 * np.abs(between).max())
    np.testing.assert_allclose(
        A @ A.swapaxes(-1, -2),
        fits.transformed_covariance(np.broadcast_to(points, noise.shape)),
        atol=1e-18,
    )


def test_errors_of_an_unknown_covariance_are_refused():
    fit = fit_similarity(TARGETS, TARGETS)
    fit = dataclasses.replace(fit, sigma_0=np.nan)
    for errors in (fit.common_errors, fit.transformed_covariance):
        with pytest.raises(ValueError, match="expected a finite covariance.* got NaN in 1 of 1"):
            errors(TARGETS)


def test_covariance_is_as_good_far_from_the_origin():
    X = noisy(TARGETS, 0.002)
    near, far = fit_similarity(TARGETS, X), fit_similarity(TARGETS + GEOCENTRIC, X + GEOCENTRIC)
    points = TARGETS + [1.0, 2, 3]
    expected = near.transformed_covariance(points, 1e-6 * np.ones(6))
    np.testing.assert_allclose(
        far.transformed_covariance(points + GEOCENTRIC, 1e-6 * np.ones(6)),
        expected,
        rtol=1e-4,
        atol=1e-12,
    )
    # t is the image of the origin, 6000 km away: its standard deviation says so.
    assert far.standard_deviations[:3].max() > 1e5 * near.standard_deviations[:3].max()


def test_covariance_without_cofactors_is_scaled_by_the_misclosures():
    X = noisy(TARGETS, 0.002)
    relative = fit_similarity(TARGETS, X, target_cofactors=4e-6)
    np.testing.assert_allclose(
        relative.covariance, fit_similarity(TARGETS, X).covariance, rtol=1e-9, atol=1e-20
    )
    absolute = fit_similarity(TARGETS, X, target_cofactors=4e-6, absolute=True)
    np.testing.assert_array_equal(absolute.covariance, absolute.cofactor)
    np.testing.assert_allclose(
        relative.covariance, relative.sigma_0**2 * absolute.covariance, rtol=1e-12
    )


def test_held_scale_has_no_error_and_no_test():
    X = noisy(1.0005 * TARGETS, 0.001)
    fixed, free = fit_similarity(TARGETS, X, scale=False), fit_similarity(TARGETS, X)
    assert fixed.scale == 1 and np.isnan(fixed.scale_test)
    np.testing.assert_array_equal(fixed.covariance[6], 0.0)
    assert free.scale_test > 2 and free.redundancy == fixed.redundancy - 1
    np.testing.assert_allclose(
        free.scale_test, (free.scale - 1) / free.standard_deviations[6], rtol=1e-10
    )


def test_scale_test_errs_as_often_as_it_should():
    X = noisy(np.broadcast_to(TARGETS, (4000, 6, 3)), 0.002)
    fits = fit_similarity(
        np.broadcast_to(TARGETS, X.shape), X, target_cofactors=4e-6, absolute=True
    )
    assert 0.035 < np.mean(fits.scale_test > 2) < 0.056  # 4.6 % of a normal variable


def test_inverse_goes_back_and_is_the_fit_of_the_frames_exchanged():
    x, X = (
        noisy(TARGETS, 0.01, 1) + [5, 6, 7],
        noisy(moved(TARGETS, 1.4, rotation(110), (90, 80, 70)), 0.01, 2),
    )
    Q_x, Q_X = covariances(6, 1), covariances(6, 2)
    fit = fit_similarity(x, X, source_cofactors=Q_x, target_cofactors=Q_X)
    back = fit_similarity(X, x, source_cofactors=Q_X, target_cofactors=Q_x)
    inverse = fit.inverse()
    np.testing.assert_allclose(parameters(inverse), parameters(back), rtol=0, atol=1e-10)
    np.testing.assert_allclose(
        inverse.covariance,
        back.covariance,
        rtol=1e-3,
        atol=1e-3 * np.abs(np.diag(back.covariance)).min(),
    )
    np.testing.assert_allclose(inverse.residuals, x - inverse.transform(X), rtol=0, atol=1e-12)
    np.testing.assert_allclose(inverse.transform(fit.transform(x)), x, rtol=0, atol=1e-12)
    np.testing.assert_allclose(inverse.inverse().covariance, fit.covariance, rtol=1e-9)


# ------------------------------------------------------------------ what changes what


def test_order_shift_turn_and_unit_change_what_they_should():
    x, X = TARGETS, noisy(moved(TARGETS, 1.2, rotation(80)), 0.01)
    w = generator(5).uniform(0.5, 2, 6)
    one = fit_similarity(x, X, weights=w)
    order = generator(6).permutation(6)
    other = fit_similarity(x[order], X[order], weights=w[order])
    np.testing.assert_allclose(parameters(other), parameters(one), rtol=0, atol=1e-13)
    np.testing.assert_allclose(other.residuals, one.residuals[order], rtol=0, atol=1e-13)
    turn = rotation(33, (0, 0, 1))
    other = fit_similarity(x, 1000 * moved(X, 1.0, turn, (1, 2, 3)), weights=w)
    np.testing.assert_allclose(other.scale, 1000 * one.scale, rtol=1e-12)
    np.testing.assert_allclose(other.rotation, turn @ one.rotation, rtol=0, atol=1e-12)
    np.testing.assert_allclose(other.residuals, 1000 * one.residuals @ turn.T, rtol=0, atol=1e-9)
    np.testing.assert_allclose(
        other.covariance[3:6, 3:6], turn @ one.covariance[3:6, 3:6] @ turn.T, rtol=0, atol=1e-16
    )


@pytest.mark.parametrize("robust", [False, True])
def test_a_stack_is_its_members_one_by_one(robust):
    x = noisy(np.broadcast_to(TARGETS, (2, 3, 6, 3)), 0.002, 1)
    X = noisy(np.broadcast_to(TARGETS, (2, 3, 6, 3)), 0.002, 2)
    X[0, 1, 4] += 0.5
    stack = fit_similarity(x, X, robust=robust, source_cofactors=1.0, target_cofactors=1.0)
    assert (
        stack.scale.shape == (2, 3)
        and stack.covariance.shape == (2, 3, 7, 7)
        and stack.translation.shape == (2, 3, 3)
    )
    for index in np.ndindex(2, 3):
        single = fit_similarity(
            x[index], X[index], robust=robust, source_cofactors=1.0, target_cofactors=1.0
        )
        np.testing.assert_allclose(parameters(stack)[index], parameters(single), rtol=0, atol=1e-14)
        np.testing.assert_allclose(
            stack.covariance[index], single.covariance, rtol=1e-12, atol=1e-20
        )
        np.testing.assert_array_equal(stack.inliers[index], single.inliers)
        np.testing.assert_allclose(
            stack.transform(x)[index], single.transform(x[index]), rtol=0, atol=1e-13
        )


def test_one_point_transforms_as_one_of_many():
    fit = fit_similarity(TARGETS, moved(TARGETS, 2.0, rotation(50), (1, 2, 3)))
    np.testing.assert_allclose(fit.transform(TARGETS[0]), fit.transform(TARGETS)[0], rtol=1e-14)
    expected = Rotation.from_matrix(rotation(50)).as_rotvec()
    np.testing.assert_allclose(fit.rotation_vector, expected, rtol=0, atol=1e-12)


def test_inputs_stay_and_results_are_frozen():
    x, X = TARGETS.copy(), noisy(TARGETS, 0.01)
    before = X.copy()
    fit = fit_similarity(x, X, robust=True)
    np.testing.assert_array_equal(x, TARGETS)
    np.testing.assert_array_equal(X, before)
    with pytest.raises(ValueError, match="read-only"):
        fit.residuals[0, 0] = 1.0
    assert x.flags.writeable and X.flags.writeable


# ------------------------------------------------------------------ wrong pairs


@pytest.mark.parametrize("wrong", range(6))
@pytest.mark.parametrize("scale", [False, True])
def test_one_wrong_pair_of_six_is_found_and_named(wrong, scale):
    X = noisy(moved(TARGETS, 1.0, rotation(160), (500, 600, 7)), 0.002, wrong)
    X[wrong] = X[(wrong + 1) % 6]  # paired with its neighbour
    fit = fit_similarity(TARGETS, X, scale=scale, robust=True)
    others = np.arange(6) != wrong
    np.testing.assert_array_equal(fit.inliers, others)
    assert fit.weights[wrong] == 0 and fit.redundancy == 15 - 6 - scale
    if np.all(fit.weights[others] == 1):
        np.testing.assert_allclose(
            parameters(fit),
            parameters(fit_similarity(TARGETS[others], X[others], scale=scale)),
            rtol=0,
            atol=1e-10,
        )
    plain = fit_similarity(TARGETS, X, scale=scale)
    assert np.linalg.norm(plain.translation - (500, 600, 7)) > 20 * np.linalg.norm(
        fit.translation - (500, 600, 7)
    )


def test_two_pairs_exchanged_are_found_in_exact_data():
    X = moved(TARGETS, 1.0, rotation(160), (500, 600, 7))
    X[[1, 4]] = X[[4, 1]]
    fit = fit_similarity(TARGETS, X, scale=False, robust=True)
    np.testing.assert_array_equal(fit.inliers, [True, False, True, True, False, True])
    np.testing.assert_allclose(fit.rotation, rotation(160), rtol=0, atol=1e-12)


def test_exact_pairs_all_keep_their_full_weight():
    x = TARGETS + GEOCENTRIC
    fit = fit_similarity(x, GEOCENTRIC + moved(TARGETS, 1.0, rotation(160)), robust=True)
    np.testing.assert_array_equal(fit.weights, 1.0)


def test_rounding_of_one_pair_is_no_reason_to_reject_it():
    x = np.round(TARGETS)
    x[2] += 0.1  # the only place that its coordinates in the target frame cannot hold exactly
    X = x + np.round(GEOCENTRIC)
    fit = fit_similarity(x, X, scale=False, robust=True)
    assert np.abs(X - np.round(GEOCENTRIC) - x)[2].max() > 1e-11
    np.testing.assert_array_equal(fit.weights, 1.0)


def robust_campaign(error, trials=1500, **options):
    x = np.broadcast_to(TARGETS, (trials, 6, 3))
    X = noisy(x, 0.002, 9)
    X[:, 2, 1] += error
    return fit_similarity(x, X, scale=False, robust=True, target_cofactors=4e-6, **options)


def test_good_pairs_are_hardly_ever_rejected():
    for absolute in (False, True):
        fits = robust_campaign(0.0, absolute=absolute)
        assert np.mean(~fits.inliers.all(axis=-1)) < 0.005
        assert np.mean(fits.converged) > 0.998


@pytest.mark.parametrize(("error", "absolute", "least"), [(0.05, False, 0.98), (0.02, True, 0.98)])
def test_a_wrong_pair_is_found_and_no_other(error, absolute, least):
    fits = robust_campaign(error, absolute=absolute)
    expected = [True, True, False, True, True, True]
    assert np.mean(np.all(fits.inliers == expected, axis=-1)) > least


def test_robust_standard_deviations_are_those_of_a_monte_carlo():
    for error in (0.0, 5.0):
        fits = robust_campaign(error, trials=6000)
        errors = deviations(fits, np.eye(3), 0.0, 1.0)[:, :6]
        stated = np.sqrt(np.mean(np.diagonal(fits.covariance, axis1=-2, axis2=-1), axis=0))[:6]
        np.testing.assert_allclose(np.sqrt(np.mean(errors**2, axis=0)), stated, rtol=0.04)


def test_many_pairs_with_two_in_five_wrong():
    draw = generator(11)
    x = draw.uniform(-10, 10, (200, 3))
    X = noisy(moved(x, 1.0, rotation(100)), 0.002)
    X[:80] = draw.permutation(X[:80])
    fit = fit_similarity(x, X, robust=True)
    wrong = np.linalg.norm(X - moved(x, 1.0, rotation(100)), axis=-1) > 0.1
    assert wrong.sum() > 70 and not fit.inliers[wrong].any() and fit.inliers[~wrong].mean() > 0.99
    np.testing.assert_allclose(fit.rotation, rotation(100), rtol=0, atol=1e-3)
    np.testing.assert_allclose(fit.sigma_0, 0.002, rtol=0.1)


# ------------------------------------------------------------------ bad input


LINE = np.outer(np.arange(5.0), [1.0, 2.0, 3.0])
BAD = {
    "two targets": (TARGETS[:2], TARGETS[:2], {}, "at least 3 pairs for a similarity, got 2"),
    "three for a robust one": (
        TARGETS[:3],
        TARGETS[:3],
        {"robust": True},
        "at least 4 pairs for a robust one, got 3",
    ),
    "line": (LINE, TARGETS[:5], {}, "source: .*points on a line"),
    "line far away": (LINE + GEOCENTRIC, TARGETS[:5], {}, "source: .*points on a line"),
    "line in the target": (TARGETS[:5], LINE, {}, "target: .*points on a line"),
    "one place": (np.ones((4, 3)), TARGETS[:4], {}, "source: .*points on a line"),
    "unequal numbers": (TARGETS, TARGETS[:5], {}, "as many points in both, got 6 and 5"),
    "unequal stacks": (
        np.stack([TARGETS] * 2),
        np.stack([TARGETS] * 3),
        {},
        "stacks of the same shape",
    ),
    "empty stack": (np.zeros((0, 6, 3)), np.zeros((0, 6, 3)), {}, "at least one set of pairs"),
    "two columns": (
        TARGETS[:, :2],
        TARGETS[:, :2],
        {},
        r"source: expected shape \(…, n, 3\), got \(6, 2\)",
    ),
    "NaN": (
        np.where(TARGETS == 8, np.nan, TARGETS),
        TARGETS,
        {},
        "source: expected finite numbers",
    ),
    "zero weight": (
        TARGETS,
        TARGETS,
        {"weights": [1, 1, 1, 1, 1, 0]},
        "weights: expected positive",
    ),
    "weights of another length": (
        TARGETS,
        TARGETS,
        {"weights": np.ones(5)},
        "weights: expected shape",
    ),
    "weights and cofactors": (
        TARGETS,
        TARGETS,
        {"weights": np.ones(6), "source_cofactors": 1.0},
        "weights: expected None beside",
    ),
    "negative variance": (
        TARGETS,
        TARGETS,
        {"source_cofactors": -1.0},
        "source_cofactors: expected a positive",
    ),
    "indefinite": (
        TARGETS,
        TARGETS,
        {"target_cofactors": -np.stack([np.eye(3)] * 6)},
        "target_cofactors: .*positive definite",
    ),
    "absolute without cofactors": (
        TARGETS,
        TARGETS,
        {"absolute": True},
        "absolute: expected cofactors",
    ),
    "iterations": (
        TARGETS,
        TARGETS,
        {"max_iterations": 0},
        "max_iterations: expected a positive whole number",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_refused_with_what_was_expected(name):
    source, target, options, message = BAD[name]
    with pytest.raises(ValueError, match=message):
        fit_similarity(source, target, **options)


def test_points_to_transform_are_checked():
    fit = fit_similarity(TARGETS, TARGETS)
    with pytest.raises(ValueError, match=r"points: expected shape \(…, 3\)"):
        fit.transform([1.0, 2.0])
    with pytest.raises(ValueError, match=r"points: expected shape \(n, 3\)"):
        fit.transformed_covariance([1.0, 2.0, 3.0])
    with pytest.raises(ValueError, match="cofactors: expected"):
        fit.transformed_covariance(TARGETS, np.ones(4))


def test_stopping_too_early_is_said():
    X = noisy(moved(TARGETS, 1.3, rotation(70)), 0.5, 2)
    with pytest.warns(analysis.ConvergenceWarning, match="still moving after 1 iterations"):
        fit = fit_similarity(
            TARGETS, X, source_cofactors=1.0, target_cofactors=1.0, max_iterations=1
        )
    assert not fit.converged and fit.iterations == 1 and "not converged" in repr(fit)
