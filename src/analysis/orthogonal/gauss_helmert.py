"""Orthogonal-distance adjustment of any geometric model by least squares (Gauss-Helmert).

A geometric model gives, for a surface x and points p, the orthogonal distances d, their normals
n = ∂d/∂p and their Jacobian J with respect to t free parameters that move the surface. From these
come the sums over the points that every adjustment of this folder is made of, and
:func:`geometric`, with any point cofactors, for every geometry alike.

All arrays are stacks (B, …) in the clouds' frames, which are centred and scaled. An iteration is
one pass over the points, a block at a time: beyond the points a large cloud needs a weight and a
distance for each.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..adjustment.iteration import Ending, Stack, iterate
from ..adjustment.linalg import solve
from ..blocks import point_pieces
from ..checks import check_whole_number
from ..result import Adjustment, Array, Fit
from .cloud import ROUNDING
from .contracts import GeometricModel, SurfaceCloud
from .observations import Observations, Points
from .second_order import without_bias

TOLERANCE = 1e-12  # of a step, in the frame's unit
STALLED = 1e-9  # a step below this that no longer shrinks is rounding
SETTLED = 1e-10  # relative change of a scale
SMALLEST_REDUNDANCY = 1e-3  # of a point, when its residual is standardised


def geometric(
    cloud: SurfaceCloud, *, bias_correction: bool = False, max_iterations: int = 100
) -> Fit:
    """Weighted orthogonal distance fit ``min Σ eᵀQ⁻¹e`` over the errors e of the points.

    By Gauss-Helmert. With equal isotropic cofactors this is ``min Σ d²``. Independent of the
    origin; a parameter may be fixed. σ0 = √(Σeᵀ Q⁻¹e/(n − t)): in m without cofactors, else
    relative to them.

    Parameters
    ----------
    bias_correction : take off the bias of second order that noise leaves in the parameters (for a
        sphere with equal cofactors σ̂0²/r of the radius): :mod:`~analysis.orthogonal.second_order`.
        The minimum itself, which is the definition of this fit, keeps it.

    Source: Pope 1972; Neitzel 2010.
    """
    check_whole_number(max_iterations, "max_iterations")
    start, points = cloud.start(), cloud.observations()
    adjusted = adjust(cloud.model, points, start, max_iterations)
    if bias_correction:
        adjusted = without_bias(cloud, adjusted)
    return cloud.fit("geometric", adjusted)


@dataclass(frozen=True)
class _State(Stack):
    """x (B, s), the length (B,) of the step that led there, N⁻¹ (B, t, t) and σ̂ before it."""

    x: Array
    step: Array
    cofactor: Array
    sigma: Array


def adjust(
    model: GeometricModel, points: Observations, x: Array, max_iterations: int
) -> Adjustment:
    """Gauss-Newton steps from x (B, s) with all points."""
    redundancy = points.count - model.degrees

    def advance(points: Observations, state: _State):
        sums = sum_up(model, state.x, points)
        cofactor, step = sums.solved()
        length = np.linalg.norm(step, axis=-1)
        lost = ~np.isfinite(length)
        new = _State(
            x=np.where(lost[:, None], state.x, model.update(state.x, step)),
            step=length,
            cofactor=cofactor,
            sigma=np.sqrt(sums.squares / redundancy if redundancy > 0 else np.nan * sums.squares),
        )
        stalled = (length >= state.step) & (length <= STALLED)
        small = length <= TOLERANCE
        return new, {Ending.SINGULAR: lost, Ending.PARAMETERS: small, Ending.ROUNDING: stalled}

    count, t = len(x), model.degrees
    start = _State(x, np.full(count, np.inf), np.zeros((count, t, t)), np.full(count, np.nan))
    end, convergence = iterate(points, start, advance, max_iterations)
    return Adjustment(end.x, end.cofactor, end.sigma, None, convergence)


@dataclass
class Sums:
    """Sums over the points of the stack's clouds.

    N : (B, t, t) ``Σ ω JJᵀ/v``; g : (B, t) ``Σ ω J f/v``: the normal equations
    weights : (B,) Σω; squares : (B,) ``Σ ω f²/v``; least_variance : (B,) smallest v
    bend : (B, t + 2, t + 2) ``Σ uω′(u) KKᵀ/v`` with K = (J, f, v/f): how these sums change with the
        weights when x and σ change; 0 where that is not asked for
    """

    N: Array
    g: Array
    weights: Array
    squares: Array
    least_variance: Array
    bend: Array

    def solved(self) -> tuple[Array, Array]:
        """Cofactor N⁻¹ (B, t, t) and Gauss-Newton step −N⁻¹g (B, t)."""
        t = self.N.shape[-1]
        right = np.concatenate([np.broadcast_to(np.eye(t), self.N.shape), self.g[..., None]], -1)
        solution = solve(self.N, right)
        cofactor = solution[..., :t]
        return 0.5 * (cofactor + cofactor.swapaxes(-1, -2)), -solution[..., t]


def sum_up(
    model: GeometricModel, x: Array, points: Observations, reweigh: Callable | None = None
) -> Sums:
    """One pass over the points at x (B, s).

    ``reweigh(part, f²/v, J, v)`` gives the weights ω (B, m) of a part and uω′(u), or None for
    either: ones, and no change.
    """
    count, t = len(x), model.degrees
    sums = Sums(
        N=np.zeros((count, t, t)),
        g=np.zeros((count, t)),
        weights=np.zeros(count),
        squares=np.zeros(count),
        least_variance=np.full(count, np.inf),
        bend=np.zeros((count, t + 2, t + 2)),
    )
    for part in point_pieces(points.points):
        f, J, variances = linearised(model, x, points.piece(part))
        squares = f * f / variances
        omega, slope = (None, None) if reweigh is None else reweigh(part, squares, J, variances)
        weighed = J * ((1.0 if omega is None else omega) / variances)[:, None, :]
        sums.N += weighed @ J.swapaxes(-1, -2)
        sums.g += (weighed @ f[..., None])[..., 0]
        sums.weights += f.shape[-1] if omega is None else np.sum(omega, axis=-1)
        sums.squares += np.einsum("bn,bn->b", np.ones_like(f) if omega is None else omega, squares)
        np.minimum(sums.least_variance, variances.min(axis=-1), out=sums.least_variance)
        if slope is not None:
            sums.bend += _bend(f, J, np.broadcast_to(variances, f.shape), slope)
    return sums


def _bend(f: Array, J: Array, variances: Array, slope: Array) -> Array:
    """``Σ uω′ KKᵀ/v``, K = (J, f, v/f); a point at f = 0 has no uω′."""
    if len(f) == 1:  # of one cloud those that have some, which are few
        some = np.flatnonzero(slope[0])
        f, J, variances, slope = f[:, some], J[..., some], variances[:, some], slope[:, some]
    ratio = variances / np.where(slope != 0.0, f, 1.0)
    K = np.concatenate([J, f[:, None], ratio[:, None]], axis=1)
    return (K * (slope / variances)[:, None]) @ K.swapaxes(-1, -2)


def m_endings(
    sums: Sums, step: Array, before: Array, sigma: Array, found: Array, foreseen: Array
) -> dict[Ending, np.ndarray]:
    """Endings (B,) of an M-estimation.

    step, before, foreseen : (B,) lengths of this step, the last one, and what the next may be
    sigma, found : (B,) scale that the residuals were standardised with, and scale of them
    """
    # The scale of exact points is rounding and never settles.
    rounding = ROUNDING / np.sqrt(sums.least_variance)
    settled = np.abs(found - sigma) <= np.maximum(SETTLED * found, rounding)
    return {
        Ending.SINGULAR: ~np.isfinite(step + found),
        Ending.PARAMETERS_AND_SCALE: settled & (foreseen <= TOLERANCE),
        Ending.ROUNDING: settled & (step >= before) & (step <= STALLED),
    }


def linearised(model: GeometricModel, x: Array, points: Points) -> tuple[Array, Array, Array]:
    """Misclosures f (B, n), Jacobian (B, t, n) and the variances of f, (B, n) or (B, 1).

    Isotropic points: the distances themselves. Otherwise everything is taken at the adjusted points
    p̃, the places on the surface that are nearest in the metric of Q⁻¹: ``f = nᵀ(p − p̃)`` (Pope
    1972).
    """
    if points.axes is None:
        return *model.linearised(x, points.D), points.variances
    feet = model.foot_points(x, points)
    d, J = model.linearised(x, feet)
    normals = model.normals(x, feet)
    f = d + np.einsum("bni,bni->bn", normals, points.D - feet)
    return f, J, points.along(normals)
