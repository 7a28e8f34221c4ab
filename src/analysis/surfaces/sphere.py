"""The sphere: orthogonal distances from it, and its fits.

As a linear errors-in-variables problem it is in :mod:`analysis.surfaces.sphere_eiv`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..adjustment.linalg import solve
from ..adjustment.wtls import triangular_factor
from ..orthogonal.cloud import Cloud
from ..orthogonal.contracts import ElementalModel, Start
from ..orthogonal.observations import Points
from ..orthogonal.start import find_start
from ..result import Adjustment, Array, Fit, FittedSurface

PARAMETERS = 4
# relative distance from the surface from which a step of Newton ends at rounding level
NEARLY = 1e-9
NO_SPHERE = "no real sphere: the squared radius δ + |k|² came out negative"


class SphereModel(ElementalModel):
    """The sphere ``|p − k| = r`` as a geometric model, x = (a, b, c, r) in the cloud's frame."""

    dimension = 3
    size = 4

    def __init__(self, fixed_radius: Array | None = None):
        """``fixed_radius`` (B,), or None for a free one."""
        self.fixed_radius = fixed_radius
        self.degrees = self.sample = 4 if fixed_radius is None else 3
        self.least_half_angle = (
            None if fixed_radius is not None else 30.0
        )  # √(1 + 3 cot⁴(θ/2)) = 24.1

    def in_frame(self, x: Array, origin: Array, length: Array) -> tuple[SphereModel, Array]:
        fixed = None if self.fixed_radius is None else self.fixed_radius / length
        centre = (x[:, :3] - origin) / length[:, None]
        return SphereModel(fixed), np.concatenate([centre, x[:, 3:] / length[:, None]], axis=-1)

    def __getitem__(self, keep) -> SphereModel:
        """The model of some of the clouds of its stack."""
        return self if self.fixed_radius is None else SphereModel(self.fixed_radius[keep])

    def with_fixed(self, x: Array) -> Array:
        """x (B, …, 4) with the fixed radius inserted."""
        if self.fixed_radius is not None:
            x[..., 3] = self.fixed_radius.reshape((-1,) + (1,) * (x.ndim - 2))
        return x

    def update(self, x: Array, step: Array) -> Array:
        """x (…, 4) after a step in the centre and, unless it is fixed, the radius.

        Of a step that would take off more than 0.8 of the radius, so much as does not.
        """
        new = x.copy()
        new[..., : self.degrees] += step
        if self.fixed_radius is None:
            over = new[..., 3] < 0.2 * x[..., 3]
            if over.any():
                share = -0.8 * x[over][..., 3:] / step[over][..., 3:]
                new[over] = x[over] + share * step[over]
        return new

    @staticmethod
    def distances(x: Array, D: Array) -> Array:
        """``|p − k| − r`` from |p|² − 2p·k + |k|², which in a centred frame loses nothing."""
        k = x[..., :3]
        squares = -2.0 * k @ D.swapaxes(-1, -2)
        squares += np.einsum("...i,...i->...", k, k)[..., None]
        squares += np.einsum("...ni,...ni->...n", D, D)[..., None, :]
        np.maximum(squares, 0.0, out=squares)
        np.sqrt(squares, out=squares)
        squares -= x[..., 3:]
        return squares

    def linearised(self, x: Array, D: Array) -> tuple[Array, Array]:
        """Distances, and their Jacobian ``(−(p − k)/|p − k|, −1)``, (…, 4 or 3, n)."""
        J = np.empty(D.shape[:-2] + (self.degrees, D.shape[-2]))
        inwards = J[..., :3, :]
        np.subtract(x[..., :3, None], D.swapaxes(-1, -2), out=inwards)
        rho = np.sqrt(np.einsum("...in,...in->...n", inwards, inwards))
        inwards /= np.maximum(rho, np.finfo(float).tiny)[..., None, :]
        J[..., 3:, :] = -1.0
        return rho - x[..., 3:], J

    @staticmethod
    def normals(x: Array, D: Array) -> Array:
        """Unit normals ``(p − k)/|p − k|``, outwards."""
        outwards = D - x[..., None, :3]
        rho = np.sqrt(np.einsum("...ni,...ni->...n", outwards, outwards))
        return outwards / np.maximum(rho, np.finfo(float).tiny)[..., None]

    @staticmethod
    def curvature(x: Array, D: Array) -> Array:
        """``(I − nnᵀ)/r``."""
        n = SphereModel.normals(x, D)
        return (np.eye(3) - n[..., :, None] * n[..., None, :]) / x[..., 3, None, None, None]

    @staticmethod
    def foot_points(x: Array, points: Points) -> Array:
        """``p̃ − k = (I + μQ)⁻¹(p − k)`` with the one root μ > −1/λ_max of ``|p̃ − k| = r``."""
        assert points.axes is not None
        k = x[:, None, :3]
        q = np.einsum("bnij,bni->jbn", points.axes, points.D - k)
        variances = np.broadcast_to(np.moveaxis(points.variances, -1, 0), q.shape)
        radius = np.broadcast_to(x[:, 3:], q.shape[1:])
        mu = _multipliers(q.reshape(3, -1), variances.reshape(3, -1), radius.ravel())
        q /= 1.0 + mu.reshape(q.shape[1:]) * variances
        return k + np.einsum("bnij,jbn->bni", points.axes, q)

    def refit(self, x: Array, D: Array, weights: Array) -> Array:
        """Weighted algebraic least squares; with a fixed radius one Gauss-Newton step."""
        if self.fixed_radius is None:
            return self._algebraic(D, weights)
        f, J = self.linearised(x, np.broadcast_to(D[:, None], x.shape[:2] + D.shape[1:]))
        weighed = J * weights[..., None, :]
        N, g = weighed @ J.swapaxes(-1, -2), weighed @ f[..., None]
        new = self.update(x, -solve(N, g)[..., 0])
        first = np.isnan(x).any(axis=-1, keepdims=True)
        return np.where(first, self._algebraic(D, weights), new) if first.any() else new

    def _algebraic(self, D: Array, weights: Array) -> Array:
        """Least squares of ``|p|² − 2p·k − δ`` (Kåsa), from the moments of the points."""
        D = D.swapaxes(-1, -2)
        rows = np.empty((len(D), 5, D.shape[-1]))
        rows[:, :3] = 2.0 * D
        rows[:, 3] = 1.0
        rows[:, 4] = np.einsum("bin,bin->bn", D, D)
        rows = rows[:, None]
        N = (rows[..., :4, :] * weights[..., None, :]) @ rows.swapaxes(-1, -2)
        return self.with_fixed(with_radius(solve(N[..., :4], N[..., 4:])[..., 0]))

    def minimal_fit(self, samples: Array) -> Array:
        """Through four points; of a fixed radius the two through three points.

        Differences of the points' equations give the centre.
        """
        first, others = samples[..., :1, :], samples[..., 1:, :]
        D = others - first
        squares = np.einsum("...ni,...ni->...n", D, D)
        if self.fixed_radius is None:
            k = solve(2.0 * D, squares[..., None])[..., 0]
            radius = np.sqrt(np.einsum("...i,...i->...", k, k))
            return np.concatenate([k + first[..., 0, :], radius[..., None]], axis=-1)
        # the centre of the circle through the points, and from it along the normal to both sides
        normal = np.cross(D[..., 0, :], D[..., 1, :])
        across = squares[..., :1] * D[..., 1, :] - squares[..., 1:] * D[..., 0, :]
        square = np.einsum("...i,...i->...", normal, normal)[..., None]
        with np.errstate(divide="ignore", invalid="ignore"):
            k = np.cross(across, normal) / (2.0 * square)
            height = self.fixed_radius[:, None] ** 2 - np.einsum("...i,...i->...", k, k)
            up = normal * np.sqrt(height[..., None] / square)
        k += first[..., 0, :]
        centres = np.concatenate([k + up, k - up], axis=1)
        return self.with_fixed(np.concatenate([centres, centres[..., :1]], axis=-1))

    def lengths(self, x: Array) -> tuple[Array, Array]:
        """The radius, unless it is fixed."""
        gradients = np.eye(4)[3 : self.degrees, : self.degrees]
        return x[:, 3 : self.degrees], np.broadcast_to(gradients, (len(x), *gradients.shape))

    @staticmethod
    def in_words(x: Array) -> str:
        return "centre {:.4f} {:.4f} {:.4f}, radius {:.4f} m".format(*x)


def _multipliers(q: Array, variances: Array, r: Array) -> Array:
    """The root μ > −1/max(v) of ``Σ_i (q_i/(1 + μ v_i))² = r²`` for each column of q (3, n).

    variances v : (3, n); r : (n,)

    Newton on 1/|y|, which is nearly linear in μ. A column that a last step has brought to rounding
    level is done: a few grazing points need three times as many steps as the rest.
    """
    limit = -1.0 / variances.max(axis=0)
    mu = np.zeros(q.shape[1])
    found, todo = mu.copy(), np.arange(q.shape[1])
    for _ in range(60):
        factors = 1.0 / (1.0 + mu * variances)
        y_squared = q * factors
        y_squared *= y_squared
        # quicker than a sum over so short an axis
        square = y_squared[0] + y_squared[1] + y_squared[2]
        excess = np.sqrt(square) - r
        y_squared *= variances
        y_squared *= factors
        slope = y_squared[0] + y_squared[1] + y_squared[2]
        step = square * excess / (r * np.maximum(slope, np.finfo(float).tiny))
        mu = np.maximum(mu + step, limit + 0.1 * (mu - limit))
        found[todo] = mu
        far = np.abs(excess) > NEARLY * r
        if not far.any():
            break
        if np.count_nonzero(far) < 0.7 * len(far):  # else the copies cost more than they save
            q, variances, r, limit, mu, todo = (
                q[:, far],
                variances[:, far],
                r[far],
                limit[far],
                mu[far],
                todo[far],
            )
    return found


def squared_radius(x: Array) -> Array:
    """``r² = δ + |k|²`` of x = (k, δ), (…)."""
    return x[..., 3] + np.einsum("...i,...i->...", x[..., :3], x[..., :3])


def real_radius(x: Array) -> Array:
    """r of x = (k, δ), (…); NaN without a real sphere."""
    square = squared_radius(x)
    return np.sqrt(np.where(square > 0, square, np.nan))


def with_radius(x: Array) -> Array:
    """(k, r) from (k, δ); NaN without a real sphere."""
    return np.concatenate([x[..., :3], real_radius(x)[..., None]], axis=-1)


@dataclass(frozen=True, eq=False, repr=False)
class SphereFit(Fit):
    """A fitted sphere; ``parameters`` are (a, b, c, r) in m."""

    NAMES = ("a", "b", "c", "r")
    SIZES = slice(3, 4)

    @property
    def center(self) -> Array:
        """(…, 3) in m."""
        return self.parameters[..., :3]

    @property
    def radius(self) -> Array:
        """(…) in m; NaN where the method found no real sphere."""
        return self.parameters[..., 3]

    def surface(self) -> FittedSurface:
        variances = np.diagonal(self.cofactor, axis1=-2, axis2=-1).reshape(-1, PARAMETERS)
        x = self.parameters.reshape(-1, PARAMETERS)
        fixed = np.all(variances[:, 3] <= 1e-12 * variances.max(axis=-1))
        model = SphereModel(x[:, 3] if fixed else None)
        J = np.eye(PARAMETERS)[:, : model.degrees]
        return FittedSurface(model, x, np.broadcast_to(J, (len(x), *J.shape)))


@dataclass(frozen=True, eq=False)
class SphereCloud(Cloud):
    """A stack of clouds around spheres; fixed_radius in m, or None for a free radius."""

    fixed_radius: float | None = None

    surface = "a sphere"

    @property
    def model(self) -> SphereModel:
        radius = self.fixed_radius
        return SphereModel(None if radius is None else radius / self.length)

    @cached_property
    def factor(self) -> Array:
        """(B, 5, 5) triangular factor of the weighted rows ``(2D, 1, |D|²)``."""
        return self.factor_of(rows)

    def least_squares(self) -> Array:
        """(B, 4): (k, δ) with the least ``Σ P r²``, in the cloud's frame."""
        return solve(self.factor[..., :4, :4], self.factor[..., :4, 4:])[..., 0]

    def start(self) -> Array:
        """Algebraic least squares; any radius of the cloud's size where it is no real sphere."""
        x = with_radius(self.least_squares())
        x[:, 3] = np.nan_to_num(x[:, 3], nan=1.0)
        return self.model.with_fixed(x)

    def robust_start(self, D: Array, seed: int, keep: slice) -> Start:
        """The best half, or the surface that chance explains worst."""
        return find_start(self.model[keep], D, seed)

    def require_surface(self) -> None:
        """Refuse points in a plane (so also on a circle, on a line or in one place)."""
        centred = triangular_factor([self.factor[..., [3, 0, 1, 2]]])[..., 1:, 1:]
        extents = np.linalg.svd(centred, compute_uv=False) * (0.5 * self.length[:, None])
        self.require_dimensions(extents, 3, flat="in one plane (or on one circle)")

    def fit(self, method: str, adjustment: Adjustment) -> SphereFit:
        """The result in m of an adjustment of (a, b, c, r) in the frame."""
        parameters = self.length[:, None] * adjustment.x
        parameters[:, :3] += self.origin
        t = adjustment.cofactor.shape[-1]
        cofactor = np.zeros((len(parameters), PARAMETERS, PARAMETERS))
        cofactor[:, :t, :t] = adjustment.cofactor * self.length[:, None, None] ** 2
        ended = adjustment.convergence
        ended = ended.failed_where(np.isnan(parameters[:, 3]) & ended.converged, NO_SPHERE)

        def distances(points: Array) -> Array:
            D = points - parameters[:, None, :3]
            return np.sqrt(np.einsum("bni,bni->bn", D, D)) - parameters[:, None, 3]

        return self.result(
            SphereFit,
            method,
            replace(adjustment, convergence=ended),
            distances,
            parameters=parameters,
            cofactor=cofactor,
        )


def rows(points: Array, origin: Array, length: Array) -> Array:
    """(B, 5, n) rows ``(2D, 1, |D|²)``, one array per column."""
    rows = np.empty((len(points), 5, points.shape[-2]))
    D = rows[:, :3]
    np.subtract(points.swapaxes(-1, -2), origin[..., None], out=D)
    D /= length[:, None, None]
    np.einsum("bin,bin->bn", D, D, out=rows[:, 4])
    D *= 2.0
    rows[:, 3] = 1.0
    return rows
