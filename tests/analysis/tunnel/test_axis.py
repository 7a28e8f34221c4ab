"""The axis of a tunnel as a curve: its frame, arc length and foot points."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.spatial import cKDTree

from analysis.tunnel import axis as module
from analysis.tunnel.axis import Axis, local_frame, straight
from analysis.tunnel.axis_estimation import robust_axis

from .exact_tunnel import SITE, Tunnel, turned


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
