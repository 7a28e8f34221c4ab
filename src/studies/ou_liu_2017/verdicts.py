"""The verdicts on Ou & Liu (2017): tables 1 to 3 by redraws and checks, the text by what the
notebooks found.
"""

from __future__ import annotations

from dataclasses import replace

from ..printed.judgement import (
    IMPOSSIBLE,
    NOT_CHECKABLE,
    REPRODUCED,
    Evaluator,
    Judgement,
    Results,
    from_comparison,
    holds_if,
    refuted_if,
    setting,
)
from ..printed.numbers import PrintedNumber, statements
from . import table3
from .causes import CAUSES
from .checks import violated
from .clouds import SPHERE_RADIUS
from .printed_tables import PAPER, all_numbers, printed, row

# The numbers that a violated check blames, where it judges several: those that the redraws do
# not give either, or that others outvote, or that alone could mend it. Why is said by
# `causes.CAUSES` and `table3.CAUSES`.
TO_BLAME = {
    "table2/ls/abs_delta_r_m": "gross residuals",
    "table2/tls/abs_delta_a_m": "least σ0",
    "table2/tls/abs_delta_r_m": "least σ0",
    "table2/tls/sigma_0": "least σ0",
    "table2/igg3_wtls/abs_delta_r_m": "sphere between points",
    "table3/I/ls/b_m": "centres of scans",
    "table3/I/ls/sigma_0": "σ0 of scans",
    "table3/I/tls/sigma_0": "σ0 of scans",
    "table3/I/igg3_wtls/sigma_s_m": "σs over all points",
    "table3/II/igg3_wtls/sigma_s_m": "σs over all points",
}
_MENDS = (
    "contradicts its own row: the printed sphere leaves a larger one, and no other "
    "number could mend that alone"
)
CENTRES = ("a_m", "b_m", "c_m")


def of_tables(number: PrintedNumber, results: Results) -> Judgement:
    """The judgement on a number of table 1, 2 or 3: by the redraws, unless a check on print is laid
    to it.
    """
    why = cause(number)
    judgement = (
        _of_scans(number, results, why)
        if number.table == 3
        else _of_simulation(number, results, why)
    )
    check = TO_BLAME.get(number.id.removeprefix(f"{PAPER}/"))
    factors = [
        relation.factor
        for name, relation in violated()
        if name == check and number.id in relation.numbers
    ]
    if factors:
        return replace(
            judgement,
            verdict=IMPOSSIBLE,
            why=why,
            notebook="11_audit",
            check=check,
            factor=max(factors),
        )
    return judgement


def cause(number: PrintedNumber) -> str:
    """Why a number of tables 1 to 3 is outside the redraws, or impossible; empty where it is
    neither.
    """
    if number.table == 3:
        return table3.CAUSES.get(
            (number.sample, number.method, number.quantity)
        ) or table3.CAUSES.get((number.method, number.quantity), "")
    if (number.table, number.method, number.quantity) == (2, "tls", "sigma_0"):
        return _MENDS  # inside the redraws all the same
    return CAUSES.get((number.table, number.method, number.quantity), "")


def _of_simulation(number: PrintedNumber, results: Results, why: str) -> Judgement:
    """Tables 1 and 2 by redraws."""
    frame = results[f"03_sphere_tables_table{number.table}"]
    (line,) = frame[
        (frame["method"] == number.method) & (frame["quantity"] == number.quantity)
    ].itertuples()
    return from_comparison(line, why, "03_sphere_tables")


def _of_scans(number: PrintedNumber, results: Results, why: str) -> Judgement:
    """Table 3 by simulated scans, cleaned; the centre of IGG III-WTLS is the truth in them."""
    if number.method == table3.CENTRE_IS_ASSUMED and number.quantity in CENTRES:
        where = "where the target stood is not known; taken as the centre of the simulated scans"
        return Judgement(NOT_CHECKABLE, where, "04_scanned_spheres")
    frame = results["04_scanned_spheres_table3_cleaned"]
    place = (
        (frame["sample"] == number.sample)
        & (frame["method"] == number.method)
        & (frame["quantity"] == number.quantity)
    )
    (line,) = frame[place].itertuples()
    return from_comparison(line, why, "04_scanned_spheres")


def of_percentage(number, results: Results) -> Judgement:
    """A percentage of section 2.2, against table 3."""
    factors = [relation.factor for _, relation in violated() if number.id in relation.numbers]
    if factors:
        return Judgement(
            IMPOSSIBLE, "does not follow from table 3", check="percentages", factor=max(factors)
        )
    return Judgement(REPRODUCED, "100 |Δr|/R of table 3", check="percentages")


def _spread(table: int, variant: str, column: str = "sd_c_mm"):
    return lambda results: results.one(
        f"03_sphere_tables_spread_table{table}", column, variant=variant
    )


def _ten_times(first, second):
    return lambda results: first(results) >= 10 * second(results)


def _igg_scatters_more(results: Results) -> bool:
    """σs of IGG III-WTLS in table 2 is above that of LS in the median of the redraws."""
    igg, ls = (
        results.one("03_sphere_tables_table2", "median", method=m, quantity="sigma_s_m")
        for m in ("igg3_wtls", "ls")
    )
    return igg > ls


def _b_differs(results: Results) -> bool:
    """b of sphere II differs between LS and TLS by what the text says."""
    ls, tls = (row(printed(), 3, method, "II")["b_m"] for method in ("ls", "tls"))
    return abs(abs(tls - ls) - printed()[f"{PAPER}/b_difference_II"].value) < 1e-9


def _many_rounds(results: Results) -> bool:
    return results["02_sphere_methods_readings"]["iterations_literal"].max() > 50


def _all_close(results: Results) -> bool:
    return all(_spread(1, name)(results) < 2 for name in ("LS", "TLS (pure SVD)", "IGG III-WTLS"))


def _origin_decides(results: Results) -> bool:
    """In coordinates moved by 100 m pure TLS stays beside LS."""
    return (
        results.one(
            "02_sphere_methods_origin", "from_ls_m", cloud="gross", method="tls", shift_m=100
        )
        < 0.1
    )


def _ls_tls_agree(results: Results) -> bool:
    frame = results["04_scanned_spheres_table3_measured"]
    return frame.loc[frame["relation"].str.startswith("LS and TLS"), "upper"].max() < 0.2


def _digits_explain(results: Results) -> bool:
    frame = results["01_simulated_sphere_rounding"]
    return abs(frame.loc[frame["step_m"] == 0.01, "sigma_s_ratio"].item() - 1) < 0.05


def _not_cleaned(results: Results) -> bool:
    """σs of LS in table 3 is far above that of simulated scans without foreign points."""
    frame = results["04_scanned_spheres_table3_cleaned"]
    rows = frame[(frame["method"] == "ls") & (frame["quantity"] == "sigma_s_m")]
    return bool((rows["printed"].astype(float) > 2 * rows["upper"]).all())


def _sigma_0_is_an_area(results: Results) -> bool:
    """σ0 of LS in table 1 is 2Rσs, in m²."""
    ls = row(printed(), 1, "ls")
    return abs(ls["sigma_0"] / (2 * SPHERE_RADIUS * ls["sigma_s_m"]) - 1) < 0.02


def _not_the_same_points(results: Results) -> bool:
    return any(name == "σs over all points" for name, _ in violated())


def _some_are_unseen(results: Results) -> bool:
    return (
        results.one("11_audit_gross_errors", "unseen", **{"gross errors": "0 to 3.5 m inside"}) > 10
    )


_SETTINGS = {
    "radius_true": "01_simulated_sphere",
    "n_points": "01_simulated_sphere",
    "square": "01_simulated_sphere",
    "gross_points": "01_simulated_sphere",
    "k0": "02_sphere_methods",
    "k1": "02_sphere_methods",
    "delta0": "02_sphere_methods",
    "radius_nominal": "04_scanned_spheres",
}
_TEXT: dict[str, Evaluator] = {name: setting(notebook) for name, notebook in _SETTINGS.items()}
_TEXT |= {
    "k0_usual": setting("02_sphere_methods", "the range that k0 = 1.5 is taken from"),
    "k1_usual": setting("02_sphere_methods", "the range that k1 = 2.5 is taken from"),
    "b_difference_II": holds_if(
        _b_differs,
        "table 3 has it; that it is the only difference is true once b of sphere I is put right",
        "11_audit",
    ),
    "claim_no_error": refuted_if(
        _some_are_unseen,
        "σ counts the gross errors too, so that one of up to 0.3 m passes for a good point",
        "11_audit",
    ),
    "claim_digits": holds_if(
        _digits_explain,
        "rounding to 0.01 m alone gives σ0 and σs of table 1",
        "01_simulated_sphere",
    ),
    "claim_table1_close": holds_if(
        _all_close,
        "standard deviations below 2 mm for all of them; LS is the most exact",
        "03_sphere_tables",
    ),
    "claim_table1_sigma_0": refuted_if(
        _sigma_0_is_an_area,
        "σ0 of LS and TLS is in m², that of IGG III-WTLS in m: no comparison",
        "01_simulated_sphere",
    ),
    "claim_table2_ls": holds_if(
        _ten_times(_spread(2, "LS"), _spread(1, "LS")),
        "its errors grow from millimetres to decimetres",
        "03_sphere_tables",
    ),
    "claim_table2_tls_worst": refuted_if(
        _origin_decides,
        "true of pure TLS in the printed frame only: moved by 100 m it stays beside LS, "
        "and mixed LS-TLS always does",
        "02_sphere_methods",
    ),
    "claim_table2_tls_reason": holds_if(
        _ten_times(_spread(2, "TLS (pure SVD)"), _spread(2, "mixed LS-TLS")),
        "with the column of ones exact it does not collapse",
        "03_sphere_tables",
    ),
    "claim_table2_detected": holds_if(
        _ten_times(_spread(2, "LS"), _spread(2, "IGG III-WTLS")),
        "it rejects the five and keeps the millimetres; only gross errors below 0.3 m pass",
        "03_sphere_tables",
    ),
    "claim_table2_best": refuted_if(
        _igg_scatters_more,
        "its errors are smallest, but not σs over all points, in most redraws larger "
        "than that of LS, and σ0 has other units",
        "03_sphere_tables",
    ),
    "claim_table3_clean": refuted_if(
        _not_cleaned,
        "σs of LS is far above that of clean scans and its radii are too large, as "
        "points left in off the sphere make them",
        "04_scanned_spheres",
    ),
    "claim_table3_ls_tls": holds_if(
        _ls_tls_agree, "within 0.2 mm on simulated scans", "04_scanned_spheres"
    ),
    "claim_table3_best": refuted_if(
        _not_the_same_points,
        "σs counts the points in use for one method and all for the others, and the σ0 "
        "have other units",
        "04_scanned_spheres",
    ),
    "claim_both_errors": refuted_if(
        lambda results: _spread(2, "WTLS")(results) >= _spread(2, "LS")(results),
        "WTLS without rejection is not better than LS: what helps is the rejection",
        "03_sphere_tables",
    ),
    "claim_more_robust": holds_if(
        _ten_times(_spread(2, "LS"), _spread(2, "IGG III-WTLS")),
        "as table 2 shows; notebook 06 says up to which share",
        "06_robustness",
    ),
    "claim_slow": holds_if(
        _many_rounds, "a hundred rounds and more, where LS needs one", "02_sphere_methods"
    ),
}


def evaluators() -> dict[str, Evaluator]:
    """id -> evaluator of every number and claim of the paper."""
    found: dict[str, Evaluator] = dict.fromkeys(all_numbers(), of_tables)
    percentages = (name for name in statements(PAPER) if name.startswith(f"{PAPER}/rel_radius"))
    found |= dict.fromkeys(percentages, of_percentage)
    return found | {f"{PAPER}/{key}": evaluator for key, evaluator in _TEXT.items()}
