"""The robust fit with other weight functions: efficiency, what they withstand, exact points."""

import numpy as np
import pytest

import analysis
from analysis.adjustment.weights import EFFICIENT_THRESHOLDS, IGG3, WEIGHT_FUNCTIONS, Huber

NAMES = list(WEIGHT_FUNCTIONS)
REJECTING = [name for name in NAMES if WEIGHT_FUNCTIONS[name].weight(9.0) == 0]
SD = 0.003


def sphere(generator, shape, sd=SD):
    """Points on the unit sphere about (5, 6, 7)."""
    directions = generator.standard_normal((*shape, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    return [5, 6, 7] + directions * (1 + sd * generator.standard_normal((*shape, 1)))


def plane(generator, shape, sd=SD):
    x, y = generator.uniform(-1, 1, (2, *shape))
    return np.stack([x, y, 0.3 * x - 0.2 * y + 2 + sd * generator.standard_normal(shape)], axis=-1)


def ellipse(generator, shape, sd=SD):
    turn = generator.uniform(0, 2 * np.pi, shape)
    points = np.stack([3 * np.cos(turn), 2 * np.sin(turn)], axis=-1)
    return points + sd * generator.standard_normal(points.shape)


def cylinder(generator, shape, sd=SD):
    section = ellipse(generator, shape, sd)
    return np.insert(section, 1, generator.uniform(-2, 2, shape), axis=-1)


SURFACES = {
    "sphere": (sphere, analysis.fit_sphere),
    "plane": (plane, analysis.fit_plane),
    "ellipse": (ellipse, analysis.fit_ellipse),
    "cylinder": (cylinder, analysis.fit_elliptic_cylinder),
}


def with_gross_errors(points, share, generator):
    """The first points of each cloud moved by 0.1 m to 1 m to one side."""
    points = points.copy()
    count = round(share * points.shape[-2])
    size = generator.uniform(0.1, 1.0, (*points.shape[:-2], count, 1))
    points[..., :count, :] += size * np.array([0.6, 0.8, 1.0])[: points.shape[-1]]
    return points, count


def test_without_one_it_is_igg3_with_its_thresholds():
    points, _ = with_gross_errors(
        sphere(np.random.default_rng(0), (80,)), 0.2, np.random.default_rng(8)
    )
    default = analysis.fit_sphere(points)
    same = [
        analysis.fit_sphere(points, k0=2.5, k1=4.0),
        analysis.fit_sphere(points, k1=4.0),
        analysis.fit_sphere(points, weight_function=IGG3(*EFFICIENT_THRESHOLDS)),
    ]
    for fit in same:
        np.testing.assert_array_equal(fit.parameters, default.parameters)
        np.testing.assert_array_equal(fit.cofactor, default.cofactor)
        np.testing.assert_array_equal(fit.weights, default.weights)


def test_a_name_stands_for_the_function_with_its_defaults():
    points = sphere(np.random.default_rng(1), (50,))
    for name, function in WEIGHT_FUNCTIONS.items():
        by_name, by_object = (
            analysis.fit_sphere(points, weight_function=w) for w in (name, function)
        )
        np.testing.assert_array_equal(by_name.parameters, by_object.parameters)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("surface", SURFACES)
def test_exact_points_give_the_surface(surface, name):
    make, fit = SURFACES[surface]
    points = make(np.random.default_rng(2), (60,), sd=0.0)
    expected, found = fit(points, "geometric"), fit(points, weight_function=name)
    assert found.converged
    np.testing.assert_allclose(found.parameters, expected.parameters, rtol=0, atol=1e-10)


@pytest.mark.parametrize("surface", SURFACES)
@pytest.mark.parametrize("name", REJECTING)
def test_what_rejects_withstands_many_gross_errors(surface, name):
    """The rejected points might as well not be there: their weight is exactly 0."""
    make, fit = SURFACES[surface]
    generator = np.random.default_rng(3)
    points, bad = with_gross_errors(make(generator, (120,)), 0.35, generator)
    found = fit(points, weight_function=name)
    far = np.flatnonzero(np.abs(found.distances[:bad]) > 0.05)
    assert found.converged and len(far) > 0.5 * bad
    assert (found.weights[far] == 0).all() and not found.inliers[far].any()
    good = fit(points[bad:], "geometric")
    off = np.abs(found.distances[bad:] - good.distances)
    assert off.max() < 2.5 * SD


def test_huber_rejects_nothing_and_breaks_down():
    generator = np.random.default_rng(4)
    points, bad = with_gross_errors(sphere(generator, (120,)), 0.35, generator)
    huber, bisquare = (
        analysis.fit_sphere(points, weight_function=w) for w in ("huber", "bisquare")
    )
    assert huber.inliers.all() and huber.sigma_0 > 10 * SD > bisquare.sigma_0
    few = analysis.fit_sphere(points[bad - 4 :], weight_function="huber")
    assert few.inliers.all() and np.abs(few.center - [5, 6, 7]).max() < 3 * SD


def test_danish_gives_far_points_next_to_no_weight():
    generator = np.random.default_rng(5)
    points, bad = with_gross_errors(sphere(generator, (120,)), 0.35, generator)
    fit = analysis.fit_sphere(points, weight_function="danish")
    assert np.median(fit.weights[:bad]) < 1e-12 and np.abs(fit.center - [5, 6, 7]).max() < SD


EFFICIENT = {"huber", "hampel", "bisquare", "danish"}


@pytest.fixture(scope="module")
def clean():
    """1000 clouds without gross errors, and the sum of the variances of their centres."""
    points = sphere(np.random.default_rng(6), (1000, 100))
    return points, analysis.fit_sphere(points, "geometric").center.var(axis=0).sum()


@pytest.mark.parametrize("name", sorted(EFFICIENT | {"igg1"}))
def test_efficiency_scale_and_covariance_at_the_normal_law(clean, name):
    points, least = clean
    fit = analysis.fit_sphere(points, weight_function=name)
    assert fit.converged.all()
    variance = fit.center.var(axis=0).sum()
    assert least / variance == pytest.approx(WEIGHT_FUNCTIONS[name].efficiency, abs=0.06)
    assert np.mean(fit.sigma_0) == pytest.approx(SD, rel=0.02 if name in EFFICIENT else 0.04)
    stated = np.trace(fit.covariance[:, :3, :3], axis1=-2, axis2=-1).mean()
    assert stated / variance == pytest.approx(1, abs=0.07 if name in EFFICIENT else 0.12)


def test_a_lower_threshold_costs_efficiency(clean):
    points, _ = clean
    variances = [
        analysis.fit_sphere(points[:300], weight_function=Huber(c)).center.var(axis=0).sum()
        for c in (0.3, 1.345, 10.0)
    ]
    assert variances == sorted(variances, reverse=True)


def test_contradictions_and_unknown_names_are_refused():
    points = sphere(np.random.default_rng(7), (20,))
    with pytest.raises(ValueError, match="weight_function: expected None beside k0 and k1"):
        analysis.fit_sphere(points, weight_function="huber", k0=2.0)
    with pytest.raises(ValueError, match="weight_function: expected one of igg3, .* got 'hubber'"):
        analysis.fit_sphere(points, weight_function="hubber")
    with pytest.raises(ValueError, match="0 < c < ∞"):
        analysis.fit_sphere(points, weight_function=Huber(-1.0))
