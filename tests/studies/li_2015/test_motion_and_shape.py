"""A motion of the ring and a change of its shape are told apart."""

import numpy as np
import pytest

from analysis.tunnel.outlines import ANGLES, deformation
from studies.li_2015.motion_and_shape import split

from ...analysis.tunnel.exact_outlines import CIRCLE, FLATTENED, REGISTRATION, known


def test_a_ring_that_moves_as_a_whole_has_no_change_of_shape():
    move = np.array([0.003, -0.008])
    change = deformation(
        known(FLATTENED), known(FLATTENED + np.append(move, [0, 0, 0])), registration=REGISTRATION
    )
    parts = split(change)
    np.testing.assert_allclose(parts.translation, move, atol=5e-5)
    assert abs(parts.mean) < 2e-5 and np.abs(parts.shape).max() < 1e-4
    np.testing.assert_allclose(parts.translation_covariance, REGISTRATION, rtol=0.03)
    np.testing.assert_allclose(
        parts.mean + parts.rigid + parts.shape, change.difference, atol=1e-15
    )


def test_a_change_of_shape_is_not_taken_for_a_motion():
    change = deformation(known(CIRCLE), known(CIRCLE + [0, 0, 0.001, 0.010, 0]), pole=CIRCLE[:2])
    parts = split(change)
    assert np.abs(parts.translation).max() < 1e-5
    np.testing.assert_allclose(parts.mean, 0.001, atol=5e-5)
    np.testing.assert_allclose(parts.shape, -0.010 * np.cos(2 * ANGLES), atol=1e-4)


def test_too_few_directions_or_a_large_gap_are_refused():
    for angles, message in (
        ([0.0, 1.0], "directions: expected at least 9"),
        (np.linspace(0.0, 0.1, 20), "directions: expected some all around the section"),
    ):
        with pytest.raises(ValueError, match=message):
            split(deformation(known(CIRCLE), known(CIRCLE), angles=angles))
