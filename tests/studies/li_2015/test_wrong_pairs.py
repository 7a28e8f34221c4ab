"""A target taken for another is found and named."""

import numpy as np
import pandas as pd
import pytest

from analysis.tunnel.registration import register_stations
from studies.li_2015 import wrong_pairs
from studies.li_2015.register_campaign import control_net


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
