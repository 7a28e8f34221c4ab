"""Where a robust adjustment starts: the surface that chance explains worst.

Trial surfaces through a few points each are compared in two ways.

The half: least trimmed squares, the surface with the least sum of the h smallest squared distances
(Rousseeuw & Van Driessen 2006). It finds any surface that holds more than half of the points.

The band: with L(k) the logarithm of the expected number of surfaces that have k of n evenly spread
points as near as the k nearest ones are (:mod:`analysis.orthogonal.improbability`), the surface
with the least L. It finds a surface that holds fewer, where what else is there is spread out
(Stewart 1995; Moisan & Stival 2004). Nothing has to be known of the noise: each k has its own band.

Where the half lies so close to its surface that nothing among the other points can be the better
one, that is all, for a whole stack at once. Other clouds are searched one by one: the best half
gives the width that the background of a band is counted in, so that clutter of less than half of
the points cannot win as a wide band; and where the surface found is not determined by its points (a
plane seen as a sphere), another one is looked for among the points that are not on it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations
from math import comb

import numpy as np

from ..adjustment.linalg import cofactor_from_normal
from ..blocks import pieces
from ..result import Array
from .contracts import ElementalModel, Start
from .improbability import least_log_nfa, spread
from .least_trimmed_squares import (
    absolute_distances,
    concentrate,
    majority,
    sorted_distances,
    trimmed_spread,
    trimmed_sum,
)

SAMPLES = 100  # trial surfaces of a round
ROUNDS = 10  # at most, of a search
SCREENED = 160  # points by which they are compared
KEPT = 5  # trial surfaces of a round that are improved on all points, of either kind
TOGETHER = 8  # clouds whose trial surfaces are compared at a time, which keeps them in the cache
CHANCE = -5.0  # L below which a band is no chance: exp(−5) such surfaces are expected in a cloud
# Half-width of the best half, over the extent of the cloud, up to which nothing among the other
# points can be the better surface; and beyond which drawing goes on, whatever was found.
TIGHT = 0.03
LOOSE = 0.1
WIDE = 2.0  # half-widths of the best half within which the background of a band is counted
OFF = 2.0  # half-widths of a band beyond which a point is not on its surface
OTHERS = 0.15  # share of such points from which another surface is looked for among them
MISSED = 1e-4  # probability that no clean sample was drawn, at which drawing ends
# Lengths of a determined surface: so many standard deviations, and half as many half-widths of its
# band, at least; in the frame's unit, beyond which rounding decides, at most.
DETERMINED = 10.0
LARGEST = 300.0


def find_start(model: ElementalModel, D: Array, seed: int) -> Start:
    """Surfaces to start from, of points D (B, n, dim) at different places.

    The points come in an order of their own, so that the samples do not depend on the order given.
    All are treated alike: a small cofactor does not make a point a good one.
    """
    start, settled = _best_halves(model, D, seed)
    for b in np.flatnonzero(~settled):
        found = _search(model[b : b + 1], D[b : b + 1], seed)
        for values, value in zip(start, found, strict=True):
            values[b] = value
    return start


def _best_halves(model: ElementalModel, D: Array, seed: int) -> tuple[Start, np.ndarray]:
    """The best half of each cloud, and where (B,) it settles the matter."""
    n, m, h = D.shape[1], model.sample, majority(D.shape[1], model)
    draws, screen = _samples(n, m, seed, 0), _screen(n, seed)
    h_screen = majority(len(screen), model)
    found = []
    for part in pieces(len(D), TOGETHER):
        # 1. surfaces through samples, compared on some of the points
        own, points = model[part], D[part]
        x = own.minimal_fit(points[:, draws])
        cost = trimmed_sum(sorted_distances(own, x, points[:, screen], np.float32), h_screen)
        # 2. the best of them, and of these the best, on all points
        x = np.take_along_axis(x, np.argsort(cost, axis=-1)[:, :KEPT, None], axis=1)
        x, ordered = concentrate(own, x, points, h, 2)
        best = np.argmin(trimmed_sum(ordered, h), axis=-1)[:, None, None]
        found.append(concentrate(own, np.take_along_axis(x, best, axis=1), points, h, 10))
    x, ordered = (np.concatenate(arrays)[:, 0] for arrays in zip(*found, strict=True))
    # 3. is it more than chance, the majority, close together, and determined?
    size = spread(D)
    least, k = least_log_nfa(ordered, m, size)
    width = ordered[:, h - 1]
    settled = (least < CHANCE) & (2 * k >= n) & (width <= TIGHT * size)
    if settled.any():
        settled[settled] = _determined(model[settled], x[settled], D[settled], width[settled])
    sd = trimmed_spread(trimmed_sum(ordered, h), h, n)
    return Start(x, sd, np.full(len(D), h), np.ones(len(D), dtype=bool)), settled


@dataclass(frozen=True)
class _Candidate:
    """A surface x (s,) of one cloud, and what speaks for it.

    least : L, of its ``count`` nearest points; width : of the half or band it rests on, one-sided
    spread : of the distances, as a standard deviation; determined : whether its points determine it
    """

    x: Array
    least: float
    count: int
    width: float
    spread: float
    determined: bool

    @property
    def speaks(self) -> bool:
        """Whether it is more than chance, and determined."""
        return self.determined and self.least < CHANCE


def _search(model: ElementalModel, D: Array, seed: int) -> tuple[Array, float, int, bool]:
    """The surface to start from of one cloud, D (1, n, dim), as in :class:`Start`."""
    found, half = _half_or_band(model, D, seed)
    if not found.determined:
        d = model.distances(found.x[None, None], D)[0, 0]
        off = ~(np.abs(d) <= OFF * found.width)
        if np.count_nonzero(off) >= max(2 * model.sample + 2, OTHERS * len(off)):
            other = _half_or_band(model, D[:, off], seed)
            if other[0].speaks:
                found, half = other[0], False
    n = D.shape[1]
    return found.x, found.spread, majority(n, model) if half else found.count, half


def _half_or_band(model: ElementalModel, D: Array, seed: int) -> tuple[_Candidate, bool]:
    """The best half, or where its band stands out from the background, the least probable surface.

    Second, whether it is the half.
    """
    n, m = D.shape[1], model.sample
    screen, size = D[:, _screen(n, seed)], spread(D)
    everything = model.refit(np.full((1, 1, model.size), np.nan), D, np.ones((1, 1, n)))
    half = _best_half(model, everything, D, size, 20)
    band: _Candidate | None = None
    drawn = 0
    for turn in range(ROUNDS):
        draws = _samples(n, m, seed, turn)
        drawn += len(draws)
        x = model.minimal_fit(D[:, draws])
        ordered = sorted_distances(model, x, screen, np.float32)
        # 1. the best half so far
        cost = trimmed_sum(ordered, majority(screen.shape[1], model))
        half = _best_half(model, _least(x, cost, half), D, size, 3)
        # 2. the least probable band so far
        wide = np.minimum(size, WIDE * half.width) if half.determined else size
        least, _ = least_log_nfa(ordered, m, wide[:, None])
        band = _best_band(model, _least(x, least, band), D, wide, 2)
        # 3. Had a clean sample been drawn by now, if what was found holds all good points?
        share = 0.0
        if band.speaks:
            share = band.count / n
        elif half.speaks and half.width <= LOOSE * size[0]:
            share = half.count / n
        missed = drawn * np.log1p(-min(share**m, 1.0 - 1e-12))
        if missed < np.log(MISSED) or drawn >= comb(n, m):
            break
    if band is not None and band.speaks:
        return _best_band(model, band.x[None, None], D, wide, 8), False
    return _best_half(model, half.x[None, None], D, size, 20), True


def least_probable(model: ElementalModel, D: Array, wide: Array) -> tuple[Array, float]:
    """The least probable surface x (s,) of one round of samples of one cloud, and its L.

    D (1, n, dim) stands in an order in which neighbours follow one another; wide (1,) is up to
    where the background is even. It need not be determined by its points.
    """
    n, m = D.shape[1], model.sample
    x = model.minimal_fit(D[:, _samples(n, m, 0, 0)])
    ordered = sorted_distances(model, x, D[:, _screen(n, 0)], np.float32)
    least, _ = least_log_nfa(ordered, m, wide[:, None])
    x, least, _, _ = _refined(model, _least(x, least, None), D, wide, 3)
    best = int(np.argmin(least))
    return x[0, best], float(least[0, best])


def _least(x: Array, cost: Array, best: _Candidate | None) -> Array:
    """The `KEPT` surfaces of x (1, S, s) with the least cost (1, S), and the best one before."""
    kept = x[:, np.argsort(cost[0])[:KEPT]]
    return kept if best is None else np.concatenate([kept, best.x[None, None]], axis=1)


def _best_half(model: ElementalModel, x: Array, D: Array, size: Array, steps: int) -> _Candidate:
    """The best of the surfaces x (1, K, s) by its half, after concentration steps."""
    n, h = D.shape[1], majority(D.shape[1], model)
    x, ordered = concentrate(model, x, D, h, steps)
    cost = trimmed_sum(ordered, h)[0]
    best = int(np.argmin(cost))
    x, ordered, width = x[:, best], ordered[:, best], ordered[:, best, h - 1]
    least, k = least_log_nfa(ordered, model.sample, size)
    determined = _determined(model, x, D, width)[0]
    sd = float(trimmed_spread(cost[best], h, n))
    return _Candidate(x[0], least[0], int(k[0]), width[0], sd, bool(determined))


def _best_band(model: ElementalModel, x: Array, D: Array, wide: Array, steps: int) -> _Candidate:
    """The best of the surfaces x (1, K, s) by its band; determined surfaces come first."""
    x, least, k, width = _refined(model, x, D, wide, steps)
    many = np.broadcast_to(D, (x.shape[1],) + D.shape[1:])
    determined = _determined(model[np.zeros(x.shape[1], dtype=int)], x[0], many, width[0])
    speaks = determined & (least[0] < CHANCE)
    best = int(np.lexsort([least[0], ~speaks])[0])
    within = float(width[0, best])
    return _Candidate(
        x[0, best], least[0, best], int(k[0, best]), within, 0.5 * within, bool(determined[best])
    )


def _refined(
    model: ElementalModel, x: Array, D: Array, wide: Array, steps: int
) -> tuple[Array, Array, np.ndarray, Array]:
    """Surfaces x (1, K, s) refitted to the points of their bands.

    Again and again, as long as that makes a band less probable. Returns x, L (1, K), the number of
    points in each band and its half-width.
    """
    m = model.sample
    d = absolute_distances(model, x, D)
    ordered = np.sort(d, axis=-1)
    least, k = least_log_nfa(ordered, m, wide[:, None])
    width = _at(ordered, k)
    for _ in range(steps):
        new = model.refit(x, D, (d <= width[..., None]).astype(float))
        theirs = absolute_distances(model, new, D)
        ordered = np.sort(theirs, axis=-1)
        now, number = least_log_nfa(ordered, m, wide[:, None])
        better = now < least
        if not better.any():
            break
        least, k = np.where(better, now, least), np.where(better, number, k)
        width = np.where(better, _at(ordered, number), width)
        x, d = np.where(better[..., None], new, x), np.where(better[..., None], theirs, d)
    return x, least, k, width


def _at(ordered: Array, k: np.ndarray) -> Array:
    """The k-th smallest distances, (B, K)."""
    return np.take_along_axis(ordered, k[..., None] - 1, axis=-1)[..., 0]


def _determined(model: ElementalModel, x: Array, D: Array, width: Array) -> np.ndarray:
    """Whether (B,) the points D (B, n, dim) within ``width`` (B,) of x (B, s) determine it.

    Its lengths must stand out from their standard deviations, after the step that the points still
    ask for, and from the width.
    """
    lengths, gradients = model.lengths(x)
    if lengths.shape[-1] == 0:
        return np.asarray(np.isfinite(x).all(axis=-1))
    with np.errstate(all="ignore"):
        f, J = model.linearised(x, D)
        weighed = J * (np.abs(f) <= width[:, None])[:, None, :]
        cofactor = cofactor_from_normal(weighed @ J.swapaxes(-1, -2))
        step = np.abs(gradients @ (cofactor @ (weighed @ f[..., None])))[..., 0]
        sd = np.sqrt(np.einsum("bqt,btu,bqu->bq", gradients, cofactor, gradients))
        sd *= 0.5 * width[:, None]
        large = (lengths - step > DETERMINED * sd) & (lengths > 0.5 * DETERMINED * width[:, None])
        return np.all(large & (lengths < LARGEST), axis=-1)


@lru_cache(maxsize=64)
def _screen(n: int, seed: int) -> np.ndarray:
    """Places of the points that trial surfaces are compared by."""
    return np.sort(np.random.default_rng(seed).permutation(n)[:SCREENED])


@lru_cache(maxsize=64)
def _samples(n: int, m: int, seed: int, turn: int) -> np.ndarray:
    """(S, m) places of samples among n points: all of few points, or some that differ per turn.

    Half of these come from all over, half from neighbours, which are more often on one surface.
    """
    if comb(n, m) <= SAMPLES:
        return np.array(list(combinations(range(n), m)))
    generator = np.random.default_rng([seed, turn])
    window = max(min(n, 3 * m), n // 8)
    first = generator.integers(n - window + 1, size=(SAMPLES // 2, 1))
    near = draw_distinct(generator, window, m, SAMPLES // 2) + first
    return np.concatenate([draw_distinct(generator, n, m, SAMPLES - SAMPLES // 2), near])


def draw_distinct(generator: np.random.Generator, n: int, m: int, count: int) -> np.ndarray:
    """(count, m) whole numbers below n, those of a row different."""
    drawn = np.empty((count, m), dtype=int)
    for j in range(m):
        new = generator.integers(n - j, size=count)
        for lower in np.sort(drawn[:, :j], axis=-1).T:  # step over those that are taken
            new += new >= lower
        drawn[:, j] = new
    return drawn
