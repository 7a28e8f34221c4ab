"""The figures of notebook 01: the simulated cloud and its noise."""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.export.figures import GREY, GROSS, PAGE, TRUTH, new

from ..ou_liu_2017 import evidence
from ..ou_liu_2017.clouds import GROSS_POINTS, SPHERE_CENTER, SPHERE_RADIUS
from ..publish import publish

STEM = "01_simulated_sphere"
# a gross error
CROSS = {"s": 45, "color": GROSS, "marker": "X", "edgecolors": "white", "linewidths": 0.6}
LABEL = {"color": GROSS, "fontweight": "bold"}  # and its number


def cloud(points: NDArray[np.float64]) -> None:
    """Figure 1 of Ou & Liu (2017): the cloud with its gross errors numbered, and how deep they lie.

    Parameters: points, the (500, 3) cloud with gross errors, m.
    Exports number, x_m, y_m, z_m, gross (0 or 1), distance_m from the true sphere.
    """
    data = pd.DataFrame(points, columns=["x_m", "y_m", "z_m"])
    data.insert(0, "number", np.arange(1, len(points) + 1))
    data["gross"] = data["number"].isin(GROSS_POINTS).astype(int)
    data["distance_m"] = evidence.true_distances(points)
    good, gross = data[data["gross"] == 0], data[data["gross"] == 1]

    figure, (left, right) = new(
        1, 2, height=3.5, gridspec_kw={"width_ratios": [1.15, 1], "wspace": 0.12}
    )
    space = figure.add_subplot(left.get_subplotspec(), projection="3d")
    left.remove()
    space.computed_zorder = False  # else the points of the cap hide the gross errors below it
    space.scatter(
        good["x_m"], good["y_m"], good["z_m"], s=5, color=GREY, linewidths=0, depthshade=False
    )
    space.scatter(gross["x_m"], gross["y_m"], gross["z_m"], depthshade=False, **CROSS)
    for row in gross.itertuples():
        point = np.array([row.x_m, row.y_m, row.z_m])
        on_sphere = SPHERE_CENTER + (point - SPHERE_CENTER) * SPHERE_RADIUS / (
            SPHERE_RADIUS + row.distance_m
        )
        space.plot(*np.transpose([point, on_sphere]), color=GROSS, linewidth=1)
        side = "right" if row.number == 53 else "left"  # 67 is on the right of 53
        space.text(*point, f"   {row.number}   ", ha=side, va="center", **LABEL)
    space.set_title("500 points on the cap, five replaced")
    space.set(
        xlabel="x / m",
        ylabel="y / m",
        xticks=[0, 10, 20],
        yticks=[0, 10, 20],
        zticks=[0, 5, 10, 15],
    )
    space.text(20, 20, 17, "z / m", ha="center")
    space.tick_params(pad=-1)
    space.set_box_aspect((20, 20, 15), zoom=1.12)
    space.view_init(elev=20, azim=-60)

    right.axhline(0, color=TRUTH, linewidth=0.8, zorder=1)
    right.scatter(good["number"], good["distance_m"], s=5, color=GREY, linewidths=0)
    right.scatter(gross["number"], gross["distance_m"], **CROSS)
    for row in gross.itertuples():
        # Beside the mark: towards the middle, and for the first of two neighbours below it.
        place = {12: ((0, -14), "center"), 465: ((-6, -3), "right")}.get(
            row.number, ((6, -3), "left")
        )
        right.annotate(
            str(row.number),
            (row.number, row.distance_m),
            place[0],
            textcoords="offset points",
            ha=place[1],
            **LABEL,
        )
    right.set_title("They lie inside the sphere, by metres")
    right.set(
        xlabel="point number",
        ylabel="distance from the true sphere / m",
        xlim=(-15, 515),
        ylim=(-3.0, 0.4),
    )
    publish(figure, f"{STEM}_cloud", data)


def noise(histogram: pd.DataFrame) -> None:
    """The distances of the clean cloud from the true sphere, as a histogram beside the normal law.

    Parameters: histogram, from :func:`evidence.distance_histogram`. exported as it is.
    """
    figure, axes = new(width=0.6 * PAGE, height=2.7)
    middle = 500 * (histogram["lower_m"] + histogram["upper_m"])
    width = 1e3 * (histogram["upper_m"] - histogram["lower_m"])
    axes.bar(
        middle,
        histogram["count"],
        width,
        color=GREY,
        edgecolor="white",
        linewidth=0.5,
        label="500 points",
    )
    axes.plot(
        middle,
        histogram["expected"],
        color=TRUTH,
        marker="o",
        markersize=2.5,
        label="normal law, sd = 10 mm / √12",
    )
    axes.set_title("Rounding to 0.01 m looks like normal noise of 3 mm")
    axes.set(xlabel="distance from the true sphere / mm", ylabel="points in a class of 0.5 mm")
    axes.set_ylim(0, 1.3 * max(histogram["count"].max(), histogram["expected"].max()))
    axes.legend(loc="upper right", ncols=2, columnspacing=1.2, handlelength=1.6)
    publish(figure, f"{STEM}_noise", histogram)
