"""The figures of notebook 09 show the exported tables, and these are the results of the studies."""

import numpy as np
import pandas as pd
import pytest
from matplotlib import pyplot
from numpy.testing import assert_allclose

from analysis.tunnel.axis import straight
from analysis.tunnel.filter import INSIDE, LINING, OUTSIDE, FilteredLining
from analysis.tunnel.radii import equal_angles
from studies.figures import tunnel_campaign as figures
from studies.li_2015 import filter_accuracy, section_density, sticker_accuracy
from studies.li_2015.epoch_cloud import join_scans
from studies.li_2015.printed_axis import mid_values, printed_axis
from studies.li_2015.register_campaign import control_net, register
from studies.li_2015.thirteen_parameters import start_study
from studies.simulation.tunnel import ZONE, simulate_campaign

from . import exported


@pytest.fixture(scope="module")
def scans():
    return simulate_campaign(2000)


@pytest.fixture(scope="module")
def zones(scans):
    clouds = [join_scans(epoch) for epoch in scans.epochs]
    return tuple(cloud.part(cloud.between(scans.tunnel, *ZONE)) for cloud in clouds)


def labelled(cloud, other=INSIDE):
    """A filter that knows the truth."""
    flags = np.where(cloud.of("lining"), LINING, other).astype(np.int8)
    nothing = np.full(len(flags), np.nan)
    return FilteredLining(flags, nothing, nothing, np.zeros(len(flags), dtype=int), ())


def drawn(ax):
    """label -> (x, y) of every line that has one."""
    return {
        line.get_label(): line.get_xydata()
        for line in ax.lines
        if not line.get_label().startswith("_")
    }


def test_map(scans):
    figures.map_(scans.epochs, scans.tunnel)
    table = exported("09_tunnel_campaign_map")
    net = control_net(*scans.epochs)
    shown = table[table["kind"] == "control point"]
    assert shown["name"].tolist() == net["target"].tolist()
    assert_allclose(shown[["x", "y", "z"]], net[["x", "y", "z"]], atol=1e-5)
    assert_allclose(drawn(pyplot.gcf().axes[1])["control net"], net[["y", "z"]])
    stations = table[table["kind"] == "station of epoch 2"]
    assert_allclose(
        stations[["x", "y", "z"]],
        [one.pose.position for one in scans.epochs[1].stations],
        atol=1e-5,
    )


def test_start():
    table = start_study(4, seed=1)
    figures.start(table)
    pd.testing.assert_frame_equal(exported("09_tunnel_campaign_start"), table, check_dtype=False)
    curves = drawn(pyplot.gcf().axes[0])
    assert (
        curves["found, started from R = I"][:, 1].tolist()
        == table["found_from_identity_percent"].tolist()
    )


def test_between():
    """Errors as markers, 1.96 standard deviations as lines to either side, rightwards above and
    upwards below.
    """
    numbers = np.random.default_rng(1).uniform(0.5, 2.0, (6, 5))
    columns = ["right_mm", "right_sd_mm", "up_mm", "up_sd_mm", "chi_squared"]
    table = pd.DataFrame(numbers, columns=columns).assign(
        registration=["singly"] * 3 + ["jointly"] * 3, chainage_m=[5.0, 15.0, 25.0] * 2
    )
    figures.between(table)
    pd.testing.assert_frame_equal(
        exported("09_tunnel_campaign_between"), table, rtol=1e-8, check_dtype=False
    )
    for ax, direction in zip(pyplot.gcf().axes, ("right", "up"), strict=True):
        for words, rows in table.groupby("registration"):
            at, shift, sd = (
                rows[["chainage_m", f"{direction}_mm", f"{direction}_sd_mm"]].to_numpy().T
            )
            assert_allclose(drawn(ax)[f"{words}: true"], np.stack([at, shift], axis=-1))
            assert_allclose(
                drawn(ax)[f"{words}: stated, ±1.96 standard deviations"],
                np.stack([at, 1.96 * sd], axis=-1),
            )
            assert any(np.array_equal(line.get_ydata(), -1.96 * sd) for line in ax.lines)


def test_stickers(scans):
    tables = {
        epoch.number: sticker_accuracy.differences(epoch, register(epoch)) for epoch in scans.epochs
    }
    figures.stickers(tables)
    shown = exported("09_tunnel_campaign_stickers")
    assert_allclose(shown.loc[shown["epoch"] == 2, "dz_mm"], tables[2]["dz_mm"], rtol=1e-8)
    for ax, column in zip(pyplot.gcf().axes, ("dx_mm", "dy_mm", "dz_mm"), strict=True):
        assert drawn(ax)["stickers, epoch 1"][:, 1].tolist() == tables[1][column].tolist()


def test_axis(scans, zones):
    axes = {
        "printed, 45 m": printed_axis(zones[0].points, 1.0),
        "robust, whole tunnel": straight([0.0, -65.0, 0.0], [0.0, 65.0, 0.0]),
    }
    figures.axis(zones[0], axes, scans.tunnel, step=1.0)
    table = exported("09_tunnel_campaign_axis")
    y, middle = mid_values(zones[0].points, 1.0)
    mids = table[table["kind"] == "mid-value"]
    assert_allclose(mids[["y_m", "x_m", "z_m"]], np.column_stack([y, middle]), atol=1e-5)
    printed = table[table["kind"] == "printed axis"]
    x, z = axes["printed, 45 m"].local_curve(printed["y_m"].to_numpy())[0]
    assert_allclose(printed[["x_m", "z_m"]], np.column_stack([x, z]), atol=1e-4)
    assert_allclose(
        drawn(pyplot.gcf().axes[0])["mid-values of 0.1 m"], np.column_stack([y, middle[:, 0]])
    )


def test_filter(scans, zones):
    figures.filter_(zones[0], labelled(zones[0], OUTSIDE), scans.tunnel, 48.0, 52.0)
    table = exported("09_tunnel_campaign_filter")
    assert table["chainage_m"].between(48, 52).all() and set(table["flag"]) == {LINING, OUTSIDE}
    before, after = pyplot.gcf().axes[:2]
    kept = table.loc[table["flag"] == LINING, ["u_m", "v_m"]]
    assert sum(len(line.get_xdata()) for line in before.lines) == len(table)
    assert_allclose(np.concatenate([line.get_xydata() for line in after.lines]), kept, atol=1e-5)


def test_crown():
    cells = pd.DataFrame(
        {
            "rule": list(figures.RULES),
            "chainage_m": 50.0,
            "alpha_deg": [0.0, 0.0, 90.0],
            "true_mm": -20.0,
        }
    )
    cells = cells.assign(
        before_mm=-19.5, after_mm=[-15.0, -19.4, -19.3], kept_percent=[40.0, 99.0, 98.0]
    )
    figures.crown(cells)
    table = exported("09_tunnel_campaign_crown")
    assert table["after_mm"].tolist() == [-15.0, -19.4]  # 90° is not the crown
    assert drawn(pyplot.gcf().axes[0])["after: one cylinder"].tolist() == [[50.0, -15.0]]


def test_the_rules_are_those_of_the_study():
    assert list(figures.RULES) == list(filter_accuracy.RULES)
    assert list(figures.READINGS) == list(section_density.READINGS)


def test_epochs(scans, zones):
    figures.epochs(
        dict(enumerate(zones, 1)),
        {k: labelled(zone) for k, zone in enumerate(zones, 1)},
        scans.tunnel,
        50.0,
        2.0,
    )
    table = exported("09_tunnel_campaign_epochs")
    section = table[(table["view"] == "section") & (table["epoch"] == 2)]
    u, v = pyplot.gcf().axes[1].lines[1].get_xydata().T
    departure = (np.hypot(u, v) - figures.RADIUS) / figures.EXAGGERATED
    assert_allclose(departure, section["rho_m"] - figures.RADIUS, atol=1e-5)
    assert len(table[table["view"] == "side"]) == sum(
        len(zone.points[:: max(1, len(zone) // figures.SHOWN)]) for zone in zones
    )


def test_density_and_sections(scans):
    setups = [one.setup for one in scans.epochs[0].stations]
    full = {"55 m": section_density.full_section(scans.tunnel, setups, 55.0, density=100_000)}
    readings = section_density.readings(full, scans.tunnel, (1.0, 0.5), 1)
    counts = pd.DataFrame(
        {"epoch": [1, 2], "station_m": [5.0, 3.0], "at_full_density": [4000.0, 10_000.0]}
    )
    figures.density(counts, readings)
    table = exported("09_tunnel_campaign_density")
    assert table.loc[table["panel"] == "section", "at_full_density"].tolist() == [4000, 10_000]
    of = readings[readings["reading"] == "equal angles"].sort_values("points")
    assert (
        drawn(pyplot.gcf().axes[1])["gaps, equal angles"].tolist()
        == of[["points", "gaps_percent"]].to_numpy().tolist()
    )

    section = section_density.noisy_section(full["55 m"], scans.tunnel, 1)
    figures.sections({"55 m": section}, scans.tunnel, 1)
    shown = exported("09_tunnel_campaign_sections")
    radii = equal_angles(section)
    assert (shown["kind"] == "gap").sum() == radii.gaps.sum()
    assert (shown["kind"] == "interpolated").sum() == radii.interpolated.sum()
    truth = shown.loc[shown["kind"] == "truth", "rho_m"]
    assert_allclose(truth, scans.tunnel.true_radius(radii.directions, 55.0, 1), atol=1e-5)
