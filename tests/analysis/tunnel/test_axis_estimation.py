"""The robust axis: exact tunnels give the truth, and what is no lining does not pull it."""

import numpy as np
import pytest

from analysis.tunnel import axis_estimation as module
from analysis.tunnel.axis_estimation import robust_axis

from .exact_tunnel import SITE, Tunnel, turned


def test_hazard_one_quadratic_does_not_follow_a_long_arc():
    tunnel, rng = Tunnel(130.0, grade=0.0), np.random.default_rng(9)
    p = tunnel.axis(np.linspace(0.0, 130.0, 500))[0]
    misfit = p[:, 0] - np.polynomial.Polynomial.fit(p[:, 1], p[:, 0], 2)(p[:, 1])
    assert 0.008 < np.abs(misfit[20:-20]).max()
    assert tunnel.errors(robust_axis(tunnel.points(100_000, rng)))[0] < 0.001


# --------------------------------------------------------------------------------- robust


@pytest.mark.parametrize(
    "tunnel",
    [
        Tunnel(40.0, curve=np.inf, grade=0.0),
        Tunnel(40.0, curve=np.inf, grade=0.1, heading=75.0),
        Tunnel(58.0, heading=-120.0),
        Tunnel(130.0, heading=160.0, origin=SITE),
        Tunnel(200.0, grade=0.02, curve=500.0),
    ],
    ids=["straight", "steep", "curved", "paper", "long"],
)
@pytest.mark.parametrize("kind", ["exact", "real"])
def test_robust_axis_is_the_truth(tunnel, kind):
    clutter = {
        "exact": {},
        "real": {"sigma": 0.003, "bed": 0.704, "cable": 0.13, "ovality": 0.008},
    }[kind]
    axis = robust_axis(
        tunnel.points(int(1000 * tunnel.length), np.random.default_rng(10), **clutter)
    )
    horizontal, up, direction = tunnel.errors(axis)
    assert axis.converged and axis.stop_reason == "the axis stands still"
    assert max(horizontal, up) < 0.001 and direction < 4e-4
    # to the ends less a slab that is not full
    assert -2.0 < axis.length - tunnel.length * np.hypot(1, tunnel.grade) < 0.05


def test_robust_axis_is_not_pulled_by_stray_points_or_a_spoiled_stretch():
    tunnel, rng = Tunnel(50.0, curve=np.inf), np.random.default_rng(11)
    points = tunnel.points(150_000, rng, sigma=0.003)
    points = np.concatenate([points, rng.uniform([-4, -24, -3], [4, 24, 4], (15_000, 3))])
    points[np.abs(points[:, 1] - 10.0) < 1.5] += [0.6, 0.0, 0.4]  # three slabs somewhere else
    horizontal, up, direction = tunnel.errors(robust_axis(points))
    assert max(horizontal, up) < 0.003 and direction < 1e-3


def test_robust_axis_moves_and_turns_with_the_points():
    tunnel, rng = Tunnel(40.0), np.random.default_rng(12)
    points = tunnel.points(80_000, rng, sigma=0.003, bed=0.7)
    axis, moved = robust_axis(points), robust_axis(points @ turned(35.0).T + SITE)
    at = np.linspace(2.0, 36.0, 20)
    there = axis.position(axis.at_chainage(at)) @ turned(35.0).T + SITE
    # other slabs, other medians
    assert np.linalg.norm(moved.position(moved.foot(there)) - there, axis=-1).max() < 5e-4


def test_robust_axis_of_a_sample_of_many_points(monkeypatch):
    tunnel, rng = Tunnel(40.0), np.random.default_rng(13)
    points = tunnel.points(200_000, rng, sigma=0.003)
    monkeypatch.setattr(module, "SAMPLE", 50_000)
    first, again, other = robust_axis(points), robust_axis(points), robust_axis(points, seed=1)
    assert np.array_equal(first.coefficients, again.coefficients) and not np.array_equal(
        first.coefficients, other.coefficients
    )
    assert max(tunnel.errors(first)[:2]) < 0.002


def test_points_stay_as_they_are_and_the_axis_is_frozen():
    points = Tunnel(20.0).points(20_000, np.random.default_rng(14))
    before = points.copy()
    axis = robust_axis(points)
    assert np.array_equal(points, before)
    with pytest.raises(ValueError, match="read-only"):
        axis.breaks[0] = 1.0


def test_an_axis_that_does_not_stand_still_says_so():
    points = Tunnel(30.0).points(60_000, np.random.default_rng(15), sigma=0.003, bed=0.7)
    axis = robust_axis(points, max_iterations=1)
    assert not axis.converged and "still moved" in axis.stop_reason and axis.iterations == 1


# --------------------------------------------------------------------------------- refusals


GOOD = Tunnel(20.0, curve=np.inf).points(20_000, np.random.default_rng(16))


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda: robust_axis(GOOD[:50]), "at least 100 points for a tunnel axis, got 50"),
        (lambda: robust_axis(1000.0 * GOOD), "are these metres"),
        (
            lambda: robust_axis(1000.0 * GOOD, slab=1000.0),
            "radius of 0.3 to 30 m, got about 269.*are these metres",
        ),
        (lambda: robust_axis(GOOD[:, [0, 2, 1]]), "with Z up, in m; got"),
        (lambda: robust_axis(GOOD[np.abs(GOOD[:, 1]) < 1.0]), "1.5 times as long as wide and high"),
        (lambda: robust_axis(GOOD[:200]), "at least 3 slabs of 1 m with 20 points"),
        (lambda: robust_axis(GOOD, slab=0.0), "slab: expected a positive"),
        (lambda: robust_axis(GOOD[:, :2]), r"expected shape \(…, n, 3\)"),
        (lambda: robust_axis(GOOD[None]), r"one cloud of shape \(n, 3\)"),
        (lambda: robust_axis(np.where(GOOD == GOOD[3], np.nan, GOOD)), "finite numbers"),
        (
            lambda: robust_axis(Tunnel(130.0).points(40_000, np.random.default_rng(1))).quadratics,
            "cubic spline of",
        ),
    ],
)
def test_bad_input_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()
