"""The simulated tunnel campaign: its truth, hits of beams, and measurements."""

from dataclasses import replace

import numpy as np
import pytest

from analysis.scanner import RIEGL_VZ400
from studies.simulation.tunnel import (
    ATTACHMENTS,
    CODES,
    FLAGGED_SECTIONS,
    NAMES,
    QUIET_ZONE,
    SECTIONS,
    ZONE,
    Alignment,
    Lining,
    default_tunnel,
    scan_station,
    section_points,
    section_scan,
    simulate_campaign,
    slab,
    survey,
)
from studies.simulation.tunnel.campaign import NET_SD, STATIONS, TARGET_SD, cast_beams, station_grid
from studies.simulation.tunnel.casting import cast

DENSITY = 20_000
ALPHA = np.deg2rad(np.arange(-180.0, 180.0, 0.5))
EVERYWHERE = np.linspace(0.0, 130.0, 2601)
TUNNEL = default_tunnel()
SMOOTH = replace(TUNNEL, lining=Lining(np.zeros((109, 6))))
EPOCHS = survey(TUNNEL)
LINE = replace(RIEGL_VZ400, beam_diameter=0.0, beam_divergence=0.0)  # a beam without width
IN_LINING = [CODES[name] for name in ("lining", "joint", "bolt pocket", "grouting hole", "bolt")]


@pytest.fixture(scope="module")
def small():
    return simulate_campaign(DENSITY, tunnel=TUNNEL)


@pytest.fixture(scope="module")
def truth():
    """One station of the second epoch without noise: points, beams, ranges, cosines, codes."""
    setup = EPOCHS[1].stations[1]
    beams, ranges, cosines, codes = cast_beams(
        TUNNEL, setup, RIEGL_VZ400, station_grid(60_000).beams(slice(None))
    )
    return setup.pose.to_engineering(ranges[:, None] * beams), beams, ranges, cosines, codes


def section_of(points):
    """Chainage, polar angle and radius of engineering coordinates."""
    chainage, u, v = TUNNEL.alignment.section_coordinates(points)
    return chainage, np.arctan2(u, v), np.hypot(u, v)


# ------------------------------------------------------------------------ the design axis


@pytest.mark.parametrize("grade", [0.0, 0.005, -0.02])
def test_section_coordinates_are_the_inverse_of_points(grade):
    axis = Alignment(grade=grade, middle=(500.0, -300.0, 20.0))
    generator = np.random.default_rng(0)
    s, u, v = generator.uniform(-5, 135, 500), *generator.uniform(-3, 3, (2, 500))
    np.testing.assert_allclose(
        axis.section_coordinates(axis.points(s, u, v)), [s, u, v], atol=1e-11
    )
    foot = axis.points(s, u, v) - axis.position(s)
    assert np.abs(np.einsum("ni,ni->n", foot, axis.tangent(s))).max() < 1e-12


def test_axis_is_a_curve_with_a_grade_whose_chainage_is_its_length():
    axis, step = TUNNEL.alignment, 1e-3
    tangent = (axis.position(EVERYWHERE + step) - axis.position(EVERYWHERE - step)) / (2 * step)
    np.testing.assert_allclose(np.linalg.norm(tangent, axis=1), 1.0, atol=1e-9)
    np.testing.assert_allclose(tangent, axis.tangent(EVERYWHERE), atol=1e-9)
    bend = (axis.tangent(EVERYWHERE + step) - axis.tangent(EVERYWHERE - step)) / (2 * step)
    assert np.linalg.norm(bend, axis=1).max() <= 1 / 300
    np.testing.assert_allclose(np.linalg.norm(bend, axis=1), axis.curvature, rtol=1e-6)
    assert 0.005 <= axis.grade <= 0.02


def test_section_frame_has_z_up_y_along_and_x_to_the_right():
    frame = TUNNEL.alignment.frame(EVERYWHERE)
    np.testing.assert_allclose(
        frame @ frame.swapaxes(1, 2), np.broadcast_to(np.eye(3), frame.shape), atol=1e-15
    )
    np.testing.assert_allclose(np.cross(frame[:, 1], frame[:, 2]), frame[:, 0], atol=1e-15)
    assert (
        frame[:, 0, 0].min() > 0.98 and frame[:, 1, 1].min() > 0.98 and frame[:, 2, 2].min() > 0.99
    )
    middle = TUNNEL.alignment.position(65.0)
    crown, right = (
        TUNNEL.alignment.polar_points(65.0, alpha, 2.0) - middle for alpha in (0.0, np.pi / 2)
    )
    np.testing.assert_allclose(crown[[0, 2]], [0.0, 2.0], atol=1e-3)
    np.testing.assert_allclose(right, [2.0, 0.0, 0.0], atol=1e-12)


# -------------------------------------------------------------------------- the deformation


@pytest.mark.parametrize(
    ("chainage", "largest"), list(zip(FLAGGED_SECTIONS, (0.0109, 0.0212, 0.0243), strict=True))
)
def test_three_sections_have_the_printed_maxima_at_the_crown(chainage, largest):
    delta = TUNNEL.deformation(ALPHA, chainage)
    assert np.abs(delta).max() == pytest.approx(largest, abs=1e-12)
    assert ALPHA[np.argmax(np.abs(delta))] in (0.0, -np.pi)
    # the crown comes down
    assert TUNNEL.deformation(0.0, chainage) == pytest.approx(-largest, abs=1e-12)
    springline = TUNNEL.deformation(np.deg2rad([-90.0, 90.0]), chainage)
    assert np.all(springline > 0) and np.all(springline < largest)
    assert ZONE[0] <= chainage <= ZONE[1] and chainage in SECTIONS


def test_deformation_is_smooth_along_the_tunnel_where_it_is_elliptic():
    s = np.arange(30.0, 100.0, 0.01)
    slope = np.gradient(TUNNEL.deformation(0.0, s), s)
    assert np.abs(slope).max() < 0.0043
    assert np.abs(np.gradient(slope, s)).max() < 0.003  # no corner: 1/m, against 0.4 for one


def test_quiet_zone_and_the_sections_where_nothing_happens_do_not_move():
    quiet = np.linspace(*QUIET_ZONE, 400)
    assert np.all(TUNNEL.deformation(ALPHA[:, None], quiet) == 0)
    still = (5.0, 15.0, 35.0, 85.0, 95.0, 125.0)
    assert np.all(TUNNEL.deformation(ALPHA[:, None], np.array(still)) == 0)
    for chainage in set(SECTIONS) - set(still):
        assert np.abs(TUNNEL.deformation(ALPHA, chainage)).max() > 1e-3


def test_dent_is_local_and_no_ellipse():
    delta = TUNNEL.deformation(ALPHA, 25.0)
    harmonics = np.stack(
        [np.ones_like(ALPHA), *(f(k * ALPHA) for k in (1, 2) for f in (np.cos, np.sin))], axis=1
    )
    left = delta - harmonics @ np.linalg.lstsq(harmonics, delta)[0]
    assert delta.min() == pytest.approx(-0.014) and delta.max() == 0
    assert np.abs(left).max() > 0.5 * 0.014
    assert np.mean(delta != 0) < 40 / 360 + 0.01
    np.testing.assert_allclose(TUNNEL.deformation(ALPHA + 2 * np.pi, 25.0), delta, atol=1e-12)


def test_one_ring_moves_as_a_whole_by_8_mm_and_its_neighbours_do_not():
    delta = TUNNEL.deformation(ALPHA, 105.0)
    rigid = np.stack([np.sin(ALPHA), np.cos(ALPHA)], axis=1)
    shift, left, *_ = np.linalg.lstsq(rigid, delta)
    assert np.hypot(*shift) == pytest.approx(0.008) and left.item() < 1e-24
    assert np.all(TUNNEL.deformation(ALPHA[:, None], np.array([104.39, 105.61])) == 0)


def test_one_ring_turns_about_its_horizontal_diameter():
    middle = 114.6
    before, at, behind = (TUNNEL.deformation(ALPHA, middle + along) for along in (-0.4, 0.0, 0.4))
    np.testing.assert_allclose(at, 0.0, atol=1e-15)
    np.testing.assert_allclose(behind, 0.4 * 0.005 * np.cos(ALPHA), atol=1e-12)
    np.testing.assert_allclose(before, -behind, atol=1e-12)


# -------------------------------------------------------------------------------- the lining


@pytest.mark.parametrize("epoch", [1, 2])
def test_lining_without_steps_is_an_ellipse_where_nothing_local_happens(epoch):
    s = np.linspace(35.0, 100.0, 40)[:, None]
    rho = SMOOTH.true_radius(ALPHA, s, epoch)
    a, b = SMOOTH.lining.semi_axes(s, epoch)
    np.testing.assert_allclose(
        (rho * np.sin(ALPHA) / a) ** 2 + (rho * np.cos(ALPHA) / b) ** 2, 1.0, atol=1e-14
    )


def test_lining_has_the_stated_sizes():
    a, b = TUNNEL.lining.semi_axes(EVERYWHERE, 1)
    assert np.all((a - b >= 0.005) & (a - b <= 0.015)) and np.ptp(a - b) > 0.005
    np.testing.assert_allclose((a + b) / 2, 2.70)
    assert np.abs(TUNNEL.lining.steps).max() <= 0.0025 and np.ptp(TUNNEL.lining.steps) > 0.0049
    steps = TUNNEL.true_radius(ALPHA, EVERYWHERE[:, None], 1) - SMOOTH.true_radius(
        ALPHA, EVERYWHERE[:, None], 1
    )
    assert len(np.unique(np.round(steps, 12))) == 109 * 6  # each segment stands in its own place


def test_a_ray_goes_on_to_the_bottom_or_to_the_far_wall_of_a_recess():
    lining, rho, in_joint = TUNNEL.lining, 2.7, 0.5 * 1.2
    at = dict(alpha=np.array([0.1]), rho=np.array([rho]), around=np.array([0.0]))
    down = lining.recess(
        chainage=np.array([12.001]), along=np.array([0.0]), outwards=np.array([1.0]), **at
    )
    assert [float(value[0]) for value in down] == [0, 0.022, 1.0]
    slant = np.deg2rad(60.0)
    far = lining.recess(
        chainage=np.array([12.001]),
        along=np.array([np.sin(slant)]),
        outwards=np.array([np.cos(slant)]),
        **at,
    )
    assert far[1][0] == pytest.approx(0.003 / np.sin(slant)) and far[2][0] == pytest.approx(
        np.sin(slant)
    )
    plain = lining.recess(
        chainage=np.array([12.0 + in_joint]), along=np.array([0.0]), outwards=np.array([1.0]), **at
    )
    assert plain[0][0] == -1 and plain[1][0] == 0


@pytest.mark.parametrize(("chainage", "mirrored"), [(12.24, 1), (12.96, -1)])
def test_a_ray_into_a_pocket_ends_where_a_walk_along_it_does(chainage, mirrored):
    """A pocket of 16 × 10 × 6 cm³ with a bolt of 4 × 4 cm² that ends 3 cm behind the face."""
    rng, rho, count, step = np.random.default_rng(5), 2.7, 1000, 2e-4
    mouth = np.stack(
        [rng.uniform(-0.08, 0.08, count), rng.uniform(-0.05, 0.05, count), np.zeros(count)]
    )
    ray = np.stack([*rng.standard_normal((2, count)), np.abs(rng.standard_normal(count)) + 0.1])
    ray /= np.linalg.norm(ray, axis=0)
    joint = np.pi / 12  # of an even ring
    alpha = joint + mirrored * 0.20 / rho + mouth[1] / rho
    which, extra, cosines = TUNNEL.lining.recess(
        alpha, chainage + mouth[0], np.full(count, rho), *ray
    )
    at = mouth[:, None, :] + np.arange(step, 0.25, step)[:, None] * ray[:, None, :]
    on_bolt = (np.abs(at[0]) < 0.02) & (np.abs(at[1]) < 0.02) & (at[2] > 0.03)
    beyond = (np.abs(at[0]) > 0.08) | (np.abs(at[1]) > 0.05) | (at[2] > 0.06)
    end = np.argmax(on_bolt | beyond, axis=0)
    met = on_bolt[end, np.arange(count)]
    names = np.array(NAMES)[CODES["lining"] + 1 + which]
    # but for edges
    assert (
        np.count_nonzero(met) > 80 and np.mean(names == np.where(met, "bolt", "bolt pocket")) > 0.99
    )
    same = (names == "bolt") == met
    np.testing.assert_allclose(extra[same], step * (1 + end[same]), rtol=0.0, atol=2 * step)
    assert cosines[names == "bolt"].min() >= 1 / np.sqrt(3)


# ----------------------------------------------------------------------------------- casting


def test_lining_points_without_noise_lie_on_the_deformed_lining(truth):
    points, *_, codes = truth
    distances = TUNNEL.distances(points, epoch=2)
    assert np.count_nonzero(codes == CODES["lining"]) > 40_000
    assert np.abs(distances[codes == CODES["lining"]]).max() < 1e-9
    other = TUNNEL.distances(points, epoch=1)  # the first epoch's lining is another
    assert np.abs(other[codes == CODES["lining"]]).max() > 0.02


def test_every_label_is_where_it_says(truth):
    points, *_, codes = truth
    furniture = TUNNEL.furniture
    s, alpha, rho = section_of(points)
    u, v = rho * np.sin(alpha), rho * np.cos(alpha)
    distances = TUNNEL.distances(points, epoch=2)
    assert np.all((s >= 0) & (s <= 130))
    for name, depth in (("joint", 0.022), ("bolt pocket", 0.06), ("grouting hole", 0.06)):
        behind = distances[codes == CODES[name]]
        # a joint may end on the higher of two segments
        assert behind.max() < depth + 0.006 and np.median(behind) > 0.002
    bolt = codes == CODES["bolt"]
    from_ring_joint = np.abs(s[bolt] - 1.2 * np.round(s[bolt] / 1.2))
    assert bolt.any() and np.abs(from_ring_joint - 0.24).max() < 0.0205
    # 30 to 60 mm but for steps between rings
    assert distances[bolt].min() > 0.025 and distances[bolt].max() < 0.065
    np.testing.assert_allclose(v[codes == CODES["track bed"]], furniture.bed, atol=1e-9)
    walk = codes == CODES["catwalk"]
    on_top, on_edge = (
        np.abs(v[walk] - furniture.catwalk.top) < 1e-9,
        np.abs(u[walk] - furniture.catwalk.edge) < 1e-6,
    )
    assert np.all(on_top | on_edge) and on_top.any() and on_edge.any()
    from_tubes = np.min(
        [
            np.abs(np.hypot(u - tube.middle[0], v - tube.middle[1]) - tube.radius)
            for tube in furniture.tubes
        ],
        axis=0,
    )
    assert from_tubes[np.isin(codes, [CODES["cable"], CODES["pipe"]])].max() < 1e-6
    for box in furniture.boxes:
        on = (
            (codes == CODES[box.label])
            & (alpha > box.alpha[0] - 0.01)
            & (alpha < box.alpha[1] + 0.01)
        )
        in_box = (
            s[on]
            - np.array(box.starts)[np.clip(np.searchsorted(box.starts, s[on] + 0.01) - 1, 0, None)]
        )
        assert on.any() and in_box.max() < box.length + 0.01 and rho[on].min() > box.rho - 1e-6
    protruding = np.isin(codes, [CODES[name] for name in ATTACHMENTS])
    assert distances[protruding].max() < 0  # all of it inside the lining


def test_all_labels_occur_and_mixed_pixels_are_few(small):
    codes = np.concatenate([station.codes for epoch in small.epochs for station in epoch.stations])
    shares = np.bincount(codes, minlength=len(NAMES)) / len(codes)
    assert len(shares) == len(NAMES) and np.all(shares > 0)
    assert 0.005 < shares[CODES["mixed"]] < 0.02
    assert shares[CODES["lining"]] > 0.7


def test_mixed_pixels_lie_between_two_surfaces(truth):
    points, beams, ranges, _, codes = truth
    mixed = codes == CODES["mixed"]
    pose = EPOCHS[1].stations[1].pose
    back, sharp, _, kinds = cast(TUNNEL, 2, LINE, pose.position, beams[mixed] @ pose.rotation.T)
    gap = ranges[mixed][back] - sharp
    nearer, behind = gap < -1e-6, gap > 0.005  # than what the middle of the beam meets
    assert np.mean(nearer | (gap > 1e-6)) > 0.95 and nearer.any() and behind.any()
    assert np.all(np.isin(kinds[behind], [CODES[name] for name in (*ATTACHMENTS, "track bed")]))


def solid(points, epoch):
    """Code of each point by an independent description with inequalities; −1 for air."""
    s, u, v = TUNNEL.alignment.section_coordinates(points)
    alpha, rho, furniture = np.arctan2(u, v), np.hypot(u, v), TUNNEL.furniture
    filled = np.full(len(points), -1)
    for person in furniture.people[epoch - 1]:
        foot = TUNNEL.alignment.points(person.chainage, person.u, furniture.bed)
        filled[np.linalg.norm((points - foot)[:, :2], axis=1) < person.radius] = CODES["person"]
        filled[(filled == CODES["person"]) & (points[:, 2] > foot[2] + person.height)] = -1
    for box in furniture.boxes:
        starts = np.array(box.starts)
        along = s - starts[np.clip(np.searchsorted(starts, s) - 1, 0, None)]
        filled[
            (alpha > box.alpha[0])
            & (alpha < box.alpha[1])
            & (rho > box.rho)
            & (along > 0)
            & (along < box.length)
        ] = CODES[box.label]
    for tube in furniture.tubes:
        filled[np.hypot(u - tube.middle[0], v - tube.middle[1]) < tube.radius] = CODES[tube.label]
    walk = furniture.catwalk
    filled[(u > walk.edge) & (v > walk.bottom) & (v < walk.top)] = CODES[walk.label]
    filled[v < furniture.bed] = CODES["track bed"]
    filled[rho > TUNNEL.true_radius(alpha, s, epoch)] = CODES["lining"]
    filled[(s < 0) | (s > 130)] = len(NAMES)
    return filled


@pytest.mark.parametrize(("epoch", "chainage"), [(1, 50.0), (2, 108.0)])
def test_beams_end_where_a_walk_along_them_first_leaves_the_air(epoch, chainage):
    station, generator, step = (
        TUNNEL.alignment.points(chainage, 0.15, -0.35),
        np.random.default_rng(3),
        0.005,
    )
    azimuth, elevation = (
        generator.uniform(-np.pi, np.pi, 500),
        generator.uniform(np.deg2rad(-40), np.deg2rad(60), 500),
    )
    # along the tunnel
    azimuth[:150] = (
        generator.uniform(-0.3, 0.3, 150) + np.pi * generator.integers(0, 2, 150) + np.pi / 2
    )
    beams = np.stack(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ],
        axis=1,
    )
    back, ranges, _, codes = cast(TUNNEL, epoch, LINE, station, beams)
    codes = np.where(np.isin(codes, IN_LINING), CODES["lining"], codes)
    found, walked, left = np.full(len(back), -1), np.zeros(len(back)), np.arange(len(back))
    for at in np.arange(1.0, 20.0, step):
        filled = solid(station + at * beams[back[left]], epoch)
        met = filled >= 0
        found[left[met]], walked[left[met]] = filled[met], at
        left = left[~met]
    near = (found >= 0) & (found < len(NAMES))
    assert np.count_nonzero(near) > 400 and np.count_nonzero(near & (found != CODES["lining"])) > 70
    # the rest: corners that the steps of the walk miss
    assert np.mean(found[near] == codes[near]) > 0.99
    late = (ranges - walked)[near & (found == codes)]
    # Recesses go on behind the face; flanks of boxes are known to some mm.
    assert np.percentile(late, 1) > -step - 1e-9 and np.percentile(late, 90) < 1e-9


def test_a_straight_level_tunnel_is_open_at_both_ends():
    straight = replace(SMOOTH, alignment=Alignment(radius=1e7, grade=0.0))
    beams = np.array(
        [[0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.6, 0.8], [0.0, 1.0, -0.7] / np.hypot(1.0, 0.7)]
    )
    endless = replace(LINE, max_range=np.inf)
    back, ranges, cosines, codes = cast(straight, 1, endless, np.array([0.0, 40.0, 0.0]), beams)
    assert back.tolist() == [2, 3] and [NAMES[code] for code in codes] == ["lining", "track bed"]
    crown = straight.true_radius(0.0, 42.0, 1)
    np.testing.assert_allclose(ranges[1], 2.0 / beams[3, 2] * -1, rtol=1e-9)
    assert ranges[0] == pytest.approx(crown / 0.8, rel=1e-5) and cosines[0] == pytest.approx(
        0.8, rel=1e-3
    )


def test_track_bed_and_cabinet_hide_the_lining():
    seen = section_scan(TUNNEL, EPOCHS[0].stations, 65.0, 2_000_000)
    _, alpha, _ = section_of(seen.points[seen.codes == CODES["lining"]])
    assert np.abs(np.rad2deg(alpha)).max() < 138
    hidden = (np.rad2deg(alpha) > 64.5) & (np.rad2deg(alpha) < 75.5)
    assert not hidden.any() and np.count_nonzero(np.abs(np.rad2deg(alpha) - 55) < 5) > 5


@pytest.mark.parametrize("distance", [-2.0, 2.0, 5.0, 8.0, 11.0, 16.0, 20.0])
def test_density_of_points_falls_along_the_tunnel(distance):
    """Points in a slab of 50 mm of a ring, by a tenth of the density in ten times the slab."""
    whole_ring = {2: 24_800, 5: 5100, 8: 1560, 11: 650, 16: 210, 20: 115}[int(abs(distance))]
    setup = EPOCHS[0].stations[2]
    s = TUNNEL.alignment.section_coordinates(setup.pose.position)[0] + distance
    seen = section_scan(TUNNEL, [setup], s, 450_000, thickness=0.5)
    of_lining = np.count_nonzero(np.isin(seen.codes, IN_LINING))
    # the rest of the ring is behind bed, catwalk, cables and brackets
    assert 0.55 < of_lining / whole_ring < 0.95


def test_scanner_sees_neither_what_is_near_nor_the_crown_above_it(small):
    for epoch in small.epochs:
        for station in epoch.stations:
            assert np.linalg.norm(station.points, axis=1).min() > 1.5
            s, alpha, _ = section_of(station.pose.to_engineering(station.points))
            crown = (np.abs(alpha) < np.deg2rad(10)) & (station.codes == CODES["lining"])
            away = np.abs(s[crown] - station.setup.chainage)
            assert 1.5 < away.min() < 2.4


def test_no_section_lies_under_an_unseen_crown():
    for stations in STATIONS:
        nearest = np.min(np.abs(np.subtract.outer(SECTIONS, stations)), axis=1)
        assert 2.5 < nearest.min() and nearest.max() < 20


# --------------------------------------------------------------------------------- campaign


def test_campaign_has_six_and_four_stations_and_the_density_is_one_number(small):
    assert [len(epoch.stations) for epoch in small.epochs] == [6, 4]
    setup = small.epochs[0].stations[2].setup
    dense = scan_station(TUNNEL, setup, 4 * DENSITY)
    assert 0.9 * DENSITY < len(small.epochs[0].stations[2]) <= 1.02 * DENSITY
    assert len(dense) / len(small.epochs[0].stations[2]) == pytest.approx(4, rel=0.02)
    assert (
        "lining" in repr(dense)
        and dense.codes.dtype == np.uint8
        and dense.points.shape == (len(dense), 3)
    )


def test_same_seed_same_campaign_and_poses_do_not_depend_on_the_density(small):
    one, same, other = (survey(TUNNEL, seed) for seed in (7, 7, 8))
    for a, b in zip(one, same, strict=True):
        for p, q in zip(a.stations, b.stations, strict=True):
            np.testing.assert_array_equal(p.pose.rotation, q.pose.rotation)
            np.testing.assert_array_equal(p.targets.scanned, q.targets.scanned)
        np.testing.assert_array_equal(a.stickers.scanned, b.stickers.scanned)
    first, again, third = (
        scan_station(TUNNEL, epochs[1].stations[0], 3000) for epochs in (one, same, other)
    )
    np.testing.assert_array_equal(first.points, again.points)
    assert np.linalg.norm(first.pose.position - third.pose.position) > 1e-3
    in_study = EPOCHS[0].stations[4].pose.position
    # whatever the density
    np.testing.assert_array_equal(small.epochs[0].stations[4].pose.position, in_study)


def test_scans_are_levelled_look_along_the_tunnel_and_fit_together(small):
    for epoch in small.epochs:
        for station in epoch.stations:
            rotation = station.pose.rotation
            np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)
            assert np.linalg.det(rotation) > 0
            assert np.arccos(rotation[2, 2]) < np.deg2rad(0.03)
            assert rotation[:, 1] @ TUNNEL.alignment.tangent(station.setup.chainage) > np.cos(
                np.deg2rad(10.5)
            )
            points = station.pose.to_engineering(station.points)
            np.testing.assert_allclose(
                station.pose.to_instrument(points), station.points, atol=1e-12
            )
            lining = station.codes == CODES["lining"]
            errors = TUNNEL.distances(points[lining], epoch.number)
            # The steps between segments reach 5 mm where noise carries a point over a joint.
            assert abs(np.mean(errors)) < 1e-4 and 0.001 < np.std(errors) < 0.003


def test_noise_is_the_scanner_s():
    setup = EPOCHS[0].stations[1]
    station = scan_station(TUNNEL, setup, DENSITY)
    beams, ranges, cosines, codes = cast_beams(
        TUNNEL, setup, RIEGL_VZ400, station_grid(DENSITY).beams(slice(None))
    )
    np.testing.assert_array_equal(codes, station.codes)
    errors = station.points - ranges[:, None] * beams
    z = np.linalg.solve(RIEGL_VZ400.roots(beams, ranges, cosines), errors[:, :, None])[:, :, 0]
    assert np.abs(np.cov(z.T) - np.eye(3)).max() < 5 * np.sqrt(2 / len(z))
    assert np.abs(z.mean(axis=0)).max() < 4 / np.sqrt(len(z))
    # the range is the less certain, the more obliquely a beam meets the surface
    oblique = cosines < 0.3
    along = np.einsum("ni,ni->n", errors, beams)
    assert np.std(along[oblique]) > 1.7 * np.std(along[~oblique])


def test_targets_hold_a_registration(small):
    control, net, scan = {}, [], []
    for epoch, count in zip(small.epochs, (5, 4), strict=True):
        for station in epoch.stations:
            targets = station.targets
            assert len(targets.names) == len(set(targets.names)) == count
            across = targets.true @ TUNNEL.alignment.frame(station.setup.chainage)[0]
            assert np.ptp(across) >= 2.0
            net.append(targets.control - targets.true)
            scan.append(station.pose.to_engineering(targets.scanned) - targets.true)
            for name, point in zip(targets.names, targets.control, strict=True):
                # one net for both epochs
                np.testing.assert_array_equal(control.setdefault(name, point), point)
            # Registered by the targets, the lining is where it was within some mm.
            source, goal = targets.scanned, targets.control
            h = (source - source.mean(axis=0)).T @ (goal - goal.mean(axis=0))
            left, _, right = np.linalg.svd(h)
            rotation = right.T @ np.diag([1, 1, np.linalg.det(left @ right)]) @ left.T
            wall = np.array([[2.7, 10.0, 0.0], [-2.7, -10.0, 0.0], [0.0, 7.0, 2.7]])
            moved = (
                goal.mean(axis=0)
                + (wall - source.mean(axis=0)) @ rotation.T
                - station.pose.to_engineering(wall)
            )
            assert np.linalg.norm(moved, axis=1).max() < 0.008
    # 46 targets, some used twice: sd within 5 standard errors.
    assert np.std(np.concatenate(scan)) == pytest.approx(TARGET_SD, rel=0.3)
    assert np.std(np.concatenate(net)) == pytest.approx(NET_SD, rel=0.3)


def test_stickers_sit_on_the_lining_and_move_with_it(small):
    first, second = (epoch.stickers for epoch in small.epochs)
    for epoch in small.epochs:
        stickers = epoch.stickers
        counts = [np.count_nonzero(stickers.chainage == chainage) for chainage in SECTIONS]
        assert min(counts) >= 3 and max(counts) <= 5
        assert np.abs(TUNNEL.distances(stickers.true, epoch.number)).max() < 1e-12
        by_total_station = stickers.total_station - stickers.true
        assert 0.0003 < np.sqrt(np.mean(np.sum(by_total_station**2, axis=1))) < 0.0015
        poses = [epoch.stations[place].pose for place in stickers.station]
        by_scan = (
            np.array(
                [pose.to_engineering(p) for pose, p in zip(poses, stickers.scanned, strict=True)]
            )
            - stickers.true
        )
        assert np.std(by_scan) == pytest.approx(TARGET_SD, rel=0.3)
    for i, j in zip(
        *np.nonzero(
            np.equal.outer(first.chainage, second.chainage)
            & np.equal.outer(first.alpha, second.alpha)
        ),
        strict=True,
    ):
        moved = np.linalg.norm(second.true[j] - first.true[i])
        assert moved == pytest.approx(
            abs(TUNNEL.deformation(first.alpha[i], first.chainage[i])), abs=1e-9
        )


# ------------------------------------------------------------------------ one section alone


def test_section_is_the_slab_of_the_campaign():
    """The slab of a section has the points that a scan of the whole station has in it."""
    setup, density, chainage, thickness = EPOCHS[1].stations[2], 60_000, 65.0, 0.4
    alone = section_scan(TUNNEL, [setup], chainage, density, thickness=thickness)
    beams, ranges, _, codes = cast_beams(
        TUNNEL, setup, RIEGL_VZ400, station_grid(density).beams(slice(None))
    )
    points = setup.pose.to_engineering(ranges[:, None] * beams)
    s, _, rho = section_of(points)
    slab = (np.abs(s - chainage) <= 0.5 * thickness) & (rho > 2.6)
    near = np.hypot(*TUNNEL.alignment.section_coordinates(alone.points)[1:]) > 2.6
    assert np.count_nonzero(slab) > 100
    np.testing.assert_array_equal(alone.points[near], points[slab])
    np.testing.assert_array_equal(alone.codes[near], codes[slab])


@pytest.mark.parametrize("epoch", EPOCHS, ids=["first", "second"])
def test_a_slab_is_found_in_the_columns_that_look_at_it(monkeypatch, epoch):
    """Blocks of one column and blocks of half of the circle give equal points."""
    # up to 30 m before and behind the stations, and beside one
    chainages = (5.0, 43.0, 71.2, 105.0, 125.0)
    at_once = [
        section_scan(TUNNEL, epoch.stations, chainage, DENSITY, thickness=0.4)
        for chainage in chainages
    ]
    monkeypatch.setattr(slab, "BLOCK", len(station_grid(DENSITY).elevations))
    for section, chainage in zip(at_once, chainages, strict=True):
        by_column = section_scan(TUNNEL, epoch.stations, chainage, DENSITY, thickness=0.4)
        assert len(section) > 5
        for name in ("codes", "stations"):
            np.testing.assert_array_equal(getattr(by_column, name), getattr(section, name))
        for name in ("points", "roots"):
            np.testing.assert_allclose(
                getattr(by_column, name), getattr(section, name), rtol=0.0, atol=1e-9
            )


def test_redrawn_sections_have_the_scanner_s_noise():
    section = section_scan(TUNNEL, EPOCHS[0].stations, 45.0, 100_000)
    assert len(set(section.stations)) > 1
    clouds = section_points(section, 400, seed=1)
    z = np.linalg.solve(section.roots, (clouds - section.points)[..., None])[..., 0]
    assert abs(np.mean(z**2) - 1) < 5 * np.sqrt(2 / z.size) and abs(np.mean(z)) < 5 / np.sqrt(
        z.size
    )
    np.testing.assert_array_equal(section_points(section, 3, seed=1), clouds[:3])
    assert np.abs(section_points(section, 1, seed=2) - clouds[:1]).max() > 1e-4


def test_a_sample_of_a_section_has_the_stated_number_of_points():
    section = section_scan(TUNNEL, EPOCHS[0].stations, 45.0, 100_000)
    some, same = section.sample(40, seed=3), section.sample(40, seed=3)
    assert len(some) == 40 and section_points(some, 2, seed=0).shape == (2, 40, 3)
    np.testing.assert_array_equal(some.points, same.points)
    assert len(np.unique(some.points, axis=0)) == 40
    everyone = section.sample(len(section), seed=3)
    np.testing.assert_array_equal(everyone.points, section.points)


def test_a_section_that_no_station_sees_is_empty():
    section = section_scan(TUNNEL, EPOCHS[0].stations[:1], 125.0, 10_000)
    assert len(section) == 0 and section_points(section, 2, seed=0).shape == (2, 0, 3)


# ----------------------------------------------------------------------------------- bad input

SECTION = section_scan(TUNNEL, EPOCHS[0].stations, 45.0, 5000)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: simulate_campaign(density=50), "density: expected at least 100 beams"),
        (lambda: simulate_campaign(density=-1), "density: expected a positive"),
        (lambda: Alignment(radius=0.0), "radius: expected a positive"),
        (lambda: Lining(np.zeros((5, 4))), r"steps: expected shape \(rings, 6\), got \(5, 4\)"),
        (lambda: TUNNEL.true_radius(0.0, 5.0, 3), "epoch: expected one of 1, 2; got 3"),
        (
            lambda: section_scan(TUNNEL, (), 45.0),
            "setups: expected stations of one epoch, got those of 0",
        ),
        (
            lambda: section_scan(TUNNEL, EPOCHS[0].stations + EPOCHS[1].stations, 45.0),
            "expected stations of one epoch, got those of 2",
        ),
        (
            lambda: section_points(SECTION, 0, 1),
            "n_trials: expected a whole number of at least 1, got 0",
        ),
        (lambda: SECTION.sample(10**6, 1), "n_points: expected from 1 to the"),
    ],
)
def test_bad_input_is_refused_by_name(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_truth_cannot_be_changed():
    with pytest.raises(ValueError, match="read-only"):
        TUNNEL.lining.steps[0, 0] = 1.0
