"""The figures of notebook 08 show, and export, what was computed."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from matplotlib import pyplot

from analysis.adjustment.algorithms import ALGORITHMS
from analysis.methods import PLANE_METHODS
from analysis.scanner import LEICA_C10
from studies import convergence
from studies.figures import plane_scan as figures
from studies.simulation.scenes import redraw
from studies.wu_chen_wang import ground_scan

from . import exported

SCANNER = replace(LEICA_C10, max_incidence=np.deg2rad(89.0))


@pytest.fixture(scope="module")
def scan():
    scene = {"height": 1.17, "near": 16.0, "far": 27.0, "width": 0.04, "step": 0.002}
    return ground_scan.ground_scan(np.random.default_rng(1), SCANNER, **scene, clutter=True)


def test_clutter_shows_every_point_and_plane(scan):
    fits = ground_scan.fitted(scan.points, SCANNER)
    figures.clutter(scan, fits, 1.17)
    data = exported("08_plane_scan_clutter")
    assert (data["kind"] == "stone").sum() == scan.on("stone").sum()
    assert len(data) == len(scan) + 2 * len(fits)
    curves = {line.get_label(): line for line in pyplot.gcf().axes[0].lines}
    for name, fit in fits.items():
        method, _, _, label = ground_scan.COMPARED[name]
        assert curves[label].get_color() == PLANE_METHODS[method].colour
        y = curves[label].get_xdata()
        height = fit.parameters[1] * y + fit.parameters[2] - (ground_scan.SLOPES[1] * y - 1.17)
        np.testing.assert_allclose(curves[label].get_ydata(), 100 * height)


def test_accuracy_shows_errors_and_claims(scan):
    fits = ground_scan.fitted(redraw(scan, 5, 1), SCANNER)
    table = ground_scan.accuracy(fits, ground_scan.truth(1.17), np.array([0.0, 20.0]))
    figures.accuracy({"clean": table, "cluttered": table})
    data = exported("08_plane_scan_accuracy")
    pd.testing.assert_frame_equal(
        data[data["scene"] == "clean"].drop(columns="scene"), table, rtol=1e-7, check_dtype=False
    )
    marks = [line.get_xdata()[0] for line in pyplot.gcf().axes[1].lines]
    assert marks == [
        value for row in table.itertuples() for value in (row.claimed_mm, row.height_mm)
    ]


def test_convergence_draws_every_run_on_every_problem():
    history = convergence.study()
    figures.convergence(history)
    pd.testing.assert_frame_equal(
        exported("08_plane_scan_convergence"), history, rtol=1e-7, check_dtype=False
    )
    for ax, (_, rows) in zip(
        pyplot.gcf().axes, history.groupby("problem", sort=False), strict=True
    ):
        curves = {line.get_label(): line for line in ax.lines}
        for run, (algorithm, _, label) in convergence.RUNS.items():
            excess = rows[rows["run"] == run]["excess"]
            np.testing.assert_array_equal(
                curves[label].get_ydata(), np.maximum(excess, figures.FLOOR)
            )
            assert curves[label].get_color() == ALGORITHMS[algorithm].colour
