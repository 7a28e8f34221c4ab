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


def frame_of(offsets):
    return pd.DataFrame(offsets, columns=["dx_mm", "dy_mm", "dz_mm"])


def test_accuracy_separates_what_is_systematic():
    """A bias, a scanner of 2 mm and a total station of 1 mm per coordinate."""
    draw = np.random.default_rng(3)
    noise = 2.0 * draw.standard_normal((4000, 3)) - draw.standard_normal((4000, 3))
    table = sticker_accuracy.accuracy(frame_of([3.0, 0.0, -1.0] + noise))
    np.testing.assert_allclose(table["bias_mm"], [3, 0, -1, np.sqrt(10)], atol=0.12)
    np.testing.assert_allclose(table["sd_mm"], np.sqrt([5, 5, 5, 15]), rtol=0.04)
    np.testing.assert_allclose(table["m_mm"], np.sqrt([14, 5, 6, 25]), rtol=0.04)
    np.testing.assert_allclose(table["scanner_mm"], np.sqrt([13, 4, 5, 22]), rtol=0.05)
    np.testing.assert_allclose(
        table["m_mm"].iloc[3], np.linalg.norm(table["m_mm"].iloc[:3]), rtol=1e-12
    )
    assert table["within_limit"].tolist() == ["yes"] * 4 and (table["n"] == 4000).all()


def test_interval_of_the_accuracy_covers_as_often_as_it_says():
    draw = np.random.default_rng(4)
    tables = [
        sticker_accuracy.accuracy(frame_of(2.0 * draw.standard_normal((8, 3)))) for _ in range(600)
    ]
    for row, sigma in enumerate([2, 2, 2, 2 * np.sqrt(3)]):
        covered = [table["low_mm"][row] < sigma < table["high_mm"][row] for table in tables]
        assert 0.92 < np.mean(covered) < 0.98


def test_one_sticker_has_no_scatter():
    with pytest.raises(ValueError, match="at least 2 stickers, got 1"):
        sticker_accuracy.accuracy(frame_of(np.zeros((1, 3))))


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
