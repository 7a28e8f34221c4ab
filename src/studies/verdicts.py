"""One row per printed number: its verdict, why, and where that is shown."""

from __future__ import annotations

import textwrap

import pandas as pd

from analysis.export import tables

from .papers import PAPERS, evaluators, registry
from .printed.judgement import VERDICTS, Results
from .printed.numbers import PrintedNumber, Statement


def verdicts(results: Results | None = None) -> pd.DataFrame:
    """Every printed number and claim with its verdict, one row each, from what notebooks wrote.

    Columns: ``id``, ``paper``, ``place``, ``quantity``, ``unit``, ``printed`` (text); ``median``,
    ``lower``, ``upper`` and ``percentile`` of the redraws; ``verdict``, ``why``, ``notebook``;
    ``setting``, whether it says how the experiment was made; ``check`` and ``factor`` of what
    proves it impossible.

    Raises
    ------
    KeyError : a number has no evaluator.

    >>> unseen = pd.DataFrame({"gross errors": ["0 to 3.5 m inside"], "unseen": [51.0]})
    >>> frame = verdicts(Results({"11_audit_gross_errors": unseen}))
    >>> frame.loc[frame["id"] == "ou_liu_2017/table3/I/ls/b_m", "verdict"].item()
    'impossible as printed, proof shown'
    """
    results = Results() if results is None else results
    known = evaluators()
    rows = []
    for name, number in registry().items():
        judgement = known[name](number, results)
        place, quantity = _place(number)
        one = {
            "id": name,
            "paper": number.paper,
            "place": place,
            "quantity": quantity,
            "unit": number.unit,
            "printed": number.text,
        }
        rows.append(one | {name: getattr(judgement, name) for name in COLUMNS})
    return pd.DataFrame(rows)


COLUMNS = (
    "median",
    "lower",
    "upper",
    "percentile",
    "verdict",
    "why",
    "notebook",
    "setting",
    "check",
    "factor",
)


def _place(number: PrintedNumber | Statement) -> tuple[str, str]:
    """Where it is printed, and what."""
    if isinstance(number, PrintedNumber):
        sphere = f", sphere {number.sample}" if number.sample else ""
        paper = PAPERS[number.paper]
        symbol = paper.symbols.get(number.quantity, number.quantity.removesuffix("_m"))
        label = paper.labels.get(number.method, number.method)
        return f"table {number.table}{sphere}, {label}", symbol
    return number.where, number.quantity


def counts(frame: pd.DataFrame) -> pd.DataFrame:
    """Number of printed numbers: one row per paper and one for all, one column per verdict.

    >>> found = counts(pd.DataFrame({"paper": ["li_2015"], "verdict": ["reproduced"]}))
    >>> found[["paper", "numbers", "reproduced"]].tail(2)
                      paper  numbers  reproduced
    2  Li and others (2015)        1           1
    3                   all        1           1
    """
    rows = []
    for paper, title in [*((name, one.title) for name, one in PAPERS.items()), ("", "all")]:
        mine = frame[frame["paper"] == paper] if paper else frame
        rows.append(
            {"paper": title, "numbers": len(mine)}
            | {word: int((mine["verdict"] == word).sum()) for word in VERDICTS}
        )
    return pd.DataFrame(rows)


def headline(frame: pd.DataFrame) -> str:
    """The verdicts counted in two sentences."""
    last = counts(frame).iloc[-1]
    words = "; ".join(f"{last[word]} {word}" for word in last.index[2:] if last[word])
    settings = (
        f"{frame['setting'].sum()} of those not checkable are settings of an experiment, "
        "taken over into ours."
    )
    return f"{last['numbers']} printed numbers and claims: {words}. {settings}"


def headline_text(frame: pd.DataFrame) -> str:
    """The counts for the terminal, at most 110 columns wide: two sentences and a table."""
    return f"{textwrap.fill(headline(frame), 110)}\n\n{tables.text(_by_verdict(frame), 0)}"


def headline_markdown(frame: pd.DataFrame) -> str:
    """The counts for the README, as `headline_text`."""
    return f"{headline(frame)}\n\n{tables.markdown(_by_verdict(frame), 0)}"


def _by_verdict(frame: pd.DataFrame) -> pd.DataFrame:
    """`counts`, turned: narrow enough for a terminal."""
    return (
        counts(frame)
        .set_index("paper")
        .T.rename_axis("verdict", axis=0)
        .rename_axis(None, axis=1)
        .reset_index()
    )
