"""Known offsets of an axis reappear, and each cause pulls the printed axis as it should."""

import numpy as np
import pytest

from analysis.tunnel.axis import straight
from studies.li_2015 import axis_accuracy
from studies.simulation.tunnel import ZONE, Alignment, Lining, Tunnel

from . import TUNNEL


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
