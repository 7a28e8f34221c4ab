"""Hypotheses on how tables 1 to 3 were made, simulated, with the likelihood of
the printed numbers under each.

The likelihood of a printed row is the probability that a redraw, rounded as printed, gives just
that row. It is estimated by a Gaussian kernel over the redraws of (a, b, c, r, ln σ0, ln σs),
summed over the signs that are not printed (`log_likelihood`). Only differences count: 2 means that
one hypothesis makes the row a hundred times as likely as the other. Far from all redraws nothing
can be estimated, and "below -30" is all that is said.

Source: Ou & Liu (2017), tables 1 to 3, doi:10.7510/jgjs.issn.1001-3806.2017.05.026.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import product

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.special import logsumexp

from analysis.adjustment.igg3 import SCALES
from analysis.export import tables

from ..montecarlo import sphere_study
from ..paths import RESULTS, existing
from .clouds import (
    SEED,
    SPHERE,
    SPHERE_CENTER,
    SPHERE_DECIMALS,
    SPHERE_POINTS,
    SPHERE_RADIUS,
    SPHERE_SIDE,
    sphere_redraws,
)
from .gross_errors import ANY_SIZE, COMMITTED, SIZES, redraws_of_size
from .printed_tables import LABELS, METHODS, printed, printed_numbers, row
from .rows import radius_with_wrong_sign

# P_X, which the paper does not print; four steps double it
UNIT_WEIGHTS = np.geomspace(0.05, 12.8, 33)
QUARTER = 0.25  # P_X where Q_u = 4 σ_x² with σ_x = 1, eq. (10)
LOWEST = -30.0  # log10: what a kernel over some hundred redraws can still tell from zero
ALL = ("a", "b", "c", "r", "sigma_0", "sigma_s")
WITHOUT_RADIUS = ("a", "b", "c", "sigma_0", "sigma_s")
CENTRE_AND_SIGMA_0 = ("a", "b", "c", "sigma_0")  # what of table 2 tells one reading from another


def log_likelihood(
    trials: pd.DataFrame,
    table: int,
    method: str,
    quantities: Sequence[str] = ALL,
    unit_weight: float = 1.0,
    wrong_sign: bool = False,
) -> float:
    """log10 of the probability that a redraw gives the printed row: its ``quantities``, each within
    half a unit of its last digit.

    trials : frame of `montecarlo.sphere_study`; unit_weight : P_X, by whose root σ0 is multiplied;
        wrong_sign : Δr of every redraw
    from δ with the wrong sign (`rows.radius_with_wrong_sign`).

    The kernel has the redraws' covariance times B^(-2/(d + 4)) (Scott's rule), enlarged by the
    width of the printed digits.
    """
    one = row(printed(), table, method)
    sample, place, width = [], [], []
    errors = trials[[f"delta_{name}_m" for name in "abcr"]].to_numpy()
    if wrong_sign:
        errors = np.column_stack(
            [errors[:, :3], radius_with_wrong_sign(SPHERE + errors) - SPHERE_RADIUS]
        )
    for name in quantities:
        if name in "abcr":
            quantity = f"abs_delta_{name}_m"
            sample.append(errors[:, "abcr".index(name)])
            place.append(one[quantity])
            width.append(2 * one.half(quantity))
        else:
            quantity, column = (
                ("sigma_0", "sigma_0") if name == "sigma_0" else ("sigma_s_m", "sigma_s_m")
            )
            scale = math.sqrt(unit_weight) if name == "sigma_0" else 1.0
            sample.append(np.log(np.maximum(scale * trials[column].to_numpy(), 1e-300)))
            place.append(math.log(one[quantity]))
            width.append(2 * one.half(quantity) / one[quantity])
    cloud = np.column_stack(sample)
    cloud = cloud[np.isfinite(cloud).all(axis=1) & trials["converged"].to_numpy()]
    signed = sum(name in "abcr" for name in quantities)
    signs = np.array(
        [[*signs, *[1] * (len(quantities) - signed)] for signs in product((-1, 1), repeat=signed)]
    )
    return _kernel_log10(cloud, signs * np.array(place), np.array(width))


def _kernel_log10(
    cloud: NDArray[np.float64], places: NDArray[np.float64], width: NDArray[np.float64]
) -> float:
    """log10 of the kernel density of a cloud (B, d) summed over places (s, d), times the volume of
    a box of that width.
    """
    count, d = cloud.shape
    if count <= d + 1:
        return LOWEST
    covariance = np.atleast_2d(np.cov(cloud.T)) * count ** (-2 / (d + 4)) + np.diag(width**2 / 12)
    factor = np.linalg.cholesky(covariance)
    away = np.linalg.solve(factor, (places[:, None, :] - cloud[None]).reshape(-1, d).T)
    exponent = logsumexp(-0.5 * np.sum(away**2, axis=0)) - math.log(count)
    exponent += (
        np.sum(np.log(width)) - 0.5 * d * math.log(2 * math.pi) - np.sum(np.log(np.diag(factor)))
    )
    return max(float(exponent / math.log(10)), LOWEST)


def best_unit_weight(
    trials: pd.DataFrame, table: int, quantities: Sequence[str], wrong_sign: bool = False
) -> tuple[float, float]:
    """The largest log10 likelihood of a row of IGG III-WTLS over `UNIT_WEIGHTS`, and the P_X that
    gives it.
    """
    curve = [
        log_likelihood(trials, table, "igg3_wtls", quantities, P_X, wrong_sign)
        for P_X in UNIT_WEIGHTS
    ]
    return max(curve), float(UNIT_WEIGHTS[int(np.argmax(curve))])


# ------------------------------------------------------------------ which IGG III

SCALES_TRIED = tuple(scale for scale in SCALES if scale != "unit")  # which leaves no points
READINGS = {
    (scale, power, cumulative): {
        "method": "igg3_wtls",
        "scale": scale,
        "power": power,
        "cumulative": cumulative,
    }
    for scale in SCALES_TRIED
    for power in (1, 2)
    for cumulative in (True, False)
}


def igg3_readings(
    trials: int,
    scales: Sequence[str] = SCALES_TRIED,
    laws: Sequence[str] = (COMMITTED, ANY_SIZE),
    seed: int = SEED,
) -> pd.DataFrame:
    """Which reading of IGG III-WTLS comes nearest to its rows in tables 1 and 2?

    Readings with σ from one of the ``scales``. One row a reading and law of the gross errors (names
    of `gross.SIZES`): ``table 1``, log10 likelihood of the row of table 1, and ``table 2`` of
    centre and σ0 of table 2 (Δr contradicts its row whatever the reading, σs counts the gross
    errors), at the P_X that suits each best; ``both`` with one P_X for both tables;
    ``both, P_X = 1`` and ``both, P_X = 1/4``; ``halves``, by how much ``both`` differs between the
    two halves of the redraws, which says what a difference is worth. Best first; last, without
    numbers, the readings that leave less than half of the points of table 1 in use: they run into a
    few points that depend on the last bits.
    """
    readings = {key: options for key, options in READINGS.items() if key[0] in scales}
    clean = sphere_study(sphere_redraws(trials, seed), SPHERE, readings)
    rows = []
    for law in laws:
        gross = sphere_study(redraws_of_size(law, trials, seed), SPHERE, readings)
        for key in readings:
            one = dict(zip(("scale", "power", "cumulative"), key, strict=True)) | {
                "gross errors": law
            }
            rows.append(one)
            if clean[key]["rejected"].median() > SPHERE_POINTS / 2:
                continue
            first, second = _over_unit_weights(clean[key], gross[key])
            both = first + second
            for name, curve in (("table 1", first), ("table 2", second), ("both", both)):
                best = int(curve[: len(UNIT_WEIGHTS)].argmax())
                one.update({name: curve[best], f"P_X, {name}": UNIT_WEIGHTS[best]})
            one.update({"both, P_X = 1": both[-2], "both, P_X = 1/4": both[-1]})
            parts = slice(0, trials // 2), slice(trials // 2, None)
            halves = [
                sum(_over_unit_weights(clean[key][part], gross[key][part])).max() for part in parts
            ]
            one["halves"] = abs(halves[0] - halves[1])
    return best_first(pd.DataFrame(rows))


def best_first(readings: pd.DataFrame) -> pd.DataFrame:
    """Readings ordered by ``both``, to three decimals, so that what is equal stays in its place."""
    return readings.sort_values(
        "both", key=lambda both: -both.round(3), kind="stable", ignore_index=True
    )


def _over_unit_weights(
    clean: pd.DataFrame, gross: pd.DataFrame
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """log10 likelihoods of the rows of table 1 and of centre and σ0 of table 2, over
    `UNIT_WEIGHTS`, 1 and 1/4.
    """
    weights = [*UNIT_WEIGHTS, 1.0, QUARTER]
    first = [log_likelihood(clean, 1, "igg3_wtls", ALL, P_X) for P_X in weights]
    second = [log_likelihood(gross, 2, "igg3_wtls", CENTRE_AND_SIGMA_0, P_X) for P_X in weights]
    return np.array(first), np.array(second)


# ------------------------------------------------------------------ which cloud


def _rounded(points: NDArray[np.float64], decimals: int = SPHERE_DECIMALS) -> NDArray[np.float64]:
    return np.round(points, decimals)


def _exact(trials: int, seed: int) -> tuple[NDArray[np.float64], list[np.random.Generator]]:
    """(B, 500, 3) points on the cap without noise, and a generator for each."""
    clouds, generators = [], []
    for child in np.random.SeedSequence([seed, 1]).spawn(trials):
        generator = np.random.default_rng(child)
        plan = generator.uniform(0, SPHERE_SIDE, size=(500, 2)) - SPHERE_CENTER[:2]
        height = np.sqrt(SPHERE_RADIUS**2 - np.sum(plan**2, axis=1))
        clouds.append(np.column_stack([plan, height]) + SPHERE_CENTER)
        generators.append(generator)
    return np.array(clouds), generators


def _noisy(
    points: NDArray[np.float64], generators: Sequence[np.random.Generator], sd: float
) -> NDArray[np.float64]:
    return points + sd * np.array(
        [generator.standard_normal(points.shape[1:]) for generator in generators]
    )


def _both_halves(points: NDArray[np.float64], _) -> NDArray[np.float64]:
    points = points.copy()
    points[:, ::2, 2] = 2 * SPHERE_CENTER[2] - points[:, ::2, 2]
    return _rounded(points)


ROUNDING = 10.0**-SPHERE_DECIMALS / math.sqrt(12)  # m, standard deviation of what rounding does
CLOUDS: dict[
    str, Callable[[NDArray[np.float64], Sequence[np.random.Generator]], NDArray[np.float64]]
] = {
    "upper cap, rounded to 0.01 m": lambda points, _: _rounded(points),
    "both halves, rounded to 0.01 m": _both_halves,
    "upper cap, rounded to 0.001 m": lambda points, _: _rounded(points, 3),
    "upper cap, rounded to 0.1 m": lambda points, _: _rounded(points, 1),
    "upper cap, normal noise 2.89 mm": lambda points, generators: _noisy(
        points, generators, ROUNDING
    ),
    "upper cap, normal noise 1 mm, rounded to 0.01 m": lambda points, generators: _rounded(
        _noisy(points, generators, 0.001)
    ),
    "upper cap, normal noise 2.89 mm, rounded to 0.01 m": lambda points, generators: _rounded(
        _noisy(points, generators, ROUNDING)
    ),
}
"""Hypothesis -> (exact points of the cap, generators) -> the cloud of table 1."""


def clouds(trials: int, seed: int = SEED) -> pd.DataFrame:
    """One cap or the whole sphere, and which noise? log10 likelihoods of the rows of table 1, best
    first.

    IGG III-WTLS is taken without its σ0, which depends on a P_X that is not printed. TLS has the
    row of LS.
    """
    exact, _ = _exact(trials, seed)
    rows = []
    for name, make in CLOUDS.items():
        points = make(exact, _exact(trials, seed)[1])
        study = sphere_study(points, SPHERE, {m: {"method": m} for m in ("ls", "igg3_wtls")})
        found = {
            "LS": log_likelihood(study["ls"], 1, "ls"),
            "IGG III-WTLS": log_likelihood(
                study["igg3_wtls"], 1, "igg3_wtls", ("a", "b", "c", "r", "sigma_s")
            ),
        }
        rows.append({"cloud": name} | found | {"together": sum(found.values())})
    return pd.DataFrame(rows).sort_values(
        "together", ascending=False, kind="stable", ignore_index=True
    )


# ------------------------------------------------------------------ which gross errors, and which
# Δr


def gross_studies(trials: int, seed: int = SEED) -> dict[str, dict[str, pd.DataFrame]]:
    """law of the gross errors -> method -> its fits to redraws of table 2."""
    variants = {method: {"method": method} for method in METHODS.values()}
    return {
        law: sphere_study(redraws_of_size(law, trials, seed), SPHERE, variants) for law in SIZES
    }


def gross_errors(studies: Mapping[str, Mapping[str, pd.DataFrame]]) -> pd.DataFrame:
    """Which gross errors? log10 likelihoods of the rows of table 2 without Δr; IGG III-WTLS at the
    best P_X and at P_X = 1/4.

    Also ``unseen``, the percentage of redraws in which IGG III-WTLS keeps at least one of the five,
    and where the printed σ0 (at P_X = 1 and 1/4) and centre of IGG III-WTLS and Δa of LS lie among
    the redraws, in percent.
    """
    rows = []
    for law, study in studies.items():
        igg, ls = study["igg3_wtls"], study["ls"]
        best, P_X = best_unit_weight(igg, 2, WITHOUT_RADIUS)
        one = {"gross errors": law, "LS": log_likelihood(ls, 2, "ls", WITHOUT_RADIUS)}
        one |= {"TLS": log_likelihood(study["tls"], 2, "tls", WITHOUT_RADIUS)}
        one |= {"IGG III-WTLS": best, "P_X": P_X}
        one |= {
            "IGG III-WTLS, P_X = 1/4": log_likelihood(igg, 2, "igg3_wtls", WITHOUT_RADIUS, QUARTER)
        }
        one["unseen"] = 100 * (igg["rejected"] < 5).mean()
        printed_row = row(printed(), 2, "igg3_wtls")
        one["σ0 below print"] = 100 * (igg["sigma_0"] < printed_row["sigma_0"]).mean()
        one["σ0 below print, P_X = 1/4"] = (
            100 * (0.5 * igg["sigma_0"] < printed_row["sigma_0"]).mean()
        )
        for name in "abc":
            one[f"Δ{name} below print"] = (
                100 * (igg[f"delta_{name}_m"].abs() < printed_row[f"abs_delta_{name}_m"]).mean()
            )
        one["Δa of LS below print"] = (
            100 * (ls["delta_a_m"].abs() < row(printed(), 2, "ls")["abs_delta_a_m"]).mean()
        )
        rows.append(one)
    return pd.DataFrame(rows)


def radius_slips(studies: Mapping[str, Mapping[str, pd.DataFrame]]) -> pd.DataFrame:
    """How did Δr of table 2 come about? log10 of the probability of each printed Δr, under four
    hypotheses and each law of gross errors.

    ``as printed``: a redraw has that Δr. ``wrong sign of δ``: it has it when the radius is computed
    as √(|k|² − δ). ``copied``: a length of table 3 was copied, any of them alike (`LOWEST` where it
    is not among them). ``one digit``: a redraw has the same Δr but for one digit, any digit and any
    wrong one alike. All of these are what follows *if* that slip was made, not how readily it is
    made.
    """
    lengths = [
        n.text
        for n in printed_numbers(3)
        if n.quantity in ("a_m", "b_m", "c_m", "r_m", "abs_delta_r_m")
    ]
    rows = []
    for law, study in studies.items():
        for method, label in LABELS.items():
            number = printed()[f"ou_liu_2017/table2/{method}/abs_delta_r_m"]
            errors = study[method][[f"delta_{name}_m" for name in "abcr"]].to_numpy()
            slipped = np.abs(radius_with_wrong_sign(SPHERE + errors) - SPHERE_RADIUS)
            copies = sum(text.lstrip("-") == number.text for text in lengths)
            neighbours = _one_digit_away(number.text)
            digit = [
                _probability(np.abs(errors[:, 3]), value, 2 * number.half_unit)
                for value in neighbours
            ]
            one = {"gross errors": law, "method": label, "printed": number.text}
            one["as printed"] = _log10(
                _probability(np.abs(errors[:, 3]), number.value, 2 * number.half_unit)
            )
            one["wrong sign of δ"] = _log10(
                _probability(slipped[np.isfinite(slipped)], number.value, 2 * number.half_unit)
            )
            one["copied"] = _log10(copies / len(lengths))
            one["one digit"] = _log10(float(np.mean(digit)))
            rows.append(one)
    return pd.DataFrame(rows)


def _one_digit_away(text: str) -> list[float]:
    """All numbers that differ from a printed one in one digit."""
    found = []
    for place, sign in enumerate(text):
        if sign.isdigit():
            found += [
                float(text[:place] + digit + text[place + 1 :])
                for digit in "0123456789"
                if digit != sign
            ]
    return found


def _probability(sample: NDArray[np.float64], value: float, width: float) -> float:
    """Probability of a positive quantity within a width, by a kernel over its sample."""
    scale = np.hypot(sample.std() * len(sample) ** (-1 / 5), width / math.sqrt(12))
    away = (np.array([[value], [-value]]) - sample) / scale  # reflected at zero
    return float(
        np.exp(-0.5 * away**2).sum() / len(sample) / scale / math.sqrt(2 * math.pi) * width
    )


def _log10(probability: float) -> float:
    return max(math.log10(probability), LOWEST) if probability > 0 else LOWEST


def rows_of_table_2(studies: Mapping[str, Mapping[str, pd.DataFrame]]) -> pd.DataFrame:
    """Whole rows of table 2: log10 likelihood with Δr as printed, from δ with the wrong sign, and
    left out (a misprint of Δr alone).

    IGG III-WTLS at the P_X that suits each best.
    """
    rows = []
    for law, study in studies.items():
        for label, method in METHODS.items():
            one = {"gross errors": law, "method": label}
            for name, quantities, wrong_sign in (
                ("as printed", ALL, False),
                ("wrong sign of δ", ALL, True),
                ("Δr left out", WITHOUT_RADIUS, False),
            ):
                if method == "igg3_wtls":
                    one[name], _ = best_unit_weight(study[method], 2, quantities, wrong_sign)
                else:
                    one[name] = log_likelihood(
                        study[method], 2, method, quantities, wrong_sign=wrong_sign
                    )
            rows.append(one)
    return pd.DataFrame(rows)


# ------------------------------------------------------------------ table 3


def scans() -> pd.DataFrame:
    """Table 3: the exponents of sphere I, and σs over all points or over those in use, beside
    simulated scans (notebook 04).

    One row a printed ratio and sphere: ``printed``; ``corrected``, with the exponent of σ0 of
    sphere I raised by one; ``lower`` and ``upper``, the central 95 % of simulated scans, raw and
    cleaned together; and both over the limit that they exceed or fall short of, 1 inside. σs of LS
    over that of IGG III-WTLS stands twice, once for each meaning: the two readings stand against
    each other.
    """
    measured = tables.read(existing(RESULTS / "04_scanned_spheres_table3_measured.csv"))
    rows = []
    ratios = measured[~measured["relation"].str.startswith("LS and TLS")]
    for (relation, sphere), group in ratios.groupby(["relation", "sphere"], sort=False):
        as_printed = float(group["printed"].iloc[0])
        corrected = 10 * as_printed if relation.startswith("σ0") and sphere == "I" else as_printed
        lower, upper = float(group["lower"].min()), float(group["upper"].max())
        one = {
            "relation": relation,
            "sphere": sphere,
            "printed": as_printed,
            "corrected": corrected,
            "lower": lower,
            "upper": upper,
        }
        one |= {
            "printed over the nearer limit": _over(as_printed, lower, upper),
            "corrected over it": _over(corrected, lower, upper),
        }
        rows.append(one)
    return pd.DataFrame(rows)


def _over(value: float, lower: float, upper: float) -> float:
    """1 inside an interval, else the value over the limit it exceeds or falls short of."""
    return value / upper if value > upper else value / lower if value < lower else 1.0


def unit_weights_of_scans(found: pd.DataFrame) -> pd.DataFrame:
    """Between which P_X σ0 of IGG III-WTLS in table 3 lies in the central 95 % of simulated scans,
    with the exponent of sphere I put right.

    found : frame of `scans`, made with P_X = 1; σ0 is proportional to √P_X.
    """
    igg = found[found["relation"].str.startswith("σ0 of IGG")]
    limits = {
        f"P_X, {word}": (igg["corrected"] / igg[limit]) ** 2
        for word, limit in (("least", "upper"), ("most", "lower"))
    }
    return pd.DataFrame({"sphere": igg["sphere"], **limits})
