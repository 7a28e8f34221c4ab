"""The figures of notebook 10 show the exported tables, and these are the results of the studies."""

import numpy as np
import pandas as pd
import pytest
from matplotlib import pyplot

from analysis.tunnel.significance import CLASSES
from studies.figures import tunnel_deformation as figures
from studies.li_2015 import section_accuracy
from studies.li_2015.printed_ellipse import failure_study
from studies.li_2015.simulated_sections import ALL, compare_epochs, simulated_sections
from studies.simulation.tunnel import default_tunnel

from . import exported


@pytest.fixture(scope="module")
def once():
    """The section at 65 m and the one with the dent in one campaign."""
    sections = simulated_sections(default_tunnel(), (65.0, 25.0), 100_000, workers=1)
    return [compare_epochs(section, 1, 1) for section in sections]


def assert_exported(name, expected):
    pd.testing.assert_frame_equal(
        exported(f"10_tunnel_deformation_{name}"),
        expected.reset_index(drop=True),
        rtol=1e-8,
        check_dtype=False,
    )


def curve(ax, colour):
    """Points of the first line of this colour."""
    return np.array(
        next(
            line for line in ax.lines if line.get_color() == colour and len(line.get_xdata()) > 100
        ).get_data()
    )


def test_projection(once):
    figures.projection(once[0], 2)
    shown = exported("10_tunnel_deformation_projection")
    points = shown[shown["kind"] != "ellipse"]
    np.testing.assert_allclose(points[["right_m", "up_m"]], once[0].points[1][0, :, :2], rtol=1e-8)
    np.testing.assert_allclose(points["along_mm"], 1e3 * once[0].points[1][0, :, 2], rtol=1e-7)
    plane = pyplot.gcf().axes[1]
    np.testing.assert_allclose(
        curve(plane, figures.CHANGE).T,
        shown[shown["kind"] == "ellipse"][["right_m", "up_m"]],
        rtol=1e-8,
    )
    assert sum(len(line.get_xdata()) for line in plane.lines[:2]) == len(points)


def test_polar(once):
    figures.polar(once)
    shown = exported("10_tunnel_deformation_polar")
    for k, one in enumerate(once):
        of = shown[shown["chainage_m"] == one.section.chainage]
        np.testing.assert_allclose(of["difference_mm"], 1e3 * one.change.difference[0], rtol=1e-8)
        np.testing.assert_allclose(of["true_mm"], 1e3 * one.truth, rtol=1e-6, atol=1e-7)
        below = pyplot.gcf().axes[len(once) + k]
        np.testing.assert_allclose(
            curve(below, figures.EPOCHS[1]), [of["angle_deg"], of["difference_mm"]], rtol=1e-8
        )
    above = pyplot.gcf().axes[0]
    first, second = (np.hypot(*curve(above, colour)) for colour in figures.EPOCHS)
    np.testing.assert_allclose(
        second - first, figures.TIMES * once[0].change.difference[0], atol=1e-9
    )


def test_classes(once):
    points = pd.concat(
        [
            section_accuracy.single_points(one.section, tuple(epoch[0] for epoch in one.points))
            for one in once
        ]
    )
    figures.classes(points, {65.0: "squat", 25.0: "dent"})
    assert_exported("classes", points)
    ax = pyplot.gcf().axes[0]
    of = points[points["chainage_m"] == 65.0]
    for line, name in zip(ax.lines[1:], CLASSES, strict=True):
        rows = of[of["class"] == name]
        radii = rows["radius_m"] + 1e-3 * figures.TIMES * rows["difference_mm"]
        np.testing.assert_allclose(np.hypot(*line.get_data()), np.abs(radii))
        assert line.get_color() == figures.CLASS_COLOURS[name]


def test_alarms():
    table = pd.DataFrame(
        {
            "section": ["25 m", "85 m", ALL],
            "flagged_percent": [0.0, 1.0, 0.5],
            "changed_percent": [100.0, 4.0, 52.0],
        }
    )
    figures.alarms(table, {"85 m": "nothing", "25 m": "dent"})
    assert_exported("alarms", table.iloc[[1, 0]])
    marks = [
        (line.get_marker(), *line.get_xdata(), *line.get_ydata())
        for line in pyplot.gcf().axes[0].lines
        if line.get_marker() in "os"
    ]
    assert marks == [("s", 1.0, 0), ("o", 4.0, 0), ("s", 0.0, 1), ("o", 100.0, 1)]


def test_hidden(once):
    table = section_accuracy.hidden(once[1])
    figures.hidden(table)
    assert_exported("hidden", table)
    drawn = {line.get_label(): line.get_ydata() for line in pyplot.gcf().axes[0].lines}
    np.testing.assert_array_equal(drawn["true"], table["true_mm"])
    np.testing.assert_array_equal(drawn["ellipses alone"], table["ellipse_mm"])


def test_parts(once):
    tables = {"65 m": section_accuracy.shares(once[0]), "25 m": section_accuracy.shares(once[1])}
    figures.parts(tables)
    assert_exported("parts", pd.concat(tables.values()))
    for ax, table in zip(pyplot.gcf().axes, tables.values(), strict=True):
        np.testing.assert_array_equal(curve(ax, figures.RIGID)[1], table["rigid_mm"])
        np.testing.assert_array_equal(curve(ax, figures.SHAPE)[1], table["shape_mm"])


def test_ellipsoid():
    study = failure_study([0.01, 0.05], [100, 200], trials=20)
    figures.ellipsoid(study)
    assert_exported("ellipsoid", study)
    left, right = pyplot.gcf().axes
    rows = study[(study["tilt_deg"] == 10) & (study["points"] == 200)]
    (line,) = [
        line for line in left.lines if line.get_label() == "ellipse tilted by 10°, 200 points"
    ]
    np.testing.assert_allclose(line.get_ydata(), 100 * rows["imaginary"])
    assert len(right.lines) == 4
