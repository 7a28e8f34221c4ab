"""The axis of a tunnel: a curve x(y), z(y) in a frame that runs along the tunnel.

Local frame: Z up, Y along the tunnel (horizontal), X = Y × Z to the right when looking along +Y. Li
et al. (2015) scan with Y along the tunnel, so their frame is the identity; :func:`local_frame`
finds it for a tunnel of any direction.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..blocks import pieces
from ..checks import point_array, real_array


@dataclass(frozen=True, eq=False)
class Axis:
    """A tunnel axis: piecewise polynomials x(y), z(y) in the local frame.

    It continues straight beyond its ends.

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
                "quadratics: expected an axis of one quadratic, got a cubic spline of "
                f"{self.coefficients.shape[-1]} pieces"
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
        """Local y (n,) of the axis points nearest to points (n, 3).

        The root of ``(P − p(y))ᵀ τ(y) = 0``, by Newton.

        Li et al. (2015), eqs. (2)-(3), search a list of axis points for it. Memory does not grow
        with n beyond the result.
        """
        points = point_array(points, 3, 0, "foot points") if len(points) else np.empty((0, 3))
        y = np.empty(len(points))
        for piece in pieces(len(points)):
            y[piece] = self._feet(self.to_local(points[piece]))
        return y

    def polar(self, points) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Local y of the foot points, radii (m) and angles (rad, + right) of points (n, 3)."""
        y, radius, angle = (np.empty(len(points)) for _ in range(3))
        for piece in pieces(len(points)):
            local = self.to_local(points[piece])
            y[piece] = self._feet(local)
            (x, z), slope, _ = self.local_curve(y[piece])
            right, up, _ = self._local_frame(slope)
            offset = local - np.stack([x, y[piece], z], axis=-1)
            u, v = np.einsum("ni,ni->n", offset, right), np.einsum("ni,ni->n", offset, up)
            radius[piece], angle[piece] = np.hypot(u, v), np.arctan2(u, v)
        return y, radius, angle

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
        """Arc length from the beginning of pieces to local y in them: 16 Gauss points per piece."""
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
    """Origin (3,) and rotation (3, 3) of the frame with Y along the tunnel of points (n, 3).

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
    points = tunnel_points(points)
    low, high = points.min(axis=0), points.max(axis=0)
    middle = 0.5 * (low + high)
    parts = []
    for piece in pieces(len(points), 2**20):
        east, north = np.floor((points[piece, :2] - middle[:2]) / 0.5).astype(np.int64).T
        parts.append(np.unique(east * 2**32 + north))  # one number a cell sorts faster than two
    cells = np.unique(np.concatenate(parts))
    north = (cells + 2**31) % 2**32 - 2**31
    places = np.stack([(cells - north) / 2**32, north], axis=-1)
    places -= places.mean(axis=0)
    direction = np.linalg.svd(places, full_matrices=False)[2][0]
    rotation = _rotation(direction * np.sign(direction[np.argmax(np.abs(direction))]))
    length, width = 0.5 * np.ptp(places @ rotation[:2, :2].T, axis=0)[::-1]
    height = high[2] - low[2]
    if not length > 1.5 * max(width, height):
        raise ValueError(
            "points: expected a tunnel at least 1.5 times as long as wide and high, with Z up, in "
            f"m; got {length:.4g} long, {width:.4g} wide and {height:.4g} high"
        )
    return middle, rotation


def _rotation(direction: np.ndarray) -> np.ndarray:
    """Rows X, Y, Z of the frame whose Y is the horizontal direction (2,)."""
    e, n = direction / np.hypot(*direction)
    return np.array([[n, -e, 0.0], [e, n, 0.0], [0.0, 0.0, 1.0]])


def tunnel_points(points, needed_for: str = "a tunnel axis", minimum: int = 100) -> np.ndarray:
    """One cloud (n, 3) of at least ``minimum`` points, or a ``ValueError`` that says what came."""
    points = point_array(points, 3, minimum, needed_for)
    if points.ndim != 2:
        raise ValueError(f"points: expected one cloud of shape (n, 3), got {points.shape}")
    return points
