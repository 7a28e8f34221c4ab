"""One check of a fit: what was looked at, against which limit, and what to do where it speaks."""

from __future__ import annotations

from dataclasses import dataclass

# checks without which there is no result: one that fails them is not to be used
DECISIVE = ("determined", "chance")


@dataclass(frozen=True)
class Check:
    """One check of a fit.

    name : of the check
    passed : False where it speaks
    value, limit : what was found, and where the check begins to speak
    sentence : one sentence; where the check speaks also what to do

    >>> str(Check("redundancy", False, 2.0, 5.0, "Measure more points."))
    'redundancy: Measure more points.'
    """

    name: str
    passed: bool
    value: float
    limit: float
    sentence: str

    @property
    def decisive(self) -> bool:
        """Whether a fit that fails this check is not to be used."""
        return self.name in DECISIVE

    def __str__(self) -> str:
        return f"{self.name}: {self.sentence}"


def at_least(name: str, value: float, limit: float, good: str, bad: str) -> Check:
    """A check that speaks below its limit, with the sentence for either case."""
    return _check(name, not value < limit, value, limit, good, bad)


def at_most(name: str, value: float, limit: float, good: str, bad: str) -> Check:
    """A check that speaks above its limit."""
    return _check(name, not value > limit, value, limit, good, bad)


def _check(name: str, passed: bool, value: float, limit: float, good: str, bad: str) -> Check:
    return Check(name, bool(passed), float(value), float(limit), good if passed else bad)
