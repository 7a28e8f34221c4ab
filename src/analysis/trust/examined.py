"""A fit of one cloud as its checks see it: standardised residuals of some points, in a frame."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ..adjustment.linalg import solve
from ..orthogonal.cloud import frame_of
from ..orthogonal.gauss_helmert import linearised
from ..orthogonal.improbability import spread
from ..orthogonal.observations import Observations
from ..result import Array, Fit

POINTS = 2000  # of a cloud that are looked at
# methods whose σ0 is the standard deviation of a distance; the others have one of their own
OWN_SCALE = ("geometric", "robust")
SMALLEST_REDUNDANCY = 0.05  # of a point, when its residual is standardised
CURVE_BITS = 10  # of a coordinate, along the curve


@dataclass(frozen=True, eq=False)
class Examined:
    """One cloud of n points and its fit; m of the points, in an order of their own.

    model, x (1, s) : the surface in the frame ``(p − origin)/length`` of the points D (m, dim)
    points : (m, dim) in m; station (dim,) in m, or None
    count, used : n, and how many of them are in use
    distances : (m,) in the frame; normals (m, dim), outwards
    in_use : (m,) bool
    sigma : standard deviation of a distance in the frame, of a point with the median variance;
        0 where the points lie on the surface up to rounding
    u : (m,) distances over σ √(v (1 − leverage)), so that each has variance 1; 0 without noise
    sizes, deviations : (k,) lengths of the surface and their standard deviations
    """

    model: Any
    x: Array
    D: Array
    points: Array
    station: Array | None
    count: int
    used: int
    distances: Array
    normals: Array
    in_use: Array
    sigma: float
    u: Array
    sizes: Array
    deviations: Array
    origin: Array
    length: Array

    @property
    def redundancy(self) -> int:
        """Points in use less free parameters."""
        return self.used - self.model.degrees

    @cached_property
    def order(self) -> np.ndarray:
        """Order of the points in which neighbours on the surface lie next to each other."""
        return along_a_curve(self.D - self.distances[:, None] * self.normals)

    @cached_property
    def spread(self) -> Array:
        """Median distance of the points from their median, in the frame."""
        return spread(self.D)


def examine(fit: Fit) -> Examined | None:
    """The fit of one cloud; None where it is no surface.

    Raises ``ValueError`` for a fit that was made without its points.
    """
    given = fit.given
    if given is None:
        raise ValueError("checks: expected a fit that knows its points, got one made without them")
    model, x, _ = fit.surface()
    if not np.isfinite(x).all():
        return None
    # 1. some of the points, in a frame of the cloud
    points = given.points[None]
    origin, length = frame_of(points)
    n = points.shape[1]
    place = Observations.of(points, origin, length, np.ones((1, 1))).places(min(n, POINTS), 0)[0]
    cofactors = np.ones((1, 1))
    if given.matrices is not None:
        cofactors = given.matrices[None, place]
    elif given.weights is not None:
        cofactors = 1.0 / given.weights[None, place]
    some = points[:, place]
    p = Observations.of(some, origin, length, cofactors / length**2).all()
    # 2. their distances, and what the fit left them to vary
    model, x = model.in_frame(x, origin, length)
    with np.errstate(all="ignore"):
        f, J, variances = (array[0] for array in linearised(model, x, p))
        distances = f if p.axes is None else model.linearised(x, p.D)[0][0]
        omega = fit.weights[place]
        w = omega / variances
        leverage = w * np.sum(solve((J * w) @ J.T * (n / len(place)), J) * J, axis=0)
        scale = _scale(fit, f * f / variances, omega > 0, model.degrees)
        sigma = float(scale * np.sqrt(np.median(variances)))
        rounding = 16 * np.finfo(float).eps * (1.0 + np.abs(origin).max() / length[0])
        if not sigma > rounding:
            sigma = 0.0
        redundancy = np.maximum(1.0 - leverage, SMALLEST_REDUNDANCY)
        u = np.nan_to_num(f / (scale * np.sqrt(variances * redundancy)))
        u = u if sigma else np.zeros(len(place))
        sizes, deviations = fit.sizes()
    return Examined(
        model=model,
        x=x,
        D=p.D[0],
        points=some[0],
        station=given.station,
        count=n,
        used=int(np.count_nonzero(fit.weights)),
        distances=distances,
        normals=model.normals(x, p.D)[0],
        in_use=omega > 0,
        sigma=sigma,
        u=u,
        sizes=sizes,
        deviations=deviations,
        origin=origin,
        length=length,
    )


def _scale(fit: Fit, squares: Array, in_use: Array, t: int) -> float:
    """Standard deviation of a distance: the fit's σ0, or the RMS of the points in use."""
    if fit.method in OWN_SCALE:
        return float(fit.sigma_0)
    used = np.count_nonzero(in_use)
    return float(np.sqrt(np.sum(squares[in_use]) / (used - t))) if used > t else np.nan


def along_a_curve(D: Array) -> np.ndarray:
    """Order (n,) of the points D (n, dim) along a Z curve: next to each other lie neighbours.

    >>> along_a_curve(np.array([[0.0, 0.0], [1.0, 1.0], [0.1, 0.1], [0.9, 0.9]]))
    array([0, 2, 3, 1])

    Source: Morton 1966.
    """
    low = D.min(axis=0)
    side = max((D.max(axis=0) - low).max(), np.finfo(float).tiny)  # of a cell the same on all axes
    cells = ((D - low) * ((2**CURVE_BITS - 1) / side)).astype(np.int64)
    dim = D.shape[1]
    code = np.zeros(len(D), dtype=np.int64)
    for bit in range(CURVE_BITS):
        for axis in range(dim):
            code |= ((cells[:, axis] >> bit) & 1) << (bit * dim + axis)
    return np.argsort(code, kind="stable")
