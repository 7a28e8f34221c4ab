"""Iteration of a stack: each problem ends by itself, with the sentence of its ending."""

from dataclasses import dataclass

import numpy as np

from analysis.adjustment.iteration import Convergence, Ending, Stack, iterate


@dataclass(frozen=True)
class Countdown(Stack):
    left: np.ndarray
    steps: np.ndarray


@dataclass(frozen=True)
class Rate(Stack):
    rate: np.ndarray


def advance(problem, state):
    left = state.left - problem.rate
    return Countdown(left, state.steps + 1), {
        Ending.NOT_FINITE: np.isnan(left),
        Ending.SMALL_STEP: left <= 0,
        Ending.ROUNDING: left <= 1,
    }


def count_down(left, rate, max_iterations=10):
    start = Countdown(np.array(left, dtype=float), np.zeros(len(left), dtype=int))
    return iterate(Rate(np.array(rate, dtype=float)), start, advance, max_iterations, 1e-3)


def test_each_problem_ends_with_the_first_ending_that_applies():
    end, convergence = count_down([4.0, 3.0, 50.0, np.nan], [2.0, 1.0, 1.0, 1.0])
    assert convergence.iterations.tolist() == [2, 2, 10, 1]
    assert convergence.converged.tolist() == [True, True, False, False]
    assert convergence.stop_reason.tolist() == [
        "the relative step fell below 0.001",
        "the step reached rounding level",
        "not converged: still moving after 10 iterations",
        "not converged: Φ or its gradient is not finite",
    ]
    np.testing.assert_array_equal(end.left, [0.0, 1.0, 40.0, np.nan])
    np.testing.assert_array_equal(end.steps, convergence.iterations)  # none goes on once ended


def test_a_problem_of_a_stack_comes_out_as_alone():
    left, rate = np.random.default_rng(0).uniform([[1.0], [0.1]], [[9.0], [2.0]], (2, 30))
    stack, of_stack = count_down(left, rate)
    for k in range(30):
        alone, of_one = count_down(left[[k]], rate[[k]])
        assert (alone.left[0], of_one.stop_reason[0]) == (stack.left[k], of_stack.stop_reason[k])


def test_a_selection_takes_all_fields_together():
    state = Countdown(np.arange(4.0), np.arange(4))
    chosen = state[np.array([True, False, False, True])]
    assert len(state) == 4 and len(chosen) == 2
    assert chosen.left.tolist() == [0.0, 3.0] and chosen.steps.tolist() == [0, 3]
    state[np.array([1, 2])] = chosen
    assert state.left.tolist() == [0.0, 0.0, 3.0, 3.0] and state.steps.tolist() == [0, 0, 3, 3]


def test_failing_leaves_the_others():
    before = Convergence.closed_form(3)
    after = before.failed_where(np.array([False, True, False]), "not converged: no")
    assert after.converged.tolist() == [True, False, True]
    assert after.stop_reason.tolist() == [
        "solved in closed form",
        "not converged: no",
        "solved in closed form",
    ]
    assert before.converged.all() and (before.iterations == 0).all()


def test_the_sentence_says_whether_it_has_converged():
    for ending in Ending:
        assert ending.converged != ending.sentence.startswith("not converged: ")
    assert len({ending.sentence for ending in Ending}) == len(Ending)
