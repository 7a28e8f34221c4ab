"""The joint adjustment: exact data give the truth, without ties and errors of the net it is the
single one, and its covariance is true.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from analysis.result import ConvergenceWarning
from analysis.similarity import fit_similarity
from analysis.tunnel import block_adjustment
from analysis.tunnel.axis import straight
from analysis.tunnel.axis_estimation import robust_axis
from analysis.tunnel.block_adjustment import adjust_block, singly
from analysis.tunnel.registration import Station
from analysis.tunnel.surface_ties import Ties, surface_ties
from studies.li_2015 import epoch_cloud, epoch_shift, register_campaign, wrong_pairs
from studies.simulation.tunnel import default_tunnel, simulate_campaign, survey
from studies.simulation.tunnel.campaign import LEVELLING_SD, NET_SD, TARGET_SD

TUNNEL = default_tunnel()
SDS = {"scanner_sd": TARGET_SD, "control_sd": NET_SD}
TIE_SD = 0.002
SECTION, DIRECTIONS = TUNNEL.alignment.position(55.0), TUNNEL.alignment.frame(55.0)[[0, 2]]


@pytest.fixture(scope="module")
def epochs():
    return survey(TUNNEL)


def setups(epochs):
    return {
        name: one
        for epoch in epochs
        for name, one in zip(register_campaign.station_names(epoch), epoch.stations, strict=True)
    }


def at_truth(epochs):
    """Stations with exact targets, registered exactly; the covariance is that of their errors."""
    stations = {}
    for name, setup in setups(epochs).items():
        source = setup.pose.to_instrument(setup.targets.true)
        true, variances = (
            setup.targets.true,
            {"source_cofactors": TARGET_SD**2, "target_cofactors": NET_SD**2},
        )
        fit = fit_similarity(source, true, scale=False, **variances, absolute=True)
        stations[name] = Station(name, setup.targets.names, source, true, fit, fit)
    return stations


def disturbed(station, shift, turn):
    """A station that is registered elsewhere, with the same targets."""
    fit = station.similarity
    fit = replace(
        fit, image=fit.image + shift, rotation=Rotation.from_rotvec(turn).as_matrix() @ fit.rotation
    )
    return replace(station, similarity=fit)


def moved(station, right, point):
    """Where the station puts a point that the right one has seen."""
    return station.similarity.transform(right.similarity.inverse().transform(point))


def ties(epochs, stations, reach=25.0):
    """Of both epochs: cells of the design cylinder that at least two stations see, as stations
    registered like this have them.
    """
    found, axis = [], TUNNEL.alignment
    s, alpha = (
        grid.ravel()
        for grid in np.meshgrid(
            np.arange(0.5, 130.0, 2.0), np.radians(np.arange(-100.0, 101.0, 20.0)), indexing="ij"
        )
    )
    points = axis.polar_points(s, alpha, TUNNEL.lining.radius)
    normals = (points - axis.position(s)) / TUNNEL.lining.radius
    truth = at_truth(epochs)
    for epoch in epochs:
        names = register_campaign.station_names(epoch)
        seen = np.abs(s[:, None] - [one.chainage for one in epoch.stations]) < reach
        seen &= np.count_nonzero(seen, axis=1, keepdims=True) >= 2
        cell, place = np.nonzero(seen)
        counts = 1 + (7 * cell + 3 * place) % 40
        station = np.array(names)[place]
        off = np.array(
            [
                moved(stations[name], truth[name], point) - point
                for name, point in zip(station, points[cell], strict=True)
            ]
        )
        radii = TUNNEL.lining.radius + np.sum(off * normals[cell], axis=-1)
        number = np.unique(cell, return_inverse=True)[1]
        found.append(Ties(station, number, points[cell], normals[cell], radii, counts))
    return found


def noisy(exact, generator):
    """The ties with errors of their standard deviation."""
    return [
        replace(
            of,
            radii=of.radii
            + TIE_SD * np.sqrt(1 / of.counts + 1 / 20) * generator.standard_normal(len(of)),
        )
        for of in exact
    ]


def test_exact_data_give_the_truth(epochs):
    generator = np.random.default_rng(1)
    truth = at_truth(epochs)
    start = {
        name: disturbed(
            one, 1e-3 * generator.standard_normal(3), 2e-4 * generator.standard_normal(3)
        )
        for name, one in truth.items()
    }
    for of, level in [((), None), (ties(epochs, start), None)]:
        block = adjust_block(start, of, **SDS, level_sd=level)
        assert block.converged and block.sigma_0 < 0.01
        for name, station in block.stations.items():
            found, right = station.similarity, truth[name].similarity
            np.testing.assert_allclose(found.image, right.image, atol=5e-6)
            assert Rotation.from_matrix(found.rotation @ right.rotation.T).magnitude() < 1e-6
            np.testing.assert_allclose(found.residuals, 0.0, atol=2e-5)


def test_without_ties_and_with_an_exact_net_it_is_the_single_registration(epochs):
    generator = np.random.default_rng(2)
    stations = {}
    for name, one in at_truth(epochs).items():
        source = one.source + TARGET_SD * generator.standard_normal(one.source.shape)
        fit = fit_similarity(
            source, one.target, scale=False, source_cofactors=TARGET_SD**2, absolute=True
        )
        stations[name] = Station(name, one.targets, source, one.target, fit, fit)
    block, alone = adjust_block(stations, scanner_sd=TARGET_SD, control_sd=1e-8), singly(stations)
    # Gauss-Helmert takes the derivatives at the adjusted points: a millimetre and a half at two
    # metres.
    np.testing.assert_allclose(block.covariance, alone.covariance, rtol=3e-3, atol=2e-11)
    for name, station in block.stations.items():
        np.testing.assert_allclose(
            station.similarity.image, stations[name].similarity.image, atol=1e-8
        )
        np.testing.assert_allclose(
            station.similarity.rotation, stations[name].similarity.rotation, atol=1e-9
        )


def draw(truth, generator):
    """One campaign's errors: the stations, still at their true poses, with targets, net and levels
    that are off.
    """
    names = sorted({name for one in truth.values() for name in one.targets})
    net = dict(zip(names, NET_SD * generator.standard_normal((len(names), 3)), strict=True))
    drawn = {}
    for name, one in truth.items():
        source = one.source + TARGET_SD * generator.standard_normal(one.source.shape)
        drawn[name] = replace(
            one, source=source, target=one.target + [net[target] for target in one.targets]
        )
    return drawn


def test_covariance_is_that_of_repeated_campaigns(epochs):
    """Also that of the shift of a section between the epochs."""
    generator, truth, trials = np.random.default_rng(3), at_truth(epochs), 400
    A = np.zeros((2, 20))
    A[:, 4:6], A[:, 14:16] = -np.eye(2), np.eye(2)  # stations 1.3 and 2.2
    exact, errors, shifts, squares = ties(epochs, truth), [], [], []
    for _ in range(trials):
        block = adjust_block(draw(truth, generator), noisy(exact, generator), **SDS)
        corrected = np.concatenate(
            [registration_error(block.stations[name], truth[name]) for name in truth]
        )
        errors.append(corrected)
        shifts.append(
            A
            @ np.concatenate(
                [
                    DIRECTIONS @ (moved(block.stations[name], truth[name], SECTION) - SECTION)
                    for name in truth
                ]
            )
        )
        squares.append(corrected @ np.linalg.solve(block.covariance, corrected))
    sd = np.sqrt(np.diagonal(block.covariance))
    # A standard deviation from 400 trials is known to 3.5 %: root mean square over 60 of them,
    # which hang together, and the largest.
    ratio = np.std(errors, axis=0) / sd - 1
    assert np.sqrt(np.mean(ratio**2)) < 0.05 and np.abs(ratio).max() < 0.15
    np.testing.assert_allclose(
        np.cov(np.array(shifts).T),
        A @ block.shifts(SECTION, DIRECTIONS) @ A.T,
        rtol=0.15,
        atol=5e-8,
    )
    assert abs(np.mean(squares) / 60 - 1) < 0.04
    assert abs(block.tie_sd / TIE_SD - 1) < 0.1 and np.mean(block.tie_weights > 0) > 0.99


def registration_error(found, right):
    turn = Rotation.from_matrix(found.similarity.rotation @ right.similarity.rotation.T).as_rotvec()
    return np.append(found.similarity.image - right.similarity.image, turn)


def relative(block):
    """Covariance of the shift between stations 1.3 and 2.2 at a section that both see."""
    A = np.zeros((2, 20))
    A[:, 4:6], A[:, 14:16] = -np.eye(2), np.eye(2)
    return A @ block.shifts(SECTION, DIRECTIONS) @ A.T


def test_ties_and_levels_make_the_epochs_agree_better(epochs):
    truth = at_truth(epochs)
    found = [
        singly(truth),
        adjust_block(truth, **SDS),
        adjust_block(truth, ties(epochs, truth), **SDS),
    ]
    found.append(adjust_block(truth, ties(epochs, truth), **SDS, level_sd=LEVELLING_SD))
    alone, net, tied, levelled = (np.sqrt(np.diagonal(relative(block))) for block in found)
    assert (net < alone).all()  # two targets are common to both stations
    assert (tied < 0.7 * net).all() and (levelled < tied).all()


def test_the_order_of_exact_ties_does_not_matter_to_the_covariance(epochs):
    """Sums in another order differ in their last bits, and so do those of other processors."""
    truth = at_truth(epochs)
    exact = ties(epochs, truth)
    turned = [Ties(*(getattr(of, name)[::-1] for name in of.__dataclass_fields__)) for of in exact]
    there, back = (adjust_block(truth, of, **SDS, level_sd=LEVELLING_SD) for of in (exact, turned))
    np.testing.assert_allclose(relative(back), relative(there), rtol=1e-6, atol=1e-14)


def test_an_error_of_the_net_that_both_epochs_share_is_in_no_difference(epochs):
    """With stations and targets of the first epoch again the net may be as wrong as it likes."""
    first = at_truth(epochs[:1])
    both = first | {
        f"2{name[1:]}": replace(one, name=f"2{name[1:]}") for name, one in first.items()
    }
    point, wrong = (
        TUNNEL.alignment.position(50.0),
        0.01 * np.random.default_rng(4).standard_normal((60, 3)),
    )
    spoilt = {
        name: replace(one, target=one.target + [wrong[int(target[1:])] for target in one.targets])
        for name, one in both.items()
    }
    block = adjust_block(spoilt, **SDS)
    shifts = [
        one.similarity.transform(one.similarity.inverse().transform(point))
        for one in block.stations.values()
    ]
    np.testing.assert_allclose(shifts[:6], shifts[6:], atol=1e-12)
    images = np.array([one.similarity.image for one in block.stations.values()])
    assert np.abs(images[:6] - [one.similarity.image for one in first.values()]).max() > 0.003
    np.testing.assert_allclose(images[:6], images[6:], atol=1e-9)
    difference = np.kron([[-1.0, 1.0]], np.kron(np.eye(6), np.eye(2)))
    with_net, exact = (
        difference
        @ adjust_block(both, scanner_sd=TARGET_SD, control_sd=sd).shifts(point, DIRECTIONS)
        @ difference.T
        for sd in (0.05, 1e-7)
    )
    np.testing.assert_allclose(with_net, exact, rtol=0.02, atol=2e-9)


def test_a_level_holds_the_inclination(epochs):
    truth = at_truth(epochs)
    plumb = {}
    for name, one in truth.items():
        R = Rotation.from_euler("z", np.arctan2(*one.similarity.rotation[:2, 1])).as_matrix().T
        fit = one.similarity
        plumb[name] = replace(
            one,
            similarity=replace(fit, rotation=R),
            source=(one.target - fit.image) @ R + fit.centre,
        )
    tilted = {
        name: disturbed(one, np.zeros(3), np.array([1e-3, -2e-3, 0.0]))
        for name, one in plumb.items()
    }
    block = adjust_block(tilted, scanner_sd=1.0, control_sd=1.0, level_sd=1e-6)
    for station in block.stations.values():
        np.testing.assert_allclose(station.similarity.rotation[:2, 2], 0.0, atol=1e-5)
    block = adjust_block(plumb, scanner_sd=1.0, control_sd=1.0, level_sd=1e-6)
    np.testing.assert_allclose(
        np.sqrt(np.diagonal(block.covariance).reshape(10, 6)[:, 3:5]), 1e-6, rtol=0.01
    )


def test_a_bad_tie_loses_its_weight(epochs):
    truth = at_truth(epochs)
    generator = np.random.default_rng(5)
    first, second = noisy(ties(epochs, truth), generator)
    bad = generator.permutation(len(first))[:20]
    radii = first.radii.copy()
    radii[bad] -= 0.05
    good, spoilt = (
        adjust_block(truth, [replace(first, radii=values), second], **SDS)
        for values in (first.radii, radii)
    )
    assert np.all(spoilt.tie_weights[bad] == 0)
    for name in truth:
        np.testing.assert_allclose(
            spoilt.stations[name].similarity.image,
            good.stations[name].similarity.image,
            atol=1.5e-4,
        )


def test_a_wrong_pair_stays_out(epochs):
    """It is named by the single registration, and the joint one does not know it any more."""
    observed, net = (
        register_campaign.observed_targets(epochs[0]),
        register_campaign.control_net(*epochs),
    )
    wrong = wrong_pairs.mistake(observed, "1.3", "T17", "T15")
    stations = register_campaign.register_observed(wrong, net)
    assert stations["1.3"].rejected == ("T15",)
    block = adjust_block(stations, **SDS)
    without = register_campaign.register_observed(
        observed[~((observed["station"] == "1.3") & (observed["target"] == "T17"))], net
    )
    expected = adjust_block(without, **SDS)
    np.testing.assert_allclose(
        block.stations["1.3"].similarity.translation,
        expected.stations["1.3"].similarity.translation,
        atol=1e-6,
    )
    assert block.stations["1.3"].rejected == ("T15",) and block.sigma_0 < 1.6


# ------------------------------------------------------------------------------------ from scans


def standing(**places):
    """Registered stations whose frames are that of the project but for their place along the
    tunnel.
    """
    x = np.array([[2.0, 1.0, 0.0], [-2.0, 1.0, 0.0], [0.0, 9.0, 0.0], [0.0, 5.0, 2.0]])
    fits = {
        name: fit_similarity(
            x, x + [0, y, 0], scale=False, target_cofactors=NET_SD**2, absolute=True
        )
        for name, y in places.items()
    }
    return {
        name: Station(name, tuple("abcd"), x, x + [0, places[name], 0], fit, fit)
        for name, fit in fits.items()
    }


def tube(generator, n, start, end, radius=2.7):
    angle, y = generator.uniform(-2.3, 2.3, n), generator.uniform(start, end, n)
    return np.column_stack([radius * np.sin(angle), y, radius * np.cos(angle)])


def test_ties_are_the_differences_of_radii():
    generator, axis = np.random.default_rng(6), straight(np.zeros(3), np.array([0.0, 20.0, 0.0]))
    first, second = tube(generator, 60_000, 0.0, 12.0), tube(generator, 30_000, 8.0, 20.0)
    shift = np.array([0.004, 0.0, -0.003])
    stations = standing(A=5.0, B=15.0)
    found = surface_ties(stations, {"A": first - [0, 5, 0], "B": second + shift - [0, 15, 0]}, axis)
    assert set(found.stations) == {"A", "B"} and np.all(np.bincount(found.cells) == 2)
    assert found.points[:, 1].min() > 8.0 and found.points[:, 1].max() < 12.0
    np.testing.assert_allclose(
        np.linalg.norm(found.points[:, [0, 2]], axis=-1), found.radii, atol=1e-9
    )
    a, b = (found.stations == name for name in "AB")
    np.testing.assert_allclose(found.radii[a], 2.7, atol=1e-9)
    apart = found.radii[b] - found.radii[a] - found.normals[a] @ shift
    # a shift is not the same all over a cell
    assert np.abs(apart).max() < 5e-4 and abs(apart.mean()) < 2e-5
    assert found.counts.sum() <= len(first) + len(second) and found.counts.min() >= 1


def test_attachments_are_left_out():
    generator, axis = np.random.default_rng(7), straight(np.zeros(3), np.array([0.0, 10.0, 0.0]))
    clean, other = tube(generator, 40_000, 0.0, 10.0), tube(generator, 40_000, 0.0, 10.0)
    near, far = tube(generator, 4000, 0.0, 10.0, 2.67), tube(generator, 4000, 0.0, 10.0, 2.5)
    found = surface_ties(
        standing(A=0.0, B=0.0), {"A": np.concatenate([clean, near, far]), "B": other}, axis
    )
    np.testing.assert_allclose(found.radii, 2.7, atol=1e-9)


def test_what_is_seen_too_obliquely_is_left_out():
    """83° are tan 83° · 2.7 m = 22 m along the tunnel."""
    generator, axis = np.random.default_rng(9), straight(np.zeros(3), np.array([0.0, 66.0, 0.0]))
    points = tube(generator, 200_000, 0.0, 66.0)
    places = {"A": 0.0, "B": 30.0, "C": 66.0}
    found = surface_ties(
        standing(**places), {name: points - [0, y, 0] for name, y in places.items()}, axis
    )
    for name, place in places.items():
        y = found.points[found.stations == name][:, 1]
        assert np.abs(y - place).max() < 22.0 < np.abs(y - place).max() + 0.3
    assert np.all(np.bincount(found.cells) == 2)


@pytest.mark.parametrize("seed", [1, 4])
def test_a_scanned_campaign(seed):
    """True errors agree with what is stated, station by station and between the epochs."""
    scans = simulate_campaign(30_000, seed, tunnel=TUNNEL)
    single = tuple(register_campaign.register(epoch) for epoch in scans.epochs)
    clouds = tuple(
        epoch_cloud.join_scans(epoch, found)
        for epoch, found in zip(scans.epochs, single, strict=True)
    )
    joint = register_campaign.adjust(scans.epochs, single, robust_axis(clouds[0].points))
    errors = epoch_shift.parameter_errors(joint, scans.epochs)
    # Ties of neighbouring cells are not quite independent: what they alone determine is stated a
    # little too well.
    assert joint.converged and errors @ np.linalg.solve(joint.covariance, errors) < 1.3 * chi2.isf(
        0.01, 60
    )
    alone = singly({name: station for found in single for name, station in found.items()})
    lining = tuple(cloud.part(cloud.of("lining")) for cloud in clouds)
    table = epoch_shift.shifts(
        {"single": alone, "joint": joint}, lining, scans.epochs, TUNNEL
    ).set_index("registration")
    assert len(table) == 26 and table["chi_squared"].max() < 14
    summary = epoch_shift.summary(table.reset_index())
    assert summary["sections"].tolist() == ["all", "flagged"] * 2
    flagged = table.loc["joint"].iloc[4:7]  # 45, 55 and 65 m
    assert summary["up_mm"][3] == pytest.approx(np.sqrt(np.mean(flagged["up_mm"] ** 2)))
    assert summary["chi_squared"][2] == pytest.approx(table.loc["joint", "chi_squared"].mean())
    stated = table.groupby(level=0)[["right_sd_mm", "up_sd_mm"]].mean()
    assert (stated.loc["joint"] < 0.75 * stated.loc["single"]).all()
    np.testing.assert_allclose(
        table.loc["joint", ["right_mm", "up_mm"]].to_numpy()[6],
        between(joint, scans, lining, 65.0),
        atol=2e-3,
    )


def between(block, scans, clouds, at):
    """Shift of a section between the epochs from points of the stations at their true and at their
    registered places, mm.
    """
    point, directions, means = TUNNEL.alignment.position(at), TUNNEL.alignment.frame(at)[[0, 2]], []
    for epoch, cloud in zip(scans.epochs, clouds, strict=True):
        near = np.abs(TUNNEL.alignment.section_coordinates(cloud.points)[0] - at) <= 0.25
        stations = [
            block.stations[name].similarity for name in register_campaign.station_names(epoch)
        ]
        shifts = [
            fit.transform(one.pose.to_instrument(point)) - point
            for fit, one in zip(stations, epoch.stations, strict=True)
        ]
        means.append(np.mean(np.array(shifts)[cloud.stations[near]], axis=0))
    return 1e3 * directions @ (means[1] - means[0])


# -------------------------------------------------------------------------------------- bad input


def test_bad_input_is_refused(epochs):
    truth = at_truth(epochs)
    with pytest.raises(ValueError, match="stations: expected at least one, got none"):
        adjust_block({}, **SDS)
    with pytest.raises(ValueError, match="control_sd: expected"):
        adjust_block(truth, scanner_sd=0.001, control_sd=0.0)
    with pytest.raises(ValueError, match="level_sd: expected"):
        adjust_block(truth, **SDS, level_sd=-1.0)
    one = truth["1.1"]
    free = fit_similarity(one.source, one.target, target_cofactors=NET_SD**2, absolute=True)
    with pytest.raises(
        ValueError, match=r"station 1\.1: expected variances in m² and a scale held at 1"
    ):
        adjust_block(truth | {"1.1": replace(one, similarity=free)}, **SDS)
    with pytest.raises(
        ValueError, match=r"station 2\.2: expected one place for target T\d+ at all stations"
    ):
        adjust_block(
            truth | {"2.2": replace(truth["2.2"], target=truth["2.2"].target + 0.1)}, **SDS
        )
    with pytest.raises(ValueError, match=r"ties: expected those of the stations 1\.1.*, got 2\.1"):
        adjust_block(at_truth(epochs[:1]), ties(epochs, truth), **SDS)
    alone = replace(ties(epochs, truth)[0], cells=np.arange(len(ties(epochs, truth)[0])))
    with pytest.raises(ValueError, match="ties: expected at least two stations in every cell"):
        adjust_block(truth, [alone], **SDS)
    stations, axis = standing(A=0.0, B=5.0), straight(np.zeros(3), np.array([0.0, 20.0, 0.0]))
    for scans, message in [
        ({"A": np.ones((10, 3))}, "scans: expected at least 2 stations of an epoch, got 1"),
        (
            {"A": np.ones((10, 3)), "C": np.ones((10, 3))},
            "scans: expected those of registered stations, got C",
        ),
        ({"A": np.full((10, 3), np.nan), "B": np.ones((10, 3))}, "points: expected finite numbers"),
        ({"A": np.ones((10, 2)), "B": np.ones((10, 3))}, "points: expected shape"),
    ]:
        with pytest.raises(ValueError, match=message):
            surface_ties(stations, scans, axis)


def test_no_convergence_is_told(epochs, monkeypatch):
    monkeypatch.setattr(block_adjustment, "MAX_STEPS", 1)
    generator, truth = np.random.default_rng(8), at_truth(epochs)
    with pytest.warns(ConvergenceWarning, match="not converged: corrections still change by"):
        block = adjust_block(draw(truth, generator), noisy(ties(epochs, truth), generator), **SDS)
    assert not block.converged and block.iterations == 1
