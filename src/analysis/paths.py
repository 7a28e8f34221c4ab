"""Where files live, where they are written, and how a file is replaced without losing the old one.

Example
-------
>>> (SIMULATED / "cloud.csv").relative_to(ROOT).as_posix()
'data/simulated/cloud.csv'
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from uuid import uuid4

ROOT = Path(__file__).resolve().parents[2]
PUBLISHED = ROOT / "data" / "published"
SIMULATED = ROOT / "data" / "simulated"
RESULTS = ROOT / "data" / "results"
SCANS = ROOT / "data" / "scans"
FIGURES = ROOT / "figures"
NOTEBOOKS = ROOT / "notebooks"

OUTPUT_VARIABLE = "ANALYSIS_OUTPUT"


def output(path: str | os.PathLike[str]) -> Path:
    """Return where to write the file that lives at `path`, and make the folder for it.

    Tests execute the notebooks, and the notebooks write results. With the environment variable
    ``ANALYSIS_OUTPUT`` set, everything goes to the same relative place below that folder, so a
    test run never touches the committed files.

    Parameters
    ----------
    path : path below `ROOT`; a relative path is taken from the current folder.

    Raises
    ------
    ValueError : `path` is not below `ROOT`.

    Example
    -------
    >>> import tempfile
    >>> from unittest.mock import patch
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with patch.dict(os.environ, {OUTPUT_VARIABLE: folder}):
    ...         output(RESULTS / "errors.csv").relative_to(folder).as_posix()
    'data/results/errors.csv'
    """
    # abspath, not resolve: data/scans may be a link that leads out of the repository.
    home = Path(os.path.abspath(path))
    if not home.is_relative_to(ROOT):
        raise ValueError(f"expected a path below {ROOT}, got {home}")
    elsewhere = os.environ.get(OUTPUT_VARIABLE)
    target = Path(elsewhere).absolute() / home.relative_to(ROOT) if elsewhere else home
    target.parent.mkdir(parents=True, exist_ok=True)
    return target


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a temporary path beside `path`; rename it to `path` when the block succeeds.

    The rename is atomic within a folder, so a reader sees the old file or the new one and never
    a half of it. When the block raises, the temporary file is removed and the old file stays.
    The temporary name keeps the suffix, because writers choose their format by it.

    Example
    -------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     target = Path(folder) / "note.txt"
    ...     with replacing(target) as temporary:
    ...         _ = temporary.write_text("new")
    ...     target.read_text(), [file.name for file in Path(folder).iterdir()]
    ('new', ['note.txt'])
    """
    path = Path(path)
    temporary = path.with_name(f".{path.stem}.{uuid4().hex}{path.suffix}")
    try:
        yield temporary
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
