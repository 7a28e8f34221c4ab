"""The figures of notebook 05 show what is exported, and that is what the study returned."""

import numpy as np
import pandas as pd
import pytest
from matplotlib import pyplot

from analysis import SPHERE_METHODS
from studies.figures import real_spheres as figures
from studies.ou_liu_2017 import real_spheres
from studies.ou_liu_2017.real_spheres import REFERENCE_CENTERS, WHOLE

from . import exported

SCAN = "SPH101"


@pytest.fixture
def table(tmp_path, monkeypatch):
    """Fits to a made-up scan: points on the sphere and a few beside it."""
    rng = np.random.default_rng(1)
    directions = rng.standard_normal((200, 3))
    points = 0.05 * directions / np.linalg.norm(directions, axis=1)[:, None]
    points[:30, 0] += 0.02
    np.savetxt(tmp_path / f"{SCAN}.xyz", REFERENCE_CENTERS[SCAN] + points)
    monkeypatch.setattr(real_spheres, "SCANS", tmp_path)
    return real_spheres.methods([SCAN], [WHOLE, 0.01, 0.003])


def assert_same(found, expected):
    pd.testing.assert_frame_equal(
        found, expected.reset_index(drop=True), rtol=1e-8, check_dtype=False
    )


def test_section(table):
    figures.section(SCAN, 0.01, 0.003, "05_test_section")
    figure = pyplot.gcf()
    shown = exported("05_test_section")
    circles = shown[shown["method"].notna()]
    whole = real_spheres.section_circles(SCAN, WHOLE)
    assert_same(
        circles[circles["half_width_mm"] == np.inf][list(whole.columns)].reset_index(drop=True),
        whole,
    )
    left, right = figure.axes
    drawn = [patch for patch in left.patches if patch.get_radius() != 50]
    assert [patch.get_radius() for patch in drawn] == whole["radius_mm"].tolist()
    assert [patch.center for patch in drawn] == list(
        zip(whole["along_mm"], whole["across_mm"], strict=True)
    )
    points = real_spheres.section(SCAN, 0.01, 0.003)
    on, off = (line.get_xdata().tolist() for line in left.lines)
    assert sorted(on + off) == sorted(points["along_mm"])
    assert right.lines[0].get_xdata().tolist() == points["along_mm"][points["on_sphere"]].tolist()
    assert len(right.lines[1].get_xdata()) == 0


def test_errors(table):
    peer = table.iloc[:1].assign(method="scipy cauchy", sd_center_mm=np.nan, center_error_mm=3.0)
    table = pd.concat([table, peer])
    figures.errors(table, "05_test_errors")
    figure = pyplot.gcf()
    assert_same(
        exported("05_test_errors"),
        table[["half_width_mm", "scan", "method", "center_error_mm", "sd_center_mm"]],
    )
    assert len(figure.axes) == 3
    drawn = [line.get_xdata()[0] for line in figure.axes[0].lines if len(line.get_xdata()) == 1]
    whole = table[table["half_width_mm"] == WHOLE]
    assert sorted(x for x in drawn if x == x) == sorted(
        [*whole["center_error_mm"], *whole["sd_center_mm"].dropna()]
    )
    assert [text.get_text() for text in figure.axes[0].get_yticklabels()][-1] == "scipy cauchy"


def test_trimming(table):
    figures.trimming(table, "05_test_trimming")
    figure = pyplot.gcf()
    shown = exported("05_test_trimming")
    assert_same(shown, table[list(shown.columns)])
    (ax,) = figure.axes
    for name, method in SPHERE_METHODS.items():
        (line,) = [line for line in ax.lines if line.get_label() == method.label]
        expected = table[table["method"] == name].sort_values("half_width_mm")
        assert line.get_ydata().tolist() == expected["center_error_mm"].tolist()
        assert line.get_color() == method.colour
