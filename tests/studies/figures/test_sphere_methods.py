"""The figures of notebook 02 show, and export, what was computed."""

import numpy as np
import pandas as pd
from matplotlib import pyplot

from studies.figures import sphere_methods
from studies.ou_liu_2017 import clouds, origin, readings

from . import exported

CLOUDS = {name: clouds.read_sphere_cloud(gross=name == "gross") for name in ("clean", "gross")}


def test_every_reading_has_a_mark_at_its_change():
    changes = readings.study(CLOUDS)
    sphere_methods.readings(changes, sd_center=1e-3)
    data = exported("02_sphere_methods_readings")
    pd.testing.assert_frame_equal(data, changes, check_dtype=False)
    for panel, (_, rows) in zip(
        pyplot.gcf().axes, changes.groupby("cloud", sort=False), strict=True
    ):
        marks = {
            int(line.get_ydata()[0]): line.get_xdata()[0]
            for line in panel.lines
            if len(line.get_xdata()) == 1
        }
        expected = rows["center_mm"].fillna(sphere_methods.FAILED).clip(lower=sphere_methods.NONE)
        np.testing.assert_allclose([marks[i] for i in range(len(rows))], expected)
    labels = [tick.get_text() for tick in pyplot.gcf().axes[0].get_yticklabels()]
    assert [label.split("  (")[0] for label in labels] == [
        reading.name for reading in readings.READINGS
    ]


def test_every_method_has_a_curve_in_both_panels():
    answers = origin.study(CLOUDS, shifts=(0, 100, 4_000_000), orders=3)
    sphere_methods.origin(answers)
    data = exported("02_sphere_methods_origin")
    pd.testing.assert_frame_equal(data, answers, check_dtype=False)
    for panel, cloud in zip(pyplot.gcf().axes, ("gross", "clean"), strict=True):
        curves = {line.get_label(): line.get_ydata() for line in panel.lines}
        assert list(curves) == list(origin.LABELS.values())
        for method, label in origin.LABELS.items():
            rows = answers[(answers["cloud"] == cloud) & (answers["method"] == method)]
            np.testing.assert_allclose(curves[label], 1e3 * rows["center_error_m"])
        assert any("lost in rounding" in text.get_text() for text in panel.texts)
