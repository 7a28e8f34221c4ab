"""A target taken for another: whether the mistake is found, and how far it moves the station."""

from __future__ import annotations

import numpy as np
import pandas as pd

from analysis.similarity import fit_similarity

from ..simulation.tunnel import Epoch
from .register_campaign import control_net, observed_targets, register_observed
from .registration_accuracy import ABSOLUTE


def mistake(observed: pd.DataFrame, station: str, target: str, taken_for: str) -> pd.DataFrame:
    """Give one target of one station the name of another.

    Raises
    ------
    ValueError : the station has not observed the target.
    """
    wrong = (observed["station"] == station) & (observed["target"] == target)
    if not wrong.any():
        raise ValueError(f"target: expected one that station {station} has observed, got {target}")
    return observed.assign(target=observed["target"].mask(wrong, taken_for))


def every_mistake(*epochs: Epoch) -> pd.DataFrame:
    """Take every target in turn for the nearest control point that its station does not use.

    Returns
    -------
    DataFrame, a row per mistake: ``station``, ``targets``, ``target``, ``taken_for``, ``apart_m``;

    * ``named``: the robust adjustment leaves out this pair and no other;
    * ``moved_mm``, ``moved_by_least_squares_mm``: shift of the instrument by the mistake in the
      robust and in the plain adjustment, against the plain adjustment of the right pairs;
    * ``largest_by_least_squares``: the wrong pair has the largest misclosure of the plain
      adjustment; ``least_by_least_squares_mm``, the smallest misclosure there.
    """
    net = control_net(*epochs)
    places = net.set_index("target")[["x", "y", "z"]]
    rows = []
    for epoch in epochs:
        observed = observed_targets(epoch)
        for station, pairs in observed.groupby("station", sort=False):
            right = _plain(pairs, places)
            free = places.drop(index=pairs["target"])
            for target in pairs["target"]:
                apart = np.linalg.norm(free - places.loc[target], axis=1)
                other = free.index[np.argmin(apart)]
                wrong = mistake(pairs, station, target, other)
                found = register_observed(wrong, net)[station]
                plain = _plain(wrong, places)
                moved = [
                    np.linalg.norm(fit.translation - right.translation)
                    for fit in (found.similarity, plain)
                ]
                misclosures = np.linalg.norm(plain.residuals, axis=-1)
                rows.append(
                    {
                        "station": station,
                        "targets": len(pairs),
                        "target": target,
                        "taken_for": other,
                        "apart_m": apart.min(),
                        "named": found.rejected == (other,),
                        "moved_mm": 1e3 * moved[0],
                        "moved_by_least_squares_mm": 1e3 * moved[1],
                        "largest_by_least_squares": wrong["target"].iloc[np.argmax(misclosures)]
                        == other,
                        "least_by_least_squares_mm": 1e3 * misclosures.min(),
                    }
                )
    return pd.DataFrame(rows)


def _plain(pairs: pd.DataFrame, places: pd.DataFrame):
    return fit_similarity(
        pairs[["x", "y", "z"]].to_numpy(),
        places.loc[pairs["target"]].to_numpy(),
        scale=False,
        **ABSOLUTE,
    )


def summary(found: pd.DataFrame) -> pd.DataFrame:
    """Summary of :func:`every_mistake` by the number of targets of a station.

    Returns
    -------
    DataFrame, a row per number of ``targets``: ``mistakes``, ``named_percent``, ``least_apart_m``,
    and shifts of the instrument in mm; of the plain adjustment ``smallest_misclosure_mm``, of any
    target in any trial, and ``largest_misclosure_percent``, the share of the mistakes in which the
    wrong pair has the largest.
    """
    rows = [
        {
            "targets": targets,
            "mistakes": len(rows),
            "named_percent": 100.0 * rows["named"].mean(),
            "least_apart_m": rows["apart_m"].min(),
            "median_moved_mm": rows["moved_mm"].median(),
            "largest_moved_mm": rows["moved_mm"].max(),
            "median_by_least_squares_mm": rows["moved_by_least_squares_mm"].median(),
            "smallest_misclosure_mm": rows["least_by_least_squares_mm"].min(),
            "largest_misclosure_percent": 100.0 * rows["largest_by_least_squares"].mean(),
        }
        for targets, rows in found.groupby("targets")
    ]
    return pd.DataFrame(rows)
