"""The two contracts between a surface and its solvers: its geometric model and its cloud.

The solvers of this folder ask nothing else of a surface. Stacks have B clouds of n points with dim
coordinates in the clouds' frames; s numbers x describe a surface, t of its parameters are free.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol, Self

import numpy as np

from ..result import Adjustment, Array, Fit
from .observations import Observations, Points


class Start(NamedTuple):
    """Surfaces of a stack that a robust adjustment starts from.

    x : (B, s); spread : (B,) of the distances, as a standard deviation
    number : (B,) of closest points that they rest on
    half : (B,) bool, whether these are the half that least trimmed squares takes
    """

    x: Array
    spread: Array
    number: np.ndarray
    half: np.ndarray


class GeometricModel(Protocol):
    """A kind of surface: orthogonal distances from it, and how it moves."""

    dimension: int
    """dim of the points"""
    degrees: int
    """t, the number of free parameters"""
    least_half_angle: float | None = None
    """half angle in degrees that the normals of the points should span, of a curved surface

    It is where an error common to points at the edge moves a length of the surface 25 times as far:
    ``√(n q) = 25`` with the length's cofactor q from n points spread evenly.
    """

    def __getitem__(self, keep) -> Self:
        """The model of some of the clouds of its stack."""
        return self

    def distances(self, x: Array, D: Array) -> Array:
        """Distances (B, K, n) of points (B, n, dim) from K surfaces each, x (B, K, s).

        First order will do: they rank many candidates.
        """
        ...

    def linearised(self, x: Array, D: Array) -> tuple[Array, Array]:
        """Distances (…, n) of D (…, n, dim) from x (…, s); their Jacobian (…, t, n)."""
        ...

    def in_frame(self, x: Array, origin: Array, length: Array) -> tuple[GeometricModel, Array]:
        """The model and x (B, s) of the same surfaces in frames ``(p − origin)/length``.

        origin : (B, dim); length : (B,)
        """
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

    size: int
    """s, the number of numbers x"""
    sample: int
    """number of points that determine a surface"""

    def minimal_fit(self, samples: Array) -> Array:
        """x (B, S, s) through samples (B, S′, ``sample``, dim), one or more each.

        NaN where there is no surface.
        """
        ...

    def refit(self, x: Array, D: Array, weights: Array) -> Array:
        """Fits (B, K, s) to points D (B, n, dim) with weights (B, K, n), in closed form.

        Where there is none, one step from x (B, K, s); NaN asks for a first fit.
        """
        ...

    def lengths(self, x: Array) -> tuple[Array, Array]:
        """Lengths (B, q) that x (B, s) must have to be a surface; their gradients (B, q, t)."""
        return np.empty((len(x), 0)), np.empty((len(x), 0, self.degrees))

    def in_words(self, x: Array) -> str:
        """One surface x (s,) in a sentence, lengths in m."""
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

    def robust_start(self, D: Array, seed: int, keep: slice) -> Start:
        """Surfaces near most of some points D (B, m, dim) of some of the clouds.

        Or those that chance explains worst. The points lie at different places.
        """
        ...

    def fit(self, method: str, adjustment: Adjustment) -> Fit:
        """The result in m of an adjustment in the frames."""
        ...
