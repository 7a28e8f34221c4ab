"""The figures of notebook 03."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.lines import Line2D
from numpy.typing import NDArray
from scipy.special import ndtri

from analysis.export.figures import GREY, GROSS, TRUTH, new
from analysis.methods import SPHERE_METHODS
from analysis.surfaces.sphere import SphereFit

from ..ou_liu_2017.clouds import GROSS_POINTS
from ..ou_liu_2017.printed_tables import METHODS, SYMBOLS, printed_numbers
from ..printed.comparison import OUTSIDE
from ..publish import publish

STEM = "03_sphere_tables"

MARKERS = dict(zip(SPHERE_METHODS, "osDv^pXhd<>", strict=False))
# Okabe & Ito, for the five gross errors
FIVE = ("#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7")
PARAMETERS = "abcr"
LOST = 0.5  # a final weight below which a point counts as given up
QUANTILES = (0.025, 0.25, 0.5, 0.75, 0.975)


def errors(studies: Mapping[int, Mapping[str, pd.DataFrame]], methods: Mapping[str, str]) -> None:
    """How large is the error of each parameter, by method? |Δ| over the redraws with the printed
    errors marked.

    studies : table -> variant -> trials; methods : variant -> name in `SPHERE_METHODS`, which gives
        label, colour and marker.
    """
    data = _error_quantiles(studies, methods)
    figure, axes = new(4, 2, height=7.6, sharex="col", sharey=True)
    for row, name in enumerate(PARAMETERS):
        for column, table in enumerate(studies):
            ax = axes[row, column]
            shown = data[(data["table"] == table) & (data["parameter"] == name)].reset_index(
                drop=True
            )
            for y, line in shown.iterrows():
                _error_line(ax, y, line)
            ax.set_yticks(range(len(shown)), shown["variant"])
            ax.set_ylim(len(shown) - 0.4, -0.6)
            ax.set_xscale("log")
            ax.grid(axis="y", visible=False)
        axes[row, 1].annotate(
            f"|Δ{name}|", (1.02, 0.5), xycoords="axes fraction", va="center", fontweight="bold"
        )
    for ax, title in zip(
        axes[0], ("Table 1: without gross errors", "Table 2: with five gross errors"), strict=True
    ):
        ax.set_title(title)
    for ax in axes[-1]:
        ax.set_xlabel("absolute error / mm")
    axes[0, 0].set_xlim(0.008, 8)
    axes[0, 1].set_xlim(0.008, 4e4)
    handles = [
        Line2D([], [], color=GREY, lw=1.2, label="95 % of the redraws"),
        Line2D([], [], color=GREY, lw=5, label="half of them"),
        Line2D([], [], color=GREY, marker="o", ls="", markeredgecolor="white", label="median"),
        Line2D(
            [],
            [],
            color=TRUTH,
            marker="|",
            markersize=11,
            markeredgewidth=2,
            ls="",
            label="printed (arrow: 0)",
        ),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4)
    publish(figure, f"{STEM}_errors", data)


def _error_line(ax, y, line):
    """Interval, box, median and the printed number of one variant."""
    colour, marker = SPHERE_METHODS[line["method"]].colour, MARKERS[line["method"]]
    ax.plot(
        [max(line["q025_mm"], 1e-3), line["q975_mm"]],
        [y, y],
        color=colour,
        lw=1.2,
        solid_capstyle="butt",
    )
    ax.plot([line["q25_mm"], line["q75_mm"]], [y, y], color=colour, lw=5, solid_capstyle="butt")
    ax.plot(
        line["q50_mm"], y, marker=marker, color=colour, markeredgecolor="white", markersize=7, ls=""
    )
    if line["printed_mm"] > 0:
        ax.plot(
            line["printed_mm"], y, marker="|", color=TRUTH, markersize=11, markeredgewidth=2, ls=""
        )
    elif line["printed_mm"] == 0:
        ax.annotate(
            "",
            (0.0, y),
            (0.07, y),
            xycoords=("axes fraction", "data"),
            arrowprops={"arrowstyle": "-|>", "color": TRUTH},
        )


def _error_quantiles(studies, methods) -> pd.DataFrame:
    rows = []
    for table, study in studies.items():
        numbers = {(n.method, n.quantity): n.value for n in printed_numbers(table)}
        for name in PARAMETERS:
            for variant, method in methods.items():
                size = 1e3 * study[variant][f"delta_{name}_m"].abs()
                row = {"table": table, "parameter": name, "variant": variant, "method": method}
                row |= {f"q{str(q)[2:]:0<2}_mm": size.quantile(q) for q in QUANTILES}
                # Printed are the defaults of a method, not its other variants.
                default = variant == SPHERE_METHODS[method].label
                row["printed_mm"] = (
                    1e3 * numbers.get((method, f"abs_delta_{name}_m"), np.nan)
                    if default
                    else np.nan
                )
                rows.append(row)
    return pd.DataFrame(rows)


def positions(comparisons: Sequence[pd.DataFrame]) -> None:
    """Where does each printed number lie among the redraws? Its percentile, on a scale even for
    normal errors.
    """
    figure, axes = new(1, 2, height=4.6, sharex=True, sharey=True)
    data = pd.concat(comparisons, ignore_index=True)[
        ["table", "method", "quantity", "printed", "percentile", "verdict"]
    ]
    limit = ndtri(1e-4)
    for ax, (table, frame) in zip(axes, data.groupby("table"), strict=True):
        ax.axvspan(ndtri(0.025), ndtri(0.975), color="#EDEDED", zorder=0)
        ax.axvline(0, color=GREY, lw=0.8)
        for place, line in enumerate(frame.itertuples()):
            y = place + place // len(SYMBOLS)
            z = np.clip(ndtri(line.percentile / 100), limit, -limit)
            outside = line.verdict == OUTSIDE
            colour = SPHERE_METHODS[line.method].colour
            face = "white" if outside else colour
            ax.plot(
                z,
                y,
                MARKERS[line.method],
                color=colour,
                markersize=7,
                markerfacecolor=face,
                markeredgewidth=1.6,
            )
        ax.set_title(
            f"Table {table}: {(frame['verdict'] == OUTSIDE).sum()} of {len(frame)} outside"
        )
        ticks = np.array([0.01, 0.5, 2.5, 16, 50, 84, 97.5, 99.5, 99.99])
        words = [f"{tick:g}" for tick in ticks]
        ax.set_xticks(
            ndtri(ticks / 100), ["≤ " + words[0], *words[1:-1], "≥ " + words[-1]], fontsize=7
        )
        ax.set_xlabel("percentile among the redraws (grey: central 95 %)")
        ax.grid(axis="y", visible=False)
    count = len(SYMBOLS)
    labels = [
        (i + i // count, symbol) for i, symbol in enumerate(list(SYMBOLS.values()) * len(METHODS))
    ]
    axes[0].set_yticks(*zip(*labels, strict=True))
    axes[0].set_ylim(labels[-1][0] + 0.7, -0.7)
    handles = [
        Line2D(
            [],
            [],
            color=SPHERE_METHODS[m].colour,
            marker=MARKERS[m],
            ls="",
            markersize=7,
            label=SPHERE_METHODS[m].label,
        )
        for m in METHODS.values()
    ]
    hollow = {"marker": "o", "markersize": 7, "markerfacecolor": "white", "markeredgewidth": 1.6}
    handles.append(Line2D([], [], color=TRUTH, ls="", label="outside", **hollow))
    figure.legend(handles=handles, loc="outside lower center", ncols=4)
    publish(figure, f"{STEM}_positions", data)


def maps(
    clean: NDArray[np.float64], gross: NDArray[np.float64], fits: Mapping[str, SphereFit]
) -> None:
    """Which residuals are left, and which points keep their weight? The cap from above.

    clean, gross : (500, 3) the committed clouds, m; fits : ``ls gross``, ``igg gross``,
        ``igg clean`` of these clouds.
    """
    lost = {name: int(np.count_nonzero(fit.weights < LOST)) for name, fit in fits.items()}
    panels = {
        "LS residuals: five errors bend the fit": (
            gross,
            1e3 * fits["ls gross"].distances,
            "ls gross",
        ),
        "IGG III-WTLS residuals: only noise": (
            gross,
            1e3 * fits["igg gross"].distances,
            "igg gross",
        ),
        f"IGG III weights: {lost['igg gross']} lost, all gross": (
            gross,
            fits["igg gross"].weights,
            "igg gross",
        ),
        f"… without gross errors: {lost['igg clean']} lost": (
            clean,
            fits["igg clean"].weights,
            "igg clean",
        ),
    }
    figure, axes = new(2, 2, height=6.6, sharex=True, sharey=True)
    frames = []
    for ax, (title, (points, values, name)) in zip(axes.flat, panels.items(), strict=True):
        residuals = "residuals" in title
        marked = np.isin(np.arange(1, len(points) + 1), GROSS_POINTS) & ("gross" in name)
        limit = {"ls gross": 80, "igg gross": 8}[name] if residuals else 1
        colours = (
            {"cmap": "RdBu_r", "vmin": -limit, "vmax": limit}
            if residuals
            else {"cmap": "viridis", "vmin": 0, "vmax": 1}
        )
        light = ~marked & (residuals | (values >= LOST))
        dark = ~marked & ~light
        drawn = ax.scatter(
            *points[light, :2].T, c=values[light], s=13, edgecolors=GREY, linewidths=0.3, **colours
        )
        ax.scatter(
            *points[dark, :2].T,
            c=values[dark],
            s=26,
            marker="X",
            edgecolors="white",
            linewidths=0.3,
            **colours,
        )
        ax.scatter(
            *points[marked, :2].T,
            s=70,
            marker="s",
            facecolors="none",
            edgecolors=GROSS,
            linewidths=1.6,
        )
        ax.scatter(*points[marked, :2].T, c=values[marked], s=22, marker="X", **colours)
        for number, place, value in zip(
            np.flatnonzero(marked) + 1, points[marked], values[marked], strict=True
        ):
            text = f"{number}: {value / 1e3:.1f} m".replace("-", "−") if residuals else f"{number}"
            side, align = (-5, "right") if number == 53 else (5, "left")  # 67 is on its right
            box = {"fc": "white", "ec": "none", "pad": 0.6, "alpha": 0.8}
            ax.annotate(
                text,
                place[:2],
                (side, 6),
                textcoords="offset points",
                ha=align,
                fontsize=7,
                bbox=box,
            )
        ax.set_title(title)
        ax.set_aspect("equal")
        ax.set_xticks(range(0, 21, 5))
        label, extend = ("distance / mm", "both") if residuals else ("final weight", "neither")
        figure.colorbar(drawn, ax=ax, label=label, shrink=0.85, extend=extend)
        frame = {
            "panel": title,
            "number": np.arange(1, len(points) + 1),
            "x_m": points[:, 0],
            "y_m": points[:, 1],
            "value": values,
        }
        frames.append(pd.DataFrame(frame))
    for ax in axes[-1]:
        ax.set_xlabel("x / m")
    for ax in axes[:, 0]:
        ax.set_ylabel("y / m")
    square = {
        "marker": "s",
        "markersize": 8,
        "markerfacecolor": "none",
        "markeredgecolor": GROSS,
        "markeredgewidth": 1.6,
    }
    handles = [
        Line2D([], [], ls="", label="gross error", **square),
        Line2D(
            [], [], marker="X", ls="", markersize=6, color="#440154", label=f"weight below {LOST:g}"
        ),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=2)
    publish(figure, f"{STEM}_maps", pd.concat(frames))


def weights(histories: Mapping[str, tuple[NDArray[np.float64], SphereFit]]) -> None:
    """When does each gross error lose its weight? One panel a case, ten iterations.

    histories : title -> (depth of the five gross errors in m, fit that kept its history).
    """
    figure, axes = new(1, len(histories), height=2.9, sharey=True)
    frames = []
    for ax, (title, (depths, fit)) in zip(axes, histories.items(), strict=True):
        table = np.array([step.weights for step in fit.history[:10]])
        iteration = np.arange(1, len(table) + 1)
        for i, (number, depth) in enumerate(zip(GROSS_POINTS, depths, strict=True)):
            weight = table[:, number - 1]
            size = f"{depth:.1f} m" if depth > 1 else f"{1e3 * depth:.0f} mm"
            ax.plot(
                iteration,
                weight,
                marker="osDv^"[i],
                markersize=4.5,
                color=FIVE[i],
                label=f"{number}: {size}",
            )
            frames.append(
                pd.DataFrame(
                    {
                        "case": title,
                        "number": number,
                        "depth_m": depth,
                        "iteration": iteration,
                        "weight": weight,
                    }
                )
            )
        ax.set_title(title)
        ax.set_xlim(0.8, 10.2)
        ax.set_xticks(range(1, 11))
        ax.set_xlabel("iteration")
        ax.legend(title="point and depth", fontsize=7, title_fontsize=7, loc="upper right")
    axes[0].set_ylabel("weight used in the iteration")
    publish(figure, f"{STEM}_weights", pd.concat(frames))
