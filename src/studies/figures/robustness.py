"""The figures of notebook 06. Bars are 95 % intervals of the Monte Carlo error throughout."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.lines import Line2D

from analysis.export.figures import GREY, TRUTH, headed, new
from analysis.methods import SPHERE_METHODS

from ..publish import publish
from ..robustness.bias import CENTROID, CORRECTED
from ..robustness.breakdown import GOOD_POINTS, PATTERNS
from ..robustness.redraws import share_interval

STEM = "06_robustness"
LABELS = {name: method.label for name, method in SPHERE_METHODS.items()}
LOWEST = 80.0  # %, of coverage against the number of points; what is below is written down
LOWER_LEFT = {"ha": "left", "va": "bottom", "fontsize": 7.5, "color": GREY}
TWO_SIDED = 1.96  # standard errors to either side

# Variants have the colour of their method. Marker, its size, line style, marker filled or not,
# label; where curves coincide the first drawn are the largest.
VARIANTS = {
    "ls": ("o", 9.5, "-", False, LABELS["ls"]),
    "tls": ("s", 8, "-", True, LABELS["tls"]),
    "mixed_ls_tls": ("D", 6.5, "-", True, LABELS["mixed_ls_tls"]),
    "wtls": ("v", 4, "-", True, LABELS["wtls"]),
    CENTROID: ("v", 5, "--", False, "WTLS, centroid as origin"),
    "igg3_wtls": ("^", 5.5, "-", True, LABELS["igg3_wtls"]),
    "igg3_wtls, not cumulative": ("^", 5.5, "--", False, "IGG III-WTLS, not cumulative"),
    "igg3_wtls, not cumulative, MAD": ("<", 5.5, ":", True, "IGG III-WTLS, not cumulative, MAD"),
    "eiv": ("P", 6.5, "-", True, LABELS["eiv"]),
    "geometric": ("X", 9, "-", True, LABELS["geometric"]),
    CORRECTED: ("X", 6.5, "--", False, "orthogonal distance, corrected"),
    "robust": ("h", 4.5, "-", True, "robust"),
    "robust, k0 = 1.5, k1 = 2.5": ("h", 5.5, "-", False, "robust, k0 = 1.5, k1 = 2.5 (printed)"),
    "robust, k0 = 2.5, k1 = 5": ("h", 5.5, "-", False, "robust, k0 = 2.5, k1 = 5"),
}


def _style(variant: str) -> dict:
    """Keywords of plot and errorbar for a variant."""
    marker, size, line, filled, label = VARIANTS[variant]
    colour = SPHERE_METHODS[variant.split(",")[0]].colour
    face = colour if filled else "white"
    return {
        "color": colour,
        "marker": marker,
        "markersize": size,
        "linestyle": line,
        "markerfacecolor": face,
        "label": label,
    }


def bias(table: pd.DataFrame, half_angle: float, sigma: float) -> None:
    """Bias of centre and radius against the half angle of the cap at noise `sigma` (m), and against
    the noise at `half_angle` (degrees).
    """
    figure, axes = new(2, 2, height=6.0, sharex="col", sharey=True)
    at_sigma, at_angle = (
        np.isclose(table["sigma_mm"], 1e3 * sigma),
        table["half_angle_deg"] == half_angle,
    )
    sections = [
        (
            table[at_sigma],
            "half_angle_deg",
            f"noise {1e3 * sigma:g} mm",
            "half angle of the cap seen / °",
        ),
        (
            table[at_angle],
            "sigma_mm",
            f"half angle {half_angle:g}°",
            "noise of a coordinate / mm (radius 72.5 mm)",
        ),
    ]
    for column, (section, x, where, words) in enumerate(sections):
        for row, (y, of) in enumerate({"along": "Centre", "radius": "Radius"}.items()):
            ax = axes[row, column]
            ax.axhline(0.0, color=TRUTH, linewidth=0.8)
            handles = []
            for variant, lines in section.groupby("variant", sort=False):
                bars = TWO_SIDED * lines[f"{y}_se_mm"]
                handles.append(
                    ax.errorbar(
                        lines[x], lines[f"{y}_mm"], bars, capsize=2, elinewidth=1, **_style(variant)
                    )
                )
            ax.set_title(f"{of}: {where}")
            ax.set_xscale("log" if x == "sigma_mm" else "linear")
        axes[1, column].set_xticks(
            section[x].unique(), [f"{value:g}" for value in section[x].unique()]
        )
        axes[1, column].minorticks_off()
        axes[1, column].set_xlabel(words)
    of = ("centre / mm\n← towards the scanner", "radius / mm\n← too small")
    for ax, words in zip(axes[:, 0], of, strict=True):
        ax.set_yscale("symlog", linthresh=0.1, linscale=1.2)
        ax.set_yticks([-10, -1, -0.1, 0, 0.1, 1], ["−10", "−1", "−0.1", "0", "0.1", "1"])
        ax.minorticks_off()
        ax.set_ylabel(f"bias of the {words}")
    headed(
        figure,
        "Which methods are off in the mean? Centre (along the line of sight) and radius",
        handles,
        3,
    )
    publish(figure, f"{STEM}_bias", table)


def efficiency(table: pd.DataFrame) -> None:
    """Standard deviation of the centre relative to the orthogonal distance fit, clean normal data,
    beside theory.
    """
    figure, ax = new(height=3.7)
    ax.axvline(1.0, color=GREY, linewidth=0.8)
    mark = {
        "color": TRUTH,
        "markersize": 16,
        "markeredgewidth": 1.4,
        "label": "theory of the weight function",
    }
    for y, row in enumerate(table.itertuples()):
        words = f"efficiency {row.efficiency_percent:.0f} %"
        if not np.isnan(row.theory_percent):
            (theory,) = ax.plot((row.theory_percent / 100) ** -0.5, y, "|", **mark)
            words += f" (theory {row.theory_percent:.0f} %)"
        ax.errorbar(
            row.sd_ratio, y, xerr=TWO_SIDED * row.sd_ratio_se, capsize=3, **_style(row.variant)
        )
        ax.annotate(
            words,
            (1.0, y),
            xycoords=("axes fraction", "data"),
            ha="right",
            va="center",
            fontsize=7.5,
        )
    ax.set_yticks(range(len(table)), [VARIANTS[variant][4] for variant in table["variant"]])
    ax.set_ylim(len(table) - 0.4, -0.6)
    ax.set_xlim(0.97, 1.85)
    ax.grid(axis="y", visible=False)
    ax.set_xlabel("standard deviation of the centre relative to the orthogonal distance fit")
    headed(figure, "What does robustness cost on clean data?", [theory], 1)
    publish(figure, f"{STEM}_efficiency", table)


def breakdown(table: pd.DataFrame) -> None:
    """Share of the runs within 10 mm against the share of gross errors, one panel a pattern."""
    figure, axes = new(1, len(PATTERNS), height=4.3, sharex=True, sharey=True)
    for ax, (pattern, words) in zip(axes, PATTERNS.items(), strict=True):
        handles = []
        for variant, lines in table[
            (table["pattern"] == pattern) & (table["variant"] != GOOD_POINTS)
        ].groupby("variant", sort=False):
            share = lines["within_percent"]
            bars = np.maximum([share - lines["low_percent"], lines["high_percent"] - share], 0.0)
            style = {"capsize": 2, "elinewidth": 1, "clip_on": False} | _style(variant)
            handles.append(ax.errorbar(lines["gross_percent"], share, bars, **style))
        ax.set_title(f"{pattern.capitalize()}: {words}", fontsize=8.5)
        ax.set_xlabel("gross errors / %")
    line = {"arrowstyle": "-", "color": GREY}
    axes[2].annotate(
        "all six without\nrobust weights",
        (3.4, 32),
        (12, 24),
        fontsize=7.5,
        color=GREY,
        va="center",
        arrowprops=line,
    )
    axes[0].set_xticks(range(0, round(table["gross_percent"].max()) + 1, 10))
    axes[0].set_ylabel("redraws with the centre within 10 mm / %")
    axes[0].set_ylim(-2, 102)
    headed(figure, "How many gross errors does each method bear?", handles, 3)
    publish(figure, f"{STEM}_breakdown", table)


def coverage(table: pd.DataFrame) -> None:
    """How often the 95 % ellipsoid holds the truth: one row of panels a noise, at the right the
    part about 95 % enlarged.
    """
    noises, methods = table["noise"].unique(), list(dict.fromkeys(table["method"]))
    figure, axes = new(
        len(noises),
        2,
        height=0.8 + 1.9 * len(noises),
        sharey=True,
        sharex="col",
        width_ratios=(1.3, 1),
    )
    for panels, noise in zip(axes, noises, strict=True):
        for ax in panels:
            ax.axvspan(94, 96, color="#E2E2E2", zorder=0)
            ax.axvline(95, color=TRUTH, linewidth=0.8)
            for row in table[table["noise"] == noise].itertuples():
                style = _style(row.method) | {"markersize": 6}
                style["markerfacecolor"] = "white" if row.gross_percent else style["color"]
                y = methods.index(row.method) + (0.18 if row.gross_percent else -0.18)
                bars = np.abs(
                    [[row.held_percent - row.low_percent], [row.high_percent - row.held_percent]]
                )
                ax.errorbar(row.held_percent, y, xerr=bars, capsize=3, **style)
            ax.grid(axis="y", visible=False)
        panels[0].set_title(f"Noise: {noise}")
        panels[1].set_title("enlarged about 95 %")
    axes[0, 0].set_yticks(range(len(methods)), [LABELS[name] for name in methods])
    axes[0, 0].set_ylim(len(methods) - 0.5, -0.5)
    axes[0, 0].set_xlim(-3, 101)
    axes[0, 1].set_xlim(92.4, 97.6)
    axes[-1, 0].set_xlabel("redraws whose ellipsoid holds the truth / %")
    axes[-1, 1].set_xlabel("the same / %")
    shares = sorted(table["gross_percent"].unique())
    marks = [
        Line2D(
            [],
            [],
            color=GREY,
            marker="o",
            linestyle="none",
            markerfacecolor="white" if share else GREY,
            label=words,
        )
        for share, words in zip(
            shares, ["clean", *(f"{share:g} % gross errors" for share in shares[1:])], strict=True
        )
    ]
    headed(
        figure,
        "Can the stated covariance be believed? The 95 % ellipsoid of (a, b, c, r)",
        marks,
        2,
    )
    publish(figure, f"{STEM}_coverage", table)


def coverage_against_points(table: pd.DataFrame) -> None:
    """How often the 95 % ellipsoid holds the truth, against the number of points: one panel per
    surface.
    """
    surfaces = list(dict.fromkeys(table["surface"]))
    figure, axes = new(1, len(surfaces), height=3.2, sharey=True, sharex=True)
    for ax, surface in zip(axes, surfaces, strict=True):
        ax.axhline(95, color=TRUTH, linewidth=0.8)
        below = []
        groups = table[table["surface"] == surface].groupby("method", sort=False)
        for (method, rows), beside in zip(groups, (0.95, 1.05), strict=True):
            held, style = rows["held_percent"], _style(method) | {"markersize": 4.5}
            bars = np.abs(rows[["low_percent", "high_percent"]].T - held)
            ax.errorbar(rows["points"] * beside, held, yerr=bars, elinewidth=1, **style)
            out = zip(rows["points"], held, strict=True)
            below += [f"{n} points: {percent:.0f} %" for n, percent in out if percent < LOWEST]
        if below:
            ax.text(0.04, 0.03, "\n".join(["below:", *below]), **LOWER_LEFT, transform=ax.transAxes)
        ax.set_xscale("log")
        ax.set_ylim(LOWEST, 100)
        ax.set_title(surface)
        ax.set_xlabel("points")
    axes[0].set_ylabel("redraws that hold the truth / %")
    handles, _ = axes[0].get_legend_handles_labels()
    headed(
        figure, "Does the 95 % ellipsoid hold the truth, for few points and for many?", handles, 2
    )
    publish(figure, f"{STEM}_coverage_points", table)


# Variants of the scale: marker, line style; all in the colour of the method.
SCALES = {
    "rms, cumulative": ("^", "-", "rms of all points (literal), cumulative"),
    "weighted, cumulative": ("o", "-", "weighted rms, cumulative"),
    "weighted, not cumulative": ("o", "--", "weighted rms, not cumulative"),
    "weighted consistent, cumulative": ("s", "-", "weighted rms made consistent, cumulative"),
    "weighted consistent, not cumulative": (
        "s",
        "--",
        "weighted rms made consistent, not cumulative",
    ),
}


def collapse(history: pd.DataFrame, redraws: pd.DataFrame, last: int) -> None:
    """Points left and σ over the first `last` iterations on one cloud; and how many points are left
    at the end, over the redraws.
    """
    figure, axes = new(1, 3, height=4.2)
    distribution = _distribution(redraws)
    for variant, (marker, line, label) in SCALES.items():
        steps = history[(history["variant"] == variant) & (history["iteration"] <= last)]
        ends = distribution[distribution["variant"] == variant]
        filled = line == "-"
        colour = SPHERE_METHODS["igg3_wtls"].colour
        style = {
            "color": colour,
            "linestyle": line,
            "linewidth": 2.4 if variant == "weighted, cumulative" else 1.2,
            "label": label,
        }
        marks = {
            "marker": marker,
            "markersize": 4.5,
            "markerfacecolor": colour if filled else "white",
        }
        for ax, column in zip(axes, ("left", "sigma_mm"), strict=False):
            ax.plot(steps["iteration"], steps[column], markevery=0.12, **style, **marks)
        axes[2].step(ends["left"], ends["percent"], where="post", **style)
        axes[2].fill_between(
            ends["left"],
            ends["low_percent"],
            ends["high_percent"],
            step="post",
            color=colour,
            alpha=0.3,
            linewidth=0,
        )
        median = ends["left"][ends["percent"] >= 50].iloc[0]
        axes[2].plot(median, 50, linestyle="none", color=colour, **marks)
    for ax, title in zip(
        axes, ("One cloud: points left", "One cloud: σ", "All redraws: points left"), strict=True
    ):
        ax.set_title(title)
    for ax in axes[:2]:
        ax.set_yscale("log")
        ax.set_xlabel("iteration")
    axes[0].set_ylabel("points with weight above 0, of 500")
    axes[1].set_ylabel("scale σ / mm")
    axes[2].set_xticks(range(0, 501, 100))
    axes[2].set_xlabel("points left at the end, of 500")
    axes[2].set_ylabel("redraws with so many or fewer / %")
    axes[0].set_yticks([5, 10, 20, 50, 100, 200, 500], ["5", "10", "20", "50", "100", "200", "500"])
    axes[1].set_yticks([1e-3, 1e-2, 1e-1, 1], ["0.001", "0.01", "0.1", "1"])
    for ax in axes[:2]:
        ax.minorticks_off()
    headed(
        figure,
        "Which scale eats up its own points? (500 good points, no gross error)",
        axes[0].get_legend_handles_labels()[0],
        2,
    )
    shown = history[history["iteration"] <= last].assign(panel="one cloud")
    columns = [
        "panel",
        "variant",
        "iteration",
        "left",
        "sigma_mm",
        "percent",
        "low_percent",
        "high_percent",
    ]
    publish(
        figure,
        f"{STEM}_collapse",
        pd.concat([shown, distribution.assign(panel="redraws")])[columns],
    )


def _distribution(redraws: pd.DataFrame) -> pd.DataFrame:
    """Share of the redraws with so many points left or fewer, with its 95 % interval: one row a
    variant and number of points.
    """
    frames = []
    for variant, rows in redraws.groupby("variant", sort=False):
        left, counts = np.unique(rows["left"], return_counts=True)
        low, high = share_interval(np.cumsum(counts), len(rows))
        percent = 100 * np.cumsum(counts) / len(rows)
        frames.append(
            pd.DataFrame(
                {
                    "variant": variant,
                    "left": left,
                    "percent": percent,
                    "low_percent": low,
                    "high_percent": high,
                }
            )
        )
    return pd.concat(frames, ignore_index=True)
