"""The figures of notebook 06 show what is exported, and that is what the studies returned."""

import numpy as np
import pandas as pd
from matplotlib import pyplot

from analysis import SPHERE_METHODS
from studies.figures import robustness as figures
from studies.ou_liu_2017.clouds import sphere_redraws
from studies.robustness import bias, breakdown, collapse, coverage, efficiency, number_of_points

from . import exported


def assert_exported(stem, expected):
    pd.testing.assert_frame_equal(
        exported(stem), expected.reset_index(drop=True), rtol=1e-8, check_dtype=False
    )


def drawn(ax):
    """variant's label -> the points of its curve; and that its colour is that of its method."""
    curves = {}
    for bars in ax.containers:
        line = bars.lines[0]
        curves.setdefault(bars.get_label(), []).append(
            (line.get_xdata().tolist(), line.get_ydata().tolist(), line.get_color())
        )
    return curves


def test_bias():
    table = bias.study([(60, 0.002), (80, 0.002), (80, 0.001)], draws=3, n=30, seed=1)
    figures.bias(table, 80, 0.002)
    figure = pyplot.gcf()
    assert_exported("06_robustness_bias", table)
    for variant in bias.ORDER:
        ((angles, along, colour),) = drawn(figure.axes[0])[figures.VARIANTS[variant][4]]
        rows = table[(table["variant"] == variant) & (table["sigma_mm"] == 2)]
        assert (angles, along) == ([60, 80], rows["along_mm"].tolist())
        assert colour == SPHERE_METHODS[variant.split(",")[0]].colour
        ((sigmas, radius, _),) = drawn(figure.axes[3])[figures.VARIANTS[variant][4]]
        assert (sigmas, radius) == (
            [1, 2],
            table[(table["variant"] == variant) & (table["half_angle_deg"] == 80)][
                "radius_mm"
            ].tolist(),
        )


def test_coverage_against_points():
    table = number_of_points.study([6, 40], 20, 1_000, 0.002, 1)
    table.loc[1, "held_percent"] = 12.0  # below what is drawn, and written down
    figures.coverage_against_points(table)
    figure = pyplot.gcf()
    assert_exported("06_robustness_coverage_points", table)
    for ax, (_, rows) in zip(figure.axes, table.groupby("surface", sort=False), strict=True):
        for method, of_method in rows.groupby("method"):
            ((_, held, _),) = drawn(ax)[figures.VARIANTS[method][4]]
            assert held == of_method["held_percent"].tolist()
    assert "6 points: 12 %" in figure.axes[0].texts[0].get_text()


def test_efficiency():
    table = efficiency.study(5, seed=1)
    figures.efficiency(table)
    figure = pyplot.gcf()
    assert_exported("06_robustness_efficiency", table)
    curves = drawn(figure.axes[0])
    for place, row in enumerate(table.itertuples()):
        assert curves[figures.VARIANTS[row.variant][4]][0][:2] == ([row.sd_ratio], [place])


def test_breakdown():
    table = breakdown.study([0, 0.2], 4, 40, seed=1)
    figures.breakdown(table)
    figure = pyplot.gcf()
    assert_exported("06_robustness_breakdown", table)
    for ax, pattern in zip(figure.axes, breakdown.PATTERNS, strict=True):
        curves = drawn(ax)
        assert set(curves) == {figures.VARIANTS[variant][4] for variant in breakdown.VARIANTS}
        rows = table[(table["pattern"] == pattern) & (table["variant"] == "robust")]
        assert curves["robust"][0][:2] == ([0, 20], rows["within_percent"].tolist())


def test_coverage():
    table = coverage.study(
        6, 30, 1, 80, [0, 0.2], {"isotropic": 0.002, "larger": 0.004}, ["ls", "robust"]
    )
    figures.coverage(table)
    figure = pyplot.gcf()
    assert_exported("06_robustness_coverage", table)
    curves = drawn(figure.axes[2])
    for method in ("ls", "robust"):
        rows = table[(table["noise"] == "larger") & (table["method"] == method)]
        assert [x for (x,), _, _ in curves[figures.VARIANTS[method][4]]] == rows[
            "held_percent"
        ].tolist()


def test_collapse():
    history, ends = collapse.history(sphere_redraws(1)[0]), collapse.redraws(4)
    figures.collapse(history, ends, last=30)
    figure = pyplot.gcf()
    shown = exported("06_robustness_collapse")
    steps = history[history["iteration"] <= 30].reset_index(drop=True)
    of_one_cloud = shown[shown["panel"] == "one cloud"][steps.columns].reset_index(drop=True)
    pd.testing.assert_frame_equal(of_one_cloud, steps, rtol=1e-8, check_dtype=False)
    variant = "weighted, cumulative"
    line = next(
        line for line in figure.axes[0].lines if line.get_label() == figures.SCALES[variant][2]
    )
    assert line.get_ydata().tolist() == steps[steps["variant"] == variant]["left"].tolist()
    distribution = shown[(shown["panel"] == "redraws") & (shown["variant"] == variant)]
    left = np.sort(ends[ends["variant"] == variant]["left"])
    assert distribution["percent"].iloc[-1] == 100 and distribution["left"].tolist() == sorted(
        set(left)
    )
