"""Wrong pairs: a start without them, and weights by a test of each pair against all others."""

from __future__ import annotations

from functools import cache
from itertools import combinations
from math import comb

import numpy as np
from scipy.integrate import quad
from scipy.stats import chi2, norm
from scipy.stats import f as fisher

from ..adjustment.linalg import solve
from ..adjustment.weights import IGG3
from ..blocks import BLOCK, pieces
from .closed_form import umeyama_centred
from .pairs import Pairs

DOUBT = 0.01  # probability of a sum of squares from which variances said to be known are doubted
SUBSETS = 500  # subsets of three pairs that the robust start tries; all of them up to 15 pairs
SMALLEST_REDUNDANCY = 1e-3  # of a direction of a pair, when its misclosure is standardised


def normal_matrix(weights: np.ndarray, J: np.ndarray) -> np.ndarray:
    """``Σ ω JᵀJ`` (B, t, t) over the pairs, for weights (B, n) and design (B, n, 3, t)."""
    return np.einsum("bn,bnki,bnkj->bij", weights, J, J, optimize=True)


def robust_weights(
    function: IGG3, r, J, weights, inflation, pairs: Pairs, absolute: bool
) -> np.ndarray:
    """IGG III weights (B, n) from the test of each pair against all others.

    With h_k and r_k the leverages (eigenvalues of J N⁻¹ Jᵀ) and misclosures of a pair along their
    three principal axes,

        T² = Σ r_k² / ((1 − ωh_k)(1 + (1 − ω)h_k)),   Ω' = Ω − Σ ω r_k² / (1 − ωh_k)

    are the square of its misclosure to the adjustment of all others, standardised, and the sum of
    squares that these have with f degrees of freedom: whatever its own weight ω, a pair is judged
    by the others alone. For a good pair T² f/(3Ω') is F(3, f), with known variances T² is χ²(3).
    Its probability, as that of a standard normal |u|, gives the weight, so few pairs are judged
    with the caution they need. Variances said to be known are not believed where the others
    contradict them (Ω' against χ²(f)): too small ones would reject pair after pair.
    """
    t = J.shape[-1]
    leverage = J @ solve(normal_matrix(weights, J)[:, None], J.mT)
    # singular equations end the iteration, not this test
    leverage = np.where(np.isfinite(leverage), leverage, 0.0)
    h, axes = np.linalg.eigh(0.5 * (leverage + leverage.mT))
    squares = np.einsum("bnki,bnk->bni", axes, r) ** 2
    w = weights[..., None]
    free = np.maximum(1.0 - w * h, SMALLEST_REDUNDANCY)
    T2 = np.sum(squares / (free * (1.0 + (1.0 - w) * h)), axis=-1)
    whole = inflation * np.sum(weights * np.sum(r**2, axis=-1), axis=-1)
    others = whole[:, None] - np.sum(w * squares / free, axis=-1)
    freedom = 3.0 * (np.sum(weights, axis=-1, keepdims=True) - weights) - t
    testable = freedom > 0.5  # the others determine more than a transformation
    freedom = np.where(testable, freedom, 1.0)
    others = np.maximum(others, freedom * pairs.rounding[:, None] ** 2 * pairs.w)
    probability = fisher.sf(T2 / 3.0 * freedom / others, 3, freedom)
    if absolute:
        believed = chi2.sf(others, freedom) > DOUBT
        probability = np.where(believed, chi2.sf(T2, 3), probability)
    return np.where(testable, function.weight(norm.isf(0.5 * probability)), weights)


@cache
def normal_means(function: IGG3) -> tuple[float, float, float]:
    """E[ω], E[ωd²]/3 and E[ω²d²]/3 for good pairs, d² their χ² with three degrees of freedom."""

    def mean(power: int) -> float:
        def integrand(u):
            squared = chi2.isf(2.0 * norm.sf(u), 3)  # d² of the same probability as |u|
            return function.weight(u) ** power * squared / 3.0 * 2.0 * norm.pdf(u)

        edges = [(0.0, function.k0), (function.k0, function.k1)]
        return sum(quad(integrand, *pair)[0] for pair in edges)

    return function.mean_weight, mean(1), mean(2)


@cache
def _trimmed_variance(share: float) -> float:
    """Mean of d²/3 over the ``share`` of the smallest d², each χ² with three degrees of freedom."""
    return float(chi2.cdf(chi2.ppf(share, 3), 5) / share) if share < 1 else 1.0


def trimmed_start(pairs: Pairs, free_scale: bool, seed: int) -> tuple[np.ndarray, float]:
    """Weights (B, n) to start from, and by how much their sum of squares is too small.

    The weight is 1 for the more than half of the pairs that agree best with three of them, else 0.
    """
    n = pairs.w.shape[1]
    h = n // 2 + 1
    # 1. the best of many similarities through three pairs each
    subsets = _subsets(n, seed)
    w = np.empty_like(pairs.w)
    for part in pieces(len(w), max(1, 4 * BLOCK // (len(subsets) * n))):
        some = pairs[part]
        found = umeyama_centred(
            some.x[:, subsets], some.X[:, subsets], some.w[:, subsets], free_scale
        )
        squares = _weighted_squares(some, *found)
        least = np.partition(squares, h - 1, axis=-1)[..., :h]
        best = np.argmin(np.sum(least, axis=-1), axis=-1)
        w[part] = _smallest(np.take_along_axis(squares, best[:, None, None], axis=1)[:, 0], h)
    # 2. closed form of the pairs chosen, and choice of those nearest to it, until it is the same
    for _ in range(20):
        mu, R, T = umeyama_centred(pairs.x, pairs.X, w * pairs.w, free_scale)
        before = w
        w = _smallest(_weighted_squares(pairs, mu[:, None], R[:, None], T[:, None])[:, 0], h)
        if np.array_equal(w, before):
            break
    return w, 1.0 / _trimmed_variance(h / n)


def _subsets(n: int, seed: int) -> np.ndarray:
    """(K, 3) subsets of three of n pairs: all, or `SUBSETS` drawn ones where there are more."""
    if comb(n, 3) <= SUBSETS:
        return np.array(list(combinations(range(n), 3)))
    draws = np.random.default_rng(seed).uniform(size=(SUBSETS, n))
    return np.argpartition(draws, 3, axis=-1)[:, :3]


def _weighted_squares(pairs: Pairs, mu, R, T) -> np.ndarray:
    """w|r|² (B, K, n) of all pairs under K transformations each."""
    turned = pairs.x[:, None] @ (mu[..., None, None] * R).mT
    return pairs.w[:, None] * np.sum((pairs.X[:, None] - T[:, :, None, :] - turned) ** 2, axis=-1)


def _smallest(squares: np.ndarray, h: int) -> np.ndarray:
    """1 for the h smallest of the squares (B, n), else 0."""
    order = np.argsort(squares, axis=-1, kind="stable")[:, :h]
    chosen = np.zeros_like(squares)
    np.put_along_axis(chosen, order, 1.0, axis=-1)
    return chosen
