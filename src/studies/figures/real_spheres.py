"""Figures of notebook 05: a scan in section, centre errors by method and scan, and how tightly a
scan must be trimmed.
"""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
import pandas as pd

from analysis.export.figures import GREY, TRUTH, headed, new
from analysis.methods import SPHERE_METHODS

from ..ou_liu_2017 import real_spheres
from ..ou_liu_2017.real_spheres import WHOLE
from ..publish import publish

# Methods that agree lie on one another: from the first to the last ever thinner, each is seen on
# the one below it.
WIDTHS = dict(zip(SPHERE_METHODS, np.linspace(7.0, 1.2, len(SPHERE_METHODS)), strict=True))
ON = {"color": "#6E6E6E", "markersize": 3.5}
OFF = {"color": "#6E6E6E", "markersize": 5.0, "markeredgewidth": 0.9}
REFERENCE = {"color": "#444444", "linestyle": (0, (1, 1.5)), "linewidth": 2.5}
IDLE = {"zorder": 5, "markerfacecolor": "white", "markeredgecolor": TRUTH, "markersize": 5}
SCAN_MARKERS = "osD^vP*Xp<>"
PEER = "#5A5A5A"  # what is not a method of this project


def section(scan: str, half_thickness: float, half_width: float, stem: str) -> None:
    """Why do they fail? A slice of a scan from above, with every method's circle: the whole scan,
    and cut to ``half_width`` (m).

    Exports points and circles.
    """
    points = real_spheres.section(scan, half_thickness, half_width)
    figure, axes = new(1, 2, height=4.4, sharex=True, sharey=True)
    circles = []
    for ax, width, title in zip(
        axes,
        (WHOLE, half_width),
        ("the whole scan", f"cut to ±{1e3 * half_width:g} mm"),
        strict=True,
    ):
        drawn = points if width == WHOLE else points[points["on_sphere"]]
        found = real_spheres.section_circles(scan, width)
        _section_panel(ax, drawn, found)
        ax.set(title=f"{scan}: {title}", xlabel="along the line of sight (mm)")
        circles.append(found.assign(half_width_mm=1e3 * width))
    axes[0].set(ylabel="across it (mm)", xlim=(-92, 96), ylim=(-76, 96))
    axes[0].annotate(
        "to the scanner",
        (-90, -70),
        (-52, -70),
        va="center",
        arrowprops={"arrowstyle": "->", "color": TRUTH},
    )
    headed(figure, "Why do they fail? A slice seen from above")
    figure.legend(handles=_section_legend(), loc="outside lower center", ncol=4)
    publish(figure, stem, pd.concat([points, *circles], ignore_index=True))


def _section_panel(ax, points: pd.DataFrame, circles: pd.DataFrame) -> None:
    on, off = points[points["on_sphere"]], points[~points["on_sphere"]]
    for row in circles.itertuples():
        method = SPHERE_METHODS[row.method]
        circle = mpl.patches.Circle(
            (row.along_mm, row.across_mm), row.radius_mm, fill=False, zorder=2
        )
        circle.set(edgecolor=method.colour, linewidth=WIDTHS[row.method])
        ax.add_patch(circle)
    radius = 1e3 * real_spheres.NOMINAL_RADIUS
    ax.add_patch(mpl.patches.Circle((0, 0), radius, fill=False, **REFERENCE))
    ax.plot(on["along_mm"], on["across_mm"], ".", **ON)
    ax.plot(off["along_mm"], off["across_mm"], "+", **OFF)
    ax.set_aspect("equal")


def _section_legend() -> list:
    line = mpl.lines.Line2D
    return [
        *(
            line([], [], color=method.colour, linewidth=WIDTHS[name], label=method.label)
            for name, method in SPHERE_METHODS.items()
        ),
        line([], [], **REFERENCE, label="reference sphere"),
        line([], [], linestyle="", marker=".", **ON, label="point on the sphere"),
        line([], [], linestyle="", marker="+", **OFF, label="point off the sphere"),
    ]


def errors(table: pd.DataFrame, stem: str) -> None:
    """Centre errors by method and scan beside the standard deviations that the fits claim; one
    panel a half-width of the table.

    Methods that are not of this project, and variants, stand below the others.
    """
    half_widths = table["half_width_mm"].unique()
    scans = table["scan"].unique()
    names = [
        *SPHERE_METHODS,
        *(name for name in table["method"].unique() if name not in SPHERE_METHODS),
    ]
    figure, axes = new(
        1, len(half_widths), height=1.3 + 0.27 * len(names), sharex=True, sharey=True, squeeze=False
    )
    for ax, half_width in zip(axes[0], half_widths, strict=True):
        for place, name in enumerate(names):
            chosen = table[
                (table["method"] == name) & (table["half_width_mm"] == half_width)
            ].set_index("scan")
            known = SPHERE_METHODS.get(name.split(",")[0])
            colour = known.colour if known else PEER
            for scan, marker, offset in zip(
                scans, SCAN_MARKERS, np.linspace(-0.27, 0.27, len(scans)), strict=False
            ):
                if scan not in chosen.index:
                    continue
                height = place + offset
                ax.plot(
                    chosen["sd_center_mm"][scan],
                    height,
                    "|",
                    color=GREY,
                    markersize=7,
                    markeredgewidth=1.4,
                )
                face = colour if name in SPHERE_METHODS else "white"
                ax.plot(
                    chosen["center_error_mm"][scan],
                    height,
                    marker,
                    color=colour,
                    markersize=5,
                    markerfacecolor=face,
                )
        ax.set(
            xscale="log",
            xlabel="distance from the reference centre (mm)",
            title=_cut_title(half_width),
        )
        ax.xaxis.set_major_formatter("{x:g}")
        ax.grid(axis="y", visible=False)
    ax.set_yticks(
        range(len(names)),
        [SPHERE_METHODS[name].label if name in SPHERE_METHODS else name for name in names],
    )
    ax.set_ylim(len(names) - 0.5, -0.5)
    for scan, marker in zip(scans, SCAN_MARKERS, strict=False):
        ax.plot([], [], marker, color=TRUTH, markersize=5, label=scan)
    ax.plot(
        [],
        [],
        "|",
        color=GREY,
        markersize=7,
        markeredgewidth=1.4,
        label="sd of the centre, as the fit states it",
    )
    figure.legend(
        *ax.get_legend_handles_labels(),
        loc="outside lower center",
        ncol=6,
        columnspacing=1.2,
        handletextpad=0.3,
    )
    headed(figure, "How far is the centre off, and how far does the fit say it is?")
    publish(
        figure, stem, table[["half_width_mm", "scan", "method", "center_error_mm", "sd_center_mm"]]
    )


def _cut_title(half_width_mm: float) -> str:
    return "whole scans" if half_width_mm == WHOLE else f"cut to ±{half_width_mm:g} mm"


def trimming(table: pd.DataFrame, stem: str) -> None:
    """Centre error of every method over the half-width to which a scan is cut; one panel per scan,
    the whole scan at the right.
    """
    scans = table["scan"].unique()
    half_widths = table["half_width_mm"].unique()
    whole = 2 * half_widths[np.isfinite(half_widths)].max()
    figure, axes = new(1, len(scans), height=3.5, sharex=True, sharey=True, squeeze=False)
    for ax, scan in zip(axes[0], scans, strict=True):
        for name, method in SPHERE_METHODS.items():
            chosen = table[(table["scan"] == scan) & (table["method"] == name)].sort_values(
                "half_width_mm"
            )
            at = chosen["half_width_mm"].replace(WHOLE, whole)
            ax.plot(
                at,
                chosen["center_error_mm"],
                color=method.colour,
                linewidth=WIDTHS[name],
                label=method.label,
                solid_capstyle="round",
            )
            idle = (chosen["downweighted"] == 0) & (
                table.loc[table["method"] == name, "downweighted"] > 0
            ).any()
            ax.plot(at[idle], chosen["center_error_mm"][idle], "o", **IDLE)
        ax.set(xscale="log", yscale="log", title=scan, xlabel="kept within (mm)")
        ax.set_xticks([1, 10, whole], ["1", "10", "all"])
        ax.set_xticks([], minor=True)
        ax.yaxis.set_major_formatter("{x:g}")
    axes[0, 0].set_ylabel("distance from the reference centre (mm)")
    axes[0, 0].plot([], [], "o", **IDLE, label="ended before any weight changed")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncol=3)
    headed(
        figure,
        "How tightly must a scan be trimmed? Points kept by their distance from the "
        "reference sphere",
    )
    publish(
        figure,
        stem,
        table[
            [
                "scan",
                "half_width_mm",
                "method",
                "points",
                "downweighted",
                "center_error_mm",
                "radius_error_mm",
            ]
        ],
    )
