"""
Time and memory of every sphere method, with scikit-spatial's sphere fit in the same run.

``python -m analysis.project.bench``; takes a minute or two. Numbers are of this machine at this moment, so nothing is exported.
"""

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


def seconds(call, repeats=1):
    """The shortest of some runs: what other programs do only adds time."""
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        call()
        times.append(time.perf_counter() - begin)
    return min(times)


def peak(call):
    """Largest memory that a call holds at one time beyond what was held before it, bytes."""
    tracemalloc.start()
    try:
        call()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def row(label, fit, one, stack, large):
    """The line of one method; ``fit`` takes points (…, n, 3), a stack only where ``stack`` is given."""
    together = seconds(lambda: fit(stack), repeats=2) if stack is not None else np.nan
    apart = seconds(lambda: [fit(points) for points in stack], repeats=2) if stack is not None else np.nan
    return {
        "method": label,
        f"{ONE} points / ms": 1e3 * seconds(lambda: fit(one), repeats=5),
        f"stack of {STACK} / s": together,
        "loop / s": apart,
        "loop : stack": apart / together,
        "10^6 points / s": seconds(lambda: fit(large), repeats=2),
        "peak : points": peak(lambda: fit(large)) / large.nbytes,
    }


def main():
    """Command line."""
    warnings.simplefilter("ignore", analysis.ConvergenceWarning)  # speed is measured here, not convergence
    one = simulate.read_sphere_cloud(gross=True)
    stack = simulate.sphere_redraws(STACK, gross=True)
    large = simulate.sphere_cloud(np.random.default_rng(simulate.SEED), LARGE)
    rows = [row("scikit-spatial best_fit", Sphere.best_fit, one, None, large)]
    for name in tqdm(analysis.SPHERE_METHODS, disable=None):
        rows.append(row(name, lambda points, name=name: analysis.fit_sphere(points, name), one, stack, large))
    table = pd.DataFrame(rows)
    table["scikit-spatial : method"] = table["10^6 points / s"].iloc[0] / table["10^6 points / s"]
    print(tables.text(table, 2))
    return 0


if __name__ == "__main__":
    sys.exit(main())
