"""The tables that the notebooks wrote in this test run, against the committed ones.

`make test` runs the notebooks and then this file, with one folder for both in $ANALYSIS_OUTPUT
(conftest.py).
"""

import os
from pathlib import Path

import pytest

from project import scans
from project.agreement import read_table, table_differences
from studies import paths

COMMITTED = sorted(
    path.relative_to(paths.ROOT)
    for folder in (paths.RESULTS, paths.SIMULATED)
    for path in folder.rglob("*.csv")
)


@pytest.fixture
def output():
    """The folder in which the notebooks of this run wrote."""
    if "NO_NOTEBOOKS_WERE_RUN" in os.environ:
        pytest.skip("no notebook was run, so there are no tables to compare: `make test` does both")
    return Path(os.environ[paths.OUTPUT_VARIABLE])


@pytest.mark.parametrize("table", COMMITTED, ids=str)
def test_a_committed_table_is_written_again(table, output):
    if table.stem.startswith(scans.NOTEBOOK) and (reason := scans.skip_reason(scans.NOTEBOOK)):
        pytest.skip(reason)
    assert (output / table).is_file(), f"{table} is committed, but no notebook of this run wrote it"
    found = table_differences(
        *(read_table((folder / table).read_bytes()) for folder in (output, paths.ROOT))
    )
    assert not found, "\n".join(found[:20])


def test_every_written_table_is_committed(output):
    written = {path.relative_to(output) for path in (output / "data").rglob("*.csv")}
    assert written <= set(COMMITTED), f"not committed: {sorted(map(str, written - set(COMMITTED)))}"
