"""Exact targets leave no error, a known error reappears, stated accuracies are true."""

import numpy as np
import pytest

from studies.li_2015 import registration_accuracy
from studies.li_2015.register_campaign import register
from studies.simulation.tunnel import survey

from . import TUNNEL, exact, moved


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
