"""The benchmark's tables, on sizes that take no time. Speed itself is no test: it is read from
``make bench``.
"""

import numpy as np
import pandas as pd

from analysis import PLANE_METHODS, fit_sphere
from project import bench
from studies.ou_liu_2017 import clouds

METHODS = ["ls", "igg3_wtls"]
STACK = clouds.sphere_redraws(3, gross=True)


def test_tables_have_a_line_a_method():
    one = bench.single(STACK[0], METHODS, repeats=1)
    together = bench.stacked(STACK, METHODS, one["ms a fit"])
    whole = bench.large_sphere(STACK[0], METHODS, repeats=1)
    assert one["method"].tolist() == together["method"].tolist() == METHODS
    assert whole["method"].tolist() == [bench.PEER, *METHODS]
    assert whole[f"{bench.PEER} : method"].iloc[0] == 1
    assert together["largest difference"].max() < 1e-9
    for table in (one, together, whole):
        assert np.all(
            table.select_dtypes("float").drop(columns="largest difference", errors="ignore") > 0
        )


def test_planes():
    stack = bench.plane_cloud(np.random.default_rng(1), (3, 50))
    one = bench.large_plane(stack[0], np.tile(1e-6 * np.eye(3), (50, 1, 1)), repeats=1)
    assert one["method"].tolist() == [bench.PEER, *PLANE_METHODS, "eiv, full cofactors"]
    many = bench.patches(stack, METHODS, repeats=1)
    assert many["method"].tolist() == [bench.PEER, *METHODS]
    assert (many["s a fit"] > 0).all() and (many["peak : input"] > 0).all()


def test_robust_beside_other_libraries():
    points = bench.gross_cloud(np.random.default_rng(1), 200)
    others = bench.other_robust_fits(points) | {
        "odrpack": lambda: bench.orthogonal_by_odrpack(points)
    }
    table = bench.robust_against(points, others, repeats=1)
    assert table["method"].tolist() == ["robust", *others]
    assert table["times robust"].iloc[0] == 1


def test_scipy_is_used_rightly():
    points = clouds.sphere_cloud(np.random.default_rng(1), 200)
    ours = fit_sphere(points).parameters - [*points.mean(axis=0), 0.0]
    np.testing.assert_allclose(bench.cauchy_by_scipy(points), ours, rtol=0, atol=2e-3)


def test_odrpack_is_used_rightly():
    points = clouds.sphere_cloud(np.random.default_rng(1), 200)
    ours = fit_sphere(points, "geometric").parameters - [*points.mean(axis=0), 0.0]
    np.testing.assert_allclose(bench.orthogonal_by_odrpack(points), ours, rtol=0, atol=1e-6)


def test_growing_clouds():
    table = bench.growing(np.random.default_rng(1), (100, 1000), repeats=1)
    assert table["method"].tolist() == ["100 points", "1000 points"]
    np.testing.assert_allclose(
        table["exponent"][1], np.log10(table["s a fit"][1] / table["s a fit"][0])
    )


def test_a_long_loop_runs_over_some_of_the_clouds():
    together = bench.stacked(STACK, ["ls"], [1e6])
    assert together["in the loop"].tolist() == [1]
    assert together["largest difference"].max() < 1e-9


def test_verdicts():
    limits = pd.DataFrame(
        [("run", "s", "at most", 1.0, ("ls",)), ("run", "gain", "at least", 5.0, None)],
        columns=["run", "quantity", "rule", "limit", "methods"],
    )
    methods = ["ls", "ls", "tls", "tls", bench.PEER]
    table = pd.DataFrame(
        {"method": methods, "s": [0.5, 2.0, 2.0, 2.0, 2.0], "gain": [5.0, 9.0, 5.0, 4.9, 1.0]}
    )
    assert bench.with_verdicts(table, limits)["verdict"].tolist() == [
        "ok",
        "short",
        "ok",
        "short",
        "",
    ]


def test_report_shows_limits_and_verdicts():
    run = bench.LIMITS["run"].iloc[0]
    text = bench.report(run, pd.DataFrame({"method": ["ls", "tls"], "ms a fit": [1.25, 1000.0]}), 2)
    assert text.splitlines() == [
        run,
        "method  ms a fit  verdict",
        "ls          1.25  ok",
        "tls      1000.00  short",
    ]


def test_peak_counts_what_a_call_holds():
    assert 8e6 <= bench.peak(lambda: np.ones(1_000_000)) < 9e6
