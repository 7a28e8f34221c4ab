"""Start of the adjustment of an elliptic cylinder: trial directions, ellipses, concentration.

A cylinder has no closed form through a few points. But seen along its axis it is an ellipse, and
five points give one. So

1. along each of a number of trial directions the best ellipse through samples of five projected
   points, or the direct fit of all, moved by a few damped Gauss-Newton steps on the h closest
   points, all seven parameters free: that mends the direction;
2. along the best directions so found more such ellipses, and these moved in the same way to the
   end.

With h a little more than half of the points this is least trimmed squares (Rousseeuw & Van Driessen
2006), with h all of them an orthogonal distance fit. A subset of the points is enough for both.
"""

from __future__ import annotations

import numpy as np

from ..adjustment.linalg import solve
from ..orthogonal.contracts import GeometricModel, Start
from ..orthogonal.improbability import spread
from ..orthogonal.least_trimmed_squares import (
    closest,
    majority,
    sorted_distances,
    trimmed_spread,
    trimmed_sum,
)
from ..orthogonal.start import TIGHT, draw_distinct
from ..result import Array
from .ellipse import EllipseModel

# Samples along each trial direction, and points by which they are compared: as many as find most
# clouds, and where the half found does not lie close to its cylinder, so many that with 45 % bad
# points chance seldom makes half of them bad (of 100 samples two starts in a hundred failed).
EFFORTS = ((60, 160), (300, 500))
CANDIDATES = 12  # directions that are looked at again, and cylinders that are followed to the end
KEPT = 6  # of the samples along each of these directions, those that are followed


def fit_majority(model: GeometricModel, D: Array, axis: Array | None, seed: int | None) -> Start:
    """Cylinders near most of the points of clouds D (B, n, 3) in their frames.

    axis : (3,) approximate direction, or None to try directions all over
    seed : of the samples for least trimmed squares, or None to fit all points alike
    """
    found = [_fit_majority(model, cloud, axis, seed) for cloud in D]
    h = D.shape[1] if seed is None else majority(D.shape[1], model)
    return Start(
        np.stack([x for x, _ in found]),
        np.array([sd for _, sd in found]),
        np.full(len(D), h),
        np.ones(len(D), dtype=bool),
    )


def _fit_majority(
    model: GeometricModel, D: Array, axis: Array | None, seed: int | None
) -> tuple[Array, Array]:
    generator = np.random.default_rng(0 if seed is None else seed)
    D = D[generator.permutation(len(D))]
    directions = trial_directions(D) if axis is None else axis[None]
    h = len(D) if seed is None else majority(len(D), model)
    found, costs = [], []
    for samples, screened in EFFORTS[-1:] if seed is None else EFFORTS:
        few, draws = D[:screened], None
        if seed is not None:
            draws = draw_distinct(generator, len(few), 5, samples)
        x = _search(model, few, directions, draws, axis is None)
        x, cost = concentrate(model, x, D, h, 40)
        found.append(x[np.argmin(cost)])
        costs.append(np.min(cost))
        if trimmed_spread(costs[-1], h, len(D)) <= TIGHT * spread(D):
            break
    best = int(np.argmin(costs))
    return found[best], trimmed_spread(costs[best], h, len(D))


def _search(
    model: GeometricModel, D: Array, directions: Array, draws: np.ndarray | None, anywhere: bool
) -> Array:
    """The best cylinders x (K, 15) of points (n, 3) along trial directions and ones near them."""
    h = len(D) if draws is None else majority(len(D), model)
    for kept in (1 if anywhere else KEPT, KEPT):
        x = np.concatenate(
            [_along(D, frame, draws, h, kept) for frame in _frames_along(directions)]
        )
        x, cost = concentrate(model, x, D, h, 6)
        x = x[np.argsort(cost)[:CANDIDATES]]
        directions = x[:, 9:12]
    return x


# ---------------------------------------------------------------------------- directions


def trial_directions(D: Array) -> Array:
    """(C, 3) unit vectors: principal axes of a cloud (n, 3), some near them, and a hemisphere.

    Those of the hemisphere are about 17° apart. The principal axes are those of the shape matrix of
    Tyler (1987), for which far points count no more than near ones.
    """
    D = D - np.median(D, axis=0)
    D = D[np.einsum("ni,ni->n", D, D) > 0]
    shape = np.eye(3)
    for _ in range(30):
        squares = np.einsum("ni,in->n", D, solve(shape, D.T))
        shape = (D / squares[:, None]).T @ D
        shape /= np.trace(shape)
    axes = np.linalg.eigh(shape)[1].T
    around = np.linspace(0.0, 2.0 * np.pi, 6, endpoint=False)
    cones = [_directions(tilt, around) for tilt in np.radians([4.0, 10.0])]
    near = np.concatenate([[[0.0, 0.0, 1.0]], *cones])
    index = np.arange(80)
    hemisphere = _directions(np.arccos((index + 0.5) / 80), np.pi * (1.0 + 5.0**0.5) * index)
    return np.concatenate([near @ np.roll(axes, k, axis=0) for k in range(3)] + [hemisphere @ axes])


def _directions(tilt, azimuth: Array) -> Array:
    return np.stack(
        np.broadcast_arrays(
            np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), np.cos(tilt)
        ),
        axis=-1,
    )


def _frames_along(directions: Array) -> Array:
    """(C, 3, 3) orthonormal frames, rows e1, e2, t, along unit vectors t (C, 3)."""
    e1 = np.cross(np.eye(3)[np.argmin(np.abs(directions), axis=-1)], directions)
    e1 /= np.linalg.norm(e1, axis=-1, keepdims=True)
    return np.stack([e1, np.cross(directions, e1), directions], axis=-2)


# ---------------------------------------------------------------------------- ellipses


def _along(D: Array, frame: Array, draws: np.ndarray | None, h: int, kept: int) -> Array:
    """The ``kept`` best cylinders x (…, 15) along one direction, by their h closest points."""
    seen, section = D @ frame[:2].T, EllipseModel()
    if draws is None:
        ellipses = section.refit(np.empty(0), seen[None], np.ones((1, 1, len(seen))))[0]
    else:
        ellipses = section.minimal_fit(seen[None, draws])[0]
    cost = trimmed_sum(sorted_distances(section, ellipses[None], seen[None]), h)[0]
    best = np.argsort(cost)[:kept]
    ellipses = ellipses[best[np.isfinite(cost[best])]]
    frames = np.broadcast_to(frame.ravel(), (len(ellipses), 9))
    return np.concatenate([ellipses[:, :2] @ frame[:2], frames, ellipses[:, 2:]], axis=-1)


# ---------------------------------------------------------------------------- concentration


def concentrate(
    model: GeometricModel, x: Array, D: Array, h: int, steps: int
) -> tuple[Array, Array]:
    """Each x (K, 15) after damped Gauss-Newton steps on its h closest points.

    They lessen the sum of the h smallest squared distances, which comes second, (K,).
    """
    D = np.broadcast_to(D, (len(x),) + D.shape)
    cost = trimmed_sum(sorted_distances(model, x[:, None], D), h)[:, 0]
    damping = np.full(len(x), 1e-3)
    for _ in range(steps):
        f, J = model.linearised(x, D)
        weighed = J * closest(f, h)[:, None, :]
        N = weighed @ J.swapaxes(-1, -2)
        N += (damping * np.trace(N, axis1=-2, axis2=-1) / model.degrees)[:, None, None] * np.eye(
            model.degrees
        )
        new = model.update(x, -solve(N, weighed @ f[..., None])[..., 0])
        now = trimmed_sum(sorted_distances(model, new[:, None], D), h)[:, 0]
        better = now < cost
        settled = np.where(better, cost - now <= 1e-6 * cost, damping > 1.0).all()
        x, cost = np.where(better[:, None], new, x), np.where(better, now, cost)
        damping = np.where(better, 0.1 * damping, 10.0 * damping)
        if settled:
            break
    return x, cost
