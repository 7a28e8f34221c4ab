"""Accuracy of the printed and the robust axis, and the causes that pull the printed one.

The printed axis takes the middle between the extreme points of bins of 0.1 m, so that single points
decide. Here points of whole rings are disturbed by one cause at a time, each as in the simulated
tunnel.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from analysis.tunnel.axis import Axis
from analysis.tunnel.axis_estimation import robust_axis

from ..simulation.tunnel import ZONE, Tunnel
from ..simulation.tunnel.campaign import ELEVATION, INSTRUMENT_HEIGHT, STATIONS
from .epoch_cloud import EpochCloud
from .printed_axis import printed_axis

MARGIN = 1.0  # m cut off at both ends where they shall have no influence
COMPARED = (ZONE[0] + 5.0, ZONE[1] - 5.0)  # m, where axes are compared
SPACING = 0.5  # m
NOISE = 0.003  # m, of a point along the radius
# of a cable tray: rad to either side of the left springline, m in front of the wall
TRAY = (np.radians(12.0), 0.13)


def axis_error(axis: Axis, tunnel: Tunnel, start: float, end: float) -> dict[str, float]:
    """Offsets of an axis from the true one, and its error of direction, between two chainages (m).

    Returns
    -------
    ``mean_u_mm``, ``mean_v_mm``, offsets to the right and upwards; ``largest_u_mm``,
    ``largest_v_mm`` about these means; ``largest_mrad``, the angle between the tangents.
    """
    at = axis.foot(tunnel.alignment.position(np.arange(start, end, SPACING)))
    chainage, u, v = tunnel.alignment.section_coordinates(axis.position(at))
    sines = np.linalg.norm(np.cross(axis.tangent(at), tunnel.alignment.tangent(chainage)), axis=-1)
    return {
        "mean_u_mm": 1e3 * u.mean(),
        "mean_v_mm": 1e3 * v.mean(),
        "largest_u_mm": 1e3 * np.abs(u - u.mean()).max(),
        "largest_v_mm": 1e3 * np.abs(v - v.mean()).max(),
        "largest_mrad": 1e3 * np.arcsin(sines).max(),
    }


def hazards(tunnel: Tunnel, n: int, seed: int) -> pd.DataFrame:
    """Errors of the printed axis of n points that are disturbed by one cause at a time.

    Returns
    -------
    DataFrame, a row per cause: ``cause``, ``length_m`` of the tunnel (the 45 m of the paper's
    sections, or all), and the columns of :func:`axis_error` in the 45 m less 5 m at both ends.
    """
    generator = np.random.default_rng(seed)
    whole = (0.0, tunnel.alignment.length)
    rows = []
    for cause, (start, end), trimmed, hidden in (
        ("nothing", ZONE, True, None),
        ("ends cut askew", ZONE, False, None),
        ("the track bed", ZONE, True, _bed),
        ("cables", ZONE, True, _cables),
        ("a wide cable tray", ZONE, True, _tray),
        ("the crown over a station", ZONE, True, _crown),
        ("the whole tunnel", whole, True, None),
        ("all of these", whole, False, _everything),
    ):
        chainage, alpha = generator.uniform(start, end, n), generator.uniform(-np.pi, np.pi, n)
        rho = tunnel.true_radius(alpha, chainage, 1) + NOISE * generator.standard_normal(n)
        if hidden is not None:
            chainage, alpha, rho = hidden(tunnel, chainage, alpha, rho)
        points = tunnel.alignment.polar_points(chainage, alpha, rho)
        if trimmed:
            y = points[:, 1]
            points = points[(y > y.min() + MARGIN) & (y < y.max() - MARGIN)]
        rows.append(
            {
                "cause": cause,
                "length_m": end - start,
                **axis_error(printed_axis(points), tunnel, *COMPARED),
            }
        )
    return pd.DataFrame(rows)


def _bed(tunnel: Tunnel, chainage, alpha, rho):
    """Put points that would lie under the bed onto it."""
    height = rho * np.cos(alpha)
    return (
        chainage,
        alpha,
        np.where(height < tunnel.furniture.bed, tunnel.furniture.bed / np.cos(alpha), rho),
    )


def _cables(tunnel: Tunnel, chainage, alpha, rho):
    """Put points behind a cable or a pipe onto its inner side."""
    for tube in tunnel.furniture.tubes:
        behind = np.abs(alpha - tube.alpha) < tube.radius / tube.rho
        rho = np.where(behind, tube.rho - tube.radius, rho)
    return chainage, alpha, rho


def _tray(tunnel: Tunnel, chainage, alpha, rho):
    """Put points behind a closed cable tray onto it.

    The simulated tunnel has none: between its cables the wall is seen.
    """
    half_width, depth = TRAY
    return chainage, alpha, np.where(np.abs(alpha + 0.5 * np.pi) < half_width, rho - depth, rho)


def _crown(tunnel: Tunnel, chainage, alpha, rho):
    """Leave out points that every station would see above the upper limit of its window."""
    above = rho * np.cos(alpha) - tunnel.furniture.bed - INSTRUMENT_HEIGHT
    across = rho * np.sin(alpha)
    seen = np.zeros(len(alpha), dtype=bool)
    for station in STATIONS[0]:
        seen |= np.arctan2(above, np.hypot(across, chainage - station)) < ELEVATION[1]
    return chainage[seen], alpha[seen], rho[seen]


def _everything(tunnel: Tunnel, chainage, alpha, rho):
    """Bed, cables and crown together."""
    for hidden in (_bed, _cables, _crown):
        chainage, alpha, rho = hidden(tunnel, chainage, alpha, rho)
    return chainage, alpha, rho


def axes(
    cloud: EpochCloud, true_cloud: EpochCloud, tunnel: Tunnel
) -> tuple[pd.DataFrame, dict[str, Axis]]:
    """Axes of a scan, of the whole tunnel and of the 45 m in which sections are cut.

    Parameters
    ----------
    cloud, true_cloud : the scan joined by registration, and by true poses.

    Returns
    -------
    DataFrame of their errors (:func:`axis_error`) in these 45 m less 5 m at both ends, and the axes
    by their names.
    """
    zone = cloud.points[cloud.between(tunnel, *ZONE)]
    y = zone[:, 1]
    found = {
        "printed, 45 m": printed_axis(zone),
        "printed, 45 m, ends cut off": printed_axis(
            zone[(y > y.min() + MARGIN) & (y < y.max() - MARGIN)]
        ),
        "printed, whole tunnel": printed_axis(cloud.points),
        "robust, whole tunnel": robust_axis(cloud.points),
        "robust, true poses": robust_axis(true_cloud.points),
    }
    table = pd.DataFrame(
        [{"axis": name, **axis_error(axis, tunnel, *COMPARED)} for name, axis in found.items()]
    )
    return table, found
