"""Real scans of sphere targets: what every method, and what other libraries return, beside a
reference sphere.

The scans hold more than the sphere: a flat surface that stands beside it, and mixed pixels, whose
beam falls partly on the rim of the sphere and partly on what is behind. The reference is the centre
that the routine of the National Institute of Standards and Technology (NIST) for ASTM E3125 finds
with the radius held at its nominal value, and that radius. It is a reference and not the truth.

Source: NIST, repository usnistgov/DMG_SphereFitting; not subject to copyright in the United States.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial

import numpy as np
import pandas as pd

from analysis.methods import SPHERE_METHODS, fit_sphere
from analysis.reading import read_points
from analysis.result import ignore_convergence_warnings, rms
from analysis.surfaces.sphere import SphereFit

from ..paths import SCANS
from . import peers

NOMINAL_RADIUS = 0.05  # m, of all the targets
REFERENCE_CENTERS = {  # m
    "SPH101": (-5.895833, 3.628939, -1.561255),
    "SPH102": (-4.510108, -6.758343, -1.576506),
    "SPH103": (-3.508773, 5.865925, -1.570917),
    "SPH107": (-5.880140, 3.631157, 0.040103),
}
WHOLE = np.inf  # half-width of the cut that leaves a scan as it is


def read(scan: str) -> np.ndarray:
    """Points of a scan, (n, 3) in m, in the frame of the scanner.

    Raises ``ValueError`` for a scan without a reference and ``FileNotFoundError`` for one that was
    not fetched.
    """
    if scan not in REFERENCE_CENTERS:
        raise ValueError(f"scan: expected one of {', '.join(REFERENCE_CENTERS)}; got {scan!r}")
    path = SCANS / f"{scan}.xyz"
    if not path.is_file():
        raise FileNotFoundError(
            f"{path.name} is not in data/scans: `make scans` fetches the real scans."
        )
    return read_points(path)


def reference_distances(points: np.ndarray, scan: str) -> np.ndarray:
    """Distances (n,) of points from the reference sphere of a scan, m, positive outside."""
    return np.linalg.norm(points - REFERENCE_CENTERS[scan], axis=-1) - NOMINAL_RADIUS


def cut(points: np.ndarray, scan: str, half_width: float) -> np.ndarray:
    """The points no farther than ``half_width`` (m) from the reference sphere.

    An idealised trimming: it knows the answer. Who trims by hand or by another fit does worse.
    """
    return points[np.abs(reference_distances(points, scan)) <= half_width]


def contents(scans: Iterable[str], half_width: float) -> pd.DataFrame:
    """Contents of each scan: points, those within ``half_width`` (m) of the reference sphere, and
    the distances of the others.

    The range is that of the reference centre from the scanner, which stands in the origin.
    """
    rows = []
    for scan in scans:
        d = reference_distances(read(scan), scan)
        on = np.abs(d) <= half_width
        rows.append(
            {
                "scan": scan,
                "range_m": np.linalg.norm(REFERENCE_CENTERS[scan]),
                "points": len(d),
                "on_sphere": np.count_nonzero(on),
                "off_sphere_percent": 100 * np.mean(~on),
                "rms_on_mm": 1e3 * rms(d[on]),
                "inside_percent": 100 * np.mean(d < -half_width),
                "farthest_mm": 1e3 * d.max(),
            }
        )
    return pd.DataFrame(rows)


def methods(scans: Iterable[str], half_widths: Iterable[float] = (WHOLE,)) -> pd.DataFrame:
    """Every sphere method on every scan, cut to every half-width (m) about the reference sphere:
    one row a fit.
    """
    rows = []
    for scan in scans:
        points = read(scan)
        for half_width in half_widths:
            part = cut(points, scan, half_width)
            rows += [
                {"half_width_mm": 1e3 * half_width, "method": name} | _row(_fit(part, name), scan)
                for name in SPHERE_METHODS
            ]
    return _scan_first(rows)


def scale_readings(scans: Iterable[str], scales: Iterable[str]) -> pd.DataFrame:
    """IGG III-WTLS on the whole scans with every reading of σ in V/σ, weights cumulative or not:
    one row a fit.
    """
    rows = []
    for scan in scans:
        points = read(scan)
        for scale in scales:
            for cumulative in (True, False):
                fit = _fit(points, "igg3_wtls", scale=scale, cumulative=cumulative)
                rows.append({"scale": scale, "cumulative": cumulative} | _row(fit, scan))
    return _scan_first(rows)


def robust_fits(scans: Iterable[str], offset: Iterable[float]) -> pd.DataFrame:
    """``robust`` on the whole scans: radius free and held, coordinates as they are and with
    ``offset`` (m) added. One row a fit.

    Columns: radius, offset, scan; ``center_error_mm`` and ``radius_error_mm`` from the reference;
    ``sd_center_mm`` as the fit states it; ``in_use``, points.
    """
    rows = []
    for radius, options in (("free", {}), ("held", {"radius": NOMINAL_RADIUS})):
        for added, shift in (("no", np.zeros(3)), ("yes", np.array(offset, dtype=float))):
            for scan in scans:
                fit = _fit(read(scan) + shift, "robust", **options)
                error = fit.center - shift - REFERENCE_CENTERS[scan]
                row = {
                    "radius": radius,
                    "offset": added,
                    "scan": scan,
                    "center_error_mm": 1e3 * np.linalg.norm(error),
                }
                row["radius_error_mm"] = 1e3 * (fit.radius - NOMINAL_RADIUS)
                row["sd_center_mm"] = 1e3 * np.linalg.norm(fit.standard_deviations[:3])
                rows.append(row | {"in_use": np.count_nonzero(fit.inliers)})
    return pd.DataFrame(rows)


def over_the_scans(table: pd.DataFrame) -> pd.DataFrame:
    """Errors of a table of :func:`robust_fits` over the scans, one row per radius and offset.

    Median and largest error of centre and radius in mm, and the RMS over the scans of the error of
    the centre over its stated standard deviation, which would be near 1.
    """
    rows = []
    for (radius, offset), fits in table.groupby(["radius", "offset"], sort=False):
        row = {"radius": radius, "offset": offset}
        for quantity in ("center", "radius"):
            errors = fits[f"{quantity}_error_mm"].abs()
            row |= {f"{quantity}, median": errors.median(), f"{quantity}, largest": errors.max()}
        ratio = fits["center_error_mm"] / fits["sd_center_mm"]
        rows.append(row | {"error/stated": np.sqrt(np.mean(ratio**2))})
    return pd.DataFrame(rows)


def peer_fits(scans: Iterable[str], told: float) -> pd.DataFrame:
    """Other libraries on the whole scans: errors from the reference, one row a fit.

    ``told``: the scale that the robust losses are told, m; each is run without, too.
    """
    fits = {peers.LIBRARY: peers.best_fit}
    for loss in peers.LOSSES:
        fits[f"scipy {loss}"] = partial(peers.robust_loss, loss=loss)
        fits[f"scipy {loss}, told {1e3 * told:g} mm"] = partial(
            peers.robust_loss, loss=loss, scale=told
        )
    rows = []
    for name, fit in fits.items():
        for scan in scans:
            sphere = fit(read(scan))
            errors = (
                1e3 * np.linalg.norm(sphere[:3] - REFERENCE_CENTERS[scan]),
                1e3 * (sphere[3] - NOMINAL_RADIUS),
            )
            rows.append(
                {"scan": scan, "method": name}
                | dict(zip(("center_error_mm", "radius_error_mm"), errors, strict=True))
            )
    return pd.DataFrame(rows)


def summary(whole_scans: pd.DataFrame, robust: pd.DataFrame, other: pd.DataFrame) -> pd.DataFrame:
    """Median and largest error from the reference over the whole scans in mm, one row per method:
    ours, then the peers.

    Parameters: the tables of :func:`methods`, :func:`robust_fits` and :func:`peer_fits`.
    """
    labels = {name: method.label for name, method in SPHERE_METHODS.items()}
    held = robust[(robust["radius"] == "held") & (robust["offset"] == "no")].assign(
        method="robust, radius held at 50 mm"
    )
    every = pd.concat([whole_scans.assign(method=whole_scans["method"].map(labels)), held, other])
    every["radius_error_mm"] = every["radius_error_mm"].abs()
    found = every.groupby("method", sort=False)[["center_error_mm", "radius_error_mm"]].agg(
        ["median", "max"]
    )
    found.columns = [
        "centre, median/mm",
        "centre, largest/mm",
        "radius, median/mm",
        "radius, largest/mm",
    ]
    return found.reset_index()


def masking(scans: Iterable[str], half_width: float, k0: float, k1: float) -> pd.DataFrame:
    """Why a scale from all points rejects so little: what IGG III would do at the LS start and at
    the reference sphere.

    σ is the RMS distance of all points, rejected ones included, from the sphere in question. Of the
    points off the sphere, those farther than ``half_width`` (m) from the reference sphere, some lie
    beyond ``k1·σ`` and are rejected; those within ``k0·σ`` keep their weight. The last columns are
    what the literal reading rejects in the end, in percent of the points off and on the sphere.
    """
    rows = []
    for scan in scans:
        points = read(scan)
        reference = reference_distances(points, scan)
        off = np.abs(reference) > half_width
        row = {"scan": scan}
        for place, distances in (("start", _fit(points, "ls").distances), ("reference", reference)):
            u = np.abs(distances[off]) / rms(distances)
            row[f"{place}_k1_sigma_mm"] = 1e3 * k1 * rms(distances)
            row[f"{place}_beyond_percent"] = 100 * np.mean(u > k1)
            row[f"{place}_kept_percent"] = 100 * np.mean(u < k0)
        rejected = ~_fit(points, "igg3_wtls", k0=k0, k1=k1).inliers
        rows.append(
            row
            | {
                "rejected_off_percent": 100 * np.mean(rejected[off]),
                "rejected_on_percent": 100 * np.mean(rejected[~off]),
            }
        )
    return pd.DataFrame(rows)


def ranges(table: pd.DataFrame) -> pd.DataFrame:
    """Smallest and largest over the scans, a row for each half-width and method.

    Errors of centre and radius in mm, and the centre error over the standard deviation that the fit
    states for the centre.
    """
    table = table.assign(error_over_sd=table["center_error_mm"] / table["sd_center_mm"])
    names = ["center_error_mm", "radius_error_mm", "error_over_sd"]
    found = table.groupby(["half_width_mm", "method"], sort=False)[names].agg(["min", "max"])
    found.columns = [f"{name}_{which}" for name, which in found.columns]
    return found.reset_index()


def by_scan(table: pd.DataFrame, keys: list[str], value: str) -> pd.DataFrame:
    """One value of a tidy table: a column per scan, a row per combination of ``keys``."""
    wide = table.pivot(index=keys, columns="scan", values=value)
    return (
        wide.reindex(table.set_index(keys).index.unique()).rename_axis(columns=None).reset_index()
    )


def section(scan: str, half_thickness: float, half_width: float) -> pd.DataFrame:
    """The points near the horizontal plane through the reference centre, seen from above.

    Columns along_mm and across_mm: coordinates from the reference centre along the horizontal line
    of sight, away from the scanner, and to the left of it; on_sphere: within ``half_width`` (m) of
    the reference sphere. ``half_thickness`` of the slice in m.
    """
    points = read(scan)
    D = points - REFERENCE_CENTERS[scan]
    near = np.abs(D[:, 2]) <= half_thickness
    along, across = 1e3 * _sight(scan) @ D[near, :2].T
    on = np.abs(reference_distances(points[near], scan)) <= half_width
    return pd.DataFrame({"along_mm": along, "across_mm": across, "on_sphere": on})


def section_circles(scan: str, half_width: float) -> pd.DataFrame:
    """The circle that each method's sphere, fitted to the scan cut to ``half_width``, makes in the
    plane of :func:`section`.
    """
    part = cut(read(scan), scan, half_width)
    rows = []
    for name in SPHERE_METHODS:
        fit = _fit(part, name)
        dx, dy, dz = fit.center - REFERENCE_CENTERS[scan]
        along, across = 1e3 * _sight(scan) @ (dx, dy)
        rows.append(
            {
                "method": name,
                "along_mm": along,
                "across_mm": across,
                "radius_mm": 1e3 * np.sqrt(fit.radius**2 - dz**2),
            }
        )
    return pd.DataFrame(rows)


def _sight(scan: str) -> np.ndarray:
    """(2, 2) horizontal unit vectors as rows: from the scanner to the sphere, and to the left of
    that.
    """
    x, y = np.array(REFERENCE_CENTERS[scan][:2]) / np.hypot(*REFERENCE_CENTERS[scan][:2])
    return np.array([[x, y], [-y, x]])


def _fit(points: np.ndarray, method: str, **options) -> SphereFit:
    """A fit whose failure is read from its row and not from a warning."""
    with ignore_convergence_warnings():
        return fit_sphere(points, method, **options)


def _row(fit: SphereFit, scan: str) -> dict:
    """Result of a fit and its difference from the reference; where it did not converge, only
    that, for it has no result.
    """
    return {
        "scan": scan,
        "points": len(fit.weights),
        "in_use": np.count_nonzero(fit.inliers),
        **(_lengths(fit, scan) if fit.converged else dict.fromkeys(LENGTHS, np.nan)),
        "downweighted": np.count_nonzero(fit.weights < 1),
        "iterations": int(fit.iterations) if fit.converged else pd.NA,
        "converged": bool(fit.converged),
        "stop_reason": fit.stop_reason,
    }


LENGTHS = (
    *("x_m", "y_m", "z_m", "r_m", "sd_x_mm", "sd_y_mm", "sd_z_mm", "sd_r_mm", "sd_center_mm"),
    *("sigma_0", "sigma_s_mm", "sigma_s_in_use_mm", "center_error_mm", "radius_error_mm"),
)


def _lengths(fit: SphereFit, scan: str) -> dict:
    deviations = 1e3 * fit.standard_deviations
    values = (
        *(*fit.parameters, *deviations, np.linalg.norm(deviations[:3])),
        *(fit.sigma_0, 1e3 * fit.sigma_s, 1e3 * fit.sigma_s_inliers),
        *(
            1e3 * np.linalg.norm(fit.center - REFERENCE_CENTERS[scan]),
            1e3 * (fit.radius - NOMINAL_RADIUS),
        ),
    )
    return dict(zip(LENGTHS, values, strict=True))


def _scan_first(rows: list[dict]) -> pd.DataFrame:
    frame = pd.DataFrame(rows).astype({"iterations": "Int64"})
    return frame[["scan", *frame.columns.drop("scan")]]
