"""A verdict with its reason, and the ways to reach one: from redraws, from what notebooks wrote.

An evaluator is a function of a printed number and the results (`Results`) that returns a
`Judgement`. Each paper has those of its numbers in its `verdicts.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import pandas as pd

from analysis.export import tables

from ..paths import RESULTS, existing
from . import comparison
from .numbers import PrintedNumber, Statement

REPRODUCED = "reproduced"
CONSISTENT = "consistent with redraws"
CAUSE = "differs, cause shown"
IMPOSSIBLE = "impossible as printed, proof shown"
NOT_CHECKABLE = "not checkable (data not published)"
VERDICTS = (REPRODUCED, CONSISTENT, CAUSE, IMPOSSIBLE, NOT_CHECKABLE)
REASONS = {
    REPRODUCED: "the median of the redraws rounds to it",
    CONSISTENT: "within the central 95 % of the redraws",
}


@dataclass(frozen=True)
class Judgement:
    """The verdict on one printed number: why, the notebook that shows it, and the check that proves
    it if it is impossible.

    ``median``, ``lower``, ``upper`` and ``percentile`` are those of the redraws, ``factor`` that of
    the check; NaN where there are none.
    ``setting`` : it says how the authors' experiment was made, not what came out, and is taken over
        into ours.
    """

    verdict: str
    why: str
    notebook: str = "11_audit"
    check: str = ""
    factor: float = float("nan")
    median: float = float("nan")
    lower: float = float("nan")
    upper: float = float("nan")
    percentile: float = float("nan")
    setting: bool = False


class Results:
    """The tables that the notebooks wrote, each read once.

    >>> Results()["01_simulated_sphere_rounding"].columns[0]
    'step_m'
    """

    def __init__(self, given: Mapping[str, pd.DataFrame] | None = None):
        """``given`` : tables by stem that are not read: this run has just computed them."""
        self._read = dict(given or {})

    def __getitem__(self, stem: str) -> pd.DataFrame:
        if stem not in self._read:
            self._read[stem] = tables.read(existing(RESULTS / f"{stem}.csv"))
        return self._read[stem]

    def one(self, stem: str, column: str, **where) -> float:
        """One number of a table: that of ``column`` in the only row in which each column of
        ``where`` has the given value.

        >>> Results().one("01_simulated_sphere_rounding", "sigma_s_ratio", step_m=0.01)
        0.980807765
        """
        frame = self[stem]
        for name, value in where.items():
            frame = frame[frame[name] == value]
        if len(frame) != 1:
            raise KeyError(f"{stem}: expected one row with {where}, got {len(frame)}")
        return frame[column].item()


Evaluator = Callable[[PrintedNumber | Statement, Results], Judgement]


def always(verdict: str, why: str, notebook: str) -> Evaluator:
    """One judgement, whatever the results: for what cannot be checked."""
    return lambda number, results: Judgement(verdict, why, notebook)


def setting(notebook: str, why: str = "a setting of the authors', taken over") -> Evaluator:
    """Not checkable, because it says how the experiment was made."""
    return lambda number, results: Judgement(NOT_CHECKABLE, why, notebook, setting=True)


def holds_if(
    predicate: Callable[[Results], bool], why: str, notebook: str, otherwise: str = CAUSE
) -> Evaluator:
    """A claim: reproduced as long as the results fulfil the predicate, else ``otherwise``."""
    return lambda number, results: Judgement(
        REPRODUCED if predicate(results) else otherwise, why, notebook
    )


def refuted_if(predicate: Callable[[Results], bool], why: str, notebook: str) -> Evaluator:
    """A claim or number that differs for a cause, as long as the results show the cause; else
    reproduced.
    """
    return lambda number, results: Judgement(
        CAUSE if predicate(results) else REPRODUCED, why, notebook
    )


def within(
    stem: str, why_outside: str, notebook: str, where: Mapping[str, object], note: str = ""
) -> Evaluator:
    """A number beside an interval that a notebook wrote: ``median``, ``lower``, ``upper`` of the
    row given by ``where``.

    The rule is that of `comparison.verdict`; outside the interval the cause is ``why_outside``.
    ``note`` : what the reason must add.
    """

    def evaluate(number, results: Results) -> Judgement:
        median, lower, upper = (
            results.one(stem, name, **where) for name in ("median", "lower", "upper")
        )
        judgement = from_interval(number, median, lower, upper, why_outside, notebook)
        return replace(judgement, why=judgement.why + note)

    return evaluate


def from_interval(
    number, median: float, lower: float, upper: float, why_outside: str, notebook: str
) -> Judgement:
    """Reproduced if the median rounds to the number; consistent if what rounds to it overlaps the
    interval; else it differs for a cause.

    >>> from studies.printed.numbers import statements
    >>> number = statements("wu_chen_wang")["wu_chen_wang/sim_sigma_s_LS"]
    >>> from_interval(number, 5.89, 5.5, 6.3, "", "06_plane").verdict
    'reproduced'
    """
    numbers = {"median": median, "lower": lower, "upper": upper}
    if abs(median - number.value) <= number.half_unit:
        return Judgement(REPRODUCED, REASONS[REPRODUCED], notebook, **numbers)
    if lower <= number.value + number.half_unit and number.value - number.half_unit <= upper:
        return Judgement(CONSISTENT, REASONS[CONSISTENT], notebook, **numbers)
    return Judgement(CAUSE, why_outside, notebook, **numbers)


def from_comparison(line, why_outside: str, notebook: str) -> Judgement:
    """A judgement from a row of `ou_liu_2017.comparison.comparison_table`."""
    words = {
        comparison.REPRODUCED: REPRODUCED,
        comparison.INSIDE: CONSISTENT,
        comparison.OUTSIDE: CAUSE,
    }
    verdict = words[line.verdict]
    numbers = {name: getattr(line, name) for name in ("median", "lower", "upper", "percentile")}
    return Judgement(verdict, REASONS.get(verdict, why_outside), notebook, **numbers)
