"""The axis of a tunnel: a curve x(y), z(y) in a frame that runs along the tunnel.

Local frame: Z up, Y along the tunnel (horizontal), X = Y × Z to the right when looking along +Y. Li
et al. (2015) scan with Y along the tunnel, so their frame is the identity; :func:`local_frame`
finds it for a tunnel of any direction.

Two axes stand side by side. :func:`printed_axis` takes the middle between the extreme points of
thin bins: cut end bins, the track bed and cables pull it. :func:`robust_axis` takes the centres of
the section's circle with its ovality, found by robust regression, and repeats from the axis found
until it stands still. Both epochs of a comparison use the axis of the first.

References
----------
Li, Lu, Zhu, Lu, Wu & Li (2015), tunnel section extraction and deformation analysis from laser point
clouds; its equations are numbered (1)-(13), but were lost from the text at hand and are
reconstructed here from its words.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import factorial

import numpy as np
from scipy.interpolate import BSpline
from scipy.ndimage import median_filter

from ..adjustment.linalg import cofactor_from_normal, solve
from ..adjustment.weights import ROUNDED_MAD_TO_SD, Bisquare
from ..blocks import pieces
from ..checks import check_positive, point_array, real_array

# A quadratic departs from a circular arc by about L⁴/(1024 R³): 0.5 mm for 60 m of a 300 m radius,
# but 3.6 mm and 1.2 mrad for 100 m.
LONGEST_QUADRATIC = 60.0  # m
LONGEST_SPLINE_PIECE = 30.0  # m
SAMPLE = 2_000_000  # points the robust axis looks at
CELLS = 120  # directions in which a slab is described by one median radius
OPENINGS = (30, 45, 60, 75)  # degrees between the three directions of a trial circle
HARMONICS = 5  # 1, sin α, cos α, sin 2α, cos 2α
STANDS_STILL = 1e-4  # m
BISQUARE = Bisquare()
RADII = (0.3, 30.0)  # m; a tunnel beyond these is one in other units


@dataclass(frozen=True, eq=False)
class Axis:
    """A tunnel axis: piecewise polynomials x(y), z(y) in the local frame, which continue straight
    beyond their ends.

    origin : (3,) of the local frame, in the system of the points, m
    rotation : (3, 3), rows X, Y, Z; ``local = rotation @ (point − origin)``
    breaks : (K + 1,) local y between which the K polynomials hold, m
    coefficients : (4, 2, K) of powers 0-3 of ``y − breaks[k]`` for x and z
    iterations, converged, stop_reason : how its estimation ended

    >>> axis = straight(np.zeros(3), np.array([0.0, 10.0, 1.0]))
    >>> print(f"{axis.length:.6f}", axis.position(5.0))
    10.049876 [0.  5.  0.5]
    >>> axis.foot(np.array([[3.0, 5.0, 0.5]]))
    array([5.])
    """

    origin: np.ndarray
    rotation: np.ndarray
    breaks: np.ndarray
    coefficients: np.ndarray
    iterations: int = 1
    converged: bool = True
    stop_reason: str = "solved in closed form"

    def __post_init__(self):
        for name in ("origin", "rotation", "breaks", "coefficients"):
            array = np.array(getattr(self, name), dtype=float)
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    @property
    def y_range(self) -> tuple[float, float]:
        """Local y of its two ends, m."""
        return float(self.breaks[0]), float(self.breaks[-1])

    @property
    def length(self) -> float:
        """Arc length between its ends, m."""
        return float(self._lengths[-1])

    @property
    def quadratics(self) -> np.ndarray:
        """``((a0, a1, a2), (b0, b1, b2))`` of ``x = a0 + a1 y + a2 y²`` and
        ``z = b0 + b1 y + b2 y²`` (Li et al. 2015, step 3).

        Raises ``ValueError`` for an axis that is not one quadratic.
        """
        if self.coefficients.shape[-1] > 1 or self.coefficients[3].any():
            raise ValueError(
                f"quadratics: expected an axis of one quadratic, got a cubic spline of {self.coefficients.shape[-1]} pieces"
            )
        c, b = self.coefficients[:, :, 0], self.breaks[0]
        return np.stack([c[0] - b * c[1] + b * b * c[2], c[1] - 2 * b * c[2], c[2]], axis=-1)

    def to_local(self, points) -> np.ndarray:
        """Points (…, 3) in the local frame."""
        return (np.asarray(points, dtype=float) - self.origin) @ self.rotation.T

    def from_local(self, points) -> np.ndarray:
        """Points (…, 3) of the local frame in the system of the scans."""
        return np.asarray(points, dtype=float) @ self.rotation + self.origin

    def local_curve(self, y) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(x, z) and their first and second derivatives with respect to y (…), each (2, …)."""
        y = np.asarray(y, dtype=float)
        inside = np.clip(y, *self.y_range)
        if self.coefficients.shape[-1] == 1:
            c = self.coefficients.reshape((4, 2) + (1,) * y.ndim)
            h = inside - self.breaks[0]
        else:
            piece = self._piece(inside)
            c = np.take(self.coefficients, piece, axis=-1)
            h = inside - self.breaks[piece]
        slope = _slope(c, h)
        value = c[0] + h * (c[1] + h * (c[2] + h * c[3])) + (y - inside) * slope
        return value, slope, np.where(y == inside, 2.0 * c[2] + h * (6.0 * c[3]), 0.0)

    def position(self, y) -> np.ndarray:
        """Axis points (…, 3) at local y (…)."""
        x, z = self.local_curve(y)[0]
        return self.from_local(np.stack([x, np.broadcast_to(y, x.shape), z], axis=-1))

    def tangent(self, y) -> np.ndarray:
        """Unit tangents ``τ/|τ|``, ``τ = (dx/dy, 1, dz/dy)`` (…, 3); Li et al. (2015), eq. (4)."""
        return self.frame(y)[2]

    def frame(self, y) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Unit vectors right, up and along of the sections at local y (…), each (…, 3).

        up ∝ e_Z − t (tᵀe_Z),   right = t × up
        """
        return tuple(
            vectors @ self.rotation for vectors in self._local_frame(self.local_curve(y)[1])
        )

    def chainage(self, y) -> np.ndarray:
        """Arc length ``s = ∫ √(1 + x'² + z'²) dy`` (…) from the first end to local y (…), m."""
        y = np.asarray(y, dtype=float)
        inside = np.clip(y, *self.y_range)
        piece = self._piece(inside)
        return self._lengths[piece] + self._arc(piece, inside) + (y - inside) * self._speed(inside)

    def at_chainage(self, s) -> np.ndarray:
        """Local y (…) at arc lengths (…), by Newton."""
        s = np.asarray(s, dtype=float)
        y = self.breaks[0] + s * (self.breaks[-1] - self.breaks[0]) / self.length
        for _ in range(50):
            step = (s - self.chainage(y)) / self._speed(y)
            y = y + step
            if np.all(np.abs(step) <= 1e-12 * (1.0 + np.abs(s))):
                break
        return y

    def foot(self, points) -> np.ndarray:
        """Local y (n,) of the axis points nearest to points (n, 3): the root of
        ``(P − p(y))ᵀ τ(y) = 0`` by Newton.

        Li et al. (2015), eqs. (2)-(3), search a list of axis points for it. Memory does not grow
        with n beyond the result.
        """
        points = point_array(points, 3, 0, "foot points") if len(points) else np.empty((0, 3))
        y = np.empty(len(points))
        for piece in pieces(len(points)):
            y[piece] = self._feet(self.to_local(points[piece]))
        return y

    def polar(self, points) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Local y of the foot points, radii in m and angles in rad (0 crown, + right) of points (n,
        3) about their own foot points.
        """
        points = self.to_local(points)
        y = self._feet(points)
        (x, z), slope, _ = self.local_curve(y)
        right, up, _ = self._local_frame(slope)
        offset = points - np.stack([x, y, z], axis=-1)
        u, v = np.einsum("ni,ni->n", offset, right), np.einsum("ni,ni->n", offset, up)
        return y, np.hypot(u, v), np.arctan2(u, v)

    def _feet(self, points: np.ndarray) -> np.ndarray:
        x, y_P, z = points.T
        y = y_P.copy()
        for _ in range(50):
            (X, Z), (k, m), (kk, mm) = self.local_curve(y)
            speed = 1.0 + k * k + m * m
            f = (X - x) * k + (y - y_P) + (Z - z) * m
            # Beyond the centre of curvature, where no tunnel point is, the slope of f changes its
            # sign.
            step = f / np.maximum(speed + (X - x) * kk + (Z - z) * mm, 0.1 * speed)
            y -= step
            # squared by the next step, so below rounding
            if step.size == 0 or np.abs(step).max() <= 1e-6:
                break
        return y

    @staticmethod
    def _local_frame(slope: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        k, m = slope
        length, run = np.sqrt(1.0 + k * k + m * m), np.sqrt(1.0 + k * k)
        along = np.stack([k, np.ones_like(k), m], axis=-1) / length[..., None]
        up = np.stack([-k * m, -m, run * run], axis=-1) / (length * run)[..., None]
        right = np.stack([np.ones_like(k), -k, np.zeros_like(k)], axis=-1) / run[..., None]
        return right, up, along

    def _piece(self, y: np.ndarray) -> np.ndarray:
        return np.clip(
            np.searchsorted(self.breaks, y, side="right") - 1, 0, self.coefficients.shape[-1] - 1
        )

    def _speed(self, y: np.ndarray) -> np.ndarray:
        k, m = self.local_curve(y)[1]
        return np.sqrt(1.0 + k * k + m * m)

    def _arc(self, piece: np.ndarray, end: np.ndarray) -> np.ndarray:
        """Arc length from the beginning of pieces to local y in them: 16 Gauss points, because the
        speed is smooth.
        """
        nodes, weights = np.polynomial.legendre.leggauss(16)
        c = np.take(self.coefficients, piece, axis=-1)
        half = 0.5 * (end - self.breaks[piece])
        total = np.zeros_like(half)
        for node, weight in zip(nodes, weights, strict=True):
            k, m = _slope(c, half * (1.0 + node))
            total += weight * np.sqrt(1.0 + k * k + m * m)
        return half * total

    @cached_property
    def _lengths(self) -> np.ndarray:
        """Arc length from the first end to every break."""
        return np.concatenate(
            [[0.0], np.cumsum(self._arc(np.arange(len(self.breaks) - 1), self.breaks[1:]))]
        )


def _slope(c: np.ndarray, h: np.ndarray) -> np.ndarray:
    """First derivative at h of cubics with coefficients c (4, …)."""
    return c[1] + h * (2.0 * c[2] + h * (3.0 * c[3]))


def straight(start, end) -> Axis:
    """The straight axis between two points (3,), m; not vertical.

    >>> straight([0.0, 0.0, 0.0], [5.0, 0.0, 0.0]).tangent(0.0).round(12)
    array([1., 0., 0.])
    """
    start, end = real_array(start, "start"), real_array(end, "end")
    run = np.hypot(*(end - start)[:2])
    if start.shape != (3,) or end.shape != (3,) or not run > 0:
        raise ValueError(
            f"start, end: expected two points (3,) at a horizontal distance, got {start} and {end}"
        )
    coefficients = np.zeros((4, 2, 1))
    coefficients[1, 1, 0] = (end[2] - start[2]) / run
    return Axis(start, _rotation((end - start)[:2]), np.array([0.0, run]), coefficients)


# --------------------------------------------------------------------------------- the local frame


def local_frame(points) -> tuple[np.ndarray, np.ndarray]:
    """Origin (3,) and rotation (3, 3) of the frame whose Y runs along the main horizontal direction
    of points (n, 3).

    The direction is that of the ground the points cover in cells of 0.5 m, so that the crowd of
    points near a scanner does not weigh more; of its two senses the one whose larger component is
    positive.

    Raises ``ValueError`` when the points are hardly longer than wide or high: too short a tunnel,
    or Z is not up.

    >>> y, turn = np.arange(20_000) * 1e-3, np.arange(20_000) * 2.4
    >>> points = np.stack([y, 2.7 * np.cos(turn) + 0.1 * y, 2.7 * np.sin(turn)], axis=-1)
    >>> local_frame(points)[1].round(1) + 0.0
    array([[ 0.1, -1. ,  0. ],
           [ 1. ,  0.1,  0. ],
           [ 0. ,  0. ,  1. ]])
    """
    points = _tunnel_points(points)
    low, high = points.min(axis=0), points.max(axis=0)
    middle = 0.5 * (low + high)
    cells = []
    for piece in pieces(len(points), 2**20):
        east, north = np.floor((points[piece, :2] - middle[:2]) / 0.5).astype(np.int64).T
        cells.append(np.unique(east * 2**32 + north))  # one number a cell sorts faster than two
    cells = np.unique(np.concatenate(cells))
    north = (cells + 2**31) % 2**32 - 2**31
    cells = np.stack([(cells - north) / 2**32, north], axis=-1)
    cells -= cells.mean(axis=0)
    direction = np.linalg.svd(cells, full_matrices=False)[2][0]
    rotation = _rotation(direction * np.sign(direction[np.argmax(np.abs(direction))]))
    length, width = 0.5 * np.ptp(cells @ rotation[:2, :2].T, axis=0)[::-1]
    height = high[2] - low[2]
    if not length > 1.5 * max(width, height):
        raise ValueError(
            f"points: expected a tunnel at least 1.5 times as long as wide and high, with Z up, in m; "
            f"got {length:.4g} long, {width:.4g} wide and {height:.4g} high"
        )
    return middle, rotation


def _rotation(direction: np.ndarray) -> np.ndarray:
    """Rows X, Y, Z of the frame whose Y is the horizontal direction (2,)."""
    e, n = direction / np.hypot(*direction)
    return np.array([[n, -e, 0.0], [e, n, 0.0], [0.0, 0.0, 1.0]])


def _tunnel_points(points) -> np.ndarray:
    points = point_array(points, 3, 100, "a tunnel axis")
    if points.ndim != 2:
        raise ValueError(f"points: expected one cloud of shape (n, 3), got {points.shape}")
    return points


# --------------------------------------------------------------------------------- as printed


def mid_values(points, step: float = 0.1) -> tuple[np.ndarray, np.ndarray]:
    """Bin centres y (B,) and mid-values (B, 2) ``(x_max + x_min)/2``, ``(z_max + z_min)/2`` of the
    occupied bins of ``step`` m from y_min.

    Source: Li et al. (2015), eq. (1).
    """
    points, step = _tunnel_points(points), check_positive(step, "step")
    first = points[:, 1].min()
    count = int((points[:, 1].max() - first) / step) + 1
    if count > len(points):
        raise ValueError(
            f"step: expected bins that hold points, got {count} bins of {step:g} m for {len(points)} points"
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
    """Axis as printed: one quadratic ``x(y)`` and one ``z(y)`` through the mid-values of bins of
    ``step`` m, by least squares.

    Parameters
    ----------
    points : (n, 3) in m, Y along the tunnel, Z up.
    step : width Δy of the bins, m.
    local : origin and rotation of another frame than that of the points, as :func:`local_frame`
        gives it.

    The middle between extremes is that of the section only where all of a ring is seen: bins at an
    end cut askew, a track bed, which lifts z by half of the height it hides, and cables pull it;
    see :func:`robust_axis`.

    Raises ``ValueError`` when the points reach further across Y than along it.

    Source: Li et al. (2015), section on the axis, steps 1-3.

    >>> y, turn = np.arange(20_000) * 1e-3, np.arange(20_000) * 2.4
    >>> tube = np.stack([2.7 * np.cos(turn) + 0.001 * y**2, y, 2.7 * np.sin(turn) + 0.02 * y], axis=-1)
    >>> axis = printed_axis(tube, step=0.5)
    >>> print(f"{axis.quadratics[0, 2]:.3f} {axis.quadratics[1, 1]:.3f}")
    0.001 0.020
    """
    points = _tunnel_points(points)
    origin, rotation = (np.zeros(3), np.eye(3)) if local is None else local
    placed = Axis(origin, rotation, np.array([0.0, 1.0]), np.zeros((4, 2, 1)))
    points = points if local is None else placed.to_local(points)
    width, length, height = np.ptp(points, axis=0)
    if not length > max(width, height):
        raise ValueError(
            f"points: expected a tunnel along Y, longer than wide and high, got {width:.4g} m in X, {length:.4g} m in Y and "
            f"{height:.4g} m in Z; local_frame finds the direction of a tunnel"
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


# --------------------------------------------------------------------------------- robust


def robust_axis(points, *, slab: float = 1.0, seed: int = 0, max_iterations: int = 30) -> Axis:
    """Axis through section centres that track bed, cables and cut ends do not pull.

    From a first axis, in turn until the axis stands still to 0.1 mm: polar coordinates of the
    points about their own foot points; in slabs of ``slab`` m the median radius in each of 120
    directions; in each slab

        ρ(α) = r + u₀ sin α + v₀ cos α + c₂ cos 2α + s₂ sin 2α

    by robust regression (trial circles with the least median residual, then bisquare weights); the
    centre (u₀, v₀) with its standard deviation; the curve through the centres, again robust: one
    quadratic up to 60 m, else a cubic spline in pieces of up to 30 m. The terms in 2α keep the
    ovality of a ring that is not seen all around from moving its centre.

    Parameters
    ----------
    points : (n, 3) in m, any horizontal direction, Z up. Of more than 2 million a random 2 million
        are used.
    slab : length of the slabs, m; at low density of points take longer ones.
    seed : of the random choice.

    Returns
    -------
    Axis from where the points of the first slab with a centre begin to where those of the last one
    end.

    Raises
    ------
    ValueError : no tunnel by its extents or its radius (other units?), or fewer than 3 slabs with a
        centre.

    >>> y, turn = np.arange(20_000) * 1e-3, np.arange(20_000) * 2.4
    >>> tube = np.stack([2.7 * np.cos(turn), y, np.maximum(2.7 * np.sin(turn), -2.0)], axis=-1)  # with a floor
    >>> axis = robust_axis(tube)
    >>> bool(np.abs(axis.position(axis.at_chainage([1.0, 9.0]))[:, [0, 2]]).max() < 5e-4)
    True
    """
    points, slab = _tunnel_points(points), check_positive(slab, "slab")
    if len(points) > SAMPLE:
        points = points[np.random.default_rng(seed).integers(0, len(points), SAMPLE)]
    axis = _first_axis(points, slab)
    for iteration in range(1, max_iterations + 1):
        y, centers, sd, ends = _slab_centers(points, axis, slab)
        x, z = axis.local_curve(y)[0]
        right, up, _ = axis._local_frame(axis.local_curve(y)[1])
        moved = np.stack([x, y, z], axis=-1) + centers[:, :1] * right + centers[:, 1:] * up
        new = _curve(
            axis.origin, axis.rotation, moved[:, 1], moved[:, [0, 2]], 1.0 / (sd**2 + 1e-6), ends
        )
        shift = np.abs(new.local_curve(y)[0] - axis.local_curve(y)[0]).max()
        axis = new
        if shift <= STANDS_STILL:
            return _ended(axis, iteration, True, "the axis stands still")
    return _ended(
        axis, max_iterations, False, f"not converged: the axis still moved by {shift:.2g} m"
    )


def _ended(axis: Axis, iterations: int, converged: bool, stop_reason: str) -> Axis:
    return Axis(
        axis.origin,
        axis.rotation,
        axis.breaks,
        axis.coefficients,
        iterations,
        converged,
        stop_reason,
    )


def _first_axis(points: np.ndarray, slab: float) -> Axis:
    """Through the middles of the 2 % and 98 % quantiles of x and z in slabs."""
    origin, rotation = local_frame(points)
    local = (points - origin) @ rotation.T
    of = np.floor(local[:, 1] / slab).astype(np.int64)
    order = np.argsort(of, kind="stable")
    slabs, starts = np.unique(of[order], return_index=True)
    groups = [local[part] for part in np.split(order, starts[1:]) if len(part) >= 20]
    if len(groups) < 3:
        raise ValueError(
            f"points: expected at least 3 slabs of {slab:g} m with 20 points or more, got {len(groups)} of {len(slabs)}; "
            "are these metres, and the slabs long enough for the density?"
        )
    quantiles = np.array([np.quantile(group[:, [0, 2]], [0.02, 0.98], axis=0) for group in groups])
    radius = 0.5 * np.median(np.diff(quantiles, axis=1))
    if not RADII[0] < radius < RADII[1]:
        raise ValueError(
            f"points: expected a tunnel with a radius of {RADII[0]:g} to {RADII[1]:g} m, got about {radius:.4g}; are these metres?"
        )
    y = np.array([group[:, 1].mean() for group in groups])
    return _curve(origin, rotation, y, quantiles.mean(axis=1), np.ones(len(y)), (y[0], y[-1]))


def _slab_centers(
    points: np.ndarray, axis: Axis, slab: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, tuple[float, float]]:
    """Local y (K,), centres (K, 2) right and up of the axis, and their standard deviations (K,), of
    the slabs that have one, m.

    Also the local y at which the points of the first of these slabs begin and those of the last one
    end.
    """
    polar = [axis.polar(points[piece]) for piece in pieces(len(points))]
    y, rho, alpha = (np.concatenate(parts) for parts in zip(*polar, strict=True))
    of = np.floor(y / slab).astype(np.int64)
    slabs, of = np.unique(of, return_inverse=True)
    cell = np.minimum(((alpha / (2.0 * np.pi) + 0.5) * CELLS).astype(np.int64), CELLS - 1)
    medians = group_medians(of * CELLS + cell, rho, len(slabs) * CELLS).reshape(-1, CELLS)
    seen = np.count_nonzero(np.isfinite(medians), axis=-1) >= 4 * HARMONICS
    angles = 2.0 * np.pi * ((np.arange(CELLS) + 0.5) / CELLS - 0.5)
    X = np.stack(
        [np.ones(CELLS), np.sin(angles), np.cos(angles), np.sin(2 * angles), np.cos(2 * angles)],
        axis=-1,
    )
    rho = medians[seen]
    start = [_residuals_of_best_circle(X[:, :3], rho[part]) for part in pieces(len(rho), 64)]
    x, cofactor, scale, used = _reweighted(
        X, rho, np.ones_like(rho), np.concatenate([np.empty((0, CELLS)), *start])
    )
    sd = scale * np.sqrt(0.5 * (cofactor[:, 1, 1] + cofactor[:, 2, 2]))
    found = np.isfinite(sd) & (used >= 2 * HARMONICS) & (sd < 0.1 * x[:, 0])
    if np.count_nonzero(found) < 3:
        raise ValueError(
            f"points: expected at least 3 slabs of {slab:g} m in which a ring is seen, got {np.count_nonzero(found)}"
        )
    used = np.flatnonzero(seen)[found]
    ends = float(y[of == used[0]].min()), float(y[of == used[-1]].max())
    return (slabs[used] + 0.5) * slab, x[found, 1:3], sd[found], ends


def group_medians(group: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """Median of the values (n,), none negative, of each of ``count`` groups; NaN where there are
    none.
    """
    # One number sorts faster than two.
    order = np.argsort(group + 0.5 * values / max(values.max(), np.finfo(float).tiny))
    values = values[order]
    present, starts, sizes = np.unique(group[order], return_index=True, return_counts=True)
    medians = np.full(count, np.nan)
    medians[present] = 0.5 * (values[starts + (sizes - 1) // 2] + values[starts + sizes // 2])
    return medians


def _residuals_of_best_circle(X: np.ndarray, rho: np.ndarray) -> np.ndarray:
    """Residuals (K, J) of radii (K, J) from the trial circle with the least median |residual|,
    which half of them cannot spoil.

    Each trial circle goes through three radii; there are trials at all places and of several
    widths.
    """
    first = np.arange(0, CELLS, 2)
    openings = [round(degrees * CELLS / 360) for degrees in OPENINGS]
    trials = (
        np.concatenate([np.stack([first - by, first, first + by], axis=-1) for by in openings])
        % CELLS
    )
    circles = solve(X[trials], np.moveaxis(rho[:, trials], 0, -1))  # (S, 3, K)
    residuals = np.abs(rho - np.einsum("ji,sik->skj", X, circles))
    ordered = np.sort(np.nan_to_num(residuals, nan=np.inf), axis=-1)
    half = np.count_nonzero(np.isfinite(rho), axis=-1) // 2
    best = np.argmin(np.take_along_axis(ordered, half[None, :, None], axis=-1)[..., 0], axis=0)
    # The best may be infinite where no trial meets three radii; then all of them start alike.
    return np.nan_to_num(np.take_along_axis(residuals, best[None, :, None], axis=0)[0], nan=0.0)


def _reweighted(X, Y, prior, residuals) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Robust linear regressions of rows Y (B, n), NaN where missing, on a common X (n, t), from
    starting residuals (B, n).

    Bisquare weights on residuals over their MAD. Returns x (B, t), cofactor (B, t, t), scale (B,)
    and the number of values in use (B,).
    """
    missing = np.isnan(Y)
    Y, root = np.where(missing, 0.0, Y), np.sqrt(prior)
    x = np.zeros((len(Y), X.shape[-1]))
    for _ in range(50):
        standardised = np.where(missing, np.nan, np.abs(residuals) * root)
        scale = ROUNDED_MAD_TO_SD * np.nanmedian(standardised, axis=-1) + 1e-9
        weights = np.nan_to_num(BISQUARE.weight(standardised / scale[:, None]), nan=0.0) * prior
        weighted = X.T * weights[:, None, :]
        N = weighted @ X
        new = solve(N, weighted @ Y[..., None])[..., 0]
        residuals = np.nan_to_num(Y - new @ X.T)
        if not np.any(np.abs(new - x) > 1e-9 * (1.0 + np.abs(new))):
            break
        x = new
    return new, cofactor_from_normal(N), scale, np.count_nonzero(weights, axis=-1)


def _curve(origin, rotation, y, centers, prior, ends) -> Axis:
    """The robust curve through centres (K, 2) at local y (K,) with weights (K,)."""
    first, last = ends
    length = last - first
    if length <= LONGEST_QUADRATIC or len(y) < 12:
        degree, inner = 2, np.empty(0)
    else:
        degree = 3
        inner = np.linspace(first, last, int(np.ceil(length / LONGEST_SPLINE_PIECE)) + 1)[1:-1]
    knots = np.concatenate([np.full(degree + 1, first), inner, np.full(degree + 1, last)])
    # the middle of a slab may lie beyond its points
    X = BSpline.design_matrix(y, knots, degree, extrapolate=True).toarray()
    # Centres that leap from their neighbours do not start with a say.
    start = centers.T - median_filter(centers.T, size=(1, 11), mode="nearest")
    start = start + 1e-3 * np.sign(start)
    x = _reweighted(X, centers.T, np.broadcast_to(prior, (2, len(y))), start)[0]
    spline, breaks = BSpline(knots, x.T, degree), np.concatenate([[first], inner, [last]])
    coefficients = np.zeros((4, 2, len(breaks) - 1))
    for power in range(degree + 1):
        coefficients[power] = spline(breaks[:-1], nu=power).T / factorial(power)
    return Axis(origin, rotation, breaks, coefficients)
