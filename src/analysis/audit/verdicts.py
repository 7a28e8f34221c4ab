"""One row a printed number: its verdict, why, and where that is shown."""

from __future__ import annotations

import pandas as pd

from .. import tables
from ..published import METHODS, SYMBOLS, PrintedNumber, registry
from . import plane_numbers, sphere_numbers, tunnel_numbers
from .judgement import VERDICTS, WAITING, Evaluator, Results

TITLES = {"ou_liu_2017": "Ou & Liu (2017)", "wu_chen_wang": "Wu, Chen & Wang", "li_2015": "Li and others (2015)"}
LABELS = {name: label for label, name in METHODS.items()}


def evaluators() -> dict[str, Evaluator]:
    """id -> evaluator of every printed number: the one place where they are registered."""
    return sphere_numbers.evaluators() | plane_numbers.evaluators() | tunnel_numbers.evaluators()


def verdicts(results: Results | None = None) -> pd.DataFrame:
    """Every printed number and claim of the three papers with its verdict, one row each, from what the notebooks wrote.

    Columns: ``id``, ``paper``, ``place``, ``quantity``, ``unit``, ``printed`` (text); ``median``, ``lower``, ``upper`` and
    ``percentile`` of the redraws; ``verdict``, ``why``, ``notebook``; ``check`` and ``factor`` of what proves it impossible.

    Raises
    ------
    KeyError : a number has no evaluator.

    >>> unseen = pd.DataFrame({"gross errors": ["0 to 3.5 m inside"], "unseen": [51.0]})
    >>> frame = verdicts(Results({"10_audit_gross_errors": unseen}))
    >>> frame.loc[frame["id"] == "ou_liu_2017/table3/I/ls/b_m", "verdict"].item()
    'impossible as printed, proof shown'
    """
    results = Results() if results is None else results
    known = evaluators()
    rows = []
    for name, number in registry().items():
        judgement = known[name](number, results)
        place, quantity = _place(number)
        one = {"id": name, "paper": number.paper, "place": place, "quantity": quantity, "unit": number.unit, "printed": number.text}
        rows.append(one | {name: getattr(judgement, name) for name in COLUMNS})
    return pd.DataFrame(rows)


COLUMNS = ("median", "lower", "upper", "percentile", "verdict", "why", "notebook", "check", "factor")


def _place(number) -> tuple[str, str]:
    """Where it is printed, and what."""
    if isinstance(number, PrintedNumber):
        sphere = f", sphere {number.sample}" if number.sample else ""
        symbol = SYMBOLS.get(number.quantity, number.quantity.removesuffix("_m"))
        return f"table {number.table}{sphere}, {LABELS[number.method]}", symbol
    return number.where, number.quantity


def counts(frame: pd.DataFrame) -> pd.DataFrame:
    """How many numbers have which verdict: a row a paper and one for all, a column a verdict; a column for those waiting if there are any.

    >>> counts(pd.DataFrame({"paper": ["li_2015"], "verdict": ["used as input"]}))[["paper", "numbers", "used as input"]].tail(2)
                      paper  numbers  used as input
    2  Li and others (2015)        1              1
    3                   all        1              1
    """
    words = [*VERDICTS, *([WAITING] if (frame["verdict"] == WAITING).any() else [])]
    rows = []
    for paper, title in [*TITLES.items(), ("", "all")]:
        mine = frame[frame["paper"] == paper] if paper else frame
        rows.append({"paper": title, "numbers": len(mine)} | {word: int((mine["verdict"] == word).sum()) for word in words})
    return pd.DataFrame(rows)


def headline(frame: pd.DataFrame) -> str:
    """The verdicts counted in one sentence."""
    last = counts(frame).iloc[-1]
    words = "; ".join(f"{last[word]} {word}" for word in last.index[2:] if last[word])
    return f"{last['numbers']} printed numbers and claims: {words}."


def headline_markdown(frame: pd.DataFrame) -> str:
    """The counts for the README: a sentence and a table a paper."""
    return f"{headline(frame)}\n\n{tables.markdown(counts(frame), 0)}"
