"""The printed numbers of Ou & Liu (2017) and their comparison with ours.

The paper prints two simulated experiments (tables 1 and 2, without and with gross errors) and one
with real scans (table 3). The simulated points were never published: a printed number belongs to
one draw of the authors', ours to another. So it is compared with the distribution over many
redraws of the simulation, and the last printed digit says how exactly it is known.

Source: Ou J., Liu W. (2017): Fitting of sphere point clouds by weighted total least squares based
on IGG III scheme. Laser Technology 41(5), 749-753, doi:10.7510/jgjs.issn.1001-3806.2017.05.026.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from decimal import Decimal

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from . import tables
from .paths import PUBLISHED

REPRODUCED = "reproduced to the printed digits"
INSIDE = "inside the 95 % interval"
OUTSIDE = "outside"
VERDICTS = (REPRODUCED, INSIDE, OUTSIDE)

METHODS = {"LS": "ls", "TLS": "tls", "IGG III-WTLS": "igg3_wtls"}  # as printed -> our name
TITLES = {1: "500 points without gross errors", 2: "the same with five gross errors"}
SYMBOLS = {
    "abs_delta_a_m": "|Δa|",
    "abs_delta_b_m": "|Δb|",
    "abs_delta_c_m": "|Δc|",
    "abs_delta_r_m": "|Δr|",
    "sigma_0": "σ0",
    "sigma_s_m": "σs",
}


@dataclass(frozen=True)
class PrintedNumber:
    """One number as the paper prints it.

    `text` is the number as printed and `decimals` the decimal places it is known to: those of the
    text itself, except for a bare ``0``, which stands for 0.0000 like its neighbours. `sample` is
    the scanned sphere of table 3 (``"I"``, ``"II"``) and empty for the simulations.

    Example
    -------
    >>> number = PrintedNumber("ou_liu_2017", 2, "", "ls", "abs_delta_a_m", "0.0670", 4, "m")
    >>> number.value, number.half_unit, number.significant_digits
    (0.067, 5e-05, 3)
    """

    paper: str
    table: int
    sample: str
    method: str
    quantity: str
    text: str
    decimals: int
    unit: str

    @property
    def value(self) -> float:
        """The printed number in `unit`."""
        return float(self.text)

    @property
    def half_unit(self) -> float:
        """Half a unit of the last printed digit, in `unit`."""
        return 0.5 * 10.0**-self.decimals

    @property
    def significant_digits(self) -> int:
        """Printed digits from the first that is not zero; 1 for a printed zero."""
        return len(Decimal(self.text).as_tuple().digits)

    def agrees(self, values: ArrayLike) -> NDArray[np.bool_]:
        """Tell which `values` (any shape) are this number when rounded to its decimals."""
        return np.round(np.asarray(values, dtype=float), self.decimals) == self.value


@dataclass(frozen=True)
class Comparison:
    """A printed number beside ours; values in the unit of `printed`.

    `ours` belongs to the committed cloud; `median`, `lower` and `upper` are the median and the
    limits of the central 95 % of the redraws; `percentile` is where the printed number lies among
    them; `matching_digits` counts the significant digits in which `ours` agrees with print;
    `redraws` were compared and `no_sphere` left out because the method found no real sphere.
    """

    printed: PrintedNumber
    ours: float
    median: float
    lower: float
    upper: float
    percentile: float
    matching_digits: int
    redraws: int
    no_sphere: int
    verdict: str


def printed_numbers(table: int) -> tuple[PrintedNumber, ...]:
    """Return the numbers of table 1, 2 or 3 of Ou & Liu (2017), row by row.

    The heads of tables 1 to 3 give σ0 in m. For LS and TLS it is the root mean square of the
    algebraic residual |p - k|² - R², an area: with R = √200 m and the printed σs of table 1,
    2 R σs = 0.0798 m² beside the printed 0.08004. So its unit is m² here. For IGG III-WTLS, eq.
    (18) with weights 1/m² leaves m.

    Raises
    ------
    ValueError : `table` is not 1, 2 or 3.

    Example
    -------
    >>> number = printed_numbers(1)[4]
    >>> number.method, number.quantity, number.text, number.unit
    ('ls', 'sigma_0', '0.08004', 'm²')
    """
    if table not in (1, 2, 3):
        raise ValueError(f"expected table 1, 2 or 3, got {table!r}")
    # As text: a trailing zero says how exactly a number is known.
    frame = pd.read_csv(PUBLISHED / f"ou_liu_2017_table{table}.csv", dtype=str, encoding="utf-8")
    columns = [column for column in frame if column not in ("sample", "method")]
    # The only bare zeros are errors of parameters, all printed to the same number of decimals.
    of_zero = max(_decimals(t) for c in columns if c.startswith("abs_delta") for t in frame[c])
    return tuple(
        PrintedNumber(
            paper="ou_liu_2017",
            table=table,
            sample=row.get("sample", ""),
            method=METHODS[row["method"]],
            quantity="sigma_0" if column == "sigma_0_m" else column,
            text=row[column],
            decimals=of_zero if row[column] == "0" else _decimals(row[column]),
            unit="m²" if column == "sigma_0_m" and row["method"] in ("LS", "TLS") else "m",
        )
        for row in frame.to_dict("records")
        for column in columns
    )


def verdict(printed: PrintedNumber, median: float, lower: float, upper: float) -> str:
    """Return the verdict on a printed number: the one rule, used everywhere.

    - reproduced to the printed digits: the median of the redraws, rounded to the printed
      decimals, is the printed number;
    - inside the 95 % interval: else, what rounds to the printed number (printed ± half a unit of
      its last digit) overlaps the central 95 % [lower, upper] of the redraws;
    - outside: else.

    Example
    -------
    >>> number = PrintedNumber("ou_liu_2017", 1, "", "ls", "sigma_s_m", "0.00282", 5, "m")
    >>> verdict(number, median=0.00287, lower=0.00274, upper=0.00301)
    'inside the 95 % interval'
    """
    if printed.agrees(median):
        return REPRODUCED
    if lower <= printed.value + printed.half_unit and printed.value - printed.half_unit <= upper:
        return INSIDE
    return OUTSIDE


def compare(printed: PrintedNumber, ours: float, redraws: ArrayLike) -> Comparison:
    """Compare a printed number with ours and with the redraws of the simulation.

    Parameters
    ----------
    printed : the number.
    ours : the value for the committed cloud, in the unit of `printed`.
    redraws : (B,) values for B redrawn clouds; NaN where the method found no real sphere. These
        are counted and left out.

    Returns
    -------
    Comparison. Its percentile is the mid-rank in percent: the redraws below the printed number,
    and half of those that round to it.

    Raises
    ------
    ValueError : `redraws` is not one-dimensional, or holds nothing but NaN.

    Example
    -------
    >>> number = PrintedNumber("ou_liu_2017", 1, "", "ls", "abs_delta_r_m", "0.0014", 4, "m")
    >>> result = compare(number, ours=0.0013, redraws=[0.0002, 0.0005, 0.0014, 0.0016, np.nan])
    >>> result.percentile, result.no_sphere, result.verdict
    (62.5, 1, 'inside the 95 % interval')
    """
    redraws = np.asarray(redraws, dtype=float)
    if redraws.ndim != 1:
        raise ValueError(f"expected redraws of shape (B,), got {redraws.shape}")
    found = redraws[~np.isnan(redraws)]
    if found.size == 0:
        name = f"{printed.quantity} of {printed.method} in table {printed.table}"
        raise ValueError(f"expected at least one redraw with a sphere for {name}, got none")
    lower, median, upper = np.quantile(found, [0.025, 0.5, 0.975]).tolist()
    ties = printed.agrees(found)
    below = (found < printed.value) & ~ties
    return Comparison(
        printed=printed,
        ours=float(ours),
        median=median,
        lower=lower,
        upper=upper,
        percentile=float(100 * (below.sum() + ties.sum() / 2) / found.size),
        matching_digits=_matching_digits(printed, ours),
        redraws=found.size,
        no_sphere=redraws.size - found.size,
        verdict=verdict(printed, median, lower, upper),
    )


def comparison_table(
    table: int,
    ours: Mapping[tuple[str, str], float],
    redraws: Mapping[tuple[str, str], ArrayLike],
) -> pd.DataFrame:
    """Compare every number of table 1 or 2; one row a printed number.

    Parameters
    ----------
    table : 1 or 2. The scans of table 3 are not published, so it has nothing to be compared with.
    ours : (method, quantity) -> the value for the committed cloud.
    redraws : (method, quantity) -> (B,) values for the redrawn clouds, as in `compare`.

    Methods are ``ls``, ``tls``, ``igg3_wtls``; quantities ``abs_delta_a_m``, ``abs_delta_b_m``,
    ``abs_delta_c_m``, ``abs_delta_r_m``, ``sigma_0``, ``sigma_s_m``.

    Raises
    ------
    ValueError : another table.
    KeyError : a (method, quantity) of the table is missing.

    Example
    -------
    >>> keys = [(number.method, number.quantity) for number in printed_numbers(1)]
    >>> frame = comparison_table(1, dict.fromkeys(keys, 0.0), dict.fromkeys(keys, [0.0, 0.001]))
    >>> len(frame), frame.loc[1, ["method", "quantity", "verdict"]].tolist()
    (18, ['ls', 'abs_delta_b_m', 'inside the 95 % interval'])
    """
    if table not in TITLES:
        raise ValueError(f"expected table 1 or 2, the simulations, got {table!r}")
    rows = []
    for printed in printed_numbers(table):
        key = printed.method, printed.quantity
        result = compare(printed, ours[key], redraws[key])
        rows.append(
            {
                "paper": printed.paper,
                "table": printed.table,
                "method": printed.method,
                "quantity": printed.quantity,
                "unit": printed.unit,
                "printed": printed.value,
                "decimals": printed.decimals,
                "ours": result.ours,
                "median": result.median,
                "lower": result.lower,
                "upper": result.upper,
                "percentile": result.percentile,
                "matching_digits": result.matching_digits,
                "redraws": result.redraws,
                "no_sphere": result.no_sphere,
                "verdict": result.verdict,
            }
        )
    return pd.DataFrame(rows)


def headline(comparison_tables: Iterable[pd.DataFrame]) -> str:
    """Return all comparisons as aligned text for the terminal, at most 110 columns wide.

    Parameters
    ----------
    comparison_tables : frames of `comparison_table`, computed or read back from their CSV files.

    Example
    -------
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
    verdicts = ", ".join(f"{(every['verdict'] == word).sum()} {word}" for word in VERDICTS)
    lines = f"{len(every)} printed numbers: {verdicts}."
    failed = every[every["no_sphere"] > 0].groupby(["table", "method"], sort=False)["no_sphere"]
    for (table, method), count in failed.max().items():
        lines += f"\nTable {table}, {method}: {count} redraws without a real sphere left out."
    return lines


def _decimals(text: str) -> int:
    """Return the decimal places of a number as printed: 4 for 0.0670, 9 for 7.7080e-5."""
    return max(0, -int(Decimal(text).as_tuple().exponent))


def _matching_digits(printed: PrintedNumber, ours: float) -> int:
    """Return how many significant digits of the printed number ours agrees in.

    All of them when ours rounds to it; else the whole part of -log10 of the relative difference,
    which, unlike a comparison of digits, sees that 0.0999 is close to 0.1000.
    """
    if printed.agrees(ours):
        return printed.significant_digits
    if printed.value == 0 or not np.isfinite(ours):
        return 0
    digits = -np.log10(abs(ours - printed.value) / abs(printed.value))
    return int(np.clip(np.floor(digits), 0, printed.significant_digits - 1))
