"""A printed number beside ours: the one rule that gives the verdict, and the tables that follow
from it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from analysis.methods import SPHERE_METHODS

from .numbers import METHODS, SYMBOLS, TITLES, PrintedNumber, printed_numbers

REPRODUCED = "reproduced to the printed digits"
INSIDE = "inside the 95 % interval"
OUTSIDE = "outside"
VERDICTS = (REPRODUCED, INSIDE, OUTSIDE)


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
    table: int, ours: Mapping[tuple[str, str], float], redraws: Mapping[tuple[str, str], ArrayLike]
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


def side_by_side(
    table: int, ours: Mapping[str, Mapping[str, float]], labels: Mapping[str, str]
) -> pd.DataFrame:
    """Return table 1 or 2 as printed with ours below every printed row; errors are absolute.

    Parameters
    ----------
    table : 1 or 2.
    ours : method -> quantity -> the value for the committed cloud; methods the paper does not have
        come last.
    labels : method -> what the table calls it.

    Returns
    -------
    Frame of text, numbers at the decimals of print; σ0 with its unit, because the paper's heads
    give m for an area.

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
    numbers = {
        method: [n for n in printed_numbers(table) if n.method == method]
        for method in METHODS.values()
    }
    rows = []
    for label, method in METHODS.items():
        rows.append(
            _row(label, "printed", numbers[method], {n.quantity: n.value for n in numbers[method]})
        )
        rows.append(_row(label, "ours", numbers[method], ours[method]))
    for method in ours:
        if method not in numbers:
            # a printed row with the unit of its σ0
            alike = "tls" if SPHERE_METHODS[method].sigma_0_unit == "m²" else "igg3_wtls"
            rows.append(_row(labels[method], "ours", numbers[alike], ours[method]))
    return pd.DataFrame(rows)


def _row(
    label: str, source: str, numbers: Iterable[PrintedNumber], values: Mapping[str, float]
) -> dict[str, str]:
    """Return a row of `side_by_side`: the values at the decimals of the numbers."""
    row = {"method": label, "source": source}
    for number in numbers:
        shown = f"{values[number.quantity]:z.{number.decimals}f}"
        if number.quantity == "sigma_0":
            row |= {"σ0": shown, "unit": number.unit}
        else:
            row[f"{SYMBOLS[number.quantity]}/m"] = shown
    return row


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
