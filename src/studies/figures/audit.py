"""The figure of notebook 11: every printed number at once."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib import pyplot

from analysis.export.figures import GREY

from ..printed.judgement import CAUSE, CONSISTENT, IMPOSSIBLE, NOT_CHECKABLE, REPRODUCED
from ..publish import publish

STEM = "11_audit"
SETTING = "of these a setting, taken over"

# verdict -> colour, marker, size, filled
MARKS = {
    REPRODUCED: ("#009E73", "o", 6, True),
    CONSISTENT: ("#0072B2", "o", 5, False),
    CAUSE: ("#E69F00", "D", 5, True),
    IMPOSSIBLE: ("#D55E00", "X", 7.5, True),
    NOT_CHECKABLE: (GREY, "s", 5, False),
    SETTING: ("#BBBBBB", "s", 5, True),
}
WORDS = {  # verdict -> lines of the key
    REPRODUCED: "reproduced: the median of our\nredraws rounds to it, or the\nclaim holds",
    CONSISTENT: "consistent: our redraws give\nsuch numbers",
    CAUSE: "differs, cause shown",
    IMPOSSIBLE: "impossible as printed, proved;\n×3: beyond its bound by 3",
    NOT_CHECKABLE: "not checkable: data not\npublished",
    SETTING: "of these a setting, taken over",
}
FARTHEST = 1e3  # half-widths, the end of the axes
NO_REDRAWS = -400.0  # where a number without redraws stands
LAYOUT = [
    ["table 1", "table 2", "table 3, sphere I", "table 3, sphere II"],
    ["ou_liu_2017", "gains", "li_2015", "key"],
]
LAYOUT += [["ou_liu_2017", "wu_chen_wang", "li_2015", "key"]]
HEIGHTS = (4.3, 1.75, 2.35)  # inches
TEXTS = {
    "ou_liu_2017": "Text on the sphere",
    "wu_chen_wang": "… claims and settings",
    "li_2015": "Text on the tunnel",
}
SHORT = {  # how the last part of an id is written beside its mark
    "radius_true": "true radius √200 m",
    "n_points": "number of points",
    "square": "square of 20 m",
    "gross_points": "which points are gross errors",
    "k0": "k0 = 1.5",
    "k1": "k1 = 2.5",
    "k0_usual": "usual range of k0",
    "k1_usual": "usual range of k1",
    "delta0": "stop at 1e-6",
    "radius_nominal": "nominal radius 72.5 mm",
    "rel_radius_I_LS": "Δr of sphere I by LS: 1.38 %",
    "rel_radius_I_TLS": "… by TLS: 1.38 %",
    "rel_radius_I_IGG": "… by IGG III-WTLS: 0.14 %",
    "rel_radius_II_LS": "Δr of sphere II by LS: 1.52 %",
    "rel_radius_II_TLS": "… by TLS: 1.52 %",
    "rel_radius_II_IGG": "… by IGG III-WTLS: 1.10 %",
    "b_difference_II": "LS and TLS differ in one b",
    "claim_no_error": "below 1.5 σ there is no error",
    "claim_digits": "table 1: digits kept explain it",
    "claim_table1_close": "table 1: all are close",
    "claim_table1_sigma_0": "table 1: IGG III best by σ0",
    "claim_table2_ls": "table 2: LS is impaired",
    "claim_table2_tls_worst": "table 2: TLS is worst",
    "claim_table2_tls_reason": "table 2: why TLS is worst",
    "claim_table2_detected": "table 2: gross errors are found",
    "claim_table2_best": "table 2: IGG III best in all",
    "claim_table3_clean": "table 3: scans were cleaned",
    "claim_table3_ls_tls": "table 3: LS and TLS agree",
    "claim_table3_best": "table 3: IGG III best by σ0, σs",
    "claim_both_errors": "better as it knows both errors",
    "claim_more_robust": "more robust than LS and TLS",
    "claim_slow": "takes more time",
    "plane_true": "z = x + 3y + 1",
    "n_runs": "10 simulations",
    "noise": "noise σ²/cos θ",
    "sim_sigma0_gain_vs_LS": "LS −83 %",
    "sim_sigma0_gain_vs_TLS": "TLS −54 %",
    "sim_sigma_s_WTLS": "σs of WTLS",
    "sim_sigma_s_TLS": "σs of TLS",
    "sim_sigma_s_LS": "σs of LS",
    "real_sigma0_gain_vs_LS": "LS −76 %",
    "real_sigma0_gain_vs_TLS": "TLS −63 %",
    "real_sigma_s": "σs, all",
    "parameter_order": "closest: WTLS, TLS, LS",
    "claim_sim_best": "simulation: WTLS fits best",
    "claim_real_close": "scan: all find the same plane",
    "claim_real_best": "scan: WTLS fits best",
    "claim_no_second_derivatives": "no second derivatives needed",
    "claim_constant_column": "exact column is better",
    "tunnel_length": "130 m of tunnel",
    "section_spacing": "13 sections, every 10 m",
    "stations_epoch_1": "6 stations in epoch 1",
    "stations_epoch_2": "4 stations in epoch 2",
    "points_per_station": "4.5 million points a station",
    "registration": "registered within 2 mm",
    "scanner_precision": "scanner: 2 mm at 100 m",
    "scanner_rate": "scanner: 300 000 points/s",
    "scanner_range": "scanner: 500 m",
    "targets": "5 and 4 targets",
    "targets_least": "at least 3 targets",
    "similarity_parameters": "7 parameters",
    "axis_step": "step of the axis 0.1 m",
    "analysed_length": "45 m analysed",
    "threshold_1": "black up to 6 mm",
    "threshold_2": "red from 12 mm",
    "section_thickness": "slab of 50 mm",
    "half_thickness": "25 mm before and behind",
    "alpha_range": "directions −135° to 135°",
    "max_deformation": "up to 10.9, 21.2, 24.3 mm",
    "epochs": "March and July 2013",
    "claim_crown_and_sides": "largest at crown and sides",
    "claim_vertical_over_horizontal": "vertical above horizontal",
    "claim_stickers": "stickers agree within 6 mm",
    "claim_every_direction": "deformation in all directions",
}


def every_number(verdicts: pd.DataFrame) -> None:
    """Which printed numbers can be believed? Each where it lies among the redraws, or with the
    bound that it violates.

    verdicts : of `studies.verdicts.verdicts`. Left of and right of the median a number is measured
        in half-widths of the central 95 %: within ±1 the redraws give it, and a factor beside a
        cross says how far it violates its bound.
    """
    data = verdicts.assign(half_widths=_half_widths(verdicts))
    data["mark"] = data["verdict"].mask(data["setting"], SETTING)
    in_table = data["place"].str.startswith("table")
    table, _, method = zip(*data["place"].str.rpartition(", ").to_numpy(), strict=True)
    scanned = (
        data["id"]
        .str.contains("/real_")
        .map({True: "ground scan: σ0 of WTLS, σs", False: "simulation: σ0 of WTLS, σs"})
    )
    data["group"] = pd.Series(method, data.index).where(in_table, scanned)
    figure, axes = pyplot.subplot_mosaic(
        LAYOUT, figsize=(9.4, sum(HEIGHTS)), height_ratios=HEIGHTS, layout="constrained"
    )
    for name in LAYOUT[0]:
        _panel(
            axes[name],
            data[in_table & (pd.Series(table, data.index) == name)],
            f"Sphere: {name.replace(', sphere ', ', ')}",
        )
    measured = ~in_table & data["half_widths"].notna()
    _panel(axes["gains"], data[measured], "Text on the plane")
    for paper, title in TEXTS.items():
        _list(axes[paper], data[~in_table & ~measured & (data["paper"] == paper)], title)
    _key(axes["key"], data)
    title = f"Which of {len(data)} printed numbers and claims can be believed?"
    figure.suptitle(title, fontweight="bold", fontsize=11, x=0.01, ha="left")
    publish(figure, f"{STEM}_every_number", data.drop(columns=["why", "quantity", "mark", "group"]))


def _half_widths(verdicts: pd.DataFrame) -> list[float]:
    """Printed less median, over the distance of the limit of the central 95 % on that side; NaN
    without redraws.
    """
    found = []
    for line in verdicts.itertuples():
        if np.isnan(line.median):
            found.append(np.nan)
            continue
        printed = float(line.printed)
        width = line.upper - line.median if printed > line.median else line.median - line.lower
        found.append((printed - line.median) / width)
    return found


def _panel(ax, data: pd.DataFrame, title: str) -> None:
    """Numbers beside redraws, a line each, groups separated; what has no redraws stands at the left
    edge.
    """
    ax.axvspan(-1, 1, color="#E4E4E4", zorder=0)
    ax.axvline(0, color=GREY, lw=0.8)
    labels, y = [], 0.0
    for group, lines in data.groupby("group", sort=False):
        ax.annotate(
            group,
            (0.02, y + 0.3),
            xycoords=("axes fraction", "data"),
            fontsize=7,
            color="#555555",
            va="center",
        )
        for line in lines.itertuples():
            y += 1
            x = (
                NO_REDRAWS
                if np.isnan(line.half_widths)
                else np.clip(line.half_widths, -FARTHEST, FARTHEST)
            )
            _mark(ax, x, y, line.mark)
            if line.verdict == IMPOSSIBLE:
                ax.annotate(
                    f"×{line.factor:.2g}",
                    (x, y),
                    (6, 0),
                    textcoords="offset points",
                    va="center",
                    fontsize=7,
                )
            labels.append((y, SHORT.get(line.id.rpartition("/")[2], line.quantity)))
        y += 0.8
    ax.set_yticks(*zip(*labels, strict=True), fontsize=7)
    ax.set_ylim(y, 0)
    ax.set_xscale("symlog", linthresh=1, linscale=0.7)
    ax.set_xlim(-FARTHEST, FARTHEST)
    ax.set_xticks([-100, -10, 0, 10, 100], ["−100", "−10", "0", "10", "100"], fontsize=6.5)
    ax.minorticks_off()
    ax.set_xlabel("half-widths of 95 % from the median", fontsize=7)
    ax.set_title(title)
    ax.grid(axis="y", visible=False)


def _list(ax, data: pd.DataFrame, title: str) -> None:
    """Statements of a text in words or without redraws: a mark and a few words each."""
    for y, line in enumerate(data.itertuples()):
        _mark(ax, 0, y, line.mark)
        ax.annotate(SHORT[line.id.rpartition("/")[2]], (0.6, y), fontsize=7, va="center")
    ax.set_xlim(-0.5, 10)
    ax.set_ylim(max(len(data), 12) - 0.3, -0.7)
    ax.set_title(title)
    ax.axis("off")


def _key(ax, data: pd.DataFrame) -> None:
    """Legend of the marks, with how many there are of each."""
    counts = _counts(data)
    y = 0.0
    for word, count in counts.items():
        _mark(ax, 0.4, y, word)
        ax.annotate(str(count), (2.3, y), fontsize=8.5, fontweight="bold", va="center", ha="right")
        ax.annotate(WORDS[word], (2.8, y - 0.35), fontsize=7.5, va="top")
        y += 0.9 + 0.75 * len(WORDS[word].splitlines())
    words = (
        "Grey band: the central 95 % of our\nredraws of the experiment.\nAt the left "
        "edge: no redraws."
    )
    ax.annotate(words, (0, y + 0.5), fontsize=7.5, va="top")
    ax.set_xlim(-0.2, 10)
    ax.set_ylim(18, -0.9)
    ax.set_title("What the marks say")
    ax.axis("off")


def _counts(data: pd.DataFrame) -> dict[str, int]:
    """How many numbers have which verdict, and how many of what is not checkable are settings."""
    counts = data["verdict"].value_counts().to_dict() | {SETTING: int(data["setting"].sum())}
    return {word: counts[word] for word in MARKS if counts.get(word)}


def _mark(ax, x: float, y: float, word: str) -> None:
    colour, marker, size, filled = MARKS[word]
    face = colour if filled else "white"
    ax.plot(
        x,
        y,
        ls="",
        marker=marker,
        color=colour,
        markersize=size,
        markerfacecolor=face,
        markeredgewidth=1.2,
        clip_on=False,
    )
