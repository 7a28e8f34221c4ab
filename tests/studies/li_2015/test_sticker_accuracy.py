"""Exact stickers agree, and errors in common are seen."""

import numpy as np
import pandas as pd
import pytest

from studies.li_2015 import sticker_accuracy
from studies.li_2015.register_campaign import register
from studies.simulation.tunnel import SECTIONS

from . import exact


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


def test_limit_rejects_a_true_6_mm_in_95_percent():
    errors = 6 / np.sqrt(3) * np.random.default_rng(2).standard_normal((20_000, 10, 3))
    m = np.sqrt(np.sum(np.mean(errors**2, axis=1), axis=-1))
    assert np.mean(m < sticker_accuracy.limit_for(10)) == pytest.approx(0.05, abs=0.006)
