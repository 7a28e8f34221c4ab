"""The printed axis: exact rings give the truth, cut ends, track bed and cables pull it."""

import numpy as np
import pytest

from analysis.tunnel.axis_estimation import robust_axis
from studies.li_2015.printed_axis import mid_values, printed_axis

from ...analysis.tunnel.exact_tunnel import RADIUS, SITE, Tunnel, turned


def full_rings(y, x_of, z_of):
    """Rings of 360 points at each y: exact tunnels whose section in planes of constant y is a
    circle.
    """
    a = np.radians(np.arange(360.0))
    y = np.repeat(y, 360)
    a = np.tile(a, len(y) // 360)
    return np.stack([x_of(y) + RADIUS * np.sin(a), y, z_of(y) + RADIUS * np.cos(a)], axis=-1)


def test_printed_axis_of_exact_rings_gives_the_quadratics():
    y = 5.0 + 0.1 * np.arange(300) + 0.05  # one ring in the middle of every bin
    points = full_rings(
        y, lambda y: 1.0 - 0.1 * y + 0.002 * y**2, lambda y: 3.0 + 0.02 * y - 1e-4 * y**2
    )
    # so that the bins begin at 5
    points = np.concatenate([points, [[points[:, 0].mean(), 5.0, 3.0]]])
    axis = printed_axis(points)
    assert np.allclose(axis.quadratics, [[1.0, -0.1, 0.002], [3.0, 0.02, -1e-4]], atol=2e-4)
    centers, middle = mid_values(points)
    assert np.allclose(centers, y, atol=1e-9)
    assert np.allclose(middle[1:, 0], 1.0 - 0.1 * y[1:] + 0.002 * y[1:] ** 2, atol=1e-12)


def test_printed_axis_in_another_frame_is_the_same_curve():
    tunnel, rng = Tunnel(30.0, curve=np.inf), np.random.default_rng(5)
    points = tunnel.points(60_000, rng)
    moved = printed_axis(points @ turned(50.0).T + SITE, local=(SITE, turned(50.0).T))
    assert np.allclose(moved.quadratics, printed_axis(points).quadratics, atol=1e-6)


def test_hazard_cut_end_bins_pull_the_printed_axis():
    """A tunnel cut across its axis, askew to Y by 0.1: the bins within R·slope of the ends hold
    part of the ring.
    """
    tunnel, rng = (
        Tunnel(60.0, curve=np.inf, grade=0.0, heading=np.degrees(np.arctan(-0.1))),
        np.random.default_rng(6),
    )
    points = tunnel.points(300_000, rng)
    whole = tunnel.errors(printed_axis(points))[0]
    y = points[:, 1]
    trimmed = tunnel.errors(printed_axis(points[(y > y.min() + 1.0) & (y < y.max() - 1.0)]))[0]
    assert whole > 0.03 and trimmed < 0.003 and tunnel.errors(robust_axis(points))[0] < 1e-3


def test_hazard_track_bed_lifts_the_printed_axis_by_half_of_what_it_hides():
    tunnel, rng = Tunnel(40.0, curve=np.inf, grade=0.0), np.random.default_rng(7)
    points = tunnel.points(200_000, rng, bed=0.704)
    printed, robust = printed_axis(points), robust_axis(points)
    assert np.allclose(printed.position(np.linspace(-15, 15, 9))[:, 2], 0.352, atol=0.003)
    # but it stays parallel
    assert np.abs(printed.tangent(np.linspace(-15, 15, 9))[:, [0, 2]]).max() < 1e-3
    assert tunnel.errors(robust)[1] < 5e-4


def test_hazard_cable_moves_the_printed_axis_by_half_of_its_depth():
    tunnel, rng = Tunnel(40.0, curve=np.inf, grade=0.0), np.random.default_rng(8)
    # The cable hides the springline: what is left of the wall beside it still reaches R cos(0.1
    # rad).
    points = tunnel.points(200_000, rng, cable=0.15)
    hidden = RADIUS * (1 - np.cos(0.1))
    assert np.median(printed_axis(points).position(np.linspace(-15, 15, 9))[:, 0]) == pytest.approx(
        -0.5 * hidden, abs=0.002
    )
    # A tray whose face is the last thing seen on the right, as deep as its depth.
    v = points[:, 2]
    points[:, 0] = np.where(
        (points[:, 0] > 0) & (np.abs(v) < 1.3), np.minimum(points[:, 0], RADIUS - 0.3), points[:, 0]
    )
    assert np.median(printed_axis(points).position(np.linspace(-15, 15, 9))[:, 0]) == pytest.approx(
        -0.15, abs=0.003
    )
    assert tunnel.errors(robust_axis(points))[0] < 1e-3


def test_points_stay_as_they_are():
    points = Tunnel(20.0).points(20_000, np.random.default_rng(14))
    before = points.copy()
    printed_axis(points)
    assert np.array_equal(points, before)


GOOD = Tunnel(20.0, curve=np.inf).points(20_000, np.random.default_rng(16))


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda: printed_axis(GOOD[:, [1, 0, 2]]), "expected a tunnel along Y.*local_frame"),
        (lambda: printed_axis(GOOD, step=-1.0), "step: expected a positive"),
        (lambda: printed_axis(GOOD, step=11.0), "at least 3 occupied bins"),
        (lambda: printed_axis(GOOD, step=1e-5), "bins that hold points"),
    ],
)
def test_bad_input_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()
