"""Tables 1 and 2 of Ou & Liu (2017) beside ours: number by number, and row by row."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import pandas as pd
from numpy.typing import ArrayLike

from analysis.methods import SPHERE_METHODS

from ..printed.comparison import compare
from ..printed.numbers import PrintedNumber
from .printed_tables import METHODS, SYMBOLS, TITLES, printed_numbers


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
