"""The control net and the observed targets, and tables of the campaign."""

import numpy as np
import pytest

from studies.li_2015 import campaign_contents
from studies.li_2015.register_campaign import control_net, observed_targets, station_names
from studies.simulation.tunnel import ATTACHMENTS


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
