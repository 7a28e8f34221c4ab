"""The comparisons in words: the headline for terminal and README, what is outside and why, and where everything is."""

from __future__ import annotations

from collections.abc import Iterable

import pandas as pd

from .. import tables
from ..paths import ROOT
from .comparison import OUTSIDE, VERDICTS
from .numbers import METHODS, SYMBOLS, TITLES

# Why a number is outside: (table, method, quantity) -> cause. Notebooks 03 and 10 show what each rests on.
_CENTRE_CONTRADICTS_SIGMA_0 = "contradicts its own row: the printed centre leaves a larger σ0 than printed, whatever the radius"
_UNSEEN = "unseen gross error: of gross errors of random size, one below 1.5 σ = 0.3 m keeps its weight and does this"
CAUSES = {
    (1, "igg3_wtls", "abs_delta_c_m"): "chance: a smaller error than most redraws have; one or two of 36 such numbers are to be expected",
    (1, "igg3_wtls", "sigma_0"): "not determined: proportional to √P_X, which is not printed; "
    "P_X of 1/5 to 1/4 gives it and, with a gross error unseen, table 2",
    (2, "ls", "abs_delta_a_m"): "not determined: it hangs on where the gross errors lie; five are found that give the row, all but Δr",
    (2, "ls", "abs_delta_r_m"): "contradicts its own row: no five gross errors balance the residuals it leaves; the rest is within reach",
    (2, "tls", "abs_delta_a_m"): _CENTRE_CONTRADICTS_SIGMA_0,
    (2, "tls", "abs_delta_r_m"): _CENTRE_CONTRADICTS_SIGMA_0,
    (2, "igg3_wtls", "abs_delta_a_m"): _UNSEEN + ", though rarely so much",
    (2, "igg3_wtls", "abs_delta_b_m"): _UNSEEN,
    (2, "igg3_wtls", "abs_delta_c_m"): _UNSEEN,
    (2, "igg3_wtls", "abs_delta_r_m"): "contradicts its own row: the sphere would not lie between its points; "
    "table 3 prints the same as a radius",
    (2, "igg3_wtls", "sigma_0"): _UNSEEN,
}


def _counted(frame: pd.DataFrame, words: Iterable[str] = VERDICTS) -> str:
    """Return how many numbers of a comparison have which verdict, in words."""
    return ", ".join(f"{(frame['verdict'] == word).sum()} {word}" for word in words)


def _audited(frame: pd.DataFrame) -> str:
    """Return the verdicts of the audit that occur, counted, in the order in which they do."""
    return _counted(frame, frame["verdict"].unique())


def _inside(frame: pd.DataFrame) -> str:
    """Return how many numbers of the plane paper's simulation are inside."""
    return f"{frame['inside'].sum()} of {len(frame)} inside; the gains are a change of unit"


def _ground_scan(frame: pd.DataFrame) -> str:
    """Return what a simulated ground scan has of the printed numbers."""
    within = (frame["lower"] <= frame["printed"] + frame["half_unit"]) & (frame["printed"] - frame["half_unit"] <= frame["upper"])
    return f"{within.sum()} of {len(frame)} inside: the gains follow from where the scanner stands; σs has the right size"


def _iterations(frame: pd.DataFrame) -> str:
    """Return the iterations of the quasi-Newton method and of Newton's on the plane."""
    count = frame.set_index("run")["plane"]
    return f"ends where Newton's method does: {count['BFGS']:.0f} iterations against {count['Newton']:.0f}"


def _joints(frame: pd.DataFrame) -> str:
    """Return how near neighbouring stations come to the printed 2 mm."""
    return f"2 mm is a standard deviation, not a limit: kept at {frame['within_percent'].mean():.0f} % of the wall between stations"


def _maxima(frame: pd.DataFrame) -> str:
    """Return how well the printed maxima, given to the simulated tunnel, are found again."""
    largest = frame.groupby("case")["largest_rms_mm"].max()
    scans, singly, jointly = (largest[case] for case in ("noise alone", "stations registered singly", "joint adjustment"))
    return f"taken as truth: found again to {scans:.1f} mm; with stations registered singly to {singly:.1f}, jointly to {jointly:.1f} mm"


# What the papers show -> where it is here. What a file says is counted (a function of its table); else the verdict is in words.
RESULTS = "data/results/"
PAPER_TO_PROJECT = (
    ("every number and claim of the three papers", "10_audit", f"{RESULTS}10_audit_verdicts.csv", _audited),
    (
        "sphere: figure 1, the simulated points",
        "01_simulated_sphere",
        "data/simulated",
        "drawn again: the authors' points are not published",
    ),
    ("sphere: equations (1) to (18)", "02_sphere_methods", "src/analysis/igg3.py", "as printed; what each misprint changes is shown"),
    ("sphere: table 1, without gross errors", "03_sphere_tables", f"{RESULTS}03_sphere_tables_table1.csv", _counted),
    ("sphere: table 2, with five gross errors", "03_sphere_tables", f"{RESULTS}03_sphere_tables_table2.csv", _counted),
    (
        "sphere: table 3, by simulated scans (its own are unpublished)",
        "04_real_spheres",
        f"{RESULTS}04_real_spheres_table3_cleaned.csv",
        _counted,
    ),
    ("plane: simulation, 83 %, 54 %, σs", "06_plane_simulation", f"{RESULTS}06_plane_simulation_five.csv", _inside),
    ("plane: ground scan, 76 %, 63 %, 1.09 mm", "07_plane_scan", f"{RESULTS}07_plane_scan_printed.csv", _ground_scan),
    ("plane: quasi-Newton algorithm", "07_plane_scan", f"{RESULTS}07_plane_scan_counts.csv", _iterations),
    ("tunnel: registration within 2 mm", "08_tunnel_campaign", f"{RESULTS}08_tunnel_campaign_joints.csv", _joints),
    (
        "tunnel: figure 2, the axis",
        "08_tunnel_campaign",
        "figures/08_tunnel_campaign_axis.png",
        "parallel to the tunnel, but lifted by the track bed",
    ),
    ("tunnel: figure 3, the filter", "08_tunnel_campaign", "figures/08_tunnel_campaign_filter.png", "drawn from the simulated campaign"),
    ("tunnel: figure 6, both epochs", "08_tunnel_campaign", "figures/08_tunnel_campaign_epochs.png", "drawn from the simulated campaign"),
    (
        "tunnel: figure 4, a section projected",
        "09_tunnel_deformation",
        "figures/09_tunnel_deformation_projection.png",
        "drawn from the simulated campaign",
    ),
    (
        "tunnel: figure 5, deformation by direction",
        "09_tunnel_deformation",
        "figures/09_tunnel_deformation_polar.png",
        "drawn from the simulated campaign",
    ),
    (
        "tunnel: figure 7, classes of 6 and 12 mm",
        "09_tunnel_deformation",
        "figures/09_tunnel_deformation_classes.png",
        "drawn from the simulated campaign",
    ),
    ("tunnel: table 1 and the largest deformations", "09_tunnel_deformation", f"{RESULTS}09_tunnel_deformation_recovery.csv", _maxima),
    (
        "tunnel: table 2, by direction",
        "09_tunnel_deformation",
        f"{RESULTS}09_tunnel_deformation_directions.csv",
        "its form, with standard deviations and the truth",
    ),
)


def headline(comparison_tables: Iterable[pd.DataFrame]) -> str:
    """Return all comparisons as aligned text for the terminal, at most 110 columns wide.

    Parameters
    ----------
    comparison_tables : frames of `comparison_table`, computed or read back from their CSV files.

    Example
    -------
    >>> from analysis.published import comparison_table, printed_numbers
    >>> keys = [(number.method, number.quantity) for number in printed_numbers(1)]
    >>> frame = comparison_table(1, dict.fromkeys(keys, 0.0), dict.fromkeys(keys, [0.0, 0.001]))
    >>> print(headline([frame]).splitlines()[0])
    Ou & Liu (2017), table 1: 500 points without gross errors
    """
    comparison_tables = list(comparison_tables)
    blocks = []
    for frame in comparison_tables:
        lines = tables.text(_headline_frame(frame), 1).splitlines()
        per_method = len(frame) // frame["method"].nunique()
        for start in range(len(lines) - per_method, 1, -per_method):
            lines.insert(start, "")
        blocks.append("\n".join([_title(frame), "", *lines]))
    return "\n\n\n".join([*blocks, _counts(comparison_tables)])


def headline_markdown(comparison_tables: Iterable[pd.DataFrame]) -> str:
    """Return all comparisons as Markdown for the README, one table for each table of the paper.

    Parameters
    ----------
    comparison_tables : frames of `comparison_table`, computed or read back from their CSV files.

    Example
    -------
    >>> from analysis.published import comparison_table, printed_numbers
    >>> keys = [(number.method, number.quantity) for number in printed_numbers(1)]
    >>> frame = comparison_table(1, dict.fromkeys(keys, 0.0), dict.fromkeys(keys, [0.0, 0.001]))
    >>> print(headline_markdown([frame]).splitlines()[0])
    **Ou & Liu (2017), table 1: 500 points without gross errors**
    """
    comparison_tables = list(comparison_tables)
    blocks = [f"**{_title(frame)}**\n\n{tables.markdown(_headline_frame(frame), 1)}" for frame in comparison_tables]
    return "\n\n".join([*blocks, _counts(comparison_tables)])


def outside_markdown(comparison_tables: Iterable[pd.DataFrame]) -> str:
    """Return the numbers that are outside, each with its cause, as a Markdown table."""
    return tables.markdown(outside(comparison_tables), 1)


def outside(comparison_tables: Iterable[pd.DataFrame]) -> pd.DataFrame:
    """Return the numbers that are outside, each with its cause; numbers of a row with the same cause together.

    Raises
    ------
    KeyError : a number is outside and `CAUSES` does not say why.
    """
    every = pd.concat(list(comparison_tables))
    labels = {name: label for label, name in METHODS.items()}
    rows: dict[tuple, list[str]] = {}
    for row in every[every["verdict"] == OUTSIDE].itertuples():
        cause = CAUSES[row.table, row.method, row.quantity]
        rows.setdefault((row.table, labels[row.method], cause), []).append(f"{SYMBOLS[row.quantity]} {row.printed:.{row.decimals}f}")
    return pd.DataFrame(
        [(table, method, ", ".join(numbers), cause) for (table, method, cause), numbers in rows.items()],
        columns=["table", "method", "printed", "cause"],
    )


def map_markdown() -> str:
    """Return the map from what the paper shows to notebook, files and verdict as a Markdown table."""
    rows = []
    for shown, notebook, file, words in PAPER_TO_PROJECT:
        rows.append(
            {
                "in the paper": shown,
                "notebook": f"[{notebook}](notebooks/{notebook}.ipynb)",
                "file": f"[{file}]({file})",
                "verdict": words if isinstance(words, str) else words(tables.read(ROOT / file)),
            }
        )
    return tables.markdown(pd.DataFrame(rows), 0)


def _headline_frame(frame: pd.DataFrame) -> pd.DataFrame:
    """Return a comparison as it is shown: each value at the decimals of its printed number."""
    shown = {"printed": "printed", "ours": "ours", "median": "median"}
    shown |= {"lower": "2.5 %", "upper": "97.5 %"}
    labels = {name: label for label, name in METHODS.items()}
    first = ~frame["method"].duplicated()
    result = pd.DataFrame(
        {
            "method": frame["method"].map(labels).where(first, ""),
            "": frame["quantity"].map(SYMBOLS),
            "unit": frame["unit"],
        }
    )
    for column, head in shown.items():
        result[head] = [f"{value:z.{decimals}f}" for value, decimals in zip(frame[column], frame["decimals"], strict=True)]
    result["percentile"] = frame["percentile"].astype(float)  # a file may hold 50 for 50.0
    result["verdict"] = frame["verdict"].str.split().str[0]  # the full words are in the last line
    return result


def _title(frame: pd.DataFrame) -> str:
    """Return the title of a comparison."""
    table = int(frame["table"].iloc[0])
    return f"Ou & Liu (2017), table {table}: {TITLES[table]}"


def _counts(comparison_tables: list[pd.DataFrame]) -> str:
    """Return how many numbers have which verdict, and how many redraws had no sphere."""
    every = pd.concat(comparison_tables)
    lines = f"{len(every)} printed numbers: {_counted(every)}."
    failed = every[every["no_sphere"] > 0].groupby(["table", "method"], sort=False)["no_sphere"]
    for (table, method), count in failed.max().items():
        lines += f"\nTable {table}, {method}: {count} redraws without a real sphere left out."
    return lines
