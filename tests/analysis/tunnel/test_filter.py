"""The filter of the lining on a small tunnel with labelled attachments, pockets, joints, track bed
and a known deformation.
"""

from dataclasses import dataclass

import numpy as np
import pytest

from analysis.result import rms
from analysis.tunnel import lining_surface
from analysis.tunnel.axis import Axis, straight
from analysis.tunnel.filter import FilteredLining, filter_lining

R = 2.7
LINING, JOINT, ATTACHMENT, POCKET, BED, MIXED = range(6)
LENGTH = 9.0
AXIS = straight(np.zeros(3), np.array([0.0, LENGTH, 0.0]))


@dataclass(frozen=True)
class Tunnel:
    """Points (n, 3), their labels, and the wall's true radius where they are."""

    points: np.ndarray
    label: np.ndarray
    wall: np.ndarray

    @property
    def truth(self):
        return self.label == LINING, self.label == ATTACHMENT


def dent(angle, w):
    """24 mm inwards at 40° and 5.2 m, falling off within half a metre, and ovality of 12 mm that
    grows along the tunnel.
    """
    away = np.hypot(R * (angle - np.radians(40)), w - 5.2)
    return 0.012 * np.cos(2 * angle) * w / LENGTH - 0.024 * np.exp(-0.5 * (away / 0.5) ** 2)


def tunnel(n=200_000, seed=0, noise=0.003, deformation=dent, station=4.5, wide=False):
    """Denser near the station, noise of the range 3 mm seen along the normal, rings 1.2 m long that
    step by up to 2 mm.
    """
    generator = np.random.default_rng(seed)
    w = generator.uniform(0, LENGTH, 6 * n)
    w = w[generator.uniform(size=6 * n) < (1 + ((w - station) / R) ** 2) ** -1.5][:n]
    n = len(w)
    angle = generator.uniform(-np.pi, np.pi, n)
    arc = R * angle
    wall = (
        R
        + 0.005 * np.cos(2 * angle)
        + deformation(angle, w)
        + generator.uniform(-0.002, 0.002, 20)[(w / 1.2).astype(int)]
    )
    label, height = np.full(n, LINING), np.zeros(n)

    def put(where, what, inwards):
        label[where], height[where] = what, inwards

    put(np.abs((w + 0.6) % 1.2 - 0.6) < 0.004, JOINT, -0.022)
    for degrees, width, inwards in (
        (100, 0.03, 0.03),
        (96, 0.05, 0.05),
        (92, 0.04, 0.02),
        (-95, 0.06, 0.08),
        (-110, 0.30, 0.15),
    ):
        # cables and a tray
        put(np.abs(arc - R * np.radians(degrees)) < width / 2, ATTACHMENT, inwards)
    for x in np.arange(1.0, LENGTH, 2.4):  # lamps
        put((np.abs(arc - R * np.radians(20)) < 0.1) & (np.abs(w - x) < 0.3), ATTACHMENT, 0.12)
    for x in np.arange(0.6, LENGTH, 1.2):  # bolts and pockets
        for degrees in (-60, -20, 30, 60):
            put(
                (np.abs(arc - R * np.radians(degrees)) < 0.02) & (np.abs(w - x - 0.1) < 0.02),
                ATTACHMENT,
                0.03,
            )
        for degrees in (-70, -35, 5, 70):
            put(
                (np.abs(arc - R * np.radians(degrees)) < 0.06) & (np.abs(w - x + 0.1) < 0.08),
                POCKET,
                -0.06,
            )
    if wide:  # cabinets over 50° of the wall, all along
        put((angle > np.radians(-90)) & (angle < np.radians(-40)), ATTACHMENT, 0.25)
    mixed = generator.uniform(size=n) < 0.003
    put(mixed, MIXED, generator.uniform(0.02, 0.3, n)[mixed])
    distance = np.hypot(R, w - station)
    # of range and angles, along the normal
    across = np.hypot(noise * R / distance, 4e-5 * (w - station))
    radius = wall - height + across * generator.standard_normal(n)
    bed = np.abs(angle) > np.radians(135)
    label[bed] = BED
    radius[bed] = R * np.cos(np.pi / 4) / -np.cos(angle[bed]) + 0.004 * generator.standard_normal(
        bed.sum()
    )
    return Tunnel(np.column_stack([radius * np.sin(angle), w, radius * np.cos(angle)]), label, wall)


def effect(result, one):
    """Effect of a filter: what it found and lost, and how it changed mean radii, in mm.

    Radii are means in cells of 5° and 0.3 m, within 135° of the crown, with at least 100 points of
    the lining. `change` comes from lining points that were lost, `intrusion` from others that were
    kept; cells `emptied` of more than half of their lining are left out of both.
    """
    lining, attachment = one.truth
    _, radius, angle = AXIS.polar(one.points)
    cell = np.floor((angle + np.pi) / np.radians(5)).astype(int) * 100
    cell += np.floor(one.points[:, 1] / 0.3).astype(int)

    def means(where):
        count = np.bincount(cell, where, minlength=cell.max() + 1)
        return np.bincount(cell, np.where(where, radius, 0.0)) / np.maximum(count, 1), count

    before, count = means(lining & (np.abs(angle) <= np.radians(135)))
    kept, left = means(lining & result.lining)
    together, _ = means(result.lining)
    emptied = (count >= 100) & (left < 0.5 * count)
    whole = (count >= 100) & ~emptied
    change, intrusion = 1e3 * (kept - before)[whole], 1e3 * (together - kept)[whole]
    return {
        "found": np.mean(result.flags[attachment] == -1),
        "lost": np.mean(~result.lining[lining]),
        "largest_change": np.abs(change).max(initial=0.0),
        "rms_change": rms(change),
        "largest_intrusion": np.abs(intrusion).max(initial=0.0),
        "cells": np.count_nonzero(whole | emptied),
        "emptied": np.count_nonzero(emptied),
    }


@pytest.fixture(scope="module")
def deformed():
    return tunnel()


@pytest.fixture(scope="module")
def filtered(deformed) -> FilteredLining:
    return filter_lining(deformed.points, AXIS)


def test_attachments_are_found_and_the_lining_is_kept(deformed, filtered):
    flags, label = filtered.flags, deformed.label
    assert np.mean(flags[label == ATTACHMENT] == -1) >= 0.995
    assert np.mean(flags[label == LINING] != 0) <= 0.005
    assert np.mean(flags[label == POCKET] == 1) >= 0.995
    assert np.mean(flags[label == JOINT] == 1) >= 0.98
    assert np.mean(flags[label == MIXED] == -1) >= 0.97
    assert np.mean(flags[label == BED] == -1) >= 0.99  # all but where it meets the wall
    assert flags.dtype == np.int8 and set(np.unique(flags)) == {-1, 0, 1}


def test_the_deformation_is_the_same_after_filtering(deformed, filtered):
    result = effect(filtered, deformed)
    assert result["cells"] > 500 and result["emptied"] == 0
    assert result["largest_change"] < 0.3 and result["rms_change"] < 0.06
    assert result["largest_intrusion"] < 0.3


@pytest.mark.parametrize(
    "deformation",
    [lambda angle, w: 0.025 * np.cos(2 * angle) * w / LENGTH, lambda angle, w: 0.0 * angle],
)
def test_elliptic_and_no_deformation(deformation):
    one = tunnel(seed=1, deformation=deformation)
    result = effect(filter_lining(one.points, AXIS), one)
    assert (
        result["found"] >= 0.995
        and result["lost"] <= 0.005
        and result["largest_change"] < 0.3
        and result["emptied"] == 0
    )


def test_the_deformation_between_two_surveys_with_the_same_noise(deformed, filtered):
    """Kept points of a deformed tunnel against those of the undeformed one, cell by cell; what
    noise does to each alone drops out.
    """
    before = tunnel(deformation=lambda angle, w: 0.0 * angle)
    kept = filter_lining(before.points, AXIS).lining & (before.label == LINING)
    still_kept = filtered.lining & (deformed.label == LINING)
    _, radius, angle = AXIS.polar(before.points)
    now = AXIS.polar(deformed.points)[1]
    cell = np.floor((angle + np.pi) / np.radians(5)).astype(int) * 100 + np.floor(
        before.points[:, 1] / 0.3
    ).astype(int)
    cells = np.flatnonzero(np.bincount(cell, kept & (np.abs(angle) < np.radians(135))) >= 100)

    def mean(values, where):
        return (
            np.bincount(cell, np.where(where, values, 0)) / np.maximum(np.bincount(cell, where), 1)
        )[cells]

    lining = deformed.label == LINING
    true = mean(now, lining) - mean(radius, lining)
    error = mean(now, still_kept) - mean(radius, kept) - true
    assert len(cells) > 500 and np.abs(true).max() > 0.018
    assert np.abs(error).max() < 2e-4 and np.sqrt(np.mean(error**2)) < 2e-5


def test_one_cylinder_and_a_fixed_limit_delete_the_deformation(deformed):
    for options in ({"surface": "cylinder", "segment": np.inf}, {"surface": "cylinder"}):
        result = effect(filter_lining(deformed.points, AXIS, **options), deformed)
        assert result["emptied"] >= 10 and result["largest_change"] > 2 and result["lost"] > 0.01


def test_few_points_in_a_segment():
    """About 2000 points in 3 m: the surface follows noise a little, and more of the lining is lost
    than of a dense one.
    """
    one = tunnel(6000, seed=2)
    result = filter_lining(one.points, AXIS)
    lining, attachment = one.truth
    assert (
        np.mean(result.flags[attachment] == -1) >= 0.99 and np.mean(result.lining[lining]) >= 0.99
    )


def test_two_fifths_of_the_circumference_behind_cabinets_and_under_the_bed():
    one = tunnel(seed=3, wide=True)
    assert np.mean((one.label == ATTACHMENT) | (one.label == BED)) > 0.4
    result = effect(filter_lining(one.points, AXIS), one)
    assert result["found"] >= 0.995 and result["lost"] <= 0.005 and result["largest_change"] < 0.3


def test_an_axis_a_third_of_a_metre_too_low_does_the_same(deformed, filtered):
    low = straight(np.array([0.02, 0, -0.35]), np.array([0.02, LENGTH, -0.35]))
    result = filter_lining(deformed.points, low)
    assert np.mean(result.flags != filtered.flags) < 0.002
    np.testing.assert_allclose([one.center[1] for one in result.segments], [0.35] * 3, atol=0.002)


def test_a_curved_and_rising_axis_makes_no_difference(deformed):
    """Radius 300 m, grade 2 %: a segment of 3 m bulges by 4 mm, which a straight cylinder would not
    follow.
    """
    coefficients = np.zeros((4, 2, 1))
    coefficients[1:3, :, 0] = [[0.01, 0.02], [1 / 600, 0.0]]
    axis = Axis(np.zeros(3), np.eye(3), np.array([0.0, LENGTH]), coefficients)
    u, y, v = deformed.points.T
    right, up, _ = axis.frame(y)
    result = filter_lining(
        axis.position(y) + u[:, None] * right + v[:, None] * up, axis, segment=3.1
    )
    as_straight = filter_lining(deformed.points, AXIS, segment=3.1)
    assert np.mean(result.flags != as_straight.flags) < 0.0005
    assert (
        np.sqrt(np.mean((result.distances - as_straight.distances)[as_straight.lining] ** 2))
        < 0.0001
    )


def test_motion_and_order_of_the_points(deformed, filtered):
    order = np.random.default_rng(0).permutation(len(deformed.points))
    result = filter_lining(deformed.points[order], AXIS)
    np.testing.assert_array_equal(result.flags, filtered.flags[order])
    np.testing.assert_allclose(result.distances, filtered.distances[order], atol=1e-7)
    c, s = np.cos(0.7), np.sin(0.7)
    turn, place = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]), np.array([1000.0, 2000.0, 100.0])
    axis = straight(place, place + turn @ [0.0, LENGTH, 0.0])
    moved = filter_lining(deformed.points @ turn.T + place, axis)
    assert np.mean(moved.flags != filtered.flags) < 1e-4
    np.testing.assert_allclose(moved.cylinder_distances, filtered.cylinder_distances, atol=1e-6)


def test_segments_and_distances(deformed, filtered):
    segments = filtered.segments
    assert len(segments) == 3 and sum(one.count for one in segments) == len(deformed.points)
    for one, following in zip(segments, segments[1:], strict=False):
        assert one.end == following.start and one.end - one.start <= 3.0
    for number, one in enumerate(segments):
        here = filtered.segment == number
        assert one.converged and one.limit == 3 * one.sigma
        np.testing.assert_array_equal(
            filtered.flags[here] == 0, np.abs(filtered.distances[here]) <= one.limit
        )
        w = deformed.points[here, 1]
        assert one.start - 1e-9 <= w.min() and w.max() <= one.end + 1e-9
    assert abs(segments[1].sigma - 0.0029) < 0.0003
    # The distances from the cylinder hold the deformation, those from the surface do not.
    angle = np.arctan2(deformed.points[:, 0], deformed.points[:, 2])
    at_dent = (
        np.hypot(deformed.points[:, 1] - 5.2, R * (angle - np.radians(40))) < 0.2
    ) & filtered.lining
    assert filtered.cylinder_distances[at_dent].mean() < -0.015
    assert abs(filtered.distances[at_dent].mean()) < 0.001


def test_inputs_are_not_changed_and_the_same_again(deformed, filtered):
    points = deformed.points.copy()
    again = filter_lining(points, AXIS)
    np.testing.assert_array_equal(points, deformed.points)
    np.testing.assert_array_equal(again.distances, filtered.distances)


def test_a_segment_with_too_few_points_is_unsupported(deformed):
    far = np.array([[R * np.sin(a), 14.0 + a, R * np.cos(a)] for a in np.linspace(-1, 1, 40)])
    result = filter_lining(
        np.concatenate([deformed.points, far]), straight(np.zeros(3), np.array([0.0, 15.0, 0.0]))
    )
    assert (result.flags[-40:] == 2).all() and np.isnan(result.distances[-40:]).all()
    assert "at least" in result.segments[-1].stop_reason and not result.segments[-1].converged


def test_bad_input_is_refused(deformed):
    points = deformed.points[:2000]
    for options in (
        {"surface": "plane"},
        {"segment": 0},
        {"segment": 20.0},
        {"threshold": -1},
        {"reach": 0},
        {"segment": np.nan},
    ):
        with pytest.raises(ValueError, match=next(iter(options))):
            filter_lining(points, AXIS, **options)
    with pytest.raises(ValueError, match="at least 100 points"):
        filter_lining(points[:50], AXIS)
    with pytest.raises(ValueError, match="in m, got 26"):
        filter_lining(1000 * points, straight(np.zeros(3), np.array([0.0, 1000 * LENGTH, 0.0])))
    with pytest.raises(ValueError, match="NaN"):
        filter_lining(np.full((200, 3), np.nan), AXIS)


# ------------------------------------------------------------------------------ the residual
# surface


def grid_and_points(n=40_000, seed=0):
    generator = np.random.default_rng(seed)
    grid = lining_surface.PixelGrid.of(R, 2.0, 5.0, n)
    return grid, generator.uniform(-np.pi, np.pi, n), generator.uniform(2.0, 5.0, n), generator


@pytest.mark.parametrize(
    "place, unknowns", [((0.2, 0.0, 0.5, 40), (8, 4)), ((R, 2.0, 5.0, 2_000), (24, 7))]
)
def test_smoothing_is_the_penalised_least_squares_of_the_dense_system(place, unknowns):
    grid = lining_surface.PixelGrid.of(*place)
    assert (grid.across.shape[1], grid.along.shape[1]) == unknowns
    generator = np.random.default_rng(0)
    weights, values = generator.uniform(0, 2, grid.shape), generator.standard_normal(grid.shape)
    weights[: len(weights) // 3] = 0.0
    B = np.kron(grid.across.toarray(), grid.along.toarray())
    N = B.T @ (weights.ravel()[:, None] * B) + lining_surface.RIDGE * np.eye(B.shape[1])
    dense = B @ np.linalg.solve(N, B.T @ (weights * values).ravel())
    np.testing.assert_allclose(grid.smoothed(weights, values).ravel(), dense, atol=1e-12)


def test_the_basis_is_a_partition_of_unity_and_periodic():
    grid, *_ = grid_and_points()
    np.testing.assert_allclose(grid.across.sum(axis=1), 1.0)
    np.testing.assert_allclose(grid.along.sum(axis=1), 1.0)
    centers = (np.arange(grid.shape[0]) + 0.5) * 2 * np.pi / grid.shape[0] - np.pi
    values = np.repeat(np.cos(centers)[:, None], grid.shape[1], axis=1)
    between = grid.interpolated(values, np.array([-np.pi, np.pi, 0.3]), np.array([2.0, 2.0, 5.0]))
    np.testing.assert_allclose(between, np.cos([np.pi, np.pi, 0.3]), atol=1e-4)


def test_a_smooth_surface_is_met_and_narrow_things_leave_it_alone():
    grid, angle, w, generator = grid_and_points()
    true = 0.012 * np.cos(2 * angle) - 0.024 * np.exp(
        -0.5 * ((R * angle / 0.5) ** 2 + ((w - 3.5) / 0.5) ** 2)
    )
    d = true + 0.003 * generator.standard_normal(len(true))
    cable = np.abs(R * (angle - 1.2)) < 0.05
    d[cable] -= 0.03
    surface = lining_surface.fitted(grid, grid.pixels(angle, w), d)
    error = grid.interpolated(surface, angle, w) - true
    assert np.abs(error).max() < 0.003
    assert np.sqrt(np.mean(error**2)) < 0.0006
    assert abs(error[cable].mean()) < 0.0005
