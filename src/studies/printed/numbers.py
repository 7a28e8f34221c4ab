"""Printed numbers and statements, read from ``data/published`` as text.

A trailing zero says how exactly a number is known, so it must not be lost.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from decimal import Decimal

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from .. import paths


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
        """The name of the number in `papers.registry`."""
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


def read_table(
    paper: str,
    table: int,
    methods: Mapping[str, str],
    describe: Callable[[str, str], tuple[str, str]],
    alike: str = "",
) -> tuple[PrintedNumber, ...]:
    """Read ``<paper>_table<table>.csv``, row by row.

    Parameters
    ----------
    paper, table : they name the file; the columns ``method`` and, where there is one, ``sample``
        name a row, every other column is described by ``describe``.
    methods : method as printed -> our name.
    describe : (column, method by our name) -> quantity and unit of the number.
    alike : beginning of the names of the columns that are printed to the same number of decimals;
        a bare ``0`` in the table is known to as many.

    Example
    -------
    >>> names = {"LS": "ls", "TLS": "tls", "IGG III-WTLS": "igg3_wtls"}
    >>> first, *_ = read_table("ou_liu_2017", 1, names, lambda column, method: (column, "m"))
    >>> first.method, first.quantity, first.text
    ('ls', 'abs_delta_a_m', '0.0002')
    """
    frame = _read_text(f"{paper}_table{table}.csv")
    columns = [column for column in frame if column not in ("sample", "method")]
    of_zero = max(_decimals(t) for c in columns if c.startswith(alike) for t in frame[c])
    return tuple(
        PrintedNumber(
            paper=paper,
            table=table,
            sample=row.get("sample", ""),
            method=methods[row["method"]],
            quantity=quantity,
            text=row[column],
            decimals=of_zero if row[column] == "0" else _decimals(row[column]),
            unit=unit,
        )
        for row in frame.to_dict("records")
        for column in columns
        for quantity, unit in [describe(column, methods[row["method"]])]
    )


@dataclass(frozen=True)
class Statement:
    """One number, list of numbers or claim that a paper states outside its tables.

    `text` is what is printed, digits kept; ``claim`` where the statement is in words, which
    `quantity` then holds.

    >>> statement = statements("li_2015")["li_2015/registration"]
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
        """The name of the statement in `papers.registry`."""
        return f"{self.paper}/{self.key}"

    @property
    def value(self) -> float:
        """The number stated, in `unit`; raises ``ValueError`` where it is not a single number."""
        return float(self.text)

    @property
    def half_unit(self) -> float:
        """Half a unit of the last printed digit, in `unit`."""
        return 0.5 * 10.0 ** -_decimals(self.text)


def statements(paper: str) -> dict[str, Statement]:
    """id -> what the text of a paper states outside its tables: ``<paper>_statements.csv``.

    Raises
    ------
    ValueError : two statements have one id.

    Example
    -------
    >>> statements("wu_chen_wang")["wu_chen_wang/sim_sigma_s_LS"].text
    '5.9'
    """
    return _by_id(_read_text(f"{paper}_statements.csv").assign(paper=paper))


def further_statements(paper: str) -> dict[str, Statement]:
    """id -> statements of a paper that were found later: its lines of ``further_statements.csv``.

    >>> len(further_statements("li_2015"))
    9
    """
    frame = _read_text("further_statements.csv")
    return _by_id(frame[frame["paper"] == paper])


def _by_id(frame: pd.DataFrame) -> dict[str, Statement]:
    rows = frame.rename(columns={"id": "key", "value": "text"}).to_dict("records")
    return join([{statement.id: statement} for statement in (Statement(**row) for row in rows)])


def join(parts: Iterable[Mapping]) -> dict:
    """All parts in one, in their order.

    Raises
    ------
    ValueError : an id is in more than one of them.
    """
    found: dict = {}
    for part in parts:
        if twice := found.keys() & part.keys():
            raise ValueError(f"statements: expected one of each id, got {min(twice)} twice")
        found |= part
    return found


def _read_text(name: str) -> pd.DataFrame:
    return pd.read_csv(
        paths.existing(paths.PUBLISHED / name), dtype=str, keep_default_na=False, encoding="utf-8"
    )


def _decimals(text: str) -> int:
    """Return the decimal places of a number as printed: 4 for 0.0670, 9 for 7.7080e-5."""
    return max(0, -int(Decimal(text).as_tuple().exponent))
