"""A printed number beside ours, and the one rule that gives the verdict."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from .numbers import PrintedNumber

REPRODUCED = "reproduced to the printed digits"
INSIDE = "inside the 95 % interval"
OUTSIDE = "outside"
VERDICTS = (REPRODUCED, INSIDE, OUTSIDE)


@dataclass(frozen=True)
class Comparison:
    """A printed number beside ours; values in the unit of `printed`.

    `ours` belongs to the committed cloud; `median`, `lower` and `upper` are the median and the
    limits of the central 95 % of the redraws; `percentile` is where the printed number lies among
    them; `matching_digits` counts the significant digits in which `ours` agrees with print;
    `redraws` were compared and `no_sphere` left out because the method found no real sphere.
    """

    printed: PrintedNumber
    ours: float
    median: float
    lower: float
    upper: float
    percentile: float
    matching_digits: int
    redraws: int
    no_sphere: int
    verdict: str


def verdict(printed: PrintedNumber, median: float, lower: float, upper: float) -> str:
    """Return the verdict on a printed number: the one rule, used everywhere.

    - reproduced to the printed digits: the median of the redraws, rounded to the printed
      decimals, is the printed number;
    - inside the 95 % interval: else, what rounds to the printed number (printed ± half a unit of
      its last digit) overlaps the central 95 % [lower, upper] of the redraws;
    - outside: else.

    Example
    -------
    >>> number = PrintedNumber("ou_liu_2017", 1, "", "ls", "sigma_s_m", "0.00282", 5, "m")
    >>> verdict(number, median=0.00287, lower=0.00274, upper=0.00301)
    'inside the 95 % interval'
    """
    if printed.agrees(median):
        return REPRODUCED
    if lower <= printed.value + printed.half_unit and printed.value - printed.half_unit <= upper:
        return INSIDE
    return OUTSIDE


def compare(printed: PrintedNumber, ours: float, redraws: ArrayLike) -> Comparison:
    """Compare a printed number with ours and with the redraws of the simulation.

    Parameters
    ----------
    printed : the number.
    ours : the value for the committed cloud, in the unit of `printed`.
    redraws : (B,) values for B redrawn clouds; NaN where the method found no real sphere. These
        are counted and left out.

    Returns
    -------
    Comparison. Its percentile is the mid-rank in percent: the redraws below the printed number,
    and half of those that round to it.

    Raises
    ------
    ValueError : `redraws` is not one-dimensional, or holds nothing but NaN.

    Example
    -------
    >>> number = PrintedNumber("ou_liu_2017", 1, "", "ls", "abs_delta_r_m", "0.0014", 4, "m")
    >>> result = compare(number, ours=0.0013, redraws=[0.0002, 0.0005, 0.0014, 0.0016, np.nan])
    >>> result.percentile, result.no_sphere, result.verdict
    (62.5, 1, 'inside the 95 % interval')
    """
    redraws = np.asarray(redraws, dtype=float)
    if redraws.ndim != 1:
        raise ValueError(f"expected redraws of shape (B,), got {redraws.shape}")
    found = redraws[~np.isnan(redraws)]
    if found.size == 0:
        name = f"{printed.quantity} of {printed.method} in table {printed.table}"
        raise ValueError(f"expected at least one redraw with a sphere for {name}, got none")
    lower, median, upper = np.quantile(found, [0.025, 0.5, 0.975]).tolist()
    ties = printed.agrees(found)
    below = (found < printed.value) & ~ties
    return Comparison(
        printed=printed,
        ours=float(ours),
        median=median,
        lower=lower,
        upper=upper,
        percentile=float(100 * (below.sum() + ties.sum() / 2) / found.size),
        matching_digits=_matching_digits(printed, ours),
        redraws=found.size,
        no_sphere=redraws.size - found.size,
        verdict=verdict(printed, median, lower, upper),
    )


def counted(frame: pd.DataFrame, words: Iterable[str] = VERDICTS) -> str:
    """Return how many numbers of a comparison have which verdict, in words."""
    return ", ".join(f"{(frame['verdict'] == word).sum()} {word}" for word in words)


def _matching_digits(printed: PrintedNumber, ours: float) -> int:
    """Return how many significant digits of the printed number ours agrees in.

    All of them when ours rounds to it; else the whole part of -log10 of the relative difference,
    which, unlike a comparison of digits, sees that 0.0999 is close to 0.1000.
    """
    if printed.agrees(ours):
        return printed.significant_digits
    if printed.value == 0 or not np.isfinite(ours):
        return 0
    digits = -np.log10(abs(ours - printed.value) / abs(printed.value))
    return int(np.clip(np.floor(digits), 0, printed.significant_digits - 1))
