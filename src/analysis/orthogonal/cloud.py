"""What every geometry is given and supplies: a stack of clouds, centred and scaled; a model; the
result of its adjustment.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..adjustment.iteration import Convergence
from ..adjustment.wtls import triangular_factor
from ..blocks import BLOCK, pieces

# distances below this, in the frame's unit, are rounding and no reason to lose weight
ROUNDING = 1e-14


@dataclass(frozen=True, eq=False)
class Cloud:
    """A stack of clouds and the frame in which it is solved, ``D = (p − origin)/length``.

    points : (B, n, dim) as given, in m
    weights : (B, n) a-priori weights, or None for ones
    cofactors : (B, n, dim, dim) of the points, or None when they are isotropic (then weights say
        all)
    first : index of the first of these clouds in the whole stack, or None where one cloud is all
        there is
    origin : (B, dim) centroid; length : (B,) a power of two near the RMS extent, so that dividing
        by it is exact
    """

    points: np.ndarray
    weights: np.ndarray | None
    cofactors: np.ndarray | None
    first: int | None
    origin: np.ndarray
    length: np.ndarray

    # (model, D, seed) → x and spread, of a geometry for which samples of points are no start
    trimmed_start = None

    @property
    def count(self) -> int:
        return self.points.shape[-2]

    def cofactors_in_frame(self) -> np.ndarray:
        """(B, n) or (B, 1) variances, or (B, n, dim, dim); 1 stands for 1 m²."""
        if self.cofactors is not None:
            return self.cofactors / self.length[:, None, None, None] ** 2
        return (
            np.ones((len(self.points), 1)) if self.weights is None else 1.0 / self.weights
        ) / self.length[:, None] ** 2

    def observations(self) -> Observations:
        """The points with their cofactors, to be taken into the frame a piece at a time."""
        cofactors = self.cofactors_in_frame()
        principal = (cofactors,) if cofactors.ndim == 2 else np.linalg.eigh(cofactors)
        return Observations(self.points, self.origin, self.length, *principal)

    def pieces(self) -> list[slice]:
        """Pieces of the point axis such that all clouds of the stack together fill a block."""
        return pieces(self.count, max(1, BLOCK // len(self.points)))

    def factor_of(self, rows) -> np.ndarray:
        """Triangular factor (B, k, k) of the rows ``√P rows(points, origin, length)``, (B, k, n)
        made a block at a time.
        """

        def blocks():
            for piece in self.pieces():
                block = rows(self.points[:, piece], self.origin, self.length)
                if self.weights is not None:
                    block *= np.sqrt(self.weights[:, None, piece])
                yield block.swapaxes(-1, -2)

        return triangular_factor(blocks())

    def degenerate(self, extents: np.ndarray, needed: int) -> tuple[int, int] | None:
        """Index in the stack and dimension of the first cloud that spans fewer than ``needed``
        dimensions, or None.

        extents : (B, dim) singular values of the centred and weighted points in m, the largest
            first. Those that do not stand out from the rounding of the coordinates count for
            nothing.
        """
        largest = np.abs(self.origin).max(axis=-1) + self.length
        weight = 1.0 if self.weights is None else np.sqrt(self.weights.max(axis=-1))
        rounding = 16 * np.sqrt(self.count) * np.finfo(float).eps * largest * weight
        rank = np.count_nonzero(
            extents > np.maximum(rounding, 1e-8 * extents[:, 0])[:, None], axis=-1
        )
        bad = np.flatnonzero(rank < needed)
        return (int(bad[0]), int(rank[bad[0]])) if len(bad) else None

    def name(self, index: int) -> str:
        """`` in cloud 7 of the stack``, or nothing where there is only one."""
        return "" if self.first is None else f" in cloud {self.first + index} of the stack"


def frame_of(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centroid (B, dim) and length (B,) of clouds (B, n, dim)."""
    n = points.shape[-2]
    # As a product this sum over the middle axis is ten times as fast as mean(), and any origin near
    # the centroid will do.
    origin = (np.ones((1, n)) @ points)[:, 0] / n
    squares = np.zeros(len(points))
    for piece in pieces(n, max(1, BLOCK // len(points))):
        D = points[:, piece] - origin[:, None, :]
        squares += np.einsum("bni,bni->b", D, D)
    return origin, np.exp2(np.round(0.5 * np.log2(np.maximum(squares / n, np.finfo(float).tiny))))


class GeometricModel(Protocol):
    """What a geometry must supply; x (…, s) numbers that describe a surface, D (…, n, dim) unless
    something else is said.
    """

    dimension: int  # of the points
    degrees: int  # t, the free parameters of a surface
    sample: int  # points that determine one surface
    holds: bool  # whether part of x is given and not estimated

    # of the points (B, n, dim) from K surfaces each, x (B, K, s); (B, K, n)
    def distances(self, x, D): ...

    # distances (…, n) and their Jacobian with respect to the free parameters, (…, t, n)
    def linearised(self, x, D): ...

    def moved(self, x, step): ...  # x (…, s) after a small step (…, t) in the free parameters

    def normals(self, x, D): ...  # their unit gradients with respect to the points, (…, n, dim)

    # the place on the surface nearest to each of the Points in the metric of its Q⁻¹
    def adjusted(self, x, points): ...

    def algebraic(self, D, weights): ...  # x (…, s) of a weighted algebraic fit

    def held(self, x): ...  # x with what is held put in

    # x (…, s) through `sample` points (…, sample, dim), NaN where there is none
    def through(self, samples): ...


@dataclass(frozen=True)
class Points:
    """The points of a stack in the caller's frame with the principal axes of their cofactors.

    D : (B, n, dim); variances : (B, n) or (B, 1) of isotropic points, or (B, n, dim) along the
        ``axes``;
    axes : (B, n, dim, dim), one axis a column, or None for isotropic points
    """

    D: np.ndarray
    variances: np.ndarray
    axes: np.ndarray | None = None

    @classmethod
    def of(cls, D: np.ndarray, cofactors: np.ndarray) -> Points:
        """From cofactors (B, n) or (B, 1), or (B, n, dim, dim)."""
        return cls(D, cofactors) if cofactors.ndim == 2 else cls(D, *np.linalg.eigh(cofactors))

    def along(self, normals: np.ndarray) -> np.ndarray:
        """Variances ``nᵀQn`` along unit normals (B, n, dim); (B, n) or (B, 1)."""
        if self.axes is None:
            return self.variances
        return np.einsum(
            "bni,bni->bn", self.variances, np.einsum("bnij,bni->bnj", self.axes, normals) ** 2
        )

    def oblique(self) -> np.ndarray:
        """Coordinates (B, n) along a fixed oblique direction, by which points have an order of
        their own.
        """
        return self.D @ np.sqrt([2.0, 3.0, 5.0])[: self.D.shape[-1]]

    def piece(self, part: slice) -> Points:
        """Some of the points of every cloud."""
        variances = self.variances if self.variances.shape[1] == 1 else self.variances[:, part]
        return Points(self.D[:, part], variances, None if self.axes is None else self.axes[:, part])

    def __getitem__(self, keep) -> Points:
        return Points(
            self.D[keep], self.variances[keep], None if self.axes is None else self.axes[keep]
        )


@dataclass(frozen=True)
class Observations:
    """The points of a stack as they were given; into its frame a large cloud is taken a piece at a
    time, so that it is never there twice.

    points : (B, n, dim) in m; origin (B, dim), length (B,) : of the frame; variances, axes : in the
        frame, as of :class:`Points`
    """

    points: np.ndarray
    origin: np.ndarray
    length: np.ndarray
    variances: np.ndarray
    axes: np.ndarray | None = None

    @property
    def count(self) -> int:
        return self.points.shape[1]

    def pieces(self) -> list[slice]:
        """Pieces of the point axis such that all clouds of the stack together fill a block."""
        return pieces(self.count, max(1, BLOCK // len(self.points)))

    def piece(self, part: slice) -> Points:
        """Some of the points of every cloud, in the frame."""
        given = self.points[:, part].swapaxes(-1, -2)
        # one array a coordinate: what is done to all points then runs through contiguous memory
        D = np.empty(given.shape)
        np.subtract(given, self.origin[..., None], out=D)
        D /= self.length[:, None, None]
        variances = self.variances if self.variances.shape[1] == 1 else self.variances[:, part]
        return Points(
            D.swapaxes(-1, -2), variances, None if self.axes is None else self.axes[:, part]
        )

    def all(self) -> Points:
        """The points of every cloud, in the frame; for clouds that are not large."""
        return self.piece(slice(None))

    def drawn(self, count: int, seed: int) -> Observations:
        """At most ``count`` points of each cloud in a canonical order; neither they nor it depend
        on the order given.

        Drawn are those whose coordinate along an oblique direction has the smallest digits from the
        sixth or seventh place on.
        """
        if count < self.count:
            scale = 1e6 * (1.0 + np.random.default_rng(seed).uniform())
            digits = np.empty(self.points.shape[:2], dtype=np.float32)
            for part in self.pieces():
                along = scale * self.piece(part).oblique()
                np.subtract(along, np.floor(along), out=digits[:, part])
            return self._taken(np.argpartition(digits, count - 1, axis=-1)[:, :count]).drawn(
                count, seed
            )
        return self._taken(np.argsort(self.all().oblique(), axis=-1))

    def _taken(self, chosen: np.ndarray) -> Observations:
        """The points with these places (B, m) in each cloud."""
        cloud = np.arange(len(chosen))[:, None]
        variances = (
            self.variances if self.variances.shape[1] == 1 else self.variances[cloud, chosen]
        )
        axes = None if self.axes is None else self.axes[cloud, chosen]
        return Observations(self.points[cloud, chosen], self.origin, self.length, variances, axes)

    def __getitem__(self, keep) -> Observations:
        axes = None if self.axes is None else self.axes[keep]
        return Observations(
            self.points[keep], self.origin[keep], self.length[keep], self.variances[keep], axes
        )


@dataclass(frozen=True)
class Adjusted:
    """Result of an adjustment in the cloud's frame.

    x (B, s); cofactor (B, t, t) of the free parameters; sigma (B,) at cofactor 1; weights (B, n) or
    None for ones; convergence.
    """

    x: np.ndarray
    cofactor: np.ndarray
    sigma: np.ndarray
    weights: np.ndarray | None
    convergence: Convergence
