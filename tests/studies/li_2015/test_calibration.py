"""Intervals cover as stated, tests give as many false alarms as stated, for any sharing of work."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from studies.li_2015.calibration import alarms, coverage
from studies.li_2015.simulated_sections import ALL, simulated_sections
from studies.simulation.tunnel import default_tunnel

QUIET, SQUAT, DENT = 95.0, 65.0, 25.0


@pytest.fixture(scope="module")
def sections():
    found = simulated_sections(default_tunnel(), (QUIET, SQUAT, DENT), 1_000_000, workers=2)
    return {section.chainage: section.lining() for section in found}


def off(section, sd=0.001):
    """The section with independent errors of its stations of sd (m) in each direction."""
    return replace(section, shifts=sd**2 * np.eye(len(section.shifts)))


def test_intervals_hold_the_truth(sections):
    exact = [sections[SQUAT], sections[QUIET]]
    table = coverage(
        {"noise": exact, "registration": [off(section) for section in exact]}, 100, 1, n_points=50
    )
    together = table[table["section"] == ALL]
    assert table["case"].tolist() == ["noise"] * 3 + ["registration"] * 3
    assert table["section"].tolist() == ["65 m", "95 m", ALL] * 2
    assert np.all(np.abs(together["held_percent"] - 95) < 2 + 3 * together["held_se_percent"])
    assert np.all(np.abs(together["rmse_mm"] / together["stated_mm"] - 1) < 0.15)
    # A registration error is rigid: it is in Δρ and hardly, where two stations see the section, in
    # what is left without its rigid part.
    without, with_it = table[["rmse_mm", "rmse_within_mm"]].to_numpy()[[2, 5]]
    assert with_it[0] > without[0] + 0.1 and abs(with_it[1] / without[1] - 1) < 0.2


def test_all_is_made_of_the_sections(sections):
    table = coverage({"one": [off(sections[SQUAT]), off(sections[QUIET])]}, 10, 1, n_points=50)
    one, other, together = table["held_percent"]
    assert together == pytest.approx(0.5 * (one + other))
    assert table["rmse_mm"][2] == pytest.approx(np.sqrt(np.mean(table["rmse_mm"][:2] ** 2)))


def test_alarms_in_a_quiet_section_and_in_a_dented_one(sections):
    quiet, dent, _ = alarms(
        [off(sections[QUIET]), off(sections[DENT])], 40, 1, workers=2
    ).itertuples()
    assert (
        quiet.changed_percent <= 5 + 4 * quiet.changed_se_percent and quiet.significant_percent < 9
    )
    assert quiet.flagged_percent == 0 and quiet.beyond_12_mm_percent <= quiet.beyond_6_mm_percent
    # the rule misses what is narrow
    assert dent.changed_percent == 100 and dent.flagged_percent < 10
    assert quiet.changed_se_percent == pytest.approx(100 * np.sqrt(0.05 * 0.95 / 40))


def test_workers_change_nothing(sections):
    one, two = (alarms([off(sections[QUIET])], 30, 1, workers=workers) for workers in (1, 2))
    pd.testing.assert_frame_equal(one, two, rtol=1e-12)
