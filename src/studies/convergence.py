"""How the algorithms for weighted total least squares converge: objective against iteration on
three problems.

    plane    one run of the plane paper's simulation, weights from the cosines on its LS plane;
             noise a third of the patch
    sphere   the sphere of Ou & Liu with five gross errors, in the printed frame
    dense    n = 40, all errors of A and y correlated with one another, 160 × 160 cofactors

All start from least squares. The quasi-Newton algorithms run twice: with the Gauss-Newton cofactor
as first inverse Hessian, and with the unit matrix, as Wu, Chen & Wang have it if they follow the
textbook.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.adjustment.algorithms import ALGORITHMS
from analysis.adjustment.wtls import Estimate, wtls
from analysis.methods import fit_plane
from analysis.surfaces.plane_eiv import incidence_cosines

from .ou_liu_2017.clouds import read_sphere_cloud
from .ou_liu_2017.readings import design
from .wu_chen_wang.clouds import read_plane_runs

DENSE_ROWS = 40
SEED = 40
# excess of Φ, relative to the least, at which an algorithm counts as arrived: well above rounding
REACHED = 1e-10
SETTLED = 1e-13  # relative change of Φ below which an iteration moves by rounding only


@dataclass(frozen=True)
class Problem:
    """A, y and the keywords of :func:`analysis.wtls` that give their cofactors; and what it is
    called.
    """

    label: str
    A: NDArray[np.float64]
    y: NDArray[np.float64]
    cofactors: dict = field(repr=False)


def problems() -> dict[str, Problem]:
    """The three problems by name.

    >>> [(name, problem.A.shape) for name, problem in problems().items()]
    [('plane', (100, 3)), ('sphere', (500, 4)), ('dense', (40, 3))]
    """
    return {"plane": plane_problem(read_plane_runs()[0]), "sphere": _sphere(), "dense": _dense()}


# Runs: name -> algorithm, first inverse Hessian, label.
RUNS: dict[str, tuple[str, str, str]] = {
    name: (name, "gauss_newton", one.label) for name, one in ALGORITHMS.items()
} | {
    f"{name}, unit start": (name, "identity", f"{one.label}, unit matrix")
    for name, one in ALGORITHMS.items()
    if one.takes_H_0
}


def study(max_iterations: int = 500) -> pd.DataFrame:
    """Every algorithm on every problem: one row per iteration, number 0 the start, until Φ has
    settled.

    Columns: ``problem``, ``run`` (name in ``RUNS``), ``iteration``; ``evaluations``, how often Φ or
    its derivatives were computed until then; ``excess``, (Φ − Φ_min)/Φ_min.
    """
    frames = []
    for name, problem in problems().items():
        estimates = {run: solved(problem, run, max_iterations) for run in RUNS}
        least = min(float(one.objective) for one in estimates.values())
        for run, one in estimates.items():
            excess = np.maximum(one.history.objective / least - 1.0, 0.0)
            moving = np.flatnonzero(np.abs(np.diff(excess)) > SETTLED)
            kept = slice(moving[-1] + 2)
            steps = {
                "iteration": np.arange(len(excess)),
                "evaluations": np.cumsum(one.history.trials),
                "excess": excess,
            }
            frames.append(
                pd.DataFrame(
                    {"problem": name, "run": run}
                    | {column: values[kept] for column, values in steps.items()}
                )
            )
    return pd.concat(frames, ignore_index=True)


def solved(problem: Problem, run: str, max_iterations: int = 500) -> Estimate:
    """The estimate of one run of ``RUNS``, with its history."""
    algorithm, H_0, _ = RUNS[run]
    return wtls(
        problem.A,
        problem.y,
        **problem.cofactors,
        algorithm=algorithm,
        H_0=H_0,
        history=True,
        max_iterations=max_iterations,
    )


def counts(history: pd.DataFrame) -> pd.DataFrame:
    """Iterations, and for searching algorithms evaluations, until the excess of Φ is below
    ``REACHED``: one row a run.

    Columns: ``run``, its label; a problem each with the iterations; ``<problem>_evaluations``.
    Missing where it never got there.
    """
    rows = []
    for run, (_, _, label) in RUNS.items():
        row: dict = {"run": label}
        for problem in history["problem"].unique():
            steps = history[
                (history["problem"] == problem)
                & (history["run"] == run)
                & (history["excess"] < REACHED)
            ]
            row[problem] = int(steps["iteration"].iloc[0]) if len(steps) else None
            row[f"{problem}_evaluations"] = (
                int(steps["evaluations"].iloc[0]) if len(steps) else None
            )
        rows.append(row)
    return pd.DataFrame(rows).astype({name: "Int64" for name in rows[0] if name != "run"})


def arrivals(points: NDArray[np.float64]) -> pd.DataFrame:
    """Outcome of every algorithm on many clouds of the plane simulation, each from least
    squares.

    Parameters: points (B, n, 3) in m.

    Returns one row a run of ``RUNS`` with the share of the clouds in percent: ``minimum_percent``
    reach the least Φ that any algorithm found; ``other_percent`` converge to a higher one;
    ``failed_percent`` say themselves that they did not converge.
    """
    problem = plane_problem(points)
    estimates = {}
    for run, (algorithm, H_0, _) in RUNS.items():
        estimates[run] = wtls(
            problem.A, problem.y, **problem.cofactors, algorithm=algorithm, H_0=H_0
        )
    least = np.min([one.objective for one in estimates.values()], axis=0)
    rows = []
    for run, one in estimates.items():
        arrived = one.converged & (one.objective < least * (1.0 + 1e-9))
        shares = {"minimum": arrived, "other": one.converged & ~arrived, "failed": ~one.converged}
        rows.append(
            {"run": RUNS[run][2]}
            | {f"{name}_percent": 100.0 * np.mean(share) for name, share in shares.items()}
        )
    return pd.DataFrame(rows)


def plane_problem(points: NDArray[np.float64]) -> Problem:
    """The plane paper's problem for clouds (…, n, 3), with the weights of their LS planes."""
    Q = 1.0 / incidence_cosines(points, fit_plane(points, "ls").parameters)
    A = np.concatenate([points[..., :2], np.ones(points.shape[:-1] + (1,))], axis=-1)
    return Problem(
        "plane, n = 100",
        A,
        points[..., 2],
        {"row_cofactors": Q[..., None, None] * np.diag([1.0, 1.0, 0.0, 1.0])},
    )


def _sphere() -> Problem:
    A, w, Q_X = design(read_sphere_cloud(gross=True))
    return Problem(
        "sphere, n = 500", A, w, {"Q_0": np.diag([1.0, 1.0, 1.0, 0.0]), "Q_X": Q_X, "Q_y": w}
    )


def _dense() -> Problem:
    """Three columns with errors; the correlation of all elements is a random positive definite
    matrix, errors a tenth of the columns.
    """
    generator = np.random.default_rng(SEED)
    n, m = DENSE_ROWS, 3
    A, x = generator.standard_normal((n, m)), np.array([1.0, -2.0, 0.5])
    root = generator.standard_normal((n * (m + 1), n * (m + 1))) * (0.1 / np.sqrt(n * (m + 1)))
    errors = root @ generator.standard_normal(n * (m + 1))
    Q = root @ root.T
    k = n * m
    return Problem(
        f"full cofactors, n = {n}",
        A + errors[:k].reshape(m, n).T,
        A @ x + errors[k:],
        {"Q_A": Q[:k, :k], "Q_y": Q[k:, k:], "Q_Ay": Q[:k, k:]},
    )
