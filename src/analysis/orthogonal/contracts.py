"""The two contracts between a surface and its solvers: its geometric model and its cloud.

The solvers of this folder ask nothing else of a surface. Stacks have B clouds of n points with dim
coordinates in the clouds' frames; s numbers x describe a surface, t of its parameters are free.
"""

from __future__ import annotations

from typing import Protocol

from ..result import Adjustment, Array, Fit
from .observations import Observations, Points


class GeometricModel(Protocol):
    """A kind of surface: orthogonal distances from it, and how it moves."""

    dimension: int
    """dim of the points"""
    degrees: int
    """t, the number of free parameters"""

    def distances(self, x: Array, D: Array) -> Array:
        """Distances (B, K, n) of points (B, n, dim) from K surfaces each, x (B, K, s).

        First order will do: they rank many candidates.
        """
        ...

    def linearised(self, x: Array, D: Array) -> tuple[Array, Array]:
        """Distances (…, n) of D (…, n, dim) from x (…, s); their Jacobian (…, t, n)."""
        ...

    def update(self, x: Array, step: Array) -> Array:
        """x (…, s) after a small step (…, t) in the free parameters."""
        ...

    def normals(self, x: Array, D: Array) -> Array:
        """Unit gradients (…, n, dim) of the distances of D (…, n, dim) from x (…, s)."""
        ...

    def curvature(self, x: Array, D: Array) -> Array:
        """Derivatives (…, n, dim, dim) of the normals by the places, at the feet of D on x.

        The Hessian matrices of the distances of places on the surface: symmetric, 0 along n.
        """
        ...

    def foot_points(self, x: Array, points: Points) -> Array:
        """Places (B, n, dim) on x (B, s) nearest to the points in the metric of their Q⁻¹."""
        ...


class ElementalModel(GeometricModel, Protocol):
    """A geometric model with closed forms through few points and near many."""

    sample: int
    """number of points that determine a surface"""
    fixed: bool = False
    """whether part of x is given and not estimated"""

    def with_fixed(self, x: Array) -> Array:
        """x (B, s) with its fixed part inserted."""
        return x

    def minimal_fit(self, samples: Array) -> Array:
        """x (…, s) through ``sample`` points (…, sample, dim); NaN where there is no surface."""
        ...

    def algebraic(self, D: Array, weights: Array) -> Array:
        """x (…, s) of a weighted algebraic fit to D (…, n, dim) with weights (…, n)."""
        ...


class SurfaceCloud(Protocol):
    """A stack of clouds that one kind of surface is fitted to."""

    @property
    def absolute(self) -> bool:
        """Whether the cofactors are variances in m², and not only in proportion."""
        ...

    @property
    def model(self) -> GeometricModel:
        """The geometric model of the surfaces in the clouds' frames."""
        ...

    @property
    def count(self) -> int:
        """The number n of points."""
        ...

    def observations(self) -> Observations:
        """The points with their cofactors in the frames."""
        ...

    def start(self) -> Array:
        """x (B, s) from which a least-squares adjustment starts."""
        ...

    def robust_start(self, D: Array, seed: int) -> tuple[Array, Array]:
        """x (B, s) near the half of some points D (B, m, dim) closest to one surface.

        Second, the standard deviation (B,) of their distances.
        """
        ...

    def fit(self, method: str, adjustment: Adjustment) -> Fit:
        """The result in m of an adjustment in the frames."""
        ...
