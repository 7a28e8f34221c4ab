"""Tests of the figures: what a figure shows is exported, and that is what is compared."""

from analysis.export import tables
from studies.paths import FIGURES, RESULTS, output


def exported(stem):
    """The table that a figure was published with; both pictures must be there and not be empty."""
    assert all(
        output(FIGURES / f"{stem}.{kind}").stat().st_size > 10_000 for kind in ("png", "svg")
    )
    return tables.read(output(RESULTS / f"{stem}.csv"))
