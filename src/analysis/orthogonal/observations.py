"""Points of a stack of clouds with the cofactors of their errors, in the frames of the clouds."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..blocks import BLOCK, point_pieces
from ..result import Array


@dataclass(frozen=True)
class Points:
    """Points of a stack in its frame, with the principal axes of their cofactors.

    D : (B, n, dim); variances : (B, n) or (B, 1) of isotropic points, or (B, n, dim) along the
        ``axes``;
    axes : (B, n, dim, dim), one axis per column, or None for isotropic points
    """

    D: Array
    variances: Array
    axes: Array | None = None

    @classmethod
    def of(cls, D: Array, cofactors: Array) -> Points:
        """From cofactors (B, n) or (B, 1), or (B, n, dim, dim)."""
        return cls(D, *_principal(cofactors))

    def along(self, normals: Array) -> Array:
        """Variances ``nᵀQn`` along unit normals (B, n, dim); (B, n) or (B, 1)."""
        if self.axes is None:
            return self.variances
        return np.einsum(
            "bni,bni->bn", self.variances, np.einsum("bnij,bni->bnj", self.axes, normals) ** 2
        )

    def oblique(self) -> Array:
        """Coordinates (B, n) along an oblique direction: the points' own order."""
        return self.D @ np.sqrt([2.0, 3.0, 5.0])[: self.D.shape[-1]]

    def different(self) -> np.ndarray:
        """(B, n) bool: False for a point equal to the one before it."""
        new = np.ones(self.D.shape[:-1], dtype=bool)
        np.any(self.D[:, 1:] != self.D[:, :-1], axis=-1, out=new[:, 1:])
        return new

    def __getitem__(self, keep) -> Points:
        axes = None if self.axes is None else self.axes[keep]
        return Points(self.D[keep], self.variances[keep], axes)


@dataclass(frozen=True)
class Observations:
    """Points of a stack as given, and the frame ``(p − origin)/length`` in which they are solved.

    They are taken into it a piece at a time, so that a large cloud is never there twice.

    points : (B, n, dim) in m; origin (B, dim), length (B,) : of the frame; variances, axes : in the
        frame, as of :class:`Points`
    """

    points: Array
    origin: Array
    length: Array
    variances: Array
    axes: Array | None = None

    @classmethod
    def of(cls, points: Array, origin: Array, length: Array, cofactors: Array) -> Observations:
        """From cofactors in the frame, (B, n) or (B, 1), or (B, n, dim, dim)."""
        return cls(points, origin, length, *_principal(cofactors))

    @property
    def count(self) -> int:
        return self.points.shape[1]

    def piece(self, part: slice) -> Points:
        """Some of the points of every cloud, in the frame."""
        if len(self.points) * self.count <= BLOCK:
            return self._all  # which are one piece
        return self._piece(part)

    def all(self) -> Points:
        """The points of every cloud, in the frame; for clouds that are not large."""
        return self._all

    @cached_property
    def _all(self) -> Points:
        return self._piece(slice(0, self.count))

    def _piece(self, part: slice) -> Points:
        given = self.points[:, part].swapaxes(-1, -2)
        # one array per coordinate: what is done to all points then runs through contiguous memory
        D = np.empty(given.shape)
        np.subtract(given, self.origin[..., None], out=D)
        D /= self.length[:, None, None]
        variances = self.variances if self.variances.shape[1] == 1 else self.variances[:, part]
        axes = None if self.axes is None else self.axes[:, part]
        return Points(D.swapaxes(-1, -2), variances, axes)

    def subsample(self, count: int, seed: int) -> Observations:
        """At most ``count`` points of each cloud; neither they nor their order depend on the order.

        Taken are those whose coordinate along an oblique direction has the smallest digits from the
        sixth or seventh place on.
        """
        return self._take(self.places(count, seed))

    def places(self, count: int, seed: int) -> np.ndarray:
        """Places (B, m) in each cloud of the points that a subsample takes, in its order."""
        if count < self.count:
            scale = 1e6 * (1.0 + np.random.default_rng(seed).uniform())
            digits = np.empty(self.points.shape[:2], dtype=np.float32)
            for part in point_pieces(self.points):
                along = scale * self.piece(part).oblique()
                np.subtract(along, np.floor(along), out=digits[:, part])
            chosen = np.argpartition(digits, count - 1, axis=-1)[:, :count]
            order = self._take(chosen).places(count, seed)
            return np.take_along_axis(chosen, order, axis=-1)
        return np.argsort(self.all().oblique(), axis=-1)

    def _take(self, chosen: np.ndarray) -> Observations:
        """The points with these places (B, m) in each cloud."""
        places = np.arange(len(chosen))[:, None], chosen
        variances = self.variances if self.variances.shape[1] == 1 else self.variances[places]
        axes = None if self.axes is None else self.axes[places]
        return Observations(self.points[places], self.origin, self.length, variances, axes)

    def __getitem__(self, keep) -> Observations:
        axes = None if self.axes is None else self.axes[keep]
        return Observations(
            self.points[keep], self.origin[keep], self.length[keep], self.variances[keep], axes
        )


def _principal(cofactors: Array) -> tuple[Array, Array | None]:
    """Variances of isotropic points, or variances and axes from matrices (B, n, dim, dim)."""
    if cofactors.ndim == 2:
        return cofactors, None
    variances, axes = np.linalg.eigh(cofactors)
    return variances, axes
