"""Figures of notebook 04: what every method makes of a scan, and what
cleaning does to LS and IGG III-WTLS.
"""

from __future__ import annotations

import pandas as pd
from matplotlib.lines import Line2D

from analysis.export.figures import GREY, TRUTH, headed, new
from analysis.methods import SPHERE_METHODS
from analysis.scanner import LEICA_C10

from ..ou_liu_2017 import table3
from ..publish import publish

PANELS = {
    "along_mm": ("Centre along the line of sight", "error / mm, away from the scanner →"),
    "radius_mm": ("Radius", "error / mm, too large →"),
}
PRINTED = {
    "marker": "|",
    "markersize": 13,
    "markeredgewidth": 2.2,
    "linestyle": "none",
    "color": TRUTH,
}
# marker, filled, place beside the line of the method
SPHERES = {"I": ("o", True, -0.17), "II": ("D", False, 0.17)}
LINES = ("-", "--", ":")  # of the settings of the scanner, in order
CURVES = {
    "ls": ("o", "ls_radius_mm", "ls_sigma_s_mm"),
    "igg3_wtls": ("^", "igg3_radius_mm", "igg3_sigma_s_mm"),
}
ASSUMED_RANGE_SD = 1e3 * LEICA_C10.range_sd  # mm; its curve is the one with words
WORDS = {"textcoords": "offset points", "fontsize": 7.5}
PRINTED_MARKERS = {"ls": "*", "igg3_wtls": "X"}
STAR = {"markersize": 12, "markeredgecolor": TRUTH, "linestyle": "none"}


def methods(table: pd.DataFrame, printed: pd.DataFrame, stem: str) -> None:
    """How exact is each method on a cleaned scan? Median and central 95 % of its errors, printed
    values marked.

    table : of `table3.every_method`; printed : of `table3.printed_errors`.
    """
    table = table[table["state"] == table3.CLEANED]
    names = list(dict.fromkeys(table["variant"]))
    figure, axes = new(1, 2, height=1.3 + 0.33 * len(names), sharey=True)
    for ax, (quantity, (title, words)) in zip(axes, PANELS.items(), strict=True):
        ax.axvline(0.0, color=GREY, linewidth=0.8)
        for row in table.itertuples():
            marker, filled, aside = SPHERES[row.sphere]
            colour = SPHERE_METHODS[row.variant.split(",")[0]].colour
            y = names.index(row.variant) + aside
            lower, upper = getattr(row, f"{quantity}_lower"), getattr(row, f"{quantity}_upper")
            ax.plot([lower, upper], [y, y], color=colour, linewidth=1.6)
            ax.plot(
                getattr(row, quantity),
                y,
                marker,
                color=colour,
                markersize=5,
                markerfacecolor=colour if filled else "white",
            )
        for row in printed.itertuples():
            ax.plot(
                getattr(row, quantity), names.index(row.method) + SPHERES[row.sphere][2], **PRINTED
            )
        ax.set(title=title, xlabel=words)
        ax.grid(axis="y", visible=False)
    axes[0].set_yticks(
        range(len(names)),
        [SPHERE_METHODS[name].label if name in SPHERE_METHODS else name for name in names],
    )
    axes[0].set_ylim(len(names) - 0.5, -0.5)
    marks = []
    for name, (marker, filled, _) in SPHERES.items():
        face = GREY if filled else "white"
        marks.append(
            Line2D(
                [],
                [],
                color=GREY,
                marker=marker,
                markerfacecolor=face,
                markersize=5,
                label=f"sphere {name}: median, 95 %",
            )
        )
    figure.legend(
        handles=[*marks, Line2D([], [], **PRINTED, label="printed")],
        loc="outside lower center",
        ncols=3,
    )
    headed(figure, "What does each method make of a scan of a sphere alone?")
    publish(figure, stem, pd.concat([table, printed.assign(state="printed")], ignore_index=True))


def cleaning(table: pd.DataFrame, printed: pd.DataFrame, stem: str) -> None:
    """Does any noise with any cleaning give both printed rows? σs over the error of the radius.

    One curve a method and scanner, its marks the half-widths to which the scan was cleaned.

    table : of `table3_settings.cleanings`; printed : of `table3_settings.printed_settings`.
    """
    figure, axes = new(1, 2, height=4.3, sharex=True, sharey=True)
    range_sds = table["range_sd_mm"].unique()
    widths = table["half_width_mm"].unique()
    for ax, (sphere, rows) in zip(axes, table.groupby("sphere", sort=False), strict=True):
        for method, (marker, x, y) in CURVES.items():
            colour = SPHERE_METHODS[method].colour
            for range_sd, line in zip(range_sds, LINES, strict=False):
                curve = rows[rows["range_sd_mm"] == range_sd]
                ax.plot(
                    curve[x],
                    curve[y],
                    marker=marker,
                    linestyle=line,
                    color=colour,
                    markersize=3.5,
                    linewidth=1.2,
                )
                if method == "ls" and range_sd == ASSUMED_RANGE_SD:
                    first, last = curve.iloc[0], curve.iloc[-1]
                    ax.annotate(
                        "sphere alone",
                        (first[x], first[y]),
                        (-5, 5),
                        **WORDS,
                        ha="right",
                        color=colour,
                    )
                    ax.annotate(
                        f"within {widths[-1]:g} mm",
                        (last[x], last[y]),
                        (6, -3),
                        **WORDS,
                        ha="left",
                        color=colour,
                    )
            seen = printed[printed["sphere"] == sphere]
            ax.plot(seen[x], seen[y], PRINTED_MARKERS[method], color=colour, zorder=5, **STAR)
        ax.axvline(0.0, color=GREY, linewidth=0.8, zorder=0)
        ax.set(
            title=f"Sphere {sphere}",
            yscale="log",
            xlim=(-8.5, 18),
            xlabel="error of the radius / mm",
        )
        ax.set_yticks([0.5, 1, 2, 5], ["0.5", "1", "2", "5"])
        ax.minorticks_off()
    axes[0].set_ylabel("σs / mm (IGG III-WTLS: in use)")
    handles = [
        *(
            Line2D(
                [],
                [],
                color=SPHERE_METHODS[m].colour,
                marker=CURVES[m][0],
                markersize=4,
                label=SPHERE_METHODS[m].label,
            )
            for m in CURVES
        ),
        *(
            Line2D([], [], color=GREY, linestyle=line, label=f"range σ {sd:g} mm")
            for sd, line in zip(range_sds, LINES, strict=False)
        ),
        *(
            Line2D(
                [],
                [],
                color=SPHERE_METHODS[m].colour,
                marker=PRINTED_MARKERS[m],
                label=f"{SPHERE_METHODS[m].label}, printed",
                **STAR,
            )
            for m in CURVES
        ),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4)
    headed(figure, "Does any noise with any cleaning give both printed rows?")
    publish(figure, stem, pd.concat([table, printed], ignore_index=True))
