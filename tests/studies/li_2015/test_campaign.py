"""The studies of a simulated campaign: exact measurements leave no error, a known error reappears,
and stated accuracies hold.
"""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from analysis.tunnel.axis import straight
from analysis.tunnel.filter import INSIDE, LINING, FilteredLining
from analysis.tunnel.registration import register_stations
from analysis.tunnel.sections import Radii, cut, local_radii
from studies.li_2015 import (
    axis_accuracy,
    campaign_contents,
    filter_accuracy,
    registration_accuracy,
    section_density,
    sticker_accuracy,
    wrong_pairs,
)
from studies.li_2015.epoch_cloud import EpochCloud, join_scans
from studies.li_2015.register_campaign import control_net, observed_targets, register, station_names
from studies.simulation.tunnel import (
    ATTACHMENTS,
    CODES,
    SECTIONS,
    ZONE,
    Alignment,
    Lining,
    Tunnel,
    default_tunnel,
    simulate_campaign,
    survey,
)
from studies.simulation.tunnel.campaign import station_grid

TUNNEL = default_tunnel()
DENSITY = 3000


@pytest.fixture(scope="module")
def scans():
    return simulate_campaign(DENSITY)


@pytest.fixture(scope="module")
def surveyed():
    return survey(TUNNEL)


def exact(epoch):
    """The epoch with targets and stickers measured without error; each keeps the errors of the
    control net and of the total station.
    """
    stations = tuple(
        replace(
            one, targets=replace(one.targets, scanned=one.pose.to_instrument(one.targets.control))
        )
        for one in epoch.stations
    )
    found = epoch.stickers
    poses = [epoch.stations[place].pose for place in found.station]
    scanned = np.array(
        [pose.to_instrument(point) for pose, point in zip(poses, found.total_station, strict=True)]
    )
    return replace(epoch, stations=stations, stickers=replace(found, scanned=scanned))


def moved(epoch, place, shift):
    """The epoch whose station has come to stand elsewhere, unknown to those who measured its
    targets.
    """
    stations = list(epoch.stations)
    pose = stations[place].pose
    stations[place] = replace(stations[place], pose=replace(pose, position=pose.position + shift))
    return replace(epoch, stations=tuple(stations))


# ------------------------------------------------------------------------------ the campaign


def test_joined_scans_lie_where_they_were_taken(scans):
    epoch = scans.epochs[0]
    cloud = join_scans(epoch, register(epoch))
    true = join_scans(epoch).points
    assert np.array_equal(
        true[: len(epoch.stations[0])],
        epoch.stations[0].pose.to_engineering(epoch.stations[0].points),
    )
    assert len(cloud) == sum(map(len, epoch.stations))
    assert 0 < np.linalg.norm(cloud.points - true, axis=-1).max() < 0.05
    assert np.array_equal(np.bincount(cloud.stations), [len(one) for one in epoch.stations])


def test_exact_targets_join_exactly(scans):
    epoch = scans.epochs[1]
    stations = tuple(
        replace(
            one,
            setup=replace(
                one.setup,
                targets=replace(one.targets, scanned=one.pose.to_instrument(one.targets.control)),
            ),
        )
        for one in epoch.stations
    )
    epoch = replace(epoch, stations=stations)
    assert (
        np.abs(join_scans(epoch, register(epoch)).points - join_scans(epoch).points).max() < 1e-10
    )


def test_parts_of_a_cloud(scans):
    epoch = scans.epochs[0]
    cloud = join_scans(epoch, register(epoch))
    part = cloud.part(cloud.between(TUNNEL, *ZONE))
    chainage = TUNNEL.alignment.section_coordinates(part.points)[0]
    assert ZONE[0] <= chainage.min() and chainage.max() <= ZONE[1] and 0 < len(part) < len(cloud)
    assert set(cloud.part(cloud.of("lining", "cable")).codes) == {CODES["lining"], CODES["cable"]}
    attached = cloud.attachments(TUNNEL, 1)
    depth = -TUNNEL.distances(cloud.points, 1)
    of_one = np.isin(cloud.codes, [CODES[name] for name in ATTACHMENTS])
    assert np.array_equal(attached, of_one & (depth >= 0.02)) and 0 < attached.sum() < of_one.sum()


def test_tables_of_the_campaign(scans):
    shares = campaign_contents.label_shares(scans)
    assert shares[["epoch_1_percent", "epoch_2_percent"]].sum().tolist() == pytest.approx(
        [100, 100]
    )
    assert set(shares["label"][shares["attachment"] == "yes"]) == set(ATTACHMENTS)
    points = campaign_contents.station_points(scans)
    assert points["station"].tolist() == station_names(scans.epochs[0]) + station_names(
        scans.epochs[1]
    )
    assert points["targets"].tolist() == 6 * [5] + 4 * [4]
    assert points["points"].sum() == sum(
        len(one) for epoch in scans.epochs for one in epoch.stations
    )


def test_control_net_and_observations(surveyed):
    net, observed = control_net(*surveyed), observed_targets(surveyed[0])
    assert net["target"].is_unique and set(observed["target"]) <= set(net["target"])
    station = surveyed[1].stations[2]
    found = net.set_index("target").loc[list(station.targets.names)]
    assert np.array_equal(found.to_numpy(), station.targets.control)
    assert np.array_equal(
        observed.loc[observed["station"] == "1.2", ["x", "y", "z"]],
        surveyed[0].stations[1].targets.scanned,
    )


# ------------------------------------------------------------------------------ registration


def test_three_solutions_are_one(surveyed):
    for epoch in surveyed:
        table = registration_accuracy.solutions(register(epoch))
        assert table["printed_less_svd"].max() < 1e-12 and table["adjusted_less_svd"].max() < 1e-12
        # The scale μ moves what is 10 m away by 10 m (μ − 1), and a little more or less by the
        # targets' own distance.
        assert np.all(table["scale_moves_mm"] < 0.02 * table["scale_printed_ppm"].abs() + 1e-6)
        assert table["scale_moves_mm"].max() > 0.5


def test_exact_targets_have_no_errors(surveyed):
    epoch = exact(surveyed[0])
    table = registration_accuracy.true_errors(register(epoch), epoch, TUNNEL)
    assert (
        table[["position_mm", "rotation_arcsec", "wall_mm", "chi_squared"]].to_numpy().max() < 1e-6
    )
    assert registration_accuracy.solutions(register(epoch))["scale_moves_mm"].max() < 1e-9


def test_a_moved_station_is_off_by_its_movement(surveyed):
    epoch = exact(surveyed[0])
    shift = np.array([0.003, -0.001, 0.002])
    table = registration_accuracy.true_errors(register(epoch), moved(epoch, 3, shift), TUNNEL)
    assert table["position_mm"].tolist() == pytest.approx(
        [0, 0, 0, 1e3 * np.linalg.norm(shift), 0, 0], abs=1e-6
    )
    assert table["rotation_arcsec"].max() < 1e-6 and table["wall_mm"].iloc[3] > 1


def test_stated_covariances_hold_in_other_campaigns():
    squares = np.concatenate(
        [
            registration_accuracy.true_errors(register(epoch), epoch, TUNNEL)["chi_squared"]
            for seed in range(6)
            for epoch in survey(TUNNEL, seed)
        ]
    )
    assert abs(squares.mean() - 6) < 4 * np.sqrt(12 / len(squares))


@pytest.mark.parametrize("robust", [False, True])
def test_stated_standard_deviations_are_right_to_3_percent(surveyed, robust):
    table = registration_accuracy.repetition(surveyed[0].stations[2], 15_000, 3, robust=robust)
    assert table["ratio_percent"].abs().max() < 3
    assert table["quantity"].tolist()[:2] == ["position x", "position y"]
    assert table["converged_percent"].iloc[0] > 99.5


def test_every_wrong_pair_is_named(surveyed):
    found = wrong_pairs.every_mistake(*surveyed)
    assert len(found) == 6 * 5 + 4 * 4 and found["named"].all()
    assert found["moved_mm"].max() < 5 and found["moved_by_least_squares_mm"].min() > 100
    summary = wrong_pairs.summary(found)
    assert summary["targets"].tolist() == [4, 5] and summary["mistakes"].sum() == len(found)


def test_six_targets_of_which_one_is_wrong(surveyed):
    net = control_net(*surveyed)
    pose = surveyed[0].stations[2].pose
    six = net.iloc[[10, 11, 13, 14, 16, 17]]
    noise = 0.0015 * np.random.default_rng(1).standard_normal((6, 3))
    observed = pd.DataFrame(
        pose.to_instrument(six[["x", "y", "z"]].to_numpy()) + noise, columns=list("xyz")
    )
    observed = observed.assign(station="1.3", target=six["target"].to_numpy())
    other = net["target"].iloc[12]
    for target in six["target"]:
        wrong = wrong_pairs.mistake(observed, "1.3", target, other)
        assert (wrong["target"] == other).sum() == 1
        assert register_stations(wrong, net, scanner_sd=0.0015, control_sd=0.001)[
            "1.3"
        ].rejected == (other,)
    with pytest.raises(ValueError, match="station 1.3 has observed, got T99"):
        wrong_pairs.mistake(observed, "1.3", "T99", other)


# ---------------------------------------------------------------------------------- accuracy


def test_exact_stickers_agree(surveyed):
    epoch = exact(surveyed[0])
    differences = sticker_accuracy.differences(epoch, register(epoch))
    assert np.abs(differences[["dx_mm", "dy_mm", "dz_mm"]].to_numpy()).max() < 1e-6
    assert sorted(differences["chainage_m"].unique()) == list(SECTIONS)
    assert sticker_accuracy.accuracy(differences)["m_mm"].max() < 1e-6


def synthetic(common, rng=5):
    generator = np.random.default_rng(rng)
    offsets = common * generator.standard_normal((8, 1, 3)) + generator.standard_normal((8, 10, 3))
    frame = pd.DataFrame(offsets.reshape(-1, 3), columns=["dx_mm", "dy_mm", "dz_mm"])
    return frame.assign(station=np.repeat(list("abcdefgh"), 10))


def test_f_ratio_sees_what_stickers_of_a_station_share():
    alone, shared = (sticker_accuracy.station_means(synthetic(common)) for common in (0.0, 1.0))
    assert 0.4 < alone["f_ratio"].iloc[0] < 1.9 and shared["f_ratio"].iloc[0] > 5
    assert shared["n"].tolist() == 8 * [10]
    rows = synthetic(1.0)
    assert shared["mean_dx_mm"].iloc[2] == pytest.approx(
        rows.loc[rows["station"] == "c", "dx_mm"].mean()
    )


def test_f_ratio_is_that_of_the_variance_analysis():
    from scipy.stats import f_oneway

    rows = synthetic(0.5)[["dx_mm", "station"]].assign(dy_mm=0.0, dz_mm=0.0)
    expected = f_oneway(*(group["dx_mm"] for _, group in rows.groupby("station"))).statistic
    assert sticker_accuracy.station_means(rows)["f_ratio"].iloc[0] == pytest.approx(expected)


def test_joints_show_a_moved_station(surveyed):
    epoch = exact(surveyed[0])
    stations = register(epoch)
    assert registration_accuracy.joints(epoch, stations, TUNNEL)["rms_mm"].max() < 1e-6
    table = registration_accuracy.joints(moved(epoch, 2, [0.003, 0.0, 0.0]), stations, TUNNEL)
    assert table["rms_mm"].tolist() == pytest.approx([0, 3, 3, 0, 0], abs=1e-2)
    assert table["within_percent"].tolist() == [100, 0, 0, 100, 100]
    # Its points come out 3 mm too far to the left: as the second of a pair, and as the first.
    assert table["shift_x_mm"].tolist() == pytest.approx([0, -3, 3, 0, 0], abs=1e-2)
    assert table["stations"].iloc[1] == "1.2, 1.3" and table["stated_mm"].between(2, 5).all()


def test_limit_rejects_a_true_6_mm_in_95_percent():
    errors = 6 / np.sqrt(3) * np.random.default_rng(2).standard_normal((20_000, 10, 3))
    m = np.sqrt(np.sum(np.mean(errors**2, axis=1), axis=-1))
    assert np.mean(m < sticker_accuracy.limit_for(10)) == pytest.approx(0.05, abs=0.006)


# -------------------------------------------------------------------------------------- axis


def test_axis_error_is_the_offset():
    tunnel = Tunnel(Alignment(radius=1e9, grade=0.01), Lining(np.zeros((109, 6))))
    frame, ends = tunnel.alignment.frame(65.0), tunnel.alignment.position(np.array([0.0, 130.0]))
    shifted = straight(*(ends + 0.02 * frame[0] - 0.05 * frame[2]))
    error = axis_accuracy.axis_error(shifted, tunnel, 10, 120)
    assert (error["mean_u_mm"], error["mean_v_mm"]) == pytest.approx((20, -50), abs=0.01)
    assert max(error["largest_u_mm"], error["largest_v_mm"], error["largest_mrad"]) < 0.01
    turned = straight(ends[0], ends[1] + 0.13 * frame[0])
    assert axis_accuracy.axis_error(turned, tunnel, 10, 120)["largest_mrad"] == pytest.approx(
        1.0, abs=1e-3
    )


def test_hazards_of_the_printed_axis():
    table = axis_accuracy.hazards(TUNNEL, 150_000, 4).set_index("cause")
    a, b = TUNNEL.lining.semi_axes(np.linspace(*ZONE, 50), 1)
    assert table.loc["nothing"].drop("length_m").abs().max() < 2
    assert table.loc["the track bed", "mean_v_mm"] == pytest.approx(
        500 * (b.mean() + TUNNEL.furniture.bed), abs=3
    )
    assert abs(table.loc["the track bed", "mean_u_mm"]) < 1
    # the wall just beside the tray is now the extreme one
    tray = 500 * a.mean() * (1 - np.cos(axis_accuracy.TRAY[0]))
    assert table.loc["a wide cable tray", "mean_u_mm"] == pytest.approx(tray, abs=5)
    assert table.loc["ends cut askew", "largest_u_mm"] > 20
    # A quadratic departs from the arc of 130 m by up to 3.5 mm, most at its ends and in the middle.
    assert 1.5 < table.loc["the whole tunnel", ["mean_u_mm", "largest_u_mm"]].abs().sum() < 6
    assert table.loc["all of these", "mean_u_mm"] > 10


# ------------------------------------------------------------------------------------ filter


def perfect_cloud(epoch, n, seed):
    """Lining points of the zone without noise, and a few cables."""
    generator = np.random.default_rng(seed)
    chainage, alpha = generator.uniform(*ZONE, n), generator.uniform(-2.2, 2.2, n)
    codes = np.where(np.arange(n) % 10, CODES["lining"], CODES["cable"])
    rho = TUNNEL.true_radius(alpha, chainage, epoch) - 0.1 * (codes == CODES["cable"])
    return EpochCloud(
        TUNNEL.alignment.polar_points(chainage, alpha, rho), codes, np.zeros(n, dtype=int)
    )


def flagged(flags):
    nothing = np.full(len(flags), np.nan)
    return FilteredLining(flags, nothing, nothing, np.zeros(len(flags), dtype=int), ())


@pytest.fixture(scope="module")
def perfect():
    return tuple(perfect_cloud(epoch, 60_000, epoch) for epoch in (1, 2))


def test_effects_count_what_is_found_and_lost(perfect):
    right = [
        flagged(np.where(cloud.of("cable"), INSIDE, LINING).astype(np.int8)) for cloud in perfect
    ]
    blind = [flagged(np.zeros(len(cloud), dtype=np.int8)) for cloud in perfect]
    table = filter_accuracy.effects(perfect, {"right": right, "blind": blind}, TUNNEL).set_index(
        ["rule", "epoch"]
    )
    assert table.loc[("right", 1), ["found_percent", "lost_percent"]].tolist() == [100, 0]
    assert table.loc[("blind", 2), ["found_percent", "lost_percent"]].tolist() == [0, 0]
    assert table.loc[("right", 2), "kept_of_all_percent"] == pytest.approx(90)
    assert table.loc[("right", 1), "attachments"] == 6000


def test_cells_show_the_deformation_that_a_filter_takes_off(perfect):
    right, eaten, emptied = [], [], []
    for cloud in perfect:
        good = cloud.of("lining")
        chainage, u, v = TUNNEL.alignment.section_coordinates(cloud.points)
        alpha = np.arctan2(u, v)
        crown = (np.abs(alpha) < 0.3) & (np.abs(chainage - 65) < 3)
        inner = crown & (np.hypot(u, v) < np.median(np.hypot(u, v)[crown & good]))
        for kept, results in ((good, right), (good & ~inner, eaten), (good & ~crown, emptied)):
            results.append(flagged(np.where(kept, LINING, INSIDE).astype(np.int8)))
    rules = {"right": right, "eaten": [right[0], eaten[1]], "emptied": [right[0], emptied[1]]}
    table = filter_accuracy.cells(perfect, rules, TUNNEL)
    of = dict(iter(table.groupby("rule")))
    assert of["right"]["change_mm"].abs().max() == 0 and of["right"]["kept_percent"].min() == 100
    # Means of two clouds differ from the mean of the difference by the lining's own steps, which
    # points sample.
    assert np.abs(of["right"]["before_mm"] - of["right"]["true_mm"]).max() < 1.5
    assert of["eaten"]["change_mm"].max() > 0.2 and of["eaten"]["kept_percent"].min() < 80
    summary = filter_accuracy.summary(table).set_index("rule")
    assert summary.loc["right", "emptied"] == 0 < summary.loc["emptied", "emptied"]
    assert summary.loc["eaten", "largest_change_mm"] == of["eaten"]["change_mm"].abs().max()


# ---------------------------------------------------------------------------------- sections


@pytest.mark.parametrize("distance", [3.0, 6.0, 12.0])
def test_ring_points_are_those_of_the_beams(distance):
    grid = station_grid(400_000)
    beams = np.concatenate([grid.beams(slice(k, k + 50_000)) for k in range(0, len(grid), 50_000)])
    y = 2.7 * beams[:, 1] / np.hypot(beams[:, 0], beams[:, 2])
    counted = np.count_nonzero(np.abs(np.abs(y) - distance) < 0.25) / 2
    assert section_density.ring_points(distance, len(grid), thickness=0.5) == pytest.approx(
        counted, rel=0.03
    )


def test_sections_are_counted_where_they_are(scans):
    clouds = tuple(cloud.part(cloud.of("lining")) for cloud in map(join_scans, scans.epochs))
    setups = [[one.setup for one in epoch.stations] for epoch in scans.epochs]
    axis = straight(*TUNNEL.alignment.position(np.array([50.0, 60.0])))
    table = section_density.section_counts(clouds, setups, axis, TUNNEL, [52.0, 57.0], DENSITY)
    assert table["station_m"].tolist() == pytest.approx([2, 7, 0, 5])
    assert table["at_full_density"].tolist() == pytest.approx((1500 * table["points"]).tolist())
    assert table[["found_percent", "interpolated_percent", "gaps_percent"]].sum(
        axis=1
    ).tolist() == pytest.approx(4 * [100])


def test_an_empty_section_is_all_gaps():
    nothing = EpochCloud(
        np.array([[0.0, 10.0, 2.7]]), np.zeros(1, dtype=int), np.zeros(1, dtype=int)
    )
    axis = straight([0.0, 0.0, 0.0], [0.0, 130.0, 0.0])
    setups = [survey(TUNNEL)[0].stations] * 2
    table = section_density.section_counts(
        (nothing, nothing), setups, axis, TUNNEL, [65.0], DENSITY
    )
    assert table["gaps_percent"].tolist() == [100, 100] and table["points"].sum() == 0


def test_a_section_at_full_density(surveyed):
    scan = section_density.full_section(TUNNEL, surveyed[0].stations, 55.0, density=400_000)
    assert set(scan.codes) == {CODES["lining"]}
    section = section_density.noisy_section(scan, TUNNEL, 1)
    assert np.abs(section.w).max() <= 0.025 and 0.4 * len(scan) < section.count < 0.6 * len(scan)
    chainage = TUNNEL.alignment.section_coordinates(section.position)[0]
    assert chainage == pytest.approx(55.0, abs=1e-6)
    errors = section_density.radius_errors(section, local_radii(section), TUNNEL, 1)
    assert np.nanmean(np.abs(errors)) < 0.002
    table = section_density.readings({"a": scan}, TUNNEL, (1.0, 0.3), 1)
    assert table["part"].tolist() == [1.0, 1.0, 0.3, 0.3]
    assert table[["found_percent", "interpolated_percent", "gaps_percent"]].sum(
        axis=1
    ).tolist() == pytest.approx(4 * [100])
    assert table["gaps_percent"].iloc[2] > table["gaps_percent"].iloc[0]


def test_radius_errors_are_those_put_in():
    points = TUNNEL.alignment.polar_points(55.0, np.array([0.0, 0.1]), 2.7)
    axis = straight(
        *(
            TUNNEL.alignment.position(55.0)
            + np.array([[-1.0], [1.0]]) * TUNNEL.alignment.tangent(55.0)
        )
    )
    (section,) = cut(points, axis, [0.5 * axis.length])
    directions = np.array([-1.0, 0.5, 2.0])
    radius = TUNNEL.true_radius(directions, 55.0, 1) + np.array([0.001, np.nan, -0.002])
    nan = np.full(3, np.nan)
    errors = section_density.radius_errors(
        section, Radii(directions, radius, nan, nan, nan, np.zeros(3, dtype=bool), nan), TUNNEL, 1
    )
    assert errors == pytest.approx([0.001, np.nan, -0.002], abs=1e-9, nan_ok=True)
