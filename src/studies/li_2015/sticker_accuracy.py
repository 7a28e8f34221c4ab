"""Scans against the total station: coordinates of stickers on the lining."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.stats import chi2

from analysis.tunnel.registration import Station, check_points

from ..simulation.tunnel import Epoch
from ..simulation.tunnel.campaign import TOTAL_STATION
from .register_campaign import station_names

LIMIT_MM = 6.0  # point error of a class III deformation survey, as Li et al. (2015) use it
SURVEYED_SD = TOTAL_STATION.range_sd  # m per coordinate; 1″ adds 0.1 mm at 20 m


def differences(epoch: Epoch, stations: dict[str, Station]) -> pd.DataFrame:
    """Coordinates of the stickers of an epoch, scanner less total station.

    Returns
    -------
    DataFrame, a row per sticker: ``station``, ``chainage_m``, ``alpha_deg``, ``dx_mm``, ``dy_mm``,
    ``dz_mm``.
    """
    found = epoch.stickers
    names = np.array(station_names(epoch))[found.station]
    derived = np.array(
        [
            stations[name].similarity.transform(point)
            for name, point in zip(names, found.scanned, strict=True)
        ]
    )
    difference = 1e3 * (derived - found.total_station)
    return pd.DataFrame(
        {
            "station": names,
            "chainage_m": found.chainage,
            "alpha_deg": np.degrees(found.alpha),
            **{f"d{axis}_mm": difference[:, k] for k, axis in enumerate("xyz")},
        }
    )


def accuracy(differences: pd.DataFrame, confidence: float = 0.95) -> pd.DataFrame:
    """Accuracy by :func:`.check_points`, with the number of stickers and the limit of 6 mm.

    Returns
    -------
    DataFrame of that function with ``n`` and ``within_limit``, "yes" or "no" for m ≤ 6 mm.
    """
    found = 1e-3 * differences[["dx_mm", "dy_mm", "dz_mm"]].to_numpy()
    table = check_points(
        found, np.zeros_like(found), surveyed_sd=SURVEYED_SD, confidence=confidence
    )
    return table.assign(n=len(found), within_limit=np.where(table["m_mm"] <= LIMIT_MM, "yes", "no"))


def station_means(differences: pd.DataFrame) -> pd.DataFrame:
    """Mean difference of the stickers of each station, and the scatter of these means.

        F = Σ n_k |d̄_k − d̄|² / (3 (K − 1))  :  Σ |d − d̄_k|² / (3 (n − K))

    Returns
    -------
    DataFrame, a row per station: ``station``, ``mean_dx_mm``, ``mean_dy_mm``, ``mean_dz_mm``,
    ``n``, and ``f_ratio``, F of all stations, repeated in each row: 1 is expected if the stickers
    of a station have no error in common.
    """
    columns = ["dx_mm", "dy_mm", "dz_mm"]
    groups = differences.groupby("station", sort=True)[columns]
    means, counts = groups.mean(), groups.size()
    within = np.sum(
        (differences[columns].to_numpy() - means.loc[differences["station"]].to_numpy()) ** 2
    )
    between = np.sum(
        counts.to_numpy()[:, None] * (means - differences[columns].mean()).to_numpy() ** 2
    )
    n, stations = len(differences), len(means)
    ratio = between / (stations - 1) * (n - stations) / within
    names = {f"d{axis}_mm": f"mean_d{axis}_mm" for axis in "xyz"}
    return means.rename(columns=names).assign(n=counts, f_ratio=ratio).reset_index()


def limit_for(n: int, confidence: float = 0.95) -> float:
    """Value in mm below which m of n stickers rejects a true m of 6 mm.

        m = 6 √(χ²(3n; 1 − confidence) / 3n)

    for equally precise coordinates, with 3n degrees of freedom.

    Example
    -------
    >>> round(limit_for(10), 2), round(limit_for(60), 2)
    (4.71, 5.48)
    """
    return LIMIT_MM * float(np.sqrt(chi2.isf(confidence, 3 * n) / (3 * n)))
