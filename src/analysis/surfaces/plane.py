"""The plane ``n · p = ϱ``: orthogonal distances from it, and its fits.

As a linear errors-in-variables problem ``z = a x + b y + c`` it is in
:mod:`analysis.surfaces.plane_eiv`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ..adjustment.linalg import propagate
from ..orthogonal.cloud import Cloud
from ..orthogonal.contracts import ElementalModel, Start
from ..orthogonal.observations import Points
from ..orthogonal.start import find_start
from ..result import Adjustment, Array, Fit, FittedSurface

PARAMETERS = 3
NO_PLANE = "no plane: total least squares has no solution for these points"


class PlaneModel(ElementalModel):
    """The plane as a geometric model: x = (n, h), ``n · (p − pivot) = h`` with |n| = 1.

    Its free parameters are small rotations of n towards two tangents, and h. The pivot (B, 3) lies
    near the points; None is the origin.
    """

    dimension = 3
    degrees = 3
    size = 4
    sample = 3

    def __init__(self, pivot: Array | None = None):
        self.pivot = pivot

    def _reduced(self, points: Array) -> Array:
        return points if self.pivot is None else points - self.pivot[:, None, :]

    def in_frame(self, x: Array, origin: Array, length: Array) -> tuple[PlaneModel, Array]:
        shift = -origin if self.pivot is None else self.pivot - origin
        h = x[:, 3:] + np.sum(x[:, :3] * shift, axis=-1, keepdims=True)
        return PlaneModel(), np.concatenate([x[:, :3], h / length[:, None]], axis=-1)

    def distances(self, x: Array, D: Array) -> Array:
        """``n · (p − pivot) − h``."""
        distances = x[..., :3] @ self._reduced(D).swapaxes(-1, -2)
        distances -= x[..., 3:]
        return distances

    def linearised(self, x: Array, D: Array) -> tuple[Array, Array]:
        """Distances, and their Jacobian ``(t₁·D, t₂·D, −1)`` with two tangents t."""
        D = self._reduced(D).swapaxes(-1, -2)
        J = np.empty(D.shape[:-2] + (3, D.shape[-1]))
        np.matmul(tangents(x[..., :3]).swapaxes(-1, -2), D, out=J[..., :2, :])
        J[..., 2, :] = -1.0
        return (x[..., None, :3] @ D)[..., 0, :] - x[..., 3:], J

    @staticmethod
    def update(x: Array, step: Array) -> Array:
        """x (…, 4) after small rotations of n towards its two tangents, and a change of h."""
        n = x[..., :3] + (tangents(x[..., :3]) @ step[..., :2, None])[..., 0]
        h = x[..., 3:] + step[..., 2:]
        return np.concatenate([n, h], axis=-1) / np.linalg.norm(n, axis=-1, keepdims=True)

    @staticmethod
    def normals(x: Array, D: Array) -> Array:
        """n for every point."""
        return np.broadcast_to(x[..., None, :3], D.shape)

    @staticmethod
    def curvature(x: Array, D: Array) -> Array:
        """None: 0."""
        return np.broadcast_to(0.0, D.shape + (3,))

    def foot_points(self, x: Array, points: Points) -> Array:
        """``p̃ = p − Qn (n · p − h)/(nᵀQn)``."""
        assert points.axes is not None
        along = np.einsum("bnij,bi->bnj", points.axes, x[:, :3])
        Qn = np.einsum("bnij,bnj->bni", points.axes, points.variances * along)
        d = self.distances(x[:, None], points.D)[:, 0]
        return points.D - Qn * (d / np.einsum("bni,bi->bn", Qn, x[:, :3]))[..., None]

    @staticmethod
    def refit(x: Array, D: Array, weights: Array) -> Array:
        """Weighted principal component analysis, from the moments of the points."""
        D = D[:, None]
        total = weights.sum(axis=-1)
        mean = (weights[..., None, :] @ D)[..., 0, :] / total[..., None]
        S = (D.swapaxes(-1, -2) * weights[..., None, :]) @ D
        S -= (total[..., None] * mean)[..., :, None] * mean[..., None, :]
        n = np.linalg.eigh(S)[1][..., 0]
        return np.concatenate([n, np.sum(n * mean, axis=-1, keepdims=True)], axis=-1)

    @staticmethod
    def minimal_fit(samples: Array) -> Array:
        """Through three points; NaN where they lie on a line."""
        first = samples[..., 0, :]
        n = np.cross(samples[..., 1, :] - first, samples[..., 2, :] - first)
        length = np.linalg.norm(n, axis=-1, keepdims=True)
        n = n / np.where(length > 0, length, np.nan)
        return np.concatenate([n, np.sum(n * first, axis=-1, keepdims=True)], axis=-1)

    @staticmethod
    def in_words(x: Array) -> str:
        return "normal {:.4f} {:.4f} {:.4f}, offset {:.4f} m".format(*x)


def tangents(n: Array) -> Array:
    """Two unit vectors (…, 3, 2) across unit normals n (…, 3) and across each other.

    They are the images of e_x and e_y in the reflection that takes n to ∓e_z, which is never near
    to singular.

    >>> T = tangents(np.array([0.0, 0.6, -0.8]))
    >>> np.abs(np.round(T.T @ T, 12)).tolist()
    [[1.0, 0.0], [0.0, 1.0]]
    >>> np.abs(np.round(T.T @ [0.0, 0.6, -0.8], 12)).tolist()
    [0.0, 0.0]
    """
    v = n.copy()
    v[..., 2] += np.where(n[..., 2] < 0, -1.0, 1.0)
    T = -v[..., :, None] * (v[..., :2] / (1.0 + np.abs(n[..., 2]))[..., None])[..., None, :]
    T[..., 0, 0] += 1.0
    T[..., 1, 1] += 1.0
    return T


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class PlaneFit(Fit):
    """A fitted plane; ``parameters`` (a, b, c) of ``z = a x + b y + c``, c in m; NaN if vertical.

    normal : (…, 3) unit vector with z ≥ 0 (y, then x, decide where it is 0)
    offset : (…) in m, ``normal · p = offset``; ``distances`` are positive on the side of the normal
    normal_cofactor : (…, 4, 4) of (normal, offset), of rank 3
    centroid : (…, 3) of the points, in m
    """

    normal: Array
    offset: Array
    normal_cofactor: Array
    centroid: Array

    NAMES = ("a", "b", "c")

    @property
    def normal_covariance(self) -> Array:
        """(…, 4, 4) covariance of (normal, offset), scaled as ``covariance`` is."""
        return self.scaled(self.normal_cofactor)

    def sizes(self) -> tuple[Array, Array]:
        """One radian, and the standard deviation of the normal about its least certain axis."""
        covariance = self.normal_covariance[..., :3, :3]
        with np.errstate(invalid="ignore"):
            variance = np.trace(np.nan_to_num(covariance, nan=np.inf), axis1=-2, axis2=-1)
        deviation = np.sqrt(np.maximum(variance, 0.0))[..., None]
        return np.ones_like(deviation), deviation

    def surface(self) -> FittedSurface:
        pivot, n = self.centroid.reshape(-1, 3), self.normal.reshape(-1, 3)
        offset = np.reshape(self.offset, -1)
        h = offset - np.sum(n * pivot, axis=-1)
        derivative = _slope_jacobian(n, offset) @ _normal_jacobian(n, pivot, 1.0)
        return FittedSurface(
            PlaneModel(pivot), np.concatenate([n, h[:, None]], axis=-1), derivative
        )


@dataclass(frozen=True, eq=False)
class PlaneCloud(Cloud):
    """A stack of clouds near planes; station (3,) in m is where the scanner stood."""

    station: Array = field(default_factory=lambda: np.zeros(3))

    surface = "a plane"
    model = PlaneModel()

    @cached_property
    def factor(self) -> Array:
        """(B, 4, 4) triangular factor of the weighted rows ``(1, D)``."""
        return self.factor_of(rows)

    @cached_property
    def principal_axes(self) -> tuple[Array, Array]:
        """Singular values (B, 3) of the centred and weighted D; its axes (B, 3, 3), as columns."""
        _, extents, Vt = np.linalg.svd(self.factor[..., 1:, 1:])
        return extents, Vt.swapaxes(-1, -2)

    def mean(self) -> Array:
        """(B, 3) weighted mean of D."""
        return self.factor[:, 0, 1:] / self.factor[:, 0, :1]

    def start(self) -> Array:
        """n and h with the least ``Σ P d²``, by weighted principal component analysis."""
        n = self.principal_axes[1][..., 2]
        return np.concatenate([n, np.einsum("bi,bi->b", n, self.mean())[:, None]], axis=-1)

    def robust_start(self, D: Array, seed: int, keep: slice) -> Start:
        """The best half, or the surface that chance explains worst."""
        return find_start(self.model[keep], D, seed)

    def require_surface(self) -> None:
        """Refuse points on a line."""
        self.require_dimensions(self.principal_axes[0] * self.length[:, None], 2)

    def fit(self, method: str, adjustment: Adjustment) -> PlaneFit:
        """The result in m of an adjustment of (n, h) in the frame."""
        n = adjustment.x[:, :3]
        normal_cofactor = propagate(
            adjustment.cofactor, _normal_jacobian(n, self.origin, self.length)
        )
        sign = _sign(n)
        n, h = n * sign[:, None], adjustment.x[:, 3] * sign * self.length
        # rounding shall not decide which way a vertical plane faces
        n = np.where(np.abs(n) < 8 * np.finfo(float).eps, 0.0, n)
        offset = h + np.sum(n * self.origin, axis=-1)
        slopes = np.stack([-n[:, 0], -n[:, 1], offset], axis=-1) / _or_nan(n[:, 2:])
        adjustment = replace(
            adjustment, x=slopes, cofactor=propagate(normal_cofactor, _slope_jacobian(n, offset))
        )
        return self.described(method, adjustment, n, offset, normal_cofactor, h)

    def described(
        self,
        method: str,
        adjustment: Adjustment,
        normal: Array,
        offset: Array,
        normal_cofactor: Array,
        height: Array,
    ) -> PlaneFit:
        """The result of an adjustment of (a, b, c) in m, with what describes the planes otherwise.

        height : (B,) of the plane over the centroid along the normal, in m
        """
        ended = adjustment.convergence
        lost = ~np.isfinite(normal).all(axis=-1) & ended.converged

        def distances(points: Array) -> Array:
            D = points - self.origin[:, None, :]
            return (D @ normal[..., None])[..., 0] - height[:, None]

        return self.result(
            PlaneFit,
            method,
            replace(adjustment, convergence=ended.failed_where(lost, NO_PLANE)),
            distances,
            parameters=adjustment.x,
            cofactor=adjustment.cofactor,
            normal=normal,
            offset=offset,
            normal_cofactor=normal_cofactor,
            centroid=self.origin,
        )


def rows(points: Array, origin: Array, length: Array) -> Array:
    """(B, 4, n) rows ``(1, D)``."""
    rows = np.empty((len(points), 4, points.shape[-2]))
    rows[:, 0] = 1.0
    np.subtract(points.swapaxes(-1, -2), origin[..., None], out=rows[:, 1:])
    rows[:, 1:] /= length[:, None, None]
    return rows


def _sign(n: Array) -> Array:
    """−1 for normals (B, 3) that point the wrong way: z ≥ 0; if 0, y decides; if 0 too, x."""
    x, y, z = np.where(np.abs(n) < 8 * np.finfo(float).eps, 0.0, n).T
    return np.where((z < 0) | ((z == 0) & ((y < 0) | ((y == 0) & (x < 0)))), -1.0, 1.0)


def _or_nan(values: Array) -> Array:
    return np.where(values == 0, np.nan, values)


def _normal_jacobian(n: Array, pivot: Array, length) -> Array:
    """(B, 4, 3) of (n, offset = length · h + n · pivot) by the rotations of n and h."""
    J = np.zeros((len(n), 4, 3))
    J[:, :3, :2] = T = tangents(n)
    J[:, 3, :2] = (pivot[:, None, :] @ T)[:, 0]
    J[:, 3, 2] = length
    return J


def _slope_jacobian(n: Array, offset: Array) -> Array:
    """(B, 3, 4) of (a, b, c) = (−n_x, −n_y, offset)/n_z by (n, offset); NaN if vertical."""
    z = _or_nan(n[:, 2])
    J = np.zeros((len(n), 3, 4))
    J[:, [0, 1, 2], [0, 1, 3]] = np.stack([-1.0 / z, -1.0 / z, 1.0 / z], axis=-1)
    J[:, :, 2] = -np.stack([-n[:, 0], -n[:, 1], offset], axis=-1) / (z * z)[:, None]
    return J
