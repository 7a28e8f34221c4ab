"""How improbable it is that chance alone puts so many points so close to one surface.

Through m of n points a surface can be laid. If the others were spread evenly, up to a distance Δ
from it, k of all n would be within δ of it by chance as often as a binomial law says. The number of
false alarms, NFA, is the number of such bands that chance makes of n points, expected over all
samples of m points and all k:

    ln NFA(k) = ln(n − m) + ln C(n, k) + ln C(k, m) + (k − m) ln min(1, δ_k/Δ)

with the k-th smallest distance δ_k. The band that is least probable says how many points lie on the
surface; nothing has to be known of the noise, or of the share of gross errors.

Source: Moisan & Stival 2004, section 3; Stewart 1995 (MINPRAN).
"""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.special import gammaln

from ..result import Array

BANDS = 48  # numbers of points in a band that are looked at, evenly spread on a logarithmic scale
NARROWEST = 1e-12  # of a band in units of Δ: what is closer is rounding


def spread(D: Array) -> Array:
    """Median distance (…) of the points D (…, n, dim) from their median: Δ of a whole cloud.

    >>> float(spread(np.array([[0.0, 0.0], [3.0, 4.0], [-3.0, -4.0], [6.0, 8.0], [-6.0, -8.0]])))
    5.0
    """
    centred = D - np.median(D, axis=-2, keepdims=True)
    return np.sqrt(np.median(np.einsum("...ni,...ni->...n", centred, centred), axis=-1))


def least_log_nfa(distances: Array, sample: int, scale: Array) -> tuple[Array, Array]:
    """Least ln NFA (…) of a band around each surface, and the number k (…) of points in it.

    Parameters
    ----------
    distances : (…, n) absolute distances of the points from each surface, in ascending order; NaN
        or infinite where there is no surface
    sample : m, the number of points that determine a surface
    scale : Δ, broadcast to (…), in the unit of the distances: up to where the background is even

    Returns
    -------
    ln NFA, infinite where there is no surface, and k. Below −5 chance makes less than one such band
    in a hundred clouds.

    >>> on_a_line = np.r_[np.linspace(0.0, 0.01, 20), np.linspace(0.05, 1.0, 10)]
    >>> L, k = least_log_nfa(on_a_line, 2, 1.0)
    >>> round(float(L)), int(k)
    (-57, 20)
    """
    ks, log_tests = _bands(distances.shape[-1], sample)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = distances[..., ks - 1] / np.asarray(scale)[..., None]
        L = log_tests + (ks - sample) * np.log(np.clip(share, NARROWEST, 1.0))
    L[~np.isfinite(distances[..., ks - 1])] = np.inf
    best = np.argmin(L, axis=-1)
    return np.take_along_axis(L, best[..., None], axis=-1)[..., 0], ks[best]


@cache
def _bands(n: int, m: int) -> tuple[np.ndarray, np.ndarray]:
    """The numbers k, and ``ln(n − m) + ln C(n, k) + ln C(k, m)``.

    A band of only one more than the sample is no evidence: coordinates on a grid make such by
    rounding.
    """
    first = min(m + 2, n)
    ks = np.unique(np.round(np.geomspace(first, n, BANDS)).astype(int))
    log_tests = np.log(max(n - m, 1)) + gammaln(n + 1) - gammaln(n - ks + 1)
    return ks, log_tests - gammaln(m + 1) - gammaln(ks - m + 1)
