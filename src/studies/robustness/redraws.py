"""Common ground of the studies: trials of their own, a target sphere, the error of a share."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from ..ou_liu_2017.table3_relations import RADIUS

# A target sphere of Ou & Liu (2017), section 2.2, before a scanner in the origin.
RANGE = 6.0  # m; the line of sight is the x axis
TARGET = np.array([RANGE, 0.0, 0.0, RADIUS])  # a, b, c, r


def stacked(
    draw: Callable[[np.random.Generator], tuple], trials: int, seed: int
) -> tuple[NDArray[np.float64], ...]:
    """The arrays that `draw` makes from the generator of each trial, each stacked to (B, …).

    >>> def draw(generator):
    ...     return generator.uniform(size=2), generator.standard_normal(3)
    >>> first, _ = stacked(draw, 5, seed=1)
    >>> again, _ = stacked(draw, 9, seed=1)
    >>> first.shape, bool(np.all(first == again[:5]))
    ((5, 2), True)
    """
    children = np.random.SeedSequence(seed).spawn(trials)
    return tuple(
        map(np.array, zip(*(draw(np.random.default_rng(child)) for child in children), strict=True))
    )


def cap_normals(uniform: NDArray[np.float64], half_angle: float) -> NDArray[np.float64]:
    """Outward unit normals (…, n, 3) spread evenly over the cap that faces the scanner.

        cos ψ = 1 − u₁ (1 − cos θ),   φ = 2π u₂,   normal = (−cos ψ, sin ψ cos φ, sin ψ sin φ)

    uniform : (…, n, 2) numbers u in [0, 1]; half_angle : θ in degrees, 180 for the whole sphere.

    >>> cap_normals(np.array([[1.0, 0.0]]), 90).round(12).tolist()
    [[-0.0, 1.0, 0.0]]
    """
    cosine = 1.0 - uniform[..., 0] * (1.0 - np.cos(np.radians(half_angle)))
    sine = np.sqrt(1.0 - cosine**2)
    around = 2.0 * np.pi * uniform[..., 1]
    return np.stack([-cosine, sine * np.cos(around), sine * np.sin(around)], axis=-1)


def failures(failed: NDArray[np.bool_]) -> int:
    """Number of fits that failed; from a twentieth of them on to the nearest tenth.

    A method that gross errors have thrown far off wanders about, and whether it then fails depends
    on the last bit of a sum, which differs from processor to processor.

    >>> failures(np.arange(2000) < 7), failures(np.arange(2000) < 415)
    (7, 400)
    """
    count, trials = int(np.count_nonzero(failed)), len(failed)
    return count if count < trials / 20 else int(10 * count / trials + 0.5) * trials // 10


def median_of_all(values: NDArray[np.float64], failed: NDArray[np.bool_]) -> float:
    """Median over the fits that did not fail; missing where a twentieth or more did, and the others
    say little.
    """
    return (
        float(np.median(values[~failed])) if np.count_nonzero(failed) < len(failed) / 20 else np.nan
    )


def share_interval(count, trials: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """95 % confidence interval of a share of which `count` in `trials` were seen, in percent
    (Wilson 1927).

    Unlike the binomial standard error it does not shrink to nothing at 0 and at 100 %.

    >>> low, high = share_interval(2000, 2000)
    >>> print(f"{low:.2f} {high:.2f}")
    99.81 100.00
    """
    z2 = norm.ppf(0.975) ** 2
    share = np.asarray(count) / trials
    middle = (share + 0.5 * z2 / trials) / (1.0 + z2 / trials)
    half = np.sqrt(z2 * (share * (1.0 - share) / trials + 0.25 * z2 / trials**2)) / (
        1.0 + z2 / trials
    )
    return 100.0 * np.maximum(middle - half, 0.0), 100.0 * np.minimum(middle + half, 1.0)
