"""Two epochs compared: nothing changes by itself, what is put in comes out, and what cannot be
compared is refused.
"""

import re

import numpy as np
import pandas as pd
import pytest

from analysis.tunnel.axis import straight
from analysis.tunnel.comparison import STEPS, EpochComparison, compare
from analysis.tunnel.radii import DIRECTIONS

LENGTH, RADIUS, NOISE = 6.0, 2.7, 0.002
AXIS = straight([0.0, 0.0, 0.0], [0.0, LENGTH, 0.0])
CHAINAGES = [0.5, 3.0, 5.5]
OPEN_TO = np.radians(145.0)  # the invert is hidden beyond
CUT = {"chainages": CHAINAGES, "thickness": 0.4}
MIDDLE = 1  # the section where the ring is ovalised most


def tube(seed, *, ovalised=0.0, count=8_000, start=0.0, end=LENGTH, open_to=OPEN_TO):
    """Points of a round tunnel along Y, its invert hidden; ``ovalised`` (m): down at the crown and
    out at the sides around the middle.
    """
    rng = np.random.default_rng(seed)
    alpha, y = rng.uniform(-open_to, open_to, count), rng.uniform(start, end, count)
    rho = (
        RADIUS
        + NOISE * rng.standard_normal(count)
        - ovalised * np.cos(2.0 * alpha) * np.exp(-((y - 0.5 * (start + end)) ** 2))
    )
    points = np.column_stack([rho * np.sin(alpha), y, rho * np.cos(alpha)])
    points.flags.writeable = False
    return points


def turned(points, degrees, shift):
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return points @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]).T + shift


@pytest.fixture(scope="module")
def quiet():
    return tube(1)


@pytest.fixture(scope="module")
def oval():
    return tube(2, ovalised=0.020)


@pytest.fixture(scope="module")
def result(quiet, oval):
    return compare(quiet, oval, axis=AXIS, **CUT)


def test_an_epoch_has_not_changed_against_itself(quiet):
    same = compare(quiet, quiet, axis=AXIS, registration=0.0, **CUT)
    directions, table = same.by_direction(), same.table()
    assert (directions["difference_mm"].dropna() == 0).all() and directions[
        "difference_mm"
    ].notna().mean() > 0.95
    assert not directions["significant"].any() and set(directions["class"]) <= {"black", "gap"}
    assert not table["flagged"].any() and not table["changed"].any()
    assert (table["p_value"] == 1).all() and (table["largest_change_mm"] == 0).all()


def test_an_ovalised_stretch_comes_out_where_it_was_put_in(result):
    table = result.table()
    row = table.iloc[MIDDLE]
    assert abs(row["crown_settlement_mm"] - 20.0) < 3 * row["crown_settlement_sd_mm"] < 5.0
    assert (
        abs(row["horizontal_convergence_mm"] - 40.0) < 3 * row["horizontal_convergence_sd_mm"] < 5.0
    )
    assert abs(abs(row["largest_change_mm"]) - 20.0) < 3 * row["largest_change_sd_mm"]
    assert row["flagged"] and row["changed"] and row["seen_percent"] == 100.0
    far = table.iloc[[0, 2]]  # e⁻⁶ of it is left there: 0.05 mm
    assert not far["flagged"].any() and not far["changed"].any()
    assert (far["crown_settlement_mm"].abs() < 3 * far["crown_settlement_sd_mm"]).all()


def test_the_classes_lie_where_the_ring_has_moved(result):
    rows = result.sections[MIDDLE].by_direction()
    expected = -20.0 * np.cos(2.0 * np.radians(rows["angle_deg"]))
    assert set(rows["class"][expected.abs() > 16]) == {"red"}
    assert set(rows["class"][expected.abs() < 2]) == {"black"}
    assert (rows["significant"][expected.abs() > 12]).all()
    assert np.sqrt(np.mean((rows["ellipse_difference_mm"] - expected) ** 2)) < 1.0
    assert np.sqrt(np.mean((rows["difference_mm"] - expected) ** 2)) < 3.0


@pytest.mark.parametrize("shift, changed", [(0.0005, False), (0.008, True)])
def test_a_shift_counts_beyond_the_stated_registration_error(quiet, shift, changed):
    moved = tube(3) + np.array([0.0, 0.0, shift])
    known = compare(quiet, moved, axis=AXIS, registration=0.001, **CUT).table()
    assert (known["changed"] == changed).all()
    # To one who is told that the registration is ten times worse neither shift is a change.
    assert not compare(quiet, moved, axis=AXIS, registration=0.010, **CUT).table()["changed"].any()


def test_the_registration_is_in_the_standard_deviations(quiet, oval):
    covariances = np.array([[[4e-6, 1e-6], [1e-6, k * 1e-6]] for k in range(1, 4)])
    exact = compare(quiet, oval, axis=AXIS, registration=0.0, **CUT).table()
    found = compare(quiet, oval, axis=AXIS, registration=covariances, **CUT).table()
    added = found["crown_settlement_sd_mm"] ** 2 - exact["crown_settlement_sd_mm"] ** 2
    # the ovalised ring is not level everywhere above the axis
    np.testing.assert_allclose(added, [1, 2, 3], rtol=0.02)
    pd.testing.assert_series_equal(found["crown_settlement_mm"], exact["crown_settlement_mm"])


def test_direction_and_site_coordinates_do_not_matter(quiet, oval, result):
    shift = np.array([500_000.0, 4_000_000.0, 123.0])
    ends = turned(np.array([[0.0, 0.0, 0.0], [0.0, LENGTH, 0.0]]), 130.0, shift)
    elsewhere = compare(
        turned(quiet, 130.0, shift), turned(oval, 130.0, shift), axis=straight(*ends), **CUT
    )
    pd.testing.assert_frame_equal(elsewhere.table(), result.table(), rtol=1e-3, atol=1e-3)


def test_the_other_sense_of_the_axis_is_the_mirror_image(quiet, oval, result):
    reversed_axis = straight([0.0, LENGTH, 0.0], [0.0, 0.0, 0.0])
    mirrored = compare(
        quiet, oval, axis=reversed_axis, chainages=LENGTH - np.array(CHAINAGES), thickness=0.4
    )
    for one, other in zip(result.sections, mirrored.sections, strict=True):
        np.testing.assert_allclose(other.change.difference[::-1], one.change.difference, atol=5e-5)
        assert other.significance.changed == one.significance.changed


def test_the_axis_is_found_and_the_steps_are_reported():
    steps, place = [], [5e5, 4e6, 0.0]
    quiet, oval = (
        turned(tube(seed, ovalised=ovalised, end=9.0, count=12_000), 33.0, place)
        for seed, ovalised in ((6, 0.0), (7, 0.02))
    )
    found = compare(quiet, oval, spacing=2.0, thickness=0.4, report=steps.append)
    assert tuple(steps) == STEPS
    assert found.converged and abs(found.axis.length - 9.0) < 1.0
    chainages = [section.chainage for section in found.sections]
    np.testing.assert_allclose(np.diff(chainages), 2.0)
    assert 0.0 <= chainages[0] < 0.5 and found.axis.length - chainages[-1] < 2.5
    y = [turned(section.sections[0].position - place, -33.0, 0.0)[1] for section in found.sections]
    settled, table = 20.0 * np.exp(-((np.array(y) - 4.5) ** 2)), found.table()
    assert (
        np.abs(table["crown_settlement_mm"] - settled) < 3 * table["crown_settlement_sd_mm"]
    ).all() and settled.max() > 15.0


def test_a_section_unseen_in_one_epoch_says_so(quiet, oval, result):
    y = oval[:, 1]
    hole = oval[(np.abs(y - 0.5) > 0.4) & ~((np.abs(y - 5.5) < 0.4) & (oval[:, 0] < 1.0))]
    found = compare(quiet, hole, axis=AXIS, **CUT)
    table = found.table()
    unseen, partly = table.iloc[0], table.iloc[2]
    assert unseen["points_2"] == 0 and unseen["seen_percent"] == 0.0
    assert unseen[["p_value", "largest_change_mm", "crown_settlement_mm"]].isna().all()
    assert unseen["note"] == "0 points of lining in the second epoch, 50 are needed"
    assert 0 < partly["seen_percent"] < 50 and partly["note"].endswith(
        "% of the directions seen in both epochs, 50 % are needed"
    )
    assert not table.loc[[0, 2], ["flagged", "changed"]].to_numpy().any() and not np.isnan(
        partly["p_value"]
    )
    assert table.loc[MIDDLE, "changed"] and table.loc[MIDDLE, "note"] == "" and found.converged
    directions = found.sections[0].by_direction()
    assert set(directions["class"]) == {"gap"} and directions["ellipse_difference_mm"].isna().all()
    assert len(found.by_direction()) == len(CHAINAGES) * len(DIRECTIONS)


def test_the_largest_change_is_one_that_is_seen(quiet, oval):
    # the crown of the second epoch
    unseen = np.abs(np.arctan2(oval[:, 0], oval[:, 2])) < np.radians(30.0)
    row = compare(quiet, oval[~unseen], axis=AXIS, **CUT).table().iloc[MIDDLE]
    assert abs(row["at_deg"]) > 60.0 and 15.0 < row["largest_change_mm"] < 25.0


def test_the_sections_hold_points_of_the_lining_only(quiet, oval):
    cable = np.column_stack(
        [np.full(2000, -2.45), np.linspace(0, LENGTH, 2000), np.full(2000, 0.6)]
    )
    cluttered = np.concatenate([oval, cable])
    found = compare(quiet, cluttered, axis=AXIS, **CUT)
    for section in found.sections:
        second = section.sections[1]
        assert (second.index < len(oval)).all()
        np.testing.assert_allclose(cluttered[second.index][:, 0], second.u, atol=1e-12)
    assert not found.table().loc[[0, 2], "changed"].any()


def test_epochs_that_overlap_partly_are_compared_where_they_do(quiet):
    later = tube(5, start=3.0, end=LENGTH + 3.0)
    beyond = later[:, 1] > LENGTH + 1.0
    # where no axis is known it may lead elsewhere
    later = np.where(beyond[:, None], later + [20.0, 0.0, 0.0], later)
    found = compare(quiet, later, axis=AXIS, spacing=1.3, thickness=0.4)
    chainages = [section.chainage for section in found.sections]
    assert 3.0 <= chainages[0] < 3.1 and chainages[-1] < LENGTH and len(chainages) == 3
    assert (found.table()["note"] == "").all()


def test_every_column_is_described(result):
    described = EpochComparison.table.__doc__.replace("`…_sd_mm`", "")
    for column in result.table():
        assert column in described or column.replace("_sd_mm", "_mm") in described
    described = EpochComparison.by_direction.__doc__
    assert all(f"`{column}`" in described for column in result.by_direction())


# ----------------------------------------------------------------------------- what is refused


def refusal(first, second, **options):
    with pytest.raises(ValueError) as raised:
        compare(first, second, **options)
    return str(raised.value)


def test_millimetres_are_refused(quiet, oval):
    assert (message := refusal(1000 * tube(8, end=9.0), oval)).startswith(
        "first: points: "
    ) and "are these metres" in message
    assert refusal(quiet, 1000 * oval, axis=AXIS).startswith(
        "second: expected an epoch in the unit (m) and system of the first"
    )


def test_another_place_is_refused(quiet, oval):
    for far in ([5e5, 4e6, 0.0], [0.0, 40.0, 0.0]):
        message = refusal(quiet, oval + far, axis=AXIS)
        assert message.startswith(
            "second: expected an epoch in the unit (m) and system of the first that overlaps with "
            "it"
        )
    message = refusal(quiet, oval + [8.0, 0.0, 0.0], axis=AXIS)
    assert message.startswith("second: ") and re.search(
        r"half of whose points lie within 2\.\d+ m of its axis; got [78]\.\d+ m", message
    )


def test_no_tunnel_is_refused(quiet, oval):
    assert "at least 1.5 times as long as wide and high, with Z up" in refusal(
        tube(8, end=9.0)[:, [0, 2, 1]], oval
    )
    # without an axis a tunnel of 6 m is too short to tell where it runs
    assert "at least 1.5 times" in refusal(quiet, oval)
    assert refusal(quiet, oval[:10]).startswith("second: points: expected at least 100 points")
    assert refusal(quiet, oval[:, :2]).startswith("second: points: expected shape")


@pytest.mark.parametrize(
    "options",
    [{"spacing": 0.0}, {"thickness": -1.0}, {"registration": -0.001}, {"registration": np.eye(3)}],
)
def test_bad_values_are_named(options, quiet, oval):
    assert refusal(quiet, oval, axis=AXIS, **options).startswith(next(iter(options)))


def test_chainages_beyond_the_axis_are_refused(quiet, oval):
    assert "chainages" in refusal(quiet, oval, axis=AXIS, chainages=[20.0])
