"""Iterate over a stack of problems until each has ended, and say how it ended."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any, Self, TypeVar

import numpy as np

# relative step below which a step that no longer shrinks is rounding and not divergence
ROUNDING = 1e-11


class Ending(Enum):
    """End of an iteration: whether it has converged, and the sentence that says so."""

    MAX_ITERATIONS = False, "not converged: still moving after {max_iterations} iterations"
    SINGULAR = False, "not converged: the normal equations became singular"
    NOT_FINITE = False, "not converged: Φ or its gradient is not finite"
    NO_DESCENT = False, "not converged: no lower Φ was found along the direction of search"
    SADDLE = False, "not converged: ended where Φ is stationary, but at no minimum"
    FLAT = False, "not converged: ended where Φ is flat, but at no minimum"
    TOO_FEW_POINTS = False, "not converged: too few points kept a weight to determine the surface"
    NO_ELLIPSE = False, "not converged: the points in use determine no ellipse"
    SMALL_STEP = True, "the relative step fell below {tolerance:g}"
    SMALL_PRINTED_STEP = True, "the step in the printed parameters fell below {tolerance:g}"
    ROUNDING = True, "the step reached rounding level"
    PARAMETERS = True, "the parameters stand still"
    PARAMETERS_AND_SCALE = True, "parameters and scale stand still"
    PARAMETERS_AND_WEIGHTS = True, "parameters and weights stand still"
    ELLIPSE = True, "the ellipse stands still"

    def __init__(self, converged: bool, sentence: str):
        self.converged = converged
        self.sentence = sentence


@dataclass(frozen=True)
class Stack:
    """Base of dataclasses whose fields all have one leading axis, that of the problems.

    A mask or an index over it selects from, or writes to, all of them together.
    """

    def __len__(self) -> int:
        return len(next(iter(vars(self).values())))

    def __getitem__(self, keep) -> Self:
        return type(self)(**{name: values[keep] for name, values in vars(self).items()})

    def __setitem__(self, keep, part: Self) -> None:
        for name, values in vars(self).items():
            values[keep] = getattr(part, name)


@dataclass(frozen=True)
class Convergence:
    """End of the iterations over a stack: their number, whether they converged, a sentence."""

    iterations: np.ndarray
    converged: np.ndarray
    stop_reason: np.ndarray

    @classmethod
    def closed_form(cls, count: int) -> Convergence:
        """That of ``count`` problems that took no iteration."""
        reason = np.full(count, "solved in closed form", dtype=object)
        return cls(np.zeros(count, dtype=int), np.ones(count, dtype=bool), reason)

    def reshape(self, lead: tuple[int, ...]) -> Convergence:
        """That of a stack (B,) in the leading axes of its problems."""
        return Convergence(**{name: values.reshape(lead) for name, values in vars(self).items()})

    def failed_where(self, wrong: np.ndarray, reason: str) -> Convergence:
        """Not converged, for this reason, where ``wrong``; else unchanged."""
        return replace(
            self,
            converged=self.converged & ~wrong,
            stop_reason=np.where(wrong, reason, self.stop_reason),
        )


State = TypeVar("State", bound=Stack)


def iterate(
    problem: Any,
    state: State,
    advance: Callable[[Any, State], tuple[State, dict[Ending, np.ndarray]]],
    max_iterations: int,
    tolerance: float | None = None,
) -> tuple[State, Convergence]:
    """Repeat ``state, endings = advance(problem, state)`` until each problem of a stack has ended.

    problem : anything that a mask over the leading axis selects from
    state : a :class:`Stack` with that leading axis (B, …)
    advance : gives the next state and the problems (B,) bool that each ending applies to; where
        several do, the first
    tolerance : what the sentence of the ending names, where it does

    A problem that has ended is left as it is, so that it comes out the same in a stack of any size.
    """
    count = len(state)
    # Made when the first of several has ended: a single state, which may be large, is not doubled.
    final: State | None = None
    active = np.arange(count)
    iterations = np.full(count, max_iterations)
    ending = np.full(count, Ending.MAX_ITERATIONS, dtype=object)
    for iteration in range(1, max_iterations + 1):
        state, endings = advance(problem, state)
        stopped = np.any(list(endings.values()), axis=0) | (iteration == max_iterations)
        if stopped.any():
            # 1. say how and when
            ended = active[stopped]
            iterations[ended] = iteration
            for one, mask in reversed(endings.items()):  # so that the first comes last, and stays
                ending[active[mask]] = one
            # 2. set aside what has ended, and go on with the others
            if len(ended) == count:
                break
            if final is None:
                final = type(state)(**{k: np.empty_like(v) for k, v in vars(state).items()})
            final[ended] = state[stopped]
            active = active[~stopped]
            if not len(active):
                break
            problem, state = problem[~stopped], state[~stopped]
    sentences = {
        one: one.sentence.format(max_iterations=max_iterations, tolerance=tolerance)
        for one in set(ending)
    }
    return state if final is None else final, Convergence(
        iterations,
        np.array([one.converged for one in ending], dtype=bool),
        np.array([sentences[one] for one in ending], dtype=object),
    )
