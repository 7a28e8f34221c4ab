"""The axis of a tunnel as printed: quadratics through the middles between extreme points.

References
----------
Li, Lu, Zhu, Lu, Wu & Li (2015), tunnel section extraction and deformation analysis from laser point
clouds; its equations are numbered (1)-(13), but were lost from the text at hand and are
reconstructed here from its words.
"""

from __future__ import annotations

import numpy as np

from analysis.blocks import pieces
from analysis.checks import check_positive
from analysis.tunnel.axis import Axis, tunnel_points


def mid_values(points, step: float = 0.1) -> tuple[np.ndarray, np.ndarray]:
    """Centres y (B,) and mid-values (B, 2) of the occupied bins of ``step`` m from y_min.

    The mid-values are ``(x_max + x_min)/2`` and ``(z_max + z_min)/2``.

    Raises
    ------
    ValueError : more bins than points.

    Source: Li et al. (2015), eq. (1).
    """
    points, step = tunnel_points(points), check_positive(step, "step")
    first = points[:, 1].min()
    count = int((points[:, 1].max() - first) / step) + 1
    if count > len(points):
        raise ValueError(
            f"step: expected bins that hold points, "
            f"got {count} bins of {step:g} m for {len(points)} points"
        )
    low, high = np.full((2, count), np.inf), np.full((2, count), -np.inf)
    for piece in pieces(len(points)):
        of = ((points[piece, 1] - first) / step).astype(np.int64)
        for row, column in enumerate((0, 2)):
            np.minimum.at(low[row], of, points[piece, column])
            np.maximum.at(high[row], of, points[piece, column])
    occupied = np.flatnonzero(np.isfinite(low[0]))
    return first + (occupied + 0.5) * step, 0.5 * (low[:, occupied] + high[:, occupied]).T


def printed_axis(
    points, step: float = 0.1, *, local: tuple[np.ndarray, np.ndarray] | None = None
) -> Axis:
    """Axis as printed: quadratics ``x(y)`` and ``z(y)`` fitted to the mid-values of bins.

    Parameters
    ----------
    points : (n, 3) in m, Y along the tunnel, Z up.
    step : width Δy of the bins, m.
    local : origin and rotation of another frame than that of the points, as
        :func:`~analysis.tunnel.axis.local_frame` gives it.

    The middle between extremes is that of the section only where all of a ring is seen: bins at an
    end cut askew, a track bed, which lifts z by half of the height it hides, and cables pull it;
    see :func:`~analysis.tunnel.axis_estimation.robust_axis`.

    Raises
    ------
    ValueError : points that reach further across Y than along it.

    Source: Li et al. (2015), section on the axis, steps 1-3.

    Example
    -------
    >>> y, turn = np.arange(20_000) * 1e-3, np.arange(20_000) * 2.4
    >>> x, z = 2.7 * np.cos(turn) + 0.001 * y**2, 2.7 * np.sin(turn) + 0.02 * y
    >>> tube = np.stack([x, y, z], axis=-1)
    >>> axis = printed_axis(tube, step=0.5)
    >>> print(f"{axis.quadratics[0, 2]:.3f} {axis.quadratics[1, 1]:.3f}")
    0.001 0.020
    """
    points = tunnel_points(points)
    origin, rotation = (np.zeros(3), np.eye(3)) if local is None else local
    placed = Axis(origin, rotation, np.array([0.0, 1.0]), np.zeros((4, 2, 1)))
    points = points if local is None else placed.to_local(points)
    width, length, height = np.ptp(points, axis=0)
    if not length > max(width, height):
        raise ValueError(
            f"points: expected a tunnel along Y, longer than wide and high, "
            f"got {width:.4g} m in X, {length:.4g} m in Y and {height:.4g} m in Z; "
            f"local_frame finds the direction of a tunnel"
        )
    y, middle = mid_values(points, step)
    first, last = points[:, 1].min(), points[:, 1].max()
    scale = last - first
    if len(y) < 3:
        raise ValueError(
            f"step: expected at least 3 occupied bins for a quadratic, got {len(y)} of {step:g} m"
        )
    fitted = np.linalg.lstsq(((y - first) / scale)[:, None] ** np.arange(3), middle, rcond=None)[0]
    coefficients = np.zeros((4, 2, 1))
    coefficients[:3, :, 0] = fitted / scale ** np.arange(3)[:, None]
    return Axis(origin, rotation, np.array([first, last]), coefficients)
