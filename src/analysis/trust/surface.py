"""Checks of the surface: do the points lie on it, determine it, and see enough of it?"""

from __future__ import annotations

import numpy as np

from ..orthogonal.improbability import least_log_nfa
from ..result import Array
from .check import Check, at_least, at_most
from .examined import Examined

REDUNDANCY = 5  # below which one gross error may stay unseen
JUDGED = 3  # redundancy from which a standard deviation and a band say something
BEYOND_HALF = 0.25  # points in use beyond the half, in √n: what chance can add to a half
STANDING_OUT = 6.0  # standard deviations by which a length must stand out
CHANCE = -3.0  # ln NFA: chance makes such a band in one of twenty clouds of even points


def surface_checks(e: Examined) -> list[Check]:
    """Those of the surface."""
    checks = [redundancy(e), share(e)]
    if e.model.least_half_angle is not None and e.redundancy >= REDUNDANCY:
        checks.append(half_angle(e, e.model.least_half_angle))
    if e.redundancy >= JUDGED:
        if len(e.sizes):
            checks.append(determined(e))
        if hasattr(e.model, "sample"):
            checks.append(chance(e))
    return checks


def redundancy(e: Examined) -> Check:
    """Points in use less free parameters."""
    return at_least(
        "redundancy",
        e.redundancy,
        REDUNDANCY,
        f"{e.redundancy} more points than free parameters are in use.",
        f"Only {e.redundancy} more points than free parameters are in use: a gross error may stay "
        "unseen; measure more points.",
    )


def share(e: Examined) -> Check:
    """Points in use beyond the half that any surface can be laid near, in √n."""
    half = (e.count + e.model.degrees + 1) // 2
    value = (e.used - half) / np.sqrt(e.count) if e.used < e.count else np.inf
    return at_least(
        "share",
        value,
        BEYOND_HALF,
        f"{e.used} of {e.count} points are in use.",
        f"Only {e.used} of {e.count} points are in use, no more than half: another surface may "
        "have as much right; cut the scan down to the object and fit again.",
    )


def determined(e: Examined) -> Check:
    """Smallest length of the surface over its standard deviation."""
    value = float(standing_out(e.sizes, e.deviations))
    return at_least(
        "determined",
        value,
        STANDING_OUT,
        "The points determine the surface.",
        f"A length of the surface is only {value:.1f} times its standard deviation: the points do "
        "not determine it, as points of a wall do not determine a sphere; fit a simpler surface, "
        "or fix the length.",
    )


def half_angle(e: Examined, limit: float) -> Check:
    """Largest angle in degrees of the normals at points in use to their mean.

    For points spread evenly over a cap of half angle θ, an error that is common to its rim moves
    the radius ``√(1 + 3 cot⁴(θ/2))`` times as far: 24 times at 30°. The limits of other surfaces
    are where it is as much.
    """
    normals = e.normals[e.in_use]
    mean = normals.mean(axis=0)
    cosine = (normals @ mean).min(initial=1.0) / max(np.sqrt(mean @ mean), np.finfo(float).tiny)
    value = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    return at_least(
        "seen",
        value,
        limit,
        f"The points see the surface up to {value:.0f}° from their middle.",
        f"The points see the surface only up to {value:.0f}° from their middle, where a common "
        "error of the points moves its size more than twenty times as far: measure more of it, or "
        "fix its size.",
    )


def chance(e: Examined) -> Check:
    """ln NFA of the best band around the surface, against an even background in the cloud."""
    value, k = (float(found) for found in band(e.distances, e.spread, e.model.sample))
    return at_most(
        "chance",
        value,
        CHANCE,
        "Chance would not bring so many points so close to one surface.",
        f"The best band around the surface holds {k:.0f} points and is so wide that points "
        "anywhere in the cloud would fill it by chance: the points lie on no such surface, or the "
        "noise is as large as the object; cut the scan down to the object.",
    )


def standing_out(sizes: Array, deviations: Array) -> Array:
    """Smallest of the lengths (…, k) over their standard deviations, (…)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.abs(sizes) / deviations
    return np.min(np.where(np.isnan(ratios), np.inf, ratios), axis=-1, initial=np.inf)


def band(distances: Array, spread: Array, sample: int) -> tuple[Array, Array]:
    """Least ln NFA (…) of a band around each surface and the points in it; distances (…, n).

    The background is even up to a third of the cloud's spread (of few points up to more of it), so
    that a band as wide as a good part of the cloud counts as nothing.
    """
    scale = spread / np.clip(distances.shape[-1] / 10.0, 1.0, 3.0)
    return least_log_nfa(np.sort(np.abs(distances), axis=-1), sample, scale)
