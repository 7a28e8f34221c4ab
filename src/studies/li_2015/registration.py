"""How good the registration of the simulated stations is: three solutions, true errors, repetition,
wrong pairs, and both epochs.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from analysis.result import ConvergenceWarning
from analysis.similarity import fit_similarity, thirteen_parameters, umeyama
from analysis.tunnel.block_adjustment import Block
from analysis.tunnel.registration import ARCSECONDS, Station, section_errors

from ..simulation.tunnel import FLAGGED_SECTIONS, SECTIONS, Epoch, Setup, Tunnel
from ..simulation.tunnel.campaign import NET_SD, TARGET_SD
from .campaign import Cloud, control_net, observed_targets, register_observed, station_names

ABSOLUTE = {"source_cofactors": TARGET_SD**2, "target_cofactors": NET_SD**2, "absolute": True}
RING = np.radians(np.arange(-135.0, 136.0, 5.0))  # directions of a section, away from the track bed
AROUND = 0.25  # m to either side of a section, in which points are counted by station


def solutions(stations: dict[str, Station], reach: float = 10.0, wall: float = 2.7) -> pd.DataFrame:
    """The printed model, the closed form and the weighted adjustment of every station.

    Columns: ``printed_less_svd``, the largest difference between the model with thirteen parameters
    and the singular value decomposition in R, μ and (in m) the image of the targets' centroid;
    ``adjusted_less_svd``, the same between the weighted adjustment and the decomposition with μ =
    1; ``scale_printed_ppm`` and ``scale_adjusted_ppm``, what they find for μ − 1;
    ``scale_moves_mm``, the largest shift at ``wall`` m from the axis, ``reach`` m from the station,
    by the printed model's free scale.
    """
    rows = []
    for name, station in stations.items():
        x, X = station.source, station.target
        printed, (mu, R, t) = thirteen_parameters(x, X), umeyama(x, X)
        _, R_1, t_1 = umeyama(x, X, scale=False)
        adjusted = fit_similarity(x, X, scale=False, **ABSOLUTE)
        middle = x.mean(axis=0)
        far = np.concatenate([_ring(wall, along) for along in (-reach, reach)])
        moved = (t + mu * far @ R.T) - (t_1 + far @ R_1.T)
        rows.append(
            {
                "station": name,
                "printed_less_svd": _largest(
                    printed.scale - mu,
                    printed.rotation - R,
                    (printed.scale * printed.rotation - mu * R) @ middle + printed.translation - t,
                ),
                "adjusted_less_svd": _largest(
                    adjusted.rotation - R_1, adjusted.transform(middle) - t_1 - R_1 @ middle
                ),
                "scale_printed_ppm": 1e6 * (float(mu) - 1.0),
                "scale_adjusted_ppm": 1e6 * (float(station.free_scale.scale) - 1.0),
                "scale_moves_mm": 1e3 * np.linalg.norm(moved, axis=-1).max(),
            }
        )
    return pd.DataFrame(rows)


def _largest(*differences) -> float:
    return float(max(np.abs(difference).max() for difference in differences))


def _ring(wall: float, along: float) -> np.ndarray:
    """Points (n, 3) on the wall around an instrument's Y axis, ``along`` m from it."""
    return np.stack([wall * np.sin(RING), np.full(len(RING), along), wall * np.cos(RING)], axis=-1)


def true_errors(
    stations: dict[str, Station], epoch: Epoch, tunnel: Tunnel, reach: float = 10.0
) -> pd.DataFrame:
    """Errors of the registrations against the true poses, beside what they state.

    Columns: ``position_mm`` and ``position_sd_mm`` at the targets' centroid; ``rotation_arcsec``
    and ``rotation_sd_arcsec``, of the whole rotation; ``wall_mm`` and ``wall_sd_mm``, root mean
    square of the radial error over the sections ``reach`` m before and behind the station;
    ``chi_squared`` of the six errors with the stated covariance, 6 expected, and its
    ``probability``.
    """
    rows = []
    for name, station in zip(station_names(epoch), epoch.stations, strict=True):
        fit, pose = stations[name].similarity, station.pose
        covariance = fit.central_cofactor[:6, :6]
        turn = Rotation.from_matrix(pose.rotation @ fit.rotation.T).as_rotvec()
        errors = np.append(pose.to_engineering(fit.centre) - fit.image, turn)
        square = float(errors @ np.linalg.solve(covariance, errors))
        points, normals = _sections(
            tunnel, tunnel.alignment.section_coordinates(pose.position)[0], reach
        )
        seen = pose.to_instrument(points)
        radial = np.sum(normals * (fit.transform(seen) - points), axis=-1)
        rows.append(
            {
                "station": name,
                "position_mm": 1e3 * np.linalg.norm(errors[:3]),
                "position_sd_mm": 1e3 * np.sqrt(np.trace(covariance[:3, :3])),
                "rotation_arcsec": ARCSECONDS * np.linalg.norm(turn),
                "rotation_sd_arcsec": ARCSECONDS * np.sqrt(np.trace(covariance[3:, 3:])),
                "wall_mm": 1e3 * np.sqrt(np.mean(radial**2)),
                "wall_sd_mm": 1e3
                * np.sqrt(np.mean(np.sum(section_errors(fit, seen, normals) ** 2, axis=-1))),
                "chi_squared": square,
                "probability": float(chi2.sf(square, 6)),
            }
        )
    return pd.DataFrame(rows)


def _sections(tunnel: Tunnel, chainage: float, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Points of the lining and normals (n, 3) of the sections ``reach`` m before and behind a
    chainage.
    """
    s, alpha = (
        grid.ravel()
        for grid in np.meshgrid(chainage + np.array([-reach, reach]), RING, indexing="ij")
    )
    points = tunnel.alignment.polar_points(s, alpha, tunnel.lining.radius)
    return points, (points - tunnel.alignment.position(s)) / tunnel.lining.radius


def repeated(setup: Setup, trials: int, seed: int, *, robust: bool = True) -> pd.DataFrame:
    """Stated standard deviations of one station against those over ``trials`` new sets of errors of
    its targets and of the net.

    Columns: ``quantity``, position of the targets' centroid (mm) and rotations (″) about the axes;
    ``stated``, root mean square over the trials; ``observed``; ``ratio_percent``, observed over
    stated less 100, known to 100/√(2n) percent from n trials; ``converged_percent`` of the trials,
    which all count.
    """
    generator = np.random.default_rng(seed)
    true = setup.targets.true
    at = setup.pose.to_instrument(true)
    middle = at.mean(axis=0)
    scanned = at + TARGET_SD * generator.standard_normal((trials, *at.shape))
    control = true + NET_SD * generator.standard_normal((trials, *at.shape))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # the table says how many
        fits = fit_similarity(scanned, control, scale=False, robust=robust, **ABSOLUTE)
    position = fits.transform(middle[None])[:, 0] - setup.pose.to_engineering(middle)
    turns = Rotation.from_matrix(setup.pose.rotation @ fits.rotation.swapaxes(-1, -2)).as_rotvec()
    variances = np.concatenate(
        [
            1e6 * np.diagonal(fits.transformed_covariance(middle[None])[:, 0], axis1=-2, axis2=-1),
            ARCSECONDS**2 * np.diagonal(fits.central_cofactor, axis1=-2, axis2=-1)[:, 3:6],
        ],
        axis=-1,
    )
    stated = np.sqrt(variances.mean(axis=0))
    observed = np.sqrt(
        np.mean(np.concatenate([1e3 * position, ARCSECONDS * turns], axis=-1) ** 2, axis=0)
    )
    names = [f"{what} {axis}" for what in ("position", "rotation") for axis in "xyz"]
    table = pd.DataFrame(
        {
            "quantity": names,
            "stated": stated,
            "observed": observed,
            "ratio_percent": 100.0 * (observed / stated - 1.0),
        }
    )
    return table.assign(converged_percent=100.0 * fits.converged.mean())


# ---------------------------------------------------------------------------------- wrong pairs


def mistaken(observed: pd.DataFrame, station: str, target: str, taken_for: str) -> pd.DataFrame:
    """The observations with one target of one station under another's name."""
    wrong = (observed["station"] == station) & (observed["target"] == target)
    if not wrong.any():
        raise ValueError(f"target: expected one that station {station} has observed, got {target}")
    return observed.assign(target=observed["target"].mask(wrong, taken_for))


def wrong_pairs(*epochs: Epoch) -> pd.DataFrame:
    """Every target of every station in turn taken for the nearest control point that its station
    does not use.

    Columns: ``station``, ``targets``, ``target``, ``taken_for``, ``apart_m``; ``named``, the robust
    adjustment leaves out this pair and no other; ``moved_mm`` and ``moved_by_least_squares_mm``,
    what the mistake does to the image of the instrument by the robust and by plain adjustment,
    compared with that of the right pairs; ``largest_by_least_squares``, whether the wrong pair has
    the largest misclosure of the plain adjustment, and ``least_by_least_squares_mm``, the smallest
    misclosure there.
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
                wrong = mistaken(pairs, station, target, other)
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


def wrong_pair_summary(found: pd.DataFrame) -> pd.DataFrame:
    """By the number of a station's targets: mistakes tried, ``named_percent``, and the shifts of
    the instrument that they do, mm.

    Of the plain adjustment ``smallest_misclosure_mm``, of any target in any trial, and
    ``largest_misclosure_percent``, how often the wrong pair has the largest.
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


# ---------------------------------------------------------------------------------- both epochs


def parameter_errors(block: Block, epochs: tuple[Epoch, ...]) -> np.ndarray:
    """Errors (6K,) of (image, ω) of the stations against their true poses, in the order of the
    block's covariance; m and rad.
    """
    errors = []
    for station, scan in zip(
        block.stations.values(), [scan for epoch in epochs for scan in epoch.stations], strict=True
    ):
        fit, pose = station.similarity, scan.pose
        turn = Rotation.from_matrix(fit.rotation @ pose.rotation.T).as_rotvec()
        errors += [fit.image - pose.to_engineering(fit.centre), turn]
    return np.concatenate(errors)


def between_epochs(
    blocks: Mapping[str, Block],
    clouds: tuple[Cloud, Cloud],
    epochs: tuple[Epoch, Epoch],
    tunnel: Tunnel,
) -> pd.DataFrame:
    """Shift of the second epoch against the first that registration makes in each section, stated
    and true.

    blocks : words -> stations registered in some way; clouds : points of the lining. A section has
        the shift of its stations, by how
    many of its points each has seen (within 0.25 m).

    Columns: ``registration`` (words), ``chainage_m``; ``right_mm``, ``right_sd_mm``, ``up_mm``,
    ``up_sd_mm``, true shift and stated standard deviation; ``chi_squared`` of both with the stated
    covariance, 2 expected.
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


def between_summary(table: pd.DataFrame, flagged=FLAGGED_SECTIONS) -> pd.DataFrame:
    """Root mean squares of :func:`between_epochs` over all sections and over those ``flagged``
    (chainages, m).

    Columns: ``registration``, ``sections``; ``right_mm``, ``right_sd_mm``, ``up_mm``, ``up_sd_mm``;
    mean ``chi_squared``.
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


def _shares(cloud: Cloud, near: np.ndarray, epoch: Epoch) -> np.ndarray:
    """Part of the points ``near`` that each station of the epoch has seen."""
    counts = np.bincount(cloud.stations[near], minlength=len(epoch.stations))
    return counts / counts.sum()
