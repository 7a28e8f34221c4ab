"""Calibration of intervals and tests in hundreds of simulated campaigns at reduced density.

:func:`coverage` counts how often the 95 % intervals of Δρ(α) hold the truth, :func:`alarms` how
often a section gives an alarm: by the fixed limit of 6 mm, and by the tests of
:mod:`analysis.tunnel.significance`, which include noise and registration. Where nothing has moved
every alarm is false; where something has moved, a section without an alarm is missed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from analysis.blocks import pieces
from analysis.result import rms
from analysis.tunnel.radii import DIRECTIONS, equal_angles, local_radii
from analysis.tunnel.significance import (
    LEVEL,
    LIMITS,
    differences,
    flagged,
    share_beyond,
    significance,
)

from .. import parallel
from .simulated_sections import ALL, SimulatedSection, compare_epochs

# neighbourhoods are about as wide: more directions would add little
EVERY_FIFTH = DIRECTIONS[::5]
CHUNK = 25  # campaigns sent to a worker at a time


def coverage(
    cases: Mapping[str, Sequence[SimulatedSection]], campaigns: int, seed: int, *, n_points: int
) -> pd.DataFrame:
    """Share of the 95 % intervals of Δρ(α) that hold the truth, and errors of Δρ.

    Parameters
    ----------
    cases : words -> sections.
    n_points : of each section in a campaign.

    Returns
    -------
    DataFrame, a row per case and section, and one for all sections together: ``case``,
    ``section``; ``held_percent`` and its standard error ``held_se_percent``, from the spread
    between campaigns, because the directions of a campaign are correlated; ``rmse_mm`` of Δρ,
    ``stated_mm``, RMS of its standard deviations; ``rmse_within_mm`` of Δρ less its rigid part.
    """
    rows = []
    for words, sections in cases.items():
        held, errors, stated, within = [], [], [], []
        for section in sections:
            one = compare_epochs(section, campaigns, seed, n_points=n_points, angles=EVERY_FIFTH)
            low, high = one.change.interval(0.95)
            held.append(np.mean((low <= one.truth) & (one.truth <= high), axis=-1))
            errors.append(one.errors)
            stated.append(one.change.standard_deviations)
            within.append(one.errors_within)
        held, errors, stated, within = map(np.array, (held, errors, stated, within))
        names = [f"{section.chainage:g} m" for section in sections]
        for name, of in [
            *((name, slice(k, k + 1)) for k, name in enumerate(names)),
            (ALL, slice(None)),
        ]:
            a_campaign = held[of].mean(axis=0)
            rows.append(
                {
                    "case": words,
                    "section": name,
                    "held_percent": 100.0 * a_campaign.mean(),
                    "held_se_percent": 100.0 * a_campaign.std() / np.sqrt(campaigns),
                    "rmse_mm": 1e3 * rms(errors[of].ravel()),
                    "stated_mm": 1e3 * rms(stated[of].ravel()),
                    "rmse_within_mm": 1e3 * rms(within[of].ravel()),
                }
            )
    return pd.DataFrame(rows)


def alarms(
    sections: Sequence[SimulatedSection], campaigns: int, seed: int, *, workers: int | None = None
) -> pd.DataFrame:
    """Alarms by the printed fixed limits, and by the tests of significance at 5 %.

    Parameters
    ----------
    workers : processes that share the work, which changes nothing.

    Returns
    -------
    DataFrame, a row per section and one for all: ``section``;

    * ``beyond_6_mm_percent``, ``beyond_12_mm_percent`` of the single directions;
    * ``flagged_percent`` of the campaigns, with over 30 % of the directions beyond 6 mm;
    * ``significant_percent`` of the single directions, by the level of detection;
    * ``changed_percent`` of the campaigns by the test of the section, and ``changed_se_percent``,
      the binomial standard error of a test that keeps its 5 %.
    """
    tasks = []
    for section in sections:
        pair = section.draw(campaigns, seed)
        tasks += [(section, [epoch[k] for epoch in pair]) for k in pieces(campaigns, CHUNK)]
    done = parallel.run(_alarms, tasks, workers)
    found = np.concatenate(done).reshape(len(sections), campaigns, -1)
    rows = []
    for name, values in [
        *zip((f"{section.chainage:g} m" for section in sections), found, strict=True),
        (ALL, np.concatenate(found)),
    ]:
        six, twelve, flags, directions, changed = 100.0 * values.mean(axis=0)
        rows.append(
            {
                "section": name,
                "beyond_6_mm_percent": six,
                "beyond_12_mm_percent": twelve,
                "flagged_percent": flags,
                "significant_percent": directions,
                "changed_percent": changed,
                "changed_se_percent": 100.0 * np.sqrt(LEVEL * (1.0 - LEVEL) / len(values)),
            }
        )
    return pd.DataFrame(rows)


def _alarms(section: SimulatedSection, epochs) -> np.ndarray:
    """(B, 5): shares beyond 6 and 12 mm, flagged; share of significant directions, changed."""
    rows = []
    for pair in zip(*epochs, strict=True):
        cut = [section.section(points) for points in pair]
        delta = differences(*(equal_angles(one, EVERY_FIFTH) for one in cut))
        found = significance(
            *(local_radii(one, EVERY_FIFTH) for one in cut), registration=section.registration
        )
        significant = found.significant[~np.isnan(found.delta)].mean()
        rows.append(
            [
                *(share_beyond(delta, limit) for limit in LIMITS),
                flagged(delta),
                significant,
                found.changed,
            ]
        )
    return np.array(rows, dtype=float)
