"""The outline of a section as the paper states it: an ellipsoid cut by the plane of the section.

    (x − a)²/λ1² + (y − b)²/λ2² + (z − c)²/λ3² = 1,  k x + y + k′z + m = 0
                                                           (Li et al. 2015, eq. 11)
    A x² + B xz + C z² + D x + E z + F = 0                 (eq. 12)

Elimination of y gives eq. (13), which ties the six unknowns (a, b, c, λ1, λ2, λ3) to the conic.
Reconstructed, with i_j = 1/λ_j²:

    A = i1 + k² i2,  B = 2kk′ i2,  C = i3 + k′² i2,
    D = −2a i1 + 2k(m + b) i2,  E = −2c i3 + 2k′(m + b) i2,
    F = a² i1 + (m + b)² i2 + c² i3 − 1,                   times an unknown factor

A conic has five numbers, so the six unknowns need one more condition, that the centre lies in the
plane. Then λ2 follows from B alone: from the tilt of the outline in its plane, divided by 2kk′,
which is zero for a tunnel along Y and about 10⁻⁴ for the others. The outline does not determine
it: noise decides the sign of i2, and with the wrong sign there is no ellipsoid.

The outline itself is well posed: the projection along y keeps it as a conic in (x, z), and the
metric of the plane turns that into the semi-axes of the ellipse in the section
(:func:`semi_axes_in_plane`).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
import pandas as pd

from analysis.adjustment.linalg import solve
from analysis.result import rms
from analysis.surfaces.conic import direct_from_points

NOISE = 0.003  # m, of a point
SEEN = np.deg2rad(135.0)  # to both sides of the crown; the track bed hides the rest
SECTION_AXES = (2.711, 2.689)  # m


@dataclass(frozen=True, eq=False)
class Ellipsoid:
    """Solutions of eq. (13).

    center, semi_axes : (…, 3) in m; NaN where there is no ellipsoid (`real` is False)
    """

    center: np.ndarray
    semi_axes: np.ndarray

    @property
    def real(self) -> np.ndarray:
        """(…) bool: whether all three squared semi-axes came out positive."""
        return np.isfinite(self.semi_axes).all(axis=-1)


@np.errstate(divide="ignore", invalid="ignore")
def ellipsoid(conic, plane) -> Ellipsoid:
    """Solve eq. (13) as printed, with the centre in the plane: ``k a + b + k′c + m = 0``.

    There is no solution where B/(kk′) is not positive, or takes more from A or C than there is.

    Parameters
    ----------
    conic : (…, 6) in (x, z), of any factor.
    plane : (…, 3) of (k, k′, m).

    Example
    -------
    The unit sphere cut by x + y + z = 0, and by y = 0, where eq. (13) does not determine λ2:

    >>> ellipsoid([2.0, 2, 2, 0, 0, -1], [1.0, 1.0, 0.0]).semi_axes
    array([1., 1., 1.])
    >>> bool(ellipsoid([1.0, 0, 1, 0, 0, -1], [0.0, 0.0, 0.0]).real)
    False

    Source: Li et al. 2015, eq. (13), reconstructed.
    """
    A, B, C, D, E, F = np.moveaxis(np.asarray(conic, dtype=float), -1, 0)
    k, kk, m = np.moveaxis(np.asarray(plane, dtype=float), -1, 0)
    determinant = 4.0 * A * C - B * B
    a, c = (B * E - 2.0 * C * D) / determinant, (B * D - 2.0 * A * E) / determinant
    b = -(k * a + kk * c + m)
    i2 = B / (2.0 * k * kk)
    i1, i3 = A - k * k * i2, C - kk * kk * i2
    factor = i1 * a * a + i2 * (m + b) ** 2 + i3 * c * c - F
    squares = factor[..., None] / np.stack([i1, i2, i3], axis=-1)
    real = (np.isfinite(squares) & (squares > 0)).all(axis=-1, keepdims=True)
    center = np.stack(np.broadcast_arrays(a, b, c), axis=-1)
    return Ellipsoid(np.where(real, center, np.nan), np.sqrt(np.where(real, squares, np.nan)))


def semi_axes_in_plane(conic, plane) -> np.ndarray:
    """Semi-axes (…, 2) in m of an outline in its own plane, the major one first.

    Parameters
    ----------
    conic : (…, 6) of the outline in (x, z).
    plane : (…, 3) of (k, k′, m).

    A step (dx, dz) is ``√(dx, dz) G (dx, dz)ᵀ`` long in the plane,
    ``G = [1 + k², kk′; kk′, 1 + k′²]``. The semi-axes are √(−F′/λ) with the eigenvalues of
    ``M v = λ G v``, M the quadratic part of the conic and F′ its value at the centre. This is the
    ellipse that :func:`analysis.fit_ellipse` finds in the section's own coordinates. NaN where
    there is no ellipse.

    Example
    -------
    A cylinder of radius 2 about y, cut at 45°:

    >>> semi_axes_in_plane([1.0, 0, 1, 0, 0, -4], [1.0, 0.0, 0.0]).round(6)
    array([2.828427, 2.      ])
    """
    A, B, C, D, E, F = np.moveaxis(np.asarray(conic, dtype=float), -1, 0)
    k, kk, _ = np.moveaxis(np.asarray(plane, dtype=float), -1, 0)
    M = np.stack([np.stack([A, 0.5 * B], axis=-1), np.stack([0.5 * B, C], axis=-1)], axis=-2)
    G = np.stack(
        [np.stack([1.0 + k * k, k * kk], axis=-1), np.stack([k * kk, 1.0 + kk * kk], axis=-1)],
        axis=-2,
    )
    center = solve(M, -0.5 * np.stack([D, E], axis=-1)[..., None])[..., 0]
    level = F + 0.5 * (D * center[..., 0] + E * center[..., 1])
    L = np.linalg.cholesky(G)
    root = solve(L, solve(L, M).swapaxes(-1, -2))  # L⁻¹ M L⁻ᵀ
    squares = -level[..., None] / np.linalg.eigvalsh(0.5 * (root + root.swapaxes(-1, -2)))
    largest_first = -np.sort(-np.where(squares > 0, squares, np.nan), axis=-1)
    return np.sqrt(largest_first)


def section_points(
    plane, tilt: float, angles: np.ndarray, noise: np.ndarray, semi_axes=SECTION_AXES
) -> np.ndarray:
    """Points (…, n, 2) in (x, z) of ellipses about the origin in planes ``k x + y + k′z = 0``.

    Parameters
    ----------
    plane : (…, 3) of (k, k′, 0).
    tilt : of the major axis against the horizontal, rad.
    angles : (…, n) eccentric anomalies, from the crown, rad.
    noise : (…, n, 2) along the two axes of the plane, m.
    """
    k, kk, _ = np.moveaxis(np.asarray(plane, dtype=float), -1, 0)[..., None]
    normal = np.stack([k, np.ones_like(k), kk], axis=-1)
    horizontal = (
        np.stack([np.ones_like(k), -k, np.zeros_like(k)], axis=-1) / np.hypot(1.0, k)[..., None]
    )
    upright = np.cross(horizontal, normal) / np.linalg.norm(normal, axis=-1, keepdims=True)
    c, s = np.cos(tilt), np.sin(tilt)
    p, q = semi_axes[0] * np.sin(angles), semi_axes[1] * np.cos(angles)
    u, v = c * p - s * q + noise[..., 0], s * p + c * q + noise[..., 1]
    return (u[..., None] * horizontal + v[..., None] * upright)[..., [0, 2]]


def failure_study(
    limits=(0.005, 0.01, 0.02, 0.05),
    points=(360, 1000),
    tilts_deg=(0.0, 10.0),
    *,
    trials: int = 200,
    noise: float = NOISE,
    seed: int = 0,
) -> pd.DataFrame:
    """Count how often eq. (13) gives no ellipsoid, beside the errors of the ellipse in the plane.

    Parameters
    ----------
    limits : k and k′ of the planes are uniform between ± this.
    points : of a section, over 270°.
    tilts_deg : of the ellipse in its plane.
    noise : of a point, m.

    Returns
    -------
    DataFrame, a row per case: ``slope_limit``, ``points``, ``tilt_deg``; ``imaginary``, share of
    the trials without an ellipsoid; ``lambda2_median_m`` of the others; ``major_rms_mm``,
    ``minor_rms_mm``, errors of the semi-axes by the metric of the plane, from the same conics.

    Example
    -------
    >>> study = failure_study([0.02], [200], [0.0], trials=50)
    >>> bool(study["imaginary"][0] > 0.2), bool(study["minor_rms_mm"][0] < 1)
    (True, True)
    """
    table = []
    for limit, n, tilt in product(limits, points, tilts_deg):
        rng = np.random.default_rng(seed)
        plane = np.column_stack([limit * rng.uniform(-1.0, 1.0, (trials, 2)), np.zeros(trials)])
        angles = rng.uniform(-SEEN, SEEN, (trials, n))
        xz = section_points(
            plane, np.deg2rad(tilt), angles, noise * rng.standard_normal((trials, n, 2))
        )
        conic, _ = direct_from_points(xz, np.ones((trials, n)))
        found = ellipsoid(conic, plane)
        errors = 1000.0 * (semi_axes_in_plane(conic, plane) - SECTION_AXES)
        table.append(
            {
                "slope_limit": limit,
                "points": n,
                "tilt_deg": tilt,
                "imaginary": np.mean(~found.real),
                "lambda2_median_m": np.median(found.semi_axes[found.real, 1])
                if found.real.any()
                else np.nan,
                "major_rms_mm": rms(errors[:, 0]),
                "minor_rms_mm": rms(errors[:, 1]),
            }
        )
    return pd.DataFrame(table)
