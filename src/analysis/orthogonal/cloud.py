"""A stack of clouds, centred and scaled: what all surfaces need of it before and after solving."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Self, TypeVar

import numpy as np

from ..adjustment.wtls import triangular_factor
from ..blocks import point_pieces
from ..checks import covariance_array, weight_array
from ..result import Adjustment, Array, Fit
from .contracts import GeometricModel
from .observations import Observations

# distances below this, in the frame's unit, are rounding and no reason to lose weight
ROUNDING = 1e-14

F = TypeVar("F", bound=Fit)


class DegenerateCloud(ValueError):
    """The points of the cloud with this index in its stack determine no surface, or not one."""

    def __init__(self, sentence: str, index: int):
        super().__init__(sentence)
        self.index = index


@dataclass(frozen=True, eq=False)
class Cloud:
    """A stack of clouds and the frame in which it is solved, ``D = (p − origin)/length``.

    points : (B, n, dim) as given, in m
    weights : (B, n) a-priori weights, or None for ones
    cofactors : (B, n, dim, dim) of the points, or None when they are isotropic (then weights say
        all)
    origin : (B, dim) centroid; length : (B,) a power of two near the RMS extent, so that dividing
        by it is exact
    absolute : whether the cofactors are variances in m², and not only in proportion
    """

    points: Array
    weights: Array | None
    cofactors: Array | None
    origin: Array
    length: Array
    absolute: bool = False

    surface: ClassVar[str]  # in messages, "a sphere"

    @classmethod
    def reduce(cls, points: Array, weights=None, cofactors=None, **own: Any) -> Self:
        """Centre and scale a stack (B, n, dim); ``own`` are fields of the surface's cloud.

        Raises :class:`DegenerateCloud` where the points determine no surface, as far as their
        coordinates can tell.
        """
        cloud = cls(points, weights, cofactors, *frame_of(points), **own)
        cloud.require_surface()
        cloud.require_places()
        return cloud

    @property
    def model(self) -> GeometricModel:
        """The geometric model of the surfaces in the clouds' frames."""
        raise NotImplementedError

    @property
    def count(self) -> int:
        return self.points.shape[-2]

    def cofactors_in_frame(self) -> Array:
        """(B, n) or (B, 1) variances, or (B, n, dim, dim); 1 stands for 1 m²."""
        if self.cofactors is not None:
            return self.cofactors / self.length[:, None, None, None] ** 2
        variances = np.ones((len(self.points), 1)) if self.weights is None else 1.0 / self.weights
        return variances / self.length[:, None] ** 2

    def observations(self) -> Observations:
        """The points with their cofactors in the frames."""
        return Observations.of(self.points, self.origin, self.length, self.cofactors_in_frame())

    def factor_of(self, rows: Callable[[Array, Array, Array], Array]) -> Array:
        """Triangular factor (B, k, k) of ``√P rows(points, origin, length)``, rows (B, k, n)."""

        def blocks():
            for piece in point_pieces(self.points):
                block = rows(self.points[:, piece], self.origin, self.length)
                if self.weights is not None:
                    block *= np.sqrt(self.weights[:, None, piece])
                yield block.swapaxes(-1, -2)

        return triangular_factor(blocks())

    def require_places(self) -> None:
        """Raise :class:`DegenerateCloud` if a cloud lies at fewer places than it has parameters."""
        t = self.model.degrees
        first = self.points[:, :t]
        equal = np.all(first[:, :, None] == first[:, None], axis=-1)
        # Where the first points lie at different places, that is enough.
        for bad in np.flatnonzero(np.count_nonzero(equal, axis=(1, 2)) > t):
            places = len(np.unique(self.points[bad], axis=0))
            if places < t:
                raise self.degenerate(f"points at {places} different places", bad)

    def require_surface(self) -> None:
        """Raise :class:`DegenerateCloud` if the points of a cloud determine no surface."""
        raise NotImplementedError

    def require_dimensions(self, extents: Array, needed: int, flat: str = "in one plane") -> None:
        """Raise :class:`DegenerateCloud` if a cloud spans fewer than ``needed`` dimensions.

        extents : (B, dim) singular values of the centred and weighted points in m, the largest
            first. Those that do not stand out from the rounding of the coordinates count for
            nothing.
        flat : where points lie that span two
        """
        largest = np.abs(self.origin).max(axis=-1) + self.length
        weight = 1.0 if self.weights is None else np.sqrt(self.weights.max(axis=-1))
        rounding = 16 * np.sqrt(self.count) * np.finfo(float).eps * largest * weight
        limit = np.maximum(rounding, 1e-8 * extents[:, 0])
        rank = np.count_nonzero(extents > limit[:, None], axis=-1)
        for bad in np.flatnonzero(rank < needed):
            where = ("all at one place", "on one line", flat)[rank[bad]]
            raise self.degenerate(f"points {where}", bad)

    def degenerate(self, got: str, index: int | np.integer) -> DegenerateCloud:
        """The error for points that do not determine this surface."""
        return DegenerateCloud(
            f"points: expected points that determine {self.surface}, got {got}", int(index)
        )

    def result(
        self,
        kind: type[F],
        method: str,
        adjustment: Adjustment,
        distances: Callable[[Array], Array],
        **geometry: Any,
    ) -> F:
        """The fit of this ``kind``: what all fits have in common, and the fields of its geometry.

        distances : gives those (B, m) of points (B, m, dim), a piece at a time
        """
        d = np.empty(self.points.shape[:2])
        for piece in point_pieces(self.points):
            d[:, piece] = distances(self.points[:, piece])
        weights = adjustment.weights
        return kind(
            method=method,
            sigma_0=adjustment.sigma,
            distances=d,
            weights=np.broadcast_to(1.0, d.shape) if weights is None else weights,
            **vars(adjustment.convergence),
            history=adjustment.history,
            absolute=self.absolute,
            **geometry,
        )


def frame_of(points: Array) -> tuple[Array, Array]:
    """Centroid (B, dim) and length (B,) of clouds (B, n, dim)."""
    n = points.shape[-2]
    # As a product this sum over the middle axis is ten times as fast as mean(), and any origin near
    # the centroid will do.
    origin = (np.ones((1, n)) @ points)[:, 0] / n
    squares = np.zeros(len(points))
    for piece in point_pieces(points):
        D = points[:, piece] - origin[:, None, :]
        squares += np.einsum("bni,bni->b", D, D)
    return origin, np.exp2(np.round(0.5 * np.log2(np.maximum(squares / n, np.finfo(float).tiny))))


def a_priori(weights, cofactors, shape: tuple[int, ...]) -> tuple[Array | None, Array | None]:
    """Weights (B, n) and full cofactors (B, n, dim, dim), each or None, of points of a ``shape``.

    Raises ``ValueError`` for other shapes, what is not positive (definite), and weights beside full
    cofactors.
    """
    lead, (n, dim) = shape[:-2], shape[-2:]
    if np.ndim(cofactors) >= 3 and np.shape(cofactors)[-3:] == (n, dim, dim):
        if weights is not None:
            raise ValueError(
                "weights: expected None beside full cofactors, which say all, got both"
            )
        matrices = covariance_array(cofactors, lead + (n, dim, dim), "cofactors")
        return None, matrices.reshape((-1, n, dim, dim))
    if weights is None and cofactors is None:
        return None, None
    product = np.ones(lead + (n,))
    if weights is not None:
        product *= weight_array(weights, lead + (n,))
    if cofactors is not None:
        product /= weight_array(cofactors, lead + (n,), "cofactors")
    return product.reshape((-1, n)), None
