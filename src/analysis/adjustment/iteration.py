"""Iterate over a stack of problems until each has ended, and say how it ended."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any, Self, TypeVar

import numpy as np

from .linalg import solve
from .problem import EIVProblem
from .steps import derivatives

# relative step below which a step that no longer shrinks is rounding and not divergence
ROUNDING = 1e-11
# relative Newton step above which Φ is not at its minimum, however small the steps have become
FLAT = 0.01


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
    """Base of dataclasses whose fields are arrays with one leading axis, that of the problems.

    A mask or an index over that axis selects from, or writes to, all of them together.
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
    """End of the iterations over a stack of problems.

    iterations, converged, stop_reason : (…) number, whether it has converged, a sentence
    """

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

    Parameters
    ----------
    problem : anything that a mask over the leading axis selects from
    state : a :class:`Stack` with that leading axis (B, …)
    advance : gives the next state and the problems (B,) bool that each ending applies to; where
        several do, the first
    tolerance : what the sentence of the ending names, where it does

    A problem that has ended is left as it is and costs nothing more, so that it comes out the same
    in a stack of any size.
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


@dataclass(frozen=True)
class _Step(Stack):
    """x (B, m) and the length (B,) of the step that led there."""

    x: np.ndarray
    length: np.ndarray


def iterate_to_convergence(
    problem: EIVProblem,
    x: np.ndarray,
    step: Callable[[EIVProblem, np.ndarray], np.ndarray],
    tolerance: float,
    max_iterations: int,
    watch: Callable[[np.ndarray], None] | None = None,
) -> tuple[np.ndarray, Convergence]:
    """Repeat ``x ← step(problem, x)`` for a stack x (B, m) until ``|Δx| ≤ tolerance·|x|``.

    A step that is down at rounding level and no longer shrinks ends it as converged, too.
    ``watch`` is called with every x.
    """

    def advance(problem: EIVProblem, state: _Step):
        new = step(problem, state.x)
        if watch is not None:
            watch(new)
        length, size = np.linalg.norm(new - state.x, axis=-1), np.linalg.norm(new, axis=-1)
        lost = ~np.isfinite(length)
        return _Step(np.where(lost[:, None], state.x, new), length), {
            Ending.SINGULAR: lost,
            Ending.SMALL_STEP: length <= tolerance * size,
            Ending.ROUNDING: (length >= state.length) & (length <= ROUNDING * size),
        }

    start = _Step(x, np.full(len(x), np.inf))
    # a lost problem is reported by its ending
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        state, convergence = iterate(problem, start, advance, max_iterations, tolerance)
    return state.x, convergence


@np.errstate(divide="ignore", invalid="ignore", over="ignore")  # what was lost has been reported
def only_minima(problem: EIVProblem, x: np.ndarray, convergence: Convergence) -> Convergence:
    """Mark as not converged every solution that is not a minimum of Φ.

    With errors as large as the columns an iteration can end at a saddle, where the Hessian has a
    negative eigenvalue, or run off to where Φ is flat: there its steps are small, but Newton's is
    not.
    """
    _, gradient, hessian = derivatives(problem, x)
    fine = np.isfinite(hessian).all(axis=(-1, -2))
    eigenvalues = np.linalg.eigvalsh(np.where(fine[..., None, None], hessian, 0.0))
    saddle = eigenvalues[..., 0] < -1e-10 * eigenvalues[..., -1]
    left = np.linalg.norm(solve(hessian, gradient[..., None])[..., 0], axis=-1)
    flat = left > FLAT * np.linalg.norm(x, axis=-1)
    at_saddle = convergence.failed_where(convergence.converged & saddle, Ending.SADDLE.sentence)
    return at_saddle.failed_where(at_saddle.converged & flat, Ending.FLAT.sentence)
