"""Evidence in the printed numbers of Ou & Liu (2017) on the simulated cloud they belong to.

The points were never published. That the cloud of :mod:`studies.ou_liu_2017.clouds` is of their
kind follows from the printed numbers themselves, and each function here is one such argument: the
noise is the rounding to 0.01 m, the points lie on the upper cap alone, the gross errors lie inside
the sphere.

Source: Ou & Liu (2017), section 2.1 and tables 1 and 2,
doi:10.7510/jgjs.issn.1001-3806.2017.05.026.
"""

from __future__ import annotations

import math
from statistics import NormalDist

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.methods import fit_sphere
from analysis.surfaces.sphere import PARAMETERS

from .clouds import SPHERE_CENTER, SPHERE_POINTS, SPHERE_RADIUS
from .printed_tables import values


def true_distances(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Signed distances (n,) of points (n, 3) to the sphere of eq. (19), m; negative inside.

    >>> true_distances(np.array([[10.0, 10.0, 1.0]])).round(4)
    array([-14.1421])
    """
    return np.linalg.norm(points - SPHERE_CENTER, axis=1) - SPHERE_RADIUS


def distance_histogram(
    clean: NDArray[np.float64], width: float = 0.5e-3, step: float = 0.01
) -> pd.DataFrame:
    """How the true distances of a cloud are spread, beside the normal law of the standard deviation
    step/√12.

    Columns: lower_m and upper_m, the limits of a class of the given width; count, the points in it;
    expected, what the normal law expects. The classes reach to where all points are in.

    >>> histogram = distance_histogram(np.array([[10.0, 10.0, 1.0004 + SPHERE_RADIUS]]))
    >>> histogram[["lower_m", "upper_m", "count"]]
       lower_m  upper_m  count
    0  -0.0005   0.0000      0
    1   0.0000   0.0005      1
    """
    distances = true_distances(clean)
    classes = math.ceil(np.abs(distances).max() / width)
    edges = np.linspace(-classes * width, classes * width, 2 * classes + 1)
    law = NormalDist(0.0, step / math.sqrt(12.0))
    shares = np.diff([law.cdf(edge) for edge in edges])
    counts = np.histogram(distances, edges)[0]
    return pd.DataFrame(
        {
            "lower_m": edges[:-1],
            "upper_m": edges[1:],
            "count": counts,
            "expected": len(clean) * shares,
        }
    )


def rounding(steps: tuple[float, ...] = (0.1, 0.01, 0.001)) -> pd.DataFrame:
    """Table 1 as rounding the coordinates to each of the steps would leave it, beside what is
    printed.

    An error uniform in ±step/2 has the standard deviation step/√12 along every axis, and so along
    the normal of the sphere: ``σs = step/√12 · √((n − 4)/n)`` after a fit, ``σ0 = 2R · step/√12``
    in m².

    Columns: step_m, sigma_s_m and sigma_0_m2 expected, and the printed ones over the expected ones.

    >>> table = rounding()
    >>> table.loc[table.sigma_s_ratio.sub(1).abs().idxmin(), "step_m"]
    np.float64(0.01)
    """
    table = values(1, "ls")
    noise = np.array(steps) / np.sqrt(12.0)
    expected = {
        "sigma_s_m": noise * np.sqrt(1 - PARAMETERS / SPHERE_POINTS),
        "sigma_0_m2": 2 * SPHERE_RADIUS * noise,
    }
    frame = pd.DataFrame({"step_m": steps} | expected)
    frame["sigma_s_ratio"] = table["sigma_s_m"] / frame["sigma_s_m"]
    frame["sigma_0_ratio"] = table["sigma_0"] / frame["sigma_0_m2"]
    return frame


def cap_or_sphere(clean: NDArray[np.float64]) -> pd.DataFrame:
    """LS standard deviations with all points on the upper cap and with every second one mirrored to
    the lower.

    Columns: points; sd_c_m and sd_r_m, standard deviations of the height of the centre and of the
    radius; and the LS errors printed in table 1 divided by them. An error of many standard
    deviations does not happen.

    Parameters: clean, (n, 3) points on the cap, m.
    """
    both = clean.copy()
    both[::2, 2] = 2 * SPHERE_CENTER[2] - both[::2, 2]
    table = values(1, "ls")
    rows = []
    for name, points in (("upper cap", clean), ("both halves", both)):
        sd = fit_sphere(points, "ls").standard_deviations
        rows.append(
            {
                "points": name,
                "sd_c_m": sd[2],
                "sd_r_m": sd[3],
                "printed_c_over_sd": table["abs_delta_c_m"] / sd[2],
                "printed_r_over_sd": table["abs_delta_r_m"] / sd[3],
            }
        )
    return pd.DataFrame(rows)


def inside_or_outside(clean: NDArray[np.float64], gross: NDArray[np.float64]) -> pd.DataFrame:
    """``σ0/(2Rσs)`` of the LS fit with the gross errors inside the sphere, with the same outside,
    and as printed.

    A residual is ``r = d (2R + d)``, so the ratio is near 1 + d/(2R) of the gross distances d:
    below 1 says inside.

    Parameters: clean and gross, (n, 3) clouds that differ in the gross errors alone, m.
    """
    table = values(2, "ls")
    rows = [
        {
            "gross errors": "as printed",
            "ratio": table["sigma_0"] / (2 * SPHERE_RADIUS * table["sigma_s_m"]),
        }
    ]
    for name, points in (("inside", gross), ("outside", 2 * clean - gross)):
        fit = fit_sphere(points, "ls")
        rows.append(
            {"gross errors": name, "ratio": fit.sigma_0 / (2 * SPHERE_RADIUS * fit.sigma_s)}
        )
    return pd.DataFrame(rows)
