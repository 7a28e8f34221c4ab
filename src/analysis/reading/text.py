"""Text: one point per line, with or without headings, comments and further columns."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

COMMENTS = ("#", "//")


@dataclass(frozen=True)
class _Layout:
    """Layout of a text file: found in its head, true for all of it."""

    first_line: int  # line of the first point, counted from 1
    separator: str | None  # None: blanks
    columns: tuple[int, int, int]  # of x, y, z, counted from 0
    count: int | None  # points promised by the line in front, if there is one


def read_text(path: Path) -> np.ndarray:
    """Points (n, 3) of a text file, read fast, or line by line where that fails.

    A file that cannot be read so is bad, and reading its lines finds where.
    """
    layout = _find_layout(path)
    try:
        frame = pd.read_csv(
            path,
            sep=r"\s+" if layout.separator is None else layout.separator,
            header=None,
            skiprows=layout.first_line - 1,
            usecols=sorted(layout.columns),
            dtype=np.float64,
            comment="#",
            quoting=csv.QUOTE_NONE,  # else a lone " in a heading swallows the lines after it
            encoding="utf-8",
            encoding_errors="replace",
        )
        points = frame.loc[:, list(layout.columns)].to_numpy()
    except ValueError:  # a row that is no row of numbers, or a comment pandas does not know
        points = None
    if points is None or not np.all(np.isfinite(points)):
        points = _read_lines(path, layout)
    if layout.count is not None and layout.count != len(points):
        raise ValueError(
            f"{path}: expected the {layout.count} points announced in front of them, "
            f"found {len(points)}"
        )
    return np.ascontiguousarray(points)


def _read_lines(path: Path, layout: _Layout) -> np.ndarray:
    """Read the points line by line; the first bad line raises."""
    points = []
    for number, line in _lines(path):
        if number < layout.first_line:
            continue
        cells = _cells(line, layout.separator)
        try:
            point = [float(cells[column]) for column in layout.columns]
        except (ValueError, IndexError):
            point = [math.nan]
        if not all(map(math.isfinite, point)):
            columns = ", ".join(str(column + 1) for column in layout.columns)
            raise ValueError(
                f"{path}: line {number}: expected finite numbers x, y, z in columns {columns}, "
                f"got {_shortened(line)}"
            )
        points.append(point)
    return np.array(points)


def _find_layout(path: Path) -> _Layout:
    """Find the layout of a text file in the lines before its first point."""
    count: int | None = None
    headings, comments = [], []
    for number, line in _lines(path, comments=True):
        words = re.split(r"[;,\s]+", line)
        if line.startswith(COMMENTS):
            comments.append(line.lstrip("#/ \t"))
        elif not any(map(_is_number, words)):
            headings.append(line)
        elif len(words) == 1 and line.isdecimal():
            count = int(line)
        else:
            separator = _separator(line)
            names = [_names(heading, separator) for heading in headings]
            # A comment may be prose; it is a heading only if it fits the columns.
            width = len(_cells(line, separator))
            names += [n for c in comments if len(n := _names(c, separator)) == width]
            named = [n for n in names if {"x", "y", "z"} <= set(n)]
            columns = (0, 1, 2)
            if named:
                columns = (named[0].index("x"), named[0].index("y"), named[0].index("z"))
            return _Layout(number, separator, columns, count)
    raise ValueError(f"{path}: expected lines of three numbers x, y, z, found none")


def _lines(path: Path, comments: bool = False) -> Iterator[tuple[int, str]]:
    """Give line number and content of the lines that hold something besides comments."""
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        for number, line in enumerate(file, start=1):
            if not (comments and line.lstrip().startswith(COMMENTS)):
                line = re.split("#|//", line, maxsplit=1)[0]
            if line.strip():
                yield number, line.strip()


def _separator(line: str) -> str | None:
    """Return what separates the cells of a line: semicolon, comma, tab or None for blanks."""
    for mark in ";,":
        if mark in line:
            return mark
    # Tabs among blanks are blanks; tabs alone can stand for an empty cell between them.
    return "\t" if "\t" in line and " " not in line else None


def _cells(line: str, separator: str | None) -> list[str]:
    """Split a line into cells without blanks and quotes around them."""
    return [cell.strip(" \t\"'") for cell in line.split(separator)]


def _names(heading: str, separator: str | None) -> list[str]:
    """Split a heading into names in lower case without units: "X [m]; Y [m]" -> x, y."""
    heading = re.sub(r"\s*[\[(].*?[\])]", "", heading.lower())
    if separator is None or separator not in heading:
        separator = _separator(heading)
    return [re.sub(r"[_/]m$", "", cell) for cell in _cells(heading, separator)]


def _is_number(cell: str) -> bool:
    """Tell whether a cell reads as a number, NaN and infinity included."""
    try:
        float(cell.strip("\"'"))
    except ValueError:
        return False
    return True


def _shortened(line: str) -> str:
    """Return a line short enough for a message."""
    return repr(line if len(line) <= 60 else line[:60] + "…")
