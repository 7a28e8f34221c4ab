"""Scans in: the points of a file as an array.

Text (.xyz, .txt, .csv, .pts, .asc) is read with pandas alone. The binary formats need one library
each, an optional extra of the project: laspy with lazrs (.las, .laz), trimesh (.ply), pye57 (.e57).
"""

from __future__ import annotations

import csv
import importlib
import math
import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

TEXT_SUFFIXES = (".xyz", ".txt", ".csv", ".pts", ".asc")
COMMENTS = ("#", "//")


def read_points(path: str | os.PathLike[str]) -> NDArray[np.float64]:
    """Read the points of a scan.

    Parameters
    ----------
    path : file; its suffix, in any case, says the format.

        - ``.xyz .txt .csv .pts .asc``: one point a line, separated by semicolons, commas, tabs or
          blanks. Lines of words and a single leading point count, as in .pts, may come first;
          ``#`` and ``//`` start comments. Where a heading names x, y and z (also as ``X``,
          ``x_m``, ``x [m]``), those columns are read, else the first three. Further columns are
          ignored.
        - ``.las .laz .ply .e57``: binary; the scans of an .e57 file are put in its common frame.

    Returns
    -------
    (n, 3) points x, y, z in the unit of the file, which should be m.

    Raises
    ------
    ValueError : unknown suffix or bad content; the message names the file, the line and what was
        expected.
    FileNotFoundError : no such file.
    ImportError : the library for a binary format is missing; the message says what to install.

    Example
    -------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     scan = Path(folder) / "scan.pts"
    ...     _ = scan.write_text("2\\n1.0 2.0 3.0 -871\\n4.0 5.0 6.0 -902\\n")
    ...     read_points(scan)
    array([[1., 2., 3.],
           [4., 5., 6.]])
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in (*TEXT_SUFFIXES, *_BINARY):
        known = " ".join([*TEXT_SUFFIXES, *_BINARY])
        raise ValueError(f"{path}: expected a file ending in one of {known}, got {suffix!r}")
    with path.open("rb") as file:  # a missing file is that, whatever the libraries make of it
        if not file.read(1):
            raise ValueError(f"{path}: expected points, the file is empty")
    return _read_text(path) if suffix in TEXT_SUFFIXES else _read_binary(path, suffix)


# --- text ---------------------------------------------------------------------------------------


class _Layout(NamedTuple):
    """How a text file is laid out: found in its head, true for all of it."""

    first_line: int  # line of the first point, counted from 1
    separator: str | None  # None: blanks
    columns: tuple[int, int, int]  # of x, y, z, counted from 0
    count: int | None  # points promised by the line in front, if there is one


def _read_text(path: Path) -> NDArray[np.float64]:
    """Read a text file fast, and where that fails line by line, which knows what is wrong."""
    layout = _layout(path)
    try:
        points = (
            pd.read_csv(
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
            .loc[:, list(layout.columns)]
            .to_numpy()
        )
    except ValueError:  # a row that is no row of numbers, or a comment pandas does not know
        points = None
    if points is None or not np.all(np.isfinite(points)):
        points = _read_lines(path, layout)
    if layout.count is not None and layout.count != len(points):
        raise ValueError(
            f"{path}: expected the {layout.count} points announced in front of them, found {len(points)}"
        )
    return np.ascontiguousarray(points)


def _read_lines(path: Path, layout: _Layout) -> NDArray[np.float64]:
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
                f"{path}: line {number}: expected finite numbers x, y, z in columns {columns}, got {_shortened(line)}"
            )
        points.append(point)
    return np.array(points)


def _layout(path: Path) -> _Layout:
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


# --- binary -------------------------------------------------------------------------------------


def _read_binary(path: Path, suffix: str) -> NDArray[np.float64]:
    """Read a binary file with the library for it."""
    name, packages, read = _BINARY[suffix]
    try:
        library = importlib.import_module(name)
    except ImportError as error:
        raise ImportError(
            f"{path}: reading {suffix} needs {name}; install it with: pip install {packages}"
        ) from error
    try:
        points = np.array(read(library, path), dtype=np.float64)
    except Exception as error:  # each library has its own; to the user they are all the same
        raise ValueError(f"{path}: expected a readable {suffix} file: {error}") from error
    if points.ndim != 2 or points.shape[0] == 0:
        raise ValueError(f"{path}: expected points, the file has none")
    if not np.all(np.isfinite(points)):
        first = int(np.argmax(~np.isfinite(points).all(axis=1))) + 1
        raise ValueError(f"{path}: point {first}: expected finite coordinates")
    return points


def _read_las(laspy: ModuleType, path: Path) -> NDArray[np.float64]:
    """Read .las or .laz."""
    return laspy.read(path).xyz


def _read_ply(trimesh: ModuleType, path: Path) -> NDArray[np.float64]:
    """Read .ply; without processing, which would merge points at the same place."""
    return trimesh.load(path, file_type="ply", process=False).vertices


def _read_e57(pye57: ModuleType, path: Path) -> NDArray[np.float64]:
    """Read all scans of an .e57 file, each moved by its pose into the common frame."""
    file = pye57.E57(str(path))
    try:
        scans = [file.read_scan(i, ignore_missing_fields=True) for i in range(file.scan_count)]
    finally:
        file.close()
    return np.concatenate(
        [
            np.column_stack([scan["cartesianX"], scan["cartesianY"], scan["cartesianZ"]])
            for scan in scans
        ]
    )


_BINARY: dict[str, tuple[str, str, Callable[[ModuleType, Path], NDArray[np.float64]]]] = {
    ".las": ("laspy", '"laspy[lazrs]"', _read_las),
    ".laz": ("laspy", '"laspy[lazrs]"', _read_las),
    ".ply": ("trimesh", "trimesh", _read_ply),
    ".e57": ("pye57", "pye57", _read_e57),
}
