"""Radial change of a section, divided into a mean change, a motion of the ring and a new shape."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.adjustment.linalg import cofactor_from_factor
from analysis.tunnel.outlines import RadialChange

ORDER = 4  # of the Fourier series: an ellipse with 22 mm between its axes is one to 0.001 mm


@dataclass(frozen=True, eq=False)
class Split:
    """Δρ(α) of sections (…) as a mean change, a motion of the ring, and a change of shape; m.

    mean : (…) mean change of the radius c0
    translation : (…, 2) motion of the ring (u, v) = (s1, c1)
    translation_covariance : (…, 2, 2) of it, m²
    rigid : (…, K) c1 cos α + s1 sin α
    shape : (…, K) Δρ − mean − rigid
    """

    mean: np.ndarray
    translation: np.ndarray
    translation_covariance: np.ndarray
    rigid: np.ndarray
    shape: np.ndarray


def split(change: RadialChange) -> Split:
    """Divide Δρ(α) into mean, rigid and shape part by a Fourier series over its directions.

    ``c0 + Σ_k (c_k cos kα + s_k sin kα)``, k ≤ 4.

    Registration error is a motion, too: it is in the rigid part and its covariance, and hardly in
    the shape.

    Raises ``ValueError`` for fewer than 9 directions, or when they leave so large a gap that they
    do not tell the terms apart.

    >>> from analysis.tunnel.outlines import ANGLES
    >>> wave = 0.001 + 0.002 * np.cos(ANGLES) + 0.003 * np.cos(2 * ANGLES)
    >>> nothing, exact = np.zeros((len(ANGLES), 1)), np.zeros((1, 1))
    >>> parts = split(RadialChange(ANGLES, wave, wave, wave, nothing, exact))
    >>> shown = parts.mean, parts.translation[1], parts.shape[135]
    >>> [round(1000 * float(part), 3) for part in shown]
    [1.0, 2.0, 3.0]
    """
    F = fourier_rows(change.angles)
    inverse = cofactor_from_factor(_factor(F)) @ F.T  # of coefficients from Δρ
    coefficients, covariance = change.combination(inverse[:3])
    rigid = coefficients[..., 1:] @ F[:, 1:3].T
    return Split(
        mean=coefficients[..., 0],
        translation=coefficients[..., [2, 1]],
        translation_covariance=covariance[..., [[2], [1]], [2, 1]],
        rigid=rigid,
        shape=change.difference - coefficients[..., :1] - rigid,
    )


def fourier_rows(angles: np.ndarray, order: int = ORDER) -> np.ndarray:
    """Rows ``(1, cos α, sin α, cos 2α, sin 2α, …)``, (K, 2·order + 1).

    >>> fourier_rows(np.array([0.0, np.pi / 2]), 1).round(12)
    array([[1., 1., 0.],
           [1., 0., 1.]])
    """
    multiples = angles[:, None] * np.arange(1, order + 1)
    waves = np.stack([np.cos(multiples), np.sin(multiples)], axis=-1).reshape(len(angles), -1)
    return np.concatenate([np.ones((len(angles), 1)), waves], axis=-1)


def _factor(rows: np.ndarray) -> np.ndarray:
    """Triangular factor (P, P) of rows (K, P), which must tell their columns apart."""
    if len(rows) < rows.shape[1]:
        raise ValueError(
            f"directions: expected at least {rows.shape[1]} for this order, got {len(rows)}"
        )
    R = np.asarray(np.linalg.qr(rows, mode="r"))
    extents = np.linalg.svd(R, compute_uv=False)
    share = extents[-1] / extents[0]
    if not share > 1e-6:
        raise ValueError(
            "directions: expected some all around the section, got a condition number of "
            f"{1 / max(share, 1e-99):.0e}"
        )
    return R
