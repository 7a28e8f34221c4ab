"""Real scans of sphere targets: what every method returns, beside a reference sphere.

The scans hold more than the sphere: a flat surface that stands beside it, and mixed pixels, whose beam
falls partly on the rim of the sphere and partly on what is behind. The reference is the centre that the
routine of the National Institute of Standards and Technology (NIST) for ASTM E3125 finds with the
radius held at its nominal value, and that radius. It is a reference and not the truth.

Source: NIST, repository usnistgov/DMG_SphereFitting; not subject to copyright in the United States.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable

import numpy as np
import pandas as pd

from .accuracy import rms
from .fit import ConvergenceWarning
from .methods import SPHERE_METHODS, fit_sphere
from .paths import SCANS
from .points import read_points
from .published import printed_numbers
from .sphere import SphereFit

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

    Raises ``ValueError`` for a scan without a reference and ``FileNotFoundError`` for one that was not fetched.
    """
    if scan not in REFERENCE_CENTERS:
        raise ValueError(f"scan: expected one of {', '.join(REFERENCE_CENTERS)}; got {scan!r}")
    path = SCANS / f"{scan}.xyz"
    if not path.is_file():
        raise FileNotFoundError(f"{path.name} is not in data/scans: `make scans` fetches the real scans.")
    return read_points(path)


def reference_distances(points: np.ndarray, scan: str) -> np.ndarray:
    """Signed distances (n,) of points from the reference sphere of a scan in m, positive outside."""
    return np.linalg.norm(points - REFERENCE_CENTERS[scan], axis=-1) - NOMINAL_RADIUS


def cut(points: np.ndarray, scan: str, half_width: float) -> np.ndarray:
    """The points no farther than ``half_width`` (m) from the reference sphere.

    An idealised trimming: it knows the answer. Who trims by hand or by another fit does worse.
    """
    return points[np.abs(reference_distances(points, scan)) <= half_width]


def contents(scans: Iterable[str], half_width: float) -> pd.DataFrame:
    """What each scan holds: points, those within ``half_width`` (m) of the reference sphere, and the distances of the others.

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
    """Every sphere method on every scan, cut to every half-width (m) about the reference sphere: one row a fit."""
    rows = []
    for scan in scans:
        points = read(scan)
        for half_width in half_widths:
            part = cut(points, scan, half_width)
            rows += [{"half_width_mm": 1e3 * half_width, "method": name} | _row(_fit(part, name), scan) for name in SPHERE_METHODS]
    return _scan_first(rows)


def scale_readings(scans: Iterable[str], scales: Iterable[str]) -> pd.DataFrame:
    """IGG III-WTLS on the whole scans with every reading of σ in V/σ, weights cumulative or not: one row a fit."""
    rows = []
    for scan in scans:
        points = read(scan)
        for scale in scales:
            for cumulative in (True, False):
                fit = _fit(points, "igg3_wtls", scale=scale, cumulative=cumulative)
                rows.append({"scale": scale, "cumulative": cumulative} | _row(fit, scan))
    return _scan_first(rows)


def thinned(scans: Iterable[str], scales: Iterable[str], shares: Iterable[float], half_width: float, seed: int) -> pd.DataFrame:
    """The readings of :func:`scale_readings` on scans of which part of the sphere is left out: one row a fit.

    Of the points within ``half_width`` (m) of the reference sphere as many are drawn as make the others the
    given share of all; a smaller share draws all that a larger one draws. A share that the whole scan exceeds is left out.
    """
    rows = []
    for scan in scans:
        points = read(scan)
        off = np.abs(reference_distances(points, scan)) > half_width
        order = np.random.default_rng(seed).permutation(np.flatnonzero(~off))
        for share in shares:
            count = round(np.count_nonzero(off) * (1 - share) / share)
            if count > len(order):
                continue
            part = np.concatenate([points[off], points[order[:count]]])
            for scale in scales:
                for cumulative in (True, False):
                    row = _row(_fit(part, "igg3_wtls", scale=scale, cumulative=cumulative), scan)
                    rows.append({"off_sphere_percent": 100 * share, "scale": scale, "cumulative": cumulative} | row)
    return _scan_first(rows)


def found(table: pd.DataFrame, within_mm: float) -> pd.DataFrame:
    """In how many scans of a table of :func:`thinned` the centre is within ``within_mm`` of the reference; a column a share in percent."""
    keys = ["scale", "cumulative"]
    counts = (table["center_error_mm"] < within_mm).groupby([table["off_sphere_percent"], *(table[key] for key in keys)], sort=False).sum()
    wide = counts.unstack("off_sphere_percent").reindex(table.set_index(keys).index.unique())
    return wide.rename(columns="{:g} %".format).rename_axis(columns=None).reset_index()


def masking(scans: Iterable[str], half_width: float, k0: float, k1: float) -> pd.DataFrame:
    """Why a scale from all points rejects so little: what IGG III would do at the LS start and at the reference sphere.

    σ is the RMS distance of all points, rejected ones included, from the sphere in question. Of the points off
    the sphere, those farther than ``half_width`` (m) from the reference sphere, some lie beyond ``k1·σ`` and are
    rejected; those within ``k0·σ`` keep their weight. The last columns are what the literal reading rejects in
    the end, in percent of the points off and on the sphere.
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
        rows.append(row | {"rejected_off_percent": 100 * np.mean(rejected[off]), "rejected_on_percent": 100 * np.mean(rejected[~off])})
    return pd.DataFrame(rows)


def ranges(table: pd.DataFrame) -> pd.DataFrame:
    """Smallest and largest over the scans, a row for each half-width and method.

    Errors of centre and radius in mm, and the centre error over the standard deviation that the fit states for the centre.
    """
    table = table.assign(error_over_sd=table["center_error_mm"] / table["sd_center_mm"])
    names = ["center_error_mm", "radius_error_mm", "error_over_sd"]
    found = table.groupby(["half_width_mm", "method"], sort=False)[names].agg(["min", "max"])
    found.columns = [f"{name}_{which}" for name, which in found.columns]
    return found.reset_index()


def by_scan(table: pd.DataFrame, keys: list[str], value: str) -> pd.DataFrame:
    """One value of a tidy table with a column a scan and a row for each combination of ``keys``, in their order in the table."""
    wide = table.pivot(index=keys, columns="scan", values=value)
    return wide.reindex(table.set_index(keys).index.unique()).rename_axis(columns=None).reset_index()


def differences(table: pd.DataFrame, method: str = "ls") -> pd.DataFrame:
    """Centre and radius of every other method less those of one method in mm, of a table of :func:`methods`.

    ``largest_mm`` is the largest of the four without its sign.
    """
    values = table.set_index(["scan", "half_width_mm", "method"])[["x_m", "y_m", "z_m", "r_m"]]
    base = values.xs(method, level="method").reindex(values.index.droplevel("method"))
    found = pd.DataFrame(1e3 * (values.to_numpy() - base.to_numpy()), values.index, ["dx_mm", "dy_mm", "dz_mm", "dr_mm"])
    found["largest_mm"] = found.abs().max(axis=1)
    found = found.reset_index()
    return found[found["method"] != method].reset_index(drop=True)


def printed_differences() -> pd.DataFrame:
    """The same differences from LS in table 3 of Ou & Liu (2017), printed to 0.1 mm, and the printed σs of both methods."""
    printed = pd.DataFrame(
        [{"sample": number.sample, "method": number.method, number.quantity: number.value} for number in printed_numbers(3)]
    )
    printed = printed.groupby(["sample", "method"], sort=False).first()
    rows = []
    for (sample, method), row in printed.iterrows():
        if method != "ls":
            ls = printed.loc[(sample, "ls")]
            moved = 1e3 * (row - ls)[["a_m", "b_m", "c_m", "r_m"]]
            rows.append(
                {
                    "sphere": sample,
                    "method": method,
                    **dict(zip(("dx_mm", "dy_mm", "dz_mm", "dr_mm"), moved, strict=True)),
                    "sigma_s_mm": 1e3 * row["sigma_s_m"],
                    "sigma_s_ls_mm": 1e3 * ls["sigma_s_m"],
                }
            )
    return pd.DataFrame(rows)


def section(scan: str, half_thickness: float, half_width: float) -> pd.DataFrame:
    """The points near the horizontal plane through the reference centre, seen from above.

    Columns along_mm and across_mm: coordinates from the reference centre along the horizontal line of sight,
    away from the scanner, and to the left of it; on_sphere: within ``half_width`` (m) of the reference sphere.
    ``half_thickness`` of the slice in m.
    """
    points = read(scan)
    D = points - REFERENCE_CENTERS[scan]
    near = np.abs(D[:, 2]) <= half_thickness
    along, across = 1e3 * _sight(scan) @ D[near, :2].T
    on = np.abs(reference_distances(points[near], scan)) <= half_width
    return pd.DataFrame({"along_mm": along, "across_mm": across, "on_sphere": on})


def section_circles(scan: str, half_width: float) -> pd.DataFrame:
    """The circle that each method's sphere, fitted to the scan cut to ``half_width``, makes in the plane of :func:`section`."""
    part = cut(read(scan), scan, half_width)
    rows = []
    for name in SPHERE_METHODS:
        fit = _fit(part, name)
        dx, dy, dz = fit.center - REFERENCE_CENTERS[scan]
        along, across = 1e3 * _sight(scan) @ (dx, dy)
        rows.append({"method": name, "along_mm": along, "across_mm": across, "radius_mm": 1e3 * np.sqrt(fit.radius**2 - dz**2)})
    return pd.DataFrame(rows)


def _sight(scan: str) -> np.ndarray:
    """(2, 2) horizontal unit vectors as rows: from the scanner to the sphere, and to the left of that."""
    x, y = np.array(REFERENCE_CENTERS[scan][:2]) / np.hypot(*REFERENCE_CENTERS[scan][:2])
    return np.array([[x, y], [-y, x]])


def _fit(points: np.ndarray, method: str, **options) -> SphereFit:
    """A fit whose failure is read from its row and not from a warning."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        return fit_sphere(points, method, **options)


def _row(fit: SphereFit, scan: str) -> dict:
    """What a fit returns and its difference from the reference; where it did not converge, only that, for it has no result."""
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
        *(1e3 * np.linalg.norm(fit.center - REFERENCE_CENTERS[scan]), 1e3 * (fit.radius - NOMINAL_RADIUS)),
    )
    return dict(zip(LENGTHS, values, strict=True))


def _scan_first(rows: list[dict]) -> pd.DataFrame:
    frame = pd.DataFrame(rows).astype({"iterations": "Int64"})
    return frame[["scan", *frame.columns.drop("scan")]]
