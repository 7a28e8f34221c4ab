"""A ground scan at grazing incidence, as the second example of the plane paper must have been.

Its points are not published, but the printed gains say where they lay. The orthogonal distances are
the same for all methods (the paper prints one σs for all), so the ratios of the σ0
(:mod:`studies.wu_chen_wang.errors`) depend on the geometry alone:

    σ0(WTLS)/σ0(LS) ≈ 1/√((1 + a² + b²) mean(1/cos θ))
    σ0(TLS)/σ0(LS)  = 1/√(1 + a² + b² + c²)  of TLS by pure SVD,    1/√(1 + a² + b²)  of mixed
                    LS-TLS

With mixed LS-TLS the slope alone has to account for the second, with pure SVD on level ground the
height |c| of the scanner does.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import chi2
from scipy.stats import f as fisher

from analysis.adjustment.linalg import solve
from analysis.methods import fit_plane
from analysis.result import ignore_convergence_warnings
from analysis.scanner import Scanner
from analysis.surfaces.plane import PARAMETERS, PlaneFit

from ..simulation.scenes import AngularGrid, Cylinder, Rectangle, Scan, Scene, Sphere, scan
from .simulation import NEWTON, printed

PRINTED = {
    "gain_vs_ls_percent": ("real_sigma0_gain_vs_LS", "σ0: WTLS below LS / %"),
    "gain_vs_tls_percent": ("real_sigma0_gain_vs_TLS", "σ0: WTLS below TLS / %"),
    "sigma_s_mm": ("real_sigma_s", "σs of all three / mm"),
}
# of the ground: it falls by 1 cm a metre across the line of sight and by half of that along it
SLOPES = (0.01, -0.005)
STONES = (
    (-0.25, 0.05, 0.06),
    (0.2, 0.2, 0.08),
    (-0.1, 0.4, 0.1),
    (0.3, 0.6, 0.12),
    (-0.35, 0.75, 0.12),
    (0.05, 0.9, 0.14),
)
# x in m, place between near and far end, radius in m: half of each stone shows
# What is compared: name -> method, options, whether it is given the scanner's cofactors, label.
COMPARED: dict[str, tuple[str, dict, bool, str]] = {
    "ls": ("ls", {}, False, "LS"),
    "tls": ("tls", {}, False, "TLS (pure SVD)"),
    "mixed_ls_tls": ("mixed_ls_tls", {}, False, "mixed LS-TLS"),
    "wtls": ("wtls", NEWTON, False, "WTLS, raw cosines"),
    "wtls, projected": (
        "wtls",
        NEWTON | {"cosine_at": "projected"},
        False,
        "WTLS, projected cosines",
    ),
    "eiv": ("eiv", {}, True, "EIV, scanner's cofactors"),
    "robust": ("robust", {}, True, "robust, scanner's cofactors"),
}


def implied() -> pd.DataFrame:
    """Place of the scan by the printed gains: by either reading of TLS, and with the limits that
    their rounding leaves.

    One row a quantity: ``reading``, ``quantity``, ``value``, ``lower``, ``upper``, ``unit``.

    >>> implied()[["quantity", "value"]].round(2).values.tolist()[:2]
    [['height of the scanner', 1.17], ['incidence angle', 86.7]]
    """
    values = printed(PRINTED).set_index("quantity")
    known = 1.0 - values[["printed"]].to_numpy()[:2] / 100.0
    half = values["half_unit"].to_numpy()[:2, None] / 100.0
    # σ0(WTLS)/σ0(LS) and σ0(WTLS)/σ0(TLS): as printed, and with both rounded either way.
    to_ls, to_tls = known + half * np.array([[0, -1, -1, 1, 1], [0, -1, 1, -1, 1]])
    squares = (to_tls / to_ls) ** 2 - 1.0  # a² + b² [+ c²]
    readings = {
        "level ground, TLS by pure SVD": {
            "height of the scanner": (np.sqrt(squares), "m"),
            "incidence angle": (np.degrees(np.arccos(to_ls**2)), "°"),
            "range": (np.sqrt(squares) / to_ls**2, "m"),
        },
        "mixed LS-TLS": {
            "slope of the ground": (np.degrees(np.arctan(np.sqrt(squares))), "°"),
            "incidence angle": (np.degrees(np.arccos(to_tls**2)), "°"),
        },
    }
    return pd.DataFrame(
        [
            {
                "reading": reading,
                "quantity": name,
                "value": found[0],
                "lower": found.min(),
                "upper": found.max(),
                "unit": unit,
            }
            for reading, quantities in readings.items()
            for name, (found, unit) in quantities.items()
        ]
    )


def ground_scan(
    generator: np.random.Generator,
    scanner: Scanner,
    *,
    height: float,
    near: float,
    far: float,
    width: float,
    step: float,
    clutter: bool,
) -> Scan:
    """Scan a strip of ground from a station in the origin.

    Parameters
    ----------
    generator : source of the noise; scanner : the instrument
    height : of the station over the ground, m; near, far : horizontal distances of the strip's
        ends, m; width : of the window, rad
    step : of the angular grid, rad
    clutter : whether stones and a post lie on the ground; their points, and mixed pixels, stay in
        the scan

    Returns the scan; labels ground, stone, post and mixed.
    """
    a, b = SLOPES

    def on_ground(x: float, y: float) -> NDArray[np.float64]:
        return np.array([x, y, a * x + b * y - height])

    right = np.array([1.0, 0.0, a])
    surfaces: list = [
        (
            "ground",
            Rectangle(on_ground(0.0, 0.0), 60.0 * right, 60.0 * np.cross([-a, -b, 1.0], right)),
        )
    ]
    if clutter:
        surfaces += [
            ("stone", Sphere(on_ground(x, near + share * (far - near)), radius))
            for x, share, radius in STONES
        ]
        foot = on_ground(0.35, 0.5 * (near + far))
        surfaces.append(("post", Cylinder(foot, foot + [0.0, 0.0, 0.5], 0.03)))
    lowest, highest = (np.arctan2(on_ground(0.0, y)[2], y) for y in (near, far))
    window = (0.5 * np.pi - 0.5 * width, 0.5 * np.pi + 0.5 * width), (lowest, highest)
    return scan(Scene(surfaces), AngularGrid(*window, step), scanner, generator)


def truth(height: float) -> NDArray[np.float64]:
    """(3,) a, b, c of the ground below a station in the origin, c in m."""
    return np.array([*SLOPES, -height])


def fitted(
    points: NDArray[np.float64], scanner: Scanner, names=tuple(COMPARED)
) -> dict[str, PlaneFit]:
    """name -> planes of a stack (B, n, 3) by each of ``COMPARED``.

    The scanner's cofactors are those of its model at the measured points, with the normal of the
    plane that LS finds.
    """
    normals = fit_plane(points, "ls").normal[..., None, :]
    cofactors = scanner.cofactors(points, normals=np.broadcast_to(normals, points.shape))
    fits = {}
    with ignore_convergence_warnings():  # `converged` tells
        for name in names:
            method, options, given, _ = COMPARED[name]
            fits[name] = fit_plane(
                points, method, cofactors=cofactors if given else None, absolute=given, **options
            )
    return fits


def against_print(fits: Mapping[str, PlaneFit]) -> pd.DataFrame:
    """The printed numbers beside the redraws: ``label``, ``printed``, ``half_unit``, ``median``,
    ``lower`` and ``upper`` (central 95 %).
    """
    sigma_0 = {name: fits[name].sigma_0 for name in ("ls", "tls", "wtls")}
    found = {
        "gain_vs_ls_percent": 100.0 * (1.0 - sigma_0["wtls"] / sigma_0["ls"]),
        "gain_vs_tls_percent": 100.0 * (1.0 - sigma_0["wtls"] / sigma_0["tls"]),
        "sigma_s_mm": 1e3 * fits["wtls"].sigma_s,
    }
    frame = printed(PRINTED)
    lower, median, upper = np.quantile(
        [found[quantity] for quantity in frame["quantity"]], [0.025, 0.5, 0.975], axis=-1
    )
    return frame.assign(median=median, lower=lower, upper=upper)


def accuracy(
    fits: Mapping[str, PlaneFit], truth: NDArray[np.float64], at: NDArray[np.float64]
) -> pd.DataFrame:
    """Accuracy of the planes beside the accuracy that they state, one row per method.

    Parameters: truth (3,) a, b, c; at (2,) x and y in m, where heights are compared.

    Columns: ``method``; ``sigma_s_mm``, median over the redraws of the RMS distance;
    ``angle_mrad``, RMS angle of the normal from the true one; ``height_mm``, RMS error of the
    height at ``at``, and ``claimed_mm``, its stated standard deviation (RMS); ``held_percent`` of
    the 95 % confidence ellipsoids of (a, b, c) that hold the truth; ``converged_percent``.
    """
    direction = np.array([-truth[0], -truth[1], 1.0]) / np.sqrt(1 + truth[0] ** 2 + truth[1] ** 2)
    row_of_height = np.array([*at, 1.0])
    rows = []
    for name, fit in fits.items():
        error = fit.parameters - truth
        height = error @ row_of_height
        claimed = np.einsum("i,bij,j->b", row_of_height, fit.covariance, row_of_height)
        square = np.einsum("bi,bi->b", error, solve(fit.covariance, error[..., None])[..., 0])
        redundancy = np.count_nonzero(fit.inliers, axis=-1) - PARAMETERS
        limit = (
            chi2.ppf(0.95, PARAMETERS)
            if fit.absolute
            else PARAMETERS * fisher.ppf(0.95, PARAMETERS, redundancy)
        )
        sine = np.linalg.norm(np.cross(fit.normal, direction), axis=-1)
        rows.append(
            {
                "method": COMPARED[name][3],
                "sigma_s_mm": 1e3 * np.median(fit.sigma_s),
                "angle_mrad": 1e3 * np.sqrt(np.mean(np.arcsin(sine) ** 2)),
                "height_mm": 1e3 * np.sqrt(np.mean(height**2)),
                "claimed_mm": 1e3 * np.sqrt(np.mean(claimed)),
                "held_percent": 100.0 * np.mean(square <= limit),
                "converged_percent": 100.0 * np.mean(fit.converged),
            }
        )
    return pd.DataFrame(rows)
