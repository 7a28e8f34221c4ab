"""Shift between the epochs of a section that comes from registration: stated and true."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from analysis.tunnel.block_adjustment import Block

from ..simulation.tunnel import FLAGGED_SECTIONS, SECTIONS, Epoch, Tunnel
from .epoch_cloud import EpochCloud

AROUND = 0.25  # m to either side of a section, in which points are counted by station


def parameter_errors(block: Block, epochs: tuple[Epoch, ...]) -> np.ndarray:
    """Errors (6K,) of the K stations of a block against their true poses.

    Image (m) and rotation (rad) of each station, in the order of the block's covariance.
    """
    errors = []
    for station, scan in zip(
        block.stations.values(), [scan for epoch in epochs for scan in epoch.stations], strict=True
    ):
        fit, pose = station.similarity, scan.pose
        turn = Rotation.from_matrix(fit.rotation @ pose.rotation.T).as_rotvec()
        errors += [fit.image - pose.to_engineering(fit.centre), turn]
    return np.concatenate(errors)


def shifts(
    blocks: Mapping[str, Block],
    clouds: tuple[EpochCloud, EpochCloud],
    epochs: tuple[Epoch, Epoch],
    tunnel: Tunnel,
) -> pd.DataFrame:
    """Shift of the second epoch against the first by registration, true and stated, per section.

    A section has the mean shift of its stations, weighted by the points that each has seen within
    0.25 m of it.

    Parameters
    ----------
    blocks : words -> stations registered in some way.
    clouds : points of the lining in both epochs.

    Returns
    -------
    DataFrame, a row per registration and section: ``registration`` (words), ``chainage_m``;
    ``right_mm``, ``right_sd_mm``, ``up_mm``, ``up_sd_mm``, true shift and stated standard
    deviation; ``chi_squared`` of both with the stated covariance, 2 expected.
    """
    seen = [tunnel.alignment.section_coordinates(cloud.points)[0] for cloud in clouds]
    rows = []
    for words, block in blocks.items():
        errors = parameter_errors(block, epochs).reshape(-1, 6)
        for at in SECTIONS:
            point, directions = tunnel.alignment.position(at), tunnel.alignment.frame(at)[[0, 2]]
            first, second = (
                _shares(cloud, np.abs(s - at) <= AROUND, epoch)
                for cloud, s, epoch in zip(clouds, seen, epochs, strict=True)
            )
            share = np.concatenate([-first, second])
            A = np.kron(share, np.eye(2))
            covariance = A @ block.shifts(point, directions) @ A.T
            arms = point - np.array(
                [station.similarity.image for station in block.stations.values()]
            )
            shift = directions @ (share @ (errors[:, :3] + np.cross(errors[:, 3:], arms)))
            right_sd, up_sd = 1e3 * np.sqrt(np.diagonal(covariance))
            rows.append(
                {
                    "registration": words,
                    "chainage_m": at,
                    "right_mm": 1e3 * shift[0],
                    "right_sd_mm": right_sd,
                    "up_mm": 1e3 * shift[1],
                    "up_sd_mm": up_sd,
                    "chi_squared": float(shift @ np.linalg.solve(covariance, shift)),
                }
            )
    return pd.DataFrame(rows)


def summary(table: pd.DataFrame, flagged=FLAGGED_SECTIONS) -> pd.DataFrame:
    """Root mean squares of :func:`shifts` over all sections and over the flagged ones.

    Parameters
    ----------
    flagged : chainages in m.

    Returns
    -------
    DataFrame: ``registration``, ``sections``; ``right_mm``, ``right_sd_mm``, ``up_mm``,
    ``up_sd_mm``; mean ``chi_squared``.
    """
    rows = []
    for words, of in table.groupby("registration", sort=False):
        for sections, part in (("all", of), ("flagged", of[of["chainage_m"].isin(flagged)])):
            columns = ("right_mm", "right_sd_mm", "up_mm", "up_sd_mm")
            means = {name: np.sqrt(np.mean(part[name] ** 2)) for name in columns}
            rows.append(
                {
                    "registration": words,
                    "sections": sections,
                    **means,
                    "chi_squared": part["chi_squared"].mean(),
                }
            )
    return pd.DataFrame(rows)


def _shares(cloud: EpochCloud, near: np.ndarray, epoch: Epoch) -> np.ndarray:
    """Share of the points ``near`` that each station of the epoch has seen."""
    counts = np.bincount(cloud.stations[near], minlength=len(epoch.stations))
    return counts / counts.sum()
