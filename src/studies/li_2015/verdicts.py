"""Verdicts on the numbers of Li and others (2015), whose tables are lost.

Facts of the campaign are settings of the simulation; its results cannot be checked. The simulated
tunnel has the printed deformations; notebooks 09 and 10 show how well scanning, registration and
ellipses recover them.
"""

from __future__ import annotations

import math

from ..printed.judgement import (
    CAUSE,
    CONSISTENT,
    NOT_CHECKABLE,
    REPRODUCED,
    Evaluator,
    Judgement,
    Results,
    always,
    refuted_if,
    setting,
)
from ..printed.numbers import statements

PAPER = "li_2015"
CAMPAIGN, DEFORMATION = "09_tunnel_campaign", "10_tunnel_deformation"

_NO_SCANS = "the scans are not published"
_SETTINGS = (
    "tunnel_length",
    "section_spacing",
    "stations_epoch_1",
    "stations_epoch_2",
    "points_per_station",
    "targets",
    "targets_least",
    "similarity_parameters",
    "axis_step",
    "analysed_length",
    "threshold_1",
    "threshold_2",
    "section_thickness",
    "half_thickness",
    "alpha_range",
)


def largest_deformations(number, results: Results) -> Judgement:
    """The printed maxima: they are the truth of the simulation, so only recovery can be judged."""
    recovery = results[f"{DEFORMATION}_recovery"].set_index("case")["largest_rms_mm"]
    scans, singly, jointly = (
        recovery[case].max()
        for case in ("noise alone", "stations registered singly", "joint adjustment")
    )
    registered = f"with stations registered singly to {singly:.1f} mm, jointly to {jointly:.1f} mm"
    given = "given to the simulated tunnel and found again"
    why = f"{_NO_SCANS}; {given} to {scans:.1f} mm, {registered}"
    return Judgement(NOT_CHECKABLE, why, DEFORMATION)


def joints(number, results: Results) -> Judgement:
    """The error between neighbouring stations: printed as a limit, in simulation a deviation."""
    found = results[f"{CAMPAIGN}_joints"]
    within, coordinate = found["within_percent"].mean(), found["stated_mm"].mean() / math.sqrt(3)
    if within > 95:
        why = "so it is nearly everywhere on the wall between simulated stations"
        return Judgement(REPRODUCED, why, CAMPAIGN)
    near = f"simulated stations are so near at {within:.0f} % of the wall between them"
    why = f"{near}: {coordinate:.1f} mm is their standard deviation"
    return Judgement(CAUSE, why, CAMPAIGN)


def stickers(number, results: Results) -> Judgement:
    """The stickers against the 6 mm of the code, in the simulated campaign."""
    accuracy = results[f"{CAMPAIGN}_accuracy"]
    highest = accuracy.loc[accuracy["coordinate"] == "point", "high_mm"].max()
    if highest < statements(PAPER)[f"{PAPER}/threshold_1"].value:
        common = "but what the stickers of a station have in common they do not show"
        why = f"so do simulated ones, {highest:.1f} mm at most; {common}"
        return Judgement(CONSISTENT, why, CAMPAIGN)
    return Judgement(CAUSE, "simulated ones do not", CAMPAIGN)


def _a_dent_is_hidden(results: Results) -> bool:
    """Whether the ellipses show less than half of the dent where it is deepest."""
    dent = results[f"{DEFORMATION}_hidden"]
    deepest = dent.loc[dent["true_mm"].idxmin()]
    return abs(deepest["ellipse_mm"]) < 0.5 * abs(deepest["true_mm"])


_TEXT: dict[str, Evaluator] = {
    name: setting(CAMPAIGN, "a fact of the campaign, taken over into the simulation")
    for name in _SETTINGS
}
_TEXT |= {
    "max_deformation": largest_deformations,
    "scanner_precision": always(NOT_CHECKABLE, "a property of the instrument", CAMPAIGN),
    "scanner_rate": always(NOT_CHECKABLE, "a property of the instrument", CAMPAIGN),
    "scanner_range": always(NOT_CHECKABLE, "a property of the instrument", CAMPAIGN),
    "epochs": always(NOT_CHECKABLE, "a date", CAMPAIGN),
    "registration": joints,
    "claim_crown_and_sides": always(
        NOT_CHECKABLE, _NO_SCANS + "; the simulated tunnel moves where it is told to", DEFORMATION
    ),
    "claim_vertical_over_horizontal": always(
        NOT_CHECKABLE, _NO_SCANS + "; tables 1 and 2, which would show it, are lost", DEFORMATION
    ),
    "claim_stickers": stickers,
    "claim_every_direction": refuted_if(
        _a_dent_is_hidden,
        "true of what an ellipse can follow, away from the track bed: "
        "a dent stays hidden in its residuals",
        DEFORMATION,
    ),
}


def evaluators() -> dict[str, Evaluator]:
    """id -> evaluator of every number and claim of the paper."""
    return {f"{PAPER}/{key}": evaluator for key, evaluator in _TEXT.items()}
