"""What a filter does to a tunnel whose lining and attachments are known: found, lost, and how far
it moves the wall.

A filter that takes off points farther than 3 σ from one cylinder takes off deformation with them,
and no later step sees it again. :func:`compare_rules` sets the rules beside each other on the same
points.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from analysis.checks import check_whole_number
from analysis.result import rms
from analysis.tunnel.filter import INSIDE, FilteredLining, TunnelAxis, filter_lining

# Name in tables: keywords of filter_lining.
RULES = {
    "one cylinder": {"surface": "cylinder", "segment": np.inf},
    "cylinder by segments": {"surface": "cylinder"},
    "cylinder and local surface": {},
}
CELL = (np.radians(5.0), 0.3)  # rad, m
SECTOR = np.radians(135.0)  # to either side of the crown; beyond it the track bed meets the wall


def effect(
    result: FilteredLining, points, axis: TunnelAxis, lining, attachment, *, fewest: int = 100
) -> dict[str, float]:
    """What a filter found and lost, and how it changed the mean radius in cells of 5° and 0.3 m.

    lining, attachment : (n,) bool, the truth
    fewest : lining points of a cell that is looked at: every point beyond 3 σ that is lost changes
        the mean of n points by 3σ/n

    Returns the shares ``found`` of the attachments flagged inside and ``lost`` of the lining
    flagged at all. Over the cells within 135° of the crown, largest and RMS ``change`` in mm of the
    mean radius by the lining points that were lost, and largest ``intrusion`` in mm by other points
    that were kept; and the numbers of these ``cells`` and of those ``emptied`` of more than half of
    their lining, whose changes are not defined and left out.
    """
    lining, attachment = np.asarray(lining, dtype=bool), np.asarray(attachment, dtype=bool)
    y, radius, angle = axis.polar(points)
    along = axis.chainage(y)
    width, length = CELL
    _, cell = np.unique(
        np.floor((angle + np.pi) / width) * 1e6 + np.floor((along - along.min()) / length),
        return_inverse=True,
    )
    before, count = _means(cell, radius, lining & (np.abs(angle) <= SECTOR))
    kept, left = _means(cell, radius, lining & result.lining)
    together, _ = _means(cell, radius, result.lining)
    looked_at = count >= check_whole_number(fewest, "fewest")
    if not looked_at.any():
        raise ValueError(
            f"fewest: expected cells with at least {fewest} lining points, got at most {count.max():.0f} in one"
        )
    emptied = looked_at & (left < 0.5 * count)
    whole = looked_at & ~emptied
    change, intrusion = 1e3 * (kept - before)[whole], 1e3 * (together - kept)[whole]
    return {
        "found": float(np.mean(result.flags[attachment] == INSIDE)),
        "lost": float(np.mean(~result.lining[lining])),
        "largest_change": float(np.abs(change).max(initial=0.0)),
        "rms_change": float(rms(change)),
        "largest_intrusion": float(np.abs(intrusion).max(initial=0.0)),
        "cells": int(looked_at.sum()),
        "emptied": int(emptied.sum()),
    }


def _means(
    cell: np.ndarray, values: np.ndarray, where: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    count = np.bincount(cell, where)
    return np.bincount(cell, np.where(where, values, 0.0)) / np.maximum(count, 1), count


def compare_rules(
    points, axis: TunnelAxis, lining, attachment, *, fewest: int = 100, threshold: float = 3.0
) -> pd.DataFrame:
    """The :func:`effect` of each of the ``RULES``, one row a rule."""
    effects = {}
    for name, options in RULES.items():
        result = filter_lining(points, axis, threshold=threshold, **options)
        effects[name] = effect(result, points, axis, lining, attachment, fewest=fewest)
    return pd.DataFrame.from_dict(effects, orient="index").rename_axis("rule")
