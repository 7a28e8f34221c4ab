"""Where the project's files live and where they are written.

Example
-------
>>> (SIMULATED / "cloud.csv").relative_to(ROOT).as_posix()
'data/simulated/cloud.csv'
"""

from __future__ import annotations

import os
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PUBLISHED = ROOT / "data" / "published"
SIMULATED = ROOT / "data" / "simulated"
RESULTS = ROOT / "data" / "results"
SCANS = ROOT / "data" / "scans"
FIGURES = ROOT / "figures"
NOTEBOOKS = ROOT / "notebooks"

OUTPUT_VARIABLE = "ANALYSIS_OUTPUT"


def existing(path: Path) -> Path:
    """Return the path of a file of the project's data, which must be there.

    Raises
    ------
    FileNotFoundError : it is not, as where the studies are not run from a checkout.

    Example
    -------
    >>> existing(PUBLISHED / "ou_liu_2017_table4.csv")
    Traceback (most recent call last):
    FileNotFoundError: data/published/ou_liu_2017_table4.csv is not there: the papers' data come
        with a checkout of the repository
    """
    if not path.is_file():
        name = path.relative_to(ROOT).as_posix()
        raise FileNotFoundError(
            f"{name} is not there: the papers' data come with a checkout of the repository"
        )
    return path


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
