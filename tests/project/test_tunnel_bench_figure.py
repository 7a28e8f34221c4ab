"""The figure of the tunnel's benchmark shows its table, beside the limits."""

import numpy as np
import pandas as pd
from matplotlib import pyplot

from project import tunnel_bench_figure as figures


def test_growth():
    table = pd.DataFrame(
        {
            "points": [400_000, 4_000_000],
            "wall, s": [10.0, 50.0],
            "CPU, s": [8.0, 40.0],
            "peak, GB": [0.3, 0.6],
            "campaign": ["a", "b"],
        }
    )
    published = []
    figures.growth(
        table, "tunnel", seconds=600.0, gigabytes=8.0, publish=lambda *what: published.append(what)
    )
    ((figure, stem, data),) = published
    assert figure is pyplot.gcf() and stem == "tunnel" and data is table
    for ax, shown, limit in zip(
        figure.axes, (["wall, s", "CPU, s"], ["peak, GB"]), (600.0, 8.0), strict=True
    ):
        for line, name in zip(ax.lines, shown, strict=False):
            np.testing.assert_allclose(line.get_data(), [[0.4, 4.0], table[name]])
        assert ax.lines[-1].get_ydata() == [limit, limit]
        assert limit < ax.get_ylim()[1] and ax.get_xscale() == ax.get_yscale() == "log"
        assert [text.get_text() for text in ax.get_xticklabels()] == ["0.4", "4"]
    proportional, coordinates = figure.axes[0].lines[2], figure.axes[1].lines[1]
    np.testing.assert_allclose(proportional.get_ydata(), [4.0, 40.0])
    np.testing.assert_allclose(coordinates.get_ydata(), [0.4e6 * 24e-9, 4e6 * 24e-9])
