"""Scans in: the points of a file as an array, and a report of how they were read.

Text is read with pandas. Two binary formats need a library each, an optional extra of the project.
A new format is one file here and one line in :data:`FORMATS`.
"""

from __future__ import annotations

import importlib
import os
import stat
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .e57 import read_e57
from .las import read_las
from .pcd import read_pcd
from .ply import read_ply
from .ptx import read_ptx
from .report import UNITS, Raw, Report, Scan, finished
from .text import read_text

__all__ = ["FORMATS", "UNITS", "Report", "Scan", "read_points", "read_scan"]


@dataclass(frozen=True)
class Format:
    """A family of formats: its suffixes, how it is read, and the libraries that this needs.

    read : gives the points of a file as they stand in it
    libraries, packages : modules that ``read`` needs, by suffix, and what pip installs for them
    table : whether it is text, whose columns can be told, and which may be packed (.gz)
    """

    suffixes: tuple[str, ...]
    read: Callable[..., Raw]
    libraries: tuple[str, ...] = ()
    packages: str = ""
    table: bool = False


FORMATS = (
    Format((".xyz", ".txt", ".csv", ".pts", ".asc", ".dat", ".xyzi"), read_text, table=True),
    Format((".ptx",), read_ptx),
    Format((".pcd",), read_pcd),
    Format((".ply",), read_ply),
    Format((".las",), read_las, ("laspy",), '"laspy[lazrs]"'),
    Format((".laz",), read_las, ("laspy", "lazrs"), '"laspy[lazrs]"'),
    Format((".e57",), read_e57, ("pye57",), "pye57"),
)


def read_points(
    path: str | os.PathLike[str], *, columns: Sequence[int] | None = None, unit: str | None = None
) -> np.ndarray:
    """Read the points (n, 3) of a scan in m: :func:`read_scan` without its report.

    Parameters and errors are those of :func:`read_scan`.

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
    return read_scan(path, columns=columns, unit=unit).points


def read_scan(
    path: str | os.PathLike[str], *, columns: Sequence[int] | None = None, unit: str | None = None
) -> Scan:
    """Read the points of a scan, and report which columns were taken, why, and what was left out.

    What can be read in two ways is refused: the message shows the columns and says what to pass.

    Parameters
    ----------
    path : file; its suffix, in any case, says the format.

        - ``.xyz .txt .csv .pts .asc .dat .xyzi``, also packed (``.gz``): one point per line,
          separated by semicolons, commas, tabs or blanks, with decimal points or commas. The
          columns are those that a heading names (x y z, E N H, Rechts Hoch Höhe, …), else the
          first three, unless others could be meant. ``.pts`` may hold several blocks.
        - ``.ptx .e57``: every scan is moved by its matrix or pose into the common frame.
        - ``.las .laz``: withheld points and noise (classes 7 and 18) are left out.
        - ``.ply .pcd``: ascii or binary.
    columns : of x, y, z in a text file, counted from 1
    unit : of the file, one of m dm cm mm km ft us-ft; None: as its heading says, else m

    Returns
    -------
    Scan : ``points`` (n, 3) in m without missing returns (NaN or 0 0 0), and the ``report``

    Raises
    ------
    ValueError : unknown suffix, no regular file, or content that is bad or can be read in two ways.
    FileNotFoundError : no such file.
    ImportError : the library for a format is missing; the message says what to install.

    Example
    -------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     scan = Path(folder) / "scan.csv"
    ...     _ = scan.write_text("Nr;E[mm];N[mm];H[mm]\\n7;1500,5;2500,0;3500,0\\n8;0;0;0\\n")
    ...     points, report = read_scan(scan)
    >>> points
    array([[1.5005, 2.5   , 3.5   ]])
    >>> report.columns, report.unit, report.left_out
    ((2, 3, 4), 'mm', {'0 0 0': 1})
    """
    path = Path(path)
    suffixes = [suffix.lower() for suffix in path.suffixes]
    packed = suffixes[-1:] == [".gz"]
    suffix = "".join(suffixes[-1 - packed :][:1])
    formats = {suffix: one for one in FORMATS for suffix in one.suffixes}
    form = formats.get(suffix)
    if form is None or packed and not form.table:
        known = " ".join(formats)
        raise ValueError(f"{path}: expected a file ending in one of {known}, got {path.suffix!r}")
    if columns is not None and not form.table:
        raise ValueError(f"{path}: {suffix} names its columns; columns are for tables of text")
    if unit is not None and unit not in UNITS:
        raise ValueError(f"{path}: expected one of the units {' '.join(UNITS)}, got {unit!r}")
    status = path.stat()  # a missing file is that, whatever the libraries make of it
    if not stat.S_ISREG(status.st_mode):
        raise ValueError(f"{path}: expected a regular file, got a folder, pipe or device")
    if status.st_size == 0:
        raise ValueError(f"{path}: expected points, the file is empty")
    for library in form.libraries:
        try:
            importlib.import_module(library)
        except ImportError as error:
            raise ImportError(
                f"{path}: reading {suffix} needs {library}; "
                f"install it with: pip install {form.packages}"
            ) from error
    given = {} if columns is None else {"columns": tuple(columns)}
    try:
        return finished(form.read(path, **given), unit)
    except (OSError, ValueError, EOFError, MemoryError, zlib.error) as error:
        if isinstance(error, OSError) and error.strerror and not form.libraries:
            raise
        raise ValueError(_message(path, suffix, error)) from error
    except Exception as error:
        if not form.libraries:
            raise
        # A library has errors of its own; to the user they are all the same.
        raise ValueError(_message(path, suffix, error)) from error


def _message(path: Path, suffix: str, error: BaseException) -> str:
    """One line that names the file; what a library leaves unsaid is said."""
    told = " ".join(str(error).split()) or type(error).__name__
    own = isinstance(error, ValueError) and suffix not in (".las", ".laz", ".e57")
    return f"{path}: {told}" if own else f"{path}: expected a readable {suffix} file: {told}"
