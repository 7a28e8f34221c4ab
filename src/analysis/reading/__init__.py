"""Scans in: the points of a file as an array.

Text is read with pandas alone. The binary formats need one library each, an optional extra of the
project. A new format is one file here and one line in :data:`FORMATS`.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .e57 import read_e57
from .las import read_las
from .ply import read_ply
from .text import read_text


@dataclass(frozen=True)
class Format:
    """A family of formats: its suffixes, how it is read, and the library that this needs.

    read : gives the points (n, 3) of a file
    library, packages : module that ``read`` imports, and what pip installs for it; None for none
    """

    suffixes: tuple[str, ...]
    read: Callable[[Path], np.ndarray]
    library: str | None = None
    packages: str | None = None


FORMATS = (
    Format((".xyz", ".txt", ".csv", ".pts", ".asc"), read_text),
    Format((".las", ".laz"), read_las, "laspy", '"laspy[lazrs]"'),
    Format((".ply",), read_ply, "trimesh", "trimesh"),
    Format((".e57",), read_e57, "pye57", "pye57"),
)


def read_points(path: str | os.PathLike[str]) -> np.ndarray:
    """Read the points of a scan.

    Parameters
    ----------
    path : file; its suffix, in any case, says the format.

        - ``.xyz .txt .csv .pts .asc``: one point per line, separated by semicolons, commas, tabs or
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
    formats = {suffix: one for one in FORMATS for suffix in one.suffixes}
    if suffix not in formats:
        known = " ".join(formats)
        raise ValueError(f"{path}: expected a file ending in one of {known}, got {suffix!r}")
    with path.open("rb") as file:  # a missing file is that, whatever the libraries make of it
        if not file.read(1):
            raise ValueError(f"{path}: expected points, the file is empty")
    if formats[suffix].library is None:
        return formats[suffix].read(path)
    return _read_with_library(path, suffix, formats[suffix])


def _read_with_library(path: Path, suffix: str, form: Format) -> np.ndarray:
    """Read a file with the library for it, whose errors become those of this package."""
    try:
        importlib.import_module(str(form.library))
    except ImportError as error:
        raise ImportError(
            f"{path}: reading {suffix} needs {form.library}; "
            f"install it with: pip install {form.packages}"
        ) from error
    try:
        points = np.array(form.read(path), dtype=np.float64)
    except Exception as error:  # each library has its own; to the user they are all the same
        raise ValueError(f"{path}: expected a readable {suffix} file: {error}") from error
    if points.ndim != 2 or points.shape[0] == 0:
        raise ValueError(f"{path}: expected points, the file has none")
    if not np.all(np.isfinite(points)):
        first = int(np.argmax(~np.isfinite(points).all(axis=1))) + 1
        raise ValueError(f"{path}: point {first}: expected finite coordinates")
    return points
