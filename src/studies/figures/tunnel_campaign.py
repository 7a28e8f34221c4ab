"""The figures of notebook 08: the campaign's map, registration, accuracy, axis, filter, both
epochs, and what a section holds.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.lines import Line2D

from analysis.export.figures import GREY, GROSS, TRUTH, headed, new
from analysis.tunnel.axis import Axis, mid_values
from analysis.tunnel.filter import INSIDE, LINING, OUTSIDE, FilteredLining
from analysis.tunnel.sections import Section, equal_angles, local_radii

from ..li_2015.epoch_cloud import EpochCloud
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
    "one cylinder": (GROSS, "--"),
    "cylinder by segments": ("#56B4E9", ":"),
    "cylinder and local surface": (ROBUST, "-"),
}
READINGS = {"equal angles": (PRINTED, "s", "--"), "local quadratics": (ROBUST, "o", "-")}
REGISTRATIONS = ((GROSS, "x", "--"), (ROBUST, "o", "-"))  # singly, jointly
SHOWN = 8_000  # points of a cloud in a figure
DECIMALS = 5  # of exported points, m
EXAGGERATED = 20.0  # times, departures from the circle
RADIUS = 2.7  # m


def map_(epochs, tunnel: Tunnel) -> None:
    """Plan and elevation: axis, control net, stations of both epochs with the targets they use,
    stickers.
    """
    figure, axes = new(2, 1, height=4.2, sharex=True)
    net, line = (
        control_net(*epochs),
        tunnel.alignment.position(np.linspace(0.0, tunnel.alignment.length, 100)),
    )
    stickers = epochs[0].stickers.true
    parts = [
        pd.DataFrame(line, columns=list("xyz")).assign(kind="axis", name=""),
        net.rename(columns={"target": "name"}).assign(kind="control point"),
        pd.DataFrame(stickers, columns=list("xyz")).assign(kind="sticker", name=""),
    ]
    for ax, row in zip(axes, "xz", strict=True):
        column = "xyz".index(row)
        (axis,) = ax.plot(line[:, 1], line[:, column], color=TRUTH, linewidth=1.0, label="axis")
        (sticker,) = ax.plot(
            stickers[:, 1], stickers[:, column], ".", color=GREY, markersize=4, label="stickers"
        )
        (control,) = ax.plot(
            net["y"],
            net[row],
            "D",
            color=TRUTH,
            markerfacecolor="white",
            markersize=4.5,
            label="control net",
        )
        handles = [axis, sticker, control]
        for epoch in epochs:
            colour, _ = EPOCHS[epoch.number]
            positions = np.array([one.pose.position for one in epoch.stations])
            for one in epoch.stations:
                for target in one.targets.true:
                    sight = np.stack([one.pose.position, target])
                    ax.plot(sight[:, 1], sight[:, column], color=colour, linewidth=0.6, alpha=0.8)
            marker = "^" if epoch.number == 1 else "v"
            label = f"stations and sights, epoch {epoch.number}"
            handles += ax.plot(
                positions[:, 1],
                positions[:, column],
                marker,
                color=colour,
                markersize=7,
                linestyle="none",
                label=label,
            )
        ax.axvspan(
            *(tunnel.alignment.position(end)[1] for end in ZONE),
            color=GREY,
            alpha=0.12,
            linewidth=0,
        )
        ax.set_ylabel(f"{row.upper()} / m")
    for epoch in epochs:
        found = pd.DataFrame([one.pose.position for one in epoch.stations], columns=list("xyz"))
        parts.append(
            found.assign(kind=f"station of epoch {epoch.number}", name=station_names(epoch))
        )
    axes[0].set_title("From above", fontweight="normal")
    axes[1].set_title("From the side", fontweight="normal")
    axes[1].set_xlabel("Y along the tunnel / m (shaded: the 45 m in which sections are cut)")
    headed(figure, "Where do the scanner and the targets stand?", handles, 5)
    publish(
        figure, f"{STEM}_map", pd.concat(parts)[["kind", "name", "x", "y", "z"]].round(DECIMALS)
    )


def start(table: pd.DataFrame) -> None:
    """Success of the model with thirteen parameters by the angle of the rotation; table from
    :func:`.start_study`.
    """
    figure, ax = new(width=5.0, height=2.8)
    middle = 0.5 * (table["from_deg"] + table["to_deg"])
    ax.plot(
        middle,
        table["found_from_svd_percent"],
        "o-",
        color=ROBUST,
        label="found, started from the SVD",
    )
    ax.plot(
        middle,
        table["found_from_identity_percent"],
        "s--",
        color=PRINTED,
        label="found, started from R = I",
    )
    ax.plot(
        middle,
        table["wrong_but_converged_percent"],
        "x:",
        color=GROSS,
        label="R = I: converged to a wrong rotation",
    )
    ax.set_xticks(np.append(table["from_deg"], table["to_deg"].iloc[-1]))
    ax.set_ylim(-4, 104)
    ax.set_xlabel("angle of the rotation / °")
    ax.set_ylabel("share of the trials / %")
    headed(
        figure,
        "Is R = I a safe start for the thirteen parameters?",
        ax.get_legend_handles_labels()[0],
        2,
    )
    publish(figure, f"{STEM}_start", table)


def between(table: pd.DataFrame) -> None:
    """Shift of the second epoch against the first by registration, true and stated; table from
    :func:`.between_epochs`.
    """
    figure, axes = new(2, 1, height=4.6, sharex=True, sharey=True)
    for ax, direction in zip(axes, ("right", "up"), strict=True):
        ax.axhline(0.0, color=TRUTH, linewidth=0.8)
        handles = []
        for (words, rows), (colour, marker, style) in zip(
            table.groupby("registration", sort=False), REGISTRATIONS, strict=True
        ):
            band, at = 1.96 * rows[f"{direction}_sd_mm"], rows["chainage_m"]
            handles += ax.plot(
                at, band, style, color=colour, label=f"{words}: stated, ±1.96 standard deviations"
            )
            ax.plot(at, -band, style, color=colour)
            handles += ax.plot(
                at,
                rows[f"{direction}_mm"],
                marker,
                color=colour,
                markersize=6,
                label=f"{words}: true",
            )
        ax.set_ylabel("shift / mm")
        ax.set_title(
            f"To the {direction}" if direction == "right" else "Upwards", fontweight="normal"
        )
    axes[1].set_xticks(table["chainage_m"].unique())
    axes[1].set_xlabel("chainage of the section / m")
    headed(figure, "How far apart does registration put the two epochs of a section?", handles, 2)
    publish(figure, f"{STEM}_between", table)


def stickers(differences: Mapping[int, pd.DataFrame]) -> None:
    """Scanner less total station at every sticker, with the mean of each station's stickers;
    differences by epoch.
    """
    figure, axes = new(1, 3, height=3.1, sharey=True)
    for ax, axis in zip(axes, "xyz", strict=True):
        column = f"d{axis}_mm"
        ax.axhspan(-JOINT_MM, JOINT_MM, color=GREY, alpha=0.2, linewidth=0)
        handles = [Line2D([], [], color=GREY, alpha=0.3, linewidth=7, label="±2 mm")]
        for epoch, table in differences.items():
            colour, marker = EPOCHS[epoch]
            aside = 0.7 * (2 * epoch - 3)
            style = {
                "color": colour,
                "marker": marker,
                "linestyle": "none",
                "markersize": 3,
                "alpha": 0.6,
            }
            handles += ax.plot(
                table["chainage_m"] + aside,
                table[column],
                **style,
                label=f"stickers, epoch {epoch}",
            )
            for _, rows in table.groupby("station"):
                ends = rows["chainage_m"].min() - 2, rows["chainage_m"].max() + 2
                level, label = 2 * [rows[column].mean()], f"means of its stations, epoch {epoch}"
                (mean,) = ax.plot(ends, level, color=colour, linewidth=2.0, label=label)
            handles.append(mean)
        ax.set_title(axis.upper(), fontweight="normal")
        ax.set_xlabel("chainage / m")
    axes[0].set_ylabel("scanner less total station / mm")
    headed(
        figure,
        "Do the scans agree with the total station? Stickers of one station err together",
        handles,
        3,
    )
    data = pd.concat([table.assign(epoch=epoch) for epoch, table in differences.items()])
    publish(figure, f"{STEM}_stickers", data)


def axis(
    zone: EpochCloud, axes_found: Mapping[str, Axis], tunnel: Tunnel, step: float = 0.1
) -> None:
    """The paper's figure 2: projections to XOY and YOZ with mid-values and the quadratics, the true
    axis, and the robust one.
    """
    figure, axes = new(2, 1, height=4.8, sharex=True)
    y, middle = mid_values(zone.points, step)
    at = np.linspace(y[0], y[-1], 100)
    true = tunnel.alignment.position(np.linspace(*ZONE, 100))
    printed, robust = (
        axes_found[name].position(axes_found[name].foot(true))
        for name in ("printed, 45 m", "robust, whole tunnel")
    )
    quadratics = axes_found["printed, 45 m"].quadratics @ (at ** np.arange(3)[:, None])
    shown = zone.points[:: max(1, len(zone) // SHOWN)]
    parts = [
        pd.DataFrame({"kind": "mid-value", "y_m": y, "x_m": middle[:, 0], "z_m": middle[:, 1]})
    ]
    as_printed = np.stack([quadratics[0], at, quadratics[1]], axis=-1)
    for name, points in (
        ("printed axis", as_printed),
        ("robust axis", robust),
        ("true axis", true),
    ):
        parts.append(
            pd.DataFrame(
                {"kind": name, "y_m": points[:, 1], "x_m": points[:, 0], "z_m": points[:, 2]}
            )
        )
    for k, (ax, column, title) in enumerate(
        zip(axes, (0, 2), ("XOY, from above", "YOZ, from the side"), strict=True)
    ):
        (dots,) = ax.plot(
            shown[:, 1],
            shown[:, column],
            ".",
            color=GREY,
            alpha=0.25,
            markersize=1.2,
            rasterized=True,
        )
        dots.set_label("points")
        (mids,) = ax.plot(
            y, middle[:, k], ".", color=BLUE, markersize=2.5, label="mid-values of 0.1 m"
        )
        (curve,) = ax.plot(
            at, quadratics[k], "-", color=PRINTED, linewidth=2.0, label="quadratic, as printed"
        )
        (truth,) = ax.plot(
            true[:, 1], true[:, column], "-", color=TRUTH, linewidth=1.2, label="true axis"
        )
        (found,) = ax.plot(
            robust[:, 1],
            robust[:, column],
            color=ROBUST,
            linestyle=(0, (2, 4)),
            linewidth=3.2,
            label="robust axis",
        )
        ax.set_title(title, fontweight="normal")
        ax.set_ylabel(f"{'XZ'[k]} / m")
    axes[1].set_xlabel("Y along the tunnel / m")
    headed(
        figure,
        "How is the axis found, and where is it? The track bed lifts the printed one",
        [dots, mids, curve, truth, found],
        5,
    )
    publish(figure, f"{STEM}_axis", pd.concat(parts).round(DECIMALS))


def filter_(
    cloud: EpochCloud, result: FilteredLining, tunnel: Tunnel, start: float, end: float
) -> None:
    """The paper's figure 3: a piece of the tunnel before and after the filter, as a section and
    unrolled.
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
    for column, (title, visible) in enumerate((("Before", kinds), ("After", kinds[:1]))):
        for _, where, colour in visible:
            style = {
                "color": colour,
                "marker": ".",
                "linestyle": "none",
                "markersize": 1.6,
                "rasterized": True,
            }
            axes[0, column].plot(u[where], v[where], **style)
            axes[1, column].plot(chainage[where], alpha[where], **style)
        axes[0, column].set_title(title, fontweight="normal")
        axes[0, column].set_aspect("equal")
        axes[0, column].set_xlabel("u to the right / m")
        axes[1, column].set_xlabel("chainage / m")
    axes[0, 0].set_ylabel("v up / m")
    axes[1, 0].set_ylabel("α from the crown / °")
    axes[1, 0].set_yticks([-180, -90, 0, 90, 180])
    handles = [
        Line2D([], [], color=colour, marker="o", linestyle="none", markersize=4, label=name)
        for name, _, colour in kinds
    ]
    headed(
        figure,
        "What does the filter take off? Bed, catwalk, cables, lamps inside; pockets and joints outside",
        handles,
        3,
    )
    publish(
        figure,
        f"{STEM}_filter",
        pd.DataFrame({"chainage_m": chainage, "u_m": u, "v_m": v, "flag": flags}).round(DECIMALS),
    )


def crown(cells: pd.DataFrame, within: float = 20.0) -> None:
    """Mean deformation of the cells at the crown along the tunnel, before and after each rule of
    the filter, and the share that is left.
    """
    figure, axes = new(2, 1, height=4.2, sharex=True, height_ratios=(1.4, 1.0))
    table = cells[cells["alpha_deg"].abs() <= within]
    every = (
        table.groupby(["rule", "chainage_m"], sort=False)[
            ["true_mm", "before_mm", "after_mm", "kept_percent"]
        ]
        .mean()
        .reset_index()
    )
    one = every[every["rule"] == every["rule"].iloc[0]].sort_values("chainage_m")
    handles = axes[0].plot(
        one["chainage_m"],
        one["true_mm"],
        color=TRUTH,
        marker="_",
        markersize=9,
        linestyle="none",
        label="truth",
    )
    handles += axes[0].plot(
        one["chainage_m"],
        one["before_mm"],
        color=GREY,
        marker="o",
        linestyle="none",
        label="all lining points",
    )
    for (rule, (colour, _)), marker in zip(RULES.items(), "x+^", strict=True):
        rows = every[every["rule"] == rule].sort_values("chainage_m")
        style = {
            "color": colour,
            "marker": marker,
            "markersize": 5,
            "markerfacecolor": "none",
            "linestyle": "none",
        }
        handles += axes[0].plot(
            rows["chainage_m"], rows["after_mm"], **style, label=f"after: {rule}"
        )
        axes[1].plot(rows["chainage_m"], rows["kept_percent"], **style)
    axes[0].set_ylabel("change of radius / mm")
    axes[1].set_ylabel("lining kept / %")
    axes[1].set_ylim(0, 105)
    axes[1].set_xlabel("chainage / m")
    headed(figure, "Does the filter eat the deformation? Cells within 20° of the crown", handles, 3)
    publish(figure, f"{STEM}_crown", every)


def epochs(
    clouds: Mapping[int, EpochCloud],
    linings: Mapping[int, FilteredLining],
    tunnel: Tunnel,
    at: float,
    thickness: float,
) -> None:
    """The paper's figure 6: both epochs in one system, from the side, and one section with its
    departures from a circle exaggerated.
    """
    figure, axes = new(1, 2, height=3.4, width_ratios=(1.9, 1.0))
    parts = []
    for epoch, cloud in clouds.items():
        colour, marker = EPOCHS[epoch]
        every = max(1, len(cloud) // SHOWN)
        shown = cloud.points[::every]
        style = {"color": colour, "linestyle": "none", "rasterized": True}
        axes[0].plot(shown[:, 1], shown[:, 2], ".", markersize=1.0, alpha=0.35, **style)
        chainage, u, v = tunnel.alignment.section_coordinates(cloud.points)
        here = linings[epoch].lining & (np.abs(chainage - at) <= 0.5 * thickness)
        rho, alpha = np.hypot(u[here], v[here]), np.arctan2(u[here], v[here])
        far = RADIUS + EXAGGERATED * (rho - RADIUS)
        axes[1].plot(
            far * np.sin(alpha), far * np.cos(alpha), marker, markersize=1.3, alpha=0.5, **style
        )
        parts.append(
            pd.DataFrame({"view": "side", "epoch": epoch, "y_m": shown[:, 1], "z_m": shown[:, 2]})
        )
        parts.append(
            pd.DataFrame(
                {"view": "section", "epoch": epoch, "alpha_deg": np.degrees(alpha), "rho_m": rho}
            )
        )
    turn = np.linspace(-np.pi, np.pi, 200)
    axes[1].plot(RADIUS * np.sin(turn), RADIUS * np.cos(turn), color=TRUTH, linewidth=0.8)
    axes[1].set_aspect("equal")
    axes[1].set_title(
        f"Lining at {at:g} m, departures from\na circle of 2.70 m × {EXAGGERATED:g}",
        fontweight="normal",
    )
    axes[1].set_xlabel("u to the right / m")
    axes[1].set_ylabel("v up / m")
    axes[0].set_title("All points of the 45 m, from the side", fontweight="normal")
    axes[0].set_xlabel("Y along the tunnel / m")
    axes[0].set_ylabel("Z / m")
    handles = [
        Line2D(
            [],
            [],
            color=EPOCHS[k][0],
            marker=EPOCHS[k][1],
            linestyle="none",
            markersize=4,
            label=f"epoch {k}",
        )
        for k in clouds
    ]
    headed(figure, "Do both epochs lie in one system?", handles, 2)
    publish(figure, f"{STEM}_epochs", pd.concat(parts).round(DECIMALS))


def density(counts: pd.DataFrame, readings: pd.DataFrame) -> None:
    """Points in a section by its distance from the nearest station, and what the directions of a
    section hold by its points.
    """
    figure, axes = new(1, 2, height=3.3)
    distance = np.geomspace(2.0, 20.0, 60)
    curve = ring_points(distance)
    ax = axes[0]
    (line,) = ax.plot(distance, curve, color=TRUTH, label="one station, a whole ring (computed)")
    handles = [line]
    for epoch, rows in counts.groupby("epoch"):
        colour, marker = EPOCHS[epoch]
        aside = 1.0 + 0.02 * (2 * epoch - 3)
        label = f"sections of epoch {epoch}, scaled to 4.5 million beams a station"
        style = {
            "color": colour,
            "marker": marker,
            "linestyle": "none",
            "markersize": 5,
            "markerfacecolor": "none",
        }
        handles += ax.plot(aside * rows["station_m"], rows["at_full_density"], **style, label=label)
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_xticks([2, 3, 5, 7, 10, 15, 20], ["2", "3", "5", "7", "10", "15", "20"])
    ax.minorticks_off()
    ax.set_xlabel("distance from the nearest station / m")
    ax.set_ylabel("points in 50 mm")
    ax = axes[1]
    for reading, (colour, marker, line) in READINGS.items():
        rows = readings[readings["reading"] == reading].sort_values("points")
        handles += ax.plot(
            rows["points"],
            rows["gaps_percent"],
            marker + line,
            color=colour,
            label=f"gaps, {reading}",
        )
        empty = 100.0 - rows["found_percent"]
        pale = {
            "color": colour,
            "alpha": 0.45,
            "markerfacecolor": "white",
            "label": f"no point of its own, {reading}",
        }
        handles += ax.plot(rows["points"], empty, marker + line, **pale)
    ax.set_xscale("log")
    ax.set_ylim(-4, 104)
    ax.set_xlabel("lining points in the section")
    ax.set_ylabel("share of the directions / %")
    headed(
        figure,
        "How many points has a section, and how many of its directions are empty?",
        handles,
        2,
    )
    shown = pd.concat(
        [
            pd.DataFrame({"panel": "ring", "station_m": distance, "at_full_density": curve}),
            counts[["epoch", "station_m", "at_full_density"]].assign(panel="section"),
            readings.assign(panel="directions"),
        ]
    )
    publish(figure, f"{STEM}_density", shown)


def sections(of: Mapping[str, Section], tunnel: Tunnel, epoch: int) -> None:
    """Sections unrolled, about the true axis: points, what the equal-angle search finds and
    interpolates, gaps, and the truth.
    """
    figure, axes = new(
        len(of), 1, height=1.0 + 1.9 * len(of), sharex=True, sharey=True, squeeze=False
    )
    parts = []
    for ax, (name, section) in zip(axes[:, 0], of.items(), strict=True):
        radii, local = equal_angles(section), local_radii(section)
        degrees = np.degrees(radii.directions)
        chainage = tunnel.alignment.section_coordinates(section.position)[0]
        truth = tunnel.true_radius(radii.directions, chainage, epoch)
        style = {
            "color": GREY,
            "markersize": 2,
            "alpha": 0.5,
            "label": "points",
            "rasterized": True,
        }
        handles = ax.plot(np.degrees(section.alpha), 1e3 * (section.rho - RADIUS), ".", **style)
        every = np.broadcast_to(degrees, radii.radius.shape)
        for label, where, marker in (
            ("found", ~radii.gaps & ~radii.interpolated, "."),
            ("interpolated", radii.interpolated, "x"),
        ):
            colour = PRINTED if label == "found" else GROSS
            style = {
                "color": colour,
                "linestyle": "none",
                "markersize": 3.5,
                "label": f"equal angles: {label}",
            }
            handles += ax.plot(every[where], 1e3 * (radii.radius[where] - RADIUS), marker, **style)
        handles += ax.plot(
            degrees,
            1e3 * (local.radius - RADIUS),
            color=ROBUST,
            linewidth=1.6,
            label="local quadratics",
        )
        handles += ax.plot(
            degrees, 1e3 * (truth - RADIUS), color=TRUTH, linewidth=0.9, label="truth"
        )
        ax.set_title(f"{name}: {section.count} points", fontweight="normal")
        ax.set_ylabel("ρ − 2.70 m / mm")
        parts.append(
            pd.DataFrame(
                {
                    "section": name,
                    "kind": "points",
                    "alpha_deg": np.degrees(section.alpha),
                    "rho_m": section.rho,
                }
            )
        )
        for kind, values in (("local quadratics", local.radius), ("truth", truth)):
            parts.append(
                pd.DataFrame({"section": name, "kind": kind, "alpha_deg": degrees, "rho_m": values})
            )
        for plane in range(3):
            kinds = np.select(
                [radii.gaps[plane], radii.interpolated[plane]], ["gap", "interpolated"], "found"
            )
            parts.append(
                pd.DataFrame(
                    {
                        "section": name,
                        "kind": kinds,
                        "plane": plane,
                        "alpha_deg": degrees,
                        "rho_m": radii.radius[plane],
                    }
                )
            )
    axes[-1, 0].set_xlabel("α from the crown / °")
    axes[-1, 0].set_xticks(np.arange(-135, 136, 45))
    axes[0, 0].set_ylim(-14, 14)
    headed(
        figure,
        f"What does a section hold at {FULL_DENSITY / 1e6:g} million beams a station?",
        handles,
        5,
    )
    publish(figure, f"{STEM}_sections", pd.concat(parts).round(DECIMALS))
