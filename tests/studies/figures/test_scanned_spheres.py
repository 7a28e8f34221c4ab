"""The figures of table 3 show what is exported, and that is what the study returned."""

import numpy as np
import pandas as pd
from matplotlib import pyplot

from analysis.methods import SPHERE_METHODS
from studies.figures import scanned_spheres as figures
from studies.ou_liu_2017 import table3, table3_settings

from . import exported


def test_methods():
    quantities = [f"{name}{end}" for name in figures.PANELS for end in ("_lower", "", "_upper")]
    variants = [*SPHERE_METHODS, table3.HELD]
    rows = [
        {"sphere": sphere, "state": state, "variant": variant}
        | dict(zip(quantities, np.arange(6.0) + place, strict=True))
        for state in (table3.RAW, table3.CLEANED)
        for sphere in "I II".split()
        for place, variant in enumerate(variants)
    ]
    table = pd.DataFrame(rows)
    figures.methods(table, table3.printed_errors(), "04_test_scanned_methods")
    shown = exported("04_test_scanned_methods")
    cleaned = table[table["state"] == table3.CLEANED]
    assert shown["along_mm"].dropna()[: len(cleaned)].tolist() == cleaned["along_mm"].tolist()
    left, right = pyplot.gcf().axes
    for ax, name in ((left, "along_mm"), (right, "radius_mm")):
        medians = [
            line.get_xdata()[0]
            for line in ax.lines
            if line.get_marker() in "oD" and len(line.get_xdata()) == 1
        ]
        assert medians == cleaned[name].tolist()
        printed = [line.get_xdata()[0] for line in ax.lines if line.get_marker() == "|"]
        assert np.array_equal(printed, table3.printed_errors()[name], equal_nan=True)
    assert [text.get_text() for text in left.get_yticklabels()][-1] == table3.HELD


def test_cleaning():
    rows = [
        {"sphere": sphere, "range_sd_mm": sd, "half_width_mm": width, "points": 100}
        | {
            "ls_radius_mm": width * sd,
            "ls_sigma_s_mm": 1 + width,
            "igg3_radius_mm": -sd,
            "igg3_sigma_s_mm": sd,
        }
        for sd in (2.0, 4.0)
        for sphere in ("I", "II")
        for width in (0.0, 5.0, 10.0)
    ]
    table = pd.DataFrame(rows)
    printed = table3_settings.printed_settings()
    figures.cleaning(table, printed, "04_test_scanned_cleaning")
    assert len(exported("04_test_scanned_cleaning")) == len(table) + len(printed)
    for ax, sphere in zip(pyplot.gcf().axes, ("I", "II"), strict=True):
        curves = [line for line in ax.lines if line.get_marker() == "o"]
        assert [line.get_xdata().tolist() for line in curves] == [
            [0.0, 10.0, 20.0],
            [0.0, 20.0, 40.0],
        ]
        (star,) = [line for line in ax.lines if line.get_marker() == "*"]
        expected = printed[printed["sphere"] == sphere]
        assert (star.get_xdata()[0], star.get_ydata()[0]) == (
            expected["ls_radius_mm"].iloc[0],
            expected["ls_sigma_s_mm"].iloc[0],
        )
