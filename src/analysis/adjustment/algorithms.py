"""The named algorithms for weighted total least squares. Tables and figures iterate over them.

A new algorithm is one function and one line here: a step ``(problem, x) → x⁺`` in ``steps.py``
wrapped in
:func:`~analysis.adjustment.iteration.solved`, or anything else that is called alike.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from .iteration import solved
from .quasi_newton import bfgs, dfp, minimised
from .steps import (
    amiri_simkooei_step,
    fang_step,
    mahboub_step,
    newton_step,
    schaffrin_wieser_step,
    shen_step,
)


@dataclass(frozen=True)
class Algorithm:
    """What tables call it, who described it, the colour it has in every figure, what computes it.

    ``function(problem, x, tolerance=, max_iterations=, watch=)`` takes a stack of problems and
    starting values (B, m), and gives the solutions and an
    :class:`~analysis.adjustment.iteration.Ended`; one that ``takes_H_0`` also takes inverse
    Hessians of Φ/2 to begin with.
    """

    label: str
    source: str
    colour: str
    function: Callable
    takes_H_0: bool = False


# Colours: Okabe & Ito's eight, which colour-blind readers can tell apart.
ALGORITHMS: dict[str, Algorithm] = {
    "newton": Algorithm("Newton", "Fang 2013", "#000000", partial(solved, step=newton_step)),
    "bfgs": Algorithm(
        "BFGS",
        "Wu, Chen & Wang; Nocedal & Wright 2006",
        "#D55E00",
        partial(minimised, update=bfgs),
        takes_H_0=True,
    ),
    "dfp": Algorithm(
        "DFP",
        "Davidon 1959; Fletcher & Powell 1963",
        "#E69F00",
        partial(minimised, update=dfp),
        takes_H_0=True,
    ),
    "schaffrin_wieser": Algorithm(
        "Schaffrin-Wieser",
        "Schaffrin & Wieser 2008",
        "#0072B2",
        partial(solved, step=schaffrin_wieser_step),
    ),
    "shen": Algorithm(
        "Shen, Li & Chen",
        "Shen, Li & Chen 2011; Neitzel 2010",
        "#56B4E9",
        partial(solved, step=shen_step),
    ),
    "amiri_simkooei": Algorithm(
        "Amiri-Simkooei & Jazaeri",
        "Amiri-Simkooei & Jazaeri 2012",
        "#009E73",
        partial(solved, step=amiri_simkooei_step),
    ),
    "fang": Algorithm("Fang", "Fang 2013, algorithm 1", "#CC79A7", partial(solved, step=fang_step)),
    "mahboub": Algorithm("Mahboub", "Mahboub 2012", "#999999", partial(solved, step=mahboub_step)),
}
