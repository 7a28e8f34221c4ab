"""Plane conics ``A u² + B uv + C v² + D u + E v + F = 0`` that are ellipses.

Here are those through five points, the best through many, and their geometry. The geometry of an
ellipse is kept as (u0, v0, m, g, h): it is the image ``p = (u0, v0) + S e`` of the unit circle |e|
= 1 with

    S = [m + g, h; h, m − g],   m = (a + b)/2,   (g, h) = (a − b)/2 · (cos 2φ, sin 2φ)

for semi-axes a ≥ b and the direction φ of the major one. Unlike (a, b, φ) these numbers are smooth
and well determined for a circle too, where g = h = 0 and φ means nothing. All arrays are stacks
(…).
"""

from __future__ import annotations

import numpy as np

from ..adjustment.linalg import solve
from ..result import Array

# 4AC − B², which is positive for an ellipse, as a quadratic form of (A, B, C).
DISCRIMINANT = np.array([[0.0, 0.0, 2.0], [0.0, -1.0, 0.0], [2.0, 0.0, 0.0]])
# powers of u and v in the rows (1, u, v, u², uv, v²)
ROWS = [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)]
# whose sums are all that a scatter matrix of the rows holds
MONOMIALS = [(i, j) for i in range(5) for j in range(5 - i)]
PRODUCTS = np.array([[MONOMIALS.index((i + k, j + m)) for k, m in ROWS] for i, j in ROWS])


def rows(u: Array, v: Array) -> Array:
    """The rows ``(1, u, v, u², uv, v²)`` of points, (…, 6, n) from u, v (…, n)."""
    return np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=-2)


# what is no ellipse comes out as NaN
@np.errstate(divide="ignore", invalid="ignore", over="ignore")
def ellipse_of(conic: Array) -> Array:
    """(u0, v0, m, g, h) of conics (…, 6); NaN where there is no real ellipse.

    >>> x = ellipse_of(np.array([1.0, 0.0, 4.0, -2.0, -8.0, 1.0]))  # (u − 1)²/4 + (v − 1)² = 1
    >>> print(*(f"{value:g}" for value in np.abs(x)))
    1 1 1.5 0.5 0
    """
    conic = conic / (conic[..., 0] + conic[..., 2])[..., None]  # A + C = 1 in every frame
    A, B, C, D, E, F = np.moveaxis(conic, -1, 0)
    determinant = 4.0 * A * C - B * B
    determinant = np.where(determinant > 0, determinant, np.nan)
    u0, v0 = (B * E - 2.0 * C * D) / determinant, (B * D - 2.0 * A * E) / determinant
    level = -(F + 0.5 * (D * u0 + E * v0))
    level = np.where(level > 0, level, np.nan)
    # Eigenvalues of [A, B/2; B/2, C]; the smaller from the determinant, without cancellation.
    larger = 0.5 + 0.5 * np.hypot(A - C, B)
    smaller = 0.25 * determinant / larger
    a, b = np.sqrt(level / smaller), np.sqrt(level / larger)
    # (a − b)/2 over (λ₁ − λ₂), which is regular for a circle.
    ratio = 0.5 * a * b / (np.sqrt(level) * (np.sqrt(smaller) + np.sqrt(larger)))
    return np.stack([u0, v0, 0.5 * (a + b), -ratio * (A - C), -ratio * B], axis=-1)


def conic_of(x: Array) -> Array:
    """(A, B, C, D, E, F) (…, 6) of ellipses (u0, v0, m, g, h), scaled to −1 at the centre.

    >>> conic_of(np.array([1.0, 1.0, 1.5, 0.5, 0.0]))[[0, 2, 3, 4, 5]]
    array([ 0.25,  1.  , -0.5 , -2.  ,  0.25])
    """
    u0, v0, m, g, h = np.moveaxis(x, -1, 0)
    square = m * m + g * g + h * h
    area = (m * m - g * g - h * h) ** 2
    # of S⁻²
    A, C, B = (square - 2.0 * m * g) / area, (square + 2.0 * m * g) / area, -4.0 * m * h / area
    D, E = -2.0 * A * u0 - B * v0, -2.0 * C * v0 - B * u0
    return np.stack([A, B, C, D, E, A * u0 * u0 + B * u0 * v0 + C * v0 * v0 - 1.0], axis=-1)


def axes_of(x: Array) -> tuple[Array, Array]:
    """(u0, v0, a, b, φ) (…, 5) of ellipses (u0, v0, m, g, h), and their Jacobian (…, 5, 5).

    φ lies in [0, π). Of a circle it is undetermined; its derivatives, which grow as 1/(a − b), are
    then huge but finite.
    """
    m, g, h = x[..., 2], x[..., 3], x[..., 4]
    half = np.hypot(g, h)
    twice = np.arctan2(h, g)
    phi = np.mod(0.5 * twice, np.pi)
    phi = np.where(phi >= np.pi, 0.0, phi)  # mod of a tiny negative number rounds to π
    axes = np.stack([x[..., 0], x[..., 1], m + half, m - half, phi], axis=-1)
    c, s = np.cos(twice), np.sin(twice)
    turn = 0.5 / np.maximum(half, np.finfo(float).eps * m)
    J = np.zeros(x.shape + (5,))
    J[..., [0, 1], [0, 1]] = 1.0
    J[..., 2:4, 2] = 1.0
    J[..., 2, 3], J[..., 2, 4] = c, s
    J[..., 3, 3], J[..., 3, 4] = -c, -s
    J[..., 4, 3], J[..., 4, 4] = -s * turn, c * turn
    return axes, J


def minimal_fit(samples: Array) -> Array:
    """(u0, v0, m, g, h) of ellipses through five points (…, 5, 2); NaN unless there is one."""
    u, v = samples[..., 0], samples[..., 1]
    # With A + C = 1, which an ellipse always allows, five unknowns are left: A − C, B, D, E, F.
    columns = np.stack([0.5 * (u * u - v * v), u * v, u, v, np.ones_like(u)], axis=-1)
    difference, B, D, E, F = np.moveaxis(
        solve(columns, -0.5 * (u * u + v * v)[..., None])[..., 0], -1, 0
    )
    return ellipse_of(
        np.stack([0.5 + 0.5 * difference, B, 0.5 - 0.5 * difference, D, E, F], axis=-1)
    )


def direct_from_factor(R: Array) -> tuple[Array, Array]:
    """The ellipse ``min Σ P f²`` with 4AC − B² = 1, from a triangular factor (…, 6, 6).

    It is that of the rows ``√P (1, u, v, u², uv, v²)``. Returns conics (…, 6), and (…) bool:
    whether without the condition, at |(A, B, C)| = 1, the best conic is an ellipse too.

    Source: Fitzgibbon, Pilu & Fisher 1999; Halir & Flusser 1998.
    """
    _, s, Vt = np.linalg.svd(R[..., 3:, 3:])
    quadratic, natural = _constrained(s, Vt.swapaxes(-1, -2))
    linear = -solve(R[..., :3, :3], R[..., :3, 3:] @ quadratic[..., None])[..., 0]
    return np.concatenate([quadratic, linear[..., [1, 2, 0]]], axis=-1), natural


def direct_from_points(points: Array, weights: Array) -> tuple[Array, Array]:
    """The ellipse ``min Σ P f²`` with 4AC − B² = 1 of points (…, n, 2) with weights (…, n).

    From sums of powers, which is a little less accurate than from the factor. Leading axes
    broadcast: for K sets of weights (B, K, n) the powers of points (B, 1, n, 2) are made once.
    """
    u, v = points[..., 0], points[..., 1]
    powers_u, powers_v = [np.ones_like(u), u, u * u], [np.ones_like(v), v, v * v]
    powers_u += [powers_u[2] * u, powers_u[2] ** 2]
    powers_v += [powers_v[2] * v, powers_v[2] ** 2]
    monomials = np.stack([powers_u[i] * powers_v[j] for i, j in MONOMIALS], axis=-1)
    sums = (weights[..., None, :] @ monomials)[..., 0, :]
    S = sums[..., PRODUCTS]
    T = -solve(S[..., :3, :3], S[..., :3, 3:])
    reduced = S[..., 3:, 3:] + S[..., 3:, :3] @ T
    fine = np.isfinite(reduced).all(axis=(-1, -2))
    squares, V = np.linalg.eigh(
        np.where(fine[..., None, None], 0.5 * (reduced + reduced.swapaxes(-1, -2)), np.eye(3))
    )
    quadratic, natural = _constrained(np.sqrt(np.maximum(squares[..., ::-1], 0.0)), V[..., ::-1])
    linear = (T @ quadratic[..., None])[..., 0]
    return np.concatenate([quadratic, linear[..., [1, 2, 0]]], axis=-1), natural


def _constrained(s: Array, V: Array) -> tuple[Array, Array]:
    """(A, B, C) with the least ``|diag(s) Vᵀ (A, B, C)|²`` over 4AC − B²; s falls.

    With z = diag(s) Vᵀ (A, B, C) it is the one eigenvector of positive eigenvalue of a symmetric
    matrix. Exact points have a last s of rounding size; it may be that large, but not 0.
    """
    s = np.maximum(s, np.finfo(float).eps * s[..., :1])
    form = V.swapaxes(-1, -2) @ DISCRIMINANT @ V
    G = form / (s[..., :, None] * s[..., None, :]) * s[..., -1:, None] ** 2
    z = np.linalg.eigh(G)[1][..., -1]
    quadratic = (V @ (z / s)[..., None])[..., 0]
    return quadratic / np.linalg.norm(quadratic, axis=-1, keepdims=True), form[..., 2, 2] > 0
