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
from .methods import SPHERE_METHODS
from .paths import PUBLISHED, ROOT

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
            unit=SPHERE_METHODS[METHODS[row["method"]]].sigma_0_unit if column == "sigma_0_m" else "m",
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


def side_by_side(table: int, ours: Mapping[str, Mapping[str, float]], labels: Mapping[str, str]) -> pd.DataFrame:
    """Return table 1 or 2 as printed with ours below every printed row; errors are absolute.

    Parameters
    ----------
    table : 1 or 2.
    ours : method -> quantity -> the value for the committed cloud; methods the paper does not have come last.
    labels : method -> what the table calls it.

    Returns
    -------
    Frame of text, numbers at the decimals of print; σ0 with its unit, because the paper's heads give m for an area.

    Example
    -------
    >>> ours = {method: dict.fromkeys(SYMBOLS, 0.001) for method in ("ls", "tls", "igg3_wtls")}
    >>> print(side_by_side(1, ours, {}).iloc[:2, :6].to_string(index=False))
    method  source |Δa|/m |Δb|/m |Δc|/m |Δr|/m
        LS printed 0.0002 0.0000 0.0016 0.0014
        LS    ours 0.0010 0.0010 0.0010 0.0010
    """
    if table not in TITLES:
        raise ValueError(f"expected table 1 or 2, the simulations, got {table!r}")
    numbers = {method: [n for n in printed_numbers(table) if n.method == method] for method in METHODS.values()}
    rows = []
    for label, method in METHODS.items():
        rows.append(_row(label, "printed", numbers[method], {n.quantity: n.value for n in numbers[method]}))
        rows.append(_row(label, "ours", numbers[method], ours[method]))
    for method in ours:
        if method not in numbers:
            alike = "tls" if SPHERE_METHODS[method].sigma_0_unit == "m²" else "igg3_wtls"  # a printed row with the unit of its σ0
            rows.append(_row(labels[method], "ours", numbers[alike], ours[method]))
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


def _row(label: str, source: str, numbers: Iterable[PrintedNumber], values: Mapping[str, float]) -> dict[str, str]:
    """Return a row of `side_by_side`: the values at the decimals of the numbers."""
    row = {"method": label, "source": source}
    for number in numbers:
        shown = f"{values[number.quantity]:z.{number.decimals}f}"
        if number.quantity == "sigma_0":
            row |= {"σ0": shown, "unit": number.unit}
        else:
            row[f"{SYMBOLS[number.quantity]}/m"] = shown
    return row


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
