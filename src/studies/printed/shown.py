"""Where something that a paper shows is found here, and with what verdict."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import pandas as pd

from analysis.export import tables

from ..paths import ROOT


@dataclass(frozen=True)
class Shown:
    """One line of the map from the papers to the project.

    what : what the paper shows
    notebook : stem of the notebook that has it
    file : path of the table, figure or code below the repository's root
    verdict : words, or a function that counts them in the table of ``file``
    """

    what: str
    notebook: str
    file: str
    verdict: str | Callable[[pd.DataFrame], str]

    def words(self) -> str:
        """The verdict in words."""
        if isinstance(self.verdict, str):
            return self.verdict
        return self.verdict(tables.read(ROOT / self.file))


def table(notebook: str, name: str) -> str:
    """Path of a table that a notebook wrote.

    >>> table("03_sphere_tables", "table1")
    'data/results/03_sphere_tables_table1.csv'
    """
    return f"data/results/{notebook}_{name}.csv"


def figure(notebook: str, name: str) -> str:
    """Path of a figure that a notebook drew."""
    return f"figures/{notebook}_{name}.png"
