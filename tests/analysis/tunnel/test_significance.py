"""Differences between two epochs: what is put in comes out, nothing else is found, and the tests
keep their false-alarm rate.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom, chi2, norm
from scipy.stats import t as student

from analysis.tunnel.axis import straight
from analysis.tunnel.radii import DIRECTIONS, Radii, equal_angles, local_radii
from analysis.tunnel.sections import cut
from analysis.tunnel.significance import (
    LEVEL,
    classes,
    differences,
    flagged,
    share_beyond,
    significance,
)

AXIS = straight([0, 0, 0], [0, 10, 0])


def epoch(n, rng, sigma=0.003, moved=lambda a: 0.0, shift=(0.0, 0.0), hole=None):
    """One section of n points: an oval ring, moved outwards by ``moved(α)``, registered with an
    error (right, up).
    """
    a = rng.uniform(-np.pi, np.pi, n)
    if hole is not None:
        a = a[(a < hole[0]) | (a > hole[1])]
    r = 2.7 + 0.01 * np.cos(2 * a) + moved(a) + sigma * rng.standard_normal(len(a))
    along = 5.0 + rng.uniform(-0.025, 0.025, len(a))
    points = np.stack(
        [r * np.sin(a) + shift[0] + 0.1, along, r * np.cos(a) + shift[1] + 0.2], axis=-1
    )
    return cut(points, AXIS, [5.0])[0]


def known(radius, sd, freedom, directions=DIRECTIONS, reach=0.5):
    """Radii given outright."""
    ones = np.ones(len(directions))
    radius, sd, freedom = radius * ones, sd * ones, freedom * ones
    return Radii(directions, radius, sd, freedom, freedom + 1, ones > 1, np.radians(reach) * ones)


def estimated(B, freedom, rng, sd=0.001, shift=0.0, directions=DIRECTIONS[::10]):
    """B pairs of epochs without deformation, each variance estimated with ``freedom`` degrees; they
    share a registration error.
    """
    for _ in range(B):
        t = shift * rng.standard_normal(2)
        radii = []
        for common in (0.0, t[0] * np.sin(directions) + t[1] * np.cos(directions)):
            s = sd * np.sqrt(
                np.sum(rng.standard_normal((freedom, len(directions))) ** 2, axis=0) / freedom
            )
            radii.append(
                known(
                    2.7 + common + sd * rng.standard_normal(len(directions)), s, freedom, directions
                )
            )
        yield radii


def no_more_than(rate, count, trials):
    """Whether ``count`` of ``trials`` is compatible with a probability of at most ``rate``."""
    return binom.sf(count - 1, trials, rate) > 1e-3


# --------------------------------------------------------------------------------- differences and
# classes


@pytest.mark.parametrize("read", [equal_angles, local_radii])
def test_the_same_epoch_twice_gives_zero(read):
    section = epoch(3000, np.random.default_rng(1))
    radii = read(section)
    delta = differences(radii, radii)
    assert np.all(delta[~radii.gaps] == 0.0) and np.isnan(delta[radii.gaps]).all()
    assert set(classes(delta).ravel()) <= {"black", "gap"} and not flagged(delta)
    if read is local_radii:
        verdict = significance(radii, radii)
        assert (
            verdict.p_value == pytest.approx(1.0)
            and not verdict.changed
            and not verdict.significant.any()
        )


def test_an_injected_deformation_reappears():
    moved = lambda a: 0.0065 - 0.0178 * np.cos(2 * a)  # noqa: E731  crown −11.3 mm, sides +24.3 mm
    rng = np.random.default_rng(2)
    first, second = (local_radii(epoch(20_000, rng, moved=m)) for m in (lambda a: 0.0, moved))
    delta = differences(first, second)
    # Seen from a pole 0.2 m off the centre, directions and radial senses differ by up to 0.2/2.7
    # rad.
    centre = np.arctan2(
        first.radius * np.sin(DIRECTIONS) - 0.1, first.radius * np.cos(DIRECTIONS) - 0.2
    )
    assert np.abs(delta - moved(centre) / np.cos(DIRECTIONS - centre)).max() < 0.004
    assert np.sqrt(np.mean((delta - moved(centre)) ** 2)) < 0.0015
    assert flagged(delta) and significance(first, second, registration=0.002).changed
    colour = classes(delta)
    assert (
        colour[np.abs(delta) > 0.012].tolist() == ["red"] * np.count_nonzero(np.abs(delta) > 0.012)
        and "black" in colour
    )


def test_exact_epochs_give_the_exact_difference_and_a_shift_is_no_change():
    """Seen from a pole 0.2 m off the centre the shift is no plain cosine, and yet is told from a
    deformation.
    """
    first, second = (
        local_radii(epoch(30_000, np.random.default_rng(3), sigma=0.0, shift=s))
        for s in ((0, 0), (0.0, -0.005))
    )
    delta = differences(first, second)
    alpha = np.linspace(-3.0, 3.0, 200_001)
    r = 2.7 + 0.01 * np.cos(2 * alpha)
    x, z = r * np.sin(alpha) + 0.1, r * np.cos(alpha) + 0.2
    seen = [np.interp(DIRECTIONS, np.arctan2(x, v), np.hypot(x, v)) for v in (z, z - 0.005)]
    assert np.abs(delta - (seen[1] - seen[0])).max() < 1e-6
    assert significance(first, second).changed
    known_noise = [
        replace(radii, sd=np.full(len(DIRECTIONS), 3e-5), freedom=np.full(len(DIRECTIONS), 50.0))
        for radii in (first, second)
    ]
    assert not significance(*known_noise, registration=0.005).changed
    # ten standard deviations from the plain cosine
    assert np.abs(delta + 0.005 * np.cos(DIRECTIONS)).max() > 3e-4


def test_gaps_of_either_epoch_are_gaps_of_the_difference():
    rng = np.random.default_rng(4)
    first = local_radii(epoch(8000, rng, hole=np.radians([10, 50])))
    second = local_radii(epoch(8000, rng, hole=np.radians([-60, -20])))
    delta = differences(first, second)
    assert (
        np.array_equal(np.isnan(delta), first.gaps | second.gaps)
        and first.gaps.any()
        and second.gaps.any()
    )
    verdict = significance(first, second)
    assert (
        not verdict.significant[np.isnan(delta)].any() and not verdict.tested[np.isnan(delta)].any()
    )
    assert (
        np.isnan(verdict.limit[np.isnan(delta)]).all()
        and np.isfinite(verdict.limit[~np.isnan(delta)]).all()
    )
    assert (classes(delta) == "gap").sum() == np.isnan(delta).sum()


def test_share_counts_the_directions_seen_only():
    delta = np.array([0.0, 0.007, np.nan, np.nan, -0.02, 0.006])
    assert share_beyond(delta) == 0.5 and flagged(delta)
    assert share_beyond(delta, 0.012) == 0.25


# --------------------------------------------------------------------------------- the fixed
# threshold


def test_false_alarms_of_printed_sections_are_those_of_single_points():
    rng, share = np.random.default_rng(6), []
    for _ in range(4):
        first, second = (equal_angles(epoch(60_000, rng, sigma=0.003)) for _ in range(2))
        share.append(share_beyond(differences(first, second)))
    assert np.mean(share) == pytest.approx(2 * norm.sf(6 / (3 * np.sqrt(2))), abs=0.03)


# --------------------------------------------------------------------------------- significance


def test_level_of_detection_adds_registration_in_quadrature():
    verdict = significance(
        known(2.7, 0.003 / np.sqrt(20), 1e9),
        known(2.7, 0.003 / np.sqrt(20), 1e9),
        registration=0.001,
    )
    assert np.allclose(verdict.limit, 1.959964 * np.sqrt(2 * 0.003**2 / 20 + 0.001**2), rtol=1e-6)
    few = significance(known(2.7, 0.001, 4.0), known(2.7, 0.002, 9.0))
    freedom = 5e-6**2 / (1e-6**2 / 4 + 4e-6**2 / 9)
    assert np.allclose(few.freedom, freedom) and np.allclose(
        few.limit, student.isf(0.025, freedom) * np.sqrt(5e-6)
    )


def test_limits_with_a_covariance_follow_the_direction():
    directions = np.radians([0.0, 90.0, -90.0])
    radii = known(2.7, 1e-6, 1e9, directions)
    limit = significance(radii, radii, registration=np.diag([0.001, 0.003]) ** 2).limit / 1.959964
    assert np.allclose(limit, [0.003, 0.001, 0.001], rtol=1e-3)
    with_radius = (
        significance(radii, radii, registration=np.diag([0.001, 0.003, 0.002]) ** 2).limit
        / 1.959964
    )
    assert np.allclose(with_radius, np.hypot(limit, 0.002), rtol=1e-3)


def test_motion_and_shape_divide_the_dense_quadratic_form():
    """Where the variances are known, δᵀ(D + AΣAᵀ)⁻¹δ = T² + χ², with p and m − p degrees of
    freedom.
    """
    rng, directions = np.random.default_rng(7), DIRECTIONS[::3]
    Sigma = np.array([[4.0, 1.0], [1.0, 2.0]]) * 1e-6
    change = 0.002 * rng.standard_normal(len(directions)) + 0.005 * np.cos(directions)
    # The mean of both is a circle, in which a motion is a cosine.
    verdict = significance(
        *(known(2.7 + 0.5 * sign * change, 0.00125, 1e9, directions) for sign in (-1, 1)),
        registration=Sigma,
    )
    A = np.stack([np.sin(directions), np.cos(directions)], axis=-1)
    D = np.diag(np.full(len(directions), 2 * 0.00125**2))
    t = np.linalg.lstsq(A, verdict.delta)[0]
    shape = np.sum((verdict.delta - A @ t) ** 2) / D[0, 0]
    whole = verdict.delta @ np.linalg.solve(D + A @ Sigma @ A.T, verdict.delta)
    assert verdict.tested.all()
    assert chi2.isf(verdict.p_shape, len(directions) - 2) == pytest.approx(shape, rel=1e-6)
    assert chi2.isf(verdict.p_motion, 2) == pytest.approx(whole - shape, rel=1e-6)
    assert verdict.p_value == 2 * verdict.p_motion < 0.1


def uneven(B, rng, directions=DIRECTIONS[::10]):
    """B pairs of epochs without deformation, in whose directions there are from 4 to 40 points of a
    noise that grows along them.
    """
    points = rng.integers(4, 41, len(directions))
    sd, freedom = np.linspace(0.002, 0.004, len(directions)) / np.sqrt(points), points - 3
    for _ in range(B):
        radii = []
        for _ in range(2):
            squares = rng.standard_normal((37, len(directions))) ** 2
            s = sd * np.sqrt(
                np.sum(squares, axis=0, where=np.arange(37)[:, None] < freedom) / freedom
            )
            noise = sd * rng.standard_normal(len(directions))
            radii.append(
                replace(known(2.7 + noise, s, freedom, directions), count=points.astype(float))
            )
        yield radii


def test_each_part_of_the_test_of_a_section_keeps_its_level_with_few_and_uneven_points():
    """Without a registration error, so that all rests on variances estimated with 1 to 37 degrees
    of freedom.

    Weights from these variances, the best if they were known, give false alarms of a motion in
    twice as many sections.
    """
    B = 1500
    verdicts = [significance(*pair) for pair in uneven(B, np.random.default_rng(13))]
    motion, shape = (
        sum(p < LEVEL for p in of)
        for of in zip(*((v.p_motion, v.p_shape) for v in verdicts), strict=True)
    )
    assert no_more_than(LEVEL, motion, B) and no_more_than(LEVEL, shape, B)
    assert motion > 0.6 * LEVEL * B  # and not by never finding one
    assert no_more_than(LEVEL, sum(v.changed for v in verdicts), B)


def test_a_motion_is_found_as_a_motion_and_a_squat_as_a_shape():
    rng, directions = np.random.default_rng(14), DIRECTIONS[::10]
    noise = 0.001 * rng.standard_normal((2, len(directions)))

    def verdict(change):
        epochs = (
            known(2.7 + error, 0.001, 10, directions) for error in (noise[0], noise[1] + change)
        )
        return significance(*epochs, registration=0.0014)

    moved, squashed = (
        verdict(0.008 * np.cos(directions - 0.5)),
        verdict(0.003 * np.cos(2 * directions)),
    )
    assert moved.p_motion < 1e-4 and moved.p_shape > LEVEL and moved.changed
    assert squashed.p_shape < 1e-4 and squashed.p_motion > LEVEL and squashed.changed


def test_no_registration_error_touches_the_shape():
    rng, directions = np.random.default_rng(15), DIRECTIONS[::10]
    first, second = (
        known(2.7 + 0.001 * rng.standard_normal(len(directions)), 0.001, 10, directions)
        for _ in range(2)
    )
    shapes = {significance(first, second, registration=sd).p_shape for sd in (0.0, 0.001, 0.1)}
    assert len(shapes) == 1 and 0 < shapes.pop() < 1
    motions = [significance(first, second, registration=sd).p_motion for sd in (0.0, 0.001, 0.1)]
    assert motions == sorted(motions)


@pytest.mark.parametrize(
    ("degrees", "testable"), [([10.0], False), ([10.0, 80.0], False), ([10.0, 80.0, 150.0], True)]
)
def test_what_could_all_be_a_motion_has_no_shape(degrees, testable):
    directions = np.radians(degrees)
    first, second = (
        known(2.7, 0.001, 10.0, directions),
        known(2.7 + 0.01 * np.cos(3 * directions), 0.001, 10.0, directions),
    )
    verdict = significance(first, second)
    assert verdict.p_motion < 0.01 and (verdict.p_shape < 1) == testable
    assert significance(first, second, registration=0.05).p_motion > 0.5


def test_few_directions_say_little_and_flag_nothing():
    delta = np.full(100, np.nan)
    delta[:24] = 0.02
    assert not flagged(delta) and share_beyond(delta) == 1.0
    delta[24] = 0.02
    assert flagged(delta)


@pytest.mark.parametrize("freedom", [2, 5, 30])
@pytest.mark.parametrize("shift", [0.0, 0.003])
def test_false_alarms_stay_below_the_level_with_a_common_registration_error(freedom, shift):
    B, rng = 400, np.random.default_rng(8)
    verdicts = [
        significance(*pair, registration=shift) for pair in estimated(B, freedom, rng, shift=shift)
    ]
    assert no_more_than(LEVEL, sum(v.changed for v in verdicts), B)
    single = np.mean([v.significant.mean() for v in verdicts])
    # Directions of a section fail together under a common error, so their share scatters more.
    assert single < LEVEL + 4 * np.std([v.significant.mean() for v in verdicts]) / np.sqrt(B)


def test_without_the_registration_error_the_false_alarms_pile_up():
    pairs = estimated(200, 30, np.random.default_rng(9), shift=0.003)
    assert np.mean([significance(*pair).changed for pair in pairs]) > 0.5


@pytest.mark.parametrize("n", [400, 2000])
def test_false_alarms_from_points_to_verdict(n):
    B, rng, registration = 50, np.random.default_rng(10), 0.0015
    changed, single = 0, []
    for _ in range(B):
        first = local_radii(epoch(n, rng))
        second = local_radii(epoch(n, rng, shift=registration * rng.standard_normal(2)))
        verdict = significance(first, second, registration=registration)
        changed += verdict.changed
        single.append(verdict.significant[~np.isnan(verdict.delta)].mean())
    assert no_more_than(LEVEL, changed, B)
    assert np.mean(single) < LEVEL + 3 * np.std(single) / np.sqrt(B)


def test_a_shape_is_found_below_the_registration_error_but_a_shift_is_not():
    rng, directions = np.random.default_rng(11), DIRECTIONS[::3]
    noise = 0.0005 * rng.standard_normal((2, len(directions)))
    first = known(2.7 + noise[0], 0.0005, 20, directions)
    shifted = known(2.7 + 0.003 * np.cos(directions) + noise[1], 0.0005, 20, directions)
    squashed = known(2.7 + 0.003 * np.cos(2 * directions) + noise[1], 0.0005, 20, directions)
    assert (
        significance(first, shifted).changed
        and not significance(first, shifted, registration=0.003).changed
    )
    assert significance(first, squashed, registration=0.003).changed
    assert not significance(first, squashed, registration=0.003).significant.all()


def test_the_section_test_takes_directions_that_share_no_points():
    wide = known(2.7, 0.001, 10.0, reach=2.0)
    tested = np.flatnonzero(significance(wide, known(2.7, 0.001, 10.0)).tested)
    assert np.all(np.diff(tested) >= 4) and len(tested) == 68  # 271 directions, each 4° of points
    around = np.radians(np.arange(-180.0, 180.0))
    assert (
        significance(known(2.7, 0.001, 10.0, around), known(2.7, 0.001, 10.0, around)).tested.sum()
        == 360
    )
    turned = significance(
        known(2.7, 0.001, 10.0, around, 2.0), known(2.7, 0.001, 10.0, around, 2.0)
    ).tested
    assert turned.sum() == 90


def test_swapping_the_epochs_changes_the_sign_alone():
    rng = np.random.default_rng(12)
    first, second = (
        local_radii(epoch(2000, rng)),
        local_radii(epoch(3000, rng, moved=lambda a: 0.003 * np.cos(3 * a))),
    )
    one, other = (
        significance(first, second, registration=0.001),
        significance(second, first, registration=0.001),
    )
    assert np.allclose(one.delta, -other.delta, equal_nan=True) and one.p_value == pytest.approx(
        other.p_value
    )
    assert np.array_equal(one.significant, other.significant)


# --------------------------------------------------------------------------------- refusals

GOOD = known(2.7, 0.001, 10.0)
BLIND = replace(GOOD, radius=np.full(len(DIRECTIONS), np.nan))


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda: differences(GOOD, known(2.7, 0.001, 10.0, DIRECTIONS + 0.1)), "at other angles"),
        (
            lambda: differences(GOOD, known(2.7, 0.001, 10.0, DIRECTIONS[:5])),
            r"got shape \(5,\) beside \(271,\)",
        ),
        (lambda: significance(GOOD, BLIND), "seen in both epochs, got 271 gaps"),
        (lambda: share_beyond([np.nan, np.nan]), "seen in both epochs, got 2 gaps"),
        (
            lambda: significance(GOOD, replace(GOOD, sd=np.full(len(DIRECTIONS), np.nan))),
            "without; local_radii gives them",
        ),
        (
            lambda: significance(*[equal_angles(epoch(500, np.random.default_rng(1)))] * 2),
            "one radius a direction",
        ),
        (
            lambda: significance(GOOD, GOOD, registration=-1.0),
            "registration: expected a standard deviation",
        ),
        (
            lambda: significance(GOOD, GOOD, registration=np.eye(4)),
            r"covariance matrix \(2, 2\) or \(3, 3\)",
        ),
        (
            lambda: significance(GOOD, GOOD, registration=np.diag([1.0, -1.0])),
            "without negative variances",
        ),
        (lambda: significance(GOOD, GOOD, registration=[[1.0, 2.0], [0.0, 1.0]]), "symmetric"),
        (lambda: significance(GOOD, GOOD, level=0.0), "level: expected a positive"),
        (lambda: share_beyond([0.0], -0.006), "limit: expected a positive"),
    ],
)
def test_bad_input_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()
