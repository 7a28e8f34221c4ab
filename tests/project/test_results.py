"""
The tables that the notebooks wrote in this test run, against the committed ones.

`make test` runs the notebooks and then this file, with one folder for both in $ANALYSIS_OUTPUT
(tests/conftest.py). Numbers are compared by tolerance, because BLAS kernels differ between
processors in the last bits of every sum, and iterations that stop at a threshold enlarge that.
"""

import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from project import scans
from studies import paths

RTOL, ATOL = 1e-6, 1e-9

COMMITTED = sorted(
    path.relative_to(paths.ROOT)
    for folder in (paths.RESULTS, paths.SIMULATED)
    for path in folder.rglob("*.csv")
)


@pytest.fixture
def output():
    """Where the notebooks of this run wrote."""
    if "NO_NOTEBOOKS_WERE_RUN" in os.environ:
        pytest.skip("no notebook was run, so there are no tables to compare: `make test` does both")
    return Path(os.environ[paths.OUTPUT_VARIABLE])


def differences(found, expected):
    """What distinguishes two tables of text cells beyond the tolerance, as lines for a person;
    empty when they agree.
    """
    if list(found.columns) != list(expected.columns):
        return [f"columns {list(found.columns)} instead of {list(expected.columns)}"]
    if len(found) != len(expected):
        return [f"{len(found)} rows instead of {len(expected)}"]
    lines = []
    for name in expected:
        numbers = [
            pd.to_numeric(table[name], errors="coerce").to_numpy(float)
            for table in (found, expected)
        ]
        agree = (found[name] == expected[name]).to_numpy() | np.isclose(
            *numbers, rtol=RTOL, atol=ATOL
        )
        lines += [
            f"row {row}, {name}: {found[name][row]} instead of {expected[name][row]}"
            for row in np.flatnonzero(~agree)
        ]
    return lines


def read(path):
    return pd.read_csv(path, dtype=str, keep_default_na=False)


@pytest.mark.parametrize("table", COMMITTED, ids=str)
def test_a_committed_table_is_written_again(table, output):
    if table.stem.startswith(scans.NOTEBOOK) and (reason := scans.skip_reason(scans.NOTEBOOK)):
        pytest.skip(reason)
    assert (output / table).is_file(), f"{table} is committed, but no notebook of this run wrote it"
    found = differences(read(output / table), read(paths.ROOT / table))
    assert not found, "\n".join(found[:20])


def test_every_written_table_is_committed(output):
    written = {path.relative_to(output) for path in (output / "data").rglob("*.csv")}
    assert written <= set(COMMITTED), f"not committed: {sorted(map(str, written - set(COMMITTED)))}"


def test_differences_are_seen():
    table = pd.DataFrame({"method": ["ls", "tls"], "radius": ["0.2023", "nan"]})
    noise = pd.DataFrame({"method": ["ls", "tls"], "radius": ["0.20230000001", "nan"]})
    other = pd.DataFrame({"method": ["ls", "wtls"], "radius": ["0.2024", "0.1"]})
    assert differences(noise, table) == []
    assert differences(other, table) == [
        "row 1, method: wtls instead of tls",
        "row 0, radius: 0.2024 instead of 0.2023",
        "row 1, radius: 0.1 instead of nan",
    ]
    assert differences(table[:1], table) == ["1 rows instead of 2"]
    assert differences(table[["radius"]], table)[0].startswith("columns")
