"""Registration of the stations of the simulated campaign, one by one and all together.

A station is named "epoch.place": "1.3" is the third station of the first epoch.
"""

from __future__ import annotations

import pandas as pd

from analysis.tunnel.axis import Axis
from analysis.tunnel.block_adjustment import Block, adjust_block
from analysis.tunnel.registration import CONTROL, OBSERVED, Station, register_stations
from analysis.tunnel.surface_ties import surface_ties

from ..simulation.tunnel import Epoch
from ..simulation.tunnel.campaign import LEVELLING_SD, NET_SD, TARGET_SD


def station_names(epoch: Epoch) -> list[str]:
    """Names of the stations of an epoch, in their order."""
    return [f"{epoch.number}.{place}" for place in range(1, len(epoch.stations) + 1)]


def observed_targets(epoch: Epoch) -> pd.DataFrame:
    """Targets in the frames of the stations: station, target, x, y, z in m."""
    rows = [
        (name, target, *point)
        for name, station in zip(station_names(epoch), epoch.stations, strict=True)
        for target, point in zip(station.targets.names, station.targets.scanned, strict=True)
    ]
    return pd.DataFrame(rows, columns=OBSERVED)


def control_net(*epochs: Epoch) -> pd.DataFrame:
    """Control points of the epochs as measured: target, x, y, z in m, sorted by name."""
    points = {
        target: point
        for epoch in epochs
        for station in epoch.stations
        for target, point in zip(station.targets.names, station.targets.control, strict=True)
    }
    return pd.DataFrame([(target, *points[target]) for target in sorted(points)], columns=CONTROL)


def register(epoch: Epoch) -> dict[str, Station]:
    """Register every station of an epoch to the control net.

    Example
    -------
    >>> from studies.simulation.tunnel import default_tunnel, survey
    >>> list(register(survey(default_tunnel())[1]))
    ['2.1', '2.2', '2.3', '2.4']
    """
    return register_observed(observed_targets(epoch), control_net(epoch))


def register_observed(observed: pd.DataFrame, net: pd.DataFrame) -> dict[str, Station]:
    """Register stations with the standard deviations of the simulation and the scale fixed at 1."""
    return register_stations(observed, net, scanner_sd=TARGET_SD, control_sd=NET_SD)


def adjust(
    epochs: tuple[Epoch, ...], stations: tuple[dict[str, Station], ...], axis: Axis
) -> Block:
    """Adjust all stations of all epochs together, with the standard deviations of the simulation.

    Parameters
    ----------
    epochs : the scans.
    stations : per epoch, the stations registered singly.
    axis : of the tunnel, from which the mean radii of the ties are counted.

    Neighbours within an epoch are tied by the wall that both see; the instruments are levelled
    to 20″ (:func:`.adjust_block`).
    """
    together = {name: station for found in stations for name, station in found.items()}
    scans = [
        dict(zip(station_names(epoch), (scan.points for scan in epoch.stations), strict=True))
        for epoch in epochs
    ]
    ties = [surface_ties(together, of_epoch, axis) for of_epoch in scans]
    return adjust_block(
        together, ties, scanner_sd=TARGET_SD, control_sd=NET_SD, level_sd=LEVELLING_SD
    )
