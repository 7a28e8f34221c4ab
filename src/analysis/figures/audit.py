"""The figure of notebook 10: every printed number at once."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.lines import Line2D

from ..audit.judgement import CAUSE, CONSISTENT, IMPOSSIBLE, INPUT, NOT_CHECKABLE, REPRODUCED, WAITING
from ..audit.verdicts import TITLES
from ..published import METHODS
from . import GREY, TRUTH, new, publish

STEM = "10_audit"

# verdict -> colour, marker, size, filled
MARKS = {
    REPRODUCED: ("#009E73", "o", 6, True),
    CONSISTENT: ("#0072B2", "o", 5, False),
    CAUSE: ("#E69F00", "D", 5, True),
    IMPOSSIBLE: ("#D55E00", "X", 7.5, True),
    NOT_CHECKABLE: (GREY, "s", 5, False),
    INPUT: ("#BBBBBB", "s", 5, True),
    WAITING: (TRUTH, "$?$", 6, True),
}
FARTHEST = 1e3  # half-widths, the end of the axes
SHORT = {  # how the end of an id is written beside its line
    "sim_sigma0_gain_vs_LS": "83 % of LS",
    "sim_sigma0_gain_vs_TLS": "54 % of TLS",
    "sim_sigma_s_WTLS": "σs WTLS",
    "sim_sigma_s_TLS": "σs TLS",
    "sim_sigma_s_LS": "σs LS",
}
COLUMNS = 12  # squares in a line of the text's panel


def every_number(verdicts: pd.DataFrame) -> None:
    """Which printed numbers can be believed? Each where it lies among the redraws, or with the bound that it violates.

    verdicts : of `audit.verdicts.verdicts`. Left of and right of the median a number is measured in half-widths of the central 95 %:
    within ±1 the redraws give it, and a factor beside a cross says how far it violates its bound.
    """
    data = verdicts.assign(half_widths=_half_widths(verdicts))
    measured = data["half_widths"].notna()
    tables_of = data["place"].str.partition(", IGG")[0].str.replace(r", (LS|TLS)$", "", regex=True)
    figure, axes = new(2, 3, height=8.6, width=8.2)
    names = ["table 1", "table 2", "table 3, sphere I", "table 3, sphere II"]
    for ax, name in zip([axes[0, 0], axes[0, 1], axes[1, 0], axes[1, 1]], names, strict=True):
        _panel(ax, data[tables_of == name], name[0].upper() + name[1:])
    in_text = ~data["place"].str.startswith("table")
    _panel(axes[0, 2], data[in_text & measured], "Plane paper, text")
    _squares(axes[1, 2], data[in_text])
    marks = [word for word in MARKS if (data["verdict"] == word).any()]
    words = {IMPOSSIBLE: f"{IMPOSSIBLE} (× over its bound)"}
    handles = [_handle(word, f"{words.get(word, word)}: {(data['verdict'] == word).sum()}") for word in marks]
    figure.legend(handles=handles, loc="outside lower center", ncols=2, fontsize=8)
    title = f"Which of {len(data)} printed numbers and claims can be believed?"
    figure.suptitle(title, fontweight="bold", fontsize=10.5, x=0.01, ha="left")
    publish(figure, f"{STEM}_every_number", data.drop(columns=["why", "quantity"]))


def _half_widths(verdicts: pd.DataFrame) -> list[float]:
    """Printed less median, over the distance of the limit of the central 95 % on that side; NaN without redraws."""
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
    """One table: a line a number, methods separated."""
    if data.empty:
        ax.axis("off")
        return
    ax.axvspan(-1, 1, color="#EDEDED", zorder=0)
    ax.axvline(0, color=GREY, lw=0.8)
    labels, y = [], 0.0
    previous = data["place"].iloc[0]
    for line in data.itertuples():
        y += 1.7 if line.place != previous else 1
        if y == 1 or line.place != previous:
            heading = line.place.rpartition(", ")[2]
            if heading in METHODS:
                ax.annotate(heading, (0.02, y - 0.75), xycoords=("axes fraction", "data"), fontsize=6.5, color=GREY, va="center")
        previous = line.place
        x = 0 if np.isnan(line.half_widths) else np.clip(line.half_widths, -FARTHEST, FARTHEST)
        _mark(ax, x, y, line.verdict)
        if line.verdict == IMPOSSIBLE:
            ax.annotate(f"×{line.factor:.2g}", (x, y), (6, 0), textcoords="offset points", va="center", fontsize=6.5)
        end = line.id.rpartition("/")[2]
        labels.append((y, line.quantity if line.place.startswith("table") else SHORT.get(end, end)))
    ax.set_yticks(*zip(*labels, strict=True), fontsize=7)
    ax.set_ylim(y + 0.7, 0)
    ax.set_xscale("symlog", linthresh=1, linscale=1.2)
    ax.set_xlim(-FARTHEST, FARTHEST)
    ax.set_xticks([-100, -10, -1, 0, 1, 10, 100], ["−100", "−10", "−1", "0", "1", "10", "100"], fontsize=7)
    ax.minorticks_off()
    ax.set_xlabel("from the median, in half-widths of 95 %", fontsize=7.5)
    ax.set_title(title)
    ax.grid(axis="y", visible=False)


def _squares(ax, data: pd.DataFrame) -> None:
    """What the texts state, one mark each, by paper."""
    y = 0.0
    for paper, title in TITLES.items():
        mine = data[data["paper"] == paper]
        ax.annotate(f"{title}: {len(mine)}", (-0.4, y), fontsize=7.5, va="center")
        for place, verdict in enumerate(mine["verdict"]):
            _mark(ax, place % COLUMNS, y + 1 + place // COLUMNS, verdict)
        y += 2.4 + (len(mine) - 1) // COLUMNS
    ax.set_xlim(-0.8, COLUMNS - 0.2)
    ax.set_ylim(max(y, 12) - 0.5, -0.8)
    ax.set_title("All that the texts state")
    ax.axis("off")


def _mark(ax, x: float, y: float, verdict: str) -> None:
    colour, marker, size, filled = MARKS[verdict]
    face = colour if filled else "white"
    ax.plot(x, y, ls="", marker=marker, color=colour, markersize=size, markerfacecolor=face, markeredgewidth=1.2, clip_on=False)


def _handle(verdict: str, label: str) -> Line2D:
    colour, marker, size, filled = MARKS[verdict]
    return Line2D([], [], ls="", marker=marker, color=colour, markersize=size, markerfacecolor=colour if filled else "white", label=label)
