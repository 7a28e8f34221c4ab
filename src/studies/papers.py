"""The papers: the one place where a paper is registered.

A paper is a folder here, its files ``<name>_statements.csv`` and ``<name>_table<n>.csv`` in
``data/published``, and one entry in :data:`PAPERS`, all with the same name. Titles, verdicts and
the map of the README follow from it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from .li_2015.shown import SHOWN as LI_2015
from .li_2015.verdicts import evaluators as li_2015
from .ou_liu_2017 import printed_tables as ou_liu_tables
from .ou_liu_2017.shown import SHOWN as OU_LIU_2017
from .ou_liu_2017.verdicts import evaluators as ou_liu_2017
from .printed.judgement import Evaluator
from .printed.numbers import PrintedNumber, further_statements, join, statements
from .printed.relation import Numbers
from .printed.shown import Shown
from .wu_chen_wang.shown import SHOWN as WU_CHEN_WANG
from .wu_chen_wang.verdicts import evaluators as wu_chen_wang


@dataclass(frozen=True)
class Paper:
    """A paper whose printed numbers are judged.

    title : what tables call it
    evaluators : () -> id -> evaluator of each of its numbers and statements
    shown : where what it shows is found here
    numbers : () -> id -> number of its tables; none where its tables are not there
    labels, symbols : method, quantity -> what tables call them
    """

    title: str
    evaluators: Callable[[], Mapping[str, Evaluator]]
    shown: tuple[Shown, ...] = ()
    numbers: Callable[[], Mapping[str, PrintedNumber]] = dict
    labels: Mapping[str, str] = field(default_factory=dict)
    symbols: Mapping[str, str] = field(default_factory=dict)


PAPERS: dict[str, Paper] = {
    "ou_liu_2017": Paper(
        "Ou & Liu (2017)",
        ou_liu_2017,
        OU_LIU_2017,
        ou_liu_tables.all_numbers,
        ou_liu_tables.LABELS,
        ou_liu_tables.SYMBOLS,
    ),
    "wu_chen_wang": Paper("Wu, Chen & Wang", wu_chen_wang, WU_CHEN_WANG),
    "li_2015": Paper("Li and others (2015)", li_2015, LI_2015),
}


def registry() -> Numbers:
    """id -> every number and statement of all papers: tables first, then statements.

    Raises
    ------
    ValueError : an id is there twice.

    Example
    -------
    >>> number = registry()["ou_liu_2017/table3/I/ls/sigma_0"]
    >>> number.text, number.decimals
    ('7.7080e-5', 9)
    """
    return join(
        [
            *(paper.numbers() for paper in PAPERS.values()),
            *map(statements, PAPERS),
            *map(further_statements, PAPERS),
        ]
    )


def evaluators() -> Mapping[str, Evaluator]:
    """id -> evaluator of every number and statement of all papers."""
    return join(paper.evaluators() for paper in PAPERS.values())
