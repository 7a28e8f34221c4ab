"""Accuracy of the filter: points it finds and loses, and the deformation it takes off.

A filter by distance from one fixed cylinder takes off the wall that has moved, and the deformation
with it. So mean radii of both epochs are compared in cells, by all lining points and by those that
a rule keeps.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd

from analysis.result import rms
from analysis.tunnel.axis import Axis
from analysis.tunnel.filter import INSIDE, FilteredLining, filter_lining

from ..simulation.tunnel import Tunnel
from .epoch_cloud import EpochCloud

# Name in tables: keywords of filter_lining.
RULES = {
    "one cylinder": {"surface": "cylinder", "segment": np.inf},
    "cylinder by segments": {"surface": "cylinder"},
    "cylinder and local surface": {},
}
CELL = (np.radians(20.0), 2.0)  # rad, m
SECTOR = np.radians(120.0)  # to either side of the crown; beyond it the track bed meets the wall
# lining points of a cell in each epoch: one lost beyond 3 σ changes the mean of n by 3σ/n
FEWEST = 100
EMPTIED = 0.5  # of its lining points: a cell that has lost more has no deformation left


def apply_rules(
    clouds: tuple[EpochCloud, EpochCloud], axis: Axis, tunnel: Tunnel, start: float, end: float
) -> tuple[tuple[EpochCloud, EpochCloud], dict[str, tuple[FilteredLining, FilteredLining]]]:
    """Filter the points of both epochs between two chainages (m) by each of the ``RULES``.

    A rule without segments is applied to the whole tunnel, as it means; the others only to the
    points between. The axis is the same for both epochs.

    Returns
    -------
    The points between, per epoch; and rule -> result per epoch.
    """
    within = [cloud.between(tunnel, start, end) for cloud in clouds]
    parts = tuple(cloud.part(which) for cloud, which in zip(clouds, within, strict=True))
    linings = {}
    for rule, options in RULES.items():
        if options.get("segment") == np.inf:
            whole = [filter_lining(cloud.points, axis, **options) for cloud in clouds]
            linings[rule] = tuple(
                _part(result, which) for result, which in zip(whole, within, strict=True)
            )
        else:
            linings[rule] = tuple(filter_lining(cloud.points, axis, **options) for cloud in parts)
    return parts, linings


def _part(result: FilteredLining, which: np.ndarray) -> FilteredLining:
    """Result for the points where ``which`` is true."""
    return replace(
        result,
        flags=result.flags[which],
        distances=result.distances[which],
        cylinder_distances=result.cylinder_distances[which],
        segment=result.segment[which],
    )


def effects(
    clouds: tuple[EpochCloud, EpochCloud],
    linings: dict[str, tuple[FilteredLining, FilteredLining]],
    tunnel: Tunnel,
) -> pd.DataFrame:
    """Attachments that each rule finds, and lining that it loses.

    Returns
    -------
    DataFrame, a row per rule and epoch: ``rule``, ``epoch``; ``attachments``, points that stand out
    by 2 cm or more, and ``found_percent`` of them flagged inside; ``lining`` points and
    ``lost_percent`` of them; ``kept_of_all_percent`` of all points.
    """
    rows = []
    for rule, pair in linings.items():
        for epoch, (cloud, result) in enumerate(zip(clouds, pair, strict=True), start=1):
            attached, lining = cloud.attachments(tunnel, epoch), cloud.of("lining")
            rows.append(
                {
                    "rule": rule,
                    "epoch": epoch,
                    "attachments": int(attached.sum()),
                    "found_percent": 100.0 * np.mean(result.flags[attached] == INSIDE),
                    "lining": int(lining.sum()),
                    "lost_percent": 100.0 * np.mean(~result.lining[lining]),
                    "kept_of_all_percent": 100.0 * np.mean(result.lining),
                }
            )
    return pd.DataFrame(rows)


def cells(
    clouds: tuple[EpochCloud, EpochCloud],
    linings: dict[str, tuple[FilteredLining, FilteredLining]],
    tunnel: Tunnel,
) -> pd.DataFrame:
    """Mean deformation in cells of 20° and 2 m before and after each rule.

    Cells with fewer than 100 lining points in an epoch are left out.

    Returns
    -------
    DataFrame, a row per rule and cell:

    * ``rule``, ``chainage_m`` and ``alpha_deg`` of the middle;
    * ``true_mm``, mean deformation; ``before_mm``, by all lining points; ``after_mm``, by those
      that are kept, NaN where half of them are lost; ``change_mm``, after less before;
    * ``kept_percent``, the smaller of both epochs.
    """
    width, length = CELL
    parts = []
    for cloud in clouds:
        chainage, u, v = tunnel.alignment.section_coordinates(cloud.points)
        alpha = np.arctan2(u, v)
        looked_at = cloud.of("lining") & (np.abs(alpha) < SECTOR)
        parts.append(
            (
                np.floor(chainage / length),
                np.floor(alpha / width),
                np.hypot(u, v),
                looked_at,
                tunnel.deformation(alpha, chainage),
            )
        )
    first, last = (
        int(f(part[0].min() if f is min else part[0].max() for part in parts)) for f in (min, max)
    )
    around = int(np.ceil(np.pi / width))
    size = (last - first + 1) * 2 * around
    places = [((s - first) * 2 * around + a + around).astype(np.int64) for s, a, *_ in parts]
    counts, before = zip(
        *(
            _means(place, rho, on, size)
            for place, (_, _, rho, on, _) in zip(places, parts, strict=True)
        ),
        strict=True,
    )
    enough = np.flatnonzero(np.min(counts, axis=0) >= FEWEST)
    true = _means(places[0], parts[0][4], parts[0][3], size)[1]
    shared = {
        "chainage_m": (enough // (2 * around) + first + 0.5) * length,
        "alpha_deg": np.degrees((enough % (2 * around) - around + 0.5) * width),
        "true_mm": 1e3 * true[enough],
        "before_mm": 1e3 * (before[1] - before[0])[enough],
    }
    frames = []
    for rule, pair in linings.items():
        left, after = zip(
            *(
                _means(place, part[2], part[3] & result.lining, size)
                for place, part, result in zip(places, parts, pair, strict=True)
            ),
            strict=True,
        )
        kept = np.min(
            [now[enough] / then[enough] for now, then in zip(left, counts, strict=True)], axis=0
        )
        after_mm = np.where(kept > EMPTIED, 1e3 * (after[1] - after[0])[enough], np.nan)
        frames.append(
            pd.DataFrame(
                {"rule": rule, **shared, "after_mm": after_mm, "kept_percent": 100.0 * kept}
            )
        )
    table = pd.concat(frames, ignore_index=True)
    return table.assign(change_mm=table["after_mm"] - table["before_mm"])


def _means(
    place: np.ndarray, values: np.ndarray, where: np.ndarray, size: int
) -> tuple[np.ndarray, np.ndarray]:
    count = np.bincount(place[where], minlength=size)
    return count, np.bincount(place[where], values[where], minlength=size) / np.maximum(count, 1)


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """Summary of :func:`cells` per rule.

    Returns
    -------
    DataFrame, a row per rule: ``cells``, those ``emptied`` of half of their lining,
    ``least_kept_percent``; of the other cells ``rms_change_mm``, ``largest_change_mm`` of the
    deformation, and ``true_at_largest_mm``.
    """
    rows = []
    for rule, of in table.groupby("rule", sort=False):
        change = of["change_mm"].dropna().to_numpy()
        rows.append(
            {
                "rule": rule,
                "cells": len(of),
                "emptied": int(of["after_mm"].isna().sum()),
                "least_kept_percent": of["kept_percent"].min(),
                "rms_change_mm": float(rms(change)),
                "largest_change_mm": float(np.abs(change).max(initial=0.0)),
                "true_at_largest_mm": float(of.loc[of["change_mm"].abs().idxmax(), "true_mm"]),
            }
        )
    return pd.DataFrame(rows)
