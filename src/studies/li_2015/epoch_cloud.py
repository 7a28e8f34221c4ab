"""All points of an epoch in one cloud, joined by the registration of its stations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.tunnel.registration import Station

from ..simulation.tunnel import ATTACHMENTS, CODES, Epoch, Tunnel
from .register_campaign import station_names

ATTACHED = 0.02  # m in front of the lining, from which an attachment counts


@dataclass(frozen=True, eq=False)
class EpochCloud:
    """All points of an epoch in registered engineering coordinates.

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
        """(n,) bool: points of attachments at least 2 cm in front of the lining."""
        found = self.of(*ATTACHMENTS)
        found[found] = tunnel.distances(self.points[found], epoch) <= -ATTACHED
        return found

    def between(self, tunnel: Tunnel, start: float, end: float) -> np.ndarray:
        """(n,) bool: points between two chainages, m."""
        chainage = tunnel.alignment.section_coordinates(self.points)[0]
        return (chainage >= start) & (chainage <= end)

    def part(self, which: np.ndarray) -> EpochCloud:
        """Cloud of the points where ``which`` (n,) is true."""
        return EpochCloud(self.points[which], self.codes[which], self.stations[which])


def join_scans(epoch: Epoch, stations: dict[str, Station] | None = None) -> EpochCloud:
    """Join the scans of an epoch by its registered stations, or by the true poses (None)."""
    scans = epoch.stations
    if stations is None:
        points = [scan.pose.to_engineering(scan.points) for scan in scans]
    else:
        points = [
            stations[name].similarity.transform(scan.points)
            for name, scan in zip(station_names(epoch), scans, strict=True)
        ]
    places = np.repeat(np.arange(len(points), dtype=np.uint8), [len(part) for part in points])
    return EpochCloud(
        np.concatenate(points), np.concatenate([scan.codes for scan in scans]), places
    )
