"""From raw stations to one cloud an epoch: registration of the simulated campaign, and what its
scans hold.

Stations are called "epoch.place", so "1.3" is the third station of the first epoch.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from analysis.tunnel.axis import Axis
from analysis.tunnel.block_adjustment import Block, adjust_block, surface_ties
from analysis.tunnel.registration import CONTROL, OBSERVED, Station, register_stations

from ..simulation.tunnel import ATTACHMENTS, CODES, FULL_DENSITY, NAMES, Campaign, Epoch, Tunnel
from ..simulation.tunnel.campaign import LEVELLING_SD, NET_SD, TARGET_SD

ATTACHED = 0.02  # m in front of the lining, from which an attachment counts


@dataclass(frozen=True, eq=False)
class Cloud:
    """All points of an epoch in engineering coordinates, as the registration has them.

    points : (n, 3) in m
    codes : (n,) places of their labels in ``NAMES`` (truth)
    stations : (n,) places of their stations
    """

    points: np.ndarray
    codes: np.ndarray
    stations: np.ndarray

    def __len__(self) -> int:
        return len(self.points)

    def of(self, *labels: str) -> np.ndarray:
        """(n,) bool: points of these labels."""
        return np.isin(self.codes, [CODES[label] for label in labels])

    def attachments(self, tunnel: Tunnel, epoch: int) -> np.ndarray:
        """(n,) bool: points of attachments that stand out by 2 cm or more; their feet on the lining
        do not.
        """
        found = self.of(*ATTACHMENTS)
        found[found] = tunnel.distances(self.points[found], epoch) <= -ATTACHED
        return found

    def between(self, tunnel: Tunnel, start: float, end: float) -> np.ndarray:
        """(n,) bool: points between two chainages, m."""
        chainage = tunnel.alignment.section_coordinates(self.points)[0]
        return (chainage >= start) & (chainage <= end)

    def part(self, which: np.ndarray) -> Cloud:
        """The points where ``which`` (n,) is true."""
        return Cloud(self.points[which], self.codes[which], self.stations[which])


def station_names(epoch: Epoch) -> list[str]:
    """Names of its stations, in their order."""
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
    """Control points that the epochs use, as the total station has them: target, x, y, z in m."""
    points = {
        target: point
        for epoch in epochs
        for station in epoch.stations
        for target, point in zip(station.targets.names, station.targets.control, strict=True)
    }
    return pd.DataFrame([(target, *points[target]) for target in sorted(points)], columns=CONTROL)


def register(epoch: Epoch) -> dict[str, Station]:
    """Every station of an epoch registered to the control net.

    >>> from studies.simulation.tunnel import default_tunnel, survey
    >>> list(register(survey(default_tunnel())[1]))
    ['2.1', '2.2', '2.3', '2.4']
    """
    return register_observed(observed_targets(epoch), control_net(epoch))


def register_observed(observed: pd.DataFrame, net: pd.DataFrame) -> dict[str, Station]:
    """:func:`.register_stations` with the standard deviations of the simulation and the scale held
    at 1.
    """
    return register_stations(observed, net, scanner_sd=TARGET_SD, control_sd=NET_SD)


def adjust(
    epochs: tuple[Epoch, ...], stations: tuple[dict[str, Station], ...], axis: Axis
) -> Block:
    """:func:`.adjust_block` of all epochs, registered singly as ``stations``, with the standard
    deviations of the simulation.

    Tied are neighbours within an epoch. The instruments are levelled to 20″.
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


def joined(epoch: Epoch, stations: dict[str, Station] | None = None) -> Cloud:
    """The scans of an epoch in one system, by its registered ``stations``; None joins them by their
    true poses.
    """
    scans = epoch.stations
    if stations is None:
        points = [scan.pose.to_engineering(scan.points) for scan in scans]
    else:
        points = [
            stations[name].similarity.transform(scan.points)
            for name, scan in zip(station_names(epoch), scans, strict=True)
        ]
    places = np.repeat(np.arange(len(points), dtype=np.uint8), [len(part) for part in points])
    return Cloud(np.concatenate(points), np.concatenate([scan.codes for scan in scans]), places)


def label_shares(campaign: Campaign) -> pd.DataFrame:
    """Points on each thing, in percent of an epoch: ``label``, ``epoch_1_percent``,
    ``epoch_2_percent``, ``attachment``.
    """
    frame = pd.DataFrame({"label": NAMES})
    for epoch in campaign.epochs:
        codes = np.concatenate([scan.codes for scan in epoch.stations])
        frame[f"epoch_{epoch.number}_percent"] = (
            100.0 * np.bincount(codes, minlength=len(NAMES)) / len(codes)
        )
    return frame.assign(attachment=np.where(frame["label"].isin(ATTACHMENTS), "yes", ""))


def station_points(campaign: Campaign) -> pd.DataFrame:
    """Stations of both epochs: ``station``, ``chainage_m``, ``targets``, ``points``,
    ``of_the_paper_percent``.
    """
    rows = [
        {
            "station": name,
            "chainage_m": scan.setup.chainage,
            "targets": len(scan.targets.names),
            "points": len(scan),
            "of_the_paper_percent": 100.0 * len(scan) / FULL_DENSITY,
        }
        for epoch in campaign.epochs
        for name, scan in zip(station_names(epoch), epoch.stations, strict=True)
    ]
    return pd.DataFrame(rows)
