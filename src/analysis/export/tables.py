"""Tables out: CSV files, plain text for terminals and notebooks, Markdown for the README.

Numbers are shown at a stated precision above the numerical noise: the last bits of a result
differ between processors, and a table that shows them changes without reason.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import pandas as pd

from .files import replacing

# Decimals of a column (4 -> 0.0670) or a format specification (".2e" -> 6.70e-02).
Precision = int | str

MISSING = "–"


def save(frame: pd.DataFrame, path: Path, *, float_format: str = "%.9g") -> Path:
    """Write ``frame`` to a CSV file and return its path; floats as ``float_format`` says."""
    # pandas applies float_format to columns of floats only, not to floats among objects.
    mixed = {
        name: frame[name].map(
            lambda cell: float_format % cell if isinstance(cell, float) and cell == cell else cell
        )
        for name in frame
        if frame[name].dtype == object
    }
    with replacing(path) as temporary:
        frame.assign(**mixed).to_csv(
            temporary, index=False, float_format=float_format, lineterminator="\n", encoding="utf-8"
        )
    return path


def read(path: str | os.PathLike[str]) -> pd.DataFrame:
    """Read a CSV file; floats come back exactly as written, to the last bit.

    Example
    -------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = save(pd.DataFrame({"sigma_s_m": [0.00282, 0.00285]}), Path(folder) / "table.csv")
    ...     read(path)["sigma_s_m"].tolist()
    [0.00282, 0.00285]
    """
    return pd.read_csv(path, encoding="utf-8")


def text(frame: pd.DataFrame, decimals: Precision | Mapping[str, Precision]) -> str:
    """Return `frame` as aligned plain text, without the index.

    Parameters
    ----------
    frame : the table.
    decimals : decimals of the float columns (or a format specification such as ``".2e"``), one
        for all of them or one for each column by its name. Integers and text stay as they are;
        a missing value is shown as a dash. Numbers are aligned at the decimal point.

    Raises
    ------
    KeyError : a float column without decimals.

    Example
    -------
    >>> frame = pd.DataFrame({"method": ["LS", "TLS"], "Δc/m": [0.1754, 11.1511], "n": [500, 500]})
    >>> print(text(frame, 2))
    method   Δc/m    n
    LS       0.18  500
    TLS     11.15  500
    """
    columns = []
    for name, cells in _columns(frame, decimals):
        if _are_numbers(cells):
            tails = [len(cell.partition(".")[2]) + ("." in cell) for cell in cells]
            cells = [
                cell + " " * (max(tails) - tail) for cell, tail in zip(cells, tails, strict=True)
            ]
            width = max(map(len, [name, *cells]))
            columns.append([cell.rjust(width) for cell in [name, *cells]])
        else:
            width = max(map(len, [name, *cells]))
            columns.append([cell.ljust(width) for cell in [name, *cells]])
    return "\n".join("  ".join(row).rstrip() for row in zip(*columns, strict=True))


def markdown(frame: pd.DataFrame, decimals: Precision | Mapping[str, Precision]) -> str:
    """Return `frame` as a Markdown table; parameters and errors as for `text`.

    Example
    -------
    >>> print(markdown(pd.DataFrame({"method": ["LS"], "|Δa|/m": [0.067]}), 4))
    | method | \\|Δa\\|/m |
    | --- | ---: |
    | LS | 0.0670 |
    """
    columns = [
        [name, "---:" if _are_numbers(cells) else "---", *cells]
        for name, cells in _columns(frame, decimals)
    ]
    # A bar inside a cell, as in |Δa|, would end the cell.
    escaped = [[cell.replace("|", r"\|") for cell in column] for column in columns]
    return "\n".join(f"| {' | '.join(row)} |" for row in zip(*escaped, strict=True))


def _columns(
    frame: pd.DataFrame, decimals: Precision | Mapping[str, Precision]
) -> list[tuple[str, list[str]]]:
    """Return name and cells, as text, of every column."""
    columns = []
    for name in frame:
        if pd.api.types.is_float_dtype(frame[name]):
            precision = decimals[name] if isinstance(decimals, Mapping) else decimals
            # z: a rounded -0.00001 is 0.000, not -0.000, whichever sign the noise has.
            form = f"z.{precision}f" if isinstance(precision, int) else precision
        else:
            form = ""
        cells = [MISSING if pd.isna(cell) else format(cell, form) for cell in frame[name]]
        columns.append((str(name), cells))
    return columns


def _are_numbers(cells: list[str]) -> bool:
    """Tell whether every cell that is not missing reads as a number."""
    try:
        return bool([float(cell) for cell in cells if cell != MISSING])
    except ValueError:
        return False
