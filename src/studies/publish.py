"""Tables of a notebook into ``data/results``, its figures and what they show into ``figures``."""

from __future__ import annotations

import os
from pathlib import Path

import pandas as pd

from analysis.export import figures, tables

from .paths import FIGURES, RESULTS, output


def write(frame: pd.DataFrame, path: str | os.PathLike[str], *, float_format: str = "%.9g") -> Path:
    """Write `frame` as CSV to `paths.output(path)` in one step and return the file written.

    UTF-8, lines end with ``\\n``, the index is left out, floats have at most nine significant
    digits unless `float_format` (a %-format) says otherwise.

    Raises
    ------
    ValueError : `path` is not below the repository's root.

    Example
    -------
    >>> import tempfile
    >>> from unittest.mock import patch
    >>> from studies.paths import RESULTS
    >>> frame = pd.DataFrame({"method": ["ls"], "radius_m": [0.1 + 0.2]})
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with patch.dict(os.environ, {"ANALYSIS_OUTPUT": folder}):
    ...         write(frame, RESULTS / "radius.csv").read_text()
    'method,radius_m\\nls,0.3\\n'
    """
    return tables.save(frame, output(path), float_format=float_format)


def publish(figure, stem: str, data: pd.DataFrame) -> None:
    """Write ``figures/<stem>.png`` and ``.svg`` and what they show as ``data/results/<stem>.csv``.

    The stem begins with the name of the notebook. The figure stays open: a notebook shows it
    at the end of the cell.
    """
    figures.save(figure, {kind: output(FIGURES / f"{stem}.{kind}") for kind in figures.UNDATED})
    write(data, RESULTS / f"{stem}.csv")
