"""Figures of the notebook 10_tunnel_deformation: from one section to alarms and the ellipsoid."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np
import pandas as pd
from matplotlib.lines import Line2D

from analysis.export.figures import GREY, GROSS, TRUTH, headed, new
from analysis.export.tunnel_figures import CLASS_COLOURS, CLASS_MARKS, CLASS_NAMES
from analysis.tunnel.outlines import ANGLES
from analysis.tunnel.significance import CLASSES

from ..li_2015.simulated_sections import ALL, POLE, SimulatedChange
from ..publish import publish
from ..simulation.tunnel import CODES, NAMES

STEM = "10_tunnel_deformation"
EPOCHS = ("#000000", "#0072B2")  # first and second, black and blue as in figure 5 of the paper
CHANGE = "#E0261B"  # red as there
TRUE = "#E69F00"
SHAPE, RIGID = "#0072B2", "#D55E00"
TIMES = 25.0  # by which changes are drawn larger than they are
TO_EITHER_SIDE = 1.96  # standard deviations that hold 95 %
CROWN = ([-90, 0, 90], ["left", "crown", "right"])

key = partial(Line2D, [], [])  # an entry of a legend


def projection(one: SimulatedChange, epoch: int) -> None:
    """One slab in one epoch: from the side, and in the plane of the section with its ellipse.

    (Figure 4 of Li et al. 2015.)
    """
    u, v, w = one.points[epoch - 1][0].T
    codes = one.section.scans[epoch - 1].codes
    lining = codes == CODES["lining"]
    radii = one.ellipses[epoch - 1].polar(ANGLES, POLE)[0][0]
    ellipse = radii * np.sin(ANGLES), radii * np.cos(ANGLES)
    figure, (side, plane) = new(1, 2, height=3.7, width_ratios=(1, 1.35))
    near = np.abs(u) < 1.0  # the crown; the walls would hide it
    side.axvline(0.0, color=CHANGE, linewidth=1.6)
    for of, marker, colour in ((lining, ".", EPOCHS[0]), (~lining, "x", GROSS)):
        style = {"color": colour, "markersize": 2.5, "rasterized": True}
        side.plot(1e3 * w[near & of], v[near & of], marker, **style)
        plane.plot(u[of], v[of], marker, **style)
    plane.plot(*ellipse, color=CHANGE, linewidth=1.2)
    plane.set_aspect("equal")
    side.set_ylim(2.48, 2.73)
    side.set_xlabel("along the axis, from the plane / mm")
    side.set_ylabel("above the axis / m")
    side.set_title("The slab at the crown, from the side")
    plane.set_xlabel("right of the axis / m")
    plane.set_title("Projected: in the plane of the section")
    line = "plane of the section (left), robust ellipse of all points (right)"
    handles = [
        key(color=EPOCHS[0], marker=".", linestyle="none", label="lining"),
        key(color=GROSS, marker="x", linestyle="none", label="anything else"),
        key(color=CHANGE, label=line),
    ]
    headed(figure, f"Which points make the section at {one.section.chainage:g} m?", handles, 3)
    shown = {"kind": np.array(NAMES)[codes], "right_m": u, "up_m": v, "along_mm": 1e3 * w}
    curve = {"kind": "ellipse", "right_m": ellipse[0], "up_m": ellipse[1]}
    publish(figure, f"{STEM}_projection", pd.concat(map(pd.DataFrame, (shown, curve))))


def polar(of: Sequence[SimulatedChange]) -> None:
    """Outlines of both epochs in one campaign, above Δρ(α) with its 95 % band and the truth.

    (Figure 5 of Li et al. 2015; below, their table 2 as curves.)
    """
    figure, axes = new(2, len(of), height=5.0, sharey="row", height_ratios=(1.35, 1))
    frames = []
    for (above, below), one in zip(axes.T, of, strict=True):
        _outlines(above, one)
        _differences(below, one)
        columns = {
            "chainage_m": one.section.chainage,
            "angle_deg": np.degrees(one.change.angles),
            "first_m": one.change.first[0],
            "difference_mm": 1e3 * one.change.difference[0],
            "sd_mm": 1e3 * one.change.standard_deviations[0],
            "true_mm": 1e3 * one.truth,
        }
        frames.append(pd.DataFrame(columns))
    axes[1, 0].set_ylabel("Δρ, positive outwards / mm")
    handles = [
        key(color=EPOCHS[0], label="first epoch"),
        key(color=EPOCHS[1], label="second epoch, its change with 95 % band"),
        key(color=CHANGE, linewidth=3, label="largest change"),
        key(color=TRUE, linestyle=":", label="true"),
    ]
    drawn = f"Above: departures from the circle drawn {TIMES:g} times"
    headed(figure, f"What has happened to the three sections? {drawn}", handles, 4)
    publish(figure, f"{STEM}_polar", pd.concat(frames))


def _outlines(ax, one: SimulatedChange) -> None:
    """Both outlines of a section, enlarged, with the largest change marked."""
    base = np.median(one.change.first[0])
    first, second = (
        base + TIMES * (radii[0] - base) for radii in (one.change.first, one.change.second)
    )
    true = first + TIMES * one.truth
    outwards = np.stack([np.sin(one.change.angles), np.cos(one.change.angles)])
    band = np.hstack([first * outwards, (second * outwards)[:, ::-1]])
    ax.fill(*band, color="#DDDDDD", linewidth=0)
    ax.plot(*(first * outwards), color=EPOCHS[0])
    ax.plot(*(second * outwards), color=EPOCHS[1])
    ax.plot(*(true * outwards), ":", color=TRUE, linewidth=1.8)
    # the largest change: a ray to it, and the change itself
    delta = one.change.difference[0]
    at = int(np.argmax(np.abs(delta)))
    direction = outwards[:, [at]]
    ax.plot(*(np.array([0.0, second[at]]) * direction), color=CHANGE, linewidth=0.8)
    ax.plot(*(np.array([first[at], second[at]]) * direction), color=CHANGE, linewidth=3)
    words = f"{1e3 * delta[at]:.1f} mm".replace("-", "−")
    ax.text(-0.05 * base, 0.1 * base, words, ha="right", fontsize=8.5, color=CHANGE)
    ax.set_title(f"{one.section.chainage:g} m")
    _without_frame(ax)


def _without_frame(ax) -> None:
    """Equal scales, and nothing drawn but the contents."""
    ax.set_aspect("equal")
    ax.set_xticks([])
    ax.set_yticks([])
    ax.grid(visible=False)
    for side in ax.spines.values():
        side.set_visible(False)


def _differences(ax, one: SimulatedChange) -> None:
    """Δρ by direction with its 95 % band, and the truth, mm."""
    degrees, delta = np.degrees(one.change.angles), one.change.difference[0]
    half = TO_EITHER_SIDE * one.change.standard_deviations[0]
    low, high = 1e3 * (delta - half), 1e3 * (delta + half)
    ax.axhline(0.0, color=TRUTH, linewidth=0.8)
    ax.fill_between(degrees, low, high, color=EPOCHS[1], alpha=0.25, linewidth=0)
    ax.plot(degrees, 1e3 * delta, color=EPOCHS[1])
    ax.plot(degrees, 1e3 * one.truth, ":", color=TRUE, linewidth=1.8)
    ax.set_xticks(*CROWN)
    ax.set_xlabel("direction")


def classes(points: pd.DataFrame, words: Mapping[float, str]) -> None:
    """Single points of sections in the classes black, blue and red.

    points : from :func:`.section_accuracy.single_points`; words : chainage -> title

    Drawn where they are in the second epoch, the change enlarged. (Figure 7 of Li et al. 2015.)
    """
    columns = min(3, len(words))
    rows = -(-len(words) // columns)
    figure, axes = new(rows, columns, height=5.2, sharex=True, sharey=True, squeeze=False)
    for ax in axes.flat[len(words) :]:
        ax.remove()
    turn = np.linspace(-np.pi, np.pi, 181)
    for ax, (chainage, title) in zip(axes.flat, words.items(), strict=False):
        section = points[points["chainage_m"] == chainage]
        radii = section["radius_m"] + 1e-3 * TIMES * section["difference_mm"]
        alpha = np.radians(section["angle_deg"])
        x, y = radii * np.sin(alpha), radii * np.cos(alpha)
        ax.plot(2.7 * np.sin(turn), 2.7 * np.cos(turn), color=GREY, linewidth=0.6)
        shown, seen = [], section["class"].isin(CLASSES)
        for name in CLASSES:
            of = section["class"] == name
            style = {"color": CLASS_COLOURS[name], "markersize": 2.2, "rasterized": True}
            ax.plot(x[of], y[of], CLASS_MARKS[name], **style)
            shown.append(f"{100 * of.sum() / seen.sum():.0f} % {name}")
        ax.set_title(title)
        ax.annotate("\n".join(shown), (0.0, -0.3), ha="center", va="center", fontsize=8)
        _without_frame(ax)
    handles = [key(color=GREY, linewidth=0.6, label="design")]
    for name in CLASSES:
        style = {"color": CLASS_COLOURS[name], "marker": CLASS_MARKS[name], "linestyle": "none"}
        handles.append(key(**style, label=f"{name}: {CLASS_NAMES[name]}"))
    title = f"Which points have moved beyond 6 and 12 mm? Changes drawn {TIMES:g} times"
    headed(figure, title, handles, 4)
    publish(figure, f"{STEM}_classes", points[points["chainage_m"].isin(list(words))])


def alarms(table: pd.DataFrame, words: Mapping[str, str]) -> None:
    """Share of the campaigns in which a section gives an alarm, by the rule and by the test.

    table : from :func:`.calibration.alarms`; words : section -> what has happened there
    """
    table = table[table["section"] != ALL].set_index("section").loc[list(words)].reset_index()
    figure, ax = new(height=2.9)
    rule = {"color": GROSS, "marker": "s", "markersize": 8, "markerfacecolor": "white"}
    test = {"color": SHAPE, "marker": "o", "markersize": 5, "linestyle": "none"}
    for y, row in enumerate(table.itertuples()):
        both = [row.flagged_percent, row.changed_percent]
        ax.plot(both, [y, y], color="#CCCCCC", linewidth=1.0, zorder=1)
        ax.plot(row.flagged_percent, y, **rule, linestyle="none", markeredgewidth=1.5)
        ax.plot(row.changed_percent, y, **test)
    five = {"color": TRUTH, "linestyle": ":", "linewidth": 1.0}
    ax.axvline(5.0, **five)
    ax.set_yticks(range(len(table)), [f"{section}: {what}" for section, what in words.items()])
    ax.set_ylim(len(table) - 0.5, -0.5)
    ax.set_xlim(-4, 104)
    ax.grid(axis="y", visible=False)
    ax.set_xlabel("campaigns in which the section gives an alarm / %")
    handles = [
        key(**rule, linestyle="none", label="rule: over 30 % of the directions beyond 6 mm"),
        key(**test, label="test of significance"),
        key(**five, label="its 5 %"),
    ]
    headed(figure, "Which alarms are false, and what is missed?", handles, 3)
    publish(figure, f"{STEM}_alarms", table)


def hidden(table: pd.DataFrame) -> None:
    """A dent as two ellipses see it, as their residuals see it, and as it is.

    table : from :func:`.section_accuracy.hidden`
    """
    figure, ax = new(height=3.2)
    degrees, together = table["angle_deg"], table["together_mm"]
    half = TO_EITHER_SIDE * np.hypot(table["ellipse_sd_mm"], table["hidden_sd_mm"])
    ax.axhline(0.0, color=GREY, linewidth=0.8)
    band = {"color": SHAPE, "alpha": 0.2, "linewidth": 0}
    ax.fill_between(degrees, together - half, together + half, **band)
    ax.plot(degrees, table["ellipse_mm"], "--", color=RIGID, label="ellipses alone")
    label = "ellipses and what they leave as residuals, 95 % band"
    ax.plot(degrees, together, color=SHAPE, label=label)
    ax.plot(degrees, table["true_mm"], ":", color=TRUE, linewidth=1.8, label="true")
    ticks = {-135: "−135°", -90: "left", -45: "−45°", 0: "crown", 40: "40°", 90: "right"}
    ticks[135] = "135°"
    ax.set_xticks(list(ticks), list(ticks.values()))
    ax.set_xlim(-137, 137)
    ax.set_ylim(-19, 9)
    ax.set_xlabel("direction")
    ax.set_ylabel("Δρ, positive outwards / mm")
    handles, _ = ax.get_legend_handles_labels()
    title = "What does an ellipse hide? A local dent, which it takes for gross errors"
    headed(figure, title, handles, 3)
    publish(figure, f"{STEM}_hidden", table)


def parts(tables: Mapping[str, pd.DataFrame]) -> None:
    """Δρ of sections divided into a motion of the ring and a change of shape.

    tables : title -> table from :func:`.section_accuracy.shares`
    """
    figure, axes = new(1, len(tables), height=3.1, sharey=True)
    styles = {
        "rigid": (RIGID, "--", "motion of the ring as a whole"),
        "shape": (SHAPE, "-", "change of shape and size"),
    }
    true = {"color": TRUE, "linewidth": 1.6, "label": "each as it is"}
    for ax, (title, table) in zip(axes, tables.items(), strict=True):
        degrees = table["angle_deg"]
        ax.axhline(0.0, color=GREY, linewidth=0.8)
        for name, (colour, line, words) in styles.items():
            ax.plot(degrees, table[f"{name}_mm"], line, color=colour, label=words)
            ax.plot(degrees, table[f"true_{name}_mm"], ":", **true)
        ax.set_title(title)
        ax.set_xticks(*CROWN)
        ax.set_xlabel("direction")
    axes[0].set_ylabel("Δρ, positive outwards / mm")
    handles, labels = axes[0].get_legend_handles_labels()
    once = dict(zip(labels, handles, strict=True)).values()
    headed(figure, "Has the ring moved, or has its shape changed?", once, 3)
    publish(figure, f"{STEM}_parts", pd.concat(tables.values()))


def ellipsoid(study: pd.DataFrame) -> None:
    """Share of the sections without the printed ellipsoid, and its semi-axis along the tunnel.

    study : from :func:`.printed_ellipse.failure_study`
    """
    figure, (left, right) = new(1, 2, height=3.0)
    lines = {0.0: ("o-", SHAPE, 4.5), 10.0: ("s--", RIGID, 6)}
    handles = []
    for (tilt, n), rows in study.groupby(["tilt_deg", "points"]):
        line, colour, size = lines[tilt]
        face = colour if n == study["points"].max() else "white"
        style = {"color": colour, "markerfacecolor": face, "markersize": size}
        label = f"ellipse tilted by {tilt:g}°, {n} points"
        limits = rows["slope_limit"]
        handles += left.plot(limits, 100 * rows["imaginary"], line, **style, label=label)
        right.plot(limits, rows["lambda2_median_m"], line, **style)
    left.set_ylim(0, 60)
    left.set_ylabel("no real ellipsoid / %")
    left.set_title("How often does it fail?")
    right.set_yscale("log")
    right.set_yticks([0.1, 0.3, 1, 3], ["0.1", "0.3", "1", "3"])
    right.minorticks_off()
    right.set_ylabel("semi-axis along the tunnel / m")
    right.set_title("What does it give otherwise?")
    limits = study["slope_limit"].unique()
    for ax in (left, right):
        ax.set_xscale("log")
        ax.set_xticks(limits, [f"{1000 * limit:g}" for limit in limits])
        ax.minorticks_off()
        ax.set_xlabel("largest slope of the axis / ‰")
    headed(figure, "Does the printed ellipsoid describe a section?", handles, 2)
    publish(figure, f"{STEM}_ellipsoid", study)
