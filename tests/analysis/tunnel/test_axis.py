"""The axis of a tunnel: exact tunnels give the truth, the printed axis shows its hazards, the
robust one does not.
"""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.spatial import cKDTree

from analysis.tunnel import axis as module
from analysis.tunnel.axis import Axis, local_frame, mid_values, printed_axis, robust_axis, straight

RADIUS = 2.7
CURVE = 300.0  # m, radius of the horizontal arc
SITE = np.array([412_000.0, 3_518_000.0, 85.0])


def turned(heading):
    """Rotation about Z, degrees."""
    c, s = np.cos(np.radians(heading)), np.sin(np.radians(heading))
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


class Tunnel:
    """A tunnel on a horizontal arc (or straight: ``curve`` infinite) with a constant grade,
    anywhere, in any direction.
    """

    def __init__(self, length=60.0, curve=CURVE, grade=0.015, heading=0.0, origin=(0.0, 0.0, 0.0)):
        self.length, self.curve, self.grade, self.turn, self.origin = (
            length,
            curve,
            grade,
            turned(heading),
            np.array(origin),
        )

    def axis(self, s):
        """Axis points and unit tangents at horizontal distances s, (n, 3)."""
        s = np.asarray(s, dtype=float)
        phi = (s - 0.5 * self.length) / self.curve
        across, ahead = np.sin(phi), np.cos(phi)
        straight_on = np.isinf(self.curve)
        x = np.zeros_like(s) if straight_on else self.curve * (1 - ahead)
        y = s - 0.5 * self.length if straight_on else self.curve * across
        tangent = np.stack([across, ahead, np.full_like(s, self.grade)], axis=-1) / np.hypot(
            1, self.grade
        )
        return np.stack(
            [x, y, self.grade * s], axis=-1
        ) @ self.turn.T + self.origin, tangent @ self.turn.T

    def points(self, n, rng, sigma=0.0, bed=0.0, cable=0.0, ovality=0.0):
        """n points of the lining; a track bed hides ``bed`` m of the invert, a cable hangs
        ``cable`` m before the right wall.
        """
        s, a = rng.uniform(0.0, self.length, n), rng.uniform(-np.pi, np.pi, n)
        r = RADIUS + ovality * np.cos(2 * a) + sigma * rng.standard_normal(n)
        u = r * np.sin(a) - cable * (np.abs(a - 0.5 * np.pi) < 0.1)
        v = np.maximum(r * np.cos(a), bed - RADIUS) if bed else r * np.cos(a)
        p, t = self.axis(s)
        right = np.cross(t, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right, axis=-1, keepdims=True)
        return p + u[:, None] * right + v[:, None] * np.cross(right, t)

    def errors(self, axis, margin=1.0):
        """Largest error of the axis in position (horizontal, up; m) and direction between the ends,
        less a margin.
        """
        p, t = self.axis(np.linspace(margin, self.length - margin, 300))
        y = axis.foot(p)
        d = axis.position(y) - p
        direction = np.linalg.norm(np.cross(axis.tangent(y), t), axis=-1)  # of either sense
        return np.hypot(d[:, 0], d[:, 1]).max(), np.abs(d[:, 2]).max(), direction.max()


def curved_axis():
    """A quadratic axis in a turned frame far from the origin."""
    coefficients = np.zeros((4, 2, 1))
    coefficients[:3, :, 0] = [[0.3, -0.2], [0.05, 0.02], [1 / 600, -1 / 4000]]
    return Axis(SITE, turned(40.0).T, np.array([-20.0, 45.0]), coefficients)


# --------------------------------------------------------------------------------- the curve itself


def test_frame_is_right_handed_with_up_nearest_to_the_vertical():
    axis = curved_axis()
    right, up, along = axis.frame(np.linspace(-25.0, 50.0, 31))
    frame = np.stack([right, up, along], axis=-2)
    assert np.allclose(frame @ frame.swapaxes(-1, -2), np.eye(3), atol=1e-14)
    assert np.allclose(np.cross(along, up), right, atol=1e-14)
    assert np.allclose(right[:, 2], 0.0, atol=1e-15) and np.all(up[:, 2] > 0.99)


def test_tangent_is_the_derivative_of_the_position():
    axis, y, h = curved_axis(), np.array([-10.0, 0.0, 33.0]), 1e-3
    chord = axis.to_local(axis.position(y + h)) - axis.to_local(axis.position(y - h))
    chord /= np.linalg.norm(chord, axis=-1, keepdims=True)
    assert np.allclose(chord @ axis.rotation, axis.tangent(y), atol=1e-6)


def test_chainage_is_the_arc_length_and_its_inverse_returns():
    axis = curved_axis()
    y = np.array([-20.0, -3.0, 12.5, 45.0])
    for end, s in zip(y, axis.chainage(y), strict=True):
        a = axis.quadratics

        def speed(v, a=a):
            slopes = a[:, 1] + 2 * a[:, 2] * v
            return np.sqrt(1 + slopes @ slopes)

        assert s == pytest.approx(quad(speed, -20.0, end, epsabs=1e-13)[0], abs=1e-10)
    assert np.allclose(axis.at_chainage(axis.chainage(y)), y, atol=1e-10)
    assert axis.chainage(-20.0) == 0.0 and axis.length == pytest.approx(axis.chainage(45.0))


def test_quadratics_are_those_of_the_whole_local_frame():
    axis, y = curved_axis(), np.array([-20.0, 7.0, 45.0])
    assert np.allclose(axis.quadratics @ [np.ones(3), y, y * y], axis.local_curve(y)[0], atol=1e-12)


@pytest.mark.parametrize("spline", [False, True])
def test_foot_points_are_the_nearest_of_all_axis_points(spline):
    rng = np.random.default_rng(4)
    axis = robust_axis(Tunnel(150.0).points(60_000, rng)) if spline else curved_axis()
    points = axis.position(rng.uniform(*axis.y_range, 400)) + rng.uniform(-3.0, 3.0, (400, 3))
    y = axis.foot(points)
    listed = np.linspace(axis.y_range[0] - 8.0, axis.y_range[1] + 8.0, 400_001)
    listed_points = axis.position(listed) - axis.origin
    distance = cKDTree(listed_points).query(points - axis.origin)[0]
    found = np.linalg.norm(axis.position(y) - points, axis=-1)
    assert np.all(found <= distance + 1e-9) and np.abs(found - distance).max() < 1e-6
    assert np.abs(np.einsum("ni,ni->n", points - axis.position(y), axis.tangent(y))).max() < 1e-8


def test_foot_points_satisfy_the_printed_cubic():
    axis, rng = curved_axis(), np.random.default_rng(8)
    (a0, a1, a2), (b0, b1, b2) = axis.quadratics
    x, y_P, z = (local := rng.uniform([-3, -15, -3], [3, 40, 3], (200, 3))).T
    y = axis.foot(axis.from_local(local))
    c3, c2 = -2 * (a2**2 + b2**2), -3 * (a1 * a2 + b1 * b2)
    c1 = 2 * a2 * (x - a0) - a1**2 - 1 + 2 * b2 * (z - b0) - b1**2
    c0 = a1 * (x - a0) + y_P + b1 * (z - b0)
    assert np.abs(c3 * y**3 + c2 * y**2 + c1 * y + c0).max() < 1e-8


def test_foot_points_do_not_depend_on_the_block(monkeypatch):
    axis, points = curved_axis(), SITE + np.random.default_rng(1).uniform(-5.0, 5.0, (1000, 3))
    whole = axis.foot(points)
    monkeypatch.setattr(
        module, "pieces", lambda count: [slice(k, k + 77) for k in range(0, count, 77)]
    )
    assert np.allclose(axis.foot(points), whole, atol=1e-12)
    assert axis.foot(np.empty((0, 3))).shape == (0,)


def test_axis_continues_straight_beyond_its_ends():
    axis = curved_axis()
    ends = axis.position(np.array([45.0, 46.0, 47.0]))
    assert np.allclose(ends[2] - ends[1], ends[1] - ends[0], atol=1e-8)
    assert axis.chainage(47.0) == pytest.approx(
        axis.length + np.linalg.norm(ends[2] - ends[0]), abs=1e-8
    )


def test_straight_axis():
    axis = straight(SITE, SITE + [30.0, -40.0, 1.0])
    assert axis.length == pytest.approx(np.sqrt(2501.0))
    assert np.allclose(
        axis.position(axis.at_chainage(axis.length)), SITE + [30.0, -40.0, 1.0], atol=1e-9
    )
    with pytest.raises(ValueError, match="horizontal distance"):
        straight([0, 0, 0], [0, 0, 5])


# --------------------------------------------------------------------------------- local frame


@pytest.mark.parametrize("heading", [0.0, 30.0, 90.0, 200.0, 315.0])
def test_local_frame_runs_along_the_tunnel_however_dense_the_points(heading):
    tunnel, rng = Tunnel(80.0, curve=np.inf, heading=heading, origin=SITE), np.random.default_rng(2)
    near = tunnel.points(40_000, rng)
    # around a scanner
    crowd = Tunnel(6.0, curve=np.inf, heading=heading, origin=SITE).points(200_000, rng)
    rotation = local_frame(np.concatenate([near, crowd]))[1]
    assert np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-14) and np.linalg.det(rotation) > 0
    assert abs(rotation[1] @ tunnel.turn[:, 1]) > np.cos(np.radians(1.0))


# --------------------------------------------------------------------------------- as printed


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
    printed_axis(points)
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
        (lambda: printed_axis(GOOD[:, [1, 0, 2]]), "expected a tunnel along Y.*local_frame"),
        (lambda: printed_axis(GOOD, step=-1.0), "step: expected a positive"),
        (lambda: printed_axis(GOOD, step=11.0), "at least 3 occupied bins"),
        (lambda: printed_axis(GOOD, step=1e-5), "bins that hold points"),
        (
            lambda: robust_axis(Tunnel(130.0).points(40_000, np.random.default_rng(1))).quadratics,
            "cubic spline of",
        ),
    ],
)
def test_bad_input_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()
