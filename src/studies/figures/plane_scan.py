"""The figures of notebook 08: a cluttered ground scan, errors and stated accuracy, and how the
algorithms converge.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.lines import Line2D

from analysis.adjustment.algorithms import ALGORITHMS
from analysis.export.figures import GREY, GROSS, headed, new
from analysis.methods import PLANE_METHODS
from analysis.surfaces.plane import PlaneFit

from ..convergence import RUNS, problems
from ..publish import publish
from ..simulation.scenes import Scan
from ..wu_chen_wang.ground_scan import COMPARED, truth

STEM = "08_plane_scan"
FLOOR = 1e-16  # where an excess that rounding has swallowed is drawn

LINES = {
    "ls": "-",
    "tls": "--",
    "mixed_ls_tls": ":",
    "wtls": "-",
    "wtls, projected": "--",
    "eiv": "-.",
    "robust": "-",
}
MARKS = {
    "ls": "o",
    "tls": "s",
    "mixed_ls_tls": "D",
    "wtls": "v",
    "wtls, projected": "^",
    "eiv": "P",
    "robust": "h",
}
CODES = {"ground": (GREY, "."), "stone": (GROSS, "x"), "post": (GROSS, "+"), "mixed": (GROSS, "1")}
ALGORITHM_LINES = {
    "newton": ("o", "-"),
    "bfgs": ("s", "-"),
    "dfp": ("D", "-"),
    "schaffrin_wieser": ("v", "-"),
    "shen": ("P", "-"),
    "amiri_simkooei": ("x", "--"),
    "fang": ("^", "-."),
    "mahboub": ("d", ":"),
}


def clutter(whole: Scan, fits: Mapping[str, PlaneFit], height: float) -> None:
    """Side view of a cluttered scan over the true ground, with what every method takes for the
    ground below the line of sight.
    """
    figure, ax = new(height=3.9)
    a, b, c = truth(height)
    x, y, z = whole.points.T
    above = 100.0 * (z - (a * x + b * y + c))
    handles = []
    for name, (colour, marker) in CODES.items():
        on = whole.on(name)
        if on.any():
            label = f"{name} ({np.count_nonzero(on)} points)"
            handles += ax.plot(
                y[on], above[on], marker, color=colour, markersize=4, label=label, rasterized=True
            )
    line = np.array([y.min(), y.max()])
    profiles = []
    for name, fit in fits.items():
        profile = 100.0 * ((fit.parameters[1] - b) * line + fit.parameters[2] - c)
        colour = PLANE_METHODS[COMPARED[name][0]].colour
        handles += ax.plot(
            line, profile, LINES[name], color=colour, linewidth=1.8, label=COMPARED[name][3]
        )
        profiles.append(pd.DataFrame({"kind": name, "y_m": line, "above_cm": profile}))
    ax.set_ylim(-3.0, 8.0)
    ax.set_xlabel("distance from the scanner / m")
    ax.set_ylabel("height over the true ground / cm")
    headed(
        figure,
        "What do stones do to the ground? One scan from the side; higher points are cut off",
        handles,
        4,
    )
    points = pd.DataFrame({"kind": whole.labels, "y_m": y, "above_cm": above})
    publish(figure, f"{STEM}_clutter", pd.concat([points, *profiles]))


def accuracy(tables: Mapping[str, pd.DataFrame]) -> None:
    """Error of the height and its stated standard deviation, a panel each for the scenes; tables
    from :func:`plane_scan.accuracy`.
    """
    figure, axes = new(1, len(tables), height=3.2, sharex=True, sharey=True)
    names = {words: (name, method) for name, (method, _, _, words) in COMPARED.items()}
    for ax, (scene, table) in zip(axes, tables.items(), strict=True):
        for y, row in enumerate(table.itertuples()):
            name, method = names[row.method]
            style = {
                "color": PLANE_METHODS[method].colour,
                "marker": MARKS[name],
                "linestyle": "none",
            }
            ax.plot(row.claimed_mm, y, markerfacecolor="white", markersize=9, **style)
            ax.plot(row.height_mm, y, markersize=5, **style)
            ax.annotate(
                f"{row.held_percent:.0f} %",
                (1.0, y),
                xycoords=("axes fraction", "data"),
                ha="right",
                va="center",
                fontsize=7.5,
            )
        ax.set_title(f"{scene[0].upper()}{scene[1:]}")
        ax.set_xscale("log")
        ax.grid(axis="y", visible=False)
        ax.set_xlabel("height in the middle of the patch / mm")
    axes[0].set_yticks(range(len(table)), table["method"])
    axes[0].set_ylim(len(table) - 0.5, -0.5)
    axes[0].set_xlim(0.03, 60)
    axes[0].set_xticks([0.1, 1, 10], ["0.1", "1", "10"])
    handles = [
        Line2D([], [], color=GREY, marker="o", markersize=5, linestyle="none", label="RMS error"),
        Line2D(
            [],
            [],
            color=GREY,
            marker="o",
            markersize=9,
            markerfacecolor="white",
            linestyle="none",
            label="stated standard deviation",
        ),
        Line2D([], [], linestyle="none", label="right: 95 % ellipsoids that hold the truth"),
    ]
    headed(figure, "Is the ground where the methods say, and do they know how well?", handles, 3)
    publish(
        figure,
        f"{STEM}_accuracy",
        pd.concat([table.assign(scene=scene) for scene, table in tables.items()]),
    )


def convergence(history: pd.DataFrame) -> None:
    """Excess of Φ over its minimum against the iteration, for every algorithm, a panel per problem;
    history from `convergence.study`.
    """
    labels = {name: problem.label for name, problem in problems().items()}
    figure, axes = new(1, len(labels), height=4.2, sharey=True, width_ratios=(1.5, 1, 1))
    for ax, (problem, rows) in zip(axes, history.groupby("problem", sort=False), strict=True):
        for run, steps in rows.groupby("run", sort=False):
            algorithm, H_0, label = RUNS[run]
            marker, line = ALGORITHM_LINES[algorithm]
            colour, unit = ALGORITHMS[algorithm].colour, H_0 == "identity"
            style = {
                "color": colour,
                "linestyle": ":" if unit else line,
                "marker": marker,
                "markersize": 4.5,
                "label": label,
            }
            every = max(1, len(steps) // 12)
            face = "white" if unit else colour
            ax.plot(
                steps["iteration"],
                np.maximum(steps["excess"], FLOOR),
                markevery=every,
                markerfacecolor=face,
                **style,
            )
        ax.set_title(labels[problem][0].upper() + labels[problem][1:])
        ax.set_xlabel("iteration")
    axes[0].set_xscale("symlog", linthresh=10, linscale=1.0)
    axes[0].set_xticks([0, 2, 5, 10, 20, 50, 100], ["0", "2", "5", "10", "20", "50", "100"])
    axes[0].minorticks_off()
    axes[0].set_yscale("log")
    axes[0].set_ylabel("(Φ − Φ min) / Φ min")
    headed(
        figure,
        "How fast do the algorithms reach the minimum?",
        axes[0].get_legend_handles_labels()[0],
        4,
    )
    publish(figure, f"{STEM}_convergence", history)
