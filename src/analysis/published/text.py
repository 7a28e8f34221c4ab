"""The comparisons in words: the headline for terminal and README, what is outside and why, and where everything is."""

from __future__ import annotations

from collections.abc import Iterable

import pandas as pd

from .. import tables
from ..paths import ROOT
from .comparison import OUTSIDE, VERDICTS
from .numbers import METHODS, SYMBOLS, TITLES

# Why a number is outside: (table, method, quantity) -> cause. Notebook 03 shows what each rests on.
_CENTRE_CONTRADICTS_SIGMA_0 = "contradicts its own row: the printed centre leaves a larger σ0 than printed, whatever the radius"
_LARGER_THAN_LITERAL = "unexplained: a larger error than the literal reading makes; some other readings are as inexact"
CAUSES = {
    (1, "igg3_wtls", "abs_delta_c_m"): "chance: a smaller error than most redraws have; one or two of 36 such numbers are to be expected",
    (1, "igg3_wtls", "sigma_0"): "not determined: σ0 is proportional to √P_X, and the paper does not print P_X",
    (2, "ls", "abs_delta_a_m"): "unexplained: the paper does not say where its gross errors lie, and ours rarely pull so far to one side",
    (2, "ls", "abs_delta_r_m"): "contradicts its own row: with the printed Δc and σ0 the residuals of LS cannot add up to zero",
    (2, "tls", "abs_delta_a_m"): _CENTRE_CONTRADICTS_SIGMA_0,
    (2, "tls", "abs_delta_r_m"): _CENTRE_CONTRADICTS_SIGMA_0,
    (2, "igg3_wtls", "abs_delta_a_m"): "unexplained: a larger error than by any reading of the algorithm that keeps most of the points",
    (2, "igg3_wtls", "abs_delta_b_m"): _LARGER_THAN_LITERAL,
    (2, "igg3_wtls", "abs_delta_c_m"): _LARGER_THAN_LITERAL,
    (2, "igg3_wtls", "abs_delta_r_m"): "contradicts its own row: it leaves many times the printed σ0; table 3 prints the same as a radius",
    (2, "igg3_wtls", "sigma_0"): "unexplained: the P_X that gives it is not the one that gives σ0 of table 1, and no reading gives both",
}

# What the paper shows -> where it is here. Where the file is a comparison its verdicts are counted, the others have theirs in words.
PAPER_TO_PROJECT = (
    ("figure 1, the simulated points", "01_simulated_sphere", "data/simulated", "drawn again: the authors' points are not published"),
    ("equations (1) to (18)", "02_sphere_methods", "src/analysis/igg3.py", "as printed; what each misprint changes is shown"),
    ("table 1, without gross errors", "03_sphere_tables", "data/results/03_sphere_tables_table1.csv", None),
    ("table 2, with five gross errors", "03_sphere_tables", "data/results/03_sphere_tables_table2.csv", None),
    ("table 3, by simulated scans (its own are unpublished)", "04_real_spheres", "data/results/04_real_spheres_table3_cleaned.csv", None),
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
    blocks = [
        f"**{_title(frame)}**\n\n{tables.markdown(_headline_frame(frame), 1)}"
        for frame in comparison_tables
    ]
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
                "verdict": words or _counted(tables.read(ROOT / file)),
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
        result[head] = [
            f"{value:z.{decimals}f}" for value, decimals in zip(frame[column], frame["decimals"], strict=True)
        ]
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


def _counted(frame: pd.DataFrame) -> str:
    """Return how many numbers of a comparison have which verdict, in words."""
    return ", ".join(f"{(frame['verdict'] == word).sum()} {word}" for word in VERDICTS)
