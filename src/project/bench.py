"""Time and memory of the methods, against stated limits and beside other libraries.

``python -m project.bench``; takes about four minutes. scikit-image takes part where it is installed
(the extra ``benchmark``). Numbers are of this machine at this moment, so nothing is exported.
"""

import importlib.util
import math
import sys
import time
import tracemalloc
import warnings

import numpy as np
import odrpack
import pandas as pd
from scipy.optimize import least_squares
from skspatial.objects import Plane, Sphere
from tqdm import tqdm

import analysis
from analysis.export import tables
from analysis.scanner import RIEGL_VZ400
from studies.ou_liu_2017 import clouds, peers

ONE, STACK, LARGE = clouds.SPHERE_POINTS, 2_000, 1_000_000
PATCHES, PATCH_POINTS = 20_000, 100
# where the loop over the stack would take longer, it runs over evenly spread clouds only
LOOP_SECONDS = 1.0
PEER = "scikit-spatial"
SOME, GROWING = 10_000, (10_000, 100_000, 1_000_000, 10_000_000)  # points with gross errors
GROSS_SHARE, SIGMA = 0.1, 0.003  # of these points; m

# What is asked, of which methods (None: all), and the column that shows it.
LIMITS = pd.DataFrame(
    [
        (f"{ONE} points", "ms a fit", "at most", 20.0, None),
        (f"stack of {STACK} x {ONE}", "loop : stack", "at least", 5.0, None),
        (f"stack of {STACK} x {ONE}", "largest difference", "at most", 1e-9, None),
        (f"{ONE} points", "ms a fit", "at most", 5.0, ("robust",)),
        (f"stack of {STACK} x {ONE}", "stack, ms", "at most", 1.5, ("robust",)),
        (f"{LARGE} points", "s a fit", "at most", 1.0, ("ls", "mixed_ls_tls")),
        (f"{LARGE} points", "peak : input", "at most", 4.0, ("ls", "mixed_ls_tls")),
        (f"{LARGE} points with gross errors", "s a fit", "at most", 0.25, ("robust",)),
        (f"{LARGE} points with gross errors", "peak : input", "at most", 1.0, ("robust",)),
        (
            f"{LARGE} points with gross errors",
            "times robust",
            "at least",
            3.0,
            ("scikit-image, RANSAC",),
        ),
        (f"{LARGE} points with gross errors", "times robust", "at least", 10.0, ("scipy, cauchy",)),
        (f"{SOME} points with gross errors", "times robust", "at least", 40.0, ("odrpack",)),
        ("robust, more and more points", "exponent", "at most", 1.1, None),
        (f"plane, {LARGE} points", "s a fit", "at most", 0.2, ("geometric",)),
        (f"plane, {LARGE} points", "s a fit", "at most", 3.0, ("eiv, full cofactors",)),
        (f"plane, {LARGE} points", "peak : input", "at most", 3.0, ("eiv, full cofactors",)),
        (f"{PATCHES} planes x {PATCH_POINTS}", "s a fit", "at most", 2.0, ("geometric",)),
    ],
    columns=["run", "quantity", "rule", "limit", "methods"],
)


def fastest(calls, repeats):
    """Shortest time of each of the named calls, s.

    They take turns, so that a busy moment of the machine hits all alike.
    """
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
    """One small cloud (n, 3): ms per fit."""
    best = fastest(fits(points, methods), repeats)
    return pd.DataFrame({"method": methods, "ms a fit": [1e3 * best[name] for name in methods]})


def stacked(stack, methods, one_ms):
    """A stack (B, n, 3) in one call and in a loop: ms per cloud, their ratio, largest difference.

    The difference is that of the parameters, m.
    """
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
    return pd.DataFrame(
        rows,
        columns=[
            "method",
            "in the loop",
            "stack, ms",
            "loop, ms",
            "loop : stack",
            "largest difference",
        ],
    )


def large(calls, sizes, repeats=2):
    """Named calls on one large input, the peer's first: time, memory, and the peer's time over it.

    Time in s per fit, memory in units of the input.
    """
    best = fastest(calls, repeats)
    memory = [peak(call) / sizes[name] for name, call in calls.items()]
    seconds = np.array(list(best.values()))
    return pd.DataFrame(
        {
            "method": list(calls),
            "s a fit": seconds,
            "peak : input": memory,
            f"{PEER} : method": best[PEER] / seconds,
        }
    )


def large_sphere(points, methods, repeats=2):
    """:func:`large` for one large cloud (n, 3) of a sphere."""
    calls = {PEER: lambda: Sphere.best_fit(points)} | fits(points, methods)
    return large(calls, dict.fromkeys(calls, points.nbytes), repeats)


def gross_cloud(generator, n):
    """n points of the paper's sphere, a tenth of them moved by up to 2 m per coordinate."""
    points = clouds.sphere_cloud(generator, n)
    points[: round(GROSS_SHARE * n)] += generator.uniform(-2.0, 2.0, (round(GROSS_SHARE * n), 3))
    return points


def orthogonal_by_odrpack(points):
    """Orthogonal distances by odrpack, implicit, from the LS sphere on; centred coordinates."""
    origin = points.mean(axis=0)
    start = analysis.fit_sphere(points, "ls").parameters - [*origin, 0.0]

    def outwards(x, beta):
        return (x - beta[:3, None]) / np.linalg.norm(x - beta[:3, None], axis=0)

    return odrpack.odr_fit(
        lambda x, beta: np.linalg.norm(x - beta[:3, None], axis=0) - beta[3],
        np.ascontiguousarray((points - origin).T),
        np.zeros(len(points)),
        start,
        task="implicit-ODR",
        jac_beta=lambda x, beta: np.vstack([-outwards(x, beta), -np.ones(x.shape[1])]),
        jac_x=outwards,
    ).beta


class RansacSphere:
    """The sphere for scikit-image's ``ransac``, by algebraic least squares."""

    @classmethod
    def from_estimate(cls, points):  # ``ransac`` calls it
        model = cls()
        model.parameters = analysis.fit_sphere(points, "ls").parameters
        return model

    def residuals(self, points):
        return np.abs(np.linalg.norm(points - self.parameters[:3], axis=1) - self.parameters[3])


def robust_against(points, others, repeats=2):
    """``fit_sphere`` beside named calls on the same points: time, memory, and the time over ours.

    Time in s per fit, memory in units of the input.
    """
    calls = {"robust": lambda: analysis.fit_sphere(points)} | others
    best = fastest(calls, repeats)
    memory = [peak(call) / points.nbytes for call in calls.values()]
    seconds = np.array(list(best.values()))
    return pd.DataFrame(
        {
            "method": list(calls),
            "s a fit": seconds,
            "peak : input": memory,
            "times robust": seconds / best["robust"],
        }
    )


def cauchy_by_scipy(points):
    """Least cauchy loss of the distances, started at the LS sphere, with scipy's own Jacobian."""
    origin = points.mean(axis=0)
    start = analysis.fit_sphere(points, "ls").parameters - [*origin, 0.0]
    centred = points - origin
    return least_squares(
        lambda x: np.linalg.norm(centred - x[:3], axis=1) - x[3],
        start,
        loss="cauchy",
        f_scale=SIGMA,
    ).x


def other_robust_fits(points):
    """Robust fits of other libraries, told the noise that ``fit_sphere`` finds itself."""
    calls = {
        "scipy, cauchy": lambda: cauchy_by_scipy(points),
        "scipy, cauchy, given the Jacobian": lambda: peers.robust_loss(points, "cauchy", SIGMA),
    }
    if importlib.util.find_spec("skimage"):
        from skimage.measure import ransac

        calls["scikit-image, RANSAC"] = lambda: ransac(points, RansacSphere, 4, 3 * SIGMA, rng=1)
    return calls


def growing(generator, sizes, repeats=2):
    """``fit_sphere`` of more and more points: s, and its exponent from each size to the next."""
    seconds = np.empty(len(sizes))
    for place, n in enumerate(sizes):
        points = gross_cloud(generator, n)
        seconds[place] = fastest(fits(points, ["robust"]), repeats)["robust"]
    exponents = np.concatenate([[0.0], np.diff(np.log(seconds)) / np.diff(np.log(sizes))])
    return pd.DataFrame(
        {"method": [f"{n} points" for n in sizes], "s a fit": seconds, "exponent": exponents}
    )


def plane_cloud(generator, shape):
    """Points (…, n, 3) of patches of 1 m of a level plane, σ 2 mm, 3 m below the origin."""
    points = np.concatenate(
        [generator.uniform(-0.5, 0.5, shape + (2,)), np.full(shape + (1,), -3.0)], axis=-1
    )
    return points + 0.002 * generator.standard_normal(points.shape)


def large_plane(points, cofactors, repeats=2):
    """:func:`large` for one large cloud (n, 3) of a plane, also with cofactors (n, 3, 3)."""
    # its default would form an n×n matrix
    calls = {PEER: lambda: Plane.best_fit(points, full_matrices=False)}
    calls |= {
        name: lambda name=name: analysis.fit_plane(points, name) for name in analysis.PLANE_METHODS
    }
    sizes = dict.fromkeys(calls, points.nbytes)
    calls["eiv, full cofactors"] = lambda: analysis.fit_plane(points, "eiv", cofactors=cofactors)
    sizes["eiv, full cofactors"] = points.nbytes + cofactors.nbytes
    return large(calls, sizes, repeats)


def patches(stack, methods, repeats=2):
    """:func:`large` for a stack (B, n, 3) of patches in one call; the peer takes one by one."""
    calls = {PEER: lambda: [Plane.best_fit(points) for points in stack]}
    calls |= {name: lambda name=name: analysis.fit_plane(stack, name) for name in methods}
    return large(calls, dict.fromkeys(calls, stack.nbytes), repeats)


def with_verdicts(table, limits):
    """The table with a column of verdicts: ok or short of the limits, empty where none is stated.

    The first column of the table names the method.
    """
    verdicts, named = [], table.columns[0]
    for row in table.to_dict("records"):
        kept = [
            row[asked.quantity] <= asked.limit
            if asked.rule == "at most"
            else row[asked.quantity] >= asked.limit
            for asked in limits.itertuples()
            if (row[named] in asked.methods if asked.methods else row[named] != PEER)
        ]
        verdicts.append("" if not kept else "ok" if all(kept) else "short")
    return table.assign(verdict=verdicts)


def stated(limits):
    """The limits as text."""
    named = limits.assign(
        methods=[", ".join(names) if names else "all" for names in limits["methods"]]
    )
    return f"Limits\n{tables.text(named, {'limit': '.9g'})}\n"


def report(run, table, decimals, limits=LIMITS):
    """The table of a run with its heading and verdicts, as text."""
    judged = with_verdicts(table, limits[limits["run"] == run])
    return f"{run}\n{tables.text(judged, decimals)}\n"


def main():
    """Command line."""
    # speed is measured here, not convergence
    warnings.simplefilter("ignore", analysis.ConvergenceWarning)
    methods = list(analysis.SPHERE_METHODS)
    print(stated(LIMITS))

    one = single(clouds.read_sphere_cloud(gross=True), methods)
    print(report(f"{ONE} points", one, 2))
    stack = clouds.sphere_redraws(STACK, gross=True)
    columns = {
        "in the loop": 0,
        "stack, ms": 3,
        "loop, ms": 3,
        "loop : stack": 1,
        "largest difference": ".1e",
    }
    print(report(f"stack of {STACK} x {ONE}", stacked(stack, methods, one["ms a fit"]), columns))
    points = clouds.sphere_cloud(np.random.default_rng(clouds.SEED), LARGE)
    print(report(f"{LARGE} points", large_sphere(points, methods), 2))

    generator = np.random.default_rng(clouds.SEED)
    points = gross_cloud(generator, LARGE)
    print(
        report(
            f"{LARGE} points with gross errors",
            robust_against(points, other_robust_fits(points)),
            2,
        )
    )
    points = gross_cloud(generator, SOME)
    print(
        report(
            f"{SOME} points with gross errors",
            robust_against(points, {"odrpack": lambda: orthogonal_by_odrpack(points)}),
            3,
        )
    )
    print(report("robust, more and more points", growing(generator, GROWING), 3))

    points = plane_cloud(generator, (LARGE,))
    cofactors = RIEGL_VZ400.cofactors(
        points, normals=np.broadcast_to([0.0, 0.0, 1.0], points.shape)
    )
    print(report(f"plane, {LARGE} points", large_plane(points, cofactors), 2))
    print(
        report(
            f"{PATCHES} planes x {PATCH_POINTS}",
            patches(
                plane_cloud(generator, (PATCHES, PATCH_POINTS)),
                ["ls", "geometric", "robust"],
                repeats=1,
            ),
            2,
        )
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
