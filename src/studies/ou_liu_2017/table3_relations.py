"""Relations between the numbers of table 3 of Ou & Liu (2017), whatever the scans were.

Each function here is one relation that the printed numbers must fulfil, with its proof. Where one
fails, a number is misprinted or means something else than the paper says; no redraw is needed for
that. The relations are applied to the printed table unless another `paper` is given, and what its
missing digits leave open is granted.

In the proofs d = |p − k| − r is the distance of a point p from the sphere of centre k and radius r,
r_alg = |p − k|² − r² its algebraic residual, σs = √(Σd²/n), and R the nominal radius of the
targets.

Source: Ou & Liu (2017), section 2.2, eqs. (13)-(18), doi:10.7510/jgjs.issn.1001-3806.2017.05.026.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from ..printed.relation import Numbers, Relation
from .printed_tables import LABELS, Row, printed, row, values

RADIUS = 0.0725  # m, R
SAMPLES = ("I", "II")
# how data/published names them in its relative errors
STATEMENT = {"ls": "LS", "tls": "TLS", "igg3_wtls": "IGG"}


def _row(sample: str, method: str, paper: Numbers | None) -> Row:
    return row(printed() if paper is None else paper, 3, method, sample)


def centres_within_reach(sample: str, paper: Numbers | None = None) -> Relation:
    """Two spheres near the same points cannot have their centres far apart:
    ``|k₁ − k₂| ≤ r₁ + r₂ + σs₁ + σs₂``.

    Proof: for every point |k₁ − k₂| ≤ |p − k₁| + |p − k₂| = d₁ + r₁ + d₂ + r₂. In the mean over the
    points the d are at most their root mean squares. Applied to the LS and TLS rows of a sphere.

    >>> centres_within_reach("I").holds, centres_within_reach("II").holds
    (False, True)
    """
    ls, tls = _row(sample, "ls", paper), _row(sample, "tls", paper)
    centre = [f"{name}_m" for name in "abc"]
    apart = float(np.linalg.norm([ls[name] - tls[name] for name in centre]))
    reach = ls["r_m"] + tls["r_m"] + ls["sigma_s_m"] + tls["sigma_s_m"]
    digits = sum(one.half(name) for one in (ls, tls) for name in [*centre, "r_m", "sigma_s_m"])
    judged = ls.judged(*centre) + tls.judged(*centre)
    words = "centres of LS and TLS: distance within reach of the points"
    return Relation(words, sample, "LS, TLS", apart, "≤", reach, "m", judged, digits)


def sigma_0_from_sigma_s(sample: str, method: str, paper: Numbers | None = None) -> Relation:
    """The algebraic σ0 of LS and TLS is larger than rσs: ``σ0 = √(Σr_alg²/(n − 4)) > r σs``.

    Proof: r_alg = d (|p − k| + r), so |r_alg| ≥ r |d| whatever the point, and n − 4 < n. (For
    points near the sphere |p − k| ≈ r, and σ0 is close to 2rσs.)

    >>> [sigma_0_from_sigma_s(sample, "ls").holds for sample in SAMPLES]
    [False, True]
    """
    one = _row(sample, method, paper)
    least = one["r_m"] * one["sigma_s_m"]
    digits = least - one.least("r_m") * one.least("sigma_s_m") + one.half("sigma_0")
    judged = one.judged("sigma_0", "r_m", "sigma_s_m")
    words = "σ0 of the algebraic residual above rσs"
    return Relation(words, sample, LABELS[method], one["sigma_0"], "≥", least, "m²", judged, digits)


def sigma_0_over_expected(sample: str, method: str, paper: Numbers | None = None) -> float:
    """Printed σ0 over what σs of the same row leads one to expect; near 1 unless weights are at
    work.

    LS, TLS: 2rσs, see :func:`sigma_0_from_sigma_s`. IGG III-WTLS at P_X = 1: by eqs. (16) and (18)
    σ0² = Σ ω r_alg²/(w + κ)/(n − 4) with w = |p|² and κ = |k|². All points of a target are at
    nearly the same distance |k| from the scanner, so σ0 ≈ 2rσs/(√2 |k|) where the weights ω are 1,
    and less where they are not. Another P_X multiplies this by √P_X, for both spheres alike.

    >>> [round(sigma_0_over_expected(sample, "ls"), 3) for sample in SAMPLES]
    [0.103, 1.037]
    """
    one = _row(sample, method, paper)
    expected = 2 * one["r_m"] * one["sigma_s_m"]
    if method == "igg3_wtls":
        expected /= np.sqrt(2) * np.linalg.norm([one[f"{name}_m"] for name in "abc"])
    return float(one["sigma_0"] / expected)


def farthest_point_needed(sample: str, paper: Numbers | None = None) -> Relation:
    """σs of IGG III-WTLS far below that of LS over the same points needs a point far away:
    ``D ≥ r σs/σs' − 2r'``.

    Proof: LS minimises Σr_alg² over all spheres. With LS unprimed, IGG III-WTLS primed, ρ = |p − k|
    and D the distance of the farthest point outside the primed sphere,

        r² n σs² ≤ Σ d² (ρ + r)² = Σ r_alg² ≤ Σ r_alg'² = Σ d'² (ρ' + r')² ≤ (2r' + D)² n σs'².

    So D is at least as large as stated, and as Σ d'² ≥ D², there are at least (D/σs')² points. A
    scan of which gross errors were removed has no point that is farther from the sphere than its
    radius: where D > R, σs' does not count all points.

    >>> [farthest_point_needed(sample).holds for sample in SAMPLES]
    [False, False]
    """
    ls, igg = _row(sample, "ls", paper), _row(sample, "igg3_wtls", paper)
    D = ls["r_m"] * ls["sigma_s_m"] / igg["sigma_s_m"] - 2 * igg["r_m"]
    digits = D - (
        ls.least("r_m") * ls.least("sigma_s_m") / igg.most("sigma_s_m") - 2 * igg.most("r_m")
    )
    judged = ls.judged("r_m", "sigma_s_m") + igg.judged("r_m", "sigma_s_m")
    words = "σs over all points: farthest point needed, within R"
    return Relation(words, sample, "LS, IGG III-WTLS", D, "≤", RADIUS, "m", judged, digits)


def points_needed(sample: str) -> int:
    """The least number of points with which the printed σs of IGG III-WTLS could count all; see
    :func:`farthest_point_needed`.

    >>> points_needed("I") > 50_000, points_needed("II") > 300_000
    (True, True)
    """
    return int(
        np.ceil(
            (farthest_point_needed(sample).value / values(3, "igg3_wtls", sample)["sigma_s_m"]) ** 2
        )
    )


def radius_error(sample: str, method: str, paper: Numbers | None = None) -> Relation:
    """The column |Δr| is ``|r − R|``. Proof: its definition; both may have been rounded by
    themselves.

    >>> all(radius_error(sample, method).holds for sample in SAMPLES for method in LABELS)
    True
    """
    one = _row(sample, method, paper)
    expected = round(abs(one["r_m"] - RADIUS), 4)
    digits = one.half("r_m") + one.half("abs_delta_r_m")
    judged = one.judged("r_m", "abs_delta_r_m")
    return Relation(
        "|Δr| = |r − R|",
        sample,
        LABELS[method],
        one["abs_delta_r_m"],
        "=",
        expected,
        "m",
        judged,
        digits,
    )


def relative_radius_error(sample: str, method: str, paper: Numbers | None = None) -> Relation:
    """The percentages of the text are ``100 |Δr|/R``. Proof: their definition, with |Δr| rounded as
    in the table or not.

    >>> all(relative_radius_error(sample, method).holds for sample in SAMPLES for method in LABELS)
    True
    """
    statement = (printed() if paper is None else paper)[
        f"ou_liu_2017/rel_radius_{sample}_{STATEMENT[method]}"
    ]
    one = _row(sample, method, paper)
    expected = round(100 * one["abs_delta_r_m"] / RADIUS, 2)
    digits = 100 * one.half("abs_delta_r_m") / RADIUS + 2 * statement.half_unit
    judged = (statement.id, *one.judged("abs_delta_r_m"))
    words = "relative error of the radius in the text"
    return Relation(
        words, sample, LABELS[method], statement.value, "=", expected, "%", judged, digits
    )


def every_relation() -> list[Relation]:
    """All relations on all the rows they speak of."""
    found = [centres_within_reach(sample) for sample in SAMPLES]
    found += [
        sigma_0_from_sigma_s(sample, method) for sample in SAMPLES for method in ("ls", "tls")
    ]
    found += [farthest_point_needed(sample) for sample in SAMPLES]
    for of_a_row in (radius_error, relative_radius_error):
        found += [of_a_row(sample, method) for sample in SAMPLES for method in LABELS]
    return found


def table() -> pd.DataFrame:
    """Every relation as a row: relation, sphere, methods, printed (or what follows from print),
    sense, limit, unit, holds.
    """
    return pd.DataFrame(
        [
            {
                "relation": found.relation,
                "sphere": found.sphere,
                "methods": found.methods,
                "printed": found.value,
                "sense": found.sense,
                "limit": found.limit,
                "unit": found.unit,
                "holds": "yes" if found.holds else "no",
            }
            for found in every_relation()
        ]
    )
