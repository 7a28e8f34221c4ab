"""What the checks of a fit see, and that they are silent on right data."""

from dataclasses import replace

import numpy as np
import pytest

import analysis
from analysis.trust.examined import along_a_curve

SIGMA = 1e-3


def half_sphere(rng, n, radius=0.1, centre=(0.0, 0.0, 0.0)):
    """Outward directions, and points of the half of a sphere that a scanner sees."""
    u = rng.standard_normal((n, 3))
    u /= np.linalg.norm(u, axis=1)[:, None]
    u[:, 0] = -np.abs(u[:, 0])
    return u, np.array(centre) + radius * u


def noise(rng, n, dim=3):
    return SIGMA * rng.standard_normal((n, dim))


def said(fit):
    return {check.name for check in fit.checks() if not check.passed}


# ------------------------------------------------------------------------------ planted faults


def sphere_on_a_wall(rng, n):
    return np.column_stack([rng.uniform(-0.3, 0.3, (n, 2)), np.zeros(n)]) + noise(rng, n)


def plane_on_a_sphere(rng, n):
    x = rng.uniform(-1.0, 1.0, (n, 2))
    return np.column_stack([x, 5 * SIGMA * np.sum(x**2, axis=1)]) + noise(rng, n)


def ellipse_on_a_dome_with_walls(rng, n):
    turn = rng.uniform(0.0, np.pi, n // 2)
    dome = np.column_stack([2.5 * np.cos(turn), 1.5 * np.sin(turn)])
    side = np.where(rng.uniform(size=n - n // 2) < 0.5, -2.5, 2.5)
    walls = np.column_stack([side, -2.0 * rng.uniform(size=len(side))])
    return np.vstack([dome, walls]) + 2 * noise(rng, n, 2)


def two_equal_spheres(rng, n):
    one, two = half_sphere(rng, n // 2)[1], half_sphere(rng, n - n // 2, 0.1, (0.05, 0.25, 0.05))[1]
    return np.vstack([one, two]) + noise(rng, n)


def cluster(rng, n):
    points = half_sphere(rng, n)[1] + noise(rng, n)
    points[: n * 11 // 20] = [0.15, 0.1, 0.05] + 5 * noise(rng, n * 11 // 20)
    return points


def twice_in_the_file(rng, n):
    points = half_sphere(rng, n)[1][: n // 2] + noise(rng, n // 2)
    return np.vstack([points, points])


def missing_returns(rng, n):
    points = half_sphere(rng, n, 0.1, (5.0, 2.0, 1.0))[1] + noise(rng, n)
    points[: n // 10] = 0.0
    return points


def float32_far_away(rng, n):
    return (half_sphere(rng, n)[1] + noise(rng, n) + 1e5).astype(np.float32)


def comet_tail(rng, n):
    u, points = half_sphere(rng, n)
    points[: n * 2 // 5] += u[: n * 2 // 5] * rng.exponential(0.01, (n * 2 // 5, 1))
    return points + noise(rng, n)


def correlated_field(rng, n):
    u, points = half_sphere(rng, n)
    waves, phases = rng.standard_normal((60, 3)) / 0.1, rng.uniform(0.0, 2 * np.pi, 60)
    field = np.sqrt(2 / 60) * np.sum(np.cos(u @ waves.T + phases), axis=1)
    return points + SIGMA * u * field[:, None] + noise(rng, n)


def tiny_cap(rng, n):
    z, turn = rng.uniform(np.cos(np.radians(12.0)), 1.0, n), rng.uniform(0.0, 2 * np.pi, n)
    q = np.sqrt(1.0 - z * z)
    return 0.1 * np.column_stack([q * np.cos(turn), q * np.sin(turn), z]) + 0.1 * noise(rng, n)


def parallel_planes(rng, n):
    return np.column_stack([rng.uniform(-1, 1, (n, 2)), 0.02 * (np.arange(n) % 2)]) + noise(rng, n)


def even_clutter(rng, n):
    return rng.uniform(-0.3, 0.3, (n, 3))


@pytest.mark.parametrize(
    ("made", "fit", "n", "names"),
    [
        (sphere_on_a_wall, analysis.fit_sphere, 300, {"determined", "seen"}),
        (plane_on_a_sphere, analysis.fit_plane, 300, {"neighbours"}),
        (ellipse_on_a_dome_with_walls, analysis.fit_ellipse, 300, {"other", "rival"}),
        (two_equal_spheres, analysis.fit_sphere, 500, {"other", "share"}),
        (cluster, analysis.fit_sphere, 300, {"chance", "other", "share"}),
        (twice_in_the_file, analysis.fit_sphere, 200, {"duplicates"}),
        (missing_returns, analysis.fit_sphere, 200, {"duplicates"}),
        (float32_far_away, analysis.fit_sphere, 200, {"grid"}),
        (comet_tail, analysis.fit_sphere, 500, {"asymmetry", "tails"}),
        (correlated_field, analysis.fit_sphere, 2000, {"neighbours"}),
        (tiny_cap, analysis.fit_sphere, 300, {"seen"}),
        (parallel_planes, analysis.fit_plane, 300, {"flatness", "other"}),
        (even_clutter, analysis.fit_sphere, 200, {"chance", "determined"}),
    ],
)
@pytest.mark.filterwarnings("ignore::analysis.ConvergenceWarning")
def test_planted_fault_is_seen(made, fit, n, names):
    for seed in range(3):
        found = said(fit(made(np.random.default_rng([seed, n]), n)))
        assert found & names, f"{found} with seed {seed}"


def test_errors_along_the_beam_are_seen_from_a_known_station():
    rng = np.random.default_rng(4)
    _, points = half_sphere(rng, 400)
    station = np.array([-10.0, 0.0, 0.0])
    beam = (points - station) / np.linalg.norm(points - station, axis=1)[:, None]
    along = points + SIGMA * beam * rng.standard_normal((400, 1))
    for cloud, speaks in ((along, True), (points + noise(rng, 400), False)):
        fit = analysis.fit_sphere(cloud)
        fit = replace(fit, given=replace(fit.given, station=station))
        assert ("incidence" in said(fit)) == speaks
    far = analysis.fit_sphere(points + noise(rng, 400))
    assert "incidence" not in {check.name for check in far.checks()}, "no station, no check"


def test_the_other_surface_is_named():
    rng = np.random.default_rng(5)
    one = half_sphere(rng, 300, 0.1, (5.0, 2.0, 1.0))[1]
    two = half_sphere(rng, 200, 0.1, (5.05, 2.25, 1.05))[1]
    fit = analysis.fit_sphere(np.vstack([one, two]) + noise(rng, 500))
    (other,) = [check for check in fit.checks() if check.name == "other"]
    numbers = other.sentence.replace(",", " ").split()
    at = numbers.index("centre") + 1
    np.testing.assert_allclose(
        [float(v) for v in numbers[at : at + 3]], [5.05, 2.25, 1.05], atol=2e-3
    )
    assert not other.passed and other.value == pytest.approx(200 / 300, rel=0.1)


# ------------------------------------------------------------------------------ right data


def right(rng, kind, clouds, n):
    if kind == "plane":
        flat = np.concatenate([rng.uniform(-1, 1, (clouds, n, 2)), np.zeros((clouds, n, 1))], -1)
        return analysis.fit_plane(flat + SIGMA * rng.standard_normal(flat.shape))
    if kind == "ellipse":
        t = 2 * np.pi * (np.arange(n) + rng.uniform(size=(clouds, 1))) / n
        points = np.stack([2.5 * np.cos(t), 2.0 * np.sin(t)], axis=-1)
        return analysis.fit_ellipse(points + 5 * SIGMA * rng.standard_normal(points.shape))
    points = half_sphere(rng, clouds * n)[1].reshape(clouds, n, 3)
    return analysis.fit_sphere(points + SIGMA * rng.standard_normal(points.shape))


@pytest.mark.parametrize("kind", ["sphere", "plane", "ellipse"])
def test_silent_on_right_data(kind):
    """At most 2 % of the fits; with 300 draws 11 are beyond that in one of 30 such tests."""
    spoken = 0
    for n, clouds in ((30, 150), (100, 120), (1000, 30)):
        fit = right(np.random.default_rng([6, n]), kind, clouds, n)
        spoken += sum(any(not check.passed for check in checks) for checks in fit.checks())
    assert spoken <= 11


def test_large_cloud():
    rng = np.random.default_rng(7)
    assert not said(analysis.fit_sphere(half_sphere(rng, 20_000)[1] + noise(rng, 20_000)))


def test_exact_points():
    t = np.arange(12.0)
    ellipse = np.column_stack([3 * np.cos(t), 2 * np.sin(t)])
    assert not said(analysis.fit_ellipse(1e3 + ellipse))
    square = np.stack(np.meshgrid(np.arange(5.0), np.arange(5.0)), axis=-1).reshape(-1, 2)
    assert not said(analysis.fit_plane(np.column_stack([square, square @ [2.0, 3.0]])))


def test_few_points():
    rng = np.random.default_rng(8)
    fit = analysis.fit_sphere(half_sphere(rng, 5)[1] + noise(rng, 5), "geometric")
    assert said(fit) == {"redundancy"}


@pytest.mark.parametrize("radius", [None, 0.1])
@pytest.mark.parametrize("method", ["geometric", "robust", "eiv"])
def test_fixed_radius_and_cofactors(method, radius):
    rng = np.random.default_rng(9)
    _, points = half_sphere(rng, 200)
    sd = rng.uniform(0.5, 3.0, 200)
    points = points + SIGMA * sd[:, None] * rng.standard_normal((200, 3))
    for cofactors in (sd**2, sd[:, None, None] ** 2 * np.eye(3)):
        assert not said(analysis.fit_sphere(points, method, radius=radius, cofactors=cofactors))


@pytest.mark.parametrize(
    ("fit", "methods"),
    [
        (analysis.fit_sphere, analysis.SPHERE_METHODS),
        (analysis.fit_plane, analysis.PLANE_METHODS),
        (analysis.fit_ellipse, analysis.ELLIPSE_METHODS),
        (analysis.fit_elliptic_cylinder, analysis.CYLINDER_METHODS),
    ],
)
def test_every_method(fit, methods):
    rng = np.random.default_rng(10)
    n = 150
    turn = 2 * np.pi * rng.uniform(size=n)
    points = {
        analysis.fit_sphere: 10.0 + half_sphere(rng, n)[1],
        analysis.fit_plane: np.column_stack([rng.uniform(-1, 1, (n, 2)), np.full(n, 5.0)]),
        analysis.fit_ellipse: np.column_stack([2.5 * np.cos(turn), 2.0 * np.sin(turn)]),
        analysis.fit_elliptic_cylinder: np.column_stack(
            [2.5 * np.cos(turn), rng.uniform(-2, 2, n), 2.0 * np.sin(turn)]
        ),
    }[fit]
    points = points + noise(rng, n, points.shape[1])
    for method in methods:
        found = said(fit(points, method))
        assert found <= ({"share"} if method in ("igg3_wtls", "robust_direct") else set()), method


# ------------------------------------------------------------------------------ form


def same(checks, others):
    assert [c.name for c in checks] == [c.name for c in others]
    assert [c.passed for c in checks] == [c.passed for c in others]
    np.testing.assert_allclose([c.value for c in checks], [c.value for c in others], rtol=1e-6)


def test_stack_is_a_loop():
    rng = np.random.default_rng(11)
    clouds = np.stack([[two_equal_spheres(rng, 60), comet_tail(rng, 60)] for _ in range(2)])
    stack = analysis.fit_sphere(clouds, "geometric").checks()
    for i in range(2):
        for j in range(2):
            same(stack[i][j], analysis.fit_sphere(clouds[i, j], "geometric").checks())


def test_order_does_not_matter():
    rng = np.random.default_rng(12)
    for n in (100, 3000):
        points = two_equal_spheres(rng, n)
        same(
            analysis.fit_sphere(points, "geometric").checks(),
            analysis.fit_sphere(points[rng.permutation(n)], "geometric").checks(),
        )


def test_place_and_unit_do_not_matter():
    rng = np.random.default_rng(13)
    points = comet_tail(rng, 200)
    checks = analysis.fit_sphere(points, "geometric").checks()
    same(checks, analysis.fit_sphere(1024.0 * points, "geometric").checks())


def test_form():
    rng = np.random.default_rng(14)
    fit = analysis.fit_sphere(comet_tail(rng, 300))
    checks = fit.checks()
    assert isinstance(checks, tuple)
    assert len({check.name for check in checks}) == len(checks)
    for check in checks:
        assert check.sentence.endswith(".") and check.sentence.count(". ") == 0
        assert check.passed or ";" in check.sentence, "what to do"
    assert "given" not in repr(fit) and np.shares_memory(fit.given.points, fit.given.points[1:])


def test_the_points_are_not_copied():
    points = half_sphere(np.random.default_rng(15), 50)[1]
    assert analysis.fit_sphere(points, "geometric").given.points is points


def test_a_fit_without_its_points():
    fit = analysis.fit_sphere(half_sphere(np.random.default_rng(16), 50)[1], "geometric")
    with pytest.raises(ValueError, match="a fit that knows its points"):
        replace(fit, given=None).checks()


def test_neighbours_along_the_curve_lie_near_each_other():
    D = np.random.default_rng(17).uniform(size=(4096, 2))
    step = np.linalg.norm(np.diff(D[along_a_curve(D)], axis=0), axis=1)
    assert np.median(step) < 2 / 64
