"""Table 3 of Ou & Liu (2017) by simulation: its two spheres, scanned again and again, beside the
printed numbers.

The authors' scans are not published. What the paper says of them is the instrument (a Leica
ScanStation C10), the radius of the targets (0.0725 m), and that gross errors had been removed, not
how. The centres are printed as each method found them; those of IGG III-WTLS are taken as the truth
here, and the printed rows of the others are to be seen relative to them. All else (the step of the
scan, the noise, what stands around the spheres) is assumed.

Two states of each scan bound whatever cleaning the authors did:

    raw       all points of a ball around the sphere: sphere, mount, wall, and mixed pixels between
              them
    cleaned   the points whose beam lay wholly on the sphere: leaves in nothing foreign and takes
              out nothing good

Source: Ou & Liu (2017), section 2.2, doi:10.7510/jgjs.issn.1001-3806.2017.05.026.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.scanner import LEICA_C10, Scanner

from ..montecarlo import EVERY_METHOD, sphere_study
from ..printed.comparison import OUTSIDE, compare
from ..simulation.scenes import Scan, redraw, scan_sphere_target
from .printed_tables import LABELS as METHOD_LABELS
from .printed_tables import printed_numbers
from .printed_tables import values as printed_values
from .table3_relations import RADIUS, SAMPLES, sigma_0_over_expected

RAW, CLEANED = "raw", "cleaned"
HELD, WITH_COFACTORS = "robust, radius held", "robust, cofactors"
CENTRE_IS_ASSUMED = "igg3_wtls"  # the method whose printed centres stand for the truth

# Why a printed number is outside the redraws of the cleaned scans: (method, quantity), or with the
# sphere where only one is concerned.
_SHIFTED = (
    "farther from the centre of IGG III-WTLS than noise moves it, as points left in "
    "beside the sphere would"
)
_NOT_BY_NOISE = (
    "larger than this noise makes it, as points left in off the sphere would, or a noisier scanner"
)
_TOO_LARGE = "too large, while noise makes it too small, as points left in outside the sphere would"
CAUSES = {
    **{
        (method, quantity): _SHIFTED
        for method in ("ls", "tls")
        for quantity in ("a_m", "b_m", "c_m")
    },
    **{(method, "r_m"): _TOO_LARGE for method in ("ls", "tls")},
    **{(method, "sigma_0"): "follows σs (close to 2rσs)" for method in ("ls", "tls")},
    **{(method, "sigma_s_m"): _NOT_BY_NOISE for method in ("ls", "tls")},
    **{
        ("I", method, "sigma_0"): "contradicts its own row: below rσs; ten times too small"
        for method in ("ls", "tls")
    },
    ("I", "ls", "b_m"): "misprint of 5.8443: half a metre from the centre of TLS",
    ("I", "igg3_wtls", "sigma_0"): "ten times smaller than its σs leads to, beside sphere II",
    ("igg3_wtls", "sigma_0"): "follows σs, and √P_X, which is not printed",
    ("igg3_wtls", "sigma_s_m"): "not over all points: impossible beside σs of LS",
    ("igg3_wtls", "sigma_s_in_use_m"): "below the noise assumed, while σs of LS is far above it",
}

SYMBOLS = dict(
    a_m="a",
    b_m="b",
    c_m="c",
    r_m="r",
    abs_delta_r_m="|Δr|",
    sigma_0="σ0",
    sigma_s_m="σs",
    sigma_s_in_use_m="σs in use",
)
COMPONENTS = ("along", "aside", "up", "radius")

# (sample, state) -> variant -> frame of `montecarlo.sphere_study`
Study = dict[tuple[str, str], dict[str, pd.DataFrame]]


def truths() -> dict[str, NDArray[np.float64]]:
    """sample -> the sphere (a, b, c, r) that is scanned, m.

    >>> truths()["I"].tolist()
    [0.0063, 5.8454, -1.6357, 0.0725]
    """
    return {
        sample: np.append(_printed_sphere(sample, CENTRE_IS_ASSUMED)[:3], RADIUS)
        for sample in SAMPLES
    }


def scans(seed: int, scanner: Scanner = LEICA_C10, **assumed) -> dict[str, Scan]:
    """sample -> its target scanned once. ``assumed``: keywords of
    :func:`scanner.scan_sphere_target`.
    """
    children = np.random.SeedSequence(seed).spawn(len(truths()))
    return {
        sample: scan_sphere_target(
            truth[:3], RADIUS, np.random.default_rng(child), scanner=scanner, **assumed
        )
        for (sample, truth), child in zip(truths().items(), children, strict=True)
    }


def contents(targets: Mapping[str, Scan]) -> pd.DataFrame:
    """Contents of the scans: ``sphere``, ``range_m`` of its centre, points by label, and the
    percentage that is not of the sphere.
    """
    rows = []
    for sample, target in targets.items():
        counts = {name: int(np.count_nonzero(target.on(name))) for name in target.names}
        one = {
            "scan of": f"sphere {sample}",
            "range_m": np.linalg.norm(truths()[sample][:3]),
            "points": len(target),
        } | counts
        rows.append(one | {"not_sphere_percent": 100 * (1 - counts["sphere"] / len(target))})
    return pd.DataFrame(rows)


def study(targets: Mapping[str, Scan], trials: int, seed: int) -> Study:
    """Every method on redraws of every scan, raw and cleaned.

    Beside the methods with their defaults: ``robust`` with the radius held at its nominal value,
    and, on the cleaned scans, with the scanner's cofactors. These depend on the directions and
    ranges of the points alone, which the noise of a redraw changes by about a thousandth, so they
    are computed once. (On the raw scans that variant would take longer than all others together.)
    """
    found: Study = {}
    for sample, target in targets.items():
        points = redraw(target, trials, seed)
        variants = EVERY_METHOD | {HELD: {"radius": RADIUS}}
        found[sample, RAW] = sphere_study(points, truths()[sample], variants)
        variants = variants | {
            WITH_COFACTORS: {
                "cofactors": target.scanner.cofactors(target.points[target.on("sphere")])
            }
        }
        found[sample, CLEANED] = sphere_study(
            points[:, target.on("sphere")], truths()[sample], variants
        )
    return found


def values(found: Study, sample: str, state: str, method: str) -> dict[str, NDArray[np.float64]]:
    """quantity -> (B,) values of what a row of table 3 prints; NaN where the fit did not converge.

    ``sigma_s_m`` is over all points, as eq. (18) defines it, ``sigma_s_in_use_m`` over those that
    kept a weight.
    """
    trials = found[sample, state][method]
    spheres = trials[[f"delta_{name}_m" for name in "abcr"]].to_numpy() + truths()[sample]
    result = {f"{name}_m": column for name, column in zip("abcr", spheres.T, strict=True)}
    result["abs_delta_r_m"] = np.abs(spheres[:, 3] - RADIUS)
    result |= {
        "sigma_0": trials["sigma_0"],
        "sigma_s_m": trials["sigma_s_m"],
        "sigma_s_in_use_m": trials["sigma_s_inliers_m"],
    }
    return {name: np.where(trials["converged"], column, np.nan) for name, column in result.items()}


def comparison(found: Study, state: str) -> pd.DataFrame:
    """Every printed number of table 3 beside the redraws, one row each; by the rule of
    :func:`comparison.verdict`.

    The printed σs of IGG III-WTLS has two rows, one for either meaning. Columns: sample, method,
    quantity, unit, printed (as text), decimals, median, lower and upper limit of the central 95 %,
    percentile of the printed number, redraws that converged, verdict.
    """
    numbers = []
    for number in printed_numbers(3):
        numbers.append((number.quantity, number))
        if (number.method, number.quantity) == ("igg3_wtls", "sigma_s_m"):
            numbers.append(("sigma_s_in_use_m", number))
    rows = []
    for quantity, number in numbers:
        ours = values(found, number.sample, state, number.method)[quantity]
        result = compare(number, ours[0], ours)
        named = {
            "sample": number.sample,
            "method": number.method,
            "quantity": quantity,
            "unit": number.unit,
        }
        named |= {"printed": number.text, "decimals": number.decimals}
        rows.append(
            named
            | {
                name: getattr(result, name)
                for name in ("median", "lower", "upper", "percentile", "redraws", "verdict")
            }
        )
    return pd.DataFrame(rows)


def side_by_side(cleaned: pd.DataFrame, raw: pd.DataFrame) -> pd.DataFrame:
    """The comparisons of both states as text for reading: values at the decimals of print."""
    rows = []
    for mine, whole in zip(cleaned.itertuples(), raw.itertuples(), strict=True):
        form = f".{mine.decimals}f" if "e" not in mine.printed else ".2e"
        shown = {
            "sphere": mine.sample,
            "method": METHOD_LABELS[mine.method],
            "": SYMBOLS[mine.quantity],
            "unit": mine.unit,
        }
        shown |= {
            "printed": mine.printed,
            "2.5 %": format(mine.lower, form),
            "median": format(mine.median, form),
        }
        shown |= {
            "97.5 %": format(mine.upper, form),
            "percentile": mine.percentile,
            "verdict": mine.verdict.split()[0],
        }
        rows.append(
            shown
            | {
                "raw: median": format(whole.median, form),
                "verdict on raw": whole.verdict.split()[0],
            }
        )
    return pd.DataFrame(rows)


def outside(cleaned: pd.DataFrame) -> pd.DataFrame:
    """The numbers that are outside, each with its cause; numbers with the same cause together.

    Raises ``KeyError`` for a number that is outside and for which :data:`CAUSES` does not say why.
    """
    rows: dict[tuple[str, str, str], list[str]] = {}
    for line in cleaned[cleaned["verdict"] == OUTSIDE].itertuples():
        cause = (
            CAUSES.get((line.sample, line.method, line.quantity))
            or CAUSES[line.method, line.quantity]
        )
        rows.setdefault((line.sample, METHOD_LABELS[line.method], cause), []).append(
            f"{SYMBOLS[line.quantity]} {line.printed}"
        )
    listed = [
        (sample, method, ", ".join(numbers), cause)
        for (sample, method, cause), numbers in rows.items()
    ]
    return pd.DataFrame(listed, columns=["sphere", "method", "printed", "cause"])


def measured(found: Study) -> pd.DataFrame:
    """Relations between the numbers of a row or of two, as printed and in the redraws (central 95
    %), a row each and for each state.

    LS and TLS: the largest difference of their centres and radii, mm. σ0: over what σs leads one to
    expect (:func:`table3_relations.sigma_0_over_expected`). σs of LS over that of IGG III-WTLS,
    over all points and over those in use.
    """
    rows = []
    for sample, state in found:
        ls, tls, igg = (
            pd.DataFrame(values(found, sample, state, method))
            for method in ("ls", "tls", "igg3_wtls")
        )
        names = [f"{name}_m" for name in "abcr"]
        ours = {
            "LS and TLS, largest difference (mm)": 1e3 * (ls[names] - tls[names]).abs().max(axis=1),
            "σ0 of LS over 2rσs": ls["sigma_0"] / (2 * ls["r_m"] * ls["sigma_s_m"]),
            "σ0 of IGG III-WTLS over 2rσs/(√2|k|), σs in use": igg["sigma_0"]
            / (2 * igg["r_m"] * igg["sigma_s_in_use_m"])
            * (np.sqrt(2) * np.linalg.norm(igg[names[:3]], axis=1)),
            "σs of LS over σs of IGG III-WTLS, all points": ls["sigma_s_m"] / igg["sigma_s_m"],
            "σs of LS over σs of IGG III-WTLS, in use": ls["sigma_s_m"] / igg["sigma_s_in_use_m"],
        }
        printed = [
            _ls_less_tls(sample),
            *(sigma_0_over_expected(sample, method) for method in ("ls", "igg3_wtls")),
        ]
        printed += 2 * [
            printed_values(3, "ls", sample)["sigma_s_m"]
            / printed_values(3, "igg3_wtls", sample)["sigma_s_m"]
        ]
        for (relation, column), number in zip(ours.items(), printed, strict=True):
            limits = dict(
                zip(("lower", "median", "upper"), column.quantile((0.025, 0.5, 0.975)), strict=True)
            )
            rows.append(
                {"relation": relation, "sphere": sample, "state": state, "printed": number} | limits
            )
    return pd.DataFrame(rows).sort_values(
        "relation", key=lambda names: names.map(list(ours).index), kind="stable", ignore_index=True
    )


def displacements(found: Study) -> pd.DataFrame:
    """TLS less IGG III-WTLS in mm, which does not depend on the centre that is assumed: as printed,
    and the central 95 % of the redraws.

    ``along``: of the centres along the line of sight, positive away from the scanner; ``aside``:
    horizontally to the left of it; ``up``:
    across both; ``radius``. (TLS because one coordinate of LS, which is equal otherwise, is
    misprinted.)
    """
    rows = []
    for sample, truth in truths().items():
        axes = _sight(truth[:3])
        printed = 1e3 * (_printed_sphere(sample, "tls") - _printed_sphere(sample, "igg3_wtls"))
        rows.append({"sphere": sample, "source": "printed"} | _components(axes, printed))
        for state in (CLEANED, RAW):
            tls, igg = (
                pd.DataFrame(values(found, sample, state, method))
                for method in ("tls", "igg3_wtls")
            )
            moved = 1e3 * (tls - igg)[[f"{name}_m" for name in "abcr"]].dropna().to_numpy()
            moved = np.column_stack([moved[:, :3] @ axes.T, moved[:, 3]])
            for level, word in ((0.025, "2.5 %"), (0.5, "median"), (0.975, "97.5 %")):
                parts = np.quantile(moved, level, axis=0)
                rows.append(
                    {"sphere": sample, "source": f"{state}, {word}"}
                    | dict(zip(COMPONENTS, parts, strict=True))
                )
    return pd.DataFrame(rows)


def printed_errors() -> pd.DataFrame:
    """Printed centres along the line of sight and radii less the truth assumed, mm, per row.

    IGG III-WTLS has no centre here, as it is the truth; LS has the one of TLS.
    """
    rows = []
    for sample, truth in truths().items():
        sight = _sight(truth[:3])[0]
        for method in METHOD_LABELS:
            printed = _printed_sphere(sample, "tls" if method == "ls" else method)
            along = (
                np.nan if method == CENTRE_IS_ASSUMED else 1e3 * sight @ (printed[:3] - truth[:3])
            )
            rows.append(
                {
                    "sphere": sample,
                    "method": method,
                    "along_mm": along,
                    "radius_mm": 1e3 * (printed[3] - RADIUS),
                }
            )
    return pd.DataFrame(rows)


def every_method(found: Study) -> pd.DataFrame:
    """Results of each method on each scan: medians over the redraws, and how far 95 % of the
    centres lie from the truth.

    Columns: sphere, state, variant; ``along_mm`` of the centre's error (see :func:`displacements`)
    and ``radius_mm``, medians, each with ``_lower`` and ``_upper``, the central 95 %;
    ``centre_95_mm``; ``sigma_s_mm`` and ``sigma_s_in_use_mm``, medians; ``not_converged``.
    """
    rows = []
    for (sample, state), frames in found.items():
        sight = _sight(truths()[sample][:3])[0]
        for variant, trials in frames.items():
            trials, failed = trials[trials["converged"]], int((~trials["converged"]).sum())
            errors = 1e3 * trials[[f"delta_{name}_m" for name in "abcr"]].to_numpy()
            one = {"sphere": sample, "state": state, "variant": variant}
            for name, error in (("along_mm", errors[:, :3] @ sight), ("radius_mm", errors[:, 3])):
                one |= dict(
                    zip(
                        (f"{name}_lower", name, f"{name}_upper"),
                        np.quantile(error, (0.025, 0.5, 0.975)),
                        strict=True,
                    )
                )
            one["centre_95_mm"] = np.quantile(np.linalg.norm(errors[:, :3], axis=1), 0.95)
            one["sigma_s_mm"] = 1e3 * trials["sigma_s_m"].median()
            one["sigma_s_in_use_mm"] = 1e3 * trials["sigma_s_inliers_m"].median()
            rows.append(one | {"not_converged": failed})
    return pd.DataFrame(rows)


def _sight(center: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3, 3) unit vectors as rows: along the line of sight from the scanner in the origin,
    horizontally to its left, and up across both.
    """
    along = center / np.linalg.norm(center)
    aside = np.array([-along[1], along[0], 0.0]) / np.hypot(along[0], along[1])
    return np.array([along, aside, np.cross(along, aside)])


def _components(axes: NDArray[np.float64], difference: NDArray[np.float64]) -> dict[str, float]:
    return dict(zip(COMPONENTS, [*(axes @ difference[:3]), difference[3]], strict=True))


def _printed_sphere(sample: str, method: str) -> NDArray[np.float64]:
    """Printed (a, b, c, r) in m."""
    return np.array([printed_values(3, method, sample)[f"{name}_m"] for name in "abcr"])


def _ls_less_tls(sample: str) -> float:
    """Largest printed difference of LS and TLS in mm."""
    return 1e3 * float(np.abs(_printed_sphere(sample, "ls") - _printed_sphere(sample, "tls")).max())
