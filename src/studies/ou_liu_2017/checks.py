"""Relations that hold between the numbers of right tables, each a small function with its bound and
its proof.

None needs the authors' points. Three need points *like* theirs, because a printed sphere leaves
residuals at points of the cap, wherever exactly these are: they take the least over many draws of
the cloud of section 2.1 (`cap_moments`) and are violated only if no draw and no choice of the
unprinted signs fulfils them.

Every check takes all numbers of Ou & Liu (2017), printed or simulated, and returns a `Relation` for
each place it judges. In the proofs d = |p − k| − r, r_alg = |p − k|² − r² = d (|p − k| + r), σs² =
Σd²/n, and, for LS and TLS, σ0² = Σr_alg²/(n − 4).

Source: Ou & Liu (2017), sections 2.1 and 2.2, doi:10.7510/jgjs.issn.1001-3806.2017.05.026.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from itertools import product

import numpy as np
from numpy.typing import NDArray

from ..printed.relation import Numbers, Relation
from . import table3_relations
from .clouds import (
    GROSS_POINTS,
    SEED,
    SPHERE,
    SPHERE_CENTER,
    SPHERE_DECIMALS,
    SPHERE_POINTS,
    SPHERE_RADIUS,
    sphere_redraws,
)
from .printed_tables import LABELS, METHODS, TITLES, Row, printed, row
from .rows import REDUNDANCY, good_points, moments, sums
from .table3_relations import RADIUS, SAMPLES

DRAWS = 300  # of the cloud, over which the least is taken
NOISE = math.sqrt(3) / 2 * 10.0**-SPHERE_DECIMALS  # m, the farthest that rounding can move a point
SIGNS = np.array(list(product((-1.0, 1.0), repeat=4)))
ERRORS = tuple(f"abs_delta_{name}_m" for name in "abcr")
# The largest over the least 1/(|p|² + |k|²): the cap begins at the height of the centre and is
# farthest from the origin along it.
MU_SPREAD = (
    (math.hypot(*SPHERE_CENTER) + SPHERE_RADIUS) ** 2 + np.dot(SPHERE_CENTER, SPHERE_CENTER)
) / (SPHERE_CENTER[2] ** 2 + np.dot(SPHERE_CENTER, SPHERE_CENTER))
ALGEBRAIC = ("ls", "tls")  # methods whose σ0 is the root mean square of the algebraic residual


def sigma_0_against_sigma_s(paper: Numbers) -> list[Relation]:
    """Tables 1 and 2: ``max(r, 2r − √n σs) ≤ σ0 √((n − 4)/n) / σs ≤ 2r + √n σs``.

    Proof: |r_alg| = |d| (2r + d), and |d| ≤ √n σs, as no term exceeds the sum; further 2r + d ≥ r,
    as |p − k| ≥ 0. Of the two radii √200 ± |Δr| the one that suits better counts. Without gross
    errors √n σs is 6 cm beside 28 m, and σ0 follows from σs within 0.2 %.
    """
    found = []
    for table, method in product(TITLES, ALGEBRAIC):
        one = row(paper, table, method)
        value = one["sigma_0"] * math.sqrt(REDUNDANCY / SPHERE_POINTS)
        judged = one.judged("sigma_0", "sigma_s_m", "abs_delta_r_m")
        small, large = (abs(SPHERE_RADIUS + sign * one.most("abs_delta_r_m")) for sign in (-1, 1))
        low, high = one.least("sigma_s_m"), one.most("sigma_s_m")
        spread = math.sqrt(SPHERE_POINTS) * high
        least = max(small, 2 * small - spread) * low
        most = (2 * large + spread) * high
        digits, words = one.half("sigma_0"), f"table {table}: σ0 against 2rσs"
        found.append(Relation(words, "", LABELS[method], value, "≥", least, "m²", judged, digits))
        found.append(Relation(words, "", LABELS[method], value, "≤", most, "m²", judged, digits))
    return found


def sigma_0_of_scans(paper: Numbers) -> list[Relation]:
    """Table 3: ``r σs ≤ σ0`` and ``σ0 ≤ (2r + R) σs √(n/(n − 4))``, with R the nominal radius and n
    ≥ 20.

    Proof: as `sigma_0_against_sigma_s`; the lower bound is that of
    `table3_relations.sigma_0_from_sigma_s`. The upper one holds for a scan of which gross errors
    have been removed, in which no point is farther from the sphere than its radius.
    """
    found = []
    for sample, method in product(SAMPLES, ALGEBRAIC):
        found.append(table3_relations.sigma_0_from_sigma_s(sample, method, paper))
        one = row(paper, 3, method, sample)
        most = (2 * one.most("r_m") + RADIUS) * one.most("sigma_s_m") * math.sqrt(20 / 16)
        judged = one.judged("sigma_0", "r_m", "sigma_s_m")
        words = "table 3: σ0 below (2r + R)σs"
        found.append(
            Relation(
                words,
                sample,
                LABELS[method],
                one["sigma_0"],
                "≤",
                most,
                "m²",
                judged,
                one.half("sigma_0"),
            )
        )
    return found


def unit_weight_of_scans(paper: Numbers) -> list[Relation]:
    """Table 3: σ0 of IGG III-WTLS over what σs leads to is alike for both spheres, within a factor
    of 3.

    Reason (no proof): the ratio (`table3_relations.sigma_0_over_expected`) is √P_X times a mean of
    the final weights, both a matter of the program and hardly of the sphere; the trials show how
    alike it is.
    """
    first, second = (
        table3_relations.sigma_0_over_expected(sample, "igg3_wtls", paper) for sample in SAMPLES
    )
    judged = sum(
        (row(paper, 3, "igg3_wtls", sample).judged("sigma_0", "sigma_s_m") for sample in SAMPLES),
        (),
    )
    value = max(first, second) / min(first, second)
    return [
        Relation(
            "table 3: unit weight of sphere I and II",
            "I, II",
            LABELS["igg3_wtls"],
            value,
            "≤",
            3.0,
            "",
            judged,
        )
    ]


def least_squares_is_least(paper: Numbers) -> list[Relation]:
    """Every table: σ0 of TLS is not below σ0 of LS.

    Proof: both are √(Σr_alg²/(n − 4)) over the same points, and LS minimises that sum over all
    spheres.
    """
    found = []
    for table, sample in [(1, ""), (2, ""), *((3, sample) for sample in SAMPLES)]:
        ls, tls = (row(paper, table, method, sample) for method in ALGEBRAIC)
        digits = ls.half("sigma_0") + tls.half("sigma_0")
        judged = ls.judged("sigma_0") + tls.judged("sigma_0")
        words = f"table {table}: least squares is least"
        found.append(
            Relation(
                words, sample, "LS, TLS", tls["sigma_0"], "≥", ls["sigma_0"], "m²", judged, digits
            )
        )
    return found


def sigma_s_over_all_points(paper: Numbers) -> list[Relation]:
    """σs of another method over the same points is not far below that of LS.

    Tables 1 and 2, LS unprimed, the other primed: ``max(r, 2r − √n σs) σs ≤ (2r' + √n σs') σs'``.
    Proof: the left side times √n is at most √Σr_alg² by `sigma_0_against_sigma_s`, this at most
    √Σr_alg'² as LS is least, and this at most the right side times √n. Table 3:
    `table3_relations.farthest_point_needed`.
    """
    found = []
    for table, method in product(TITLES, ("tls", "igg3_wtls")):
        ls, other = row(paper, table, "ls"), row(paper, table, method)
        small = SPHERE_RADIUS - ls.most("abs_delta_r_m")
        low, high = ls.least("sigma_s_m"), other.most("sigma_s_m")
        needed = max(small, 2 * small - math.sqrt(SPHERE_POINTS) * ls.most("sigma_s_m")) * low
        reached = (
            2 * (SPHERE_RADIUS + other.most("abs_delta_r_m")) + math.sqrt(SPHERE_POINTS) * high
        ) * high
        judged = ls.judged("sigma_s_m") + other.judged("sigma_s_m")
        words = f"table {table}: σs over all points"
        found.append(
            Relation(words, "", f"LS, {LABELS[method]}", reached, "≥", needed, "m²", judged)
        )
    return found + [table3_relations.farthest_point_needed(sample, paper) for sample in SAMPLES]


@cache
def cap_moments(gross: bool, draws: int = DRAWS, seed: int = SEED) -> NDArray[np.float64]:
    """(B, 5, 5) `rows.moments` of draws of the cloud; with ``gross`` of the good points of table 2
    alone.

    >>> cap_moments(gross=True)[0, 4, 4]
    np.float64(495.0)
    """
    clouds = sphere_redraws(draws, seed)
    return moments(good_points(clouds) if gross else clouds)


def spheres_of(one: Row) -> NDArray[np.float64]:
    """(16, 4) spheres that a row of errors allows, one for each choice of the signs."""
    return SPHERE + SIGNS * [one[name] for name in ERRORS]


def digits_of_residual(one: Row) -> float:
    """The most by which the missing digits of a row of errors change a residual of the cap, m²:
    ``2 (|p − k| √3 + r) · half a unit``.
    """
    far = SPHERE_RADIUS + NOISE + math.dist((0, 0, 0), [one[name] for name in ERRORS[:3]])
    return (
        2 * (far * math.sqrt(3) + SPHERE_RADIUS + one["abs_delta_r_m"]) * one.half("abs_delta_r_m")
    )


def radius_follows_centre(paper: Numbers) -> list[Relation]:
    """Table 1, LS and TLS: some draw and some signs make the mean of r_alg zero.

    Proof: the normal equation of the column of ones is Σr_alg = 0 for LS; for TLS it is −δ
    Σr_alg²/(1 + |X|²), at most 1e-4 m² here. A cap ties Δr to Δc by it: too large a centre error
    without its radius error is impossible.
    """
    found = []
    for method in ALGEBRAIC:
        one = row(paper, 1, method)
        total, _ = sums(cap_moments(False), spheres_of(one))
        value = float(np.abs(total).min()) / SPHERE_POINTS
        limit = digits_of_residual(one)
        found.append(
            Relation(
                "table 1: Δr follows Δk",
                "",
                LABELS[method],
                value,
                "≤",
                limit,
                "m²",
                one.judged(*ERRORS),
            )
        )
    return found


def gross_residuals(paper: Numbers) -> list[Relation]:
    """Table 2, LS: ``(Σ_good r_alg)²/5 ≤ 496 σ0² − Σ_good r_alg²`` for some draw and some signs;
    the value is left over right.

    Proof: Σr_alg = 0, so the five gross residuals sum up to −Σ_good r_alg, and five numbers of that
    sum have at least a fifth of its square as their sum of squares (Cauchy-Schwarz), of which σ0
    leaves the right side. Whatever the gross errors are.
    """
    one = row(paper, 2, "ls")
    total, squares = sums(cap_moments(True), spheres_of(one))
    good, slack = SPHERE_POINTS - len(GROSS_POINTS), digits_of_residual(one)
    needed = np.maximum(np.abs(total) - good * slack, 0) ** 2 / len(GROSS_POINTS)
    left = (
        REDUNDANCY * one.most("sigma_0") ** 2
        - np.maximum(np.sqrt(squares) - math.sqrt(good) * slack, 0) ** 2
    )
    ratio = np.where(left > 0, needed / np.where(left > 0, left, 1), np.inf)
    judged = one.judged(*ERRORS, "sigma_0")
    return [
        Relation(
            "table 2: gross residuals balance the good ones",
            "",
            "LS",
            float(ratio.min()),
            "≤",
            1.0,
            "",
            judged,
        )
    ]


def least_rms(paper: Numbers) -> list[Relation]:
    """Tables 1 and 2: σ0 of LS and TLS is at least what the printed sphere leaves at the good
    points, ``√(Σ_good r_alg²/496)``.

    Proof: the gross errors add squares. Of all draws and signs the least counts.
    """
    found = []
    for table, method in product(TITLES, ALGEBRAIC):
        one = row(paper, table, method)
        products = cap_moments(table == 2)
        _, squares = sums(products, spheres_of(one))
        least = math.sqrt(max(squares.min(), 0) / REDUNDANCY)
        digits = digits_of_residual(one) * math.sqrt(products[0, 4, 4] / REDUNDANCY) + one.half(
            "sigma_0"
        )
        judged = one.judged(*ERRORS, "sigma_0")
        words = f"table {table}: least σ0 of the printed sphere"
        found.append(
            Relation(words, "", LABELS[method], one["sigma_0"], "≥", least, "m²", judged, digits)
        )
    return found


def least_sigma_s(paper: Numbers) -> list[Relation]:
    """Tables 1 and 2, LS and IGG III-WTLS: σs is at least ``√(Σ_good r_alg²/500) / (2r + D)``, D =
    |Δk| + |Δr| + √3/2 · 0.01 m.

    Proof: |d| = |r_alg|/(2r + d), and no good point lies farther out than D. (Not for TLS of table
    2, whose errors of metres make D too large for the bound to say anything.)
    """
    found = []
    for table, method in [(1, "ls"), (1, "tls"), (1, "igg3_wtls"), (2, "ls"), (2, "igg3_wtls")]:
        one = row(paper, table, method)
        errors = np.array([one[name] for name in ERRORS])
        _, squares = sums(cap_moments(table == 2), spheres_of(one))
        widest = 2 * (SPHERE_RADIUS + errors[3]) + np.linalg.norm(errors[:3]) + errors[3] + NOISE
        least = math.sqrt(max(squares.min(), 0) / SPHERE_POINTS) / widest
        digits = digits_of_residual(one) / widest + one.half("sigma_s_m")
        judged = one.judged(*ERRORS, "sigma_s_m")
        words = f"table {table}: least σs of the printed sphere"
        found.append(
            Relation(words, "", LABELS[method], one["sigma_s_m"], "≥", least, "m", judged, digits)
        )
    return found


def radius_between_points(paper: Numbers) -> list[Relation]:
    """Table 1, and IGG III-WTLS of table 2: ``|Δr| ≤ |Δk| + √3/2 · 0.01 m``, in table 2
    ``+ 5 k1 σs (μ_most/μ_least)/495``.

    Proof: the equation of the column of ones is Σ ω μ r_alg = 0 with weights ω ≥ 0, so the points
    in use cannot all lie on one side of the sphere (TLS as in `radius_follows_centre`). Good points
    are at most √3/2 · 0.01 m off the true sphere, and moving the centre by Δk changes a distance by
    at most |Δk|. In table 2 gross errors may pull as well, but by eq. (13) only those nearer than
    k1 σ, with weights of at most 1, while the 495 good points keep theirs, being far nearer than k0
    σ; μ = 1/(|p|² + |k|²) by eq. (16).
    """
    found = []
    for table, method in [*((1, method) for method in METHODS.values()), (2, "igg3_wtls")]:
        one = row(paper, table, method)
        limit = math.dist((0, 0, 0), [one[name] for name in ERRORS[:3]]) + NOISE
        judged = one.judged(*ERRORS)
        if table == 2:
            limit += (
                len(GROSS_POINTS)
                * paper["ou_liu_2017/k1"].value
                * one["sigma_s_m"]
                * MU_SPREAD
                / (SPHERE_POINTS - len(GROSS_POINTS))
            )
            judged += one.judged("sigma_s_m")
        digits = (1 + math.sqrt(3)) * one.half("abs_delta_r_m")
        words = f"table {table}: the sphere lies between its points"
        found.append(
            Relation(
                words, "", LABELS[method], one["abs_delta_r_m"], "≤", limit, "m", judged, digits
            )
        )
    return found


def centres_of_scans(paper: Numbers) -> list[Relation]:
    """Table 3: centres of LS and TLS within reach of the points; see
    `table3_relations.centres_within_reach`.
    """
    return [table3_relations.centres_within_reach(sample, paper) for sample in SAMPLES]


def radius_errors(paper: Numbers) -> list[Relation]:
    """Table 3: the column |Δr| is |r − R|; see `table3_relations.radius_error`."""
    return [
        table3_relations.radius_error(sample, method, paper)
        for sample, method in product(SAMPLES, LABELS)
    ]


def percentages(paper: Numbers) -> list[Relation]:
    """Percentages of section 2.2 against table 3; see `table3_relations.relative_radius_error`."""
    return [
        table3_relations.relative_radius_error(sample, method, paper)
        for sample, method in product(SAMPLES, LABELS)
    ]


def only_difference(paper: Numbers) -> list[Relation]:
    """Section 2.2: LS and TLS agree in table 3 to one unit of the last digit, the difference that
    the text names for b of sphere II.

    Reason: the text says so. (On a scan far from the origin the two minimise nearly the same; the
    trials show how nearly.)
    """
    found = []
    statement = paper["ou_liu_2017/b_difference_II"]
    for sample, name in product(SAMPLES, "abcr"):
        ls, tls = (row(paper, 3, method, sample) for method in ALGEBRAIC)
        quantity = f"{name}_m"
        judged = (*ls.judged(quantity), *tls.judged(quantity))
        differs = abs(ls[quantity] - tls[quantity])
        words = f"table 3: LS and TLS agree in {name} as the text says"
        found.append(
            Relation(
                words,
                sample,
                "LS, TLS",
                differs,
                "≤",
                statement.value,
                "m",
                judged,
                0.1 * ls.half(quantity),
            )
        )
    return found


@dataclass(frozen=True)
class Check:
    """A check and, in words, what it claims to find."""

    function: Callable[[Numbers], list[Relation]]
    finds: str
    proved: bool = True


CHECKS = {
    "σ0 against σs": Check(
        sigma_0_against_sigma_s, "a wrong leading digit of σ0 or σs of LS and TLS in tables 1 and 2"
    ),
    "σ0 of scans": Check(sigma_0_of_scans, "a wrong exponent of σ0 of LS and TLS in table 3"),
    "unit weight of scans": Check(
        unit_weight_of_scans, "a wrong exponent of σ0 of IGG III-WTLS in table 3", proved=False
    ),
    "least squares is least": Check(
        least_squares_is_least, "rows of LS and TLS exchanged where they differ, in table 2"
    ),
    "σs over all points": Check(
        sigma_s_over_all_points, "σs of the points in use printed for that of all, in table 2"
    ),
    "Δr follows Δk": Check(
        radius_follows_centre, "an error of c or r in table 1 ten times too large"
    ),
    "gross residuals": Check(gross_residuals, "a wrong leading digit of Δc or Δr of LS in table 2"),
    "least σ0": Check(least_rms, "errors in tables 1 and 2 too large for their σ0"),
    "least σs": Check(least_sigma_s, "errors in tables 1 and 2 too large for their σs"),
    "sphere between points": Check(
        radius_between_points, "Δr of IGG III-WTLS from δ with the wrong sign in table 2"
    ),
    "centres of scans": Check(
        centres_of_scans, "a wrong digit before or right after the point in a centre of table 3"
    ),
    "radius errors": Check(radius_errors, "a wrong digit of r or |Δr| in table 3"),
    "percentages": Check(percentages, "a wrong digit of a percentage"),
    "only difference": Check(
        only_difference, "a wrong digit in a centre or radius of LS or TLS in table 3", proved=False
    ),
}
"""Name -> check. Each holds for tables in which nothing is wrong but for at most 1 %; see `trials`.
"""


def judge(paper: Numbers) -> dict[str, list[Relation]]:
    """Check name -> its relations on a paper.

    >>> found = judge(printed())
    >>> [name for name in found if not all(relation.holds for relation in found[name])][:2]
    ['σ0 of scans', 'unit weight of scans']
    """
    return {name: check.function(paper) for name, check in CHECKS.items()}


@cache
def violated() -> list[tuple[str, Relation]]:
    """The relations that fail on print, each with the name of its check."""
    return [
        (name, relation)
        for name, relations in judge(printed()).items()
        for relation in relations
        if not relation.holds
    ]
