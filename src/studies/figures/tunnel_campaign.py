"""Figures of the notebook 09_tunnel_campaign: from the map of the campaign to single sections."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np
import pandas as pd
from matplotlib.lines import Line2D

from analysis.export.figures import GREY, GROSS, TRUTH, headed, new
from analysis.tunnel.axis import Axis
from analysis.tunnel.filter import INSIDE, LINING, OUTSIDE, FilteredLining
from analysis.tunnel.radii import equal_angles, local_radii
from analysis.tunnel.sections import Section

from ..li_2015.epoch_cloud import EpochCloud
from ..li_2015.printed_axis import mid_values
from ..li_2015.register_campaign import control_net, station_names
from ..li_2015.registration_accuracy import JOINT_MM
from ..li_2015.section_density import ring_points
from ..publish import publish
from ..simulation.tunnel import FULL_DENSITY, ZONE, Tunnel

STEM = "09_tunnel_campaign"
BLUE = "#0072B2"
EPOCHS = {1: (GROSS, "o"), 2: (BLUE, "s")}  # the paper shows the first red, the second blue
PRINTED, ROBUST = "#CC79A7", "#009E73"
RULES = {
    "one cylinder": (GROSS, "x"),
    "cylinder by segments": ("#56B4E9", "+"),
    "cylinder and local surface": (ROBUST, "^"),
}
READINGS = {"equal angles": (PRINTED, "s--"), "local quadratics": (ROBUST, "o-")}
REGISTRATIONS = ((GROSS, "x", "--"), (ROBUST, "o", "-"))  # singly, jointly
SHOWN = 8_000  # points of a cloud in a figure
DECIMALS = 5  # of exported points, m
EXAGGERATED = 20.0  # times, departures from the circle
RADIUS = 2.7  # m

PLAIN = {"fontweight": "normal"}  # of a title
key = partial(Line2D, [], [])  # an entry of a legend


def map_(epochs, tunnel: Tunnel) -> None:
    """Plan and elevation: axis, control net, stations with sights to their targets, stickers."""
    figure, axes = new(2, 1, height=4.2, sharex=True)
    net = control_net(*epochs)
    line = tunnel.alignment.position(np.linspace(0.0, tunnel.alignment.length, 100))
    stickers = epochs[0].stickers.true
    zone = [tunnel.alignment.position(end)[1] for end in ZONE]
    white = {"color": TRUTH, "markerfacecolor": "white", "markersize": 4.5}
    for ax, name in zip(axes, "xz", strict=True):
        k = "xyz".index(name)
        handles = ax.plot(line[:, 1], line[:, k], color=TRUTH, linewidth=1.0, label="axis")
        dots = {"color": GREY, "markersize": 4, "label": "stickers"}
        handles += ax.plot(stickers[:, 1], stickers[:, k], ".", **dots)
        handles += ax.plot(net["y"], net[name], "D", **white, label="control net")
        for epoch in epochs:
            handles += _stations_and_sights(ax, epoch, k)
        ax.axvspan(*zone, color=GREY, alpha=0.12, linewidth=0)
        ax.set_ylabel(f"{name.upper()} / m")
    axes[0].set_title("From above", **PLAIN)
    axes[1].set_title("From the side", **PLAIN)
    axes[1].set_xlabel("Y along the tunnel / m (shaded: the 45 m in which sections are cut)")
    headed(figure, "Where do the scanner and the targets stand?", handles, 5)
    parts = [
        pd.DataFrame(line, columns=list("xyz")).assign(kind="axis", name=""),
        net.rename(columns={"target": "name"}).assign(kind="control point"),
        pd.DataFrame(stickers, columns=list("xyz")).assign(kind="sticker", name=""),
    ]
    for epoch in epochs:
        at = pd.DataFrame([one.pose.position for one in epoch.stations], columns=list("xyz"))
        kind = f"station of epoch {epoch.number}"
        parts.append(at.assign(kind=kind, name=station_names(epoch)))
    table = pd.concat(parts)[["kind", "name", "x", "y", "z"]]
    publish(figure, f"{STEM}_map", table.round(DECIMALS))


def _stations_and_sights(ax, epoch, k: int) -> list[Line2D]:
    """Draw the stations of an epoch, y against coordinate k, and return their handles."""
    colour, _ = EPOCHS[epoch.number]
    for one in epoch.stations:
        for target in one.targets.true:
            sight = np.stack([one.pose.position, target])
            ax.plot(sight[:, 1], sight[:, k], color=colour, linewidth=0.6, alpha=0.8)
    at = np.array([one.pose.position for one in epoch.stations])
    label = f"stations and sights, epoch {epoch.number}"
    marker = "^" if epoch.number == 1 else "v"
    return ax.plot(at[:, 1], at[:, k], marker, color=colour, markersize=7, label=label)


def start(table: pd.DataFrame) -> None:
    """Success of the model with thirteen parameters by the angle of the rotation.

    table : share of the trials found from either start, by classes of angles
    """
    figure, ax = new(width=5.0, height=2.8)
    middle = 0.5 * (table["from_deg"] + table["to_deg"])
    for column, style, colour, label in (
        ("found_from_svd_percent", "o-", ROBUST, "found, started from the SVD"),
        ("found_from_identity_percent", "s--", PRINTED, "found, started from R = I"),
        ("wrong_but_converged_percent", "x:", GROSS, "R = I: converged to a wrong rotation"),
    ):
        ax.plot(middle, table[column], style, color=colour, label=label)
    ax.set_xticks(np.append(table["from_deg"], table["to_deg"].iloc[-1]))
    ax.set_ylim(-4, 104)
    ax.set_xlabel("angle of the rotation / °")
    ax.set_ylabel("share of the trials / %")
    handles, _ = ax.get_legend_handles_labels()
    headed(figure, "Is R = I a safe start for the thirteen parameters?", handles, 2)
    publish(figure, f"{STEM}_start", table)


def between(table: pd.DataFrame) -> None:
    """Shift of the second epoch against the first by registration, true and stated.

    table : from :func:`.epoch_shift.shifts`
    """
    figure, axes = new(2, 1, height=4.6, sharex=True, sharey=True)
    titles = {"right": "To the right", "up": "Upwards"}
    for ax, (direction, title) in zip(axes, titles.items(), strict=True):
        ax.axhline(0.0, color=TRUTH, linewidth=0.8)
        handles = []
        cases = table.groupby("registration", sort=False)
        for (words, rows), (colour, marker, line) in zip(cases, REGISTRATIONS, strict=True):
            at, shift = rows["chainage_m"], rows[f"{direction}_mm"]
            band = 1.96 * rows[f"{direction}_sd_mm"]
            stated = f"{words}: stated, ±1.96 standard deviations"
            handles += ax.plot(at, band, line, color=colour, label=stated)
            ax.plot(at, -band, line, color=colour)
            true = {"color": colour, "markersize": 6, "label": f"{words}: true"}
            handles += ax.plot(at, shift, marker, **true)
        ax.set_ylabel("shift / mm")
        ax.set_title(title, **PLAIN)
    axes[1].set_xticks(table["chainage_m"].unique())
    axes[1].set_xlabel("chainage of the section / m")
    headed(figure, "How far apart does registration put the two epochs of a section?", handles, 2)
    publish(figure, f"{STEM}_between", table)


def stickers(differences: Mapping[int, pd.DataFrame]) -> None:
    """Scanner less total station at every sticker, with the means of the stations.

    differences : epoch -> table from :func:`.sticker_accuracy.differences`
    """
    figure, axes = new(1, 3, height=3.1, sharey=True)
    for ax, coordinate in zip(axes, "xyz", strict=True):
        column = f"d{coordinate}_mm"
        ax.axhspan(-JOINT_MM, JOINT_MM, color=GREY, alpha=0.2, linewidth=0)
        handles = [key(color=GREY, alpha=0.3, linewidth=7, label="±2 mm")]
        for epoch, table in differences.items():
            colour, marker = EPOCHS[epoch]
            at = table["chainage_m"] + 0.7 * (2 * epoch - 3)  # the epochs side by side
            style = {"color": colour, "markersize": 3, "alpha": 0.6}
            style["label"] = f"stickers, epoch {epoch}"
            handles += ax.plot(at, table[column], marker, **style)
            label = f"means of its stations, epoch {epoch}"
            for _, rows in table.groupby("station"):
                ends = rows["chainage_m"].min() - 2, rows["chainage_m"].max() + 2
                level = 2 * [rows[column].mean()]
                (mean,) = ax.plot(ends, level, color=colour, linewidth=2.0, label=label)
            handles.append(mean)
        ax.set_title(coordinate.upper(), **PLAIN)
        ax.set_xlabel("chainage / m")
    axes[0].set_ylabel("scanner less total station / mm")
    title = "Do the scans agree with the total station? Stickers of one station err together"
    headed(figure, title, handles, 3)
    data = pd.concat([table.assign(epoch=epoch) for epoch, table in differences.items()])
    publish(figure, f"{STEM}_stickers", data)


def axis(
    zone: EpochCloud, axes_found: Mapping[str, Axis], tunnel: Tunnel, step: float = 0.1
) -> None:
    """Projections to XOY and YOZ: mid-values, their quadratics, the true and the robust axis.

    (Figure 2 of Li et al. 2015.)
    """
    figure, axes = new(2, 1, height=4.8, sharex=True)
    y, middle = mid_values(zone.points, step)
    at = np.linspace(y[0], y[-1], 100)
    true = tunnel.alignment.position(np.linspace(*ZONE, 100))
    robust_axis = axes_found["robust, whole tunnel"]
    robust = robust_axis.position(robust_axis.foot(true))
    quadratics = axes_found["printed, 45 m"].quadratics @ (at ** np.arange(3)[:, None])
    shown = _thinned(zone)
    titles = ("XOY, from above", "YOZ, from the side")
    for k, (ax, column, title) in enumerate(zip(axes, (0, 2), titles, strict=True)):
        dots = {"color": GREY, "alpha": 0.25, "markersize": 1.2, "rasterized": True}
        handles = ax.plot(shown[:, 1], shown[:, column], ".", **dots, label="points")
        dots = {"color": BLUE, "markersize": 2.5, "label": "mid-values of 0.1 m"}
        handles += ax.plot(y, middle[:, k], ".", **dots)
        line = {"color": PRINTED, "linewidth": 2.0, "label": "quadratic, as printed"}
        handles += ax.plot(at, quadratics[k], "-", **line)
        line = {"color": TRUTH, "linewidth": 1.2, "label": "true axis"}
        handles += ax.plot(true[:, 1], true[:, column], "-", **line)
        line = {"color": ROBUST, "linestyle": (0, (2, 4)), "linewidth": 3.2}
        handles += ax.plot(robust[:, 1], robust[:, column], **line, label="robust axis")
        ax.set_title(title, **PLAIN)
        ax.set_ylabel(f"{'XZ'[k]} / m")
    axes[1].set_xlabel("Y along the tunnel / m")
    title = "How is the axis found, and where is it? The track bed lifts the printed one"
    headed(figure, title, handles, 5)
    lines = {
        "mid-value": np.stack([middle[:, 0], y, middle[:, 1]], axis=-1),
        "printed axis": np.stack([quadratics[0], at, quadratics[1]], axis=-1),
        "robust axis": robust,
        "true axis": true,
    }
    parts = []
    for kind, points in lines.items():
        x, along, z = points.T
        parts.append(pd.DataFrame({"kind": kind, "y_m": along, "x_m": x, "z_m": z}))
    publish(figure, f"{STEM}_axis", pd.concat(parts).round(DECIMALS))


def _thinned(cloud: EpochCloud) -> np.ndarray:
    """About ``SHOWN`` points of a cloud, evenly taken."""
    return cloud.points[:: max(1, len(cloud) // SHOWN)]


def filter_(
    cloud: EpochCloud, result: FilteredLining, tunnel: Tunnel, start: float, end: float
) -> None:
    """A piece of the tunnel before and after the filter, as a section and unrolled.

    (Figure 3 of Li et al. 2015.)
    """
    figure, axes = new(2, 2, height=5.6, height_ratios=(1.25, 1.0), sharex="row", sharey="row")
    chainage, u, v = tunnel.alignment.section_coordinates(cloud.points)
    here = (chainage > start) & (chainage < end)
    chainage, u, v, flags = chainage[here], u[here], v[here], result.flags[here]
    alpha = np.degrees(np.arctan2(u, v))
    kinds = (
        ("kept as lining", flags == LINING, GREY),
        ("inside the lining", flags == INSIDE, GROSS),
        ("outside", flags == OUTSIDE, BLUE),
    )
    columns = zip(axes.T, ("Before", "After"), (kinds, kinds[:1]), strict=True)
    for (section, unrolled), title, visible in columns:
        for _, where, colour in visible:
            style = {"color": colour, "markersize": 1.6, "rasterized": True}
            section.plot(u[where], v[where], ".", **style)
            unrolled.plot(chainage[where], alpha[where], ".", **style)
        section.set_title(title, **PLAIN)
        section.set_aspect("equal")
        section.set_xlabel("u to the right / m")
        unrolled.set_xlabel("chainage / m")
    axes[0, 0].set_ylabel("v up / m")
    axes[1, 0].set_ylabel("α from the crown / °")
    axes[1, 0].set_yticks([-180, -90, 0, 90, 180])
    dots = {"marker": "o", "linestyle": "none", "markersize": 4}
    handles = [key(color=colour, **dots, label=name) for name, _, colour in kinds]
    title = "What does the filter take off? Bed, catwalk, cables, lamps inside; pockets and joints"
    headed(figure, f"{title} outside", handles, 3)
    data = pd.DataFrame({"chainage_m": chainage, "u_m": u, "v_m": v, "flag": flags})
    publish(figure, f"{STEM}_filter", data.round(DECIMALS))


def crown(cells: pd.DataFrame, within: float = 20.0) -> None:
    """Mean deformation at the crown along the tunnel, before and after each rule of the filter.

    cells : from :func:`.filter_accuracy.cells`; within : degrees from the crown
    """
    figure, axes = new(2, 1, height=4.2, sharex=True, height_ratios=(1.4, 1.0))
    table = cells[cells["alpha_deg"].abs() <= within]
    columns = ["true_mm", "before_mm", "after_mm", "kept_percent"]
    means = table.groupby(["rule", "chainage_m"], sort=False)[columns].mean().reset_index()
    one = means[means["rule"] == means["rule"].iloc[0]].sort_values("chainage_m")
    truth = {"color": TRUTH, "markersize": 9, "label": "truth"}
    handles = axes[0].plot(one["chainage_m"], one["true_mm"], "_", **truth)
    before = {"color": GREY, "label": "all lining points"}
    handles += axes[0].plot(one["chainage_m"], one["before_mm"], "o", **before)
    for rule, (colour, marker) in RULES.items():
        rows = means[means["rule"] == rule].sort_values("chainage_m")
        style = {"color": colour, "markersize": 5, "markerfacecolor": "none"}
        after = {**style, "label": f"after: {rule}"}
        handles += axes[0].plot(rows["chainage_m"], rows["after_mm"], marker, **after)
        axes[1].plot(rows["chainage_m"], rows["kept_percent"], marker, **style)
    axes[0].set_ylabel("change of radius / mm")
    axes[1].set_ylabel("lining kept / %")
    axes[1].set_ylim(0, 105)
    axes[1].set_xlabel("chainage / m")
    headed(figure, "Does the filter eat the deformation? Cells within 20° of the crown", handles, 3)
    publish(figure, f"{STEM}_crown", means)


def epochs(
    clouds: Mapping[int, EpochCloud],
    linings: Mapping[int, FilteredLining],
    tunnel: Tunnel,
    at: float,
    thickness: float,
) -> None:
    """Both epochs in one system: from the side, and one section with its departures enlarged.

    (Figure 6 of Li et al. 2015.)
    """
    figure, (side, section) = new(1, 2, height=3.4, width_ratios=(1.9, 1.0))
    parts = []
    for epoch, cloud in clouds.items():
        colour, marker = EPOCHS[epoch]
        shown = _thinned(cloud)
        style = {"color": colour, "rasterized": True}
        side.plot(shown[:, 1], shown[:, 2], ".", markersize=1.0, alpha=0.35, **style)
        chainage, u, v = tunnel.alignment.section_coordinates(cloud.points)
        here = linings[epoch].lining & (np.abs(chainage - at) <= 0.5 * thickness)
        rho, alpha = np.hypot(u[here], v[here]), np.arctan2(u[here], v[here])
        far = RADIUS + EXAGGERATED * (rho - RADIUS)
        x, y = far * np.sin(alpha), far * np.cos(alpha)
        section.plot(x, y, marker, markersize=1.3, alpha=0.5, **style)
        for view, columns in (
            ("side", {"y_m": shown[:, 1], "z_m": shown[:, 2]}),
            ("section", {"alpha_deg": np.degrees(alpha), "rho_m": rho}),
        ):
            parts.append(pd.DataFrame({"view": view, "epoch": epoch} | columns))
    turn = np.linspace(-np.pi, np.pi, 200)
    section.plot(RADIUS * np.sin(turn), RADIUS * np.cos(turn), color=TRUTH, linewidth=0.8)
    section.set_aspect("equal")
    departures = f"departures from\na circle of 2.70 m × {EXAGGERATED:g}"
    section.set_title(f"Lining at {at:g} m, {departures}", **PLAIN)
    section.set_xlabel("u to the right / m")
    section.set_ylabel("v up / m")
    side.set_title("All points of the 45 m, from the side", **PLAIN)
    side.set_xlabel("Y along the tunnel / m")
    side.set_ylabel("Z / m")
    handles = []
    for epoch in clouds:
        colour, marker = EPOCHS[epoch]
        dots = {"color": colour, "marker": marker, "linestyle": "none", "markersize": 4}
        handles.append(key(**dots, label=f"epoch {epoch}"))
    headed(figure, "Do both epochs lie in one system?", handles, 2)
    publish(figure, f"{STEM}_epochs", pd.concat(parts).round(DECIMALS))


def density(counts: pd.DataFrame, readings: pd.DataFrame) -> None:
    """Points of a section by its distance from a station, and its empty directions by its points.

    counts, readings : from :func:`.section_counts` and :func:`.readings`
    """
    figure, (left, right) = new(1, 2, height=3.3)
    distance = np.geomspace(2.0, 20.0, 60)
    curve = ring_points(distance)
    computed = "one station, a whole ring (computed)"
    handles = left.plot(distance, curve, color=TRUTH, label=computed)
    for epoch, rows in counts.groupby("epoch"):
        colour, marker = EPOCHS[epoch]
        at = (1.0 + 0.02 * (2 * epoch - 3)) * rows["station_m"]  # the epochs side by side
        style = {"color": colour, "markersize": 5, "markerfacecolor": "none"}
        style["label"] = f"sections of epoch {epoch}, scaled to 4.5 million beams a station"
        handles += left.plot(at, rows["at_full_density"], marker, **style)
    left.set_xscale("log")
    left.set_yscale("log")
    left.set_xticks([2, 3, 5, 7, 10, 15, 20], ["2", "3", "5", "7", "10", "15", "20"])
    left.minorticks_off()
    left.set_xlabel("distance from the nearest station / m")
    left.set_ylabel("points in 50 mm")
    for reading, (colour, line) in READINGS.items():
        rows = readings[readings["reading"] == reading].sort_values("points")
        gaps = {"color": colour, "label": f"gaps, {reading}"}
        handles += right.plot(rows["points"], rows["gaps_percent"], line, **gaps)
        pale = {"color": colour, "alpha": 0.45, "markerfacecolor": "white"}
        pale["label"] = f"no point of its own, {reading}"
        handles += right.plot(rows["points"], 100.0 - rows["found_percent"], line, **pale)
    right.set_xscale("log")
    right.set_ylim(-4, 104)
    right.set_xlabel("lining points in the section")
    right.set_ylabel("share of the directions / %")
    title = "How many points has a section, and how many of its directions are empty?"
    headed(figure, title, handles, 2)
    parts = [
        pd.DataFrame({"panel": "ring", "station_m": distance, "at_full_density": curve}),
        counts[["epoch", "station_m", "at_full_density"]].assign(panel="section"),
        readings.assign(panel="directions"),
    ]
    publish(figure, f"{STEM}_density", pd.concat(parts))


def sections(of: Mapping[str, Section], tunnel: Tunnel, epoch: int) -> None:
    """Sections unrolled about the true axis: points, both readings with gaps, and the truth.

    of : name -> section
    """
    height = 1.0 + 1.9 * len(of)
    figure, axes = new(len(of), 1, height=height, sharex=True, sharey=True, squeeze=False)
    parts = []
    for ax, (name, section) in zip(axes[:, 0], of.items(), strict=True):
        handles, table = _unrolled(ax, section, tunnel, epoch)
        ax.set_title(f"{name}: {section.count} points", **PLAIN)
        ax.set_ylabel("ρ − 2.70 m / mm")
        parts.append(table.assign(section=name))
    axes[-1, 0].set_xlabel("α from the crown / °")
    axes[-1, 0].set_xticks(np.arange(-135, 136, 45))
    axes[0, 0].set_ylim(-14, 14)
    million = f"{FULL_DENSITY / 1e6:g} million"
    headed(figure, f"What does a section hold at {million} beams a station?", handles, 5)
    columns = ["section", "kind", "alpha_deg", "rho_m", "plane"]
    publish(figure, f"{STEM}_sections", pd.concat(parts)[columns].round(DECIMALS))


def _unrolled(ax, section: Section, tunnel: Tunnel, epoch: int) -> tuple[list, pd.DataFrame]:
    """Draw one section and return the handles and a table of what is shown."""
    radii, local = equal_angles(section), local_radii(section)
    degrees = np.degrees(radii.directions)
    chainage = tunnel.alignment.section_coordinates(section.position)[0]
    truth = tunnel.true_radius(radii.directions, chainage, epoch)

    def plot(at, rho, line, **style):
        return ax.plot(at, 1e3 * (rho - RADIUS), line, **style)

    dots = {"color": GREY, "markersize": 2, "alpha": 0.5, "rasterized": True}
    handles = plot(np.degrees(section.alpha), section.rho, ".", **dots, label="points")
    every = np.broadcast_to(degrees, radii.radius.shape)
    for kind, where, marker, colour in (
        ("found", ~radii.gaps & ~radii.interpolated, ".", PRINTED),
        ("interpolated", radii.interpolated, "x", GROSS),
    ):
        style = {"color": colour, "markersize": 3.5, "label": f"equal angles: {kind}"}
        handles += plot(every[where], radii.radius[where], marker, **style)
    quadratics = {"color": ROBUST, "linewidth": 1.6, "label": "local quadratics"}
    handles += plot(degrees, local.radius, "-", **quadratics)
    handles += plot(degrees, truth, "-", color=TRUTH, linewidth=0.9, label="truth")

    shown = [("points", np.degrees(section.alpha), section.rho, np.nan)]
    shown += [
        ("local quadratics", degrees, local.radius, np.nan),
        ("truth", degrees, truth, np.nan),
    ]
    for plane in range(3):
        states = [radii.gaps[plane], radii.interpolated[plane]]
        kinds = np.select(states, ["gap", "interpolated"], "found")
        shown.append((kinds, degrees, radii.radius[plane], plane))
    columns = ("kind", "alpha_deg", "rho_m", "plane")
    return handles, pd.concat([pd.DataFrame(dict(zip(columns, row, strict=True))) for row in shown])
