"""The bias of second order of an orthogonal fit, and what is left when it is taken off.

Errors along a curved surface take a point off it. The distance f of a point with cofactor Q from
the true surface, with normal n and curvature H = ∂²f/∂p², has the expectation

    E[f] = σ² · ½ tr(H C),   C = Q − Qn nᵀQ/(nᵀQn),

where C is what the adjustment leaves of Q along the surface; with isotropic errors σ² times half
the sum of the principal curvatures. An adjustment with Jacobian J, variances v = nᵀQn and weights ω
takes these distances for a change of the surface by

    b = −(Σ ω JJᵀ/v)⁻¹ Σ ω J E[f]/v,

σ²/r of the radius for a sphere with equal isotropic errors, σ²/(2r) for a circle and nothing for a
plane. It does not become smaller with the number n of points, as standard deviations do; terms of
the order σ²/n, which do, are left. σ̂² is known to ±σ̂² √(2/ν) with the redundancy ν, and so b to
±b √(2/ν).

Source: the expansion of Box 1971 (bias of nonlinear estimates) for distances; Al-Sharadqah &
Chernov 2009 for circles.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..adjustment.linalg import solve
from ..blocks import point_pieces
from ..result import Adjustment, Array
from .contracts import GeometricModel, SurfaceCloud
from .observations import Points

# E[f] over the standard deviation of f, for a sphere σ/r, up to which an expansion to second order
# is one: beyond it nothing is taken off
LARGEST = 0.5


def without_bias(cloud: SurfaceCloud, adjusted: Adjustment) -> Adjustment:
    """An adjustment less its bias of second order; what is not known of it is in the cofactor.

    σ is 1, and known, where the cofactors of the cloud are absolute. Where there is no σ, for want
    of redundancy, or errors are as large as the surface, nothing is taken off.
    """
    model, sigma = cloud.model, adjusted.sigma
    total = cloud.count if adjusted.weights is None else np.sum(adjusted.weights, axis=-1)
    redundancy = np.broadcast_to(total - model.degrees, sigma.shape)
    if cloud.absolute:
        sigma = np.ones_like(sigma)
    bias, ratio = _bias(cloud, adjusted)
    with np.errstate(invalid="ignore", over="ignore"):
        known = np.isfinite(sigma) & np.isfinite(bias).all(axis=-1) & (sigma * ratio <= LARGEST)
    if not cloud.absolute:
        known &= redundancy > 0
    bias, sigma = np.where(known[:, None], bias, 0.0), np.where(known, sigma, 0.0)
    x = model.update(adjusted.x, -(sigma[:, None] ** 2) * bias)
    cofactor = adjusted.cofactor
    if not cloud.absolute:
        share = sigma**2 * 2.0 / np.where(known, redundancy, 1.0)
        cofactor = cofactor + share[:, None, None] * bias[:, :, None] * bias[:, None, :]
    return replace(adjusted, x=np.where(known[:, None], x, adjusted.x), cofactor=cofactor)


def _bias(cloud: SurfaceCloud, adjusted: Adjustment) -> tuple[Array, Array]:
    """b/σ² (B, t) of the free parameters; E[f]/(σ √v) (B,), its RMS over the points."""
    model, x, points = cloud.model, adjusted.x, cloud.observations()
    t = model.degrees
    N, g, squares, total = np.zeros((len(x), t, t)), np.zeros((len(x), t)), 0.0, 0.0
    for part in point_pieces(points.points):
        J, expected, variances = _expected(model, x, points.piece(part))
        weights = (1.0 if adjusted.weights is None else adjusted.weights[:, part]) / variances
        weights = np.broadcast_to(weights, expected.shape)
        weighed = J * weights[:, None, :]
        N += weighed @ J.swapaxes(-1, -2)
        g += (weighed @ expected[..., None])[..., 0]
        squares += np.sum(weights * expected**2, axis=-1)
        total += np.sum(weights * variances, axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return -solve(N, g[..., None])[..., 0], np.sqrt(squares / total)


def _expected(model: GeometricModel, x: Array, points: Points) -> tuple[Array, Array, Array]:
    """Jacobian (B, t, n), E[f]/σ² (B, n), and the variances v, (B, n) or (B, 1)."""
    if points.axes is None:
        curvature = model.curvature(x, points.D)
        half = 0.5 * np.einsum("bnii->bn", curvature)
        return model.linearised(x, points.D)[1], half * points.variances, points.variances
    feet = model.foot_points(x, points)
    # in coordinates with Q = RRᵀ in which the errors are isotropic: RᵀHR, and the unit normal
    root = points.axes * np.sqrt(points.variances)[..., None, :]
    H = root.swapaxes(-1, -2) @ model.curvature(x, feet) @ root
    normals = np.einsum("bnij,bni->bnj", root, model.normals(x, feet))
    variances = np.einsum("bnj,bnj->bn", normals, normals)
    along = np.einsum("bnij,bni,bnj->bn", H, normals, normals) / variances
    half = 0.5 * (np.einsum("bnii->bn", H) - along)
    return model.linearised(x, feet)[1], half, variances
