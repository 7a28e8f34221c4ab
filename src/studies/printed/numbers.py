"""The printed numbers and statements, read from ``data/published`` as text: a trailing zero says
how exactly a number is known.
"""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from analysis.methods import SPHERE_METHODS

from ..paths import PUBLISHED, existing

PAPERS = ("ou_liu_2017", "wu_chen_wang", "li_2015")
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
    def id(self) -> str:
        """The name of the number in `registry`."""
        return "/".join(
            part
            for part in (self.paper, f"table{self.table}", self.sample, self.method, self.quantity)
            if part
        )

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
    frame = pd.read_csv(
        existing(PUBLISHED / f"ou_liu_2017_table{table}.csv"), dtype=str, encoding="utf-8"
    )
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
            unit=SPHERE_METHODS[METHODS[row["method"]]].sigma_0_unit
            if column == "sigma_0_m"
            else "m",
        )
        for row in frame.to_dict("records")
        for column in columns
    )


@dataclass(frozen=True)
class Statement:
    """One number, list of numbers or claim that a paper states outside its tables.

    `text` is what is printed, digits kept; ``claim`` where the statement is in words, which
    `quantity` then holds.

    >>> statement = statements()["li_2015/registration"]
    >>> statement.where, statement.text, statement.unit
    ('section 4.1', 'within 2', 'mm')
    """

    paper: str
    key: str
    where: str
    quantity: str
    text: str
    unit: str
    note: str

    @property
    def id(self) -> str:
        """The name of the statement in `registry`."""
        return f"{self.paper}/{self.key}"

    @property
    def value(self) -> float:
        """The number stated, in `unit`; raises ``ValueError`` where it is not a single number."""
        return float(self.text)

    @property
    def half_unit(self) -> float:
        """Half a unit of the last printed digit, in `unit`."""
        return 0.5 * 10.0 ** -_decimals(self.text)


def statements() -> dict[str, Statement]:
    """id -> what the texts of the three papers state outside their tables, in the order of the
    files.

    >>> statements()["wu_chen_wang/sim_sigma_s_LS"].text
    '5.9'
    """
    frames = []
    for paper in PAPERS:
        frame = pd.read_csv(
            existing(PUBLISHED / f"{paper}_statements.csv"),
            dtype=str,
            keep_default_na=False,
            encoding="utf-8",
        )
        frames.append(frame.assign(paper=paper))
    further = pd.read_csv(
        existing(PUBLISHED / "further_statements.csv"),
        dtype=str,
        keep_default_na=False,
        encoding="utf-8",
    )
    found = {}
    for row in (
        pd.concat([*frames, further])
        .rename(columns={"id": "key", "value": "text"})
        .to_dict("records")
    ):
        statement = Statement(**row)
        if statement.id in found:
            raise ValueError(f"statements: expected one of each id, got {statement.id} twice")
        found[statement.id] = statement
    return found


def registry() -> dict[str, PrintedNumber | Statement]:
    """id -> every number and claim of the three papers, each once.

    >>> number = registry()["ou_liu_2017/table3/I/ls/sigma_0"]
    >>> number.text, number.decimals
    ('7.7080e-5', 9)
    """
    return {
        number.id: number for table in (1, 2, 3) for number in printed_numbers(table)
    } | statements()


def _decimals(text: str) -> int:
    """Return the decimal places of a number as printed: 4 for 0.0670, 9 for 7.7080e-5."""
    return max(0, -int(Decimal(text).as_tuple().exponent))
