"""Points of sections are counted, and errors of radii are those put in."""

import numpy as np
import pytest

from analysis.tunnel.axis import straight
from analysis.tunnel.radii import Radii, local_radii
from analysis.tunnel.sections import cut
from studies.li_2015 import section_density
from studies.li_2015.epoch_cloud import EpochCloud, join_scans
from studies.simulation.tunnel import CODES, survey
from studies.simulation.tunnel.campaign import station_grid

from . import TUNNEL
from .conftest import DENSITY


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
