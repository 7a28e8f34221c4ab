"""Where the sphere paper can be read in two ways, and what the difference makes.

Each :class:`Reading` is one place of Ou & Liu (2017): the literal reading, another reading, and how
to compute both. :func:`study` runs both on every cloud and judges the change by one rule:

    a change matters if it exceeds a tenth of the standard deviation of what changed,

which is that of the LS parameters on the cloud without gross errors for centre and radius, and
``σ0/√(2(n − t))`` for σ0. One place is changed at a time; everything else stays literal.

Source: Ou & Liu (2017), doi:10.7510/jgjs.issn.1001-3806.2017.05.026.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.adjustment.igg3 import SCALES
from analysis.adjustment.wtls import wtls
from analysis.methods import fit_sphere
from analysis.result import ignore_convergence_warnings
from analysis.surfaces.sphere import PARAMETERS

from .clouds import sphere_redraws

SHARE = 0.1  # of a standard deviation: a smaller change does not matter
FADED = 1e-3  # a weight below this takes a point out of the fit, though it is not rejected

SPHERE, SIGMA_0, NOTHING, BREAKDOWN = "sphere", "σ0 only", "no", "breaks down"


@dataclass(frozen=True)
class Answer:
    """Result of one reading for one cloud: lengths in m, numbers of points with weight 0 and
    with weight below ``FADED``.
    """

    center: NDArray[np.float64]
    radius: float
    sigma_0: float
    rejected: int
    faded: int
    iterations: int
    converged: bool


@dataclass(frozen=True)
class Reading:
    """One place of the paper and the functions points -> Answer for its two readings."""

    name: str
    equation: str
    literal: str
    other: str
    run_literal: Callable[[NDArray[np.float64]], Answer]
    run_other: Callable[[NDArray[np.float64]], Answer]


def _igg3(points, **options) -> Answer:
    """IGG III-WTLS as printed but for the options."""
    with ignore_convergence_warnings():  # the Answer says it
        fit = fit_sphere(points, "igg3_wtls", **options)
    return Answer(
        fit.center,
        float(fit.radius),
        float(fit.sigma_0),
        rejected=int(np.count_nonzero(fit.weights == 0)),
        faded=int(np.count_nonzero(fit.weights < FADED)),
        iterations=int(fit.iterations),
        converged=bool(fit.converged),
    )


def _igg3_from_centroid(points) -> Answer:
    """Points in coordinates from their centroid, the centre moved back."""
    origin = points.mean(axis=0)
    answer = _igg3(points - origin)
    return replace(answer, center=answer.center + origin)


def _igg3_points_in_use(points) -> Answer:
    """A fit with its σ0 over the redundancy of the points in use."""
    answer = _igg3(points)
    n = len(points)
    return replace(
        answer,
        sigma_0=answer.sigma_0 * np.sqrt((n - PARAMETERS) / (n - answer.rejected - PARAMETERS)),
    )


def _wtls(points, Q_0=(1.0, 1.0, 1.0, 0.0), Q_w_over_w_Q_u: float = 1.0) -> Answer:
    """WTLS without reweighting, by eqs. (16)-(17), with any column cofactors and any ratio of Q_Y
    to w Q_X.
    """
    A, w, Q_X = design(points)
    estimate = wtls(
        A, w, Q_y=Q_w_over_w_Q_u * w, Q_0=np.diag(Q_0), Q_X=Q_X, algorithm="schaffrin_wieser"
    )
    center = estimate.x[:3]
    radius = float(np.sqrt(estimate.x[3] + center @ center))
    return Answer(
        center,
        radius,
        float(estimate.sigma_0),
        0,
        0,
        int(estimate.iterations),
        bool(estimate.converged),
    )


def design(points: NDArray[np.float64]) -> tuple[NDArray, NDArray, NDArray]:
    """The rows ``A = (2x, 2y, 2z, 1)``, ``Y = w = x² + y² + z²`` and ``Q_X = 1`` of eqs. (2) and
    (12).

    >>> A, w, Q_X = design(np.array([[1.0, 2.0, 2.0]]))
    >>> A, w, Q_X
    (array([[2., 4., 4., 1.]]), array([9.]), array([1.]))
    """
    return (
        np.column_stack([2 * points, np.ones(len(points))]),
        np.sum(points**2, axis=1),
        np.ones(len(points)),
    )


SIGMA_NAMES = {
    "rms_in": "rms of the points in use",
    "rms_w": "weighted rms",
    "rms_wc": "weighted rms, consistent",
    "mad": "median absolute distance",
    "unit": "unit-weight σ0",
}

READINGS = (
    Reading(
        "column of ones",
        "2, 3",
        "its error is 1, not 0: Q_0 = diag(1,1,1,1)",
        "it is exact: Q_0 = diag(1,1,1,0), eq. (12)",
        partial(_wtls, Q_0=(1.0, 1.0, 1.0, 1.0)),
        _wtls,
    ),
    Reading(
        "v or 2v in E_A",
        "2",
        "v in eq. (2), which the weights do not use: Q_w = w Q_u",
        "v carried on to the weights: Q_w = 4 w Q_u",
        _wtls,
        partial(_wtls, Q_w_over_w_Q_u=4.0),
    ),
    Reading(
        "P_X",
        "10, 12",
        "1 (no value is given)",
        "1/4, that is Q_u = 4σ² at σ = 1",
        _igg3,
        partial(_igg3, unit_weight=0.25),
    ),
    Reading(
        "origin of w",
        "11, 12",
        "the printed origin of coordinates",
        "the centroid",
        _igg3,
        _igg3_from_centroid,
    ),
    Reading("exponent", "13", "1", "2, the usual IGG III", _igg3, partial(_igg3, power=2)),
    *(
        Reading(
            f"σ: {SIGMA_NAMES[scale]}",
            "13",
            "rms of all points",
            SIGMA_NAMES[scale],
            _igg3,
            partial(_igg3, scale=scale),
        )
        for scale in SCALES
        if scale != "rms"
    ),
    Reading(
        "start",
        "15, line 2",
        "weighted by Q_Y",
        "weighted by P_Y, its inverse",
        _igg3,
        partial(_igg3, start="P_Y"),
    ),
    Reading(
        "cumulation",
        "step 6",
        "cumulative, P ← P ω",
        "not cumulative, P = P_base ω (section 1.3)",
        _igg3,
        partial(_igg3, cumulative=False),
    ),
    Reading(
        "stop", "step 7", "|ΔX| < 1e-6", "|ΔX| < 1e-10", _igg3, partial(_igg3, tolerance=1e-10)
    ),
    Reading("n in n − t", "18", "all points", "the points in use", _igg3, _igg3_points_in_use),
)


def study(
    clouds: Mapping[str, NDArray[np.float64]], readings: tuple[Reading, ...] = READINGS
) -> pd.DataFrame:
    """Run both readings of every place on every cloud.

    Parameters
    ----------
    clouds : name -> (n, 3) points in m; ``"clean"`` must be among them, its LS fit gives the
        standard deviations.
    readings : the places.

    Returns
    -------
    One row a reading and cloud. ``center_mm`` is how far the centre moves from the literal to the
    other reading, ``radius_mm`` how much the radius grows, ``sigma_0_ratio`` the other σ0 over the
    literal one; ``…_literal`` and ``…_other`` are the numbers of rejected points (weight 0), of
    faded ones (weight below ``FADED``, the rejected included) and of iterations, these to two
    digits; ``matters`` is one of "sphere", "σ0 only", "no", "breaks down". An answer that did not
    converge to a sphere has no numbers. A reading breaks down if it does not converge or rejects
    more than half of the points.

    Raises ``KeyError`` without the cloud ``"clean"``.

    >>> from studies.ou_liu_2017.clouds import read_sphere_cloud
    >>> found = study({"clean": read_sphere_cloud(gross=False)}, READINGS[2:3])
    >>> found[["reading", "sigma_0_ratio", "matters"]]
      reading  sigma_0_ratio  matters
    0     P_X            0.5  σ0 only
    """
    sd_center, sd_radius = reference(clouds["clean"])
    answer = cache(lambda run, cloud: run(clouds[cloud]))  # most places share their literal reading
    rows = []
    for reading in readings:
        for cloud, points in clouds.items():
            change = _change(answer(reading.run_literal, cloud), answer(reading.run_other, cloud))
            matters = _judged(change, len(points), sd_center, sd_radius)
            rows.append(
                {"equation": reading.equation, "reading": reading.name, "cloud": cloud}
                | change
                | {"matters": matters}
            )
    # Nullable integers: no number stays no number, and whole numbers stay whole.
    counts = [
        f"{name}_{side}"
        for name in ("rejected", "faded", "iterations")
        for side in ("literal", "other")
    ]
    return pd.DataFrame(rows).astype(dict.fromkeys(counts, "Int64"))


def reference(clean: NDArray[np.float64]) -> tuple[float, float]:
    """Standard deviations in m of centre (root of the sum of the three variances) and radius by LS
    without gross errors.
    """
    sd = fit_sphere(clean, "ls").standard_deviations
    return float(np.linalg.norm(sd[:3])), float(sd[3])


def _change(literal: Answer, other: Answer) -> dict:
    """Changes from the literal to the other answer, at a precision above the rounding errors."""
    change = {
        "center_mm": round(1e3 * float(np.linalg.norm(other.center - literal.center)), 6),
        "radius_mm": round(1e3 * (other.radius - literal.radius), 6),
        "sigma_0_ratio": round(other.sigma_0 / literal.sigma_0, 9),
    }
    if not (literal.converged and other.converged):
        change = dict.fromkeys(change, np.nan)
    for name in ("rejected", "faded", "iterations"):
        for side, answer in (("literal", literal), ("other", other)):
            change[f"{name}_{side}"] = getattr(answer, name) if answer.converged else None
    for side in ("literal", "other"):
        if change[f"iterations_{side}"]:  # the last of hundreds depends on the last bits
            change[f"iterations_{side}"] = int(float(f"{change[f'iterations_{side}']:.1e}"))
    return change


def _judged(change: dict, n: int, sd_center: float, sd_radius: float) -> str:
    """The rule of this study."""
    if np.isnan(change["center_mm"]) or change["rejected_other"] > n / 2:
        return BREAKDOWN
    if (
        change["center_mm"] > SHARE * 1e3 * sd_center
        or abs(change["radius_mm"]) > SHARE * 1e3 * sd_radius
    ):
        return SPHERE
    if abs(change["sigma_0_ratio"] - 1) > SHARE / np.sqrt(2 * (n - PARAMETERS)):
        return SIGMA_0
    return NOTHING


def shown(changes: pd.DataFrame) -> pd.DataFrame:
    """The table of :func:`study` as a reader wants it: counts as "literal → other", the place once
    for both clouds.
    """
    frame = changes.rename(
        columns={
            "equation": "eq.",
            "center_mm": "centre/mm",
            "radius_mm": "radius/mm",
            "sigma_0_ratio": "σ0 ratio",
        }
    )
    for name, head in (("rejected", "rejected"), ("faded", "faded"), ("iterations", "rounds")):
        pairs = zip(changes[f"{name}_literal"], changes[f"{name}_other"], strict=True)
        frame[head] = [
            " → ".join("–" if pd.isna(count) else str(count) for count in pair) for pair in pairs
        ]
    for column in ("eq.", "reading"):
        frame[column] = frame[column].where(~changes["reading"].duplicated(), "")
    return frame[
        [
            "eq.",
            "reading",
            "cloud",
            "centre/mm",
            "radius/mm",
            "σ0 ratio",
            "rejected",
            "faded",
            "rounds",
            "matters",
        ]
    ]


def how_often(trials: int, readings: tuple[Reading, ...] = READINGS) -> pd.DataFrame:
    """In how many redraws of both clouds the sphere changes by what matters, or the reading breaks
    down.

    Parameters: trials, the number of redraws; :func:`study` judges each by its own clean cloud.
    Returns one row a place, ``clean`` and ``gross`` count redraws.
    """
    redraws = zip(sphere_redraws(trials), sphere_redraws(trials, gross=True), strict=True)
    changes = pd.concat(
        [study({"clean": clean, "gross": gross}, readings) for clean, gross in redraws]
    )
    changes["counts"] = changes["matters"].isin([SPHERE, BREAKDOWN])
    counts = changes.pivot_table(
        index=["equation", "reading"], columns="cloud", values="counts", aggfunc="sum", sort=False
    )
    return counts.astype(int).reset_index().rename_axis(columns=None)


def descriptions(readings: tuple[Reading, ...] = READINGS) -> pd.DataFrame:
    """Places that can be read in two ways, one row per place.

    >>> descriptions().loc[4].tolist()
    ['13', 'exponent', '1', '2, the usual IGG III']
    """
    return pd.DataFrame(
        [
            {"eq.": r.equation, "reading": r.name, "literal": r.literal, "other": r.other}
            for r in readings
        ]
    )


def scale_and_cumulation(
    clouds: Mapping[str, NDArray[np.float64]], center: NDArray[np.float64]
) -> pd.DataFrame:
    """Error of the centre for every σ of eq. (13), each with cumulative weights (step 6) and
    without.

    Parameters
    ----------
    clouds : name -> (n, 3) points in m.
    center : (3,) the true one, m.

    Returns
    -------
    One row a σ and rule, with ``<cloud>_mm``, the distance to the true centre, and
    ``<cloud>_lost``, the number of points whose weight ended below ``FADED``; no numbers where no
    sphere was found.
    """
    rows = []
    for scale in SCALES:
        for cumulative in (True, False):
            row = {"sigma": scale, "weights": "cumulative" if cumulative else "not cumulative"}
            for cloud, points in clouds.items():
                answer = _igg3(points, scale=scale, cumulative=cumulative)
                found = answer.converged
                row[f"{cloud}_mm"] = (
                    round(1e3 * float(np.linalg.norm(answer.center - center)), 6)
                    if found
                    else np.nan
                )
                row[f"{cloud}_lost"] = answer.faded if found else None
            rows.append(row)
    return pd.DataFrame(rows).astype({f"{cloud}_lost": "Int64" for cloud in clouds})


def start_as_printed(points: NDArray[np.float64]) -> pd.DataFrame:
    """Forms of ``[(μA)⁻¹Aᵀμ]Y``, line 4 of eq. (15): one row per form, its factors with
    their shapes.

    An inverse needs a square matrix; a product needs equal inner dimensions.

    >>> start = start_as_printed(np.arange(18.0).reshape(6, 3) ** 2)
    >>> print(start.to_string(index=False, header=False))
         (μA)⁻¹ Aᵀμ Y, as printed  (6 × 4)⁻¹ · (4 × 6) · (6 × 1) no: only a square matrix has an
         inverse
     (μA)⁺ Aᵀμ Y, pseudo-inverse    (4 × 6) · (4 × 6) · (6 × 1)      no: inner dimensions 6 and 4
     differ
      (AᵀμA)⁻¹ Aᵀμ Y, Aᵀ added  (4 × 4)⁻¹ · (4 × 6) · (6 × 1)                     yes: 4 parameters
    """
    A, w, _ = design(points)
    X = np.linalg.lstsq(A, w, rcond=None)[0]
    mu = np.diag(1 / (w + X[:3] @ X[:3]))
    forms = {
        "(μA)⁻¹ Aᵀμ Y, as printed": ([mu @ A, A.T @ mu], True),
        "(μA)⁺ Aᵀμ Y, pseudo-inverse": ([np.linalg.pinv(mu @ A), A.T @ mu], False),
        "(AᵀμA)⁻¹ Aᵀμ Y, Aᵀ added": ([A.T @ mu @ A, A.T @ mu], True),
    }
    rows = []
    for form, ((first, second), inverted) in forms.items():
        if inverted and first.shape[0] != first.shape[1]:
            outcome = "no: only a square matrix has an inverse"
        elif first.shape[1] != second.shape[0]:
            outcome = f"no: inner dimensions {first.shape[1]} and {second.shape[0]} differ"
        else:
            outcome = f"yes: {len(first @ second @ w)} parameters"
        shapes = f"({_shape(first)}){'⁻¹' * inverted} · ({_shape(second)}) · ({len(w)} × 1)"
        rows.append({"form": form, "shapes": shapes, "defined": outcome})
    return pd.DataFrame(rows)


def _shape(array: NDArray) -> str:
    return " × ".join(map(str, array.shape))


def zero_weight(points: NDArray[np.float64], rejected: int) -> pd.DataFrame:
    """ν of eq. (16) when one point has weight 0: as printed, by sums, and as printed without that
    point.

    The printed ``Q = P⁻¹`` makes the cofactors of the point infinite, so its λ is 0 and
    ``ν = λᵀQ_Xλ`` holds a 0·∞. With ``μ = ωP/(w + κ)`` the same sum is ``ν = Σ ωP r²/(w + κ)²``,
    where nothing is divided by ω.

    Parameters: points (n, 3) in m, n small, because the printed form is computed with its n × n
    matrices; rejected, the index of the point of weight 0.

    >>> from studies.ou_liu_2017.clouds import read_sphere_cloud
    >>> nu = zero_weight(read_sphere_cloud(gross=True)[:12], rejected=11)["nu"]
    >>> np.isnan(nu[0]), np.isclose(nu[1], nu[2])
    (np.True_, np.True_)
    """
    A, w, P = design(points)
    P[rejected] = 0.0
    used = P > 0
    X = np.linalg.lstsq(A[used], w[used], rcond=None)[0]
    r, kappa = w - A @ X, X[:3] @ X[:3]
    computed = {
        "as printed, Q = P⁻¹": _nu_as_printed(P, w, r, kappa),
        "by sums, nothing divided by ω": np.sum(P * (r / (w + kappa)) ** 2),
        "as printed, point deleted": _nu_as_printed(P[used], w[used], r[used], kappa),
    }
    return pd.DataFrame({"computed": list(computed), "nu": list(computed.values())})


def _nu_as_printed(P: NDArray, w: NDArray, r: NDArray, kappa: float) -> float:
    """Eq. (16) with diagonal n × n matrices."""
    with np.errstate(divide="ignore", invalid="ignore"):
        Q_X, Q_Y = np.diag(1 / P), np.diag(w / P)
        mu = np.diag(1 / np.diag(Q_Y + kappa * Q_X))
        multipliers = mu @ r
        return float(multipliers @ Q_X @ multipliers)
