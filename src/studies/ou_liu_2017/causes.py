"""Why a printed number of tables 1 and 2 is outside the range of the redraws."""

from __future__ import annotations

from collections.abc import Iterable

import pandas as pd

from ..printed.comparison import OUTSIDE
from .printed_tables import LABELS, SYMBOLS

# Why a number is outside: (table, method, quantity) -> cause. Notebooks 03 and 11 show what each
# rests on.
_CENTRE_CONTRADICTS_SIGMA_0 = (
    "contradicts its own row: the printed centre leaves a larger σ0 than printed, "
    "whatever the radius"
)
_UNSEEN = (
    "unseen gross error: of gross errors of random size, one below 1.5 σ = 0.3 m "
    "keeps its weight and does this"
)
CAUSES = {
    (1, "igg3_wtls", "abs_delta_c_m"): (
        "chance: a smaller error than most redraws have; one or two of 36 such numbers "
        "are to be expected"
    ),
    (1, "igg3_wtls", "sigma_0"): "not determined: proportional to √P_X, which is not printed; "
    "P_X of 1/5 to 1/4 gives it and, with a gross error unseen, table 2",
    (2, "ls", "abs_delta_a_m"): (
        "not determined: it hangs on where the gross errors lie; five are found that "
        "give the row, all but Δr"
    ),
    (2, "ls", "abs_delta_r_m"): (
        "contradicts its own row: no five gross errors balance the residuals it leaves; "
        "the rest is within reach"
    ),
    (2, "tls", "abs_delta_a_m"): _CENTRE_CONTRADICTS_SIGMA_0,
    (2, "tls", "abs_delta_r_m"): _CENTRE_CONTRADICTS_SIGMA_0,
    (2, "igg3_wtls", "abs_delta_a_m"): _UNSEEN + ", though rarely so much",
    (2, "igg3_wtls", "abs_delta_b_m"): _UNSEEN,
    (2, "igg3_wtls", "abs_delta_c_m"): _UNSEEN,
    (
        2,
        "igg3_wtls",
        "abs_delta_r_m",
    ): "contradicts its own row: the sphere would not lie between its points; "
    "table 3 prints the same as a radius",
    (2, "igg3_wtls", "sigma_0"): _UNSEEN,
}


def outside(comparison_tables: Iterable[pd.DataFrame]) -> pd.DataFrame:
    """Return the numbers that are outside, each with its cause; numbers of a row with the same
    cause together.

    Raises
    ------
    KeyError : a number is outside and `CAUSES` does not say why.
    """
    every = pd.concat(list(comparison_tables))
    rows: dict[tuple, list[str]] = {}
    for row in every[every["verdict"] == OUTSIDE].itertuples():
        cause = CAUSES[row.table, row.method, row.quantity]
        rows.setdefault((row.table, LABELS[row.method], cause), []).append(
            f"{SYMBOLS[row.quantity]} {row.printed:.{row.decimals}f}"
        )
    return pd.DataFrame(
        [
            (table, method, ", ".join(numbers), cause)
            for (table, method, cause), numbers in rows.items()
        ],
        columns=["table", "method", "printed", "cause"],
    )
