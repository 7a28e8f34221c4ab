"""Sections cut from tunnel points, and radii read off in directions: against exact tunnels and
slow, obvious computations.
"""

import numpy as np
import pytest

from analysis.tunnel import sections as module
from analysis.tunnel.axis import Axis, straight
from analysis.tunnel.radii import DIRECTIONS, STEP, equal_angles, local_radii
from analysis.tunnel.sections import Section, cut

RADIUS = 2.7


def curved(heading=0.6):
    """A quadratic axis, 60 m, radius of curvature 300 m, grade 2 %, in a turned frame."""
    c, s = np.cos(heading), np.sin(heading)
    coefficients = np.zeros((4, 2, 1))
    coefficients[:3, :, 0] = [[0.0, 1.0], [-0.1, 0.02], [1 / 600, 1e-5]]
    return Axis(
        [1000.0, 2000.0, 50.0], [[c, -s, 0], [s, c, 0], [0, 0, 1]], [0.0, 60.0], coefficients
    )


def tube(axis, n, rng, radius=lambda a: RADIUS, sigma=0.0):
    """n points of a lining at radius(α) about the axis."""
    y, a = rng.uniform(*axis.y_range, n), rng.uniform(-np.pi, np.pi, n)
    right, up, _ = axis.frame(y)
    r = (radius(a) + sigma * rng.standard_normal(n))[:, None]
    return axis.position(y) + r * (np.sin(a)[:, None] * right + np.cos(a)[:, None] * up)


def section_of(alpha, rho, w=None, thickness=0.05):
    """A section with given polar coordinates, without a cloud behind it."""
    alpha, rho = np.asarray(alpha, dtype=float), np.asarray(rho, dtype=float)
    w = np.zeros_like(alpha) if w is None else w
    frame = np.eye(3)
    u, v = rho * np.sin(alpha), rho * np.cos(alpha)
    return Section(
        0.0, np.zeros(3), frame[0], frame[2], frame[1], thickness, np.arange(len(alpha)), u, v, w
    )


def ring(n, rng, radius=lambda a: RADIUS + 0.0 * a, sigma=0.0, hole=None):
    a = rng.uniform(-np.pi, np.pi, n)
    if hole is not None:
        a = a[(a < hole[0]) | (a > hole[1])]
    return section_of(
        a, radius(a) + sigma * rng.standard_normal(len(a)), rng.uniform(-0.025, 0.025, len(a))
    )


def oval(a):
    # seen from a pole 0.2 m off its centre
    return RADIUS + 0.011 * np.cos(2 * a) + 0.2 * np.cos(a - 0.4)


# --------------------------------------------------------------------------------- cutting


@pytest.mark.parametrize(
    "axis",
    [straight([0, 0, 0], [0, 60, 0]), straight([5, 5, 5], [-30, 50, 9]), curved()],
    ids=["paper", "any", "curved"],
)
def test_sections_hold_the_points_between_the_planes_and_no_others(axis):
    points = tube(axis, 40_000, np.random.default_rng(1))
    for section in cut(points, axis, [3.0, 40.0, 3.02], thickness=0.3):
        w = (points - section.position) @ section.along
        # the plane of a curve meets it again elsewhere
        y = axis.at_chainage(section.chainage)
        near = np.abs(axis.foot(points) - y) < 5.0
        assert set(section.index) == set(np.flatnonzero((np.abs(w) <= 0.15) & near))
        assert np.allclose(section.w, w[section.index], atol=1e-9)
        assert np.allclose(section.rho, RADIUS, atol=1e-4)  # w²κ/2 of a curve
        assert np.allclose(section.position, axis.position(y))


def test_polar_coordinates_have_the_crown_at_zero_and_right_positive():
    axis = curved()
    y = axis.at_chainage(20.0)
    right, up, _ = axis.frame(y)
    points = axis.position(y) + np.array([2 * up, 3 * right, -4 * up, -5 * right, right + up])
    (section,) = cut(points, axis, 20.0)
    order = np.argsort(section.index)
    directions = np.radians([0, 90, 180, 270, 45])
    assert np.allclose(np.exp(1j * section.alpha[order]), np.exp(1j * directions), atol=1e-9)
    assert np.allclose(section.rho[order], [2, 3, 4, 5, np.sqrt(2)], atol=1e-9)


def test_projection_along_a_straight_tunnel_leaves_no_trace_and_in_a_curve_the_sagitta():
    rng = np.random.default_rng(3)
    steep = straight([0, 0, 0], [30, 40, 8])
    (section,) = cut(tube(steep, 50_000, rng), steep, [20.0], thickness=0.5)
    assert np.abs(section.rho - RADIUS).max() < 1e-9
    (section,) = cut(tube(curved(), 50_000, rng), curved(), [20.0], thickness=0.5)
    assert 2e-5 < np.abs(section.rho - RADIUS).max() <= 1.1 * 0.25**2 / 600


def test_sections_do_not_depend_on_the_order_of_the_points_or_the_block(monkeypatch):
    axis, rng = curved(), np.random.default_rng(4)
    points = tube(axis, 5000, rng)
    order = rng.permutation(len(points))
    whole = cut(points, axis, [10.0, 30.0])
    monkeypatch.setattr(
        module, "pieces", lambda count, size: [slice(k, k + 333) for k in range(0, count, 333)]
    )
    for one, other in zip(whole, cut(points[order], axis, [10.0, 30.0]), strict=True):
        assert set(one.index) == set(order[other.index]) and np.isclose(one.u.sum(), other.u.sum())


def test_a_section_without_points_comes_back_empty_and_refuses_to_be_read():
    axis = straight([0, 0, 0], [0, 60, 0])
    points = tube(axis, 20_000, np.random.default_rng(5))
    points = points[np.abs(points[:, 1] - 30.0) > 1.0]
    full, empty = cut(points, axis, [20.0, 30.0])
    assert full.count and empty.count == 0
    for read in (equal_angles, local_radii):
        with pytest.raises(
            ValueError,
            match=r"chainage 30.000 m: expected at least 5 points, got 0; nothing was scanned "
            r"there",
        ):
            read(empty)


# --------------------------------------------------------------------------------- equal angles, as
# printed


def test_nearest_points_against_a_search_of_all():
    section = ring(3000, np.random.default_rng(6), oval, sigma=0.003)
    radii = equal_angles(section)
    assert radii.radius.shape == (3, len(DIRECTIONS))
    for k, offset in enumerate([-0.025, 0.0, 0.025]):
        near = np.flatnonzero(np.abs(section.w - offset) <= 0.0125)
        for j in range(0, len(DIRECTIONS), 7):
            away = np.abs(section.alpha[near] - DIRECTIONS[j])
            if away.min() <= 0.5 * STEP:
                assert (
                    radii.radius[k, j] == section.rho[near[np.argmin(away)]]
                    and not radii.interpolated[k, j]
                )
                assert radii.count[k, j] == 1.0
            else:
                assert radii.interpolated[k, j] or np.isnan(radii.radius[k, j])
    assert np.isnan(radii.sd).all()  # of a single point it is not known


def test_an_empty_direction_is_interpolated_by_a_quadratic():
    a = np.concatenate([np.radians([-4.0, -3.0, -2.5]), np.radians([2.0, 3.5, 5.0])])
    curve = lambda x: 2.7 + 0.3 * x - 0.8 * x**2  # noqa: E731
    radii = equal_angles(section_of(a, curve(a)), np.radians([0.0, 2.1]))
    assert np.allclose(radii.radius[1], [2.7, curve(a[3])], atol=1e-12)
    assert radii.interpolated[1].tolist() == [True, False] and np.isnan(radii.radius[[0, 2]]).all()


# --------------------------------------------------------------------------------- robust local
# estimate


@pytest.mark.parametrize("read", [equal_angles, local_radii])
def test_exact_sections_give_the_exact_radius_in_every_direction(read):
    section = ring(40_000, np.random.default_rng(7), oval)
    radii = read(section)
    error = np.abs(radii.radius - oval(DIRECTIONS))
    assert not radii.gaps.any() and error.max() < (2e-3 if read is equal_angles else 1e-6)


@pytest.mark.parametrize("read", [equal_angles, local_radii])
def test_gaps_are_flagged_and_never_extrapolated(read):
    hole = np.radians([20.0, 60.0])
    radii = read(
        ring(8000, np.random.default_rng(8), oval, hole=hole), np.radians(np.arange(-180.0, 181.0))
    )
    inside = (radii.directions > hole[0] + 0.5 * STEP) & (radii.directions < hole[1] - 0.5 * STEP)
    assert np.isnan(radii.radius[..., inside]).all() and not radii.interpolated[..., inside].any()
    assert np.isfinite(
        radii.radius[..., (radii.directions < hole[0] - STEP) | (radii.directions > hole[1] + STEP)]
    ).all()


@pytest.mark.parametrize("read", [equal_angles, local_radii])
def test_a_small_hole_is_interpolated_and_says_so(read):
    hole = np.radians([24.5, 30.5])
    radii = read(
        ring(40_000, np.random.default_rng(9), oval, hole=hole), np.radians([10.0, 27.0, 28.0])
    )
    assert radii.interpolated[..., 1:].all() and not radii.interpolated[..., 0].any()
    assert np.allclose(radii.radius[..., 1:], oval(radii.directions[1:]), atol=1e-3)


def test_the_seam_at_the_invert_is_no_edge():
    section = ring(8000, np.random.default_rng(10), oval)
    left, right = local_radii(section, np.array([-np.pi, np.pi])).radius
    assert left == pytest.approx(right, abs=1e-12) and left == pytest.approx(oval(np.pi), abs=1e-6)


@pytest.mark.parametrize("count, sigma", [(700, 0.003), (3000, 0.002), (20_000, 0.005)])
def test_standard_deviations_are_those_of_many_redraws(count, sigma):
    rng, directions = (
        np.random.default_rng(11),
        np.radians([-130.0, -60.0, -17.0, 0.0, 45.0, 111.0]),
    )
    ratios = []
    for _ in range(120):
        radii = local_radii(ring(count, rng, oval, sigma), directions)
        ratios.append((radii.radius - oval(directions)) / radii.sd)
    # Student's t of few degrees of freedom is wider than 1
    ratios, limit = np.concatenate(ratios), 1.6
    assert 0.9 < np.sqrt(np.mean(np.clip(ratios, -5, 5) ** 2)) < limit
    assert abs(ratios.mean()) < 4 * ratios.std() / np.sqrt(len(ratios))


def test_noise_falls_with_the_root_of_the_effective_count():
    section = ring(60_000, np.random.default_rng(12), oval, sigma=0.003)
    radii = local_radii(section)
    # a quadratic costs 5/9
    assert np.median(radii.count) == pytest.approx(60_000 / 360 * 4 / 9, rel=0.1)
    assert np.median(radii.sd) == pytest.approx(0.003 / np.sqrt(np.median(radii.count)), rel=0.1)
    errors = radii.radius - oval(DIRECTIONS)
    assert errors.std() == pytest.approx(np.median(radii.sd), rel=0.15)
    printed = equal_angles(section).radius[1] - oval(DIRECTIONS)
    assert printed.std() == pytest.approx(0.003, rel=0.2) and errors.std() < printed.std() / 5


def test_points_before_the_wall_do_not_pull():
    rng = np.random.default_rng(13)
    section = ring(20_000, rng, oval, sigma=0.003)
    before = rng.uniform(size=section.count) < 0.1
    rho = section.rho - np.where(before, 0.13, 0.0)
    clean, spoiled = local_radii(section), local_radii(section_of(section.alpha, rho, section.w))
    assert np.abs(spoiled.radius - oval(DIRECTIONS)).max() < 0.003
    assert (spoiled.radius - oval(DIRECTIONS)).std() < 1.5 * (clean.radius - oval(DIRECTIONS)).std()


def test_sparse_sections_reach_further_and_never_pretend():
    radii = local_radii(ring(300, np.random.default_rng(14), oval, sigma=0.003))
    seen = ~radii.gaps
    assert (
        seen.sum() > 200
        and np.all(radii.reach[seen] > 0.5 * STEP)
        and np.all(radii.reach[seen] <= np.radians(10.0) + 1e-12)
    )
    assert np.all(radii.count[seen] >= 1.0) and np.all(radii.sd[seen] > 0)
    assert np.abs((radii.radius - oval(DIRECTIONS))[seen]).max() < 0.015


# --------------------------------------------------------------------------------- refusals

AXIS = straight([0, 0, 0], [0, 10, 0])
POINTS = np.array([[0.0, 5.0, 3.0]])


@pytest.mark.parametrize(
    "call, message",
    [
        (
            lambda: cut(POINTS, AXIS, [11.0]),
            r"between 0 and the axis' length of 10.000 m, got 11 to 11 m",
        ),
        (lambda: cut(POINTS, AXIS, []), "got none"),
        (lambda: cut(POINTS, AXIS, [np.nan]), "chainages: expected finite"),
        (lambda: cut(POINTS, AXIS, [5.0], thickness=0.0), "thickness: expected a positive"),
        (lambda: cut(np.empty((0, 3)), AXIS, [5.0]), "at least 1 points for sections, got 0"),
        (lambda: cut(POINTS[:, :2], AXIS, [5.0]), "expected shape"),
        (lambda: cut(POINTS[None], AXIS, [5.0]), "one cloud"),
        (lambda: local_radii(cut(POINTS, AXIS, [5.0])[0]), "at least 5 points, got 1"),
        (lambda: local_radii(ring(100, np.random.default_rng(1)), [90.0]), "in rad between"),
        (
            lambda: local_radii(ring(100, np.random.default_rng(1)), step=0.0),
            "step: expected a positive",
        ),
    ],
)
def test_bad_input_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()
