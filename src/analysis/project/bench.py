"""
Time and memory of every sphere method, against stated limits and beside scikit-spatial's sphere fit.

``python -m analysis.project.bench``; takes about a minute. Numbers are of this machine at this moment, so nothing is exported.
"""

import math
import sys
import time
import tracemalloc
import warnings

import numpy as np
import pandas as pd
from skspatial.objects import Sphere
from tqdm import tqdm

import analysis
from analysis import simulate, tables

ONE, STACK, LARGE = simulate.SPHERE_POINTS, 2_000, 1_000_000
LOOP_SECONDS = 1.0  # where the loop over the stack would take longer, it runs over evenly spread clouds only
PEER = "scikit-spatial"

# What is asked, of which methods (None: all), and the column that shows it.
LIMITS = pd.DataFrame(
    [
        (f"{ONE} points", "ms a fit", "at most", 20.0, None),
        (f"stack of {STACK} x {ONE}", "loop : stack", "at least", 5.0, None),
        (f"stack of {STACK} x {ONE}", "largest difference", "at most", 1e-9, None),
        (f"{LARGE} points", "s a fit", "at most", 1.0, ("ls", "mixed_ls_tls")),
        (f"{LARGE} points", "peak : points", "at most", 4.0, ("ls", "mixed_ls_tls")),
    ],
    columns=["run", "quantity", "rule", "limit", "methods"],
)


def fastest(calls, repeats):
    """Shortest time of each of the named calls, s. They take turns, so that a busy moment of the machine hits all alike."""
    best = dict.fromkeys(calls, math.inf)
    for _ in tqdm(range(repeats), leave=False, disable=None):
        for name, call in calls.items():
            begin = time.perf_counter()
            call()
            best[name] = min(best[name], time.perf_counter() - begin)
    return best


def peak(call):
    """Largest memory that a call holds at one time beyond what was held before it, bytes."""
    tracemalloc.start()
    try:
        call()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def fits(points, methods):
    """A call for each method that fits a sphere to the points."""
    return {name: lambda name=name: analysis.fit_sphere(points, name) for name in methods}


def single(points, methods, repeats=20):
    """One small cloud (n, 3): ms a fit."""
    best = fastest(fits(points, methods), repeats)
    return pd.DataFrame({"method": methods, "ms a fit": [1e3 * best[name] for name in methods]})


def stacked(stack, methods, one_ms):
    """A stack (B, n, 3) in one call and in a loop: ms a cloud, their ratio, and the largest difference of parameters, m."""
    rows = []
    for name, ms in zip(methods, one_ms, strict=True):
        looped = slice(None, None, math.ceil(1e-3 * ms * len(stack) / LOOP_SECONDS))
        together, apart = [], []  # the results of every repetition

        def one_call(name=name, together=together):
            together.append(analysis.fit_sphere(stack, name).parameters)

        def loop(name=name, looped=looped, apart=apart):
            apart.append([analysis.fit_sphere(points, name).parameters for points in stack[looped]])

        best = fastest({"one call": one_call, "loop": loop}, 2)
        stack_ms, loop_ms = 1e3 * best["one call"] / len(stack), 1e3 * best["loop"] / len(apart[0])
        difference = np.abs(together[0][looped] - apart[0]).max()
        rows.append((name, len(apart[0]), stack_ms, loop_ms, loop_ms / stack_ms, difference))
    return pd.DataFrame(rows, columns=["method", "in the loop", "stack, ms", "loop, ms", "loop : stack", "largest difference"])


def large(points, methods, repeats=2):
    """One large cloud (n, 3), and the same by scikit-spatial: s a fit, peak memory over that of the points, and how many times as fast."""
    calls = {PEER: lambda: Sphere.best_fit(points)} | fits(points, methods)
    best = fastest(calls, repeats)
    memory = [peak(call) / points.nbytes for call in calls.values()]
    seconds = np.array(list(best.values()))
    return pd.DataFrame({"method": list(calls), "s a fit": seconds, "peak : points": memory, f"{PEER} : method": best[PEER] / seconds})


def with_verdicts(table, limits):
    """The table with a column that says whether each method keeps the limits: ok, short, or nothing where none is stated."""
    verdicts = []
    for row in table.to_dict("records"):
        kept = [
            row[asked.quantity] <= asked.limit if asked.rule == "at most" else row[asked.quantity] >= asked.limit
            for asked in limits.itertuples()
            if row["method"] in (asked.methods or analysis.SPHERE_METHODS)
        ]
        verdicts.append("" if not kept else "ok" if all(kept) else "short")
    return table.assign(verdict=verdicts)


def report(run, table, decimals):
    """The table of a run with its heading and verdicts, as text."""
    judged = with_verdicts(table, LIMITS[LIMITS["run"] == run])
    return f"{run}\n{tables.text(judged, decimals)}\n"


def main():
    """Command line."""
    warnings.simplefilter("ignore", analysis.ConvergenceWarning)  # speed is measured here, not convergence
    methods = list(analysis.SPHERE_METHODS)
    stated = LIMITS.assign(methods=[", ".join(names) if names else "all" for names in LIMITS["methods"]])
    print("Limits\n" + tables.text(stated, {"limit": ".9g"}) + "\n")

    one = single(simulate.read_sphere_cloud(gross=True), methods)
    print(report(f"{ONE} points", one, 2))
    stack = simulate.sphere_redraws(STACK, gross=True)
    columns = {"in the loop": 0, "stack, ms": 3, "loop, ms": 3, "loop : stack": 1, "largest difference": ".1e"}
    print(report(f"stack of {STACK} x {ONE}", stacked(stack, methods, one["ms a fit"]), columns))
    points = simulate.sphere_cloud(np.random.default_rng(simulate.SEED), LARGE)
    print(report(f"{LARGE} points", large(points, methods), 2))
    return 0


if __name__ == "__main__":
    sys.exit(main())
