"""Accuracy of the registration of simulated stations: three solutions, true errors, repetition,
and joints between neighbours.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from analysis.result import ignore_convergence_warnings
from analysis.similarity import fit_similarity, umeyama
from analysis.tunnel.registration import ARCSECONDS, Station

from ..simulation.tunnel import Epoch, Setup, Tunnel
from ..simulation.tunnel.campaign import NET_SD, TARGET_SD
from .register_campaign import station_names
from .thirteen_parameters import thirteen_parameters

ABSOLUTE = {"source_cofactors": TARGET_SD**2, "target_cofactors": NET_SD**2, "absolute": True}
RING = np.radians(np.arange(-135.0, 136.0, 5.0))  # directions of a section, away from the track bed
JOINT_MM = 2.0  # registration error between stations, as Li et al. (2015) print it


def solutions(stations: dict[str, Station], reach: float = 10.0, wall: float = 2.7) -> pd.DataFrame:
    """Compare the printed model, the closed form and the weighted adjustment of every station.

    Parameters
    ----------
    stations : the registered stations.
    reach, wall : m along and from the axis, of the points that the free scale moves.

    Returns
    -------
    DataFrame, a row per station:

    * ``printed_less_svd``, largest difference between the model with thirteen parameters and the
      singular value decomposition in R, μ and (in m) the image of the targets' centroid;
    * ``adjusted_less_svd``, between the weighted adjustment and the decomposition with μ = 1;
    * ``scale_printed_ppm``, ``scale_adjusted_ppm``, estimates of μ − 1;
    * ``scale_moves_mm``, the largest shift of the wall by the printed model's free scale.
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
    """Points (n, 3) on a wall of radius ``wall`` around the Y axis, at y = ``along``, m."""
    return np.stack([wall * np.sin(RING), np.full(len(RING), along), wall * np.cos(RING)], axis=-1)


def true_errors(
    stations: dict[str, Station], epoch: Epoch, tunnel: Tunnel, reach: float = 10.0
) -> pd.DataFrame:
    """Errors of the registrations against the true poses, beside the stated ones.

    Parameters
    ----------
    stations : the registered stations of the epoch.
    reach : m, from a station to the sections before and behind it on whose wall errors count.

    Returns
    -------
    DataFrame, a row per station:

    * ``position_mm``, ``position_sd_mm`` at the targets' centroid;
    * ``rotation_arcsec``, ``rotation_sd_arcsec``, of the whole rotation;
    * ``wall_mm``, ``wall_sd_mm``, root mean square of the radial error over the sections;
    * ``chi_squared`` of the six errors with the stated covariance (6 expected), ``probability``.
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
        stated = np.einsum("ni,nik->nk", normals, fit.common_errors(seen))
        rows.append(
            {
                "station": name,
                "position_mm": 1e3 * np.linalg.norm(errors[:3]),
                "position_sd_mm": 1e3 * np.sqrt(np.trace(covariance[:3, :3])),
                "rotation_arcsec": ARCSECONDS * np.linalg.norm(turn),
                "rotation_sd_arcsec": ARCSECONDS * np.sqrt(np.trace(covariance[3:, 3:])),
                "wall_mm": 1e3 * np.sqrt(np.mean(radial**2)),
                "wall_sd_mm": 1e3 * np.sqrt(np.mean(np.sum(stated**2, axis=-1))),
                "chi_squared": square,
                "probability": float(chi2.sf(square, 6)),
            }
        )
    return pd.DataFrame(rows)


def _sections(tunnel: Tunnel, chainage: float, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Points and normals (n, 3) of the lining ``reach`` m before and behind a chainage."""
    s, alpha = (
        grid.ravel()
        for grid in np.meshgrid(chainage + np.array([-reach, reach]), RING, indexing="ij")
    )
    points = tunnel.alignment.polar_points(s, alpha, tunnel.lining.radius)
    return points, (points - tunnel.alignment.position(s)) / tunnel.lining.radius


def repetition(setup: Setup, trials: int, seed: int, *, robust: bool = True) -> pd.DataFrame:
    """Stated standard deviations of one station beside those observed in repeated measurements.

    Parameters
    ----------
    setup : the station with its targets.
    trials, seed : new sets of errors of the targets and of the net.
    robust : as of :func:`analysis.fit_similarity`.

    Returns
    -------
    DataFrame, a row per quantity: position of the targets' centroid (mm), rotations about the
    axes (″).

    * ``stated``, root mean square over the trials; ``observed``;
    * ``ratio_percent``, observed over stated less 100, known to 100/√(2 trials) percent;
    * ``converged_percent`` of the trials. All trials count.
    """
    generator = np.random.default_rng(seed)
    true = setup.targets.true
    at = setup.pose.to_instrument(true)
    middle = at.mean(axis=0)
    scanned = at + TARGET_SD * generator.standard_normal((trials, *at.shape))
    control = true + NET_SD * generator.standard_normal((trials, *at.shape))
    with ignore_convergence_warnings():  # the table says how many
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


def joints(epoch: Epoch, stations: dict[str, Station], tunnel: Tunnel) -> pd.DataFrame:
    """Distances at which neighbouring stations put the same wall, half way between them.

    The points have no noise; the registrations alone differ.

    Returns
    -------
    DataFrame, a row per pair of neighbours: ``stations``, ``chainage_m``;

    * ``shift_x_mm``, ``shift_y_mm``, ``shift_z_mm``, mean over the section;
    * ``rms_mm``, distance of a point, and ``stated_mm``, the root mean square that the covariances
      of both stations give for it;
    * ``within_percent`` of the points no farther apart than 2 mm in any coordinate.
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
