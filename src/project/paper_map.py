"""The map of the README: where what the papers show is found here, and with what verdict."""

from __future__ import annotations

import pandas as pd

from analysis.export import tables
from studies.papers import PAPERS
from studies.printed.comparison import counted
from studies.printed.shown import Shown, table


def _audited(frame: pd.DataFrame) -> str:
    """The verdicts of the audit that occur, counted, in the order in which they do."""
    return counted(frame, frame["verdict"].unique())


def shown() -> list[Shown]:
    """The lines of the map: all numbers together, then paper by paper."""
    everything = Shown(
        "every number and claim of the three papers",
        "11_audit",
        table("11_audit", "verdicts"),
        _audited,
    )
    return [everything, *(one for paper in PAPERS.values() for one in paper.shown)]


def map_markdown() -> str:
    """The map as a Markdown table."""
    rows = [
        {
            "in the paper": one.what,
            "notebook": f"[{one.notebook}](notebooks/{one.notebook}.ipynb)",
            "file": f"[{one.file}]({one.file})",
            "verdict": one.words(),
        }
        for one in shown()
    ]
    return tables.markdown(pd.DataFrame(rows), 0)
