"""The figures of notebook 02: what each reading of the paper changes, and what the origin of
coordinates does.
"""

from __future__ import annotations

from itertools import cycle

import pandas as pd

from analysis.export.figures import TRUTH, headed, new
from analysis.methods import SPHERE_METHODS

from ..ou_liu_2017.clouds import SPHERE_POINTS
from ..ou_liu_2017.origin import LABELS, RAW
from ..ou_liu_2017.readings import BREAKDOWN, NOTHING, SHARE, SIGMA_0, SPHERE
from ..publish import publish

STEM = "02_sphere_methods"

# What a change does: marker, colour, whether filled, and its words in the legend.
VERDICTS = {
    SPHERE: ("o", "#D55E00", True, "matters: another sphere"),
    BREAKDOWN: ("X", "#000000", True, "breaks down"),
    SIGMA_0: ("s", "#0072B2", False, "changes σ0 only"),
    NOTHING: ("o", "#8C8C8C", False, "does not matter"),
}
NONE, FAILED = 2e-4, 5e2  # mm, where "no change" and "no sphere" stand on the logarithmic axis
# One after the other for the methods in their order: curves that coincide stay readable by the
# markers inside one another.
MARKERS = [
    {"marker": "o", "linestyle": "-", "markersize": 9, "markerfacecolor": "white"},
    {"marker": "v", "linestyle": "-", "markersize": 5},
    {"marker": "D", "linestyle": "--", "markersize": 5, "markerfacecolor": "white"},
    {"marker": "s", "linestyle": "-.", "markersize": 3.5},
    {"marker": "^", "linestyle": "-", "markersize": 5},
    {"marker": "P", "linestyle": "--", "markersize": 5},
    {"marker": "d", "linestyle": "-.", "markersize": 5},
    {"marker": "*", "linestyle": "-", "markersize": 6},
]
RAW_STYLE = {"color": "#7A1FA2", "marker": "x", "linestyle": ":", "markersize": 5}
TITLES = {"clean": "Without gross errors", "gross": "With five gross errors"}


def readings(changes: pd.DataFrame, sd_center: float) -> None:
    """How far the centre moves from the literal to the other reading of each place, clean and gross
    side by side.

    Parameters: changes, from :func:`readings.study`, exported as it is; sd_center in m, the
    standard deviation of the LS centre.
    """
    places = changes.drop_duplicates("reading")
    names = places["reading"].tolist()
    prefixes = places["equation"].map(
        lambda equation: "" if equation.startswith("step") else "eq. "
    )
    labels = places["reading"] + "  (" + prefixes + places["equation"] + ")"
    figure, axes = new(1, 2, height=4.4, sharey=True, sharex=True)
    for panel, (cloud, rows) in zip(axes, changes.groupby("cloud", sort=False), strict=True):
        panel.axvspan(1e3 * SHARE * sd_center, 1e4, color="#F6EAE1", zorder=0)
        panel.axvline(1e3 * sd_center, color=TRUTH, linewidth=1, linestyle="--")
        panel.text(1.2e3 * sd_center, -0.8, "sd of the LS centre", fontsize=7.5)
        for row in rows.itertuples():
            marker, colour, filled, _ = VERDICTS[row.matters]
            x = FAILED if pd.isna(row.center_mm) else max(row.center_mm, NONE)
            y = names.index(row.reading)
            panel.plot(
                x,
                y,
                marker,
                color=colour,
                markerfacecolor=colour if filled else "white",
                markersize=6,
            )
            if row.matters == BREAKDOWN:
                left = (
                    f"{SPHERE_POINTS - row.rejected_other} of {SPHERE_POINTS} left"
                    if row.center_mm > 0
                    else "no sphere"
                )
                side = "left" if row.center_mm > 0 else "right"
                panel.annotate(f"   {left}   ", (x, y), ha=side, va="center", fontsize=7.5)
        panel.set_title(TITLES[cloud])
        panel.set_xscale("log")
        panel.set_xlim(NONE / 3, 3e3)
        panel.set_xticks([NONE, 1e-2, 1e-1, 1, 10, 100], ["none", "0.01", "0.1", "1", "10", "100"])
        panel.minorticks_off()
        panel.set_xlabel("the centre moves by / mm")
    axes[0].set_yticks(range(len(names)), labels)
    axes[0].set_ylim(len(names) - 0.4, -1.3)
    for marker, colour, filled, words in VERDICTS.values():
        axes[0].plot(
            [],
            [],
            marker,
            color=colour,
            markerfacecolor=colour if filled else "white",
            markersize=6,
            label=words,
        )
    headed(
        figure,
        "Which places of the paper, read in another way, give another sphere?",
        axes[0].get_legend_handles_labels()[0],
        4,
    )
    publish(figure, f"{STEM}_readings", changes)


def origin(answers: pd.DataFrame) -> None:
    """Error of the centre by each method against the shift of the coordinates along x, gross and
    clean.

    Parameters: answers, from :func:`origin.study`, exported as it is.
    """
    figure, axes = new(1, 2, height=4.2, sharex=True)
    for panel, cloud in zip(axes, ("gross", "clean"), strict=True):
        panel.axvspan(3.5e5, 6e6, color="#EDEDED", zorder=0)
        rows = answers[answers["cloud"] == cloud]
        for (method, known), style in zip(SPHERE_METHODS.items(), cycle(MARKERS)):
            _curve(panel, rows[rows["method"] == method], {"color": known.colour} | style)
        _curve(panel, rows[rows["method"] == RAW], RAW_STYLE)
        panel.set_title(TITLES[cloud])
        panel.set_xscale("symlog", linthresh=1, linscale=0.6)
        panel.set_yscale("log")
        panel.set_xticks(
            [0, 1, 10, 100, 1e3, 1e4, 1e5, 1e6, 1e7],
            ["0", "1", "10", "100", "10³", "10⁴", "10⁵", "10⁶", "10⁷"],
        )
        panel.set_xlim(-0.3, 2e7)
        panel.set_xlabel("shift of the points along x / m")
        panel.minorticks_off()
    axes[0].text(1.5e6, 30, "national grids", rotation=90, ha="center", va="top", fontsize=7.5)
    axes[0].set_ylabel("error of the centre / mm")
    axes[0].set_ylim(0.3, 3e4)
    axes[0].set_yticks([1, 10, 100, 1e3, 1e4], ["1", "10", "100", "1000", "10 000"])
    axes[1].set_ylim(0.2, 30)
    axes[1].set_yticks([0.2, 0.5, 1, 2, 5, 10, 20], ["0.2", "0.5", "1", "2", "5", "10", "20"])
    headed(
        figure,
        "The same points in other frames: which methods give the same sphere?",
        axes[0].get_legend_handles_labels()[0],
        3,
    )
    publish(figure, f"{STEM}_origin", answers)


def _curve(panel, rows: pd.DataFrame, style: dict) -> None:
    """One method: its curve, and an arrow to where its answers drown in rounding errors."""
    label = LABELS[rows["method"].iloc[0]]
    panel.plot(rows["shift_m"], 1e3 * rows["center_error_m"], label=label, **style)
    if rows["lost"].any():
        first = rows[rows["lost"]]["shift_m"].min()
        last = 1e3 * rows[rows["shift_m"] < first]["center_error_m"].iloc[-1]
        arrow = {"arrowstyle": "-|>", "color": style["color"], "linewidth": 0.8}
        place = {"xytext": (-10, -36), "textcoords": "offset points", "ha": "right"}
        panel.annotate(
            f"{label}:\nlost in rounding",
            (first, last),
            **place,
            fontsize=7.5,
            color=style["color"],
            arrowprops=arrow,
        )
