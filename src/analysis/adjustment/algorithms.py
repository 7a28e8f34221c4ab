"""The named algorithms for weighted total least squares. Tables and figures iterate over them.

A new algorithm is one function and one line here: a step ``(problem, x) → x⁺`` in ``steps.py``,
or anything that is called like :func:`~analysis.adjustment.steps.iterate_to_convergence`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from .quasi_newton import bfgs, dfp, minimise
from .steps import (
    amiri_simkooei_step,
    fang_step,
    iterate_to_convergence,
    mahboub_step,
    newton_step,
    schaffrin_wieser_step,
    shen_step,
)


@dataclass(frozen=True)
class Algorithm:
    """An algorithm: its name in tables, its source, its colour in figures, its function.

    ``function(problem, x, tolerance=, max_iterations=, watch=)`` takes a stack of problems and
    starting values (B, m), and gives the solutions and a
    :class:`~analysis.adjustment.iteration.Convergence`; one that ``takes_H_0`` also takes inverse
    Hessians of Φ/2 to begin with.
    """

    label: str
    source: str
    colour: str
    function: Callable
    takes_H_0: bool = False


def _repeating(step: Callable) -> Callable:
    """The algorithm that repeats a step of :mod:`~analysis.adjustment.steps`."""
    return partial(iterate_to_convergence, step=step)


# Colours: Okabe & Ito's eight, which colour-blind readers can tell apart.
ALGORITHMS: dict[str, Algorithm] = {
    "newton": Algorithm("Newton", "Fang 2013", "#000000", _repeating(newton_step)),
    "bfgs": Algorithm(
        "BFGS",
        "Wu, Chen & Wang; Nocedal & Wright 2006",
        "#D55E00",
        partial(minimise, update=bfgs),
        takes_H_0=True,
    ),
    "dfp": Algorithm(
        "DFP",
        "Davidon 1959; Fletcher & Powell 1963",
        "#E69F00",
        partial(minimise, update=dfp),
        takes_H_0=True,
    ),
    "schaffrin_wieser": Algorithm(
        "Schaffrin-Wieser", "Schaffrin & Wieser 2008", "#0072B2", _repeating(schaffrin_wieser_step)
    ),
    "shen": Algorithm(
        "Shen, Li & Chen", "Shen, Li & Chen 2011; Neitzel 2010", "#56B4E9", _repeating(shen_step)
    ),
    "amiri_simkooei": Algorithm(
        "Amiri-Simkooei & Jazaeri",
        "Amiri-Simkooei & Jazaeri 2012",
        "#009E73",
        _repeating(amiri_simkooei_step),
    ),
    "fang": Algorithm("Fang", "Fang 2013, algorithm 1", "#CC79A7", _repeating(fang_step)),
    "mahboub": Algorithm("Mahboub", "Mahboub 2012", "#999999", _repeating(mahboub_step)),
}
