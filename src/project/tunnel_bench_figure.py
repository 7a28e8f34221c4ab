"""Figure of the benchmark of the tunnel: time and memory over the number of points."""

from __future__ import annotations

import pandas as pd
from matplotlib.ticker import FuncFormatter, NullFormatter

from analysis.export.figures import GREY, GROSS, TRUTH, Publish, headed, new

BLUE = "#0072B2"
GB_A_MILLION = 0.024  # three coordinates in double precision


def growth(
    table: pd.DataFrame, stem: str, *, seconds: float, gigabytes: float, publish: Publish
) -> None:
    """Time and largest memory against the points, with their limits; table from
    ``project.tunnel_bench.growing``.
    """
    figure, (left, right) = new(1, 2, height=3.2)
    millions = 1e-6 * table["points"].to_numpy()
    ends = millions[[0, -1]]
    left.plot(millions, table["wall, s"], "o-", color=BLUE, label="elapsed")
    left.plot(millions, table["CPU, s"], "s--", color=GROSS, label="of the processor")
    left.plot(
        ends,
        table["CPU, s"].iloc[-1] * ends / ends[1],
        ":",
        color=GREY,
        label="in proportion to the points",
    )
    right.plot(millions, table["peak, GB"], "o-", color=BLUE, label="largest of the whole process")
    right.plot(ends, GB_A_MILLION * ends, ":", color=GREY, label="coordinates alone")
    for ax, limit, quantity, unit in (
        (left, seconds, "time", "s"),
        (right, gigabytes, "memory", "GB"),
    ):
        ax.axhline(limit, color=TRUTH, linewidth=1.0)
        ax.annotate(
            f"limit: {limit:g} {unit}",
            (0.02, limit),
            (0, -4),
            ("axes fraction", "data"),
            "offset points",
            va="top",
        )
        ax.set_xscale("log")
        ax.set_yscale("log")
        ax.set_ylim(top=1.5 * limit)
        ax.set_xticks(millions, [f"{value:.2g}" for value in millions])
        ax.xaxis.set_minor_formatter(NullFormatter())
        ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        ax.set_xlabel("million points in both epochs")
        ax.set_ylabel(f"{quantity} / {unit}")
        ax.legend(loc="lower right")
    headed(figure, "Do time and memory grow faster than the points?")
    publish(figure, stem, table)
