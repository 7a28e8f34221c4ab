"""Points in a section, and its directions: read from points, interpolated, or gaps."""

from __future__ import annotations

import numpy as np
import pandas as pd

from analysis.result import rms
from analysis.tunnel.axis import Axis, straight
from analysis.tunnel.radii import FEWEST, Radii, equal_angles, local_radii
from analysis.tunnel.sections import THICKNESS, Section, cut

from ..simulation.tunnel import (
    CODES,
    FULL_DENSITY,
    SectionScan,
    Setup,
    Tunnel,
    section_points,
    section_scan,
)
from ..simulation.tunnel.campaign import ELEVATION
from .epoch_cloud import EpochCloud

READINGS = {"equal angles": equal_angles, "local quadratics": local_radii}
# of a section with too few points to read
NOTHING = {"found_percent": 0.0, "interpolated_percent": 0.0, "gaps_percent": 100.0}
AXIS_PIECE = 0.5  # m to each side of a section that stands alone


def ring_points(
    distance, density: float = FULL_DENSITY, *, radius: float = 2.7, thickness: float = THICKNESS
) -> np.ndarray:
    """Number of points (…) that a scanner on the axis puts on a whole ring.

        n = N d R² / (2π Δε) ∫ dα / (r³ cos ε),   r² = R² + L²,   sin ε = R cos α / r

    for the α with ε within the window of the scanner. N beams are evenly spread in azimuth and in
    elevation over Δε; the ring has radius R, thickness d and the axial distance L.

    Parameters
    ----------
    distance : L (…), m.
    density : N, beams per station.
    radius, thickness : R and d, m.

    Example
    -------
    >>> np.round(ring_points([5.0, 8.0, 20.0]), -1)
    array([5450., 1600.,  110.])
    """
    distance = np.asarray(distance, dtype=float)
    alpha = np.radians(np.arange(0.25, 360.0, 0.5))
    r = np.hypot(radius, distance)[..., None]
    sine = radius * np.cos(alpha) / r
    seen = (sine > np.sin(ELEVATION[0])) & (sine < np.sin(ELEVATION[1]))
    integral = np.radians(0.5) * np.sum(seen / (r**3 * np.sqrt(1.0 - sine**2)), axis=-1)
    return density * thickness * radius**2 / (2 * np.pi * (ELEVATION[1] - ELEVATION[0])) * integral


def nearest_station(chainages, setups) -> np.ndarray:
    """Distances (K,) in m along the tunnel from chainages to the nearest of the set-ups."""
    stations = np.array([setup.chainage for setup in setups])
    return np.abs(np.asarray(chainages)[:, None] - stations).min(axis=1)


def section_counts(
    linings: tuple[EpochCloud, EpochCloud],
    setups,
    axis: Axis,
    tunnel: Tunnel,
    chainages,
    density: float,
) -> pd.DataFrame:
    """Points and directions of the sections of the lining in both epochs.

    Parameters
    ----------
    linings : points of the lining, per epoch.
    setups : stations, per epoch.
    axis : about which the sections are cut.
    chainages : of the sections, m of the design.
    density : beams per station of the scans.

    Returns
    -------
    DataFrame, a row per section and epoch:

    * ``chainage_m``, ``epoch``, ``station_m``, distance to the nearest station;
    * ``points`` in the 50 mm of the section; ``at_full_density``, times 4.5 million / density;
    * ``found_percent``, ``interpolated_percent``, ``gaps_percent`` of the directions by local
      quadratics.
    """
    at = axis.chainage(axis.foot(tunnel.alignment.position(np.asarray(chainages, dtype=float))))
    rows = []
    for epoch, (cloud, stations) in enumerate(zip(linings, setups, strict=True), start=1):
        near = nearest_station(chainages, stations)
        for chainage, distance, section in zip(
            chainages, near, cut(cloud.points, axis, at), strict=True
        ):
            rows.append(
                {
                    "chainage_m": float(chainage),
                    "epoch": epoch,
                    "station_m": distance,
                    "points": section.count,
                    "at_full_density": section.count * FULL_DENSITY / density,
                    **(shares(local_radii(section)) if section.count >= FEWEST else NOTHING),
                }
            )
    return pd.DataFrame(rows)


def shares(radii: Radii) -> dict[str, float]:
    """Percent of directions that are ``found``, ``interpolated`` and ``gaps``."""
    gaps, interpolated = radii.gaps.mean(), radii.interpolated.mean()
    return {
        "found_percent": 100.0 * (1.0 - gaps - interpolated),
        "interpolated_percent": 100.0 * interpolated,
        "gaps_percent": 100.0 * gaps,
    }


def full_section(
    tunnel: Tunnel, setups: tuple[Setup, ...], chainage: float, density: float = FULL_DENSITY
) -> SectionScan:
    """Points of the lining around one section without noise, by default at the paper's density.

    The slab is twice as thick as the section: noise along the axis leads points into the section
    and out of it.
    """
    scan = section_scan(tunnel, setups, chainage, density, thickness=2.0 * THICKNESS)
    return scan[scan.codes == CODES["lining"]]


def noisy_section(scan: SectionScan, tunnel: Tunnel, seed: int) -> Section:
    """Section about the true axis, with the scanner's noise and without registration errors."""
    points = section_points(scan, 1, seed)[0]
    ends = tunnel.alignment.position(scan.chainage) + AXIS_PIECE * np.array(
        [[-1.0], [1.0]]
    ) * tunnel.alignment.tangent(scan.chainage)
    axis = straight(*ends)
    (section,) = cut(points, axis, [0.5 * axis.length])
    return section


def readings(scans: dict[str, SectionScan], tunnel: Tunnel, parts, seed: int) -> pd.DataFrame:
    """Both readings of sections thinned out at random.

    Parameters
    ----------
    scans : name -> slab, from :func:`full_section`.
    parts : fractions of the points that are left.

    Returns
    -------
    DataFrame, a row per section, part and reading: ``section``, ``part``, ``points``, ``reading``;
    ``found_percent``, ``interpolated_percent``, ``gaps_percent`` of the directions;
    ``rms_found_mm``, ``rms_interpolated_mm``, root mean square errors of the radii.
    """
    rows = []
    for name, scan in scans.items():
        for part in parts:
            section = noisy_section(
                scan.sample(max(round(part * len(scan)), 1), seed), tunnel, seed
            )
            for reading, read in READINGS.items():
                radii = read(section)
                errors = 1e3 * radius_errors(section, radii, tunnel, scan.epoch)
                found = ~radii.gaps & ~radii.interpolated
                rows.append(
                    {
                        "section": name,
                        "part": part,
                        "points": section.count,
                        "reading": reading,
                        **shares(radii),
                        "rms_found_mm": float(rms(errors[found])) if found.any() else np.nan,
                        "rms_interpolated_mm": float(rms(errors[radii.interpolated]))
                        if radii.interpolated.any()
                        else np.nan,
                    }
                )
    return pd.DataFrame(rows)


def radius_errors(section: Section, radii: Radii, tunnel: Tunnel, epoch: int) -> np.ndarray:
    """Errors ρ − ρ_true of radii in m, in their shape; NaN at gaps."""
    seen = ~radii.gaps
    alpha, rho = (
        np.broadcast_to(radii.directions, seen.shape)[seen][:, None],
        radii.radius[seen][:, None],
    )
    errors = np.full(seen.shape, np.nan)
    errors[seen] = tunnel.distances(
        section.position + rho * (np.sin(alpha) * section.right + np.cos(alpha) * section.up), epoch
    )
    return errors
