"""One small simulated campaign for all tests."""

import pytest

from studies.simulation.tunnel import default_tunnel, simulate_campaign, survey

DENSITY = 3000


@pytest.fixture(scope="session")
def scans():
    """Both epochs with their scans."""
    return simulate_campaign(DENSITY)


@pytest.fixture(scope="session")
def surveyed():
    """Both epochs before their scans."""
    return survey(default_tunnel())
