"""Keeps test runs out of the checkout, and notebooks that cannot be run here out of test runs.

At the root, because pytest reads it from here whether it is given tests, sources or notebooks.
"""

import os
import shutil
import tempfile

from project import scans
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


def pytest_ignore_collect(collection_path):
    if collection_path.suffix == ".ipynb" and scans.skip_reason(collection_path.stem):
        return True


def pytest_terminal_summary(terminalreporter, config):
    if config.option.nbval and (reason := scans.skip_reason(scans.NOTEBOOK)):
        terminalreporter.write_line(reason)
