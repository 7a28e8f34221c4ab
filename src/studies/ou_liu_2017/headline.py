"""The comparisons of tables 1 and 2 as the headline of terminal and README."""

from __future__ import annotations

from collections.abc import Iterable

import pandas as pd

from analysis.export import tables

from ..printed.comparison import counted
from .printed_tables import LABELS, SYMBOLS, TITLES


def text(comparison_tables: Iterable[pd.DataFrame]) -> str:
    """Return all comparisons as aligned text for the terminal, at most 110 columns wide.

    Parameters
    ----------
    comparison_tables : frames of `comparison_table`, computed or read back from their CSV files.

    Example
    -------
    >>> from studies.ou_liu_2017.comparison import comparison_table
    >>> from studies.ou_liu_2017.printed_tables import printed_numbers
    >>> keys = [(number.method, number.quantity) for number in printed_numbers(1)]
    >>> frame = comparison_table(1, dict.fromkeys(keys, 0.0), dict.fromkeys(keys, [0.0, 0.001]))
    >>> print(text([frame]).splitlines()[0])
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


def markdown(comparison_tables: Iterable[pd.DataFrame]) -> str:
    """Return all comparisons as Markdown for the README, one table for each table of the paper.

    Parameters
    ----------
    comparison_tables : frames of `comparison_table`, computed or read back from their CSV files.

    Example
    -------
    >>> from studies.ou_liu_2017.comparison import comparison_table
    >>> from studies.ou_liu_2017.printed_tables import printed_numbers
    >>> keys = [(number.method, number.quantity) for number in printed_numbers(1)]
    >>> frame = comparison_table(1, dict.fromkeys(keys, 0.0), dict.fromkeys(keys, [0.0, 0.001]))
    >>> print(markdown([frame]).splitlines()[0])
    **Ou & Liu (2017), table 1: 500 points without gross errors**
    """
    comparison_tables = list(comparison_tables)
    blocks = [
        f"**{_title(frame)}**\n\n{tables.markdown(_headline_frame(frame), 1)}"
        for frame in comparison_tables
    ]
    return "\n\n".join([*blocks, _counts(comparison_tables)])


def _headline_frame(frame: pd.DataFrame) -> pd.DataFrame:
    """Return a comparison as it is shown: each value at the decimals of its printed number."""
    shown = {"printed": "printed", "ours": "ours", "median": "median"}
    shown |= {"lower": "2.5 %", "upper": "97.5 %"}
    first = ~frame["method"].duplicated()
    result = pd.DataFrame(
        {
            "method": frame["method"].map(LABELS).where(first, ""),
            "": frame["quantity"].map(SYMBOLS),
            "unit": frame["unit"],
        }
    )
    for column, head in shown.items():
        result[head] = [
            f"{value:z.{decimals}f}"
            for value, decimals in zip(frame[column], frame["decimals"], strict=True)
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
    lines = f"{len(every)} printed numbers: {counted(every)}."
    failed = every[every["no_sphere"] > 0].groupby(["table", "method"], sort=False)["no_sphere"]
    for (table, method), count in failed.max().items():
        lines += f"\nTable {table}, {method}: {count} redraws without a real sphere left out."
    return lines
