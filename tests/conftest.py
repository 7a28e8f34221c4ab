"""Clouds that many tests read."""

import pytest

from studies.ou_liu_2017 import clouds


def _redraws(gross):
    points = clouds.sphere_redraws(300, gross=gross)
    points.flags.writeable = False  # shared by all tests
    return points


@pytest.fixture(scope="session")
def clean():
    """(300, 500, 3): redraws of the simulated sphere, m."""
    return _redraws(gross=False)


@pytest.fixture(scope="session")
def gross():
    """(300, 500, 3): the same with five gross errors, m."""
    return _redraws(gross=True)
