"""Checks that look for other surfaces: one beside the surface found, and one in place of it.

They are looked for only where there is room for them: many points off the surface, or a wide band
around it.
"""

from __future__ import annotations

import numpy as np

from ..orthogonal.improbability import least_log_nfa, spread
from ..orthogonal.least_trimmed_squares import absolute_distances, sorted_distances
from ..orthogonal.start import least_probable
from ..result import Array
from .check import Check, at_most
from .examined import Examined

POINTS = 1000  # that are looked at
OFF = 4.0  # σ from where a point is not on the surface
MANY_OFF = 0.15  # of the points
NARROW = 0.03  # of the cloud's spread: half of the points this close leave no room for another one
SIGNIFICANT = -10.0  # ln NFA
LARGEST = 100.0  # number that describes a surface in the frame; beyond it is a plane in disguise
EQUAL = 1.0 / 3.0  # of the points on the surface found, that make another one of equal right
RIVAL = 2.0
SHARES = (0.2, 0.3, 0.4, 0.5)  # of all points, within whose bands two surfaces are compared


def other_checks(e: Examined) -> list[Check]:
    """Those that look for other surfaces; none of a surface that no sample determines."""
    if not hasattr(e.model, "minimal_fit") or e.sigma == 0.0:
        return []
    order = e.order[:: max(1, len(e.D) // POINTS)]
    return [other(e, order), rival(e, order)]


def other(e: Examined, order: Array) -> Check:
    """Points off this surface and on another one, over the points on this one."""
    off = np.abs(e.distances[order]) > OFF * e.sigma
    count, value, words = np.count_nonzero(off), 0.0, ""
    if count >= max(2 * e.model.sample + 2, MANY_OFF * len(order)):
        rest = e.D[None, order[off]]
        x, L = least_probable(e.model, rest, spread(rest))
        if L < SIGNIFICANT and np.abs(x).max() < LARGEST:
            on = np.count_nonzero(absolute_distances(e.model, x[None, None], rest) < OFF * e.sigma)
            value = float(on / np.maximum(len(order) - count, 1))
            words = _in_words(e, x)
    return at_most(
        "other",
        value,
        EQUAL,
        "No other surface holds as many points.",
        f"Another surface holds {value:.2f} times as many points: {words}; keep the points of the "
        "one that is meant.",
    )


def rival(e: Examined, order: Array) -> Check:
    """Points in the band of another surface beyond those that this one has in the same width.

    ``max (k − m − own)/√(own + 1)`` over the bands of a fifth to a half of the points.
    """
    D, own = e.D[order], np.sort(np.abs(e.distances[order]))
    n, m, value, words = len(D), e.model.sample, 0.0, ""
    off = np.count_nonzero(own > OFF * e.sigma)
    if off >= MANY_OFF * n or own[n // 2] > NARROW * e.spread:
        _, k = least_log_nfa(own, m, e.spread)
        x, _ = least_probable(e.model, D[None], own[k - 1 : k])
        if np.isfinite(x).all():
            theirs = sorted_distances(e.model, x[None, None], D[None])[0, 0]
            k = np.minimum(np.maximum((np.array(SHARES) * n).astype(int), 2 * m + 2), n)
            same = np.searchsorted(own, theirs[k - 1], side="right")
            value = max(0.0, float(np.max((k - m - same) / np.sqrt(same + 1.0))))
            words = _in_words(e, x)
    return at_most(
        "rival",
        value,
        RIVAL,
        "No other surface has more points as close.",
        f"Another surface has more points as close: {words}; the one found is not the best, "
        "cut the scan down to the object.",
    )


def _in_words(e: Examined, x: Array) -> str:
    """A surface in the frame, described in the coordinates given."""
    _, x = e.model.in_frame(x[None], -e.origin / e.length[:, None], 1.0 / e.length)
    return e.model.in_words(x[0])
