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


def _step(label: str, source: str, colour: str, step: Callable) -> Algorithm:
    return Algorithm(label, source, colour, partial(iterate_to_convergence, step=step))


def _quasi_newton(label: str, source: str, colour: str, update: Callable) -> Algorithm:
    return Algorithm(label, source, colour, partial(minimise, update=update), takes_H_0=True)


# Colours: Okabe & Ito's eight, which colour-blind readers can tell apart.
ALGORITHMS: dict[str, Algorithm] = {
    "newton": _step("Newton", "Fang 2013", "#000000", newton_step),
    "bfgs": _quasi_newton("BFGS", "Wu, Chen & Wang; Nocedal & Wright 2006", "#D55E00", bfgs),
    "dfp": _quasi_newton("DFP", "Davidon 1959; Fletcher & Powell 1963", "#E69F00", dfp),
    "schaffrin_wieser": _step(
        "Schaffrin-Wieser", "Schaffrin & Wieser 2008", "#0072B2", schaffrin_wieser_step
    ),
    "shen": _step("Shen, Li & Chen", "Shen, Li & Chen 2011; Neitzel 2010", "#56B4E9", shen_step),
    "amiri_simkooei": _step(
        "Amiri-Simkooei & Jazaeri", "Amiri-Simkooei & Jazaeri 2012", "#009E73", amiri_simkooei_step
    ),
    "fang": _step("Fang", "Fang 2013, algorithm 1", "#CC79A7", fang_step),
    "mahboub": _step("Mahboub", "Mahboub 2012", "#999999", mahboub_step),
}
