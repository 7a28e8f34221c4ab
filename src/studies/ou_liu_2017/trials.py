"""Are the checks right? How often they raise a false alarm on right tables, and how often they find
a slip planted in them.

The right tables are simulated: all three tables of Ou & Liu (2017) and the percentages of the text,
from points of our own, with the digits that the paper keeps. Half of the gross errors of table 2
have the sizes assumed for the committed cloud, half are of any size up to 3.5 m, so that some of
them stay unseen.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from decimal import Decimal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..montecarlo import printed_quantities, sphere_study
from ..printed.relation import Numbers
from ..simulation.scenes import redraw
from . import table3
from .checks import CHECKS
from .clouds import SPHERE, SPHERE_RADIUS, sphere_redraws
from .gross_errors import redraws_of_any_size
from .printed_tables import METHODS, SYMBOLS, printed, row
from .rows import radius_with_wrong_sign
from .table3_relations import RADIUS, SAMPLES, STATEMENT

PAPERS_METHODS = {name: {"method": name} for name in METHODS.values()}


def right_papers(trials: int, seed: int) -> list[Numbers]:
    """As many papers in which nothing is wrong: the printed ones with every number of tables 1 to 3
    and every percentage simulated.

    Rounded as printed: tables 1 and 2 to the same decimals, table 3 to four decimals or five
    digits. Beside the numbers that are printed a paper holds ``in use/…``, σs of IGG III-WTLS over
    the points in use, for slips.
    """
    values: dict[str, NDArray[np.float64]] = {}
    half = trials // 2
    gross = np.concatenate(
        [sphere_redraws(half, seed, gross=True), redraws_of_any_size(trials, seed)[half:]]
    )
    for table, points in ((1, sphere_redraws(trials, seed)), (2, gross)):
        study = sphere_study(points, SPHERE, PAPERS_METHODS)
        for (method, quantity), column in printed_quantities(study).items():
            values[f"ou_liu_2017/table{table}/{method}/{quantity}"] = column
        values[f"in use/ou_liu_2017/table{table}/igg3_wtls/sigma_s_m"] = study["igg3_wtls"][
            "sigma_s_inliers_m"
        ].to_numpy()
    for sample, target in table3.scans(seed).items():
        truth = table3.truths()[sample]
        points = redraw(target, trials, seed)[:, target.on("sphere")]
        for method, frame in sphere_study(points, truth, PAPERS_METHODS).items():
            place = f"ou_liu_2017/table3/{sample}/{method}/"
            spheres = frame[[f"delta_{name}_m" for name in "abcr"]].to_numpy() + truth
            values |= {
                f"{place}{name}_m": column for name, column in zip("abcr", spheres.T, strict=True)
            }
            values[place + "abs_delta_r_m"] = np.abs(spheres[:, 3] - RADIUS)
            values |= {
                place + quantity: frame[quantity].to_numpy()
                for quantity in ("sigma_0", "sigma_s_m")
            }
            values[f"ou_liu_2017/rel_radius_{sample}_{STATEMENT[method]}"] = (
                100 * values[place + "abs_delta_r_m"] / RADIUS
            )
    return [_written(values, trial) for trial in range(trials)]


def _written(values: dict[str, NDArray[np.float64]], trial: int) -> Numbers:
    """One paper with the digits that print keeps."""
    paper = dict(printed())
    for name, column in values.items():
        number = paper[name.removeprefix("in use/")]
        paper[name] = rewritten(number, column[trial])
    return paper


def rewritten(number, value: float):
    """A number of the paper with another value, written with the digits of print.

    >>> rewritten(printed()["ou_liu_2017/table3/I/ls/sigma_0"], 0.00012345678).text
    '1.2346e-04'
    """
    if "e" in number.text:
        text = f"{value:.{len(number.text.partition('e')[0]) - 2}e}"
        return replace(number, text=text, decimals=-int(Decimal(text).as_tuple().exponent))
    decimals = getattr(number, "decimals", len(number.text.partition(".")[2]))
    return replace(number, text=f"{value:.{decimals}f}")


def false_alarms(papers: Iterable[Numbers]) -> pd.DataFrame:
    """How often each check, and any, is violated by right papers: ``check``, ``papers``,
    ``false alarms``, ``percent``.
    """
    raised = pd.DataFrame([{name: not _holds(name, paper) for name in CHECKS} for paper in papers])
    raised["any"] = raised.any(axis=1)
    rows = [
        {
            "check": name,
            "papers": len(raised),
            "false alarms": int(raised[name].sum()),
            "percent": 100 * raised[name].mean(),
        }
        for name in raised
    ]
    return pd.DataFrame(rows)


def _holds(check: str, paper: Numbers) -> bool:
    return all(relation.holds for relation in CHECKS[check].function(paper))


# ------------------------------------------------------------------ slips


@dataclass(frozen=True)
class Slip:
    """A slip, how it is planted (paper, generator -> wrong paper), and the check that claims to
    find it.
    """

    name: str
    plant: Callable[[Numbers, np.random.Generator], Numbers]
    check: str | None = None


def with_digit(paper: Numbers, name: str, place: int, generator: np.random.Generator) -> Numbers:
    """The paper with one digit of one number replaced by another one; place 0 is the first that is
    not zero.
    """
    text = paper[name].text
    digits = [i for i, sign in enumerate(text.partition("e")[0]) if sign.isdigit()]
    first = next((i for i, position in enumerate(digits) if text[position] != "0"), len(digits) - 1)
    position = digits[min(first + place, len(digits) - 1)]
    other = [digit for digit in "0123456789" if digit != text[position]]
    changed = text[:position] + other[int(generator.integers(len(other)))] + text[position + 1 :]
    return {**paper, name: replace(paper[name], text=changed)}


def with_exponent(paper: Numbers, name: str, generator: np.random.Generator) -> Numbers:
    """The paper with one number ten times too large or too small."""
    return {
        **paper,
        name: rewritten(
            paper[name], paper[name].value * 10.0 ** (2 * int(generator.integers(2)) - 1)
        ),
    }


def with_rows_exchanged(paper: Numbers, first: str, second: str) -> Numbers:
    """The paper with two rows exchanged, named by what their ids begin with."""
    changed = dict(paper)
    for name in paper:
        if name.startswith(first):
            other = second + name.removeprefix(first)
            for mine, its in ((name, other), (other, name)):
                changed[mine] = replace(
                    paper[mine], text=paper[its].text, decimals=paper[its].decimals
                )
    return changed


def with_points_in_use(paper: Numbers, table: int) -> Numbers:
    """The paper with σs of IGG III-WTLS over the points in use, called that of all."""
    name = f"ou_liu_2017/table{table}/igg3_wtls/sigma_s_m"
    return {**paper, name: paper[f"in use/{name}"]}


def with_wrong_sign(paper: Numbers, generator: np.random.Generator) -> Numbers:
    """The paper with Δr of table 2 from δ with the wrong sign; the unprinted signs are drawn."""
    changed = dict(paper)
    for method in METHODS.values():
        one = row(paper, 2, method)
        errors = np.array([one[quantity] for quantity in list(SYMBOLS)[:4]]) * (
            2 * generator.integers(2, size=4) - 1
        )
        radius = radius_with_wrong_sign(SPHERE + errors)
        if np.isfinite(radius):
            name = one.ids["abs_delta_r_m"]
            changed[name] = rewritten(paper[name], abs(float(radius) - SPHERE_RADIUS))
    return changed


def with_ten_times_the_error(paper: Numbers, generator: np.random.Generator) -> Numbers:
    """The paper with Δc or Δr of LS in table 1 ten times too large; one of them, and not below a
    millimetre before.
    """
    name = f"ou_liu_2017/table1/ls/abs_delta_{'cr'[int(generator.integers(2))]}_m"
    return {**paper, name: rewritten(paper[name], 10 * max(paper[name].value, 0.001))}


def _any_of(*names: str, place: int) -> Callable[[Numbers, np.random.Generator], Numbers]:
    return lambda paper, generator: with_digit(
        paper, names[int(generator.integers(len(names)))], place, generator
    )


def _exponent_of(*names: str) -> Callable[[Numbers, np.random.Generator], Numbers]:
    return lambda paper, generator: with_exponent(
        paper, names[int(generator.integers(len(names)))], generator
    )


def _numbers(table: int, methods: Iterable[str], quantities: Iterable[str]) -> list[str]:
    samples = [f"{sample}/" for sample in SAMPLES] if table == 3 else [""]
    return [
        f"ou_liu_2017/table{table}/{sample}{m}/{q}"
        for sample in samples
        for m in methods
        for q in quantities
    ]


def _exchanged(
    table: int, first: str, second: str
) -> Callable[[Numbers, np.random.Generator], Numbers]:
    return lambda paper, generator: with_rows_exchanged(
        paper, f"ou_liu_2017/table{table}/{first}/", f"ou_liu_2017/table{table}/{second}/"
    )


_TABLES = [name for name in printed() if "/table" in name]
_PERCENTAGES = [name for name in printed() if "/rel_radius_" in name]
_BOTH, _IGG = ("ls", "tls"), ("igg3_wtls",)
_SIGMAS, _HEIGHT = ("sigma_0", "sigma_s_m"), ("abs_delta_c_m", "abs_delta_r_m")
SLIPS = (
    Slip(
        "first digit of σ0 or σs, LS and TLS, table 1",
        _any_of(*_numbers(1, _BOTH, _SIGMAS), place=0),
        "σ0 against σs",
    ),
    Slip(
        "second digit of the same", _any_of(*_numbers(1, _BOTH, _SIGMAS), place=1), "σ0 against σs"
    ),
    Slip(
        "exponent of σ0 or σs, LS, table 1",
        _exponent_of(*_numbers(1, ["ls"], _SIGMAS)),
        "σ0 against σs",
    ),
    Slip(
        "exponent of σ0 or σs, LS, table 2",
        _exponent_of(*_numbers(2, ["ls"], _SIGMAS)),
        "σ0 against σs",
    ),
    Slip(
        "exponent of σ0, LS and TLS, table 3",
        _exponent_of(*_numbers(3, _BOTH, ["sigma_0"])),
        "σ0 of scans",
    ),
    Slip(
        "exponent of σ0, IGG III-WTLS, table 3",
        _exponent_of(*_numbers(3, _IGG, ["sigma_0"])),
        "unit weight of scans",
    ),
    Slip(
        "rows of LS and TLS exchanged, table 2",
        _exchanged(2, "ls", "tls"),
        "least squares is least",
    ),
    Slip("rows of LS and IGG III-WTLS exchanged, table 1", _exchanged(1, "ls", "igg3_wtls")),
    Slip("rows of LS and IGG III-WTLS exchanged, table 2", _exchanged(2, "ls", "igg3_wtls")),
    Slip(
        "σs over the points in use, table 2",
        lambda paper, _: with_points_in_use(paper, 2),
        "σs over all points",
    ),
    Slip("Δc or Δr ten times too large, LS, table 1", with_ten_times_the_error, "Δr follows Δk"),
    Slip(
        "first digit of Δc or Δr, LS, table 2",
        _any_of(*_numbers(2, ["ls"], _HEIGHT), place=0),
        "gross residuals",
    ),
    Slip("Δr from δ with the wrong sign, table 2", with_wrong_sign, "sphere between points"),
    Slip(
        "first digit of b or c, LS or TLS, table 3",
        _any_of(*_numbers(3, _BOTH, ("b_m", "c_m")), place=0),
        "centres of scans",
    ),
    Slip(
        "second digit of the same",
        _any_of(*_numbers(3, _BOTH, ("b_m", "c_m")), place=1),
        "centres of scans",
    ),
    Slip(
        "last digit of the same",
        _any_of(*_numbers(3, _BOTH, ("b_m", "c_m")), place=9),
        "only difference",
    ),
    Slip(
        "first digit of |Δr|, table 3",
        _any_of(*_numbers(3, METHODS.values(), ["abs_delta_r_m"]), place=0),
        "radius errors",
    ),
    Slip(
        "second digit of r, table 3",
        _any_of(*_numbers(3, METHODS.values(), ["r_m"]), place=1),
        "radius errors",
    ),
    Slip("first digit of a percentage", _any_of(*_PERCENTAGES, place=0), "percentages"),
    Slip("first digit of any number of the tables", _any_of(*_TABLES, place=0)),
    Slip("second digit of any number of the tables", _any_of(*_TABLES, place=1)),
    Slip("third digit of any number of the tables", _any_of(*_TABLES, place=2)),
)


def detection_rates(papers: list[Numbers], seed: int) -> pd.DataFrame:
    """Each slip planted once in every paper: the share in percent that the check which claims it
    finds, and that any check finds.

    Columns: ``slip``, ``check`` (which claims to find it, empty if none does), ``papers``,
    ``by it``, ``by any``.
    """
    rows = []
    for slip, child in zip(SLIPS, np.random.SeedSequence(seed).spawn(len(SLIPS)), strict=True):
        generator = np.random.default_rng(child)
        wrong = [slip.plant(paper, generator) for paper in papers]
        found = np.array([[not _holds(name, paper) for name in CHECKS] for paper in wrong])
        own = 100 * found[:, list(CHECKS).index(slip.check)].mean() if slip.check else np.nan
        any_check = 100 * found.any(axis=1).mean()
        rows.append(
            {
                "slip": slip.name,
                "check": slip.check or "",
                "papers": len(papers),
                "by it": own,
                "by any": any_check,
            }
        )
    return pd.DataFrame(rows)
