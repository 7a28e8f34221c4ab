"""Contents of the simulated scans: points per station, and shares of the things they lie on."""

from __future__ import annotations

import numpy as np
import pandas as pd

from ..simulation.tunnel import ATTACHMENTS, FULL_DENSITY, NAMES, Campaign
from .register_campaign import station_names


def label_shares(campaign: Campaign) -> pd.DataFrame:
    """Shares of the labels among the points of each epoch.

    Returns
    -------
    DataFrame, a row per label: ``label``, ``epoch_1_percent``, ``epoch_2_percent``, and
    ``attachment``, "yes" or empty.
    """
    frame = pd.DataFrame({"label": NAMES})
    for epoch in campaign.epochs:
        codes = np.concatenate([scan.codes for scan in epoch.stations])
        frame[f"epoch_{epoch.number}_percent"] = (
            100.0 * np.bincount(codes, minlength=len(NAMES)) / len(codes)
        )
    return frame.assign(attachment=np.where(frame["label"].isin(ATTACHMENTS), "yes", ""))


def station_points(campaign: Campaign) -> pd.DataFrame:
    """Points and targets of every station.

    Returns
    -------
    DataFrame, a row per station: ``station``, ``chainage_m``, ``targets``, ``points``,
    ``of_the_paper_percent`` (of 4.5 million points).
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
