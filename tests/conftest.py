"""Keeps test runs out of the checkout, and notebook 05 out of runs without scans."""

import os
import shutil
import tempfile

import pytest

from project import scans
from studies.ou_liu_2017 import clouds
from studies.paths import OUTPUT_VARIABLE


def pytest_configure(config):
    # Set here and not in a fixture: the kernels of the notebooks inherit it, and so do pytest's own
    # workers.
    config.own_output = (
        None if OUTPUT_VARIABLE in os.environ else tempfile.mkdtemp(prefix="analysis-")
    )
    if config.own_output:
        os.environ[OUTPUT_VARIABLE] = config.own_output
        os.environ["NO_NOTEBOOKS_WERE_RUN"] = "1"  # for the workers, which inherit the folder
    if not config.option.nbval:
        os.environ["MPLBACKEND"] = "Agg"  # in a notebook this would remove its figures


def pytest_unconfigure(config):
    if config.own_output:
        shutil.rmtree(os.environ.pop(OUTPUT_VARIABLE), ignore_errors=True)
        del os.environ["NO_NOTEBOOKS_WERE_RUN"]


def pytest_collection_modifyitems(items):
    for item in items:
        if item.path.suffix == ".ipynb" and (reason := scans.skip_reason(item.path.stem)):
            item.add_marker(pytest.mark.skip(reason=reason))


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
