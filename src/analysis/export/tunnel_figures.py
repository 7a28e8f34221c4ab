"""Figures of two epochs of a tunnel: the lining unrolled, one section, the course along the tunnel.

Every function draws from what :func:`analysis.tunnel.comparison.compare` returns, and hands figure,
stem and what is shown to ``publish``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from matplotlib.colors import ListedColormap
from matplotlib.patches import Patch, Rectangle

from .figures import GREY, TRUTH, Publish, headed, new

if TYPE_CHECKING:
    from ..tunnel.comparison import ComparedSection, EpochComparison

# The classes of a difference, as in analysis.tunnel.significance.
CLASS_COLOURS = {"black": "#1A1A1A", "blue": "#2F7FD6", "red": "#E0261B"}
CLASS_MARKS = {"black": ".", "blue": "^", "red": "s"}
CLASS_NAMES = {"black": "up to 6 mm", "blue": "6 to 12 mm", "red": "beyond 12 mm"}
TWO_SIDED = 1.96  # standard deviations to either side that hold 95 % at the normal law
UNSEEN: dict[str, Any] = {
    "facecolor": "white",
    "edgecolor": GREY,
    "hatch": "/////",
    "linewidth": 0.4,
    "hatch_linewidth": 0.4,
}
NOT_SIGNIFICANT = "#D9D9D9"
FIRST, SECOND = GREY, "#7B3294"
QUANTITIES = {
    "crown_settlement": ("crown settlement", "o", "#0072B2"),
    "horizontal_convergence": ("horizontal convergence, positive: wider", "s", "#B8860B"),
}
DRAWN = 0.2  # of the section's radius is the largest change drawn


def changes(comparison: EpochComparison, stem: str, *, publish: Publish) -> None:
    """The lining unrolled, direction by chainage: classes above, significant changes below.

    The classes have the limits of 6 and 12 mm.

    Exports :meth:`EpochComparison.by_direction`. (The classes and their colours: figure 7 of Li et
    al. 2015.)
    """
    data = comparison.by_direction()
    chainages = np.array([section.chainage for section in comparison.sections])
    degrees = np.degrees(comparison.sections[0].radii[0].directions)
    shape = len(chainages), len(degrees)
    # NaN: a gap
    places = {name: place for place, name in enumerate(CLASS_NAMES)}
    numbers = data["class"].map(places).to_numpy(float).reshape(shape)
    delta = data["difference_mm"].to_numpy().reshape(shape)
    known = np.where(data["significant"].to_numpy().reshape(shape), delta, np.nan)
    figure, (above, below) = new(2, 1, height=4.6, sharex=True, sharey=True)
    colours = ListedColormap(list(CLASS_COLOURS.values()))
    largest = max(1.0, np.ceil(np.nanmax(np.abs(known), initial=0.0)))
    halves = _half_widths(chainages)
    for chainage, half, number, all_seen, change in zip(
        chainages, halves, numbers, delta, known, strict=True
    ):
        edges = [chainage - half, chainage + half], _edges(degrees)
        style = {"rasterized": True}
        above.pcolormesh(
            *edges, number[:, None], cmap=colours, vmin=-0.5, vmax=len(places) - 0.5, **style
        )
        seen = np.where(np.isnan(all_seen), np.nan, 0.0)
        below.pcolormesh(*edges, seen[:, None], cmap=ListedColormap([NOT_SIGNIFICANT]), **style)
        drawn = below.pcolormesh(
            *edges, change[:, None], cmap="RdBu_r", vmin=-largest, vmax=largest, **style
        )
        for ax in (above, below):
            ax.add_patch(
                Rectangle(
                    (chainage - half, degrees[0]), 2 * half, np.ptp(degrees), zorder=0.5, **UNSEEN
                )
            )
    above.set_title("Where does the change pass 6 and 12 mm?")
    below.set_title("Where has the lining moved significantly, and by how much?")
    figure.colorbar(drawn, ax=below, label="outwards / mm", pad=0.01)
    patches = [
        Patch(facecolor=CLASS_COLOURS[name], label=text) for name, text in CLASS_NAMES.items()
    ]
    patches += [
        Patch(facecolor=NOT_SIGNIFICANT, label="no significant change"),
        Patch(label="not seen in both epochs", **UNSEEN),
    ]
    figure.legend(
        handles=patches, loc="outside lower center", ncols=5, columnspacing=1.2, handlelength=1.2
    )
    for ax in (above, below):
        ax.grid(visible=False)
        ax.set_yticks([-90, 0, 90], ["left −90°", "crown 0°", "right 90°"])
        ax.set_ylim(degrees[0] - 4, degrees[-1] + 4)
        ax.set_xlim(
            np.min(chainages - halves) - 0.5 * halves.min(),
            np.max(chainages + halves) + 0.5 * halves.min(),
        )
    below.set_xlabel("chainage along the axis of the first epoch / m")
    publish(figure, stem, data)


def section(
    compared: ComparedSection,
    stem: str,
    *,
    truth: tuple[np.ndarray, np.ndarray] | None = None,
    publish: Publish,
) -> None:
    """One section: its outlines with the change exaggerated, and Δρ(α) with its 95 % band.

    Beside the band: the directly measured changes.

    truth : (K,) directions in rad and (K,) radial changes in m, drawn as well where they are known

    Exports what :meth:`ComparedSection.by_direction` returns, with `truth_mm`. (Figure 5 of Li et
    al. 2015.)
    """
    data = compared.by_direction()
    if truth is not None:
        data["truth_mm"] = 1e3 * np.interp(np.radians(data["angle_deg"]), *truth)
    figure, (left, right) = new(1, 2, height=3.6, width_ratios=(1, 1.45))
    times = _outlines(left, compared, data)
    _profile(right, data)
    left.set_title(f"Changes drawn {times:g} times")
    handles = left.get_legend_handles_labels()[0] + right.get_legend_handles_labels()[0]
    figure.legend(
        handles=handles, loc="outside lower center", ncols=4, columnspacing=1.0, handlelength=1.5
    )
    headed(figure, f"How has the section at {compared.chainage:.2f} m changed?")
    publish(figure, stem, data)


def along(
    comparison: EpochComparison, stem: str, *, truth: pd.DataFrame | None = None, publish: Publish
) -> None:
    """Crown settlement and horizontal convergence along the tunnel, with 95 % error bars.

    truth : columns `chainage_m`, `crown_settlement_mm`, `horizontal_convergence_mm`, drawn as lines
        where they are known
    """
    names = [f"{name}_{end}" for name in QUANTITIES for end in ("mm", "sd_mm")]
    data = comparison.table()[["chainage_m", *names]]
    chainage = data["chainage_m"]
    # so that the bars of both quantities can be told apart
    aside = 0.004 * max(np.ptp(chainage), 1.0)
    figure, ax = new(height=3.0)
    ax.axhline(0.0, color=TRUTH, linewidth=0.8)
    handles = []
    for (name, (label, marker, colour)), shift in zip(
        QUANTITIES.items(), (-aside, aside), strict=True
    ):
        bars = TWO_SIDED * data[f"{name}_sd_mm"]
        style = {"fmt": marker, "markersize": 5, "capsize": 2.5}
        handles.append(
            ax.errorbar(
                chainage + shift, data[f"{name}_mm"], bars, color=colour, label=label, **style
            )
        )
        if truth is not None:
            handles += ax.plot(
                truth["chainage_m"],
                truth[f"{name}_mm"],
                color=colour,
                linewidth=1.0,
                label=f"{label.split(',')[0]}, true",
            )
    unknown = chainage[data[f"{name}_mm"].isna()]
    if len(unknown):
        at_the_bottom = {"transform": ax.get_xaxis_transform(), "clip_on": False}
        handles += ax.plot(
            unknown,
            np.zeros(len(unknown)),
            "x",
            color=GREY,
            markersize=6,
            label="too little seen",
            **at_the_bottom,
        )
    ax.set_title("How far has the crown settled, and how much wider is the tunnel?")
    ax.set_xlabel("chainage along the axis of the first epoch / m")
    ax.set_ylabel("change and its 95 % interval / mm")
    figure.legend(handles=handles, loc="outside lower center", ncols=3, columnspacing=1.4)
    if truth is not None:
        data = pd.concat(
            [data.assign(kind="measured"), truth.assign(kind="true")], ignore_index=True
        )
    publish(figure, stem, data)


def _half_widths(chainages: np.ndarray) -> np.ndarray:
    """0.4 times the distance to the nearest other section: between sections it stays empty."""
    if len(chainages) == 1:
        return np.array([0.5])
    order = np.argsort(chainages)
    gaps = np.diff(chainages[order])
    half = np.empty(len(chainages))
    half[order] = 0.4 * np.minimum(np.append(gaps, np.inf), np.append(np.inf, gaps))
    return half


def _edges(degrees: np.ndarray) -> np.ndarray:
    """Between neighbouring directions, and half a step beyond the outermost."""
    middles = 0.5 * (degrees[1:] + degrees[:-1])
    return np.concatenate(
        [[1.5 * degrees[0] - 0.5 * degrees[1]], middles, [1.5 * degrees[-1] - 0.5 * degrees[-2]]]
    )


def _outlines(ax, compared: ComparedSection, data: pd.DataFrame) -> float:
    """Draw both outlines, the change of the second exaggerated, and return by how much."""
    alpha = np.radians(data["angle_deg"].to_numpy())
    change, known = (
        1e-3 * data[name].to_numpy() for name in ("difference_mm", "ellipse_difference_mm")
    )
    first = compared.radii[0].radius
    largest = np.nanmax(np.abs([change, known]), initial=1e-4)
    times = _round_number(DRAWN * np.nanmax(first, initial=0.0) / largest)
    sine, cosine = np.sin(alpha), np.cos(alpha)
    if compared.change is not None:
        base = compared.change.first
        ax.plot(
            base * sine, base * cosine, color=FIRST, linewidth=1.0, label="first epoch, ellipse"
        )
        moved = base + times * known
        ax.plot(moved * sine, moved * cosine, color=SECOND, label="second epoch, ellipse")
    moved = first + times * change
    for name in CLASS_NAMES:
        of = (data["class"] == name).to_numpy()
        ax.plot(
            (moved * sine)[of],
            (moved * cosine)[of],
            CLASS_MARKS[name],
            color=CLASS_COLOURS[name],
            markersize=2.5,
            rasterized=True,
        )
    ax.plot(0.0, 0.0, "+", color=TRUTH, markersize=6)
    ax.set_aspect("equal")
    ax.set_xlabel("right of the axis / m")
    ax.set_ylabel("above the axis / m")
    return times


def _profile(ax, data: pd.DataFrame) -> None:
    """Draw Δρ(α): measured by direction, of the ellipses with their band, detectable, and true."""
    degrees = data["angle_deg"]
    ax.axhline(0.0, color=TRUTH, linewidth=0.8)
    for name in CLASS_NAMES:
        of = data["class"] == name
        label = f"measured, {CLASS_NAMES[name]}"
        ax.plot(
            degrees[of],
            data["difference_mm"][of],
            CLASS_MARKS[name],
            color=CLASS_COLOURS[name],
            markersize=3.5,
            label=label,
        )
    ax.plot(
        degrees,
        data["detectable_mm"],
        ":",
        color=GREY,
        linewidth=1.0,
        label="detectable in one direction",
    )
    ax.plot(degrees, -data["detectable_mm"], ":", color=GREY, linewidth=1.0)
    middle, half = data["ellipse_difference_mm"], TWO_SIDED * data["ellipse_sd_mm"]
    ax.fill_between(
        degrees,
        middle - half,
        middle + half,
        color=SECOND,
        alpha=0.25,
        linewidth=0,
        label="its 95 % band",
    )
    ax.plot(degrees, middle, color=SECOND, label="difference of the ellipses")
    if "truth_mm" in data:
        ax.plot(degrees, data["truth_mm"], "--", color="#008F5A", label="true")
    ax.set_xticks(
        [-135, -90, -45, 0, 45, 90, 135], ["−135°", "left", "−45°", "crown", "45°", "right", "135°"]
    )
    ax.set_xlabel("direction")
    ax.set_ylabel("Δρ, positive outwards / mm")


def _round_number(value: float) -> float:
    """The next smaller of 1, 2, 5, 10, 20, 50, …; at least 1."""
    power = 10.0 ** np.floor(np.log10(max(value, 1.0)))
    return float(max(step for step in (1, 2, 5) if step * power <= max(value, 1.0)) * power)
