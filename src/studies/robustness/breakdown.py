"""Breakdown: how many gross errors, and of which kind, does each method bear?

The sphere of table 1 of Ou & Liu (2017), its points good to the rounding of the coordinates; a
growing share of them is replaced. A fit succeeds when its centre is within 10 mm of the truth,
several standard deviations of a good fit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..montecarlo import EVERY_METHOD, sphere_study
from ..ou_liu_2017.clouds import SPHERE, SPHERE_CENTER, SPHERE_RADIUS, SPHERE_SIDE, sphere_redraws
from .redraws import failures, median_of_all, share_interval, stacked

WITHIN = 0.01  # m
DEPTH = (1.0, 3.0)  # m towards the centre
VARIANTS = EVERY_METHOD | {
    "igg3_wtls, not cumulative": {"method": "igg3_wtls", "cumulative": False},
    "igg3_wtls, not cumulative, MAD": {"method": "igg3_wtls", "cumulative": False, "scale": "mad"},
}
# their orthogonal distance fit: what the noise would leave anyway
GOOD_POINTS = "good points alone"
PATTERNS = {
    "clustered": "neighbours, all inside",
    "one-sided": "scattered, all inside",
    "uniform": "anywhere in the box",
}


def replaced(
    points: NDArray[np.float64], pattern: str, count: int, seed: int
) -> NDArray[np.float64]:
    """Copies of the clouds (B, n, 3), m, in each of which `count` points are gross errors.

    - ``clustered``: a point drawn at random and its nearest neighbours, each moved U(1, 3) m
      towards the centre
    - ``one-sided``: points drawn at random, moved in the same way
    - ``uniform``: points drawn at random, replaced by points anywhere in the box that holds the cap

    The points replaced at a count stay replaced in the same way at every higher one.

    >>> cloud = sphere_redraws(1)
    >>> few, many = (
    ...     np.any(replaced(cloud, "one-sided", count, seed=1) != cloud, axis=-1)
    ...     for count in (5, 9)
    ... )
    >>> int(few.sum()), int(many.sum()), bool(np.all(many[few]))
    (5, 9, True)
    """
    n = points.shape[1]
    order, uniform = stacked(
        lambda generator: (generator.permutation(n), generator.uniform(size=(n, 3))),
        len(points),
        seed,
    )
    trials = np.arange(len(points))[:, None]
    if pattern == "clustered":
        order = np.argsort(np.linalg.norm(points - points[trials, order[:, :1]], axis=-1), axis=-1)
    chosen = trials, order[:, :count]
    moved, uniform = points.copy(), uniform[:, :count]
    if pattern == "uniform":
        moved[chosen] = [0.0, 0.0, SPHERE_CENTER[2]] + uniform * [
            SPHERE_SIDE,
            SPHERE_SIDE,
            SPHERE_RADIUS,
        ]
    else:
        radial = points[chosen] - SPHERE_CENTER
        depth = DEPTH[0] + uniform[..., :1] * (DEPTH[1] - DEPTH[0])
        moved[chosen] -= depth * radial / np.linalg.norm(radial, axis=-1, keepdims=True)
    return moved


def study(
    shares: Sequence[float],
    trials: int,
    n: int,
    seed: int,
    variants: Mapping[str, Mapping] = VARIANTS,
    patterns: Sequence[str] = tuple(PATTERNS),
) -> pd.DataFrame:
    """Share of the runs within 10 mm for every variant, pattern and share of gross errors.

    Parameters
    ----------
    shares : of gross errors, 0 to 0.5; trials : redraws of each; n : points a cloud, at most 500;
        seed : of the gross errors.
    variants : label -> keyword arguments of `fit_sphere`; patterns : keys of `PATTERNS`.

    Returns
    -------
    One row a pattern, share and variant, `GOOD_POINTS` after the others: ``pattern``,
    ``gross_percent``, ``variant``; ``within_percent`` with its 95 % interval ``low_percent``,
    ``high_percent``; ``median_error_mm`` of the centre (`redraws.median_of_all`); ``failed``
    (`redraws.failures`). Without gross errors all patterns are one, and it is run once.
    """
    clean = np.ascontiguousarray(sphere_redraws(trials)[:, :n])
    rows = []
    for share in shares:
        count = round(share * n)
        for pattern in patterns if count else patterns[:1]:
            points = replaced(clean, pattern, count, seed)
            good = clean[np.all(points == clean, axis=-1)].reshape(trials, n - count, 3)
            frames = sphere_study(points, SPHERE, variants)
            frames |= sphere_study(good, SPHERE, {GOOD_POINTS: {"method": "geometric"}})
            for variant, frame in frames.items():
                row = {"gross_percent": 100 * share, "variant": variant} | _summary(frame)
                rows += [{"pattern": name} | row for name in ([pattern] if count else patterns)]
    return pd.DataFrame(rows).sort_values(
        ["pattern", "gross_percent"], kind="stable", ignore_index=True
    )


def _summary(frame: pd.DataFrame) -> dict:
    converged = frame["converged"].to_numpy()
    error = np.linalg.norm(frame[["delta_a_m", "delta_b_m", "delta_c_m"]], axis=-1)
    within = np.count_nonzero(converged & (error < WITHIN))
    low, high = share_interval(within, len(frame))
    return {
        "within_percent": 100 * within / len(frame),
        "low_percent": float(low),
        "high_percent": float(high),
        "median_error_mm": 1e3 * median_of_all(error, ~converged),
        "failed": failures(~converged),
    }
