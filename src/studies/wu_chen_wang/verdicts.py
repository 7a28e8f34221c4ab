"""The verdicts on Wu, Chen & Wang, whose tables are lost and whose text gives nine results in
numbers.
"""

from __future__ import annotations

from ..printed.judgement import (
    CAUSE,
    CONSISTENT,
    NOT_CHECKABLE,
    Evaluator,
    Judgement,
    Results,
    holds_if,
    refuted_if,
    setting,
    within,
)

PAPER = "wu_chen_wang"
SIMULATION, REAL = "07_plane_simulation", "08_plane_scan"
PRINTED = {  # id -> how notebook 07 names it
    "sim_sigma_s_LS": "sigma_s_ls_cm",
    "sim_sigma_s_TLS": "sigma_s_tls_cm",
    "sim_sigma_s_WTLS": "sigma_s_wtls_cm",
    "sim_sigma0_gain_vs_LS": "gain_vs_ls_percent",
    "sim_sigma0_gain_vs_TLS": "gain_vs_tls_percent",
}
_THREE = (
    "σ0 is a vertical residual for LS, orthogonal for TLS, at perpendicular "
    "incidence for WTLS; true planes show the same gain"
)
_OUTSIDE = "outside what the recovered patch and σ give"
_FITTED = "; the size of the patch and σ, which are not printed, were found from the five results"
_PLACE = (
    "the points are not published; height and range of the scanner follow from the "
    "two gains, and scans from there have both"
)
_NOISE = (
    "neither the points nor the scanner are known; one of the usual precision gives the same size"
)
SCANNED = {  # id -> how notebook 08 names it, and why it proves nothing that scans of ours are near
    "real_sigma0_gain_vs_LS": ("gain_vs_ls_percent", _PLACE),
    "real_sigma0_gain_vs_TLS": ("gain_vs_tls_percent", _PLACE),
    "real_sigma_s": ("sigma_s_mm", _NOISE),
}


def of_scan(number, results: Results) -> Judgement:
    """A number of the ground scan, beside scans from where the gains say that the scanner stood;
    not checkable, they assume too much.
    """
    name, why = SCANNED[number.key]
    interval = {
        end: results.one(f"{REAL}_printed", end, quantity=name)
        for end in ("median", "lower", "upper")
    }
    return Judgement(NOT_CHECKABLE, why, REAL, **interval)


def order(number, results: Results) -> Judgement:
    """The printed order of the methods: consistent if more than half of the simulated experiments
    have it in all parameters.
    """
    share = results.one(f"{SIMULATION}_order", "WTLS, TLS, LS/%", parameter="all")
    if share > 50:
        why = (
            "most experiments have this order, but only against pure TLS; mixed LS-TLS is "
            "closer than WTLS"
        )
        return Judgement(CONSISTENT, why, SIMULATION)
    return Judgement(CAUSE, "most experiments have another order", SIMULATION)


def _gain_without_merit(results: Results) -> bool:
    """Exactly true planes from every method would give at least the printed gain over LS, within
    five percent.
    """
    return results.one(f"{SIMULATION}_meanings", "gain_true_plane_percent", method="LS") > 78


def _exact_column_helps(results: Results) -> bool:
    """Mixed LS-TLS, whose column of ones is exact, is closer in b than pure TLS, on the small patch
    and on the large one.
    """
    frame = results[f"{SIMULATION}_errors"].set_index(["side_m", "variant"])["median_b"]
    return all(frame[side, "mixed_ls_tls"] < frame[side, "tls"] for side in frame.index.levels[0])


def _planes_are_close(results: Results) -> bool:
    """On the simulated scan the normals of all three are equally good, within five percent."""
    names = ("LS", "TLS (pure SVD)", "WTLS, raw cosines")
    angles = [
        results.one(f"{REAL}_accuracy", "angle_mrad", method=name, scene="clean") for name in names
    ]
    return max(angles) < 1.05 * min(angles)


def _gradients_suffice(results: Results) -> bool:
    """BFGS ends where Newton does."""
    frame = results[f"{REAL}_convergence"]
    ends = frame[frame["run"] == "bfgs"].groupby("problem")["excess"].last()
    return bool((ends.abs() < 1e-9).all())


_TEXT: dict[str, Evaluator] = {
    "plane_true": setting(SIMULATION, "the plane that is simulated"),
    "n_points": setting(SIMULATION),
    "n_runs": setting(SIMULATION),
    "noise": setting(
        SIMULATION,
        "taken over; σ and the extent of the patch are not printed, but follow from the results",
    ),
    **{
        name: within(f"{SIMULATION}_five", _OUTSIDE, SIMULATION, {"quantity": row}, _FITTED)
        for name, row in PRINTED.items()
    },
    "parameter_order": order,
    **{name: of_scan for name in SCANNED},
    "claim_sim_best": refuted_if(
        _gain_without_merit,
        f"σs of WTLS and TLS is printed equal, so it rests on σ0: {_THREE}",
        SIMULATION,
    ),
    "claim_real_close": holds_if(
        _planes_are_close, "on a simulated scan from there all find the same plane", REAL
    ),
    "claim_real_best": refuted_if(
        _planes_are_close, f"σs of all is printed equal, so it rests on σ0: {_THREE}", REAL
    ),
    "claim_no_second_derivatives": holds_if(
        _gradients_suffice, "BFGS ends where Newton's method with the exact Hessian does", REAL
    ),
    "claim_constant_column": holds_if(
        _exact_column_helps, "mixed LS-TLS is closer to the truth than pure TLS", SIMULATION
    ),
}


def evaluators() -> dict[str, Evaluator]:
    """id -> evaluator of every number and claim of the paper."""
    return {f"{PAPER}/{key}": evaluator for key, evaluator in _TEXT.items()}
