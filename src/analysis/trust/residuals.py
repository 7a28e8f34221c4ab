"""Checks of the residuals: are they what independent normal errors leave?

Each value is normally distributed with variance 1 (or below) where that is so; 3.1 is then passed
once in a thousand fits on either side.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.special import bdtr, ndtr, ndtri

from .check import Check, at_most
from .examined import Examined

LIMIT = 3.1
WIDER_LIMIT = 3.5  # where the value is not quite normally distributed, or has a sign
FEWEST = 10  # redundancy below which residuals are far from normally distributed
CLIP = 2.5  # from where a residual is not normal noise; the thresholds of the default method
END = 4.0
NEAR = 6.0  # residuals beyond are gross errors
TAIL = 2.0, 12.0  # residuals of mixed pixels and of small steps
QUARTILE = float(ndtri(0.75))  # half of a normal sample lies within
WITHIN_CLIP = float(2.0 * ndtr(CLIP) - 1.0)  # share of a normal sample within CLIP
LAGS = 4  # along the curve
SMALLEST = 1e-300  # of a probability


def residual_checks(e: Examined) -> list[Check]:
    """Those of the residuals; none where they are too few to have a distribution."""
    if e.redundancy < FEWEST or e.sigma == 0.0:
        return []
    checks = [asymmetry(e), tails(e), flatness(e), neighbours(e)]
    return checks if e.station is None else [*checks, incidence(e, e.station)]


def asymmetry(e: Examined) -> Check:
    """Third moment of the residuals, without what a shift of the surface would take off.

    ``Σg/√Σg²``, g = c³ − 3c less its part along ψ, c the residuals clipped at 2.5: the Hermite
    polynomial is orthogonal to what the fit has adjusted, and bounded so that gross errors do not
    decide.
    """
    u = e.u[np.abs(e.u) < NEAR]
    c = np.clip(u, -CLIP, CLIP)
    psi = c * np.clip((END - np.abs(u)) / (END - CLIP), 0.0, 1.0)
    g = c * (c * c - 3.0)
    g -= psi * _ratio(g @ psi, psi @ psi)
    value = _ratio(g.sum(), np.sqrt(g @ g))
    side = "outside" if value > 0 else "inside"
    return at_most(
        "asymmetry",
        abs(value),
        LIMIT,
        "The residuals are symmetric.",
        f"The residuals have more weight on the {side}, as mixed pixels leave them: the surface "
        "is drawn there by up to a standard deviation of a point; cut off the rim of the object, "
        "or filter the scan.",
    )


def tails(e: Examined) -> Check:
    """Signs of the residuals between 2 and 12 σ, in a binomial test."""
    low, high = TAIL
    outside = int(np.count_nonzero((e.u > low) & (e.u < high)))
    inside = int(np.count_nonzero((e.u < -low) & (e.u > -high)))
    many, both = max(outside, inside), outside + inside
    value = -float(ndtri(np.clip(bdtr(both - many, both, 0.5), SMALLEST, 0.5)))
    side = "outside" if outside > inside else "inside"
    return at_most(
        "tails",
        value,
        LIMIT,
        "Large residuals lie on both sides.",
        f"{many} of {both} large residuals lie on the {side}: mixed pixels, or "
        "something in front of the surface or behind it; cut it off and fit again.",
    )


def flatness(e: Examined) -> Check:
    """Points within the quartiles, too few: two surfaces a few σ apart, or errors on a grid."""
    size = np.abs(e.u[e.in_use])
    n = np.count_nonzero(size < CLIP)
    share = 0.5 / WITHIN_CLIP
    inner = np.count_nonzero(size < QUARTILE)
    value = _ratio(share * n - inner, np.sqrt(n * share * (1.0 - share)))
    return at_most(
        "flatness",
        value,
        LIMIT,
        "As many residuals are small as a normal distribution has.",
        f"Only {inner} of {n} residuals are within the quartiles of a normal distribution: the "
        "points lie on both sides of the surface rather than on it; look for two surfaces, or for "
        "another shape.",
    )


def neighbours(e: Examined) -> Check:
    """Correlation of the residuals of neighbours, ``Σ (ρ_k + t/m) √(m/K)`` of the lags k = 1…K.

    Neighbours are those along a Z curve of the feet, so that the residual does not decide who is
    one. The fit leaves residuals whose neighbours correlate by about −t/m.
    """
    z = np.clip(e.u[e.order[e.in_use[e.order]]], -CLIP, CLIP)
    m = len(z)
    products = sum(float(z[lag:] @ z[:-lag]) for lag in range(1, LAGS + 1))
    rho = _ratio(products, LAGS * (z @ z))
    return at_most(
        "neighbours",
        (rho + e.model.degrees / m) * np.sqrt(LAGS * m),
        WIDER_LIMIT,
        "The residuals of neighbours do not correlate.",
        f"The residuals of neighbours correlate by {rho:.2f}: the surface has another shape, or "
        "the errors do not average out and the standard deviations are too small; look at a map "
        "of the residuals.",
    )


def incidence(e: Examined, station: np.ndarray) -> Check:
    """Correlation of squared residuals with the cosine of the incidence angle, times √m."""
    sight = e.points[e.in_use] - station
    away = np.sqrt(np.einsum("ni,ni->n", sight, sight))
    cosine = np.abs(np.einsum("ni,ni->n", sight, e.normals[e.in_use])) / np.maximum(away, SMALLEST)
    squares = np.minimum(e.u[e.in_use] ** 2, CLIP**2)
    cosine, squares = cosine - cosine.mean(), squares - squares.mean()
    size = np.sqrt((squares @ squares) * (cosine @ cosine))
    value = _ratio(squares @ cosine, size) * np.sqrt(len(cosine))
    where = "that are hit head-on" if value > 0 else "at grazing incidence"
    return at_most(
        "incidence",
        abs(value),
        WIDER_LIMIT,
        "The residuals do not depend on the angle of incidence.",
        f"Residuals of points {where} are larger: the errors are not alike in all directions; give "
        "cofactors of the points.",
    )


def _ratio(value: Any, size: Any) -> float:
    """``value/size``; 0 where there is no size."""
    return float(value / size) if size > 0 else 0.0
