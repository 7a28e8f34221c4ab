"""Can any five gross errors give the LS and TLS rows of table 2 together? A search for those that
come nearest.

LS and TLS follow from the 5 × 5 matrix of sums of products of a row (2x, 2y, 2z, 1, w), to which
every gross error adds one product. So the 15 coordinates of the five points can be varied quickly,
and a least-squares search brings both rows as near to print as they will come. It proves nothing
(there may be a better minimum), but it shows what is within reach, beside the bound of
`checks.gross_residuals`, which is a proof.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.optimize import least_squares, minimize

from .checks import ERRORS, SIGNS, cap_moments
from .clouds import GROSS_POINTS, SEED, SPHERE, SPHERE_CENTER, SPHERE_RADIUS, sphere_redraws
from .printed_tables import printed, row
from .rows import REDUNDANCY, good_points, radius_with_wrong_sign, sums

QUANTITIES = (*ERRORS, "sigma_0", "sigma_s_m")
FREED = np.arange(0.0, 25.0, 0.05)  # m, what is tried for a number that may be anything
FAR = 1e3  # instead of a quantity that is not real: as far from print as anything


@dataclass(frozen=True)
class Target:
    """Target of a search: rows of table 2 (methods), without Δr or with Δr from δ with the wrong
    sign if asked.
    """

    methods: tuple[str, ...]
    without_radius: bool = False
    wrong_sign: bool = False

    def quantities(self) -> list[tuple[str, str]]:
        left_out = ("abs_delta_r_m",) if self.without_radius else ()
        return [
            (method, quantity)
            for method in self.methods
            for quantity in QUANTITIES
            if quantity not in left_out
        ]


TARGETS = {
    "LS": Target(("ls",)),
    "LS, Δr from δ with the wrong sign": Target(("ls",), wrong_sign=True),
    "LS without Δr": Target(("ls",), without_radius=True),
    "LS and TLS": Target(("ls", "tls")),
    "LS and TLS without Δr": Target(("ls", "tls"), without_radius=True),
}


def rows_of(points: NDArray[np.float64], wrong_sign: bool = False) -> dict[tuple[str, str], float]:
    """(method, quantity) -> what the LS and TLS rows of table 2 would print for these points (n,
    3), m.

    >>> rows_of(sphere_redraws(1)[0])["ls", "sigma_s_m"].round(5)
    np.float64(0.0028)
    """
    A = np.column_stack([2 * points, np.ones(len(points)), np.sum(points**2, axis=1)])
    moments = A.T @ A
    solutions = {"ls": np.linalg.solve(moments[:4, :4], moments[:4, 4])}
    v = np.linalg.eigh(moments)[1][:, 0]
    solutions["tls"] = -v[:4] / v[4]
    found = {}
    for method, x in solutions.items():
        square = x[3] + x[:3] @ x[:3]
        if square <= 0:
            found |= {(method, quantity): FAR for quantity in QUANTITIES}
            continue
        sphere = np.append(x[:3], np.sqrt(square))
        distances = np.linalg.norm(points - sphere[:3], axis=1) - sphere[3]
        residuals = A[:, 4] - A[:, :4] @ x
        if wrong_sign:
            radius = float(radius_with_wrong_sign(sphere))
            sphere[3] = radius if np.isfinite(radius) else SPHERE_RADIUS + FAR
        values = [
            *np.abs(sphere - SPHERE),
            np.sqrt(residuals @ residuals / REDUNDANCY),
            np.sqrt(np.mean(distances**2)),
        ]
        found |= {
            (method, quantity): value for quantity, value in zip(QUANTITIES, values, strict=True)
        }
    return found


def nearest(target: Target, starts: int, seed: int = SEED) -> dict[tuple[str, str], float]:
    """The rows that come nearest to print, over as many starts: each a cloud of its own with five
    points up to 3.5 m inside or outside.

    Nearest by the sum of squares of the relative differences. The best start is followed to the
    very minimum, which Gauss-Newton steps approach too slowly where differences remain.
    """
    aims = target.quantities()
    wanted = np.array([row(printed(), 2, method)[quantity] for method, quantity in aims])
    best, best_good = None, None
    for good, child in zip(
        good_points(sphere_redraws(starts, seed)),
        np.random.SeedSequence([seed, 2]).spawn(starts),
        strict=True,
    ):
        generator = np.random.default_rng(child)
        on_cap = good[generator.integers(len(good), size=len(GROSS_POINTS))]
        outward = (on_cap - SPHERE_CENTER) / SPHERE_RADIUS
        begin = on_cap + generator.uniform(-3.5, 1.0, size=(len(GROSS_POINTS), 1)) * outward
        ended = least_squares(
            _differences, begin.ravel(), args=(good, target, aims, wanted), max_nfev=60
        )
        if best is None or ended.cost < best.cost:
            best, best_good = ended, good
    end = minimize(
        _cost,
        best.x,
        args=(best_good, target, aims, wanted),
        method="BFGS",
        jac="3-point",
        options={"gtol": 1e-7},
    )
    return rows_of(np.concatenate([best_good, end.x.reshape(-1, 3)]), target.wrong_sign)


def _cost(flat: NDArray[np.float64], *arguments) -> float:
    """Half the sum of squares of `_differences`."""
    return 0.5 * float(np.sum(_differences(flat, *arguments) ** 2))


def _differences(
    flat: NDArray[np.float64], good: NDArray[np.float64], target: Target, aims, wanted
) -> NDArray[np.float64]:
    """Relative differences of the rows that gross errors at ``flat`` (15,), m, lead to."""
    rows = rows_of(np.concatenate([good, flat.reshape(-1, 3)]), target.wrong_sign)
    return np.array([rows[aim] for aim in aims]) / wanted - 1


def best_rows(
    starts: int, targets: Sequence[str] = tuple(TARGETS), seed: int = SEED
) -> pd.DataFrame:
    """How near one comes: for each target and each of its numbers ``printed``, ``reached`` and
    their ratio, and ``worst``, the largest relative difference of the target in percent. To three
    digits, above what the search leaves to chance.
    """
    rows = []
    for name in targets:
        target = TARGETS[name]
        found = nearest(target, starts, seed)
        wanted = {aim: row(printed(), 2, aim[0])[aim[1]] for aim in target.quantities()}
        worst = max(abs(found[aim] / value - 1) for aim, value in wanted.items())
        for (method, quantity), value in wanted.items():
            one = {"target": name, "method": method, "quantity": quantity, "printed": value}
            one |= {
                "reached": float(f"{found[method, quantity]:.3g}"),
                "reached over printed": round(found[method, quantity] / value, 2),
            }
            rows.append(one | {"worst percent": round(100 * worst, 1)})
    return pd.DataFrame(rows)


def repairs() -> pd.DataFrame:
    """Which number alone could be the wrong one in the TLS row of table 2, whose sphere leaves a
    larger σ0 than printed?

    One row each for Δa, Δb, Δc, Δr: ``least σ0``, the least that any value of it leaves at the good
    points (all draws, all signs, the other three errors as printed), the value ``at`` which it does
    so, and ``mends``, whether that is below the printed σ0.
    """
    one = row(printed(), 2, "tls")
    errors = np.array([one[name] for name in ERRORS])
    rows = []
    for place, name in enumerate(ERRORS):
        tried = np.repeat(errors[None], len(FREED), axis=0)
        tried[:, place] = FREED
        spheres = SPHERE + (SIGNS * tried[:, None]).reshape(-1, len(errors))
        least = sums(cap_moments(True), spheres)[1].min(axis=1).reshape(len(FREED), -1).min(axis=1)
        best = int(least.argmin())
        sigma_0 = float(np.sqrt(max(least[best], 0.0) / REDUNDANCY))
        mends = "yes" if sigma_0 <= one["sigma_0"] else "no"
        rows.append(
            {
                "free": name,
                "printed": one[name],
                "at": FREED[best],
                "least σ0": sigma_0,
                "mends": mends,
            }
        )
    return pd.DataFrame(rows)
