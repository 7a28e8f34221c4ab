"""The figures of notebook 07: where the plane simulation took place, what it prints, and how good
the methods are.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from analysis.export.figures import GREY, TRUTH, headed, new
from analysis.methods import PLANE_METHODS

from ..publish import publish
from ..wu_chen_wang.errors import PARAMETERS
from ..wu_chen_wang.simulation import FIVE, VARIANTS, printed

STEM = "07_plane_simulation"
REGION = "#BBDDBB"  # where all five numbers fit

# The five numbers: colour, line style. Those of a method have its colour.
LINES = {
    "sigma_s_ls_cm": (PLANE_METHODS["ls"].colour, "-"),
    "sigma_s_tls_cm": (PLANE_METHODS["tls"].colour, "-"),
    "sigma_s_wtls_cm": (PLANE_METHODS["wtls"].colour, "--"),
    "gain_vs_ls_percent": (TRUTH, ":"),
    "gain_vs_tls_percent": (TRUTH, "-."),
}
# Variants: marker, filled or not.
MARKS = {
    "ls": ("o", True),
    "tls": ("s", True),
    "mixed_ls_tls": ("D", True),
    "wtls": ("v", True),
    "wtls, LS plane": ("^", False),
    "wtls, projected": ("v", False),
    "wtls, true": ("P", True),
}


def recovery(maps: Mapping[str, pd.DataFrame], setting: tuple[float, float]) -> None:
    """For each layout, which L and σ can have printed each of the five numbers, and all of them;
    the ``setting`` (m, m) is marked.

    maps : layout -> :meth:`plane_recovery.Nodes.compared`.
    """
    figure, axes = new(2, 2, height=6.4, sharex=True, sharey=True)
    five = _printed_limits()
    for ax, (layout, frame) in zip(axes.flat, maps.items(), strict=True):
        sides, sigmas = np.unique(frame["side_m"]), np.unique(frame["sigma_m"])

        shape = len(sides), len(sigmas)

        def gridded(column, frame=frame, shape=shape):
            return frame[column].to_numpy().reshape(shape).T

        mesh = (sides, 100.0 * sigmas)
        misses = []  # relative distance of each number from where it fits, negative where it does
        for name, (low, high) in five.items():
            lower, upper = gridded(f"{name}_lower"), gridded(f"{name}_upper")
            colour, line = LINES[name]
            # Settings whose central 95 % just reach the printed number from above, and from below.
            ax.contour(
                *mesh, lower - high, levels=[0.0], colors=colour, linestyles=line, linewidths=1.3
            )
            ax.contour(
                *mesh, upper - low, levels=[0.0], colors=colour, linestyles=line, linewidths=1.3
            )
            misses.append(np.maximum(lower - high, low - upper) / (upper - lower + high - low))
        ax.contourf(*mesh, np.max(misses, axis=0), levels=[-np.inf, 0.0], colors=REGION, zorder=0)
        most = int(frame["inside"].max())
        words = (
            "all five fit at once" if most == len(FIVE) else f"at most {most} of the 5 fit at once"
        )
        ax.set_title(f"{layout[0].upper()}{layout[1:]}:\n{words}", fontsize=8.5)
        ax.set_xscale("log")
        ax.set_yscale("log")
        if most == len(FIVE):
            ax.plot(
                setting[0],
                100.0 * setting[1],
                marker="+",
                color=TRUTH,
                markersize=11,
                markeredgewidth=1.6,
                linestyle="none",
            )
    ticks = [0.15, 0.2, 0.3, 0.4]
    axes[0, 0].set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes[0, 0].set_yticks([1.6, 2.0, 2.4, 2.8], ["1.6", "2.0", "2.4", "2.8"])
    for ax in axes.flat:
        ax.minorticks_off()
    for ax in axes[1]:
        ax.set_xlabel("side L of the patch / m")
    for ax in axes[:, 0]:
        ax.set_ylabel("σ of a coordinate at cos θ = 1 / cm")
    handles = [
        Line2D([], [], color=colour, linestyle=line, label=FIVE[name][1])
        for name, (colour, line) in LINES.items()
    ]
    handles.append(Patch(color=REGION, label="all five fit"))
    handles.append(
        Line2D(
            [],
            [],
            color=TRUTH,
            marker="+",
            markersize=9,
            linestyle="none",
            label="L = 0.2 m, σ² = 0.0005 m²",
        )
    )
    headed(
        figure,
        "Which patch and which noise print the five numbers? (between its two lines each fits)",
        handles,
        4,
    )
    shown = pd.concat([frame.assign(layout=layout) for layout, frame in maps.items()])
    publish(figure, f"{STEM}_recovery", shown[["layout", *shown.columns.drop("layout")]])


def experiments(found: NDArray[np.float64], comparison: pd.DataFrame) -> None:
    """How the five numbers (E, 5) spread over ten-run experiments, with the printed ones;
    comparison from `plane_study.against_print`.
    """
    figure, axes = new(1, len(FIVE), height=2.9, sharey=True)
    rows = []
    for ax, values, row in zip(axes, found.T, comparison.itertuples(), strict=True):
        colour, _ = LINES[row.quantity]
        counts, edges = np.histogram(values, bins=24)
        ax.stairs(100.0 * counts / len(values), edges, color=colour, fill=True, alpha=0.35)
        ax.stairs(100.0 * counts / len(values), edges, color=colour, linewidth=1.2)
        ax.axvspan(
            row.printed - row.half_unit,
            row.printed + row.half_unit,
            color=GREY,
            alpha=0.55,
            linewidth=0,
        )
        for limit in (row.lower, row.upper):
            ax.axvline(limit, color=TRUTH, linewidth=0.9, linestyle="--")
        ax.set_xlabel(row.label.replace("σ0: WTLS below", "gain over"))
        rows.append(
            pd.DataFrame(
                {
                    "quantity": row.quantity,
                    "from": edges[:-1],
                    "to": edges[1:],
                    "percent": 100.0 * counts / len(values),
                }
            )
        )
    axes[0].set_ylabel("experiments / %")
    handles = [
        Patch(color=GREY, alpha=0.55, label="what rounds to the printed number"),
        Line2D(
            [],
            [],
            color=TRUTH,
            linewidth=0.9,
            linestyle="--",
            label="central 95 % of the experiments",
        ),
    ]
    headed(
        figure,
        "Does the recovered setting print the paper's numbers? Ten-run experiments",
        handles,
        2,
    )
    publish(figure, f"{STEM}_experiments", pd.concat(rows))


def errors(table: pd.DataFrame) -> None:
    """Bias (mark) and central half (bar) of the errors of a, b and c, for every variant, one row of
    panels a patch.
    """
    sides, variants = table["side_m"].unique(), list(dict.fromkeys(table["variant"]))
    figure, axes = new(len(sides), len(PARAMETERS), height=0.9 + 2.2 * len(sides), sharey=True)
    for panels, side in zip(axes, sides, strict=True):
        for ax, parameter in zip(panels, PARAMETERS, strict=True):
            ax.axvline(0.0, color=TRUTH, linewidth=0.8)
            for row in table[table["side_m"] == side].itertuples():
                bias, low, high = (
                    getattr(row, f"{kind}_{parameter}") for kind in ("bias", "low", "high")
                )
                marker, filled = MARKS[row.variant]
                colour = PLANE_METHODS[VARIANTS[row.variant].method].colour
                y = variants.index(row.variant)
                ax.hlines(y, low, high, color=colour, linewidth=2.2)
                ax.plot(
                    bias,
                    y,
                    marker=marker,
                    color=colour,
                    markerfacecolor=colour if filled else "white",
                    markersize=6.5,
                )
            ax.grid(axis="y", visible=False)
            ax.set_title(f"{parameter}, L = {side:g} m")
    axes[0, 0].set_yticks(range(len(variants)), [VARIANTS[name].label for name in variants])
    axes[0, 0].set_ylim(len(variants) - 0.5, -0.5)
    for ax, words in zip(axes[-1], ("error of a", "error of b", "error of c / m"), strict=True):
        ax.set_xlabel(words)
    handles = [
        Line2D(
            [],
            [],
            color=GREY,
            marker="o",
            markersize=6.5,
            linestyle="none",
            label="bias: what averaging does not remove",
        ),
        Line2D([], [], color=GREY, linewidth=2.2, label="half of the runs lie in here"),
    ]
    headed(figure, "Which method finds the plane? Errors of a single run", handles, 2)
    publish(figure, f"{STEM}_errors", table)


def _printed_limits() -> dict[str, tuple[float, float]]:
    """Interval that rounds to each printed number."""
    return {
        row.quantity: (row.printed - row.half_unit, row.printed + row.half_unit)
        for row in printed().itertuples()
    }
