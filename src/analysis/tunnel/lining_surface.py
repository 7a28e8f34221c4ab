"""A smooth surface of radial residuals over a piece of lining, not pulled by what is fixed to it.

The surface s(α, w) is a tensor product of cubic B-splines, periodic in α. Their knots are half a
metre apart: a dent of the lining is wider than that and is followed, a cable or a lamp is narrower
and is left standing off. What covers the wall over more than about 0.3 m in every direction, but
stands off by less than the surface's reach, cannot be told from a dent.

The points are summed on a grid of pixels of 5 cm, so that an iteration costs a few sums over the
points and one small system. Its matrix comes from the grid by two products (Eilers, Currie & Durbán
2006); they are sparse and the matrix is banded, because a B-spline overlaps with few others. The
iteration is reweighted least squares: first with weights 1/|e|, whose limit is a median surface
that a local minority does not move, then from there with IGG III weights.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import solveh_banded
from scipy.sparse import csr_array

from ..adjustment.weights import IGG3
from .medians import median_scale

PIXEL = 0.05  # m
KNOTS = 0.5  # m, and farther apart where there are fewer than so many points
POINTS_A_KNOT = 20
MEDIAN_STEPS, STEPS = 12, 12
SETTLED = 2e-5  # m
# What a pixel can say of a smooth surface is limited by the wall's roughness and not by the number
# of its points.
POINTS_THAT_COUNT = 20.0
RIDGE = 0.1  # of one point, towards the cylinder, where there are no points
ROUGHNESS = 0.001  # m; no lining is smoother, and no scale smaller
# σ: full weight up to 2 and none beyond 4, so that each point that may count as lining (3 σ) has a
# say. Below the thresholds of the other robust fits, because what is fixed to the wall lies on one
# side of it and pulls the surface; the efficiency of 96 % instead of 98 % is no loss with so many
# points.
THRESHOLDS = (2.0, 4.0)
WEIGHTS = IGG3(*THRESHOLDS)


@dataclass(frozen=True)
class PixelGrid:
    """A grid over α ∈ [−π, π) and w ∈ [start, end] with the B-splines at its pixel centres.

    across (Pα, Kα) and along (Pw, Kw) : the basis functions at the pixel centres
    """

    start: float
    end: float
    across: csr_array
    along: csr_array

    @classmethod
    def of(cls, radius: float, start: float, end: float, count: int) -> PixelGrid:
        """For a piece of tunnel with ``count`` points on it."""
        circumference, length = 2.0 * np.pi * radius, end - start
        apart = max(KNOTS, np.sqrt(POINTS_A_KNOT * circumference * length / count))
        around, along = max(16, round(circumference / PIXEL)), max(4, round(length / PIXEL))
        return cls(
            start,
            end,
            _periodic_basis(_centres(around), max(8, round(circumference / apart))),
            _open_basis(_centres(along), max(1, round(length / apart))),
        )

    @property
    def shape(self) -> tuple[int, int]:
        return self.across.shape[0], self.along.shape[0]

    def places(self, angle: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """α and w in pixels, from the edge of the first one."""
        rows, columns = self.shape
        length = self.end - self.start
        return (angle + np.pi) * (rows / (2.0 * np.pi)), (along - self.start) * (columns / length)

    def pixels(self, angle: np.ndarray, along: np.ndarray) -> np.ndarray:
        """Number of the pixel each point lies in, (n,)."""
        rows, columns = self.shape
        i, j = self.places(angle, along)
        row, column = np.clip(i.astype(np.int64), 0, rows - 1), j.astype(np.int64)
        return row * columns + np.clip(column, 0, columns - 1)

    def interpolated(self, values: np.ndarray, angle: np.ndarray, along: np.ndarray) -> np.ndarray:
        """Bilinear between the values (Pα, Pw) at the pixel centres."""
        rows, columns = self.shape
        i, j = self.places(angle, along)
        i, j = i - 0.5, np.clip(j - 0.5, 0.0, columns - 1.0)
        row, column = np.floor(i).astype(np.int64), np.minimum(j.astype(np.int64), columns - 2)
        x, y = i - row, j - column
        flat = values.ravel()
        first, second = row % rows * columns + column, (row + 1) % rows * columns + column
        below = flat[first] * (1.0 - y) + flat[first + 1] * y
        return below * (1.0 - x) + (flat[second] * (1.0 - y) + flat[second + 1] * y) * x

    def smoothed(self, weights: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Weighted least-squares spline of ``values`` at the pixel centres, (Pα, Pw)."""
        across, along, lower, diagonal, column = self._equations
        k, m = self.across.shape[1], self.along.shape[1]
        N = np.zeros((diagonal.max() + 1, k * m))  # the diagonals of its lower half
        N[diagonal, column] = (across @ weights @ along.T)[lower]
        N[0] += RIDGE
        right = self.across.T @ (weights * values) @ self.along
        coefficients = solveh_banded(N, right.ravel(), lower=True)
        return self.across @ coefficients.reshape(k, m) @ self.along.T

    @cached_property
    def _equations(self) -> tuple[csr_array, csr_array, np.ndarray, np.ndarray, np.ndarray]:
        """Products of basis functions and their places in the lower half of the normal matrix."""
        (p, q), across = _overlapping(self.across)
        (r, s), along = _overlapping(self.along)
        m = self.along.shape[1]
        row, column = np.add.outer(p * m, r), np.add.outer(q * m, s)
        lower = row >= column
        return across, along, lower, (row - column)[lower], column[lower]


def _centres(pixels: int) -> np.ndarray:
    """Centres of equal pixels of [0, 1]."""
    return (np.arange(pixels) + 0.5) / pixels


def _overlapping(basis: csr_array) -> tuple[np.ndarray, csr_array]:
    """Pairs (2, L) of basis functions that overlap, and their products (L, P)."""
    pairs = np.array((basis.T @ basis).nonzero())
    basis = basis.toarray().T
    return pairs, csr_array(basis[pairs[0]] * basis[pairs[1]])


def _open_basis(x: np.ndarray, intervals: int) -> csr_array:
    """Cubic B-splines over ``intervals`` equal parts of [0, 1] at x, (n, intervals + 3)."""
    knots = np.arange(-3, intervals + 4) / intervals
    return BSpline.design_matrix(x, knots, 3)


def _periodic_basis(x: np.ndarray, intervals: int) -> csr_array:
    """Periodic cubic B-splines at x, (n, intervals).

    In the order 0, −1, 1, −2, …, in which neighbours on the ring stay near one another.
    """
    basis = _open_basis(x, intervals).toarray()
    basis[:, :3] += basis[:, -3:]
    place = np.arange(intervals)
    return csr_array(basis[:, np.where(place % 2, -(place + 1) // 2, place // 2) % intervals])


def fitted(grid: PixelGrid, pixel: np.ndarray, d: np.ndarray) -> np.ndarray:
    """The surface at the pixel centres, (Pα, Pw), of residuals d (n,) of points in given pixels."""
    count = np.prod(grid.shape)
    surface = np.zeros(count)
    for step in range(MEDIAN_STEPS + STEPS):
        e = d - surface[pixel]
        scale = median_scale(e, ROUGHNESS)
        weights = (
            scale / np.maximum(np.abs(e), scale)
            if step < MEDIAN_STEPS
            else WEIGHTS.weight(e / scale)
        )
        total: np.ndarray = np.bincount(pixel, weights, count)
        mean = np.bincount(pixel, weights * d, count) / np.maximum(total, 1e-12)
        total /= 1.0 + total / POINTS_THAT_COUNT
        new = grid.smoothed(total.reshape(grid.shape), mean.reshape(grid.shape)).ravel()
        change = np.abs(new - surface)[total > 0].max(initial=0.0)
        surface = new
        if step > MEDIAN_STEPS and change <= SETTLED:
            break
    return surface.reshape(grid.shape)
