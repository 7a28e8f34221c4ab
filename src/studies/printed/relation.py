"""A relation that printed numbers must fulfil, and the tables it is applied to: the printed ones or
simulated ones.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

from . import PrintedNumber, Statement, registry

# id -> number, as `published.registry`; the same with other digits for simulated tables.
Paper = Mapping[str, PrintedNumber | Statement]


@dataclass(frozen=True)
class Relation:
    """One relation applied to one place: ``value`` (from print) must be ``sense`` ``limit``, both
    in ``unit``.

    ``numbers`` are the ids of the printed numbers it judges: if it is violated, at least one of
    them is wrong or means something else. ``tolerance`` is what their missing digits allow, in
    ``unit``.

    >>> relation = Relation("σs of LS", "", "LS", 0.3, "≤", 0.1, "m", tolerance=0.02)
    >>> relation.holds, round(relation.factor, 3)
    (False, 2.8)
    """

    relation: str
    sphere: str
    methods: str
    value: float
    sense: str
    limit: float
    unit: str
    numbers: tuple[str, ...] = ()
    tolerance: float = 0.0

    @property
    def holds(self) -> bool:
        """Whether the relation is fulfilled by some numbers that round to the printed ones."""
        return self.factor <= 1

    @property
    def factor(self) -> float:
        """By how much it is violated: 1 at the limit, above 1 impossible. For "=" the difference
        over what the digits allow.
        """
        if self.sense == "=":
            return abs(self.value - self.limit) / (self.tolerance + 1e-9 * abs(self.limit))
        above, below = (self.value, self.limit) if self.sense == "≤" else (self.limit, self.value)
        if above - self.tolerance <= below:
            return 1.0 if above > below else above / below if below > 0 else 0.0
        return (above - self.tolerance) / below if below > 0 else float("inf")


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


QUANTITIES = {
    1: ("abs_delta_a_m", "abs_delta_b_m", "abs_delta_c_m", "abs_delta_r_m", "sigma_0", "sigma_s_m"),
    3: ("a_m", "b_m", "c_m", "r_m", "abs_delta_r_m", "sigma_0", "sigma_s_m"),
}


def row(paper: Paper, table: int, method: str, sample: str = "") -> Row:
    """One row of a table.

    >>> row(printed(), 3, "ls", "II")["r_m"]
    0.0736
    """
    place = f"table{table}/{sample}/{method}" if sample else f"table{table}/{method}"
    ids = {
        quantity: f"ou_liu_2017/{place}/{quantity}"
        for quantity in QUANTITIES[3 if table == 3 else 1]
    }
    return Row(ids, {quantity: paper[name] for quantity, name in ids.items()})


@cache
def printed() -> Paper:
    """The papers as printed."""
    return registry()
