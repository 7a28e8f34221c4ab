"""The checks of input, and that their messages name what was expected and what came."""

import numpy as np
import pytest

from analysis.blocks import BLOCK, pieces
from analysis.checks import (
    check_one_of,
    check_positive,
    finite_array,
    point_array,
    real_array,
    weight_array,
)


@pytest.mark.parametrize(
    ("count", "size"), [(0, 3), (1, 3), (3, 3), (7, 3), (9, 3), (BLOCK + 1, BLOCK)]
)
def test_pieces_cover_everything_once(count, size):
    found = pieces(count, size)
    assert [i for piece in found for i in range(count)[piece]] == list(range(count))
    assert all(0 < piece.stop - piece.start <= size for piece in found)


def test_float64_is_not_copied():
    array = np.arange(6.0)
    assert np.shares_memory(real_array(array, "x"), array)
    assert np.shares_memory(finite_array(array[::2], "x"), array)


@pytest.mark.parametrize(
    "values",
    [
        [1, 2],
        (1.0, 2.0),
        np.float32([1, 2]),
        np.uint8([1, 2]),
        np.array([1, 2], dtype=object),
        range(1, 3),
    ],
)
def test_real_numbers_become_float64(values):
    array = real_array(values, "x")
    assert array.dtype == np.float64
    np.testing.assert_array_equal(array, [1, 2])


@pytest.mark.parametrize(
    "values",
    [
        "12",
        ["1", "2"],
        [1j],
        np.array([True]),
        [[1], [1, 2]],
        [{}],
        np.array(["2020"], "M8[Y]"),
        b"12",
    ],
)
def test_what_is_no_real_number_is_refused(values):
    with pytest.raises(ValueError, match="^x: expected an array of real numbers, got "):
        real_array(values, "x")


def test_missing_values_count_as_not_finite():
    with pytest.raises(ValueError, match="x: expected finite numbers, got 1 NaN or infinite of 2"):
        finite_array([1.0, None], "x")


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_every_place_is_looked_at(bad):
    """Also behind the first block."""
    array = np.zeros((3, BLOCK))
    array[1, 5] = array[2, -1] = bad
    with pytest.raises(
        ValueError, match=f"^x: expected finite numbers, got 2 NaN or infinite of {3 * BLOCK}$"
    ):
        finite_array(array, "x")


def test_points():
    points = np.zeros((2, 5, 3))
    assert np.shares_memory(point_array(points, 3, 4, "a sphere"), points)
    for bad, message in [
        (np.zeros(3), r"points: expected shape \(…, n, 3\), got \(3,\)"),
        (np.zeros((5, 2)), r"points: expected shape \(…, n, 3\), got \(5, 2\)"),
        (
            np.zeros((2, 3, 3)),
            r"points: expected at least 4 points for a sphere, got 3 \(shape \(2, 3, 3\)\)",
        ),
        (
            np.zeros((0, 5, 3)),
            r"points: expected at least one cloud, got an empty stack of shape \(0, 5, 3\)",
        ),
        (np.full((5, 3), np.nan), "points: expected finite numbers, got 15 NaN or infinite of 15"),
    ]:
        with pytest.raises(ValueError, match=message):
            point_array(bad, 3, 4, "a sphere")


def test_weights():
    assert weight_array([1, 2, 3], (2, 3)).shape == (2, 3)
    assert weight_array(np.ones((2, 3)), (2, 3)).shape == (2, 3)
    for bad, message in [
        (1.0, r"w: expected shape \(2, 3\) or \(3,\), got \(\)"),
        ([1.0], r"w: expected shape \(2, 3\) or \(3,\), got \(1,\)"),
        (np.ones((3, 3)), r"w: expected shape \(2, 3\) or \(3,\), got \(3, 3\)"),
        (np.ones((2, 2, 3)), r"w: expected shape \(2, 3\) or \(3,\), got \(2, 2, 3\)"),
        ([1.0, 0.0, 2.0], "w: expected positive numbers, got a smallest value of 0"),
        ([1.0, -0.5, 2.0], "w: expected positive numbers, got a smallest value of -0.5"),
        ([1.0, np.inf, 2.0], "w: expected finite numbers, got 1 NaN or infinite of 3"),
    ]:
        with pytest.raises(ValueError, match=message):
            weight_array(bad, (2, 3), "w")


@pytest.mark.parametrize("value", [1, 0.5, np.float32(2), np.array(3.0), "1e-3"])
def test_positive_numbers_pass(value):
    assert check_positive(value, "x") == float(value)


@pytest.mark.parametrize("value", [0, -1, np.nan, np.inf, "a", None, [1, 2], 1j])
def test_other_values_are_refused(value):
    with pytest.raises(ValueError, match="^x: expected a positive finite number, got "):
        check_positive(value, "x")


def test_one_of_lists_the_known():
    assert check_one_of("b", {"a": 1, "b": 2}, "x") == "b"
    with pytest.raises(ValueError, match="^x: expected one of a, b; got 'c'$"):
        check_one_of("c", {"a": 1, "b": 2}, "x")
    with pytest.raises(ValueError, match=r"^x: expected one of a, b; got \['a'\]$"):
        check_one_of(["a"], {"a": 1, "b": 2}, "x")
