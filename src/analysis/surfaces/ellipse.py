"""The ellipse in the plane: orthogonal distances from it, and the methods that fit it.

    p = (u0, v0) + S e,   |e| = 1,   S = [m + g, h; h, m − g]

with m = (a + b)/2 and (g, h) = (a − b)/2 · (cos 2φ, sin 2φ). In these five numbers a circle is
nothing special: the adjustment and its covariance stay regular where the direction φ of the major
axis is lost. What a fit reports as ``parameters`` is (u0, v0, a, b, φ); what its covariance is good
for at any shape are functions of (u0, v0, m, g, h).

The foot of a point is the place on the ellipse nearest to it. It is found in the axes of the
ellipse from one scalar equation per point, whose Newton iteration rises to the root from below for
every point: inside, at the centre, on an axis.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..adjustment.iteration import Ending, Stack, iterate
from ..adjustment.linalg import cofactor_from_normal, propagate, solve, unit_weight_sd
from ..adjustment.weights import IGG3, PRINTED_THRESHOLDS, ROUNDED_MAD_TO_SD
from ..checks import check_positive, check_whole_number
from ..orthogonal.cloud import ROUNDING, Cloud
from ..orthogonal.contracts import ElementalModel, Start
from ..orthogonal.observations import Points
from ..orthogonal.start import find_start
from ..result import Adjustment, Array, Fit, FittedSurface
from .conic import axes_of, conic_of, direct_from_factor, direct_from_points, ellipse_of, rows
from .conic import minimal_fit as conic_minimal_fit

PARAMETERS = 5
SETTLED = 1e-10  # change of the robust direct ellipse, in the frame's unit
NEAREST_TO_ZERO = 1e-30  # coordinate of a point in the ellipse's own unit
# A fit to points on one branch of a hyperbola runs away along ellipses that only grow. Mean
# semi-axis in units of the cloud's extent,
LARGEST = 1e4  # beyond which that is so however the iteration ended
LARGE = 100.0  # beyond which it is the reason for not converging
NO_ELLIPSE = (
    "no ellipse: the points lie closer to a parabola or hyperbola, "
    "towards which ellipses grow without end"
)
NOT_NATURAL = "no ellipse: without the condition that it be one, the best conic is a hyperbola"


class EllipseModel(ElementalModel):
    """The ellipse as a geometric model, x = (u0, v0, m, g, h) in the cloud's frame."""

    dimension = 2
    degrees = size = sample = PARAMETERS
    least_half_angle = 75.0

    @staticmethod
    def in_frame(x: Array, origin: Array, length: Array) -> tuple[EllipseModel, Array]:
        length = length[:, None]
        return EllipseModel(), np.concatenate([x[:, :2] - origin, x[:, 2:]], axis=-1) / length

    @staticmethod
    def update(x: Array, step: Array) -> Array:
        """x after a step, shortened if longer than m, or to take off 0.8 of the minor semi-axis."""
        b, new = _minor(x), _minor(x + step)
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.minimum(1.0, x[..., 2] / np.linalg.norm(step, axis=-1))
            # The minor semi-axis is a concave function of x: on the way it is nowhere below its
            # chord.
            share = np.where(new < 0.2 * b, np.minimum(share, 0.8 * b / (b - new)), share)
        return x + np.where(np.isfinite(share), share, 1.0)[..., None] * step

    @staticmethod
    def distances(x: Array, D: Array) -> Array:
        """First order: ``(|q| − 1)|q|/|S⁻¹q|``, q = S⁻¹(p − centre); exact for a circle.

        Good enough to rank candidates, of which there are many: two quadratic forms, and no
        iteration.
        """
        monomials = rows(D[..., 0], D[..., 1])[..., [3, 4, 5, 1, 2, 0], :]
        square = conic_of(x) @ monomials
        square += 1.0  # |q|²
        np.maximum(square, 0.0, out=square)
        # S² = [m² + g² + h² + 2mg, 2mh; ·, ·] is the matrix of another ellipse, with the squares of
        # the semi-axes.
        m, g, h = x[..., 2], x[..., 3], x[..., 4]
        squared = np.stack(
            [x[..., 0], x[..., 1], m * m + g * g + h * h, 2.0 * m * g, 2.0 * m * h], axis=-1
        )
        slope = conic_of(squared) @ monomials
        slope += 1.0  # |S⁻¹q|²
        np.maximum(slope, np.finfo(float).tiny, out=slope)
        np.sqrt(slope, out=slope)
        square -= np.sqrt(square)
        square /= slope
        return square

    @staticmethod
    def linearised(x: Array, D: Array) -> tuple[Array, Array]:
        """Orthogonal distances and their Jacobian.

        The distance is ``n · (p − centre − S e)``, and its derivative −n · ∂(centre + S e)/∂x at
        fixed e, because neither the foot's move along the ellipse nor the normal's turn changes it.
        """
        P, e, normals = _feet(x, D)
        (eu, ev), (nu, nv) = np.moveaxis(e, -2, 0), np.moveaxis(normals, -2, 0)
        m, g, h = np.moveaxis(x[..., 2:, None], -2, 0)
        J = -np.stack([nu, nv, nu * eu + nv * ev, nu * eu - nv * ev, nu * ev + nv * eu], axis=-2)
        d = (
            np.einsum("...in,...in->...n", normals, P)
            + m * J[..., 2, :]
            + g * J[..., 3, :]
            + h * J[..., 4, :]
        )
        return d, J

    @staticmethod
    def normals(x: Array, D: Array) -> Array:
        """Unit normals at the feet, outwards."""
        return _feet(x, D)[2].swapaxes(-1, -2)

    @staticmethod
    def curvature(x: Array, D: Array) -> Array:
        """``κ ttᵀ`` with the unit tangent t and ``κ = ab/|dp/dτ|³`` at the foot."""
        _, e, normals = _feet(x, D)
        t = np.stack([-normals[..., 1, :], normals[..., 0, :]], axis=-1)
        kappa = _area(x)[..., None] / _speed(x, e) ** 3
        return kappa[..., None, None] * t[..., :, None] * t[..., None, :]

    @staticmethod
    def foot_points(x: Array, points: Points) -> Array:
        """Feet on the ellipse that T makes of this one, in coordinates ``T p`` with ``TᵀT = Q⁻¹``.

        T is each point's own.
        """
        assert points.axes is not None
        sd = np.sqrt(points.variances)
        centre = x[:, None, :2]
        q = np.einsum("bnij,bni->bnj", points.axes, points.D - centre) / sd
        T_S = points.axes.swapaxes(-1, -2) @ _matrix(x)[:, None] / sd[..., None]
        H = T_S @ T_S.swapaxes(-1, -2)  # whose eigenvalues are the squared semi-axes
        half_sum = 0.5 * (H[..., 0, 0] + H[..., 1, 1])
        half_difference = 0.5 * (H[..., 0, 0] - H[..., 1, 1])
        a = np.sqrt(half_sum + np.hypot(half_difference, H[..., 0, 1]))
        b = np.abs(T_S[..., 0, 0] * T_S[..., 1, 1] - T_S[..., 0, 1] * T_S[..., 1, 0]) / a
        angle = 0.5 * np.arctan2(H[..., 0, 1], half_difference)
        c, s = np.cos(angle), np.sin(angle)
        ct, st = _eccentric(c * q[..., 0] + s * q[..., 1], c * q[..., 1] - s * q[..., 0], a, b)
        foot = np.stack([c * a * ct - s * b * st, s * a * ct + c * b * st], axis=-1)
        return centre + np.einsum("bnij,bnj->bni", points.axes, sd * foot)

    @staticmethod
    def refit(x: Array, D: Array, weights: Array) -> Array:
        """Weighted direct least squares (Halir & Flusser) from the moments of the points."""
        return ellipse_of(direct_from_points(D[:, None], weights)[0])

    @staticmethod
    def minimal_fit(samples: Array) -> Array:
        """Through five points; NaN where their conic is no ellipse."""
        return conic_minimal_fit(samples)

    @staticmethod
    def lengths(x: Array) -> tuple[Array, Array]:
        """The semi-axes m ± √(g² + h²)."""
        half = np.hypot(x[:, 3], x[:, 4])[:, None]
        along = x[:, 3:] / np.where(half > 0, half, 1.0)
        gradients = np.zeros((len(x), 2, PARAMETERS))
        gradients[:, :, 2] = 1.0
        gradients[:, 0, 3:], gradients[:, 1, 3:] = along, -along
        return np.concatenate([x[:, 2:3] + half, x[:, 2:3] - half], axis=-1), gradients

    @staticmethod
    def in_words(x: Array) -> str:
        u0, v0, a, b, _ = axes_of(x[None])[0][0]
        return f"centre {u0:.4f} {v0:.4f}, semi-axes {a:.4f} and {b:.4f} m"


def _minor(x: Array) -> Array:
    return x[..., 2] - np.hypot(x[..., 3], x[..., 4])


def _area(x: Array) -> Array:
    """det S = ab."""
    return x[..., 2] ** 2 - x[..., 3] ** 2 - x[..., 4] ** 2


def _matrix(x: Array) -> Array:
    """S, (…, 2, 2)."""
    m, g, h = x[..., 2], x[..., 3], x[..., 4]
    return np.stack([np.stack([m + g, h], axis=-1), np.stack([h, m - g], axis=-1)], axis=-2)


def _feet(x: Array, points: Array) -> tuple[Array, Array, Array]:
    """p − centre, e of the foot and the outward normal there, each (…, 2, n)."""
    P = points.swapaxes(-1, -2) - x[..., :2, None]
    half = np.hypot(x[..., 3], x[..., 4])
    a, b = (x[..., 2] + half)[..., None], (x[..., 2] - half)[..., None]
    angle = 0.5 * np.arctan2(x[..., 4], x[..., 3])[..., None]
    c, s = np.cos(angle), np.sin(angle)
    ct, st = _eccentric(
        c * P[..., 0, :] + s * P[..., 1, :], c * P[..., 1, :] - s * P[..., 0, :], a, b
    )
    e = np.stack([c * ct - s * st, s * ct + c * st], axis=-2)
    along, across = b * ct, a * st
    size = np.hypot(along, across)
    along /= size
    across /= size
    return P, e, np.stack([c * along - s * across, s * along + c * across], axis=-2)


def _eccentric(X: Array, Y: Array, a: Array, b: Array) -> tuple[Array, Array]:
    """(cos τ, sin τ) of the foot (a cos τ, b sin τ) of (X, Y) in the axes of the ellipse, a ≥ b.

    The foot is ``(a²X/(w + a² − b²), b²Y/w)`` with the root w > 0 of |(cos τ, sin τ)| = 1. Newton
    on 1/|(cos τ, sin τ)|, which is nearly linear in w, rises to it from where one of the two is 1.
    On an axis a point is moved off it by nothing that counts, so that inside the evolute, where two
    feet are equally near, it has one of them.
    """
    aX = a * np.maximum(np.abs(X), NEAREST_TO_ZERO * a)
    bY = b * np.maximum(np.abs(Y), NEAREST_TO_ZERO * b)
    squares = (a - b) * (a + b)
    w = np.maximum(bY, aX - squares)
    for _ in range(100):
        cos, sin = aX / (w + squares), bY / w
        size = np.sqrt(cos * cos + sin * sin)
        excess = size - 1.0
        if not (excess > 4e-16).any():
            break
        w += excess * size * size / (cos * cos / (w + squares) + sin * sin / w)
    return np.copysign(cos / size, X), np.copysign(sin / size, Y)


def polar(x: Array, angles: Array, pole: Array) -> tuple[Array, Array, Array]:
    """Radii of ellipses x (…, 5) from a pole (…, 2) inside, at angles α (K,) from up to the right.

    ρ is the positive root of ``|q + ρ D| = 1``, q = S⁻¹(pole − centre), D = S⁻¹(sin α, cos α).

    Returns ρ (…, K) in m, NaN where the pole is outside; ∂ρ/∂x (…, K, 5), which follows from
    ``d(x, pole + ρδ) = 0`` for the orthogonal distance d; and ∂ρ/∂t (…, K, 2) of a shift t of the
    ellipse.

    >>> x, pole = np.array([0.0, 0.0, 1.5, 0.5, 0.0]), np.array([0.5, 0.0])
    >>> radii, *_ = polar(x, np.deg2rad([0.0, 90.0, -90.0]), pole)
    >>> radii[1:]
    array([1.5, 2.5])

    Source: Li et al. 2015, section 3.4.3.
    """
    delta = np.stack([np.sin(angles), np.cos(angles)], axis=-1)
    S = _matrix(x)
    q = solve(S, (pole - x[..., :2])[..., None])
    D = solve(S, np.broadcast_to(delta.T, S.shape[:-1] + (len(delta),)))
    q2, q1 = np.sum(D * D, axis=-2), np.sum(q * D, axis=-2)
    q0 = np.sum(q * q, axis=(-2, -1))[..., None] - 1.0
    with np.errstate(invalid="ignore"):
        radii = (np.sqrt(np.where(q0 < 0, q1 * q1 - q2 * q0, np.nan)) - q1) / q2
    places = np.asarray(pole)[..., None, :] + radii[..., None] * delta
    J = EllipseModel.linearised(x, places)[1].swapaxes(-1, -2)
    # J holds −n in front; −J/(n · δ)
    gradient = J / np.einsum("...ki,ki->...k", J[..., :2], delta)[..., None]
    return radii, gradient, gradient[..., :2]


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class EllipticFit(Fit):
    """A fit of an elliptic section, which may be a circle.

    regular : (…, k) numbers that describe it also where it is a circle, among them m = (a + b)/2
        and (g, h) = (a − b)/2 · (cos 2φ, sin 2φ), in m
    regular_cofactor : (…, t, t) of its free parameters. Where a − b is not many times its standard
        deviation, φ and a − b are far from normally distributed and their entries in ``cofactor``
        say little (of a circle: nothing); these hold at any shape.
    """

    regular: Array
    regular_cofactor: Array

    @property
    def regular_covariance(self) -> Array:
        """(…, t, t) covariance of the free parameters."""
        return self.scaled(self.regular_cofactor)


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class EllipseFit(EllipticFit):
    """A fitted ellipse; ``parameters`` are (u0, v0, a, b, φ) in m and rad, a ≥ b, φ in [0, π).

    regular : (…, 5) the same ellipse as (u0, v0, m, g, h); regular_cofactor : (…, 5, 5) of these
    """

    NAMES = ("u0", "v0", "a", "b", "phi")
    SIZES = slice(2, 4)

    @property
    def center(self) -> Array:
        """(…, 2) in m."""
        return self.parameters[..., :2]

    @property
    def semi_axes(self) -> Array:
        """(…, 2) in m, the major one first."""
        return self.parameters[..., 2:4]

    @property
    def angle(self):
        """(…) direction of the major axis from the first coordinate axis, in [0, π) rad."""
        return self.parameters[..., 4]

    @property
    def conic(self) -> Array:
        """(…, 6) of ``A u² + B uv + C v² + D u + E v + F = 0``, −1 at the centre.

        Far from the origin it loses digits.
        """
        return conic_of(self.regular)

    def polar(self, angles: Array, pole: Array) -> tuple[Array, Array, Array]:
        """:func:`polar` of the fitted ellipse; its gradient goes with ``regular_covariance``."""
        return polar(self.regular, angles, pole)

    def surface(self) -> FittedSurface:
        x = self.regular.reshape(-1, PARAMETERS)
        return FittedSurface(EllipseModel(), x, axes_of(x)[1])


@dataclass(frozen=True, eq=False)
class EllipseCloud(Cloud):
    """A stack of plane clouds around ellipses."""

    surface = "an ellipse"
    model = EllipseModel()

    @cached_property
    def factor(self) -> Array:
        """(B, 6, 6) triangular factor of the weighted rows ``(1, u, v, u², uv, v²)``."""
        return self.factor_of(_rows)

    def start(self) -> Array:
        """Direct least squares."""
        return ellipse_of(direct_from_factor(self.factor)[0])

    def robust_start(self, D: Array, seed: int, keep: slice) -> Start:
        """The best half, or the surface that chance explains worst."""
        return find_start(self.model[keep], D, seed)

    def require_surface(self) -> None:
        """Refuse points on a line, and such as more than one conic passes through."""
        extents = np.linalg.svd(self.factor[:, 1:3, 1:3], compute_uv=False)
        self.require_dimensions(extents * self.length[:, None], 2)
        s = np.linalg.svd(self.factor[:, 3:, 3:], compute_uv=False)
        # Of the three combinations of u², uv and v² that are left of lines, one may be constant on
        # the points, but not two.
        far = 1.0 + np.abs(self.origin).max(axis=-1) / self.length
        rounding = 16 * np.sqrt(self.count) * np.finfo(float).eps * far
        for bad in np.flatnonzero(s[:, 1] <= np.maximum(rounding, 1e-10) * s[:, 0]):
            raise self.degenerate("points on more than one conic", bad)

    def fit(self, method: str, adjustment: Adjustment) -> EllipseFit:
        """The result in m of an adjustment of (u0, v0, m, g, h) in the frame."""
        x, length = adjustment.x, self.length[:, None]
        regular = length * x
        regular[:, :2] += self.origin
        regular_cofactor = adjustment.cofactor * length[..., None] ** 2
        parameters, J = axes_of(regular)
        # digits lost in `regular` far from the origin
        centred = np.concatenate([length * x[:, :2], regular[:, 2:]], axis=-1)
        ended = adjustment.convergence
        endless = ~(x[:, 2] <= np.where(ended.converged, LARGEST, LARGE))
        return self.result(
            EllipseFit,
            method,
            replace(adjustment, convergence=ended.failed_where(endless, NO_ELLIPSE)),
            lambda points: self.model.linearised(centred, points - self.origin[:, None])[0],
            parameters=parameters,
            cofactor=propagate(regular_cofactor, J),
            regular=regular,
            regular_cofactor=regular_cofactor,
        )


def _rows(points: Array, origin: Array, length: Array) -> Array:
    D = (points - origin[:, None]) / length[:, None, None]
    return rows(D[..., 0], D[..., 1])


# --------------------------------------------------------------------------------- the methods


def direct(cloud: EllipseCloud) -> EllipseFit:
    """Direct least squares, ``min Σ P f²`` with 4AC − B² = 1, which only ellipses fulfil.

    σ0 = √(ΣPd²/(n − 5)) of the orthogonal distances. Its covariance is that of a fit whose residual
    f is d times the slope of f. The condition favours small and flat ellipses: with noise the
    semi-axes come out too small, much so on a short arc.

    Source: Fitzgibbon, Pilu & Fisher 1999; Halir & Flusser 1998, in the centred frame; Li et al.
    2015, section 3.4.2.
    """
    conic, natural = direct_from_factor(cloud.factor)
    x = ellipse_of(conic)
    points = cloud.observations().all()
    d, _ = cloud.model.linearised(x, points.D)
    sigma = unit_weight_sd(np.sum(d * d / points.variances, axis=-1), cloud.count - PARAMETERS)
    cofactor = _algebraic_cofactor(x, points, np.ones_like(d))
    adjustment = Adjustment.closed_form(x, cofactor, sigma)
    return cloud.fit("direct", _only_ellipses(adjustment, natural))


@dataclass(frozen=True)
class State(Stack):
    """x, and the scale and weights that it was found with."""

    x: Array
    sigma: Array
    weights: Array


def robust_direct(
    cloud: EllipseCloud,
    *,
    k0: float = PRINTED_THRESHOLDS[0],
    k1: float = PRINTED_THRESHOLDS[1],
    max_iterations: int = 200,
) -> EllipseFit:
    """Direct least squares with IGG III weights of the distances over their MAD.

    Repeated until the ellipse no longer changes. The weights multiply the a-priori ones and do not
    accumulate. It starts from all points, so a large group of gross errors on one side can hold it.
    σ0 = 1.4826 med|d| n/(n − 5), the scale that the weights were found with.

    Source: after Xu & Yao 2008, as cited by Li et al. 2015, section 3.4.2; weights of Ou & Liu
    2017, eq. (13).
    """
    function = IGG3(check_positive(k0, "k0"), check_positive(k1, "k1"))
    check_whole_number(max_iterations, "max_iterations")
    model, n = cloud.model, cloud.count
    redundancy = n / (n - PARAMETERS) if n > PARAMETERS else 1.0

    def advance(points: Points, state: State):
        u = np.abs(model.linearised(state.x, points.D)[0]) / np.sqrt(points.variances)
        sigma = ROUNDED_MAD_TO_SD * redundancy * np.median(u, axis=-1)
        weights = function.weight(
            u / np.maximum(sigma[:, None], ROUNDING / np.sqrt(points.variances))
        )
        new = ellipse_of(direct_from_points(points.D, weights / points.variances)[0])
        change = np.max(np.abs(new - state.x), axis=-1)
        lost = ~np.isfinite(change)
        return State(np.where(lost[:, None], state.x, new), sigma, weights), {
            Ending.NO_ELLIPSE: lost,
            Ending.ELLIPSE: change <= SETTLED,
        }

    points = cloud.observations().all()
    start = State(cloud.start(), np.zeros(len(points.D)), np.ones((len(points.D), n)))
    end, convergence = iterate(points, start, advance, max_iterations)
    x, sigma, weights = end.x, end.sigma, end.weights
    cofactor = function.covariance_factor * _algebraic_cofactor(x, points, weights)
    _, natural = direct_from_points(points.D, weights / points.variances)
    adjustment = Adjustment(x, cofactor, sigma, weights, convergence)
    return cloud.fit("robust_direct", _only_ellipses(adjustment, natural))


def _only_ellipses(adjustment: Adjustment, natural: np.ndarray) -> Adjustment:
    """Mark as not converged where only the condition makes an ellipse of the conic."""
    ended = adjustment.convergence.failed_where(~natural, NOT_NATURAL)
    return replace(adjustment, convergence=ended)


def _algebraic_cofactor(x: Array, points: Points, weights: Array) -> Array:
    """Cofactor ``N⁻¹MN⁻¹``, N = Σ G²wJJᵀ, M = Σ G⁴w²v/ω JJᵀ, w = ω/v.

    f ≈ G d, where G is the slope of f at the foot.
    """
    _, J = EllipseModel.linearised(x, points.D)
    _, e, _ = _feet(x, points.D)
    squared = (_speed(x, e) / _area(x)[:, None]) ** 2  # |S⁻¹e|²
    w = weights / points.variances * squared
    N = (J * w[:, None]) @ J.swapaxes(-1, -2)
    M = (J * (w * squared)[:, None]) @ J.swapaxes(-1, -2)
    return propagate(M, cofactor_from_normal(N))


def _speed(x: Array, e: Array) -> Array:
    """|dp/dτ| (…, n) at the places e (…, 2, n); it is |S⁻¹e| det S."""
    m, g, h = np.moveaxis(x[..., 2:, None], -2, 0)
    return np.hypot(
        (m - g) * e[..., 0, :] - h * e[..., 1, :], (m + g) * e[..., 1, :] - h * e[..., 0, :]
    )
