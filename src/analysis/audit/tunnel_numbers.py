"""The verdicts on Li and others (2015), whose tables are lost: the campaign is an input of the simulation, its results cannot be checked.

The deformations and what is claimed of them wait for notebooks 08 and 09: replace `waiting` by an evaluator that reads what they write.
"""

from __future__ import annotations

from .judgement import INPUT, NOT_CHECKABLE, Evaluator, always, waiting

PAPER = "li_2015/"
CAMPAIGN, DEFORMATION = "08_tunnel", "09_tunnel"

_NO_SCANS = "the scans are not published"
_INPUTS = (
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
_TEXT: dict[str, Evaluator] = {name: always(INPUT, "a fact of the campaign, taken over into the simulation", CAMPAIGN) for name in _INPUTS}
_TEXT |= {
    "max_deformation": always(INPUT, _NO_SCANS + "; the simulated tunnel is given these deformations", DEFORMATION),
    "scanner_precision": always(NOT_CHECKABLE, "a property of the instrument", CAMPAIGN),
    "scanner_rate": always(NOT_CHECKABLE, "a property of the instrument", CAMPAIGN),
    "scanner_range": always(NOT_CHECKABLE, "a property of the instrument", CAMPAIGN),
    "epochs": always(NOT_CHECKABLE, "a date", CAMPAIGN),
    "registration": waiting(CAMPAIGN),
    "claim_crown_and_sides": always(NOT_CHECKABLE, _NO_SCANS + "; the simulated tunnel moves where it is told to", DEFORMATION),
    "claim_vertical_over_horizontal": always(NOT_CHECKABLE, _NO_SCANS + "; tables 1 and 2, which would show it, are lost", DEFORMATION),
    "claim_stickers": always(NOT_CHECKABLE, "neither the stickers nor their errors are published", CAMPAIGN),
    "claim_every_direction": waiting(DEFORMATION),
}


def evaluators() -> dict[str, Evaluator]:
    """id -> evaluator of every number and claim of the paper."""
    return {PAPER + key: evaluator for key, evaluator in _TEXT.items()}
