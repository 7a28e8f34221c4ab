"""Registration of scanner stations by targets: seven parameters per station, and their errors.

The targets seen from a station are known in its own frame from the scan and in the project's from
the control net. All points of a station share the error of its registration, so it does not average
out over the points of a section (Winiwarter et al. 2021 for two-epoch comparison): the spread of
the targets decides. Frame of the tunnel (Li et al. 2015): y along it, z up, x to the right.

References
----------
Winiwarter, Anders & Höfle (2021), ISPRS Journal of Photogrammetry and Remote Sensing 178, 240-258.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.spatial.distance import pdist
from scipy.stats import chi2

from ..checks import check_positive, finite_array
from ..similarity import Similarity, fit_similarity, umeyama
from ..similarity.pairs import SMALLEST

OBSERVED = ["station", "target", "x", "y", "z"]
CONTROL = ["target", "x", "y", "z"]
FACTOR = 2.0  # by which distances in the two frames may differ before their units must differ
# misclosures of the mirrored targets, relative to those of the targets as they are, below which
# axes are swapped
MIRRORED = 0.1
# m; targets that misfit less than this are as good as in a plane, and a plane is its own mirror
# image
VISIBLE = 0.01
SCALE_LIMIT = 2.0  # standard deviations of the scale from 1
ERROR = 0.01  # probability with which a right registration fails the test of its misclosures
WALL = 2.7  # m, of the lining from the axis of a rotation
WALL_LIMIT = 0.002  # m, largest standard deviation there of a rotation that needs no warning
ARCSECONDS = np.degrees(1.0) * 3600.0


@dataclass(frozen=True, eq=False)
class Station:
    """A registered station: its targets' names, its transformation, and the same with a free scale.

    source, target : (n, 3) coordinates of the targets in the frame of the station and of the
        project, m
    """

    name: str
    targets: tuple[str, ...]
    source: np.ndarray
    target: np.ndarray
    similarity: Similarity
    free_scale: Similarity

    @property
    def rejected(self) -> tuple[str, ...]:
        """Names of the targets that the robust adjustment leaves out."""
        return tuple(
            name
            for name, used in zip(self.targets, self.similarity.inliers, strict=True)
            if not used
        )


def register_stations(
    observed: pd.DataFrame,
    control: pd.DataFrame,
    *,
    scanner_sd: float,
    control_sd: float,
    scale: bool = False,
) -> dict[str, Station]:
    """Register every station to the control net, robustly where it has at least four targets.

    Parameters
    ----------
    observed : columns station, target, x, y, z; targets in the frame of each station, m.
    control : columns target, x, y, z; targets in the frame of the project, m.
    scanner_sd, control_sd : standard deviation of a coordinate of a target in each, m. They are
        taken as known: a handful of targets says little about its own precision. :func:`checks`
        tests them.
    scale : True estimates a scale per station. Scanner and total station both measure metres: leave
        it at 1 unless :func:`checks` says that it is not.

    Returns the stations by name, in the order of ``observed``. Targets that are not in the control
    net are left out. The control net's errors are common to stations that use the same targets; the
    covariances of the stations do not hold these common parts.

    Raises ``ValueError``, with the station's name, for missing columns, a target that occurs twice,
    fewer than three targets, targets on a line, other units (millimetres), and swapped axes
    (mirrored frames).

    >>> x, y, z = [0, 2, 0, 2.0], [0, 0, 9, 9.0], [0, 1, 1, 3.0]
    >>> control = pd.DataFrame({"target": list("abcd"), "x": x, "y": y, "z": z})
    >>> observed = control.assign(station="S1", y=control["y"] - 100)
    >>> stations = register_stations(observed, control, scanner_sd=0.002, control_sd=0.001)
    >>> stations["S1"].similarity.translation.round(9) + 0
    array([  0., 100.,   0.])
    """
    _require_rows(observed, OBSERVED, OBSERVED[:2], "observed")
    _require_rows(control, CONTROL, CONTROL[:1], "control")
    errors = {
        "source_cofactors": check_positive(scanner_sd, "scanner_sd") ** 2,
        "target_cofactors": check_positive(control_sd, "control_sd") ** 2,
        "absolute": True,
    }
    pairs = observed.merge(control, on="target", suffixes=("", "_control"))
    stations = {}
    for name in observed["station"].unique():
        mine = pairs[pairs["station"] == name]
        source = finite_array(mine[["x", "y", "z"]], f"station {name}")
        target = finite_array(
            mine[["x_control", "y_control", "z_control"]], f"station {name}, control"
        )
        stations[name] = _registered(
            str(name), tuple(mine["target"].astype(str)), source, target, errors, scale
        )
    return stations


def _registered(
    name: str,
    targets: tuple[str, ...],
    source: np.ndarray,
    target: np.ndarray,
    errors: dict,
    scale: bool,
) -> Station:
    try:
        if len(targets) < SMALLEST:
            raise ValueError(
                f"expected at least {SMALLEST} targets of the control net, got {len(targets)}"
            )
        _require_same_unit(source, target)
        _require_same_hand(source, target)
        robust = len(targets) > SMALLEST
        fits = {
            free: fit_similarity(source, target, scale=free, robust=robust, **errors)
            for free in (scale, True)
        }
    except ValueError as error:
        raise ValueError(f"station {name}: {error}") from None
    return Station(name, targets, source, target, fits[scale], fits[True])


def _require_rows(frame: pd.DataFrame, columns: list[str], key: list[str], name: str) -> None:
    """The columns must be there, and each target once."""
    if missing := [column for column in columns if column not in frame]:
        raise ValueError(
            f"{name}: expected columns {', '.join(columns)}; {', '.join(missing)} missing"
        )
    twice = frame[frame.duplicated(key)]
    if len(twice):
        found = " ".join(map(str, twice[key].iloc[0]))
        raise ValueError(f"{name}: expected each target once, got {found} twice")


def _require_same_unit(source: np.ndarray, target: np.ndarray) -> None:
    of_source, of_target = pdist(source), pdist(target)
    # The median, because a wrong pair spoils only its own distances.
    ratio = np.median(of_source / np.maximum(of_target, np.finfo(float).tiny))
    if not 1 / FACTOR < ratio < FACTOR:
        raise ValueError(
            "expected metres in both frames, got distances between its targets that are "
            f"{ratio:.4g} times those of the control net (millimetres? other targets?)"
        )


def _require_same_hand(source: np.ndarray, target: np.ndarray) -> None:
    as_is, mirrored = (_misclosure(source * sign, target) for sign in (1.0, [1.0, 1.0, -1.0]))
    if mirrored < MIRRORED * as_is and as_is > VISIBLE:
        raise ValueError(
            "expected right-handed frames, got targets that fit only mirrored, to "
            f"{mirrored:.4f} m against {as_is:.4f} m (two axes swapped?)"
        )


def _misclosure(source: np.ndarray, target: np.ndarray) -> float:
    """Root mean square misclosure of a coordinate after the best transformation with μ = 1, m."""
    _, R, t = umeyama(source, target, scale=False)
    return float(np.sqrt(np.mean((target - t - source @ R.T) ** 2)))


# ----------------------------------------------------------------------------- what came of it


def residual_table(stations: dict[str, Station]) -> pd.DataFrame:
    """Misclosures of all targets, control net less transformed.

    Columns: station, target, ``dx_mm dy_mm dz_mm d_mm``, ``weight``, ``in_use``.
    """
    parts = []
    for station in stations.values():
        r = 1e3 * station.similarity.residuals
        parts.append(
            pd.DataFrame(
                {
                    "station": station.name,
                    "target": station.targets,
                    **{f"d{axis}_mm": r[:, k] for k, axis in enumerate("xyz")},
                    "d_mm": np.linalg.norm(r, axis=-1),
                    "weight": station.similarity.weights,
                    "in_use": station.similarity.inliers,
                }
            )
        )
    return pd.concat(parts, ignore_index=True)


def _roll(station: Station) -> float:
    """Standard deviation of the rotation that is worst known, rad."""
    return float(np.sqrt(np.linalg.eigvalsh(station.similarity.central_cofactor[3:6, 3:6])[-1]))


def station_table(stations: dict[str, Station]) -> pd.DataFrame:
    """Accuracy of each station.

    Columns: ``station``, ``targets``, ``in_use``; ``sigma_0``, 1 where the standard deviations
    given are right; ``sd_position_mm`` at the centroid of the targets, root of the sum of the
    variances; ``rot_x_arcsec``, ``rot_y_arcsec``, ``rot_z_arcsec``, standard deviations of the
    rotations about the axes of the project; ``roll_arcsec``, that of the rotation that is worst
    known, and ``wall_mm``, what it does at 2.7 m from its axis; ``scale_ppm``,
    ``scale_sd_ppm`` and ``scale_test`` of the scale estimated freely: its distance from 1 and that
    in standard deviations.
    """
    rows = []
    for station in stations.values():
        variances = np.diagonal(station.similarity.central_cofactor)  # absolute
        roll, free = _roll(station), station.free_scale
        rows.append(
            {
                "station": station.name,
                "targets": len(station.targets),
                "in_use": int(np.count_nonzero(station.similarity.inliers)),
                "sigma_0": float(station.similarity.sigma_0),
                "sd_position_mm": 1e3 * np.sqrt(variances[:3].sum()),
                **{
                    f"rot_{axis}_arcsec": ARCSECONDS * np.sqrt(variance)
                    for axis, variance in zip("xyz", variances[3:6], strict=True)
                },
                "roll_arcsec": ARCSECONDS * roll,
                "wall_mm": 1e3 * WALL * roll,
                "scale_ppm": 1e6 * (float(free.scale) - 1.0),
                "scale_sd_ppm": 1e6 * np.sqrt(free.central_cofactor[6, 6]),
                "scale_test": float(free.scale_test),
            }
        )
    return pd.DataFrame(rows)


def checks(stations: dict[str, Station]) -> list[str]:
    """Warnings about a registration, one sentence each; none where all is well.

    Wrong targets by name; three targets, of which a wrong one cannot be told; misclosures larger
    than the standard deviations given allow (χ² test at 1 %); a scale that differs from 1 by more
    than two standard deviations; a rotation so weakly determined that it moves the wall, 2.7 m from
    its axis, by a standard deviation above 2 mm.
    """
    return [
        f"station {name}: {sentence}"
        for name, station in stations.items()
        for sentence in _sentences(station)
    ]


def _sentences(station: Station) -> Iterator[str]:
    fit, free, roll = station.similarity, station.free_scale, _roll(station)
    for target, r, used in zip(station.targets, fit.residuals, fit.inliers, strict=True):
        if not used:
            off = np.linalg.norm(r)
            yield f"target {target} does not fit the others, by {off:.4f} m; it is not used"
    if len(station.targets) == SMALLEST:
        yield "with three targets a wrong one cannot be found"
    if not fit.converged:
        yield str(fit.stop_reason)
    redundancy = int(fit.redundancy)
    if redundancy * fit.sigma_0**2 > chi2.isf(ERROR, redundancy):
        yield f"misclosures are {fit.sigma_0:.2f} times what the standard deviations given allow"
    if free.scale_test > SCALE_LIMIT:
        yield (
            f"its scale differs from 1 by {1e6 * (free.scale - 1):.0f} ppm, "
            f"{free.scale_test:.1f} standard deviations"
        )
    if roll * WALL > WALL_LIMIT:
        yield (
            f"its targets lie near a line; a rotation is known to {ARCSECONDS * roll:.0f} arc "
            f"seconds only, {1e3 * roll * WALL:.1f} mm at {WALL:g} m"
        )
