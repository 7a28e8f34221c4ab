"""Scans of an epoch joined by registration, and parts of the cloud."""

from dataclasses import replace

import numpy as np

from studies.li_2015.epoch_cloud import join_scans
from studies.li_2015.register_campaign import register
from studies.simulation.tunnel import ATTACHMENTS, CODES, ZONE

from . import TUNNEL


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
