"""The scanner: cofactors of its points, visible parts of a scene, and noise."""

from dataclasses import replace

import numpy as np
import pytest

import analysis
from analysis.scanner import LEICA_C10, RIEGL_VZ400, Scanner
from studies.simulation.scenes import (
    MIXED,
    AngularGrid,
    Cylinder,
    Disc,
    Rectangle,
    Scene,
    Sphere,
    redraw,
    scan,
    scan_sphere_target,
    sphere_target_scene,
)
from studies.simulation.scenes.scanning import RINGS, disc_pattern

# of Ou & Liu's table 3, IGG III-WTLS, m
CENTERS = [(0.0063, 5.8454, -1.6357), (1.3963, 3.7694, -1.6247)]
CENTER = np.array(CENTERS[0])
RADIUS = 0.0725
LINE = replace(LEICA_C10, beam_diameter=0.0)  # a beam without width
POLAR = Scanner(
    "polar", range_sd=0.003, angle_sd=2e-4, azimuth_sd=5e-4, range_rate=1e-4, incidence_exponent=0.0
)


def generator(seed=0):
    return np.random.default_rng(seed)


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def random_points(count, seed=1):
    return generator(seed).uniform(-20.0, 20.0, size=(count, 3)) + (25.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def target():
    """A finely scanned target: enough points for statistics."""
    return scan_sphere_target(CENTER, RADIUS, generator(), step=2e-4)


# ------------------------------------------------------------------ the stochastic model


def test_cofactors_are_the_propagated_polar_ones():
    points = random_points(50)
    x, y, z = points.T
    rho, azimuth, elevation = (
        np.linalg.norm(points, axis=1),
        np.arctan2(y, x),
        np.arcsin(z / np.linalg.norm(points, axis=1)),
    )
    ca, sa, ce, se, zero = (
        np.cos(azimuth),
        np.sin(azimuth),
        np.cos(elevation),
        np.sin(elevation),
        0 * x,
    )
    J = np.moveaxis(
        np.array(
            [
                [ce * ca, -rho * ce * sa, -rho * se * ca],
                [ce * sa, rho * ce * ca, -rho * se * sa],
                [se, zero, rho * ce],
            ]
        ),
        -1,
        0,
    )
    variances = np.stack(
        [0.003**2 + (1e-4 * rho) ** 2, 0 * rho + 5e-4**2, 0 * rho + 2e-4**2], axis=-1
    )
    np.testing.assert_allclose(
        POLAR.cofactors(points),
        (J * variances[:, None, :]) @ J.swapaxes(-1, -2),
        rtol=1e-9,
        atol=1e-18,
    )


def test_isotropic_angles_give_the_form_with_the_projector_across_the_beam():
    points = random_points(50)
    rho = np.linalg.norm(points, axis=1)[:, None, None]
    bb = unit(points)[:, :, None] * unit(points)[:, None, :]
    expected = LEICA_C10.range_sd**2 * bb + (rho * LEICA_C10.angle_sd) ** 2 * (np.eye(3) - bb)
    np.testing.assert_allclose(LEICA_C10.cofactors(points), expected, rtol=1e-12, atol=1e-20)


def test_cofactors_are_the_covariance_of_polar_noise():
    point = np.array([[12.0, -7.0, 9.0]])
    rho, azimuth, elevation = (
        np.linalg.norm(point),
        np.arctan2(-7.0, 12.0),
        np.arcsin(9.0 / np.linalg.norm(point)),
    )
    z = generator(2).standard_normal((3, 200_000))
    rho = rho + np.hypot(0.003, 1e-4 * rho) * z[0]
    azimuth, elevation = azimuth + 5e-4 * z[1], elevation + 2e-4 * z[2]
    cloud = rho * np.array(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ]
    )
    Q = POLAR.cofactors(point)[0]
    scale = np.sqrt(np.outer(np.diag(Q), np.diag(Q)))
    np.testing.assert_allclose(np.cov(cloud) / scale, Q / scale, atol=5 * np.sqrt(2 / 200_000))


@pytest.mark.parametrize("degrees", [0.0, 30.0, 60.0, 80.0])
def test_variance_along_the_normal_follows_the_incidence_angle(degrees):
    theta = np.deg2rad(degrees)
    points = random_points(20)
    b = unit(points)
    aside = unit(np.cross(b, (0.3, -0.2, 0.9)))
    normals = np.cos(theta) * b + np.sin(theta) * aside
    # neither length nor sense of a normal matters
    Q = LEICA_C10.cofactors(points, normals=-7.0 * normals)
    rho = np.linalg.norm(points, axis=1)
    sd = LEICA_C10.range_sd * np.cos(theta) ** -0.5
    expected = sd**2 * np.cos(theta) ** 2 + (rho * LEICA_C10.angle_sd) ** 2 * np.sin(theta) ** 2
    np.testing.assert_allclose(np.einsum("ni,nij,nj->n", normals, Q, normals), expected, rtol=1e-9)


def test_range_variance_is_inverse_to_the_cosine_by_default_and_bounded_when_grazing():
    cosines = np.cos(np.deg2rad([0.0, 40.0, 70.0]))
    np.testing.assert_allclose(
        RIEGL_VZ400.range_standard_deviation(10.0, cosines) ** 2, 0.003**2 / cosines
    )
    at_limit = LEICA_C10.range_standard_deviation(10.0, np.cos(LEICA_C10.max_incidence))
    assert LEICA_C10.range_standard_deviation(10.0, 0.0) == at_limit


def test_cofactors_of_a_stack_from_any_station_are_positive_definite():
    points = random_points(24).reshape(2, 3, 4, 3)
    station = np.array([3.0, -2.0, 1.5])
    Q = LEICA_C10.cofactors(points, station, normals=unit(random_points(4, seed=3)))
    assert Q.shape == (2, 3, 4, 3, 3)
    assert np.all(Q == Q.swapaxes(-1, -2))
    assert np.linalg.eigvalsh(Q).min() > 0
    np.testing.assert_array_equal(
        LEICA_C10.cofactors(points, station), LEICA_C10.cofactors(points - station)
    )
    straight_up = LEICA_C10.cofactors([[0.0, 0.0, 10.0]])[0]
    np.testing.assert_allclose(straight_up, np.diag([6e-4, 6e-4, 2e-3]) ** 2, atol=1e-20)


def test_fit_with_the_scanner_s_cofactors_is_calibrated(target):
    """With absolute variances σ0 is 1 and the covariance contains the truth."""
    sphere = target[target.on("sphere")][::64]
    redraws = redraw(sphere, 400, seed=5)
    Q = LEICA_C10.cofactors(sphere.true_points, normals=sphere.normals)
    fit = analysis.fit_sphere(redraws, cofactors=np.broadcast_to(Q, redraws.shape + (3,)))
    assert fit.converged.all()
    assert abs(fit.sigma_0.mean() - 1) < 0.01
    errors = fit.parameters - [*CENTER, RADIUS]
    squares = np.einsum("bi,bij,bj->b", errors, np.linalg.inv(fit.cofactor), errors)
    inside = np.mean(squares < 9.488)  # χ² of 4, 95 %
    assert abs(inside - 0.95) < 4 * np.sqrt(0.95 * 0.05 / 400)


# ------------------------------------------------------------------------------ the grid


def test_grid_has_the_asked_step_and_window():
    grid = AngularGrid((0.2, 0.5), (-0.3, 0.1), step=0.01)
    beams = grid.beams(slice(None))
    assert beams.shape == (len(grid), 3) == (31 * 41, 3)
    np.testing.assert_allclose(np.linalg.norm(beams, axis=1), 1.0, rtol=1e-15)
    azimuth = np.arctan2(beams[:, 1], beams[:, 0]).reshape(31, 41)
    elevation = np.arcsin(beams[:, 2]).reshape(31, 41)
    np.testing.assert_allclose(np.diff(azimuth, axis=0), 0.01, rtol=1e-9)
    np.testing.assert_allclose(np.diff(elevation, axis=1), 0.01, rtol=1e-9)
    np.testing.assert_allclose(
        [azimuth.min(), azimuth.max(), elevation.min(), elevation.max()], [0.2, 0.5, -0.3, 0.1]
    )
    np.testing.assert_array_equal(grid.beams(slice(100, 150)), beams[100:150])


def test_full_circle_has_no_beam_twice():
    grid = AngularGrid((-np.pi, np.pi), (0.0, 0.0), step=np.pi / 180)
    assert len(grid) == 360
    between = grid.beams(slice(0, 1)) @ grid.beams(slice(359, 360)).T
    assert np.isclose(np.arccos(between.item()), np.pi / 180)


def test_window_around_a_target_shows_the_whole_ball_and_touches_it():
    station = (1.0, -2.0, 0.5)
    grid = AngularGrid.around(CENTER, 0.3, 1e-3, station)
    scene = Scene([("ball", Sphere(CENTER, 0.3))])
    hit = (
        scene.first_hit(np.array(station), grid.beams(slice(None)))[1].reshape(
            len(grid.azimuths), -1
        )
        == 0
    )
    wide = AngularGrid(
        *(np.add(window, (-0.02, 0.02)) for window in (grid.azimuth, grid.elevation)), step=1e-3
    )
    all_hits = np.count_nonzero(scene.first_hit(np.array(station), wide.beams(slice(None)))[1] == 0)
    # nothing outside the window but the phase of the grid
    assert abs(hit.sum() / all_hits - 1) < 0.01
    assert hit[:3].any() and hit[-3:].any() and hit[:, :3].any() and hit[:, -3:].any()


# -------------------------------------------------------------------------- the surfaces

SURFACES = {
    "sphere": (
        Sphere((0.5, 6.0, -0.2), 0.7),
        lambda p: np.linalg.norm(p - [0.5, 6.0, -0.2], axis=1) - 0.7,
    ),
    "rectangle": (
        Rectangle((0.0, 6.0, 0.0), (1.0, 0.5, 0.0), (0.0, 0.0, 1.0)),
        lambda p: (p - [0.0, 6.0, 0.0]) @ unit(np.array([0.5, -1.0, 0.0])),
    ),
    "disc": (
        Disc((0.0, 6.0, 0.0), (0.2, 1.0, -0.3), 1.0),
        lambda p: (p - [0.0, 6.0, 0.0]) @ unit(np.array([0.2, 1.0, -0.3])),
    ),
    "cylinder": (
        Cylinder((-1.0, 5.0, -1.0), (1.0, 7.0, 1.0), 0.3),
        lambda p: (
            np.linalg.norm(np.cross(p - [-1.0, 5.0, -1.0], unit(np.array([2.0, 2.0, 2.0]))), axis=1)
            - 0.3
        ),
    ),
}
EXTENT = {  # no point of the surface is farther from this point than that
    "sphere": ((0.5, 6.0, -0.2), 0.7),
    "rectangle": ((0.0, 6.0, 0.0), np.sqrt(2.25)),
    "disc": ((0.0, 6.0, 0.0), 1.0),
    "cylinder": ((0.0, 6.0, 0.0), np.sqrt(3.0 + 0.09)),
}


@pytest.mark.parametrize("name", SURFACES)
def test_hits_lie_exactly_on_the_surface(name):
    surface, distance = SURFACES[name]
    beams = AngularGrid((1.0, 2.1), (-0.4, 0.4), 0.005).beams(slice(None))
    ranges = surface.intersect(np.zeros(3), beams)
    hit = np.isfinite(ranges)
    points = ranges[hit, None] * beams[hit]
    assert hit.sum() > 1000 and (~hit).sum() > 1000
    assert np.abs(distance(points)).max() < 1e-13
    middle, reach = EXTENT[name]
    assert np.linalg.norm(points - middle, axis=1).max() <= reach + 1e-12
    # A normal is the gradient of the distance.
    normals = surface.normals(points)
    gradient = np.stack(
        [(distance(points + step) - distance(points - step)) / 2e-6 for step in 1e-6 * np.eye(3)],
        axis=1,
    )
    np.testing.assert_allclose(np.abs(np.einsum("ni,ni->n", normals, gradient)), 1.0, atol=1e-8)


@pytest.mark.parametrize("name", SURFACES)
def test_rays_meet_only_what_lies_before_them(name):
    surface, _ = SURFACES[name]
    beams = AngularGrid((1.0, 2.1), (-0.4, 0.4), 0.01).beams(slice(None))
    ahead = surface.intersect(np.zeros(3), beams)
    hit = np.isfinite(ahead)
    assert np.all(np.isinf(surface.intersect(np.array([0.0, 20.0, 0.0]), beams)))
    # From half way the rest of the range is left, and there may be many origins.
    np.testing.assert_allclose(
        surface.intersect(0.5 * ahead[hit, None] * beams[hit], beams[hit]),
        0.5 * ahead[hit],
        rtol=1e-10,
    )


def test_closed_surfaces_are_seen_from_inside():
    beams = unit(generator(4).standard_normal((500, 3)))
    np.testing.assert_allclose(Sphere((0, 0, 0), 2.0).intersect(np.zeros(3), beams), 2.0)
    tunnel = Cylinder((0.0, -50.0, 0.0), (0.0, 50.0, 0.0), 2.75)
    ranges = tunnel.intersect(np.array([0.3, 1.0, -0.5]), beams)
    points = [0.3, 1.0, -0.5] + ranges[:, None] * beams
    seen = np.isfinite(ranges)
    assert seen.mean() > 0.98
    np.testing.assert_allclose(np.hypot(points[seen, 0], points[seen, 2]), 2.75, rtol=1e-12)
    assert np.isinf(tunnel.intersect(np.zeros(3), np.array([0.0, 1.0, 0.0])))  # along the axis
    # From outside, through the open end, the far wall.
    through = unit(np.array([0.0, 3.0, 1.0]))
    np.testing.assert_allclose(
        tunnel.intersect(np.array([0.0, -51.0, 0.0]), through)[()], 2.75 * np.sqrt(10.0)
    )


# ------------------------------------------------------------------------- what is seen


def test_labels_and_occlusion():
    """A disc hides part of a wall: the hole in the wall is the shadow of the disc, not more."""
    wall, disc = (
        Rectangle((0.0, 10.0, 0.0), (3.0, 0.0, 0.0), (0.0, 0.0, 3.0)),
        Disc((0.0, 5.0, 0.0), (0.0, 1.0, 0.0), 0.5),
    )
    grid = AngularGrid((1.4, 1.75), (-0.2, 0.2), 0.004)
    seen = scan(Scene([("wall", wall), ("disc", disc)]), grid, LINE, generator())
    points = seen.true_points
    np.testing.assert_allclose(points[seen.on("disc"), 1], 5.0)
    np.testing.assert_allclose(points[seen.on("wall"), 1], 10.0)
    from_axis = np.hypot(points[:, 0], points[:, 2])
    assert from_axis[seen.on("disc")].max() <= 0.5
    assert from_axis[seen.on("wall")].min() > 1.0
    assert len(seen) == len(grid)
    assert set(seen.labels[seen.on("disc")]) == {"disc"} and not seen.on(MIXED).any()


def test_nothing_is_seen_behind_another_surface(target):
    """From each point the way back to the station is free."""
    pure = target[~target.on(MIXED)]
    ranges, _ = sphere_target_scene(CENTER, RADIUS).first_hit(
        target.station, unit(pure.true_points)
    )
    np.testing.assert_allclose(ranges, np.linalg.norm(pure.true_points, axis=1), rtol=1e-12)


def test_visible_cap_of_a_sphere_faces_the_scanner():
    to_the_edge = replace(LINE, max_incidence=np.deg2rad(89.9))
    seen = scan(
        Scene([("ball", Sphere(CENTER, RADIUS))]),
        AngularGrid.around(CENTER, 0.08, 2e-4),
        to_the_edge,
        generator(),
    )
    radial = unit(seen.true_points - CENTER)
    towards = -radial @ unit(CENTER)
    # cosine of the half angle of the cap: the tangents from the station
    edge = RADIUS / np.linalg.norm(CENTER)
    assert edge <= towards.min() < edge + 0.05 and towards.max() > 0.9999
    np.testing.assert_allclose(seen.normals, radial, atol=1e-11)
    np.testing.assert_allclose(seen.cosines, -np.einsum("ni,ni->n", seen.beams, radial), atol=1e-11)


def test_number_of_points_grows_with_the_inverse_square_of_the_step():
    coarse, fine = (
        np.count_nonzero(scan_sphere_target(CENTER, RADIUS, generator(), step=step).on("sphere"))
        for step in (8e-4, 2e-4)
    )
    assert abs(fine / coarse / 16 - 1) < 0.05


def test_reach_and_grazing_incidence():
    wall = Scene([("wall", Rectangle((0.0, 10.0, 0.0), (100.0, 0.0, 0.0), (0.0, 0.0, 1.0)))])
    grid = AngularGrid((0.0, np.pi), (0.0, 0.0), 0.001)
    seen = scan(
        wall,
        grid,
        replace(LINE, min_range=11.0, max_range=40.0, max_incidence=np.deg2rad(70.0)),
        generator(),
    )
    assert 11.0 <= seen.true_ranges.min() < 11.05
    assert np.deg2rad(69.9) < seen.incidence.max() <= np.deg2rad(70.0)
    assert (
        39.5
        < scan(wall, grid, replace(LINE, max_range=40.0), generator()).true_ranges.max()
        <= 40.0
    )
    empty = scan(wall, AngularGrid((-1.0, -0.5), (0.0, 0.0), 0.01), LINE, generator())
    assert len(empty) == 0 and empty.points.shape == (0, 3)


def test_a_scene_may_stand_anywhere():
    """Scene and station moved together give the moved scan."""
    shift = np.array([100.0, -30.0, 7.0])
    here = scan_sphere_target(CENTER, RADIUS, generator(), step=5e-4)
    there = scan_sphere_target(CENTER + shift, RADIUS, generator(), step=5e-4, station=shift)
    np.testing.assert_array_equal(there.codes, here.codes)
    np.testing.assert_allclose(there.points - shift, here.points, atol=1e-9)


# -------------------------------------------------------------------------- mixed pixels


def test_disc_pattern_fills_the_unit_disc():
    pattern = disc_pattern(RINGS)
    assert len(pattern) == 61
    assert np.isclose(np.linalg.norm(pattern, axis=1).max(), 1.0)
    np.testing.assert_allclose(pattern.mean(axis=0), 0.0, atol=1e-15)


def step_scene(near=5.0, far=7.0):
    """A near wall to the left of x = 0 before a far wall."""
    left = Rectangle((-2.0, near, 0.0), (2.0, 0.0, 0.0), (0.0, 0.0, 2.0))
    behind = Rectangle((0.0, far, 0.0), (4.0, 0.0, 0.0), (0.0, 0.0, 4.0))
    return Scene([("near", left), ("far", behind)])


def test_mixed_pixels_lie_between_the_two_ranges_and_only_at_the_edge():
    seen = scan(
        step_scene(),
        AngularGrid((np.pi / 2 - 0.01, np.pi / 2 + 0.01), (-0.01, 0.01), 1e-4),
        LEICA_C10,
        generator(),
    )
    mixed = seen.on(MIXED)
    depth = seen.true_points[:, 1]
    assert np.all((depth[mixed] > 5.0) & (depth[mixed] < 7.0))
    # from all of one wall to all of the other
    assert depth[mixed].min() < 5.1 and depth[mixed].max() > 6.9
    # of the beam's centre from the edge, m
    aside = 5.0 * np.cos(np.arctan2(seen.beams[:, 1], seen.beams[:, 0]))
    half = 0.5 * LEICA_C10.beam_diameter
    assert np.abs(aside[mixed]).max() <= half * 1.01
    assert np.abs(aside[~mixed]).min() >= half * 0.85  # the rim is looked at in six places
    # Where the centre lies on the edge, the mean of both ranges, weighted by the inverse of their
    # squares.
    middle = mixed & (np.abs(aside) < 1e-4)
    expected = (5.0 / 25.0 + 7.0 / 49.0) / (1 / 25.0 + 1 / 49.0)
    assert abs(depth[middle].mean() - expected) < 0.15
    # along the beam
    np.testing.assert_allclose(np.cross(seen.true_points, seen.beams), 0.0, atol=1e-12)


def test_without_a_step_there_is_no_mixed_pixel():
    """Two halves of one wall, and a wall met obliquely: one range, however many surfaces."""
    halves = [
        ("wall", Rectangle((x, 5.0, 0.0), (2.0, 0.0, 0.0), (0.0, 0.0, 2.0))) for x in (-2.0, 2.0)
    ]
    grid = AngularGrid((np.pi / 2 - 0.02, np.pi / 2 + 0.02), (-0.02, 0.02), 2e-4)
    assert not scan(Scene(halves), grid, LEICA_C10, generator()).on(MIXED).any()
    oblique = Scene([("wall", Rectangle((0.0, 5.0, 0.0), (0.3, 2.0, 0.0), (0.0, 0.0, 2.0)))])
    assert not scan(oblique, grid, LEICA_C10, generator()).on(MIXED).any()


def test_share_of_mixed_pixels_grows_with_the_beam(target):
    narrow = scan_sphere_target(
        CENTER, RADIUS, generator(), step=2e-4, scanner=replace(LEICA_C10, beam_diameter=0.0035)
    )
    ratio = narrow.on(MIXED).sum() / target.on(MIXED).sum()
    assert 0.4 < ratio < 0.6
    diverging = replace(
        LEICA_C10, beam_diameter=0.0, beam_divergence=0.007 / np.linalg.norm(CENTER)
    )
    same = scan_sphere_target(CENTER, RADIUS, generator(), step=2e-4, scanner=diverging)
    assert abs(same.on(MIXED).sum() / target.on(MIXED).sum() - 1) < 0.05


# --------------------------------------------------------------------- noise and redraws


def test_noise_has_the_statistics_of_the_model(target):
    errors = target.points - target.true_points
    of_range = np.einsum("ni,ni->n", errors, target.beams)
    along = of_range / LEICA_C10.range_standard_deviation(target.true_ranges, target.cosines)
    across = (errors - of_range[:, None] * target.beams) / (
        LEICA_C10.angle_sd * target.true_ranges
    )[:, None]
    n = len(target)
    assert n > 10_000
    assert abs(np.mean(along)) < 4 / np.sqrt(n)
    assert abs(np.mean(along**2) - 1) < 4 * np.sqrt(2 / n)
    assert abs(np.mean(np.sum(across**2, axis=1)) - 2) < 4 * np.sqrt(4 / n)
    np.testing.assert_allclose(target.ranges - target.true_ranges, of_range, atol=1e-6)


def test_redraws_have_the_cofactors_as_covariance(target):
    some = target[target.on("sphere", "wall")][::400]
    redraws = redraw(some, 4000, seed=3)
    Q = LEICA_C10.cofactors(some.true_points, normals=some.normals)
    root = np.linalg.inv(np.linalg.cholesky(Q))
    z = np.einsum("nij,bnj->bni", root, redraws - some.true_points)
    found = np.einsum("bni,bnj->nij", z, z) / 4000
    assert np.abs(found - np.eye(3)).max() < 6 * np.sqrt(2 / 4000)


def test_same_seed_same_scan_and_redraws_that_do_not_depend_on_their_number():
    one, same, other = (scan_sphere_target(CENTER, RADIUS, generator(seed)) for seed in (7, 7, 8))
    np.testing.assert_array_equal(one.points, same.points)
    np.testing.assert_array_equal(one.true_points, other.true_points)
    assert np.abs(one.points - other.points).max() > 1e-3
    np.testing.assert_array_equal(redraw(one, 5, seed=1)[:3], redraw(other, 3, seed=1))
    assert redraw(one, 5, seed=1).shape == (5, len(one), 3)


def test_a_part_of_a_scan_is_a_scan(target):
    wall = target[target.on("wall")]
    assert set(wall.labels) == {"wall"} and len(wall) == target.on("wall").sum()
    np.testing.assert_array_equal(wall.points, target.points[target.labels == "wall"])
    assert "wall" in repr(wall)


# --------------------------------------------------------------------- the ready target


@pytest.mark.parametrize("center", CENTERS)
def test_target_is_like_a_real_scan_and_the_default_fit_finds_it(center):
    """In real scans of targets 35 to 45 % of the points are not on the sphere."""
    seen = scan_sphere_target(center, RADIUS, generator())
    assert 0.35 < np.mean(~seen.on("sphere")) < 0.45
    assert all(seen.on(name).any() for name in seen.names)
    fits = analysis.fit_sphere(redraw(seen, 50, seed=2))
    errors = np.linalg.norm(fits.center - center, axis=1)
    sd = np.sqrt(np.trace(fits.covariance[:, :3, :3], axis1=1, axis2=2))
    assert fits.converged.all()
    assert np.median(errors / sd) < 2 and np.max(errors / sd) < 5
    assert np.abs(fits.radius - RADIUS).max() < 1.5e-3
    plain = analysis.fit_sphere(redraw(seen, 5, seed=2), "ls")
    assert np.min(np.linalg.norm(plain.center - center, axis=1)) > 10 * errors.max()


def test_target_is_cut_out_by_a_ball():
    seen = scan_sphere_target(CENTER, RADIUS, generator(), cut=1.5, wall_distance=0.5)
    assert np.linalg.norm(seen.true_points - CENTER, axis=1).max() <= 1.5 * RADIUS
    assert not seen.on("wall").any() and seen.on("mount", MIXED).any()


# ----------------------------------------------------------------------------- bad input

WINDOW = ((0.0, 1.0), (0.0, 1.0))
GRID = AngularGrid(*WINDOW, 0.5)
TAKEN = Scene([(MIXED, Sphere((0, 5, 0), 1.0))])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Scanner("x", 0.0, 1e-5), "range_sd: expected a positive"),
        (lambda: Scanner("x", 1e-3, -1e-5), "angle_sd: expected a positive"),
        (lambda: Scanner("x", 1e-3, 1e-5, azimuth_sd=0.0), "azimuth_sd: expected a positive"),
        (
            lambda: Scanner("x", 1e-3, 1e-5, incidence_exponent=-0.5),
            "incidence_exponent: expected a number not below 0",
        ),
        (lambda: Scanner("x", 1e-3, 1e-5, beam_diameter=np.nan), "beam_diameter: expected finite"),
        (lambda: Scanner("x", 1e-3, 1e-5, max_incidence=2.0), "max_incidence: expected an angle"),
        (
            lambda: Scanner("x", 1e-3, 1e-5, min_range=5.0, max_range=5.0),
            "max_range: expected more than",
        ),
        (lambda: LEICA_C10.cofactors(np.ones((4, 2))), r"points: expected shape \(…, n, 3\)"),
        (
            lambda: LEICA_C10.cofactors(np.ones((4, 3)), station=(1, 1)),
            r"station: expected shape \(3,\)",
        ),
        (
            lambda: LEICA_C10.cofactors(np.ones((4, 3)), station=(1, 1, 1)),
            "points: expected points away from the station, got 4",
        ),
        (
            lambda: LEICA_C10.cofactors(np.ones((4, 3)), normals=np.ones((5, 3))),
            "normals: expected shape",
        ),
        (
            lambda: LEICA_C10.cofactors(np.ones((4, 3)), normals=np.ones((2, 4, 3))),
            "normals: expected shape",
        ),
        (
            lambda: LEICA_C10.cofactors(np.ones((4, 3)), normals=np.zeros((4, 3))),
            "normals: expected vectors with a direction, got 4",
        ),
        (lambda: LEICA_C10.cofactors(np.full((4, 3), np.inf)), "points: expected finite"),
        (
            lambda: POLAR.cofactors([[0.0, 0.0, 3.0]]),
            "points: expected points off the vertical axis",
        ),
        (lambda: Sphere((0, 0, 0), 0.0), "radius: expected a positive"),
        (lambda: Sphere((0, 0), 1.0), r"center: expected shape \(3,\)"),
        (
            lambda: Rectangle((0, 0, 0), (1, 0, 0), (1, 1, 0)),
            "up: expected a half side perpendicular",
        ),
        (
            lambda: Rectangle((0, 0, 0), (0, 0, 0), (1, 1, 0)),
            "right: expected a vector with a direction",
        ),
        (lambda: Disc((0, 0, 0), (0, 0, 0), 1.0), "axis: expected a vector with a direction"),
        (lambda: Cylinder((1, 2, 3), (1, 2, 3), 1.0), "end: expected a point away from start"),
        (lambda: Scene([]), "surfaces: expected at least one pair"),
        (lambda: Scene([("ball", None)]), r"surfaces: expected pairs \(text, surface\)"),
        (lambda: AngularGrid((1.0, 0.0), (0.0, 1.0), 0.1), "azimuth: expected"),
        (
            lambda: AngularGrid((0.0, 7.0), (0.0, 1.0), 0.1),
            "azimuth: expected a window of at most 2π",
        ),
        (lambda: AngularGrid((0.0, 1.0), (0.0, 2.0), 0.1), "elevation: expected angles"),
        (lambda: AngularGrid(*WINDOW, 0.0), "step: expected a positive"),
        (
            lambda: AngularGrid.around((0, 1, 0), 1.0, 0.1),
            "radius: expected less than the distance",
        ),
        (
            lambda: AngularGrid.around((0, 0.1, 5), 0.2, 0.1),
            "target: expected a window without the vertical axis",
        ),
        (
            lambda: scan(step_scene(), GRID, LEICA_C10, 0),
            "generator: expected a numpy.random.Generator, got int",
        ),
        (lambda: scan(TAKEN, GRID, LEICA_C10, generator()), "scene: expected labels other"),
        (
            lambda: scan(step_scene(), GRID, LEICA_C10, generator(), (0, np.nan, 0)),
            "station: expected finite",
        ),
        (
            lambda: redraw(scan_sphere_target(CENTER, RADIUS, generator()), 0, 1),
            "n_trials: expected a whole number",
        ),
        (
            lambda: scan_sphere_target(CENTER, RADIUS, generator()).on("walls"),
            "labels: expected some of sphere, mount, wall, mixed; got",
        ),
        (
            lambda: sphere_target_scene(CENTER, RADIUS, wall_distance=0.05),
            "wall_distance: expected more than the radius",
        ),
        (
            lambda: sphere_target_scene((0, 0, -2), RADIUS),
            "center: expected a sphere beside the vertical axis",
        ),
        (
            lambda: sphere_target_scene(CENTER, RADIUS, mount_radius=0),
            "mount_radius: expected a positive",
        ),
        (
            lambda: scan_sphere_target(CENTER, RADIUS, generator(), cut=0.5),
            "cut: expected at least 1 radius",
        ),
    ],
)
def test_bad_input_is_refused_by_name(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_inputs_are_left_alone_and_results_of_surfaces_are_frozen():
    center = np.array([0.0, 5.0, 0.0])
    ball = Sphere(center, 1.0)
    center[1] = 9.0
    assert ball.center[1] == 5.0
    with pytest.raises(ValueError, match="read-only"):
        ball.center[0] = 1.0
