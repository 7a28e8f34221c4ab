"""One look for all figures, and ways to publish them.

A figure answers the question its title states; what it shows is
exported beside it as a table of the same name, which tests compare.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl
import pandas as pd
from matplotlib import pyplot
from matplotlib.figure import Figure

from . import tables
from .files import replacing

PAGE = 7.2  # inches, the width of a journal's page

# Okabe & Ito's colours for what is not a method; methods have theirs in methods.py.
TRUTH = "#000000"
GROSS = "#D55E00"
GREY = "#8C8C8C"

STYLE: Any = {  # matplotlib types each key by itself
    "font.size": 8.5,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelsize": 8.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#E3E3E3",
    "grid.linewidth": 0.6,
    "legend.fontsize": 8,
    "legend.frameon": False,
    "lines.linewidth": 1.4,
    "figure.dpi": 110,
    "savefig.dpi": 200,
    # What would make a figure differ from run to run: element names in SVG files and dates.
    "svg.hashsalt": "analysis",
    "svg.fonttype": "path",
}
# For the whole process: this package is the only one that draws. (A context would end before titles
# and legends are set, and would switch off the display of figures in notebooks.)
mpl.rcParams.update(STYLE)

Publish = Callable[[Figure, str, pd.DataFrame], None]

UNDATED = {"png": {"Software": None}, "svg": {"Date": None, "Creator": None}}


def new(rows: int = 1, columns: int = 1, *, width: float = PAGE, height: float = 3.0, **options):
    """A figure and its axes in the project's style.

    ``height`` and ``width`` are in inches, the options those of ``pyplot.subplots``.
    """
    return pyplot.subplots(rows, columns, figsize=(width, height), layout="constrained", **options)


def headed(figure, title: str, handles=(), columns: int = 1) -> None:
    """One title over all panels, and one legend of the handles below them."""
    figure.suptitle(title, x=0.01, ha="left", fontweight="bold", fontsize=STYLE["axes.titlesize"])
    if handles := list(handles):
        figure.legend(handles=handles, loc="outside lower center", ncols=columns, columnspacing=1.4)


def into(folder: Path) -> Publish:
    """A ``publish`` that writes ``<stem>.png``, ``.svg`` and ``.csv`` into a folder.

    It closes the figure.
    """

    def publish_there(figure: Figure, stem: str, data: pd.DataFrame) -> None:
        save(figure, {kind: folder / f"{stem}.{kind}" for kind in UNDATED})
        tables.save(data, folder / f"{stem}.csv")
        pyplot.close(figure)

    return publish_there


def save(figure: Figure, files: Mapping[str, Path]) -> None:
    """Write a figure as each of the kinds of :data:`UNDATED`, without dates."""
    for kind, path in files.items():
        with replacing(path) as temporary:
            figure.savefig(temporary, format=kind, metadata=UNDATED[kind])
