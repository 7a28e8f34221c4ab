"""A relation that printed numbers must fulfil, and the tables it is applied to: the printed ones or
simulated ones.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from .numbers import PrintedNumber, Statement

# id -> number, as printed; with other digits for simulated tables.
Numbers = Mapping[str, PrintedNumber | Statement]


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
