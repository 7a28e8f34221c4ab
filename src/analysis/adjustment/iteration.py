"""Iterate over a stack of problems until each has ended, and say how it ended."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from .linalg import solve
from .problem import EIVProblem
from .steps import derivatives

# relative step below which a step that no longer shrinks is rounding and not divergence
ROUNDING = 1e-11
# relative Newton step above which Φ is not at its minimum, however small the steps have become
FLAT = 0.01
ENDED = ("iterations", "converged", "stop_reason")


@dataclass(frozen=True)
class Ended:
    """How the iterations over a stack of B problems ended: the last state, and (B,) iterations,
    converged, stop_reason.
    """

    state: tuple[np.ndarray, ...]
    iterations: np.ndarray
    converged: np.ndarray
    stop_reason: np.ndarray


def iterate(
    problem,
    state: tuple[np.ndarray, ...],
    advance: Callable,
    endings: list[tuple[bool, str]],
    max_iterations: int,
) -> Ended:
    """Repeat ``state, ending = advance(problem, state)`` for every problem of a stack until it has
    ended.

    problem : anything that a mask over the leading axis selects from
    state : arrays with that leading axis (B, …)
    advance : gives the next state and, for each problem, 0 to go on or the 1-based number of an
        ending
    endings : (converged, sentence) of each ending

    A problem that has ended is left as it is and costs nothing more, so that it comes out the same
    in a stack of any size.
    """
    count = len(state[0])
    # made when one of several has ended: a single problem, which may be large, is never there twice
    final = None
    active = np.arange(count)
    iterations = np.full(count, max_iterations)
    ending = np.zeros(count, dtype=int)
    for iteration in range(1, max_iterations + 1):
        state, now = advance(problem, state)
        stopped = (now > 0) | (iteration == max_iterations)
        if stopped.any():
            ended = active[stopped]
            iterations[ended] = iteration
            ending[ended] = now[stopped]
            if len(ended) == count:
                final = state
                break
            if final is None:
                final = tuple(np.empty_like(array) for array in state)
            for whole, part in zip(final, state, strict=True):
                whole[ended] = part[stopped]
            keep = ~stopped
            active = active[keep]
            if not len(active):
                break
            problem, state = problem[keep], tuple(part[keep] for part in state)
    known = [(False, f"not converged: still moving after {max_iterations} iterations"), *endings]
    converged = np.array([one[0] for one in known])[ending]
    return Ended(
        final, iterations, converged, np.array([one[1] for one in known], dtype=object)[ending]
    )


def solved(
    problem: EIVProblem,
    x: np.ndarray,
    step: Callable,
    tolerance: float,
    max_iterations: int,
    watch: Callable | None = None,
) -> tuple[np.ndarray, Ended]:
    """Repeat ``x ← step(problem, x)`` for a stack x (B, m) until ``|Δx| ≤ tolerance·|x|``.

    A step that is down at rounding level and does not shrink any more ends it as converged, too.
    ``watch`` is called with every x.
    """

    def advance(problem, state):
        x, last = state
        new = step(problem, x)
        if watch is not None:
            watch(new)
        length, size = np.linalg.norm(new - x, axis=-1), np.linalg.norm(new, axis=-1)
        lost = ~np.isfinite(length)
        stalled = (length >= last) & (length <= ROUNDING * size)
        ending = np.select([lost, length <= tolerance * size, stalled], [1, 2, 3], 0)
        return (np.where(lost[:, None], x, new), length), ending

    endings = [
        (False, "not converged: the normal equations became singular"),
        (True, f"the relative step fell below {tolerance:g}"),
        (True, "the step reached rounding level"),
    ]
    # a lost problem is reported by its ending
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        ended = iterate(problem, (x, np.full(len(x), np.inf)), advance, endings, max_iterations)
    return ended.state[0], ended


@np.errstate(divide="ignore", invalid="ignore", over="ignore")  # what was lost has been reported
def only_minima(problem: EIVProblem, x: np.ndarray, ended: Ended) -> Ended:
    """Take back the convergence of what is no minimum of Φ.

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
    reason = np.where(
        flat, "not converged: ended where Φ is flat, but at no minimum", ended.stop_reason
    )
    reason = np.where(
        saddle, "not converged: ended where Φ is stationary, but at no minimum", reason
    )
    wrong = ended.converged & (saddle | flat)
    return replace(
        ended,
        converged=ended.converged & ~wrong,
        stop_reason=np.where(wrong, reason, ended.stop_reason),
    )
