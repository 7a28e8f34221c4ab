"""Tables 1 to 3 of Ou & Liu (2017) as printed.

The tables 1 and 2 are simulations, without and with gross errors, table 3 has two scanned spheres.
The simulated points were never published: a printed number belongs to one draw of the authors',
ours to another. So it is compared with the distribution over many redraws of the simulation, and
its last digit says how exactly it is known.

Source: Ou J., Liu W. (2017): Fitting of sphere point clouds by weighted total least squares based
on IGG III scheme. Laser Technology 41(5), 749-753, doi:10.7510/jgjs.issn.1001-3806.2017.05.026.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

from analysis.methods import SPHERE_METHODS

from ..printed.numbers import PrintedNumber, further_statements, join, read_table, statements
from ..printed.relation import Numbers

PAPER = "ou_liu_2017"
METHODS = {"LS": "ls", "TLS": "tls", "IGG III-WTLS": "igg3_wtls"}  # as printed -> our name
LABELS = {name: label for label, name in METHODS.items()}
TITLES = {1: "500 points without gross errors", 2: "the same with five gross errors"}
SYMBOLS = {
    "abs_delta_a_m": "|Δa|",
    "abs_delta_b_m": "|Δb|",
    "abs_delta_c_m": "|Δc|",
    "abs_delta_r_m": "|Δr|",
    "sigma_0": "σ0",
    "sigma_s_m": "σs",
}


@cache
def printed_numbers(table: int) -> tuple[PrintedNumber, ...]:
    """Numbers of table 1, 2 or 3, row by row.

    The heads of the tables give σ0 in m. For LS and TLS it is the root mean square of the algebraic
    residual |p - k|² - R², an area: with R = √200 m and the printed σs of table 1,
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
    # The only bare zeros are errors of parameters, all printed to the same number of decimals.
    return read_table(PAPER, table, METHODS, _quantity, alike="abs_delta")


def _quantity(column: str, method: str) -> tuple[str, str]:
    """Quantity and unit of a column, in the row of a method."""
    if column == "sigma_0_m":
        return "sigma_0", SPHERE_METHODS[method].sigma_0_unit
    return column, "m"


def all_numbers() -> dict[str, PrintedNumber]:
    """id -> number of every table."""
    return {number.id: number for table in (1, 2, 3) for number in printed_numbers(table)}


@cache
def printed() -> Numbers:
    """id -> every number and statement of the paper."""
    return join([all_numbers(), statements(PAPER), further_statements(PAPER)])


def values(table: int, method: str, sample: str = "") -> dict[str, float]:
    """Printed values of one row, by quantity.

    >>> values(1, "ls")["sigma_s_m"]
    0.00282
    """
    return {q: number.value for q, number in row(printed(), table, method, sample).numbers.items()}


@dataclass(frozen=True)
class Row:
    """The printed numbers of one row by quantity; `least` and `most` are what its digits allow."""

    ids: Mapping[str, str]
    numbers: Mapping[str, PrintedNumber]

    def __getitem__(self, quantity: str) -> float:
        return self.numbers[quantity].value

    def half(self, quantity: str) -> float:
        """Half a unit of the last printed digit."""
        return self.numbers[quantity].half_unit

    def least(self, quantity: str) -> float:
        """The least number that rounds to the printed one."""
        return self[quantity] - self.half(quantity)

    def most(self, quantity: str) -> float:
        """The largest number that rounds to the printed one."""
        return self[quantity] + self.half(quantity)

    def judged(self, *quantities: str) -> tuple[str, ...]:
        """The ids of some of its numbers."""
        return tuple(self.ids[quantity] for quantity in quantities)


def row(numbers: Numbers, table: int, method: str, sample: str = "") -> Row:
    """One row of a table, of the printed numbers or of others with the same ids.

    >>> row(printed(), 3, "ls", "II")["r_m"]
    0.0736
    """
    place = "/".join(part for part in (PAPER, f"table{table}", sample, method) if part)
    ids = {n.quantity: n.id for n in printed_numbers(table) if n.id == f"{place}/{n.quantity}"}
    return Row(ids, {quantity: numbers[name] for quantity, name in ids.items()})
