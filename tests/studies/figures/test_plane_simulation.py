"""The figures of notebook 07 show, and export, what was computed."""

import numpy as np
import pandas as pd
import pytest
from matplotlib import pyplot

from analysis.methods import PLANE_METHODS
from studies.figures import plane_simulation as figures
from studies.wu_chen_wang import clouds, errors, recovery, simulation

from . import exported


def test_recovery_shows_the_setting_where_all_five_fit():
    sides, sigmas = np.geomspace(0.14, 0.36, 4), np.geomspace(0.017, 0.029, 4)
    layouts = list(clouds.PLANE_LAYOUTS)[:2]
    maps = {
        name: recovery.search(sides, sigmas, 40, name)[recovery.LITERAL].compared(3)
        for name in layouts
    }
    maps |= {name: maps[layouts[0]] for name in list(clouds.PLANE_LAYOUTS)[2:]}
    figures.recovery(maps, (0.2, 0.0224))
    data = exported("07_plane_simulation_recovery")
    for layout, frame in maps.items():
        rows = data[data["layout"] == layout].drop(columns="layout").reset_index(drop=True)
        pd.testing.assert_frame_equal(rows, frame, rtol=1e-7, check_dtype=False)
    fits, fails = pyplot.gcf().axes[:2]
    assert "all five" in fits.get_title(loc="left") and "at most" in fails.get_title(loc="left")
    assert [line.get_xydata().tolist() for line in fits.lines] == [[[0.2, pytest.approx(2.24)]]]
    assert not fails.lines  # no mark where it does not fit


def test_experiments_shows_all_of_them_and_the_printed_numbers():
    found = np.random.default_rng(0).normal([5.9, 4.8, 4.8, 83, 54], 0.1, (300, 5))
    comparison = simulation.against_print(found, found[0])
    figures.experiments(found, comparison)
    data = exported("07_plane_simulation_experiments")
    np.testing.assert_allclose(data.groupby("quantity")["percent"].sum(), 100)
    for ax, row in zip(pyplot.gcf().axes, comparison.itertuples(), strict=True):
        assert [line.get_xdata()[0] for line in ax.lines] == [row.lower, row.upper]


def test_errors_has_a_mark_at_every_bias():
    table = errors.study([0.2, 2.0], 20)
    figures.errors(table)
    pd.testing.assert_frame_equal(
        exported("07_plane_simulation_errors"), table, rtol=1e-7, check_dtype=False
    )
    axes = pyplot.gcf().axes
    marks = [line for line in axes[4].lines if line.get_marker() != "None"]
    rows = table[table["side_m"] == 2.0]
    assert [mark.get_xdata()[0] for mark in marks] == rows["bias_b"].tolist()
    for mark, variant in zip(marks, rows["variant"], strict=True):
        assert mark.get_color() == PLANE_METHODS[simulation.VARIANTS[variant].method].colour
