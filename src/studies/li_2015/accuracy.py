"""Scans against the total station: stickers on the lining, and how well neighbouring stations join."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.stats import chi2

from analysis.tunnel.registration import Station, check_points

from ..simulation.tunnel import Epoch, Tunnel
from ..simulation.tunnel.campaign import TOTAL_STATION
from .campaign import station_names
from .registration import RING

LIMIT_MM = 6.0  # point error of a class III deformation survey, as Li et al. (2015) use it
JOINT_MM = 2.0  # registration error between stations, as Li et al. (2015) print it
SURVEYED_SD = TOTAL_STATION.range_sd  # m a coordinate; 1″ adds 0.1 mm at 20 m


def stickers(epoch: Epoch, stations: dict[str, Station]) -> pd.DataFrame:
    """Every sticker of an epoch: ``station``, ``chainage_m``, ``alpha_deg``, and scanner less total
    station, ``dx_mm dy_mm dz_mm``.
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
    """:func:`.check_points` of the stickers, with their number ``n`` and whether m is
    ``within_limit`` of 6 mm.
    """
    found = 1e-3 * differences[["dx_mm", "dy_mm", "dz_mm"]].to_numpy()
    table = check_points(
        found, np.zeros_like(found), surveyed_sd=SURVEYED_SD, confidence=confidence
    )
    return table.assign(n=len(found), within_limit=np.where(table["m_mm"] <= LIMIT_MM, "yes", "no"))


def by_station(differences: pd.DataFrame) -> pd.DataFrame:
    """Mean difference of each station's stickers, mm, and ``f_ratio``, the scatter of these means
    over that within stations.

        F = Σ n_k |d̄_k − d̄|² / (3 (K − 1))  :  Σ |d − d̄_k|² / (3 (n − K))

    1 is expected if the stickers of a station have no error in common. The ratio is that of all
    stations, repeated in each row.
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


def joints(epoch: Epoch, stations: dict[str, Station], tunnel: Tunnel) -> pd.DataFrame:
    """How far apart neighbouring stations put the same wall, at the section half way between them;
    no noise but the registrations'.

    Columns: ``stations``, ``chainage_m``; ``shift_x_mm``, ``shift_y_mm``, ``shift_z_mm``, mean over
    the section; ``rms_mm``, a point's distance, and ``stated_mm``, the root mean square that the
    covariances of both stations give for it; ``within_percent`` of the section's points no farther
    apart than 2 mm in any coordinate.
    """
    names, rows = station_names(epoch), []
    poses = [station.pose for station in epoch.stations]
    for first in range(len(poses) - 1):
        pair = range(first, first + 2)
        chainage = np.mean(
            [tunnel.alignment.section_coordinates(poses[k].position)[0] for k in pair]
        )
        points = tunnel.alignment.polar_points(
            chainage, RING, tunnel.true_radius(RING, chainage, epoch.number)
        )
        fits = [stations[names[k]].similarity for k in pair]
        seen = [poses[k].to_instrument(points) for k in pair]
        apart = 1e3 * np.subtract(
            *(fit.transform(x) for fit, x in zip(reversed(fits), reversed(seen), strict=True))
        )
        variance = sum(
            np.trace(fit.transformed_covariance(x), axis1=-2, axis2=-1).mean()
            for fit, x in zip(fits, seen, strict=True)
        )
        shift = apart.mean(axis=0)
        rows.append(
            {
                "stations": f"{names[first]}, {names[first + 1]}",
                "chainage_m": chainage,
                **{f"shift_{axis}_mm": shift[k] for k, axis in enumerate("xyz")},
                "rms_mm": np.sqrt(np.mean(np.sum(apart**2, axis=-1))),
                "stated_mm": 1e3 * np.sqrt(variance),
                "within_percent": 100.0 * np.mean(np.abs(apart).max(axis=-1) <= JOINT_MM),
            }
        )
    return pd.DataFrame(rows)


def limit_for(n: int, confidence: float = 0.95) -> float:
    """Smallest m in mm that n stickers must show before a true m of 6 mm is rejected; m_P has 3n
    degrees of freedom.

        m = 6 √(χ²(3n; 1 − confidence) / 3n)     if the coordinates are equally precise

    >>> round(limit_for(10), 2), round(limit_for(60), 2)
    (4.71, 5.48)
    """
    return LIMIT_MM * float(np.sqrt(chi2.isf(confidence, 3 * n) / (3 * n)))
